//! A frame: depth order, then chunks of splats front to back, each binned to the tiles that are still open and blended.
//!
//! Chunks grow geometrically. A tile whose pixels are all opaque takes no further entries, so splats hidden behind it
//! cost neither binning nor colour; the picture is the same as with full lists, bit for bit.

use crate::blend::{Limits, blend};
use crate::frame::Frame;
use crate::kernel::{Bent, Falloff, Gaussian};
use crate::options::RasterOptions;
use crate::project::{Shape, View, project, sh_color};
use crate::simd;
use crate::sort::{Key, sort};
use crate::tiles::{Drawn, Grid, LOG2_SCALE, OpenTiles, TILE};
use crate::workspace::{Bin, Chunk, Entry, TileState, Workspace};
use fearless_simd::{Level, dispatch, prelude::*};
use gs_core::{Camera, Color, Splats};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

/// Splats handled by one task when depths are taken.
const KEY_BLOCK: usize = 4096;
/// The first chunk holds this share of the splats, each further one twice as many as the one before.
const FIRST_SHARE: usize = 24;
/// Smallest chunk.
const MIN_CHUNK: usize = 2048;
/// Tasks a chunk is binned by, at most.
const BINS: usize = 16;
/// Smallest number of splats a binning task takes.
const MIN_BIN: usize = 128;

/// Draws `splats` as `camera` sees them into `frame`, reusing its memory and `workspace`'s.
///
/// `splats` and `camera` must have passed their `check`; results are the same bits for any number of threads.
pub fn render_into(
    splats: &Splats,
    camera: &Camera,
    options: &RasterOptions,
    workspace: &mut Workspace,
    frame: &mut Frame,
) {
    if splats.kernel.is_neutral() {
        draw(Gaussian, splats, camera, options, workspace, frame);
    } else {
        let mut bends = std::mem::take(&mut workspace.bends);
        let kernel = Bent::new(&splats.kernel, splats.len(), options.kernel_cut, &mut bends);
        draw(kernel, splats, camera, options, workspace, frame);
        workspace.bends = bends;
    }
}

/// [`render_into`] with a fall-off of the caller's choice.
pub(crate) fn draw<K: Falloff>(
    kernel: K,
    splats: &Splats,
    camera: &Camera,
    options: &RasterOptions,
    w: &mut Workspace,
    frame: &mut Frame,
) {
    let view = View::new(camera);
    let grid = Grid::new(camera.width as usize, camera.height as usize);
    w.grid = grid;
    w.view = Some(view);
    reset_tiles(&mut w.tiles, &grid);
    take_keys(splats, &view, options, w);
    sort(&mut w.keys, &mut w.key_scratch, |i| view.depth(splats.means[i as usize]));
    draw_chunks(kernel, splats, options, w);
    assemble(&w.tiles, &grid, options.background, frame);
}

fn reset_tiles(tiles: &mut Vec<TileState>, grid: &Grid) {
    tiles.resize_with(grid.tiles(), TileState::default);
    tiles.par_iter_mut().enumerate().for_each(|(i, t)| t.reset(grid.origin(i), grid));
}

/// Depth keys of the splats that may be seen, in index order.
fn take_keys(splats: &Splats, view: &View, options: &RasterOptions, w: &mut Workspace) {
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

fn draw_chunks<K: Falloff>(kernel: K, splats: &Splats, options: &RasterOptions, w: &mut Workspace) {
    let level = simd::level(options.simd);
    let limits = Limits::new(options);
    let Some(view) = w.view else { return };
    w.open.update(&w.grid, w.tiles.iter().map(TileState::is_open));
    let widest = f64::from(-limits.log2_min_alpha).sqrt() / LOG2_SCALE;
    let mut first = 0;
    let mut size = MIN_CHUNK.max(w.keys.len() / FIRST_SHARE);
    w.chunk_count = 0;
    while first < w.keys.len() && w.open.any() {
        let end = w.keys.len().min(first + size);
        // A short rest is not worth a round of its own.
        let end = if w.keys.len() - end < size / 2 { w.keys.len() } else { end };
        if w.chunks.len() == w.chunk_count {
            w.chunks.push(Chunk::default());
        }
        let chunk = &mut w.chunks[w.chunk_count];
        w.chunk_count += 1;
        chunk.first = first;
        let scene = Scene { kernel, splats, options, view: &view, limits, grid: &w.grid, open: &w.open, widest };
        bin_chunk(&scene, &w.keys[first..end], &mut w.bins, chunk);
        blend_chunk(kernel, level, limits, &w.grid, chunk, &mut w.tiles);
        w.open.update(&w.grid, w.tiles.iter().map(TileState::is_open));
        first = end;
        size *= 2;
    }
}

/// What binning reads.
struct Scene<'a, K> {
    kernel: K,
    splats: &'a Splats,
    options: &'a RasterOptions,
    view: &'a View,
    limits: Limits,
    grid: &'a Grid,
    open: &'a OpenTiles,
    /// Largest Mahalanobis distance at which an opaque Gaussian is visible.
    widest: f64,
}

