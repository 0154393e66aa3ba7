//! PSNR and SSIM over a mask: the co-visibility metrics of DyCheck.
//!
//! The mask is `[H, W, 1]` with weights `m ≥ 0` (1 = the pixel counts, 0 = it does not), the same for all channels.
//! ```text
//! masked mse  = Σ m (a − b)² / Σ m                                    (both sums over pixels and channels)
//! ```
//! Masked SSIM replaces each one-dimensional pass of the 11-tap window `g` by a *partial convolution*, horizontal then
//! vertical, over windows inside the image:
//! ```text
//! z'(p) = 11·Σ_k g_k m z / Σ_k m,   m'(p) = 1      if Σ_k m ≠ 0
//! z'(p) = 0,                        m'(p) = 0      otherwise
//! ```
//! (normalised by the count of pixels, not by the weight of the window, as in the code behind the published numbers). The
//! variances are `max(E[z²] − μ², 0)`, the covariance is clamped to `±√(σx²σy²)`, and the rest is plain SSIM. Where no
//! pixel of the window counts, all statistics are 0 and the map is 1. Large empty areas therefore **raise** the published
//! mean, [`MaskedSsim::whole`], up to 1 for an empty mask. [`MaskedSsim::seen`] is the mean without those places.
//!
//! Everything is computed in `f64`, without gradient. DyCheck also truncates predictions to 8 bits before scoring:
//! [`Quantise::Truncate`](crate::Quantise).
//!
//! Gao, Li, Tulsiani, Russell, Kanazawa, *Monocular dynamic view synthesis: a reality check*, NeurIPS 2022.
//!
//! ```
//! use gs_core::Image;
//! use gs_metrics::{masked_psnr, masked_ssim};
//! let flat = |v: f32| Image { width: 16, height: 16, channels: 1, data: vec![v; 256] };
//! let (mut render, truth, mut mask) = (flat(0.5), flat(0.5), flat(1.0));
//! render.data[0] = 0.9;
//! assert!(masked_psnr(&render, &truth, &mask)?.is_finite());
//! mask.data[0] = 0.0;
//! assert_eq!(masked_psnr(&render, &truth, &mask)?, f64::INFINITY);
//! assert!((masked_ssim(&render, &truth, &mask)?.whole - 1.0).abs() < 1e-12);
//! # Ok::<(), gs_metrics::MetricError>(())
//! ```

use gs_core::Image;
use rayon::prelude::*;

use crate::error::{MetricError, check_finite, check_image, check_pair};
use crate::psnr::psnr_from_mse;
use crate::window::{RADIUS, TAPS, half_window};

/// The two means of masked SSIM.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskedSsim {
    /// Mean over the whole map, where a place without any pixel that counts has the value 1: the published number.
    pub whole: f64,
    /// Mean over places whose window holds a pixel that counts; 1 where no place does.
    pub seen: f64,
}

/// Mean squared error of two `[H, W, C]` images, weighted by a mask `[H, W, 1]`.
///
/// # Errors
/// Different shapes, a mask of another size or with several channels, negative weights, an empty mask, or a value that is
/// not finite.
pub fn masked_mse(a: &Image, b: &Image, mask: &Image) -> Result<f64, MetricError> {
    check_masked(a, b, mask)?;
    let c = a.channels;
    let row = |y: usize| {
        let (mut error, mut weight) = (0.0f64, 0.0f64);
        for x in 0..a.width {
            let m = f64::from(mask.pixel(x, y)[0]);
            weight += m;
            for (p, q) in a.pixel(x, y).iter().zip(b.pixel(x, y)) {
                error += m * (f64::from(*p) - f64::from(*q)).powi(2);
            }
        }
        (error, weight)
    };
    let rows: Vec<(f64, f64)> = (0..a.height).into_par_iter().map(row).collect();
    let (error, weight) = rows.iter().fold((0.0, 0.0), |s, r| (s.0 + r.0, s.1 + r.1));
    if weight > 0.0 { Ok(error / (weight * c as f64)) } else { Err(MetricError::EmptyMask) }
}

