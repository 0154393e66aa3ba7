//! Backward of a frame: tiles to records, records to splats, splats to parameters.
//!
//! Tiles run in parallel and write the records of their own entries. Then each splat adds its records in ascending tile
//! order, followed by the backward of projection and colour. Nothing depends on the number of threads.

use crate::blend_backward::{TileBackward, TileSpan, blend_backward};
use crate::camera_grad::{CameraGrad, CameraSum};
use crate::frame::{FrameGrad, ScreenStats};
use crate::kernel::{Gaussian, KernelProfile, PiecewiseLinear};
use crate::lanes::{LANES, Lanes};
use crate::options::{Limits, RasterOptions};
use crate::project::{self, PixelSums, SplatGeometry, View, sh_color_backward};
use crate::simd;
use crate::tiles::{Grid, TILE};
use crate::workspace::{BLOCKS, Plane, RECORD, Record, Workspace, pixel_of};
use fearless_simd::{dispatch, prelude::*};
use glam::Vec3;
use gs_core::{Camera, Color, Kernel, SplatsGrad, SplatsRef};
use rayon::prelude::*;

/// Splats per task of the second pass.
const SPLAT_BLOCK: usize = 512;

/// Gradient of the loss whose cotangents are `d` with respect to every column of `splats`, written to `grad` (same
/// layout) and `stats`; both are resized and overwritten.
///
/// Must follow [`crate::render_into`] of the same splats, camera and options with the same workspace, which keeps what that call
/// projected and sorted: after another one the result is wrong, or it panics. `d` must be
/// finite. The result is the same bits for any number of threads.
///
/// ```
/// use gs_core::SplatsGrad;
/// use gs_raster::{Frame, FrameGrad, RasterOptions, ScreenStats, Workspace, measure};
///
/// let (splats, camera, options) = (measure::scene(100, 0), measure::camera(32), RasterOptions::default());
/// let (mut workspace, mut frame) = (Workspace::new(), Frame::default());
/// gs_raster::render_into(&splats, &camera, &options, &mut workspace, &mut frame);
/// let d = FrameGrad { alpha: vec![1.0; frame.alpha.len()], ..FrameGrad::default() };
/// let (mut grad, mut stats) = (SplatsGrad::default(), ScreenStats::default());
/// gs_raster::render_backward_into(&splats, &camera, &options, &mut workspace, &d, &mut grad, &mut stats);
/// assert!(grad.opacities.iter().all(|&g| g >= 0.0)); // more opacity, more alpha
/// assert!(stats.radii.iter().zip(&grad.opacities).all(|(&r, &g)| r > 0.0 || g == 0.0));
/// ```
pub fn render_backward_into<'a>(
    splats: impl Into<SplatsRef<'a>>,
    camera: &Camera,
    options: &RasterOptions,
    workspace: &mut Workspace,
    d: &FrameGrad,
    grad: &mut SplatsGrad,
    stats: &mut ScreenStats,
) {
    backward(splats.into(), camera, options, workspace, d, (grad, stats), None);
}

/// [`render_backward_into`], and the gradient with respect to the camera's pose and intrinsics. `grad` and `stats` get the
/// same bits.
///
/// ```
/// use gs_core::SplatsGrad;
/// use gs_raster::{FrameGrad, RasterOptions, ScreenStats, Workspace, measure, render, render_backward_with_camera};
///
/// let (splats, camera, options) = (measure::scene(100, 0), measure::camera(32), RasterOptions::default());
/// let mut workspace = Workspace::new();
/// let frame = render(&splats, &camera, &options, &mut workspace);
/// let d = FrameGrad { alpha: vec![1.0; frame.alpha.len()], ..FrameGrad::default() };
/// let (mut grad, mut stats) = (SplatsGrad::default(), ScreenStats::default());
/// let camera_grad =
///     render_backward_with_camera(&splats, &camera, &options, &mut workspace, &d, &mut grad, &mut stats);
/// // Where colours do not depend on the view, a shift of the camera's T acts as the same shift of every splat.
/// let [.., back] = camera_grad.twist(&camera);
/// let splats_back: f64 = grad.means.iter().map(|d| camera.forward().dot(d.as_dvec3())).sum();
/// assert!(back < 0.0 && (splats_back / back - 1.0).abs() < 1e-4); // farther away, less alpha
/// ```
pub fn render_backward_with_camera<'a>(
    splats: impl Into<SplatsRef<'a>>,
    camera: &Camera,
    options: &RasterOptions,
    workspace: &mut Workspace,
    d: &FrameGrad,
    grad: &mut SplatsGrad,
    stats: &mut ScreenStats,
) -> CameraGrad {
    let mut camera_grad = CameraGrad::default();
    backward(splats.into(), camera, options, workspace, d, (grad, stats), Some(&mut camera_grad));
    camera_grad
}

