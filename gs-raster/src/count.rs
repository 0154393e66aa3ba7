//! Number of splats blended into each pixel, from the tile lists of the last frame.

use crate::blend::{block_pixels, log2_raw, whitened};
use crate::blend_backward::TileSpan;
use crate::kernel::{Gaussian, KernelProfile, PiecewiseLinear};
use crate::options::{Limits, RasterOptions};
use crate::rows::{GROUP, Rows};
use crate::simd;
use crate::tiles::TILE;
use crate::workspace::{BLOCKS, Plane, Workspace, pixel_of};
use fearless_simd::{dispatch, prelude::*, u32x16};
use gs_core::SplatsRef;
use rayon::prelude::*;

/// Number of splats blended into each pixel, `[height, width]` row-major: those that reach `min_alpha` there, up to the
/// one before the pixel's transmittance falls to `stop`.
///
/// Must follow [`crate::render_into`] of the same splats and options with the same workspace.
///
/// ```
/// use gs_raster::{RasterOptions, Workspace, blend_counts, measure, render};
///
/// let (splats, camera) = (measure::scene(500, 0), measure::camera(32));
/// let (options, mut workspace) = (RasterOptions::default(), Workspace::new());
/// let frame = render(&splats, &camera, &options, &mut workspace);
/// let counts = blend_counts(&splats, &options, &mut workspace);
/// assert!(counts.iter().zip(&frame.alpha).all(|(&n, &alpha)| (n > 0) == (alpha > 0.0)));
/// ```
pub fn blend_counts<'a>(
    splats: impl Into<SplatsRef<'a>>,
    options: &RasterOptions,
    workspace: &mut Workspace,
) -> Vec<u32> {
    counts_of(splats.into(), options, workspace)
}

/// The same, compiled here once and not in every crate that calls a generic function.
fn counts_of(splats: SplatsRef<'_>, options: &RasterOptions, workspace: &mut Workspace) -> Vec<u32> {
    if splats.kernel.is_neutral() {
        return counts(Gaussian, options, workspace);
    }
    let mut kernel_consts = std::mem::take(&mut workspace.kernel_consts);
    let kernel = PiecewiseLinear::new(splats.kernel, splats.len(), options.kernel_cut, &mut kernel_consts);
    let found = counts(kernel, options, workspace);
    workspace.kernel_consts = kernel_consts;
    found
}

fn counts<K: KernelProfile>(kernel: K, options: &RasterOptions, w: &Workspace) -> Vec<u32> {
    let (level, limits, grid) = (simd::level(options.simd), Limits::new(options), &w.grid);
    let tile_counts = |tile: usize| {
        let (origin, last) = (grid.origin(tile), &w.tiles[tile].last);
        let mut counts: Plane<u32> = [[0; 16]; BLOCKS];
        for chunk in &w.chunks[..w.chunk_count] {
            let first_slot = chunk.listed_before[tile];
            let span = TileSpan { projected: &chunk.projected, list: chunk.tile_list(tile), first_slot };
            dispatch!(level, simd => count(simd, kernel, span, origin, limits, last, &mut counts));
        }
        counts
    };
    let tiles: Vec<Plane<u32>> = (0..w.tiles.len()).into_par_iter().map(tile_counts).collect();
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

/// Adds one span of a tile's list to `counts`. Entries behind a pixel's `last` were not blended.
#[inline(always)]
fn count<S: Simd, K: KernelProfile>(
    simd: S,
    kernel: K,
    span: TileSpan,
    origin: [usize; 2],
    limits: Limits,
    last: &Plane<u32>,
    counts: &mut Plane<u32>,
) {
    let mut rows = Rows::new();
    let one = u32x16::splat(simd, 1);
    for (k, group) in span.list.chunks(GROUP).enumerate() {
        rows.fill(simd, kernel, span.projected, group, origin);
        let first = span.first_slot + (k * GROUP) as u32;
        for block in 0..BLOCKS {
            let (pixels, last) = (block_pixels(simd, block), u32x16::from_slice(simd, &last[block]));
            let mut sum = u32x16::from_slice(simd, &counts[block]);
            let mut bits = rows.by_block[block];
            while bits != 0 {
                let i = bits.trailing_zeros() as usize;
                bits &= bits - 1;
                let row = &rows.row[i];
                let sample = K::sample(simd, row, log2_raw(simd, row, whitened(simd, row, pixels)), limits);
                let blended = sample.visible & last.simd_gt(u32x16::splat(simd, first + i as u32));
                sum += blended.select(one, u32x16::splat(simd, 0));
            }
            sum.store_slice(&mut counts[block]);
        }
    }
}
