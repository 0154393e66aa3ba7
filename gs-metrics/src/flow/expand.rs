//! The quadratic fitted to the neighbourhood of every pixel (polynomial expansion).
//!
//! With the window `g(x) ∝ exp(−x²/2σ²)` of 11 taps, normalised to sum 1, and moments in both directions,
//! ```text
//! b_x = i₁₁⟨x⟩,  b_y = i₁₁⟨y⟩,  A_xx = i₀₃⟨1⟩ + i₃₃⟨x²⟩,  A_yy = i₀₃⟨1⟩ + i₃₃⟨y²⟩,  A_xy = i₅₅⟨xy⟩
//! ```
//! where `i` are entries of the inverse of the 6 × 6 matrix of moments. The taps `i₀₃ g + i₃₃ x² g` sum to 0, as a constant
//! has no curvature. They are applied to differences from the centre, so that bright areas lose no digits. Values outside the
//! image are the nearest ones.

use fearless_simd::{Level, Simd, dispatch};
use gs_core::cast;
use rayon::prelude::*;

/// Coefficients of each pixel: `b_y, b_x, A_yy, A_xx, A_xy`.
pub(super) const TERMS: usize = 5;
/// Half width of the window.
const RADIUS: usize = 5;
/// Standard deviation of the window in pixels.
const SIGMA: f64 = 1.2;
/// Output rows of one parallel task.
const BAND: usize = 16;

/// One-sided taps, index = distance from the centre.
struct Taps {
    /// The window `g`.
    smooth: [f32; RADIUS + 1],
    /// `i₁₁ x g`: the first derivative.
    slope: [f32; RADIUS + 1],
    /// `(i₅₅/i₁₁) x g`: the mixed derivative, applied to slopes.
    mixed: [f32; RADIUS + 1],
    /// `i₀₃ g + i₃₃ x² g`: half the second derivative.
    curvature: [f32; RADIUS + 1],
}

impl Taps {
    /// The moments of the window are `m₀ = 1`, `m₂ = Σ g x²`, `m₄ = Σ g x⁴`; the matrix of the even terms
    /// `1, x², y²` is inverted in closed form.
    fn new() -> Self {
        let raw: [f64; RADIUS + 1] = std::array::from_fn(|k| (-((k * k) as f64) / (2.0 * SIGMA * SIGMA)).exp());
        let total: f64 = raw[0] + 2.0 * raw[1..].iter().sum::<f64>();
        let g = raw.map(|v| v / total);
        let moment = |power: i32| 2.0 * (1..=RADIUS).map(|k| g[k] * (k as f64).powi(power)).sum::<f64>();
        let (m2, m4) = (moment(2), moment(4));
        let (i11, i55) = (1.0 / m2, 1.0 / (m2 * m2));
        // Subtracting m₂ from x² and y² makes them orthogonal to 1 and to each other.
        let i33 = 1.0 / (m4 - m2 * m2);
        let i03 = -m2 * i33;
        let x = |k: usize| k as f64;
        Self {
            smooth: g.map(cast::to_f32),
            slope: std::array::from_fn(|k| cast::to_f32(i11 * x(k) * g[k])),
            mixed: std::array::from_fn(|k| cast::to_f32(i55 / i11 * x(k) * g[k])),
            curvature: std::array::from_fn(|k| cast::to_f32((i03 + i33 * x(k) * x(k)) * g[k])),
        }
    }
}

/// One row of the vertical pass, padded by `RADIUS` values on both sides.
#[derive(Default)]
struct Columns {
    smooth: Vec<f32>,
    slope: Vec<f32>,
    curvature: Vec<f32>,
}

/// The coefficients `[H, TERMS, W]` of a plane `[H, W]`.
pub(super) fn expand(plane: &[f32], width: usize, out: &mut Vec<f32>) {
    out.resize(plane.len() * TERMS, 0.0);
    let taps = Taps::new();
    let work = out.par_chunks_mut(BAND * TERMS * width).enumerate();
    work.for_each_init(Columns::default, |columns, (band, out)| {
        columns.resize(width + 2 * RADIUS);
        dispatch!(Level::new(), simd => rows(simd, &taps, plane, width, band * BAND, columns, out));
    });
}

/// The coefficients of the rows from `first`, as many as `out` holds.
#[inline(always)]
fn rows<S: Simd>(_: S, taps: &Taps, plane: &[f32], width: usize, first: usize, columns: &mut Columns, out: &mut [f32]) {
    for (i, out) in out.chunks_exact_mut(TERMS * width).enumerate() {
        columns.vertical_pass(taps, plane, width, first + i);
        let (b_y, out) = out.split_at_mut(width);
        let (b_x, out) = out.split_at_mut(width);
        let (a_yy, out) = out.split_at_mut(width);
        let (a_xx, a_xy) = out.split_at_mut(width);
        even(&columns.slope, &taps.smooth, b_y);
        odd(&columns.smooth, &taps.slope, b_x);
        even(&columns.curvature, &taps.smooth, a_yy);
        zero_sum(&columns.smooth, &taps.curvature, a_xx);
        odd(&columns.slope, &taps.mixed, a_xy);
    }
}

