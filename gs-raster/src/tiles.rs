//! Which 16×16 tiles a splat touches: its screen ellipse against rows of tiles, in closed form.
//!
//! In whitened coordinates the visible region is the disc `a² + b² ≤ r²`. A horizontal strip is an interval of `b`
//! (`b` depends on `y` only), and with `k = w₁/w₂` the pixel column is `x = u_x + (a − k b)/w₀`. Over the strip the
//! rightmost point has `b = clamp(−k r/√(1+k²))` and `a = √(r² − b²)`, the leftmost the mirror image: one square root
//! per side. The interval is widened by a bound on its rounding error, so a list may hold a few entries too many but
//! misses none; each pixel applies the alpha threshold itself.

use crate::project::{Outline, standard_radius};

/// Side of a tile, pixels.
pub const TILE: usize = 16;
/// Side of a block, pixels: one SIMD vector is a 4×4 block.
pub(crate) const BLOCK: usize = 4;
/// `√(½ log₂ e)`: scales whitened coordinates so that `log₂ g = −(a² + b²)`.
pub(crate) const LOG2_SCALE: f64 = 0.849_321_800_288_019_1;
/// Relative widening of the support against rounding.
const SLACK: f32 = 4e-6;
/// Absolute widening of intervals, pixels.
const MARGIN: f32 = 5e-3;

/// A splat after projection: what tiles need of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ProjectedSplat {
    /// Projected mean, pixels.
    pub center: [f64; 2],
    /// Whitening `w₀, w₁, w₂` scaled by [`LOG2_SCALE`] (see [`crate::project`]).
    pub whitening: [f64; 3],
    /// `log₂ o'`, the opacity after anti-aliasing compensation.
    pub log2_opacity: f32,
    /// `r²`: largest visible `a² + b²`.
    pub support: f32,
    /// `r`: square root of the support.
    pub radius: f32,
    /// `k r/√(1+k²)`: `−b` of the rightmost and `b` of the leftmost point.
    pub extreme: f32,
    /// `k = w₁/w₂`: shear of the whitening.
    pub slope: f32,
    /// `1/w₀`: pixel columns per unit of `a`.
    pub inv_w0: f32,
    /// Colour seen from this camera.
    pub rgb: [f32; 3],
    /// Camera depth, world units.
    pub depth: f32,
    /// Row in the caller's columns.
    pub index: u32,
}

impl ProjectedSplat {
    /// From an outline and the support `a² + b²`; `None` if that is negative, so that no pixel reaches `min_alpha`.
    #[inline(always)]
    pub(crate) fn new(outline: &Outline, log2_opacity: f64, support: f64, index: u32) -> Option<Self> {
        if support < 0.0 {
            return None;
        }
        let [w0, w1, w2] = outline.whitening;
        let slope = (w1 / w2) as f32;
        let support = (support * 1.000_01 + 1e-4) as f32;
        let radius = support.sqrt();
        Some(Self {
            center: outline.center,
            whitening: [w0 * LOG2_SCALE, w1 * LOG2_SCALE, w2 * LOG2_SCALE],
            log2_opacity: log2_opacity as f32,
            support,
            radius,
            extreme: slope / (1.0 + slope * slope).sqrt() * radius,
            slope,
            inv_w0: (1.0 / (w0 * LOG2_SCALE)) as f32,
            rgb: [0.0; 3],
            depth: outline.depth as f32,
            index,
        })
    }

    /// Three standard deviations along the larger axis, pixels: of the covariance `W⁻¹ W⁻ᵀ`.
    pub(crate) fn standard_radius(&self) -> f64 {
        let [w0, w1, w2] = self.whitening.map(|w| w / LOG2_SCALE);
        let (a, b, c) = (1.0 / w0, -w1 / (w0 * w2), 1.0 / w2);
        standard_radius([a * a + b * b, b * c, c * c])
    }

    /// The visible disc relative to `origin` (pixels).
    #[inline(always)]
    pub(crate) fn ellipse(&self, origin: [f64; 2]) -> Ellipse {
        let [w0, w1, w2] = self.whitening;
        let (ox, oy) = (origin[0] - self.center[0], origin[1] - self.center[1]);
        let b0 = (w2 * oy) as f32;
        let reach = self.slope.abs() * (b0.abs() + self.radius) + self.radius + (w0 * ox + w1 * oy).abs() as f32;
        Ellipse {
            b0,
            step: w2 as f32,
            radius: self.radius,
            support: self.support,
            extreme: self.extreme,
            slope: self.slope,
            inv_w0: self.inv_w0,
            shift: -ox as f32,
            margin: MARGIN + SLACK * reach * self.inv_w0,
        }
    }
}

/// A splat's visible disc relative to a fixed origin; gives intervals of pixel columns for strips of rows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ellipse {
    /// `b` at the origin's row.
    pub b0: f32,
    /// Increase of `b` per pixel row.
    pub step: f32,
    /// Radius `r` of the disc.
    pub radius: f32,
    /// `r²`, rounded on its own.
    pub support: f32,
    /// `|b|` of the leftmost and rightmost points, signed by the slope.
    pub extreme: f32,
    /// `k = w₁/w₂`: shear of the whitening.
    pub slope: f32,
    /// `1/w₀`: pixel columns per unit of `a`.
    pub inv_w0: f32,
    /// Column of the centre relative to the origin.
    pub shift: f32,
    /// Widening of column intervals against rounding, pixels.
    pub margin: f32,
}