impl<K: Falloff> Scene<'_, K> {
    /// Projects one splat; `None` if no pixel can see it.
    #[inline(always)]
    fn drawn(&self, index: u32) -> Option<Drawn> {
        let (s, i) = (self.splats, index as usize);
        let shape = Shape { mean: s.means[i], quat: s.quats[i], scale: s.scales[i] };
        let log2_min_alpha = f64::from(self.limits.log2_min_alpha);
        let widest = self.kernel.widest(index, self.widest, log2_min_alpha);
        let (center, radius) = self.view.bound(&shape, self.options.dilation, widest);
        if !self.open.meets(self.grid, center, radius) {
            return None;
        }
        let footprint = project(self.view, &shape, self.options)?;
        let log2_opacity = (f64::from(s.opacities[i]) * footprint.compensation).log2();
        let most = (self.options.box_sigmas * LOG2_SCALE).powi(2);
        let support = self.kernel.support(index, log2_opacity, log2_min_alpha).min(most);
        Drawn::new(&footprint, log2_opacity, support, footprint.depth(), index)
    }

    #[inline(always)]
    fn color(&self, index: u32) -> [f32; 3] {
        let i = index as usize;
        match &self.splats.color {
            Color::Rgb(rgb) => rgb[i],
            Color::Sh { degree, coeffs } => {
                let width = self.splats.color.width();
                sh_color(self.splats.means[i], self.view.position, *degree, &coeffs[i * width..][..width])
            }
        }
    }
}

/// Projects the splats of a chunk and lists, tile by tile in depth order, which open tiles they touch.
fn bin_chunk<K: Falloff>(scene: &Scene<K>, keys: &[Key], bins: &mut Vec<Bin>, chunk: &mut Chunk) {
    let size = keys.len().div_ceil(BINS).max(MIN_BIN);
    let count = keys.len().div_ceil(size);
    if bins.len() < count {
        bins.resize_with(count, Bin::default);
    }
    let bins = &mut bins[..count];
    chunk.drawn.clear();
    chunk.drawn.resize(keys.len(), Drawn::default());
    chunk.splat_starts.clear();
    chunk.splat_starts.resize(keys.len() + 1, 0);
    let work = (
        &mut *bins,
        keys.par_chunks(size),
        chunk.drawn.par_chunks_mut(size),
        chunk.splat_starts[1..].par_chunks_mut(size),
    );
    let level = simd::level(scene.options.simd);
    work.into_par_iter().for_each(|(bin, keys, drawn, counts)| {
        dispatch!(level, simd => bin_block(simd, scene, keys, bin, drawn, counts));
    });
    place(scene.grid.tiles(), bins, chunk);
    fill_lists(size, bins, chunk);
}

/// Projects a block of splats, colours those that some open tile may see, and lists the tiles of each.
#[inline(always)]
fn bin_block<S: Simd, K: Falloff>(
    _: S,
    scene: &Scene<K>,
    keys: &[Key],
    bin: &mut Bin,
    drawn: &mut [Drawn],
    counts: &mut [u32],
) {
    bin.tiles.clear();
    bin.places.clear();
    bin.places.resize(scene.grid.tiles(), 0);
    for ((key, drawn), count) in keys.iter().zip(drawn).zip(counts) {
        let Some(splat) = scene.drawn(key.index) else { continue };
        let before = bin.tiles.len();
        scene.grid.touched(&splat, |tile| {
            if scene.open.is_open(tile) {
                bin.tiles.push(tile);
                bin.places[tile as usize] += 1;
            }
        });
        *count = (bin.tiles.len() - before) as u32;
        if *count > 0 {
            *drawn = Drawn { rgb: scene.color(key.index), ..splat };
        }
    }
}

/// Turns counts into places: tile-major, within a tile in depth order.
fn place(tiles: usize, bins: &mut [Bin], chunk: &mut Chunk) {
    let mut sum = 0;
    for c in &mut chunk.splat_starts {
        sum += *c;
        *c = sum;
    }
    chunk.tile_starts.clear();
    chunk.tile_starts.resize(tiles + 1, 0);
    for bin in bins.iter() {
        for (total, count) in chunk.tile_starts[1..].iter_mut().zip(&bin.places) {
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
        for (next, place) in cursor.iter_mut().zip(&mut bin.places) {
            let count = *place;
            *place = *next;
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
                let place = &mut bin.places[tile as usize];
                list[*place as usize].store((block * size + i) as u32, Ordering::Relaxed);
                *entry = Entry { tile, number: *place - tile_starts[tile as usize] };
                *place += 1;
            }
        }
    });
}

fn blend_chunk<K: Falloff>(
    kernel: K,
    level: Level,
    limits: Limits,
    grid: &Grid,
    chunk: &mut Chunk,
    tiles: &mut [TileState],
) {
    chunk.seen_before.clear();
    chunk.seen_before.extend(tiles.iter().map(|t| t.seen));
    let chunk = &*chunk;
    tiles.par_iter_mut().enumerate().for_each(|(tile, state)| {
        let list = chunk.tile_list(tile);
        if !list.is_empty() {
            let origin = grid.origin(tile);
            dispatch!(level, simd => blend(simd, kernel, &chunk.drawn, list, origin, limits, state));
        }
    });
}

impl Chunk {
    /// The chunk's entries of one tile, front to back.
    pub(crate) fn tile_list(&self, tile: usize) -> &[AtomicU32] {
        &self.list[self.tile_starts[tile] as usize..self.tile_starts[tile + 1] as usize]
    }
}

/// Tiles to rows of pixels.
fn assemble(tiles: &[TileState], grid: &Grid, background: [f32; 3], frame: &mut Frame) {
    let n = grid.width * grid.height;
    (frame.width, frame.height) = (grid.width, grid.height);
    frame.rgb.resize(3 * n, 0.0);
    frame.alpha.resize(n, 0.0);
    frame.depth.resize(n, 0.0);
    let band = grid.width * TILE;
    let bands =
        (frame.rgb.par_chunks_mut(3 * band), frame.alpha.par_chunks_mut(band), frame.depth.par_chunks_mut(band));
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