/// The gradient of the camera where it is asked for. Not generic, as those that call it are: it is compiled here, and not in every crate
/// that calls them.
fn backward(
    splats: SplatsRef<'_>,
    camera: &Camera,
    options: &RasterOptions,
    w: &mut Workspace,
    d: &FrameGrad,
    (grad, stats): (&mut SplatsGrad, &mut ScreenStats),
    camera_grad: Option<&mut CameraGrad>,
) {
    debug_assert_eq!((w.grid.width, w.grid.height), (camera.width as usize, camera.height as usize));
    allocate_records(w);
    let depth = !d.depth.is_empty();
    match splats.kernel {
        Kernel::Gaussian if depth => tiles_backward::<_, true>(Gaussian, options, d, w),
        Kernel::Gaussian => tiles_backward::<_, false>(Gaussian, options, d, w),
        kernel => {
            let mut kernel_consts = std::mem::take(&mut w.kernel_consts);
            let profile = PiecewiseLinear::new(kernel, splats.len(), options.kernel_cut, &mut kernel_consts);
            match depth {
                true => tiles_backward::<_, true>(profile, options, d, w),
                false => tiles_backward::<_, false>(profile, options, d, w),
            }
            w.kernel_consts = kernel_consts;
        }
    }
    assign_ranks(splats.len(), w);
    match camera_grad {
        None => splats_backward::<()>(splats, options, w, grad, stats),
        Some(sum) => *sum = splats_backward(splats, options, w, grad, stats),
    }
}

/// Allocates one record for each entry up to the last one that some pixel of its tile blended.
fn allocate_records(w: &mut Workspace) {
    w.record_starts.clear();
    w.record_starts.push(0);
    let mut sum = 0;
    for tile in &w.tiles {
        sum += tile.used();
        w.record_starts.push(sum);
    }
    w.records.resize(sum as usize, Record::default());
}

fn tiles_backward<K: KernelProfile, const DEPTH: bool>(
    kernel: K,
    options: &RasterOptions,
    d: &FrameGrad,
    w: &mut Workspace,
) {
    let level = simd::level(options.simd);
    let limits = Limits::new(options);
    let chunks = &w.chunks[..w.chunk_count];
    let mut rest = w.records.as_mut_slice();
    let mut parts = Vec::with_capacity(w.tiles.len());
    for span in w.record_starts.windows(2) {
        let (part, tail) = rest.split_at_mut((span[1] - span[0]) as usize);
        parts.push(part);
        rest = tail;
    }
    let grid = &w.grid;
    (&w.tiles, parts).into_par_iter().enumerate().for_each(|(tile, (state, records))| {
        if records.is_empty() {
            return;
        }
        let origin = grid.origin(tile);
        let plane = |values: &[f32], channels: usize, c: usize| tile_plane(grid, origin, values, channels, c);
        let d_rgb = [0, 1, 2].map(|c| plane(&d.rgb, 3, c));
        let (d_alpha, d_depth) = (plane(&d.alpha, 1, 0), plane(&d.depth, 1, 0));
        let mut back = TileBackward::new(state, d_rgb, &d_alpha, d_depth, options.background);
        for chunk in chunks.iter().rev() {
            let first_slot = chunk.listed_before[tile];
            let span = TileSpan { projected: &chunk.projected, list: chunk.tile_list(tile), first_slot };
            dispatch!(level, simd => blend_backward::<_, K, DEPTH>(simd, kernel, span, origin, limits, &mut back, records));
        }
    });
}

