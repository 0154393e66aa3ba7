//! A frame: depth order, then chunks of splats front to back, each binned to the tiles that are still open and blended.
//!
//! Chunks grow geometrically, and one of splats that meet very many tiles is cut. A tile whose pixels are all closed takes no further entries, so splats hidden behind it
//! cost neither binning nor colour. The image is bit for bit the one of full lists.

use crate::blend::blend;
use crate::frame::Frame;
use crate::kernel::{Gaussian, KernelProfile, PiecewiseLinear};
use crate::lanes::{LANES, Lanes};
use crate::options::{Limits, RasterOptions};
use crate::project::{Outline, SplatGeometry, View, project, sh_color};
use crate::simd;
use crate::sort::{Key, sort};
use crate::tiles::{Grid, LOG2_SCALE, OpenTiles, ProjectedSplat, TILE};
use crate::workspace::{Bin, Chunk, Entry, TileState, Workspace};
use fearless_simd::{Level, dispatch, prelude::*};
use gs_core::{Camera, Color, SplatsRef};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};

/// Splats per task when depth keys are computed.
const KEY_BLOCK: usize = 4096;
/// The first chunk holds the number of splats divided by this; each further one twice as many as the one before.
const FIRST_CHUNK_DIVISOR: usize = 24;
/// Fewest splats of the first chunk.
const MIN_CHUNK: usize = 2048;
/// Most tasks that bin one chunk.
const MAX_BIN_TASKS: usize = 16;
/// Fewest splats of a binning task.
const MIN_BIN_SPLATS: usize = 128;
/// Splats per task when the splats of a chunk get other colours.
const RECOLOR_BLOCK: usize = 1024;

/// Renders `splats` from `camera` into `frame`, reusing its memory and that of `workspace`.
///
/// `splats` and `camera` must have passed their `check`; the frame is finite then. The result is the same bits for any
/// number of threads.
///
/// ```
/// use gs_raster::{Frame, RasterOptions, Workspace, measure, render_into};
///
/// let (mut workspace, mut frame) = (Workspace::new(), Frame::default());
/// for side in [64, 32] {
///     let (splats, camera) = (measure::scene(200, 1), measure::camera(side));
///     render_into(&splats, &camera, &RasterOptions::default(), &mut workspace, &mut frame);
///     assert_eq!(frame.alpha.len(), (side * side) as usize);
/// }
/// ```
pub fn render_into<'a>(
    splats: impl Into<SplatsRef<'a>>,
    camera: &Camera,
    options: &RasterOptions,
    workspace: &mut Workspace,
    frame: &mut Frame,
) {
    render_lists(splats.into(), Lists::New(camera), options, workspace, frame);
}

/// The lists of splats per tile that a frame is blended from.
#[derive(Clone, Copy)]
pub(crate) enum Lists<'a> {
    /// Made for this camera.
    New(&'a Camera),
    /// Those of the last frame; the splats differ from its splats in colour alone.
    Kept,
}

/// [`render_into`] with the lists named.
pub(crate) fn render_lists(
    splats: SplatsRef<'_>,
    lists: Lists<'_>,
    options: &RasterOptions,
    workspace: &mut Workspace,
    frame: &mut Frame,
) {
    if splats.kernel.is_neutral() {
        render_with(Gaussian, splats, lists, options, workspace, frame);
    } else {
        let mut kernel_consts = std::mem::take(&mut workspace.kernel_consts);
        let kernel = PiecewiseLinear::new(splats.kernel, splats.len(), options.kernel_cut, &mut kernel_consts);
        render_with(kernel, splats, lists, options, workspace, frame);
        workspace.kernel_consts = kernel_consts;
    }
}

