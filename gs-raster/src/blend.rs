//! Front-to-back blending of one tile. One vector holds sixteen pixels (a 4×4 block); a block's state stays in
//! registers.
//!
//! ```text
//! p = log₂ o' − a² − b²     α = min(max_alpha, o' ψ)   skipped below min_alpha
//! close a pixel before the sample with T (1 − α) ≤ stop
//! C += T α c     D += T α z     T ← T (1 − α)
//! ```

use crate::kernel::KernelProfile;
use crate::options::Limits;
use crate::rows::{GROUP, Row, Rows};
use crate::tiles::ProjectedSplat;
use crate::workspace::{BLOCKS, TileState, pixel_of};
use fearless_simd::{f32x16, mask32x16, prelude::*, u32x16};
use std::sync::atomic::AtomicU32;

/// Pixel offsets of each block from the tile's first pixel, `x` then `y`, one lane per pixel.
static PIXELS: [[[f32; 16]; 2]; BLOCKS] = {
    let mut table = [[[0.0; 16]; 2]; BLOCKS];
    let mut i = 0;
    while i < BLOCKS * 16 {
        let [x, y] = pixel_of(i / 16, i % 16);
        table[i / 16][0][i % 16] = x as f32;
        table[i / 16][1][i % 16] = y as f32;
        i += 1;
    }
    table
};

/// Pixel offsets of a block from the tile's first pixel, `x` then `y`, one lane per pixel.
#[inline(always)]
pub(crate) fn block_pixels<S: Simd>(simd: S, block: usize) -> [f32x16<S>; 2] {
    let [x, y] = &PIXELS[block];
    [f32x16::from_slice(simd, x), f32x16::from_slice(simd, y)]
}

/// Whitened offsets `(a, b)` of a block's pixels from a splat's centre.
#[inline(always)]
pub(crate) fn whitened<S: Simd>(simd: S, row: &Row, pixels: [f32x16<S>; 2]) -> [f32x16<S>; 2] {
    let c = |v: f32| f32x16::splat(simd, v);
    let a = pixels[0].mul_add(c(row.w[0]), pixels[1].mul_add(c(row.w[1]), c(row.a0)));
    [a, pixels[1].mul_add(c(row.w[2]), c(row.b0))]
}

/// `log₂(o' g)` from whitened offsets: `log2_opacity − a² − b²`.
#[inline(always)]
pub(crate) fn log2_raw<S: Simd>(simd: S, row: &Row, [a, b]: [f32x16<S>; 2]) -> f32x16<S> {
    let minus = |v: f32x16<S>| f32x16::splat(simd, 0.0) - v;
    minus(a).mul_add(a, minus(b).mul_add(b, f32x16::splat(simd, row.log2_opacity)))
}

/// Blends `list` (positions in `projected`) front to back into the tile whose first pixel is `origin`. The list
/// continues what the tile was given before; its entries get the next slots.
#[inline(always)]
pub(crate) fn blend<S: Simd, K: KernelProfile>(
    simd: S,
    kernel: K,
    projected: &[ProjectedSplat],
    list: &[AtomicU32],
    origin: [usize; 2],
    limits: Limits,
    state: &mut TileState,
) {
    let mut rows = Rows::new();
    let mut slot = state.listed;
    state.listed += list.len() as u32;
    for group in list.chunks(GROUP) {
        rows.fill(simd, kernel, projected, group, origin);
        for block in 0..BLOCKS {
            if state.open[block] != 0 && rows.by_block[block] != 0 {
                blend_block::<S, K>(simd, &rows, block, slot, limits, state);
            }
        }
        if !state.is_open() {
            return;
        }
        slot += group.len() as u32;
    }
}

#[inline(always)]
fn blend_block<S: Simd, K: KernelProfile>(
    simd: S,
    rows: &Rows,
    block: usize,
    slot: u32,
    limits: Limits,
    state: &mut TileState,
) {
    let c = |v: f32| f32x16::splat(simd, v);
    let load = |plane: &[[f32; 16]; BLOCKS]| f32x16::from_slice(simd, &plane[block]);
    let pixels = block_pixels(simd, block);
    let mut transmittance = load(&state.transmittance);
    let mut rgb = [load(&state.rgb[0]), load(&state.rgb[1]), load(&state.rgb[2])];
    let mut depth = load(&state.depth);
    let mut last = u32x16::from_slice(simd, &state.last[block]);
    let mut open = mask32x16::from_bitmask(simd, u64::from(state.open[block]));
    let (max_alpha, stop) = (c(limits.max_alpha), c(limits.stop));
    let mut bits = rows.by_block[block];
    while bits != 0 {
        let i = bits.trailing_zeros() as usize;
        bits &= bits - 1;
        let row = &rows.row[i];
        let p = log2_raw(simd, row, whitened(simd, row, pixels));
        let sample = K::sample(simd, row, p, limits);
        let mut blended = open & sample.visible;
        let mut alpha = blended.select(sample.raw.min(max_alpha), c(0.0));
        let mut next = (c(0.0) - alpha).mul_add(transmittance, transmittance);
        let closing = next.simd_le(stop);
        // A pixel closes once per frame, before T falls to `stop`, so the common path skips this.
        if closing.any_true() {
            blended &= !closing;
            open &= !closing;
            alpha = blended.select(alpha, c(0.0));
            next = closing.select(transmittance, next);
        }
        let weight = transmittance * alpha;
        for (to, from) in rgb.iter_mut().zip(row.rgb) {
            *to = weight.mul_add(c(from), *to);
        }
        depth = weight.mul_add(c(row.depth), depth);
        transmittance = next;
        last = blended.select(u32x16::splat(simd, slot + i as u32 + 1), last);
        if !open.any_true() {
            break;
        }
    }
    transmittance.store_slice(&mut state.transmittance[block]);
    for (plane, value) in state.rgb.iter_mut().zip(rgb) {
        value.store_slice(&mut plane[block]);
    }
    depth.store_slice(&mut state.depth[block]);
    last.store_slice(&mut state.last[block]);
    state.open[block] = open.to_bitmask() as u16;
}