/// One channel of an image, cropped to a tile; zero outside the image, and everywhere if `values` is empty.
fn tile_plane(grid: &Grid, origin: [usize; 2], values: &[f32], channels: usize, channel: usize) -> Plane<f32> {
    let mut plane = [[0.0; 16]; BLOCKS];
    if values.is_empty() {
        return plane;
    }
    let (width, height) = (TILE.min(grid.width - origin[0]), TILE.min(grid.height - origin[1]));
    for (block, row) in plane.iter_mut().enumerate() {
        for (lane, value) in row.iter_mut().enumerate() {
            let [x, y] = pixel_of(block, lane);
            if x < width && y < height {
                *value = values[((origin[1] + y) * grid.width + origin[0] + x) * channels + channel];
            }
        }
    }
    plane
}

/// Depth ranks of the splats that lie in some tile.
fn assign_ranks(n: usize, w: &mut Workspace) {
    w.rank_of.clear();
    w.rank_of.resize(n, u32::MAX);
    for chunk in &w.chunks[..w.chunk_count] {
        for (i, span) in chunk.splat_starts.windows(2).enumerate() {
            if span[1] > span[0] {
                w.rank_of[chunk.projected[i].index as usize] = (chunk.first + i) as u32;
            }
        }
    }
}

fn splats_backward<C: CameraSum>(
    splats: SplatsRef<'_>,
    options: &RasterOptions,
    w: &Workspace,
    grad: &mut SplatsGrad,
    stats: &mut ScreenStats,
) -> C {
    let Some(view) = &w.view else { return C::default() };
    grad.reset(splats);
    let n = splats.len();
    stats.grad_means2d.clear();
    stats.grad_means2d.resize(n, [0.0; 2]);
    stats.radii.clear();
    stats.radii.resize(n, 0.0);
    let width = splats.color.width();
    let b = SPLAT_BLOCK;
    // A kernel without parameters has no column to split.
    let kernel_rows: Vec<&mut [f32]> = match splats.kernel.width() {
        0 => (0..n.div_ceil(b)).map(|_| &mut [][..]).collect(),
        width => grad.kernel.chunks_mut(b * width).collect(),
    };
    let columns = (
        grad.means.par_chunks_mut(b),
        grad.quats.par_chunks_mut(b),
        grad.scales.par_chunks_mut(b),
        grad.opacities.par_chunks_mut(b),
        grad.color.par_chunks_mut(b * width),
        kernel_rows,
        stats.grad_means2d.par_chunks_mut(b),
        stats.radii.par_chunks_mut(b),
    );
    let level = simd::level(options.simd);
    let blocks = columns.into_par_iter().enumerate().map(
        |(block, (means, quats, scales, opacities, color, kernel, means2d, radii))| {
            let rows = RowsOut { first: block * b, means, quats, scales, opacities, color, kernel, means2d, radii };
            dispatch!(level, simd => block_backward(simd, splats, options, w, view, rows))
        },
    );
    let blocks: Vec<C> = blocks.collect();
    blocks.into_iter().fold(C::default(), |mut sum, block| {
        sum.add(block);
        sum
    })
}

/// Output rows of one block of splats.
struct RowsOut<'a> {
    first: usize,
    means: &'a mut [Vec3],
    quats: &'a mut [[f32; 4]],
    scales: &'a mut [Vec3],
    opacities: &'a mut [f32],
    color: &'a mut [f32],
    kernel: &'a mut [f32],
    means2d: &'a mut [[f32; 2]],
    radii: &'a mut [f32],
}