impl Ellipse {
    /// Columns `[left, right]` the disc covers between rows `y0` and `y1` (relative to the origin), or `None`.
    #[inline(always)]
    pub(crate) fn columns(&self, y0: f32, y1: f32) -> Option<[f32; 2]> {
        let slack = self.slack();
        let lo = (self.b0 + self.step * y0 - slack).max(-self.radius);
        let hi = (self.b0 + self.step * y1 + slack).min(self.radius);
        if lo > hi {
            return None;
        }
        let right = (-self.extreme).clamp(lo, hi);
        let left = self.extreme.clamp(lo, hi);
        let half = |b: f32| (self.support - b * b).max(0.0).sqrt();
        Some([
            self.shift + (-half(left) - self.slope * left) * self.inv_w0 - self.margin,
            self.shift + (half(right) - self.slope * right) * self.inv_w0 + self.margin,
        ])
    }

    /// Rows `[top, bottom]` the disc covers, relative to the origin.
    #[inline(always)]
    pub(crate) fn rows(&self) -> [f32; 2] {
        let inv = 1.0 / self.step;
        let slack = self.slack() * inv;
        [(-self.radius - self.b0) * inv - slack, (self.radius - self.b0) * inv + slack]
    }

    /// Widening of an interval of `b` against rounding.
    #[inline(always)]
    pub(crate) fn slack(&self) -> f32 {
        SLACK * (self.b0.abs() + self.radius) + MARGIN * self.step
    }
}

/// The grid of tiles over an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Grid {
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Number of tiles per row.
    pub columns: usize,
    /// Number of rows of tiles.
    pub rows: usize,
}

impl Grid {
    /// The grid of an image of `width × height` pixels.
    pub(crate) fn new(width: usize, height: usize) -> Self {
        Self { width, height, columns: width.div_ceil(TILE), rows: height.div_ceil(TILE) }
    }

    /// Number of tiles of the grid, row-major.
    pub(crate) fn tiles(&self) -> usize {
        self.columns * self.rows
    }

    /// First pixel `(x, y)` of a tile.
    #[inline(always)]
    pub(crate) fn origin(&self, tile: usize) -> [usize; 2] {
        [tile % self.columns * TILE, tile / self.columns * TILE]
    }

    /// Calls `visit` with every tile the splat touches, in ascending order.
    #[inline(always)]
    pub(crate) fn for_each_tile(&self, splat: &ProjectedSplat, mut visit: impl FnMut(u32)) {
        let ellipse = splat.ellipse([0.0, 0.0]);
        let [top, bottom] = ellipse.rows();
        // Pixel centres lie at +½; a row of tiles holds centres 16r + ½ … 16r + 15½.
        let Some((first, last)) = span(top, bottom, self.height) else { return };
        for row in first / TILE..=last / TILE {
            let y = (row * TILE) as f32;
            let y_end = (self.height.min((row + 1) * TILE)) as f32;
            let Some([left, right]) = ellipse.columns(y + 0.5, y_end - 0.5) else { continue };
            let Some((from, to)) = span(left, right, self.width) else { continue };
            for column in from / TILE..=to / TILE {
                visit((row * self.columns + column) as u32);
            }
        }
    }
}

/// Which tiles have open pixels, with counts over any rectangle of tiles in constant time.
#[derive(Clone, Debug, Default)]
pub(crate) struct OpenTiles {
    open: Vec<bool>,
    /// Open tiles above and left of each corner of the grid (a summed-area table).
    sums: Vec<u32>,
    stride: usize,
}

impl OpenTiles {
    /// Sets the state of every tile, in row-major order.
    pub(crate) fn update(&mut self, grid: &Grid, is_open: impl Iterator<Item = bool>) {
        self.open.clear();
        self.open.extend(is_open);
        self.stride = grid.columns + 1;
        self.sums.clear();
        self.sums.resize(self.stride * (grid.rows + 1), 0);
        for row in 0..grid.rows {
            let mut run = 0;
            for column in 0..grid.columns {
                run += u32::from(self.open[row * grid.columns + column]);
                let at = (row + 1) * self.stride + column + 1;
                self.sums[at] = self.sums[at - self.stride] + run;
            }
        }
    }

    /// Whether any tile is open.
    pub(crate) fn any(&self) -> bool {
        self.sums.last().is_some_and(|&n| n > 0)
    }

    /// Whether one tile is open.
    #[inline(always)]
    pub(crate) fn is_open(&self, tile: u32) -> bool {
        self.open[tile as usize]
    }

    /// Whether an open tile intersects the square of half-side `radius` pixels around `center`.
    #[inline(always)]
    pub(crate) fn intersect(&self, grid: &Grid, center: [f32; 2], radius: f32) -> bool {
        let columns = span(center[0] - radius, center[0] + radius, grid.width);
        let rows = span(center[1] - radius, center[1] + radius, grid.height);
        let (Some((left, right)), Some((top, bottom))) = (columns, rows) else { return false };
        let (left, right, top, bottom) = (left / TILE, right / TILE + 1, top / TILE, bottom / TILE + 1);
        let at = |row: usize, column: usize| self.sums[row * self.stride + column];
        at(bottom, right) + at(top, left) > at(top, right) + at(bottom, left)
    }
}

/// First and last of `side` pixels whose centre lies in `[lo, hi]`.
#[inline(always)]
fn span(lo: f32, hi: f32, side: usize) -> Option<(usize, usize)> {
    let from = (lo - 0.5).ceil().max(0.0);
    let to = (hi - 0.5).floor().min(side as f32 - 1.0);
    (from <= to).then_some((from as usize, to as usize))
}
