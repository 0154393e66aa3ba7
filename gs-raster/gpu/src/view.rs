//! The uniform of a frame: camera, options and sizes as `shaders/view.wgsl` lays them out.

use crate::resident::Shape;
use bytemuck::{Pod, Zeroable};
use gs_core::{Camera, SplatsRef};
use gs_raster::{ClampGrad, RasterOptions, tiles};

/// Side of a tile, pixels.
const TILE: u32 = tiles::TILE as u32;
/// `√(½ log₂ e)` squared: from squared Mahalanobis distances to the blend's `a² + b²`.
const LOG2_SCALE_SQUARED: f64 = 0.5 * std::f64::consts::LOG2_E;
/// The projection Jacobian clamps `x/z` this fraction of half the image beyond its border (INRIA's 1.3 tan).
const FRUSTUM_MARGIN: f64 = 0.3;
/// Stands for infinity: WGSL has no infinite numbers.
const ENDLESS: f64 = 1e30;

/// Uniform of every kernel; see `shaders/view.wgsl`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct View {
    rotation_h: [[f32; 4]; 3],
    rotation_l: [[f32; 4]; 3],
    focal: [f32; 4],
    center: [f32; 4],
    limits_h: [f32; 4],
    limits_l: [f32; 4],
    position_h: [f32; 4],
    position_l: [f32; 4],
    background: [f32; 4],
    thresholds: [f32; 4],
    range: [f32; 4],
    limits: [f32; 4],
    sizes: [u32; 4],
    counts: [u32; 4],
    flags: [u32; 4],
    zero: [u32; 4],
}

/// A number as a high and a low part.
fn split(v: f64) -> (f32, f32) {
    let high = v as f32;
    (high, (v - f64::from(high)) as f32)
}

fn split4(v: [f64; 4]) -> ([f32; 4], [f32; 4]) {
    (v.map(|v| split(v).0), v.map(|v| split(v).1))
}

/// The smallest `f32` at or above `v`.
fn round_up(v: f64) -> f32 {
    let near = v as f32;
    if f64::from(near) < v { near.next_up() } else { near }
}

impl View {
    /// Of a frame of splats of this shape from `camera`. `entries` is the number of entries that fit.
    pub(crate) fn new(shape: Shape, camera: &Camera, options: &RasterOptions, entries: u32) -> Self {
        let rows = camera.rotation.transpose().to_cols_array_2d();
        let t = camera.translation.to_array();
        let with_t = |r: usize| split4([rows[r][0], rows[r][1], rows[r][2], t[r]]);
        let pair = |a: f64, b: f64| [split(a).0, split(b).0, split(a).1, split(b).1];
        let (limits_h, limits_l) = split4(jacobian_limits(camera));
        let p = camera.position();
        let (position_h, position_l) = split4([p.x, p.y, p.z, 0.0]);
        let (min_alpha, stop) = (options.min_alpha, options.stop.max(RasterOptions::MIN_STOP));
        let support = (options.box_sigmas.powi(2) * LOG2_SCALE_SQUARED).min(ENDLESS);
        let [r, g, b] = options.background;
        Self {
            rotation_h: [0, 1, 2].map(|r| with_t(r).0),
            rotation_l: [0, 1, 2].map(|r| with_t(r).1),
            focal: pair(camera.fx, camera.fy),
            center: pair(camera.cx, camera.cy),
            limits_h,
            limits_l,
            position_h,
            position_l,
            background: [r, g, b, 0.0],
            thresholds: [min_alpha, min_alpha.log2(), options.max_alpha, stop].map(|v| v as f32),
            range: [options.near, options.far.min(ENDLESS), options.dilation, support].map(|v| v as f32),
            limits: [round_up(min_alpha), 0.0, 0.0, 0.0],
            sizes: [camera.width, camera.height, camera.width.div_ceil(TILE), camera.height.div_ceil(TILE)],
            counts: [shape.splats, entries, shape.sh_degree.map_or(0, u32::from), 0],
            flags: [
                u32::from(options.antialias),
                u32::from(options.clamp_grad == ClampGrad::PassThrough),
                u32::from(shape.sh_degree.is_some()),
                0,
            ],
            zero: [0; 4],
        }
    }

    /// The same view for the run of the listing kernel that writes.
    pub(crate) fn writing(mut self) -> Self {
        self.flags[3] = 1;
        self
    }

    /// Number of splats.
    pub(crate) fn splats(&self) -> u32 {
        self.counts[0]
    }

    /// Number of entries that fit.
    pub(crate) fn entries(&self) -> u32 {
        self.counts[1]
    }

    /// Columns and rows of tiles.
    pub(crate) fn tiles(&self) -> [u32; 2] {
        [self.sizes[2], self.sizes[3]]
    }

    /// Width and height, pixels.
    pub(crate) fn size(&self) -> [u32; 2] {
        [self.sizes[0], self.sizes[1]]
    }

    /// The same view of a frame that has so many entries.
    pub(crate) fn holding(mut self, entries: u32) -> Self {
        self.counts[1] = entries;
        self
    }

    /// Whether the splats and the image have the same shape as those of another frame.
    pub(crate) fn same_shape(&self, other: &Self) -> bool {
        let shape = |v: &Self| (v.sizes, v.counts[0], v.counts[2], v.flags[2]);
        shape(self) == shape(other)
    }
}

/// Bounds of `x/z` and of `y/z` in the Jacobian: low and high of x, then of y.
fn jacobian_limits(camera: &Camera) -> [f64; 4] {
    let limit = |side: u32, f: f64, c: f64| {
        let margin = FRUSTUM_MARGIN * 0.5 * f64::from(side) / f;
        [-(c / f + margin), (f64::from(side) - c) / f + margin]
    };
    let ([a, b], [c, d]) = (limit(camera.width, camera.fx, camera.cx), limit(camera.height, camera.fy, camera.cy));
    [a, b, c, d]
}

/// Constants of the kernel profiles, one row each, as `shaders/profile.wgsl` takes them.
pub(crate) fn profiles(splats: SplatsRef<'_>, options: &RasterOptions) -> Vec<[f32; 4]> {
    let cut = (options.kernel_cut * LOG2_SCALE_SQUARED).min(ENDLESS) as f32;
    let row = |i| {
        let Some(p) = splats.kernel.bend(i) else { return [0.0; 4] };
        let kappa = if p.is_clamped() { -1.0 } else { p.kappa };
        let cut = if p.is_unbounded() { cut } else { ENDLESS as f32 };
        [p.u as f32, kappa as f32, p.foot as f32, cut]
    };
    (0..splats.len()).map(row).collect()
}