#[inline(always)]
fn block_backward<S: Simd, C: CameraSum>(
    simd: S,
    splats: SplatsRef<'_>,
    options: &RasterOptions,
    w: &Workspace,
    view: &View,
    out: RowsOut,
) -> C {
    let mut camera = C::default();
    let (width, kernel_width) = (splats.color.width(), splats.kernel.width());
    let listed = (out.first..out.first + out.means.len()).filter(|&i| w.rank_of[i] != u32::MAX);
    let listed: Vec<usize> = listed.collect();
    for eight in listed.chunks(LANES) {
        let (mut rows, mut opacity) = ([0; LANES], [0.0; LANES]);
        let (mut records, mut columns) = ([[0.0; RECORD]; LANES], [[0.0; LANES]; RECORD]);
        for l in 0..LANES {
            rows[l] = eight[l.min(eight.len() - 1)];
            opacity[l] = f64::from(splats.opacities[rows[l]]);
            records[l] = sum_records(w, w.rank_of[rows[l]]);
            for k in 0..RECORD {
                columns[k][l] = records[l][k];
            }
        }
        let geometry = SplatGeometry::gather(simd, splats, &rows);
        let footprint = project::project(view, &geometry, options);
        let (opacity, sums) = (Lanes::load(simd, opacity), PixelSums::new(Lanes::all(simd, columns)));
        let g = project::backward(view, &geometry, &footprint, opacity, &sums, options);
        let (mean, quat, scale) = (Lanes::arrays(g.mean), Lanes::arrays(g.quat), Lanes::arrays(g.scale));
        let ([u, v], opacity) = (Lanes::arrays(g.mean2d), g.opacity.to_array());
        let radius = footprint.radius().to_array();
        let valid = footprint.valid();
        let mut d_view = [Vec3::ZERO; LANES];
        for (l, &i) in eight.iter().enumerate().filter(|(l, _)| valid[*l]) {
            let (k, sums) = (i - out.first, PixelSums::new(records[l]));
            d_view[l] = color_backward(splats, view, i, &sums, &mut out.color[k * width..][..width]);
            splats.kernel.vjp(i, sums.kernel, &mut out.kernel[k * kernel_width..][..kernel_width]);
            for axis in 0..3 {
                out.means[k][axis] = mean[axis][l] as f32 + d_view[l][axis];
                out.scales[k][axis] = scale[axis][l] as f32;
            }
            for (to, from) in out.quats[k].iter_mut().zip(&quat) {
                *to = from[l] as f32;
            }
            out.opacities[k] = opacity[l] as f32;
            out.means2d[k] = [u[l] as f32, v[l] as f32];
            out.radii[k] = radius[l] as f32;
        }
        camera.add_splats(view, &geometry, &footprint, &g, &d_view[..eight.len()], valid);
    }
    camera
}

/// Sums of the records of the splat of a rank, in ascending tile order.
#[inline(always)]
fn sum_records(w: &Workspace, rank: u32) -> [f64; RECORD] {
    let chunks = &w.chunks[..w.chunk_count];
    let chunk = &chunks[chunks.partition_point(|c| c.first <= rank as usize) - 1];
    let at = rank as usize - chunk.first;
    let span = chunk.splat_starts[at] as usize..chunk.splat_starts[at + 1] as usize;
    let mut sum = [0.0f64; RECORD];
    for entry in &chunk.entries[span] {
        let tile = entry.tile as usize;
        let slot = chunk.listed_before[tile] + entry.chunk_slot;
        let start = w.record_starts[tile];
        if start + slot < w.record_starts[tile + 1] {
            for (to, from) in sum.iter_mut().zip(&w.records[(start + slot) as usize]) {
                *to += f64::from(*from);
            }
        }
    }
    sum
}

/// Writes the cotangents of the colour row; returns that of the mean through the view direction.
#[inline(always)]
fn color_backward(splats: SplatsRef<'_>, view: &View, i: usize, sums: &PixelSums<f64>, d_row: &mut [f32]) -> Vec3 {
    let d_rgb = [sums.rgb[0] as f32, sums.rgb[1] as f32, sums.rgb[2] as f32];
    match splats.color {
        Color::Rgb(_) => {
            d_row.copy_from_slice(&d_rgb);
            Vec3::ZERO
        }
        Color::Sh { degree, coeffs } => {
            let row = &coeffs[i * d_row.len()..][..d_row.len()];
            Vec3::from_array(sh_color_backward(splats.means[i], view.position, *degree, row, d_rgb, d_row))
        }
    }
}
