//! One tile, back to front: every entry's gradient sums over the tile's pixels.
//!
//! ```text
//! T   ← T / (1 − α)                       transmittance in front of the sample, recovered
//! v_α = T (c·D + z D_z) − S / (1 − α)     S: light from behind, Σ w (c·D + z D_z) + T_end (background·D − D_α)
//! S   ← S + T α (c·D + z D_z)
//! s   = dL/d ln o', dL/d ln g             from v_α by the kernel; zero above the cap under the exact rule
//! ```
//! Entries are the outer loop, blocks the inner one, so an entry's sums stay in registers until they are reduced
//! once; pixel state stays in the first-level cache. Each (tile, entry) writes one record of its own: no atomics, and
//! the order of additions depends on nothing but the tile.

use crate::blend::{Limits, block_pixels, log2_raw, whitened};
use crate::kernel::{Falloff, Pull};
use crate::rows::{GROUP, Row, Rows};
use crate::simd::LANES;
use crate::tiles::Drawn;
use crate::workspace::{BLOCKS, Plane, Record, TileState};
use fearless_simd::{f32x16, prelude::*, u32x16};
use std::sync::atomic::AtomicU32;

/// State of a tile's pixels on the way back.
pub(crate) struct TileBack {
    /// Transmittance behind the current entry.
    transmittance: Plane<f32>,
    /// Light from behind it, times the cotangents.
    behind: Plane<f32>,
    /// Cotangents of colour and depth.
    pub d_rgb: [Plane<f32>; 3],
    pub d_depth: Plane<f32>,
    last: Plane<u32>,
    /// Largest `last` of each block.
    deepest: [u32; BLOCKS],
}

impl TileBack {
    /// From the state the forward pass left; `d_alpha` is the cotangent of accumulated alpha.
    pub fn new(
        state: &TileState,
        d_rgb: [Plane<f32>; 3],
        d_alpha: &Plane<f32>,
        d_depth: Plane<f32>,
        background: [f32; 3],
    ) -> Self {
        let mut behind = [[0.0; 16]; BLOCKS];
        for (block, row) in behind.iter_mut().enumerate() {
            for (lane, value) in row.iter_mut().enumerate() {
                let light: f32 = (0..3).map(|c| background[c] * d_rgb[c][block][lane]).sum();
                *value = state.transmittance[block][lane] * (light - d_alpha[block][lane]);
            }
        }
        let deepest = state.last.map(|lanes| lanes.into_iter().max().unwrap_or(0));
        Self { transmittance: state.transmittance, behind, d_rgb, d_depth, last: state.last, deepest }
    }
}

/// One chunk's part of a tile's list, with the running number of its first entry.
#[derive(Clone, Copy)]
pub(crate) struct Stretch<'a> {
    pub drawn: &'a [Drawn],
    pub list: &'a [AtomicU32],
    pub first_number: u32,
}

/// Goes back through one stretch; `records` are the tile's, by running number.
#[inline(always)]
pub(crate) fn blend_backward<S: Simd, K: Falloff, const DEPTH: bool>(
    simd: S,
    kernel: K,
    stretch: Stretch,
    origin: [usize; 2],
    limits: Limits,
    back: &mut TileBack,
    records: &mut [Record],
) {
    let mut rows = Rows::new();
    let used = records.len().saturating_sub(stretch.first_number as usize).min(stretch.list.len());
    for start in (0..used.div_ceil(GROUP)).rev().map(|g| g * GROUP) {
        let group = &stretch.list[start..stretch.list.len().min(start + GROUP)];
        rows.fill(simd, kernel, stretch.drawn, group, origin);
        for i in (0..group.len().min(used - start)).rev() {
            let number = stretch.first_number + (start + i) as u32;
            let sums = entry::<S, K, DEPTH>(simd, &rows.row[i], rows.by_entry[i], number, limits, back);
            records[number as usize] = reduce::<S, K>(simd, sums);
        }
    }
}

/// In the order of a [`Record`]; the last two stay zero where the kernel has no parameters.
type Sums<S> = [f32x16<S>; 12];