/// [`render_lists`] with a given kernel profile.
pub(crate) fn render_with<K: KernelProfile>(
    kernel: K,
    splats: SplatsRef<'_>,
    lists: Lists<'_>,
    options: &RasterOptions,
    w: &mut Workspace,
    frame: &mut Frame,
) {
    match lists {
        Lists::New(camera) => {
            let view = View::new(camera);
            w.grid = Grid::new(camera.width as usize, camera.height as usize);
            w.view = Some(view);
            reset_tiles(&mut w.tiles, &w.grid);
            depth_keys(splats, &view, options, w);
            sort(&mut w.keys, &mut w.key_scratch, |i| view.depth(splats.means[i as usize]));
            render_chunks(kernel, splats, options, w);
        }
        Lists::Kept => {
            recolor(splats, options, w);
            reset_tiles(&mut w.tiles, &w.grid);
            let (level, limits) = (simd::level(options.simd), Limits::new(options));
            for chunk in &mut w.chunks[..w.chunk_count] {
                blend_chunk(kernel, level, limits, &w.grid, chunk, &mut w.tiles);
            }
        }
    }
    assemble(&w.tiles, &w.grid, options.background, frame);
}

/// Gives the listed splats of the last frame the colours of `splats`, which differ from its splats in nothing else.
pub(crate) fn recolor(splats: SplatsRef<'_>, options: &RasterOptions, w: &mut Workspace) {
    let Some(view) = &w.view else { return };
    let level = simd::level(options.simd);
    for chunk in &mut w.chunks[..w.chunk_count] {
        let blocks =
            chunk.projected.par_chunks_mut(RECOLOR_BLOCK).zip(chunk.splat_starts.par_windows(2).chunks(RECOLOR_BLOCK));
        blocks.for_each(
            |(projected, spans)| dispatch!(level, simd => recolor_block(simd, splats, view, projected, &spans)),
        );
    }
}

#[inline(always)]
fn recolor_block<S: Simd>(
    _: S,
    splats: SplatsRef<'_>,
    view: &View,
    projected: &mut [ProjectedSplat],
    spans: &[&[u32]],
) {
    for (splat, span) in projected.iter_mut().zip(spans) {
        if span[1] > span[0] {
            splat.rgb = color(splats, view, splat.index);
        }
    }
}

fn reset_tiles(tiles: &mut Vec<TileState>, grid: &Grid) {
    tiles.resize_with(grid.tiles(), TileState::default);
    tiles.par_iter_mut().enumerate().for_each(|(i, t)| t.reset(grid.origin(i), grid));
}

/// Depth keys, in row order, of the splats within the depth range that can reach `min_alpha`.
fn depth_keys(splats: SplatsRef<'_>, view: &View, options: &RasterOptions, w: &mut Workspace) {
    let blocks = splats.len().div_ceil(KEY_BLOCK);
    w.key_blocks.resize_with(blocks, Vec::new);
    w.key_blocks.par_iter_mut().enumerate().for_each(|(block, keys)| {
        keys.clear();
        let end = splats.len().min((block + 1) * KEY_BLOCK);
        for i in block * KEY_BLOCK..end {
            let depth = view.depth(splats.means[i]);
            if depth > options.near && depth < options.far && f64::from(splats.opacities[i]) >= options.min_alpha {
                keys.push(Key { bits: (depth as f32).to_bits(), index: i as u32 });
            }
        }
    });
    w.keys.clear();
    for block in &w.key_blocks {
        w.keys.extend_from_slice(block);
    }
}

fn render_chunks<K: KernelProfile>(kernel: K, splats: SplatsRef<'_>, options: &RasterOptions, w: &mut Workspace) {
    let level = simd::level(options.simd);
    let limits = Limits::new(options);
    let Some(view) = w.view else { return };
    w.open.update(&w.grid, w.tiles.iter().map(TileState::is_open));
    let max_distance = f64::from(-limits.log2_min_alpha).sqrt() / LOG2_SCALE;
    let mut first = 0;
    let mut size = MIN_CHUNK.max(w.keys.len() / FIRST_CHUNK_DIVISOR);
    w.chunk_count = 0;
    while first < w.keys.len() && w.open.any() {
        let end = w.keys.len().min(first + size);
        // A short remainder joins this chunk.
        let mut end = if w.keys.len() - end < size / 2 { w.keys.len() } else { end };
        if w.chunks.len() == w.chunk_count {
            w.chunks.push(Chunk::default());
        }
        let chunk = &mut w.chunks[w.chunk_count];
        w.chunk_count += 1;
        chunk.first = first;
        let scene = Scene { kernel, splats, options, view: &view, limits, grid: &w.grid, open: &w.open, max_distance };
        while !bin_chunk(&scene, &w.keys[first..end], w.max_entries.0, &mut w.bins, chunk) {
            size = (end - first).div_ceil(2);
            end = first + size;
        }
        blend_chunk(kernel, level, limits, &w.grid, chunk, &mut w.tiles);
        w.open.update(&w.grid, w.tiles.iter().map(TileState::is_open));
        first = end;
        size *= 2;
    }
}

