//! The 11-tap Gaussian window of SSIM, and the SIMD kernels that run it over rows.
//!
//! All rows hold interleaved pixels, so tap `k` of a row lies `k·C` values away and no planes are split. The pair is
//! read as `s = x + y` and `d = x − y`, whose variances give both `σx² + σy² = (σs² + σd²)/2` and
//! `2σxy = (σs² − σd²)/2`, so with `μ` alike
//! ```text
//! ssim = (1 − μd²/B1)·(1 − σd²/B2),   B1 = (μs² + μd²)/2 + C1,   B2 = (σs² + σd²)/2 + C2
//! ```
//! which equals `(2μxμy + C1)(2σxy + C2) / ((μx² + μy² + C1)(σx² + σy² + C2))`. In this form the distance from 1 is a sum
//! of small positive terms, and identical images give exactly 1.
//!
//! **Variances do not cancel.** `E[z²] − μ²` loses all digits on flat areas. Each one-dimensional variance is instead
//! taken about the centre value of its window, `z₀`, `v = Σ g (z − z₀)² − (Σ g (z − z₀))²`, where the subtracted term is at
//! most `(1/g₀ − 1)` = 2.8 times the result; the vertical pass combines rows by the law of total variance,
//! `σ² = Σ g_r v_r + var_r(m_r)`, exact because the window is a product `g_r g_k` with sum 1.
//!
//! Source: Wang, Bovik, Sheikh, Simoncelli, *Image quality assessment: from error visibility to structural similarity*,
//! IEEE TIP 13(4), 2004 (eq. 13, window of §III-C).

use fearless_simd::{Simd, SimdBase, SimdFloat};

/// Taps on each side of the centre.
pub(crate) const RADIUS: usize = 5;
/// Taps of the window along one axis.
pub(crate) const TAPS: usize = 2 * RADIUS + 1;
/// Standard deviation of the window in pixels.
pub(crate) const SIGMA: f64 = 1.5;
/// Rows are padded to a multiple of this many values, the widest SIMD vector in use.
pub(crate) const LANES: usize = 16;

/// The normalised window: weight of the centre, then of the taps at distance 1 to 5.
pub(crate) fn half_window() -> [f64; RADIUS + 1] {
    let g: [f64; RADIUS + 1] = std::array::from_fn(|k| (-((k * k) as f64) / (2.0 * SIGMA * SIGMA)).exp());
    let sum = g[0] + 2.0 * g[1..].iter().sum::<f64>();
    g.map(|v| v / sum)
}

/// Constants of one SSIM evaluation, read by the kernels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Consts {
    /// The half window: weight of the centre, then of distances 1 to 5.
    pub g: [f32; RADIUS + 1],
    /// `C1 = (K1·range)²`.
    pub c1: f32,
    /// `C2 = (K2·range)²`.
    pub c2: f32,
    /// Factor of the gradient.
    pub scale: f32,
}

/// The eleven rows under a vertical window, top to bottom, each `n` values.
pub(crate) type Rows<'a> = [&'a [f32]; TAPS];

/// Means and variances under the horizontal window.
///
/// `z` is a row padded by `RADIUS·channels` values on both sides; `mean` and `var` hold one value per unpadded value.
#[inline(always)]
pub(crate) fn horizontal_moments<S: Simd>(
    simd: S,
    g: &[f32; RADIUS + 1],
    channels: usize,
    z: &[f32],
    mean: &mut [f32],
    var: &mut [f32],
) {
    let lanes = S::f32s::LEN;
    let n = mean.len();
    let (z, var) = (&z[..n + 2 * RADIUS * channels], &mut var[..n]);
    for i in (0..n).step_by(lanes) {
        let at = |k: usize| S::f32s::from_slice(simd, &z[i + k * channels..][..lanes]);
        let centre = at(RADIUS);
        let mut first = S::f32s::splat(simd, 0.0);
        let mut second = first;
        for (k, weight) in g.iter().enumerate().skip(1) {
            let (l, r) = (at(RADIUS - k) - centre, at(RADIUS + k) - centre);
            let weight = S::f32s::splat(simd, *weight);
            first = weight.mul_add(l + r, first);
            second = weight.mul_add(l.mul_add(l, r * r), second);
        }
        (centre + first).store_slice(&mut mean[i..i + lanes]);
        (second - first * first).store_slice(&mut var[i..i + lanes]);
    }
}