/// Gradient sums of one entry over the blocks it touches.
#[inline(always)]
fn entry<S: Simd, K: Falloff, const DEPTH: bool>(
    simd: S,
    row: &Row,
    blocks: u32,
    number: u32,
    limits: Limits,
    back: &mut TileBack,
) -> Sums<S> {
    let c = |v: f32| f32x16::splat(simd, v);
    let (zero, one) = (c(0.0), c(1.0));
    let mut sums = [zero; 12];
    let mut bits = blocks;
    while bits != 0 {
        let block = bits.trailing_zeros() as usize;
        bits &= bits - 1;
        if back.deepest[block] <= number {
            continue;
        }
        let load = |plane: &Plane<f32>| f32x16::from_slice(simd, &plane[block]);
        let offset = whitened(simd, row, block_pixels(simd, block));
        let sample = K::sample(simd, row, log2_raw(simd, row, offset), limits);
        let last = u32x16::from_slice(simd, &back.last[block]);
        let blended = sample.reached & last.simd_gt(u32x16::splat(simd, number));
        let alpha = blended.select(sample.raw.min(c(limits.max_alpha)), zero);
        let inverse = reciprocal(simd, one - alpha);
        let transmittance = load(&back.transmittance) * inverse;
        let behind = load(&back.behind);
        let d = [load(&back.d_rgb[0]), load(&back.d_rgb[1]), load(&back.d_rgb[2])];
        let mut light = d[0] * c(row.rgb[0]);
        light = d[1].mul_add(c(row.rgb[1]), light);
        light = d[2].mul_add(c(row.rgb[2]), light);
        if DEPTH {
            light = load(&back.d_depth).mul_add(c(row.depth), light);
        }
        let d_alpha = transmittance * light - behind * inverse;
        let weight = transmittance * alpha;
        transmittance.store_slice(&mut back.transmittance[block]);
        weight.mul_add(light, behind).store_slice(&mut back.behind[block]);
        let learns = if limits.pass_through { blended } else { blended & sample.raw.simd_le(c(limits.max_alpha)) };
        let pull = K::backward(simd, row, sample, learns, d_alpha);
        accumulate::<S, K>(&mut sums, pull, offset, weight, d);
        if DEPTH {
            sums[9] = weight.mul_add(load(&back.d_depth), sums[9]);
        }
    }
    sums
}

/// `1 / x` by Newton steps from the machine's estimate, to rounding, for `x` in `[0.001, 1]`. One step does for the
/// 14-bit estimate of AVX-512; the 12-bit ones take two, else a bias of 1e-7 a sample adds up over deep tiles.
#[inline(always)]
fn reciprocal<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    let (minus_x, one) = (f32x16::splat(simd, 0.0) - x, f32x16::splat(simd, 1.0));
    let estimate = x.approximate_recip();
    let first = minus_x.mul_add(estimate, one).mul_add(estimate, estimate);
    if S::f32s::LEN == LANES { first } else { minus_x.mul_add(first, one).mul_add(first, first) }
}

/// Adds one block's samples to `o, sa, sb, saa, sab, sbb, r, g, b` and the sums of the kernel's parameters.
#[inline(always)]
fn accumulate<S: Simd, K: Falloff>(
    sums: &mut Sums<S>,
    pull: Pull<S>,
    [a, b]: [f32x16<S>; 2],
    weight: f32x16<S>,
    d: [f32x16<S>; 3],
) {
    let (sa, sb) = (pull.shape * a, pull.shape * b);
    sums[0] += pull.opacity;
    sums[1] += sa;
    sums[2] += sb;
    sums[3] = sa.mul_add(a, sums[3]);
    sums[4] = sa.mul_add(b, sums[4]);
    sums[5] = sb.mul_add(b, sums[5]);
    for k in 0..3 {
        sums[6 + k] = weight.mul_add(d[k], sums[6 + k]);
    }
    if K::BENT {
        sums[10] += pull.bend[0];
        sums[11] += pull.bend[1];
    }
}

/// Sums of the lanes of each vector: lane `k` of the result is the sum of vector `k`. Four rounds of pairwise sums.
#[inline(always)]
fn reduce<S: Simd, K: Falloff>(simd: S, v: Sums<S>) -> Record {
    let zero = f32x16::splat(simd, 0.0);
    let (p0, p1) = (pairs(simd, v[0], v[1]), pairs(simd, v[2], v[3]));
    let (p2, p3) = (pairs(simd, v[4], v[5]), pairs(simd, v[6], v[7]));
    let (q0, q1) = (pairs(simd, p0, p1), pairs(simd, p2, p3));
    let p5 = if K::BENT { pairs(simd, v[10], v[11]) } else { zero };
    let q2 = pairs(simd, pairs(simd, v[8], v[9]), p5);
    let (r0, r1) = (pairs(simd, q0, q1), pairs(simd, q2, zero));
    let mut record = [0.0; 16];
    pairs(simd, r0, r1).store_slice(&mut record);
    record
}

/// Sums of neighbouring lanes of `a`, then of `b`.
#[inline(always)]
fn pairs<S: Simd>(simd: S, a: f32x16<S>, b: f32x16<S>) -> f32x16<S> {
    simd.unzip_low_f32x16(a, b) + simd.unzip_high_f32x16(a, b)
}