/// Inputs of binning.
struct Scene<'a, K> {
    kernel: K,
    splats: SplatsRef<'a>,
    options: &'a RasterOptions,
    view: &'a View,
    limits: Limits,
    grid: &'a Grid,
    open: &'a OpenTiles,
    /// Largest Mahalanobis distance at which an opaque Gaussian reaches `min_alpha`.
    max_distance: f64,
}

impl<K: KernelProfile> Scene<'_, K> {
    /// Lists in `reaching` the positions of those splats of `keys` whose bound meets an open tile.
    #[inline(always)]
    fn reaching<S: Simd>(&self, simd: S, keys: &[Key], reaching: &mut Vec<u32>) {
        reaching.clear();
        let log2_min_alpha = f64::from(self.limits.log2_min_alpha);
        for (group, keys) in keys.chunks(LANES).enumerate() {
            let (mut mean, mut largest, mut distance) = ([[0.0; LANES]; 3], [0.0; LANES], [0.0; LANES]);
            for l in 0..LANES {
                let index = keys[l.min(keys.len() - 1)].index;
                let row = index as usize;
                for (axis, mean) in mean.iter_mut().enumerate() {
                    mean[l] = f64::from(self.splats.means[row][axis]);
                }
                largest[l] = f64::from(self.splats.scales[row].abs().max_element());
                distance[l] = self.kernel.max_distance(index, self.max_distance, log2_min_alpha);
            }
            let (mean, [largest, distance]) = (Lanes::all(simd, mean), Lanes::all(simd, [largest, distance]));
            let ([x, y], radius) = self.view.bound(mean, largest, self.options.dilation, distance);
            let ([x, y], radius) = (Lanes::arrays([x, y]), radius.to_array());
            for l in 0..keys.len() {
                if self.open.intersect(self.grid, [x[l] as f32, y[l] as f32], radius[l] as f32) {
                    reaching.push((group * LANES + l) as u32);
                }
            }
        }
    }

    /// What tiles need of a splat; `None` if it reaches `min_alpha` nowhere.
    #[inline(always)]
    fn splat(&self, outline: &Outline, index: u32) -> Option<ProjectedSplat> {
        let log2_min_alpha = f64::from(self.limits.log2_min_alpha);
        let log2_opacity = (f64::from(self.splats.opacities[index as usize]) * outline.compensation).log2();
        let max_support = (self.options.box_sigmas * LOG2_SCALE).powi(2);
        let support = self.kernel.support(index, log2_opacity, log2_min_alpha).min(max_support);
        ProjectedSplat::new(outline, log2_opacity, support, index)
    }
}

/// Colour of the splat in row `index`, seen from the camera.
#[inline(always)]
fn color(splats: SplatsRef<'_>, view: &View, index: u32) -> [f32; 3] {
    let i = index as usize;
    match splats.color {
        Color::Rgb(rgb) => rgb[i],
        Color::Sh { degree, coeffs } => {
            let width = splats.color.width();
            sh_color(splats.means[i], view.position, *degree, &coeffs[i * width..][..width])
        }
    }
}

/// Projects the splats of a chunk, and lists for each open tile, in depth order, those that touch it. False if several splats
/// have more than `most` entries.
fn bin_chunk<K: KernelProfile>(
    scene: &Scene<K>,
    keys: &[Key],
    most: usize,
    bins: &mut Vec<Bin>,
    chunk: &mut Chunk,
) -> bool {
    let size = keys.len().div_ceil(MAX_BIN_TASKS).max(MIN_BIN_SPLATS);
    let count = keys.len().div_ceil(size);
    if bins.len() < count {
        bins.resize_with(count, Bin::default);
    }
    let bins = &mut bins[..count];
    chunk.projected.clear();
    chunk.projected.resize(keys.len(), ProjectedSplat::default());
    chunk.splat_starts.clear();
    chunk.splat_starts.resize(keys.len() + 1, 0);
    let work = (
        &mut *bins,
        keys.par_chunks(size),
        chunk.projected.par_chunks_mut(size),
        chunk.splat_starts[1..].par_chunks_mut(size),
    );
    let level = simd::level(scene.options.simd);
    let budget = Budget { most: if keys.len() > 1 { most } else { usize::MAX }, entries: AtomicUsize::new(0) };
    work.into_par_iter().for_each(|(bin, keys, projected, counts)| {
        dispatch!(level, simd => bin_block(simd, scene, keys, &budget, bin, projected, counts));
    });
    if !budget.holds(0) {
        return false;
    }
    assign_offsets(scene.grid.tiles(), bins, chunk);
    fill_lists(size, bins, chunk);
    true
}

