//! Blend constants of up to 64 entries of a tile's list, and which 4×4 pixel blocks each entry touches.

use crate::kernel::{KernelProfile, ProfileConsts};
use crate::simd;
use crate::tiles::{BLOCK, ProjectedSplat};
use crate::workspace::BLOCKS;
use fearless_simd::{f32x16, prelude::*, u32x16};
use std::sync::atomic::{AtomicU32, Ordering};

/// Entries of a tile's list processed at once: one per bit of a `u64`.
pub(crate) const GROUP: usize = 64;

/// Constants of one entry, relative to the tile's first pixel: `a = a0 + w0 x + w1 y`, `b = b0 + w2 y`,
/// `log₂(o' g) = log2_opacity − a² − b²`, with `x`, `y` in pixels.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub(crate) struct Row {
    pub a0: f32,
    pub b0: f32,
    pub w: [f32; 3],
    pub log2_opacity: f32,
    pub rgb: [f32; 3],
    pub depth: f32,
    /// Set only if [`KernelProfile::HAS_PARAMS`]; stale otherwise.
    pub profile: ProfileConsts,
}

/// The rows of a group, and the blocks they touch as bit sets.
pub(crate) struct Rows {
    pub row: [Row; GROUP],
    /// Per block, a bit for every entry that touches it.
    pub by_block: [u64; BLOCKS],
    /// Per entry, a bit for every block it touches.
    pub by_entry: [u32; GROUP],
}

/// Sixteen [`crate::tiles::Ellipse`]s as a structure of arrays, one lane each.
#[derive(Default)]
struct Lanes {
    b0: [f32; 16],
    step: [f32; 16],
    radius: [f32; 16],
    support: [f32; 16],
    extreme: [f32; 16],
    slope: [f32; 16],
    inv_w0: [f32; 16],
    shift: [f32; 16],
    margin: [f32; 16],
    slack: [f32; 16],
}

impl Rows {
    /// Rows of zeros that touch no block.
    pub(crate) fn new() -> Self {
        Self { row: [Row::default(); GROUP], by_block: [0; BLOCKS], by_entry: [0; GROUP] }
    }

    /// Fills in the entries `list` (at most [`GROUP`] positions in `projected`) of the tile whose first pixel is
    /// `origin`.
    #[inline(always)]
    pub(crate) fn fill<S: Simd, K: KernelProfile>(
        &mut self,
        simd: S,
        kernel: K,
        projected: &[ProjectedSplat],
        list: &[AtomicU32],
        origin: [usize; 2],
    ) {
        let origin = origin.map(|v| v as f64);
        self.by_block = [0; BLOCKS];
        for (sixteen, part) in list.chunks(16).enumerate() {
            let mut lanes = Lanes { radius: [-1.0; 16], ..Lanes::default() };
            for (lane, at) in part.iter().enumerate() {
                let splat = &projected[at.load(Ordering::Relaxed) as usize];
                let row = &mut self.row[16 * sixteen + lane];
                row.set(splat, origin);
                if K::HAS_PARAMS {
                    row.profile = kernel.consts(splat.index);
                }
                lanes.set(lane, splat, origin);
            }
            if K::HAS_PARAMS {
                exp2_opacities(simd, &mut self.row[16 * sixteen..][..16]);
            }
            let blocks = lanes.blocks(simd, &mut self.by_entry[16 * sixteen..][..16]);
            for (all, bits) in self.by_block.iter_mut().zip(blocks) {
                *all |= bits << (16 * sixteen);
            }
        }
    }
}

impl Row {
    /// Sets everything but the profile.
    #[inline(always)]
    fn set(&mut self, splat: &ProjectedSplat, origin: [f64; 2]) {
        let (dx, dy) = (origin[0] + 0.5 - splat.center[0], origin[1] + 0.5 - splat.center[1]);
        let [w0, w1, w2] = splat.whitening;
        self.a0 = (w0 * dx + w1 * dy) as f32;
        self.b0 = (w2 * dy) as f32;
        self.w = splat.whitening.map(|w| w as f32);
        self.log2_opacity = splat.log2_opacity;
        self.rgb = splat.rgb;
        self.depth = splat.depth;
    }
}

/// Opacities of sixteen rows from their logarithms. The same exponential computes the samples, so no sample exceeds its
/// row's opacity by more than the rounding of that function.
#[inline(always)]
fn exp2_opacities<S: Simd>(simd: S, rows: &mut [Row]) {
    let mut lanes = [0.0f32; 16];
    for (lane, row) in lanes.iter_mut().zip(rows.iter()) {
        *lane = row.log2_opacity;
    }
    simd::exp2(simd, f32x16::from_slice(simd, &lanes)).store_slice(&mut lanes);
    for (row, lane) in rows.iter_mut().zip(lanes) {
        row.profile.opacity = lane;
    }
}

impl Lanes {
    #[inline(always)]
    fn set(&mut self, lane: usize, splat: &ProjectedSplat, origin: [f64; 2]) {
        let e = splat.ellipse(origin);
        self.b0[lane] = e.b0;
        self.step[lane] = e.step;
        self.radius[lane] = e.radius;
        self.support[lane] = e.support;
        self.extreme[lane] = e.extreme;
        self.slope[lane] = e.slope;
        self.inv_w0[lane] = e.inv_w0;
        self.shift[lane] = e.shift;
        self.margin[lane] = e.margin;
        self.slack[lane] = e.slack();
    }

    /// Per block, a bit for each of the sixteen entries that touches it; writes per entry the blocks it touches. The
    /// vector form of [`crate::tiles::Ellipse::columns`] on four strips of rows. A lane with negative radius touches
    /// nothing.
    #[inline(always)]
    fn blocks<S: Simd>(&self, simd: S, by_entry: &mut [u32]) -> [u64; BLOCKS] {
        let v = |a: &[f32; 16]| f32x16::from_slice(simd, a);
        let c = |x: f32| f32x16::splat(simd, x);
        let (radius, slope, inv_w0, support) = (v(&self.radius), v(&self.slope), v(&self.inv_w0), v(&self.support));
        let (extreme, shift, margin, slack) = (v(&self.extreme), v(&self.shift), v(&self.margin), v(&self.slack));
        let (b0, step) = (v(&self.b0), v(&self.step));
        let zero = c(0.0);
        let mut bits = [0u64; BLOCKS];
        let mut entry_bits = u32x16::splat(simd, 0);
        for strip in 0..4 {
            let first = (strip * BLOCK) as f32 + 0.5;
            let lo = (step.mul_add(c(first), b0) - slack).max(zero - radius);
            let hi = (step.mul_add(c(first + 3.0), b0) + slack).min(radius);
            let touched = lo.simd_le(hi);
            let right_b = (zero - extreme).max(lo).min(hi);
            let left_b = extreme.max(lo).min(hi);
            let half = |b: f32x16<S>| (support - b * b).max(zero).sqrt();
            let left = shift + (zero - half(left_b) - slope * left_b) * inv_w0 - margin;
            let right = shift + (half(right_b) - slope * right_b) * inv_w0 + margin;
            for column in 0..4 {
                let x = (column * BLOCK) as f32 + 0.5;
                let hit = touched & left.simd_le(c(x + 3.0)) & right.simd_ge(c(x));
                let block = strip * 4 + column;
                bits[block] = hit.to_bitmask();
                let one = u32x16::splat(simd, 1 << block);
                entry_bits |= hit.select(one, u32x16::splat(simd, 0));
            }
        }
        entry_bits.store_slice(by_entry);
        bits
    }
}