/// Mean and variance of the whole window from the means and variances of its rows, at values `i..i + LEN`.
#[inline(always)]
fn vertical_moments<S: Simd>(simd: S, g: &[f32; RADIUS + 1], mean: &Rows, var: &Rows, i: usize) -> (S::f32s, S::f32s) {
    let load = |rows: &Rows, k: usize| S::f32s::from_slice(simd, &rows[k][i..i + S::f32s::LEN]);
    let centre = load(mean, RADIUS);
    let mut first = S::f32s::splat(simd, 0.0);
    let mut second = load(var, RADIUS) * S::f32s::splat(simd, g[0]);
    for (k, weight) in g.iter().enumerate().skip(1) {
        let (l, r) = (load(mean, RADIUS - k) - centre, load(mean, RADIUS + k) - centre);
        let within = load(var, RADIUS - k) + load(var, RADIUS + k);
        let weight = S::f32s::splat(simd, *weight);
        first = weight.mul_add(l + r, first);
        second = weight.mul_add(l.mul_add(l, r.mul_add(r, within)), second);
    }
    (centre + first, second - first * first)
}

/// Cotangents written by [`score_row`] and blurred by the window: `u` enters the gradient as it is, `v_s` and `v_d` times `2s`
/// and `2d`.
pub(crate) struct Maps<'a> {
    /// `Σ` over `z ∈ {s, d}` of `∂S/∂μz − 2 μz ∂S/∂σz²`.
    pub u: &'a mut [f32],
    /// Cotangent of the variance of `s`, `∂S/∂σs²`.
    pub v_s: &'a mut [f32],
    /// Cotangent of the variance of `d`, `∂S/∂σd²`.
    pub v_d: &'a mut [f32],
}

/// Input of the vertical pass: horizontal means and variances of `s` and of `d`.
pub(crate) struct Fields<'a> {
    /// Means of `s` under the horizontal window.
    pub mean_s: Rows<'a>,
    /// Variances of `s` under the horizontal window.
    pub var_s: Rows<'a>,
    /// Means of `d` under the horizontal window.
    pub mean_d: Rows<'a>,
    /// Variances of `d` under the horizontal window.
    pub var_d: Rows<'a>,
}

/// One row of `1 − ssim` (`FULL`) or `1 − contrast·structure`, and its cotangents into `maps`.
#[inline(always)]
pub(crate) fn score_row<S: Simd, const FULL: bool>(
    simd: S,
    consts: &Consts,
    fields: &Fields,
    loss: &mut [f32],
    mut maps: Option<Maps>,
) {
    let lanes = S::f32s::LEN;
    let splat = |v: f32| S::f32s::splat(simd, v);
    let (half, one, two) = (splat(0.5), splat(1.0), splat(2.0));
    for i in (0..loss.len()).step_by(lanes) {
        let (mu_s, var_s) = vertical_moments(simd, &consts.g, &fields.mean_s, &fields.var_s, i);
        let (mu_d, var_d) = vertical_moments(simd, &consts.g, &fields.mean_d, &fields.var_d, i);
        let inv_b1 = one / half.mul_add(mu_s.mul_add(mu_s, mu_d * mu_d), splat(consts.c1));
        let inv_b2 = one / half.mul_add(var_s + var_d, splat(consts.c2));
        let p_l = if FULL { mu_d * mu_d * inv_b1 } else { splat(0.0) };
        let p_c = var_d * inv_b2;
        (p_l + p_c - p_l * p_c).store_slice(&mut loss[i..i + lanes]);
        let Some(maps) = &mut maps else { continue };
        let (l, k) = (one - p_l, one - p_c);
        let v_s = half * l * p_c * inv_b2;
        let v_d = (half * p_c - one) * l * inv_b2;
        // The variances may be taken about any value. With s about 1 (mid grey) both terms of the sum stay small.
        let mut u = splat(-2.0) * (v_s * (mu_s - one)).mul_add(one, v_d * mu_d);
        if FULL {
            let d_mean = k * inv_b1;
            u = d_mean.mul_add(p_l * mu_s - mu_d * (two - p_l), u);
        }
        u.store_slice(&mut maps.u[i..i + lanes]);
        v_s.store_slice(&mut maps.v_s[i..i + lanes]);
        v_d.store_slice(&mut maps.v_d[i..i + lanes]);
    }
}