/// Entries of a chunk, counted by all its tasks: whether there are too many does not depend on their order.
struct Budget {
    most: usize,
    entries: AtomicUsize,
}

/// Entries that a task counts for itself first.
const COUNTED_AT_ONCE: usize = 4096;

impl Budget {
    /// Adds entries; whether there are still not too many.
    fn holds(&self, more: usize) -> bool {
        self.entries.fetch_add(more, Ordering::Relaxed) + more <= self.most
    }
}

/// Projects a block of splats, lists the open tiles each touches, and evaluates the colour of those that touch any.
#[inline(always)]
fn bin_block<S: Simd, K: KernelProfile>(
    simd: S,
    scene: &Scene<K>,
    keys: &[Key],
    budget: &Budget,
    bin: &mut Bin,
    projected: &mut [ProjectedSplat],
    counts: &mut [u32],
) {
    let Bin { tiles, offsets, reaching } = bin;
    let mut counted = 0;
    tiles.clear();
    offsets.clear();
    offsets.resize(scene.grid.tiles(), 0);
    scene.reaching(simd, keys, reaching);
    for eight in reaching.chunks(LANES) {
        if tiles.len() - counted >= COUNTED_AT_ONCE {
            if !budget.holds(tiles.len() - counted) {
                return;
            }
            counted = tiles.len();
        }
        let mut rows = [0; LANES];
        for (l, row) in rows.iter_mut().enumerate() {
            *row = keys[eight[l.min(eight.len() - 1)] as usize].index as usize;
        }
        let footprint = project(scene.view, &SplatGeometry::gather(simd, scene.splats, &rows), scene.options);
        let outlines = footprint.outlines().into_iter().zip(footprint.valid());
        for (&at, (outline, valid)) in eight.iter().zip(outlines) {
            let (at, index) = (at as usize, keys[at as usize].index);
            let Some(splat) = valid.then(|| scene.splat(&outline, index)).flatten() else { continue };
            let before = tiles.len();
            scene.grid.for_each_tile(&splat, |tile| {
                if scene.open.is_open(tile) {
                    tiles.push(tile);
                    offsets[tile as usize] += 1;
                }
            });
            counts[at] = (tiles.len() - before) as u32;
            if counts[at] > 0 {
                projected[at] = ProjectedSplat { rgb: color(scene.splats, scene.view, index), ..splat };
            }
        }
    }
    budget.holds(tiles.len() - counted);
}

/// Turns counts into offsets by prefix sums: tile-major, within a tile in depth order.
fn assign_offsets(tiles: usize, bins: &mut [Bin], chunk: &mut Chunk) {
    let mut sum = 0;
    for c in &mut chunk.splat_starts {
        sum += *c;
        *c = sum;
    }
    chunk.tile_starts.clear();
    chunk.tile_starts.resize(tiles + 1, 0);
    for bin in bins.iter() {
        for (total, count) in chunk.tile_starts[1..].iter_mut().zip(&bin.offsets) {
            *total += count;
        }
    }
    let mut sum = 0;
    for c in &mut chunk.tile_starts {
        sum += *c;
        *c = sum;
    }
    let mut cursor = chunk.tile_starts.clone();
    for bin in bins {
        for (next, offset) in cursor.iter_mut().zip(&mut bin.offsets) {
            let count = *offset;
            *offset = *next;
            *next += count;
        }
    }
}