/// PSNR in dB of [`masked_mse`], data range 1; `+∞` if the images agree where the mask is positive.
///
/// # Errors
/// Those of [`masked_mse`].
pub fn masked_psnr(a: &Image, b: &Image, mask: &Image) -> Result<f64, MetricError> {
    masked_mse(a, b, mask).map(psnr_from_mse)
}

/// SSIM by partial convolution over a mask `[H, W, 1]`; see the [module](self). Both sides need at least 11 pixels. An empty
/// mask gives 1.
///
/// # Errors
/// Those of [`masked_mse`] except for the empty mask, or an image that is too small.
pub fn masked_ssim(a: &Image, b: &Image, mask: &Image) -> Result<MaskedSsim, MetricError> {
    check_masked(a, b, mask)?;
    let (width, height) = (a.width, a.height);
    if width.min(height) < TAPS {
        let hint = "masked SSIM has no padded form";
        return Err(MetricError::TooSmall { metric: "masked SSIM", need: TAPS, width, height, hint });
    }
    let channels: Vec<[f64; 3]> = (0..a.channels).into_par_iter().map(|c| channel_sums(a, b, mask, c)).collect();
    let [whole, seen, count] = channels.iter().fold([0.0; 3], |s, r| std::array::from_fn(|k| s[k] + r[k]));
    let places = (a.channels * (width - 2 * RADIUS) * (height - 2 * RADIUS)) as f64;
    Ok(MaskedSsim { whole: whole / places, seen: if count > 0.0 { seen / count } else { 1.0 } })
}

pub(crate) fn check_masked(a: &Image, b: &Image, mask: &Image) -> Result<(), MetricError> {
    check_pair(a, b)?;
    check_image("mask", mask)?;
    let want = (a.width, a.height, 1);
    if mask.shape() != want {
        return Err(MetricError::Shape { what: "image and mask (one channel)", first: want, second: mask.shape() });
    }
    check_finite("a", a)?;
    check_finite("b", b)?;
    check_finite("mask", mask)?;
    match mask.data.iter().position(|m| *m < 0.0) {
        Some(at) => Err(MetricError::NegativeMask { x: at % mask.width, y: at / mask.width }),
        None => Ok(()),
    }
}

/// A plane of `f64` values, row-major.
struct Plane {
    width: usize,
    data: Vec<f64>,
}

/// One partial convolution with taps `step` values apart, `z'` and `m'` of `out_width` columns and `out_height` rows.
fn partial_pass(z: &Plane, m: &Plane, step: usize, out_width: usize, out_height: usize) -> (Plane, Plane) {
    let half = half_window();
    let mut out = Plane { width: out_width, data: Vec::with_capacity(out_width * out_height) };
    let mut seen = Plane { width: out_width, data: Vec::with_capacity(out_width * out_height) };
    for y in 0..out_height {
        for x in 0..out_width {
            let at = y * z.width + x;
            let (mut sum, mut count) = (0.0, 0.0);
            for k in 0..TAPS {
                let weight = m.data[at + k * step];
                sum += half[k.abs_diff(RADIUS)] * weight * z.data[at + k * step];
                count += weight;
            }
            let any = count != 0.0;
            out.data.push(if any { sum * TAPS as f64 / count } else { 0.0 });
            seen.data.push(f64::from(u8::from(any)));
        }
    }
    (out, seen)
}

/// Both passes over one field: `z'` and `m'` over the valid area.
fn filtered(field: Vec<f64>, mask: &Plane) -> (Plane, Plane) {
    let width = mask.width;
    let height = field.len() / width;
    let (inner_w, inner_h) = (width - 2 * RADIUS, height - 2 * RADIUS);
    let (z, m) = partial_pass(&Plane { width, data: field }, mask, 1, inner_w, height);
    partial_pass(&z, &m, inner_w, inner_w, inner_h)
}

