//! How many splats made each pixel: another walk over the lists that a frame leaves behind.

use crate::blend::{Limits, block_pixels, log2_raw, whitened};
use crate::blend_backward::Stretch;
use crate::kernel::{Bent, Falloff, Gaussian};
use crate::options::RasterOptions;
use crate::rows::{GROUP, Rows};
use crate::simd;
use crate::tiles::TILE;
use crate::workspace::{BLOCKS, Plane, Workspace, pixel_of};
use fearless_simd::{dispatch, prelude::*, u32x16};
use gs_core::Splats;
use rayon::prelude::*;

/// Splats that were blended into each pixel, `[height, width]`: those of at least `min_alpha` there, up to the last one
/// before the pixel was full.
///
/// Must follow [`crate::render_into`] of the same splats and options with the same workspace.
pub fn blend_counts(splats: &Splats, options: &RasterOptions, workspace: &mut Workspace) -> Vec<u32> {
    if splats.kernel.is_neutral() {
        return counts(Gaussian, options, workspace);
    }
    let mut bends = std::mem::take(&mut workspace.bends);
    let kernel = Bent::new(&splats.kernel, splats.len(), options.kernel_cut, &mut bends);
    let found = counts(kernel, options, workspace);
    workspace.bends = bends;
    found
}

fn counts<K: Falloff>(kernel: K, options: &RasterOptions, w: &Workspace) -> Vec<u32> {
    let (level, limits, grid) = (simd::level(options.simd), Limits::new(options), &w.grid);
    let of_tile = |tile: usize| {
        let (origin, last) = (grid.origin(tile), &w.tiles[tile].last);
        let mut counts: Plane<u32> = [[0; 16]; BLOCKS];
        for chunk in &w.chunks[..w.chunk_count] {
            let first_number = chunk.seen_before[tile];
            let stretch = Stretch { drawn: &chunk.drawn, list: chunk.tile_list(tile), first_number };
            dispatch!(level, simd => count(simd, kernel, stretch, origin, limits, last, &mut counts));
        }
        counts
    };
    let tiles: Vec<Plane<u32>> = (0..w.tiles.len()).into_par_iter().map(of_tile).collect();
    let mut all = vec![0; grid.width * grid.height];
    for (tile, counts) in tiles.iter().enumerate() {
        let [left, top] = grid.origin(tile);
        let (width, height) = (TILE.min(grid.width - left), TILE.min(grid.height - top));
        for (block, lane) in (0..BLOCKS).flat_map(|b| (0..16).map(move |l| (b, l))) {
            let [x, y] = pixel_of(block, lane);
            if x < width && y < height {
                all[(top + y) * grid.width + left + x] = counts[block][lane];
            }
        }
    }
    all
}

/// Counts a stretch of a tile's list. What a pixel is reached by behind its `last` splat came too late.
#[inline(always)]
fn count<S: Simd, K: Falloff>(
    simd: S,
    kernel: K,
    stretch: Stretch,
    origin: [usize; 2],
    limits: Limits,
    last: &Plane<u32>,
    counts: &mut Plane<u32>,
) {
    let mut rows = Rows::new();
    let one = u32x16::splat(simd, 1);
    for (k, group) in stretch.list.chunks(GROUP).enumerate() {
        rows.fill(simd, kernel, stretch.drawn, group, origin);
        let first = stretch.first_number + (k * GROUP) as u32;
        for block in 0..BLOCKS {
            let (pixels, last) = (block_pixels(simd, block), u32x16::from_slice(simd, &last[block]));
            let mut sum = u32x16::from_slice(simd, &counts[block]);
            let mut bits = rows.by_block[block];
            while bits != 0 {
                let i = bits.trailing_zeros() as usize;
                bits &= bits - 1;
                let row = &rows.row[i];
                let sample = K::sample(simd, row, log2_raw(simd, row, whitened(simd, row, pixels)), limits);
                let blended = sample.reached & last.simd_gt(u32x16::splat(simd, first + i as u32));
                sum += blended.select(one, u32x16::splat(simd, 0));
            }
            sum.store_slice(&mut counts[block]);
        }
    }
}