/// Writes the tile-major lists and the splat-major entries.
fn fill_lists(size: usize, bins: &mut [Bin], chunk: &mut Chunk) {
    let total: usize = bins.iter().map(|b| b.tiles.len()).sum();
    chunk.entries.resize(total, Entry::default());
    chunk.list.resize_with(total, AtomicU32::default);
    let mut rest = chunk.entries.as_mut_slice();
    let mut parts = Vec::with_capacity(bins.len());
    for bin in bins.iter() {
        let (part, tail) = rest.split_at_mut(bin.tiles.len());
        parts.push(part);
        rest = tail;
    }
    let (list, tile_starts) = (&chunk.list, &chunk.tile_starts);
    let work = (bins, parts, chunk.splat_starts.par_windows(2).chunks(size)).into_par_iter();
    work.enumerate().for_each(|(block, (bin, entries, spans))| {
        let base = spans.first().map_or(0, |s| s[0]);
        for (i, span) in spans.iter().enumerate() {
            let own = (span[0] - base) as usize..(span[1] - base) as usize;
            for (entry, &tile) in entries[own.clone()].iter_mut().zip(&bin.tiles[own]) {
                let offset = &mut bin.offsets[tile as usize];
                list[*offset as usize].store((block * size + i) as u32, Ordering::Relaxed);
                *entry = Entry { tile, chunk_slot: *offset - tile_starts[tile as usize] };
                *offset += 1;
            }
        }
    });
}

fn blend_chunk<K: KernelProfile>(
    kernel: K,
    level: Level,
    limits: Limits,
    grid: &Grid,
    chunk: &mut Chunk,
    tiles: &mut [TileState],
) {
    chunk.listed_before.clear();
    chunk.listed_before.extend(tiles.iter().map(|t| t.listed));
    let chunk = &*chunk;
    tiles.par_iter_mut().enumerate().for_each(|(tile, state)| {
        let list = chunk.tile_list(tile);
        if !list.is_empty() {
            let origin = grid.origin(tile);
            dispatch!(level, simd => blend(simd, kernel, &chunk.projected, list, origin, limits, state));
        }
    });
}

impl Chunk {
    /// The chunk's entries of one tile, front to back.
    pub(crate) fn tile_list(&self, tile: usize) -> &[AtomicU32] {
        &self.list[self.tile_starts[tile] as usize..self.tile_starts[tile + 1] as usize]
    }
}

/// Copies the tiles into the rows of the frame, over the background.
fn assemble(tiles: &[TileState], grid: &Grid, background: [f32; 3], frame: &mut Frame) {
    let n = grid.width * grid.height;
    (frame.rgb.width, frame.rgb.height, frame.rgb.channels) = (grid.width, grid.height, 3);
    frame.rgb.data.resize(3 * n, 0.0);
    frame.alpha.resize(n, 0.0);
    frame.depth.resize(n, 0.0);
    let band = grid.width * TILE;
    let bands =
        (frame.rgb.data.par_chunks_mut(3 * band), frame.alpha.par_chunks_mut(band), frame.depth.par_chunks_mut(band));
    bands.into_par_iter().enumerate().for_each(|(row, (rgb, alpha, depth))| {
        for column in 0..grid.columns {
            let tile = &tiles[row * grid.columns + column];
            for y in 0..alpha.len() / grid.width {
                let x0 = column * TILE;
                let width = TILE.min(grid.width - x0);
                let at = y * grid.width + x0;
                let row = &mut rgb[3 * at..3 * (at + width)];
                tile.row(y, row.as_chunks_mut().0, background, &mut alpha[at..at + width], &mut depth[at..at + width]);
            }
        }
    });
}

impl TileState {
    /// Writes row `y` of the tile, as many pixels as the slices hold.
    fn row(&self, y: usize, rgb: &mut [[f32; 3]], background: [f32; 3], alpha: &mut [f32], depth: &mut [f32]) {
        let [red, green, blue] = &self.rgb;
        for (x, ((rgb, alpha), depth)) in rgb.iter_mut().zip(alpha).zip(depth).enumerate() {
            let (block, lane) = (y / 4 * 4 + x / 4, y % 4 * 4 + x % 4);
            let t = self.transmittance[block][lane];
            *rgb = [
                red[block][lane] + t * background[0],
                green[block][lane] + t * background[1],
                blue[block][lane] + t * background[2],
            ];
            *alpha = 1.0 - t;
            *depth = self.depth[block][lane];
        }
    }
}