/// For one channel: the sum of the map, its sum over places with `m' = 1`, and the number of those.
fn channel_sums(a: &Image, b: &Image, mask: &Image, c: usize) -> [f64; 3] {
    let plane = |i: &Image| i.data.iter().skip(c).step_by(i.channels).map(|v| f64::from(*v)).collect::<Vec<_>>();
    let (x, y) = (plane(a), plane(b));
    let m = Plane { width: mask.width, data: mask.data.iter().map(|v| f64::from(*v)).collect() };
    let product = |p: &[f64], q: &[f64]| p.iter().zip(q).map(|(u, v)| u * v).collect::<Vec<_>>();
    let (xx, yy, xy) = (product(&x, &x), product(&y, &y), product(&x, &y));
    let (mu_x, seen) = filtered(x, &m);
    let [mu_y, xx, yy, xy] = [y, xx, yy, xy].map(|field| filtered(field, &m).0);
    let (c1, c2) = (1e-4, 9e-4);
    let mut sums = [0.0; 3];
    for i in 0..seen.data.len() {
        let (mx, my) = (mu_x.data[i], mu_y.data[i]);
        let (vx, vy) = ((xx.data[i] - mx * mx).max(0.0), (yy.data[i] - my * my).max(0.0));
        let limit = (vx * vy).sqrt();
        let cov = (xy.data[i] - mx * my).clamp(-limit, limit);
        let score = (2.0 * mx * my + c1) * (2.0 * cov + c2) / ((mx * mx + my * my + c1) * (vx + vy + c2));
        sums[0] += score;
        sums[1] += score * seen.data[i];
        sums[2] += seen.data[i];
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SsimOptions, psnr, ssim};
    use gs_core::Rng;

    fn noise(w: usize, h: usize, c: usize, seed: u64) -> Image {
        let mut rng = Rng::new(seed, "masked test", 0, 0);
        Image { width: w, height: h, channels: c, data: (0..w * h * c).map(|_| rng.uniform()).collect() }
    }

    fn mask(w: usize, h: usize, f: impl Fn(usize, usize) -> f32) -> Image {
        Image { width: w, height: h, channels: 1, data: (0..w * h).map(|i| f(i % w, i / w)).collect() }
    }

    #[test]
    fn a_full_mask_is_the_plain_metric() {
        let (a, b) = (noise(31, 23, 3, 1), noise(31, 23, 3, 2));
        let full = mask(31, 23, |_, _| 1.0);
        let plain = ssim(&a, &b, &SsimOptions::published()).unwrap();
        let got = masked_ssim(&a, &b, &full).unwrap();
        assert!((got.whole - plain).abs() < 1e-6 && (got.seen - got.whole).abs() < 1e-12, "{got:?} {plain}");
        assert!((masked_psnr(&a, &b, &full).unwrap() - psnr(&a, &b).unwrap()).abs() < 1e-9);
        let same = masked_ssim(&a, &a, &full).unwrap();
        assert!((same.whole - 1.0).abs() < 1e-12);
        assert_eq!(masked_psnr(&a, &a, &full).unwrap(), f64::INFINITY);
    }

    #[test]
    fn pixels_outside_the_mask_change_nothing() {
        let (a, b) = (noise(40, 33, 3, 1), noise(40, 33, 3, 2));
        let left = mask(40, 33, |x, _| if x < 17 { 1.0 } else { 0.0 });
        let mut other = b.clone();
        for y in 0..33 {
            (17..40).for_each(|x| other.pixel_mut(x, y).fill(0.3));
        }
        assert_eq!(masked_psnr(&a, &b, &left).unwrap(), masked_psnr(&a, &other, &left).unwrap());
        let (p, q) = (masked_ssim(&a, &b, &left).unwrap(), masked_ssim(&a, &other, &left).unwrap());
        assert_eq!(p, q);
        // Windows start at columns 0 to 29 and overlap the mask if they start before column 17; the rest of the map is 1.
        let seen = 17.0 / 30.0;
        assert!((p.whole - (p.seen * seen + 1.0 - seen)).abs() < 1e-12, "{p:?}");
    }

    #[test]
    fn one_window_by_hand() {
        let (a, b) = (noise(11, 11, 1, 3), noise(11, 11, 1, 4));
        let m = mask(11, 11, |x, y| if (x + 2 * y) % 3 == 0 { 0.0 } else { 1.0 });
        let half = half_window();
        let filter = |f: &dyn Fn(usize, usize) -> f64| {
            let mut total = 0.0;
            for y in 0..11 {
                let count: f64 = (0..11).map(|x| f64::from(m.pixel(x, y)[0])).sum();
                let sum: f64 = (0..11usize).map(|x| half[x.abs_diff(5)] * f64::from(m.pixel(x, y)[0]) * f(x, y)).sum();
                total += half[y.abs_diff(5)] * sum * 11.0 / count;
            }
            total
        };
        let (p, q) = (|x, y| f64::from(a.pixel(x, y)[0]), |x, y| f64::from(b.pixel(x, y)[0]));
        let (mx, my) = (filter(&p), filter(&q));
        let vx = (filter(&|x, y| p(x, y).powi(2)) - mx * mx).max(0.0);
        let vy = (filter(&|x, y| q(x, y).powi(2)) - my * my).max(0.0);
        let limit = (vx * vy).sqrt();
        let cov = (filter(&|x, y| p(x, y) * q(x, y)) - mx * my).clamp(-limit, limit);
        let want = (2.0 * mx * my + 1e-4) * (2.0 * cov + 9e-4) / ((mx * mx + my * my + 1e-4) * (vx + vy + 9e-4));
        assert!((masked_ssim(&a, &b, &m).unwrap().whole - want).abs() < 1e-12);
    }

    #[test]
    fn weights_weigh() {
        let (a, mut b) = (Image::zeros(2, 1, 3), Image::zeros(2, 1, 3));
        b.pixel_mut(0, 0).fill(1.0);
        b.pixel_mut(1, 0).fill(0.5);
        let got = masked_mse(&a, &b, &mask(2, 1, |x, _| if x == 0 { 3.0 } else { 1.0 })).unwrap();
        assert!((got - (3.0 + 0.25) / 4.0).abs() < 1e-15);
    }

    #[test]
    fn bad_masks_are_errors() {
        let a = noise(20, 20, 3, 1);
        assert_eq!(masked_psnr(&a, &a, &mask(20, 20, |_, _| 0.0)).unwrap_err(), MetricError::EmptyMask);
        let empty = masked_ssim(&a, &noise(20, 20, 3, 2), &mask(20, 20, |_, _| 0.0)).unwrap();
        assert_eq!(empty, MaskedSsim { whole: 1.0, seen: 1.0 });
        let negative = mask(20, 20, |x, y| if (x, y) == (3, 4) { -1.0 } else { 1.0 });
        assert_eq!(masked_ssim(&a, &a, &negative).unwrap_err(), MetricError::NegativeMask { x: 3, y: 4 });
        let nan = mask(20, 20, |x, _| if x == 2 { f32::NAN } else { 1.0 });
        assert!(matches!(masked_psnr(&a, &a, &nan), Err(MetricError::NotFinite { which: "mask", x: 2, .. })));
        assert!(matches!(masked_psnr(&a, &a, &a), Err(MetricError::Shape { .. })));
        let thin = noise(40, 10, 3, 1);
        assert!(matches!(masked_ssim(&thin, &thin, &mask(40, 10, |_, _| 1.0)), Err(MetricError::TooSmall { .. })));
        let mut bad = a.clone();
        bad.data[7] = f32::NAN;
        assert!(masked_ssim(&a, &bad, &mask(20, 20, |_, _| 1.0)).is_err());
    }
}
