//! Backward of one tile, back to front: each entry's gradient sums over the tile's pixels.
//!
//! ```text
//! T   ← T / (1 − α)                       transmittance in front of the sample
//! v_α = T (c·D + z D_z) − S / (1 − α)     S: everything behind, Σ w (c·D + z D_z) + T_end (background·D − D_α)
//! S   ← S + T α (c·D + z D_z)
//! s   = dL/d ln o', dL/d ln g             from v_α by the kernel profile; zero above the cap if ClampGrad::Exact
//! ```
//! Entries are the outer loop, blocks the inner one, so an entry's sums stay in registers until they are reduced once;
//! pixel state stays in the first-level cache. Each (tile, entry) pair writes its own record: there are no atomics, and
//! the order of additions depends on the tile alone. `D`, `D_z`, `D_α` are the cotangents of colour, depth and alpha.

use crate::blend::{block_pixels, log2_raw, whitened};
use crate::kernel::{KernelProfile, SampleGrad};
use crate::options::Limits;
use crate::rows::{GROUP, Row, Rows};
use crate::simd::LANES;
use crate::tiles::ProjectedSplat;
use crate::workspace::{BLOCKS, Plane, Record, TileState};
use fearless_simd::{f32x16, prelude::*, u32x16};
use std::sync::atomic::AtomicU32;

/// State of a tile's pixels during the backward pass.
pub(crate) struct TileBackward {
    /// Transmittance `T` behind the current entry.
    transmittance: Plane<f32>,
    /// `S`: what lies behind the current entry, times the cotangents.
    behind: Plane<f32>,
    /// Cotangents of colour.
    pub d_rgb: [Plane<f32>; 3],
    /// Cotangents of depth.
    pub d_depth: Plane<f32>,
    /// One past the slot of each pixel's last blended entry.
    last: Plane<u32>,
    /// Largest `last` of each block.
    deepest: [u32; BLOCKS],
}

