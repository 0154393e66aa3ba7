//! Which tiles a splat touches, exactly: an ellipse against rows of tiles, in closed form.
//!
//! In whitened coordinates the visible region is the disc `a² + b² ≤ r²`. A horizontal strip is an interval of `b`
//! (`b` depends on `y` only), and with `k = w₁/w₂` the pixel column is `x = u_x + (a − k b)/w₀`. Over the strip the
//! rightmost point has `b = clamp(−k r/√(1+k²))` and `a = √(r² − b²)`, the leftmost the mirror image: one square root a
//! side. The interval is widened by a bound on its rounding error, so a list may hold a little too much, never too
//! little; the alpha test of each pixel has the last word.

use crate::project::Footprint;

/// Pixels along a tile's side.
pub const TILE: usize = 16;
/// Pixels along a block's side: one SIMD vector is a 4×4 block.
pub const BLOCK: usize = 4;
/// `√(½ log₂ e)`: scales whitened coordinates so that `log₂ g = −(a² + b²)`.
pub const LOG2_SCALE: f64 = 0.849_321_800_288_019_1;
/// Relative widening of the support against rounding.
const SLACK: f32 = 4e-6;
/// Absolute widening of intervals, pixels.
const MARGIN: f32 = 5e-3;

/// A splat ready for the tiles: everything a tile needs, in one place, in depth order.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Drawn {
    /// Centre, pixels.
    pub center: [f64; 2],
    /// Whitening scaled by [`LOG2_SCALE`].
    pub whitening: [f64; 3],
    /// `log₂` of the compensated opacity.
    pub log2_opacity: f32,
    /// `r²`: support in the same units.
    pub support: f32,
    /// Colour from this camera.
    pub rgb: [f32; 3],
    /// Camera depth.
    pub depth: f32,
    /// Row in the caller's columns.
    pub index: u32,
}

impl Drawn {
    /// From a footprint; `None` if no pixel can reach `min_alpha`.
    #[inline]
    pub fn new(fp: &Footprint, log2_opacity: f64, support: f64, depth: f64, index: u32) -> Option<Self> {
        (support >= 0.0).then(|| Self {
            center: fp.center,
            whitening: fp.whitening.map(|w| w * LOG2_SCALE),
            log2_opacity: log2_opacity as f32,
            support: (support * 1.000_01 + 1e-4) as f32,
            rgb: [0.0; 3],
            depth: depth as f32,
            index,
        })
    }

    /// The disc against strips, relative to `origin` (pixels).
    #[inline]
    pub fn ellipse(&self, origin: [f64; 2]) -> Ellipse {
        let [w0, w1, w2] = self.whitening;
        let (ox, oy) = (origin[0] - self.center[0], origin[1] - self.center[1]);
        let r = self.support.sqrt();
        let slope = (w1 / w2) as f32;
        let b0 = (w2 * oy) as f32;
        let inv = (1.0 / w0) as f32;
        let tilt = slope / (1.0 + slope * slope).sqrt();
        let reach = slope.abs() * (b0.abs() + r) + r + (w0 * ox + w1 * oy).abs() as f32;
        Ellipse {
            b0,
            step: w2 as f32,
            radius: r,
            support: self.support,
            extreme: tilt * r,
            slope,
            inv,
            // x where a = 0 and b = 0 is −ox; written through b so that rounding stays near the strip.
            shift: -ox as f32,
            margin: MARGIN + SLACK * reach * inv,
        }
    }
}

/// A splat's disc seen from a fixed origin: intervals of pixel columns for strips of rows.
#[derive(Clone, Copy, Debug)]
pub struct Ellipse {
    /// `b` at the origin's row.
    pub b0: f32,
    /// `b` per row.
    pub step: f32,
    /// Disc radius.
    pub radius: f32,
    /// Its square.
    pub support: f32,
    /// `|b|` of the leftmost and rightmost points, signed by the slope.
    pub extreme: f32,
    /// `w₁/w₂`.
    pub slope: f32,
    /// `1/w₀`.
    pub inv: f32,
    /// Column of the centre relative to the origin.
    pub shift: f32,
    /// Widening, pixels.
    pub margin: f32,
}

impl Ellipse {
    /// Columns `[left, right]` the disc covers between rows `y0` and `y1` (relative to the origin), or `None`.
    #[inline]
    pub fn columns(&self, y0: f32, y1: f32) -> Option<[f32; 2]> {
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
            self.shift + (-half(left) - self.slope * left) * self.inv - self.margin,
            self.shift + (half(right) - self.slope * right) * self.inv + self.margin,
        ])
    }

    /// Rows `[top, bottom]` the disc covers, relative to the origin.
    #[inline]
    pub fn rows(&self) -> [f32; 2] {
        let inv = 1.0 / self.step;
        let slack = self.slack() * inv;
        [(-self.radius - self.b0) * inv - slack, (self.radius - self.b0) * inv + slack]
    }

    /// Widening of an interval of `b` against rounding.
    #[inline]
    pub fn slack(&self) -> f32 {
        SLACK * (self.b0.abs() + self.radius) + MARGIN * self.step
    }
}

/// The grid of tiles over an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Grid {
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Tiles per row.
    pub columns: usize,
    /// Rows of tiles.
    pub rows: usize,
}

impl Grid {
    /// The grid of an image.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, columns: width.div_ceil(TILE), rows: height.div_ceil(TILE) }
    }

    /// Number of tiles.
    pub fn tiles(&self) -> usize {
        self.columns * self.rows
    }

    /// First pixel `(x, y)` of a tile.
    #[inline]
    pub fn origin(&self, tile: usize) -> [usize; 2] {
        [tile % self.columns * TILE, tile / self.columns * TILE]
    }

    /// Calls `visit` with every tile the splat touches, in ascending order.
    #[inline]
    pub fn touched(&self, splat: &Drawn, mut visit: impl FnMut(u32)) {
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

/// First and last pixel whose centre lies in `[lo, hi]`, of `side` pixels.
#[inline]
fn span(lo: f32, hi: f32, side: usize) -> Option<(usize, usize)> {
    let from = (lo - 0.5).ceil().max(0.0);
    let to = (hi - 0.5).floor().min(side as f32 - 1.0);
    (from <= to).then_some((from as usize, to as usize))
}