/// Horizontal blur of a padded row.
#[inline(always)]
pub(crate) fn blur_row<S: Simd>(simd: S, g: &[f32; RADIUS + 1], channels: usize, z: &[f32], out: &mut [f32]) {
    let lanes = S::f32s::LEN;
    let z = &z[..out.len() + 2 * RADIUS * channels];
    for i in (0..out.len()).step_by(lanes) {
        let at = |k: usize| S::f32s::from_slice(simd, &z[i + k * channels..][..lanes]);
        let mut sum = at(RADIUS) * S::f32s::splat(simd, g[0]);
        for (k, weight) in g.iter().enumerate().skip(1) {
            sum = S::f32s::splat(simd, *weight).mul_add(at(RADIUS - k) + at(RADIUS + k), sum);
        }
        sum.store_slice(&mut out[i..i + lanes]);
    }
}

/// Vertical blur of eleven rows at values `i..i + LEN`.
#[inline(always)]
fn vertical_blur<S: Simd>(simd: S, g: &[f32; RADIUS + 1], rows: &Rows, i: usize) -> S::f32s {
    let at = |k: usize| S::f32s::from_slice(simd, &rows[k][i..i + S::f32s::LEN]);
    let mut sum = at(RADIUS) * S::f32s::splat(simd, g[0]);
    for (k, weight) in g.iter().enumerate().skip(1) {
        sum = S::f32s::splat(simd, *weight).mul_add(at(RADIUS - k) + at(RADIUS + k), sum);
    }
    sum
}

/// One row of the gradient: `scale·(G∗u + 2(s − 1)·G∗v_s + 2d·G∗v_d)` from horizontally blurred rows.
#[inline(always)]
pub(crate) fn gradient_row<S: Simd>(
    simd: S,
    consts: &Consts,
    blurred: [&Rows; 3],
    s: &[f32],
    d: &[f32],
    out: &mut [f32],
) {
    let lanes = S::f32s::LEN;
    let (two, one) = (S::f32s::splat(simd, 2.0), S::f32s::splat(simd, 1.0));
    for i in (0..out.len()).step_by(lanes) {
        let u = vertical_blur(simd, &consts.g, blurred[0], i);
        let v_s = vertical_blur(simd, &consts.g, blurred[1], i);
        let v_d = vertical_blur(simd, &consts.g, blurred[2], i);
        let s = S::f32s::from_slice(simd, &s[i..i + lanes]) - one;
        let d = S::f32s::from_slice(simd, &d[i..i + lanes]);
        let sum = two.mul_add(s.mul_add(v_s, d * v_d), u);
        (sum * S::f32s::splat(simd, consts.scale)).store_slice(&mut out[i..i + lanes]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_is_the_published_one() {
        let g = half_window();
        assert!((g[0] + 2.0 * g[1..].iter().sum::<f64>() - 1.0).abs() < 1e-15);
        assert!((g[1] / g[0] - (-1.0f64 / 4.5).exp()).abs() < 1e-15);
        assert!((g[0] - 0.266_011_7).abs() < 1e-6, "{}", g[0]);
    }
}