impl TileBackward {
    /// From the state that the forward pass left. `d_alpha` is the cotangent of accumulated alpha.
    pub(crate) fn new(
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

/// One chunk's part of a tile's list.
#[derive(Clone, Copy)]
pub(crate) struct TileSpan<'a> {
    pub projected: &'a [ProjectedSplat],
    pub list: &'a [AtomicU32],
    /// Slot of the first entry: its position in the tile's list over all chunks.
    pub first_slot: u32,
}

/// Backward of one span. `records` are the tile's, by slot.
#[inline(always)]
pub(crate) fn blend_backward<S: Simd, K: KernelProfile, const DEPTH: bool>(
    simd: S,
    kernel: K,
    span: TileSpan,
    origin: [usize; 2],
    limits: Limits,
    state: &mut TileBackward,
    records: &mut [Record],
) {
    let mut rows = Rows::new();
    let used = records.len().saturating_sub(span.first_slot as usize).min(span.list.len());
    for start in (0..used.div_ceil(GROUP)).rev().map(|g| g * GROUP) {
        let group = &span.list[start..span.list.len().min(start + GROUP)];
        rows.fill(simd, kernel, span.projected, group, origin);
        for i in (0..group.len().min(used - start)).rev() {
            let slot = span.first_slot + (start + i) as u32;
            let sums = entry::<S, K, DEPTH>(simd, &rows.row[i], rows.by_entry[i], slot, limits, state);
            records[slot as usize] = reduce::<S, K>(simd, sums);
        }
    }
}

/// Lane sums in the order of a [`Record`]; the last two stay zero where the kernel has no parameters.
type Sums<S> = [f32x16<S>; 12];

/// Gradient sums of one entry over the blocks it touches.
#[inline(always)]
fn entry<S: Simd, K: KernelProfile, const DEPTH: bool>(
    simd: S,
    row: &Row,
    blocks: u32,
    slot: u32,
    limits: Limits,
    state: &mut TileBackward,
) -> Sums<S> {
    let c = |v: f32| f32x16::splat(simd, v);
    let (zero, one) = (c(0.0), c(1.0));
    let mut sums = [zero; 12];
    let mut bits = blocks;
    while bits != 0 {
        let block = bits.trailing_zeros() as usize;
        bits &= bits - 1;
        if state.deepest[block] <= slot {
            continue;
        }
        let load = |plane: &Plane<f32>| f32x16::from_slice(simd, &plane[block]);
        let offset = whitened(simd, row, block_pixels(simd, block));
        let sample = K::sample(simd, row, log2_raw(simd, row, offset), limits);
        let last = u32x16::from_slice(simd, &state.last[block]);
        let blended = sample.visible & last.simd_gt(u32x16::splat(simd, slot));
        let alpha = blended.select(sample.raw.min(c(limits.max_alpha)), zero);
        let inverse = reciprocal(simd, one - alpha);
        let transmittance = load(&state.transmittance) * inverse;
        let behind = load(&state.behind);
        let d = [load(&state.d_rgb[0]), load(&state.d_rgb[1]), load(&state.d_rgb[2])];
        let mut light = d[0] * c(row.rgb[0]);
        light = d[1].mul_add(c(row.rgb[1]), light);
        light = d[2].mul_add(c(row.rgb[2]), light);
        if DEPTH {
            light = load(&state.d_depth).mul_add(c(row.depth), light);
        }
        let d_alpha = transmittance * light - behind * inverse;
        let weight = transmittance * alpha;
        transmittance.store_slice(&mut state.transmittance[block]);
        weight.mul_add(light, behind).store_slice(&mut state.behind[block]);
        let has_grad = if limits.pass_through { blended } else { blended & sample.raw.simd_le(c(limits.max_alpha)) };
        let grad = K::backward(simd, row, sample, has_grad, d_alpha);
        accumulate::<S, K>(&mut sums, grad, offset, weight, d);
        if DEPTH {
            sums[9] = weight.mul_add(load(&state.d_depth), sums[9]);
        }
    }
    sums
}

/// `1 / x` to rounding for `x` in `[0.001, 1]`, by Newton steps from the hardware's estimate. One step suffices for the
/// 14-bit estimate of AVX-512; the 12-bit ones take two, else a bias of 1e-7 per sample adds up over deep tiles.
#[inline(always)]
fn reciprocal<S: Simd>(simd: S, x: f32x16<S>) -> f32x16<S> {
    let (minus_x, one) = (f32x16::splat(simd, 0.0) - x, f32x16::splat(simd, 1.0));
    let estimate = x.approximate_recip();
    let first = minus_x.mul_add(estimate, one).mul_add(estimate, estimate);
    if S::f32s::LEN == LANES { first } else { minus_x.mul_add(first, one).mul_add(first, first) }
}

/// Adds one block's samples to `o, sa, sb, saa, sab, sbb, r, g, b` and the sums of the kernel's parameters.
#[inline(always)]
fn accumulate<S: Simd, K: KernelProfile>(
    sums: &mut Sums<S>,
    grad: SampleGrad<S>,
    [a, b]: [f32x16<S>; 2],
    weight: f32x16<S>,
    d: [f32x16<S>; 3],
) {
    let (sa, sb) = (grad.d_ln_g * a, grad.d_ln_g * b);
    sums[0] += grad.d_ln_opacity;
    sums[1] += sa;
    sums[2] += sb;
    sums[3] = sa.mul_add(a, sums[3]);
    sums[4] = sa.mul_add(b, sums[4]);
    sums[5] = sb.mul_add(b, sums[5]);
    for k in 0..3 {
        sums[6 + k] = weight.mul_add(d[k], sums[6 + k]);
    }
    if K::HAS_PARAMS {
        sums[10] += grad.d_kernel[0];
        sums[11] += grad.d_kernel[1];
    }
}

/// Sums of the lanes of each vector: lane `k` of the result is the sum of vector `k`. Four rounds of
/// pairwise sums.
#[inline(always)]
fn reduce<S: Simd, K: KernelProfile>(simd: S, v: Sums<S>) -> Record {
    let zero = f32x16::splat(simd, 0.0);
    let (p0, p1) = (pairwise_sums(simd, v[0], v[1]), pairwise_sums(simd, v[2], v[3]));
    let (p2, p3) = (pairwise_sums(simd, v[4], v[5]), pairwise_sums(simd, v[6], v[7]));
    let (q0, q1) = (pairwise_sums(simd, p0, p1), pairwise_sums(simd, p2, p3));
    let p5 = if K::HAS_PARAMS { pairwise_sums(simd, v[10], v[11]) } else { zero };
    let q2 = pairwise_sums(simd, pairwise_sums(simd, v[8], v[9]), p5);
    let (r0, r1) = (pairwise_sums(simd, q0, q1), pairwise_sums(simd, q2, zero));
    let mut record = [0.0; 16];
    pairwise_sums(simd, r0, r1).store_slice(&mut record);
    record
}

/// Sums of neighbouring lanes of `a`, then of `b`.
#[inline(always)]
fn pairwise_sums<S: Simd>(simd: S, a: f32x16<S>, b: f32x16<S>) -> f32x16<S> {
    simd.unzip_low_f32x16(a, b) + simd.unzip_high_f32x16(a, b)
}