impl Columns {
    fn resize(&mut self, n: usize) {
        for row in [&mut self.smooth, &mut self.slope, &mut self.curvature] {
            row.resize(n, 0.0);
        }
    }

    /// The vertical pass of row `y`.
    #[inline(always)]
    fn vertical_pass(&mut self, taps: &Taps, plane: &[f32], width: usize, y: usize) {
        let last = plane.len() / width - 1;
        let row = |y: usize| &plane[y * width..(y + 1) * width];
        let centre = row(y);
        let inner = RADIUS..RADIUS + width;
        let (smooth, slope, curvature) =
            (&mut self.smooth[inner.clone()], &mut self.slope[inner.clone()], &mut self.curvature[inner]);
        for x in 0..width {
            smooth[x] = taps.smooth[0] * centre[x];
            slope[x] = 0.0;
            curvature[x] = 0.0;
        }
        for k in 1..=RADIUS {
            let (up, down) = (row(y.saturating_sub(k)), row((y + k).min(last)));
            let (g, s, b) = (taps.smooth[k], taps.slope[k], taps.curvature[k]);
            for x in 0..width {
                smooth[x] += g * (up[x] + down[x]);
                slope[x] += s * (down[x] - up[x]);
                curvature[x] += b * ((up[x] - centre[x]) + (down[x] - centre[x]));
            }
        }
        for row in [&mut self.smooth, &mut self.slope, &mut self.curvature] {
            let (low, high) = (row[RADIUS], row[RADIUS + width - 1]);
            row[..RADIUS].fill(low);
            row[RADIUS + width..].fill(high);
        }
    }
}

/// Symmetric taps along a row.
#[inline(always)]
fn even(line: &[f32], taps: &[f32; RADIUS + 1], out: &mut [f32]) {
    let n = out.len();
    let line = &line[..n + 2 * RADIUS];
    for x in 0..n {
        let mut sum = taps[0] * line[x + RADIUS];
        for k in 1..=RADIUS {
            sum += taps[k] * (line[x + RADIUS - k] + line[x + RADIUS + k]);
        }
        out[x] = sum;
    }
}

/// Antisymmetric taps along a row.
#[inline(always)]
fn odd(line: &[f32], taps: &[f32; RADIUS + 1], out: &mut [f32]) {
    let n = out.len();
    let line = &line[..n + 2 * RADIUS];
    for x in 0..n {
        let mut sum = 0.0;
        for k in 1..=RADIUS {
            sum += taps[k] * (line[x + RADIUS + k] - line[x + RADIUS - k]);
        }
        out[x] = sum;
    }
}

/// Symmetric taps with sum 0, applied to differences from the centre.
#[inline(always)]
fn zero_sum(line: &[f32], taps: &[f32; RADIUS + 1], out: &mut [f32]) {
    let n = out.len();
    let line = &line[..n + 2 * RADIUS];
    for x in 0..n {
        let centre = line[x + RADIUS];
        let mut sum = 0.0;
        for k in 1..=RADIUS {
            sum += taps[k] * ((line[x + RADIUS - k] - centre) + (line[x + RADIUS + k] - centre));
        }
        out[x] = sum;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn taps_agree_with_the_published_inverse() {
        let t = Taps::new();
        let g = f64::from(t.smooth[2]);
        let close = |a: f32, b: f64| assert!((f64::from(a) - b).abs() < 1e-7, "{a} {b}");
        close(t.slope[2], 0.694_486_393_0 * 2.0 * g);
        close(t.mixed[2], 0.482_311_346_2 / 0.694_486_393_0 * 2.0 * g);
        close(t.curvature[0], -0.347_453_530_6 * f64::from(t.smooth[0]));
        close(t.curvature[2], (-0.347_453_530_6 + 4.0 * 0.241_301_747_3) * g);
    }

    #[test]
    fn a_quadratic_is_recovered() {
        let (w, h) = (23usize, 19usize);
        let f = |x: f64, y: f64| 90.0 + 0.7 * x - 1.1 * y + 0.03 * x * x - 0.05 * y * y + 0.04 * x * y;
        let plane: Vec<f32> = (0..w * h).map(|i| f((i % w) as f64, (i / w) as f64) as f32).collect();
        let mut out = Vec::new();
        expand(&plane, w, &mut out);
        for (x, y) in [(5, 5), (11, 9), (17, 13)] {
            let got: [f32; TERMS] = std::array::from_fn(|t| out[(y * TERMS + t) * w + x]);
            let (dx, dy) = (x as f64, y as f64);
            let want = [-1.1 - 0.1 * dy + 0.04 * dx, 0.7 + 0.06 * dx + 0.04 * dy, -0.05, 0.03, 0.04];
            for (g, w) in got.iter().zip(want) {
                assert!((f64::from(*g) - w).abs() < 2e-5, "({x}, {y}): {got:?} {want:?}");
            }
        }
    }

    #[test]
    fn flat_planes_of_any_size_have_no_slope() {
        for (w, h) in [(1, 1), (3, 2), (17, 33)] {
            let mut out = Vec::new();
            expand(&vec![200.0; w * h], w, &mut out);
            assert!(out.len() == 5 * w * h && out.iter().all(|v| *v == 0.0));
        }
    }
}
