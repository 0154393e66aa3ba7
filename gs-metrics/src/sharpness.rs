//! Sharpness of a render relative to its ground-truth image. It shows a slight blur everywhere, which PSNR hides.
//!
//! * [`laplacian_variance`]: variance over inner pixels of `4 f(x, y) − f(x ± 1, y) − f(x, y ± 1)` (Pech-Pacheco et al.
//!   2000);
//! * [`high_band_share`]: energy of the spectrum at [`HIGH_BAND`] cycles per pixel and above, divided by its energy without the mean.
//!
//! Both are taken of the luma (BT.601). [`Sharpness`] holds the ratios render / ground truth: below 1 the render is blurred,
//! above 1 it is sharper or noisier than the ground truth.
//!
//! ```
//! use gs_core::Image;
//! use gs_metrics::Sharpness;
//! let waves = |contrast: f32| {
//!     let data = (0..1024).map(|i| 0.5 + contrast * ((i % 32) as f32 * 0.9).sin()).collect();
//!     Image { width: 32, height: 32, channels: 1, data }
//! };
//! // Half the contrast has a quarter of the variance, and the same shape of the spectrum.
//! let s = Sharpness::of(&waves(0.2), &waves(0.4))?;
//! assert!((s.laplacian.unwrap() - 0.25).abs() < 1e-4 && (s.high_band.unwrap() - 1.0).abs() < 1e-4);
//! # Ok::<(), gs_metrics::MetricError>(())
//! ```

use gs_core::{Image, cast};

use crate::error::{MetricError, check_finite, check_image, check_pair};
use crate::fft2::Fft2;
use crate::plane::opponent_planes;

/// Lowest frequency of the high band in cycles per pixel: half the highest frequency along an axis.
pub const HIGH_BAND: f64 = 0.25;

/// Sharpness of a render over that of its ground-truth image, dimensionless.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sharpness {
    /// Ratio of [`laplacian_variance`]; `None` if that of the ground truth is 0 (a constant image).
    pub laplacian: Option<f64>,
    /// Ratio of [`high_band_share`]; `None` if that of the ground truth is 0.
    pub high_band: Option<f64>,
}

impl Sharpness {
    /// Compares a render with its ground-truth image, both `[H, W, 1 or 3]`.
    ///
    /// # Errors
    /// Different shapes, a side below 3 pixels, another number of channels, a value that is not finite.
    pub fn of(image: &Image, truth: &Image) -> Result<Self, MetricError> {
        check_pair(image, truth)?;
        let ratio = |a: f64, b: f64| (b > 0.0).then(|| a / b);
        Ok(Self {
            laplacian: ratio(laplacian_variance(image)?, laplacian_variance(truth)?),
            high_band: ratio(high_band_share(image)?, high_band_share(truth)?),
        })
    }
}

/// Variance of the Laplacian of the luma over the pixels that have four neighbours, `[H, W, 1 or 3]`.
///
/// # Errors
/// A side below 3 pixels, a number of channels other than 1 and 3, a value that is not finite.
pub fn laplacian_variance(image: &Image) -> Result<f64, MetricError> {
    let luma = luma(image)?;
    let (width, height) = (luma.width, luma.height);
    let f = |x: usize, y: usize| f64::from(luma.data[y * width + x]);
    let (mut sum, mut squares) = (0.0, 0.0);
    for y in 1..height - 1 {
        for x in 1..width - 1 {
            let v = 4.0 * f(x, y) - f(x - 1, y) - f(x + 1, y) - f(x, y - 1) - f(x, y + 1);
            sum += v;
            squares += v * v;
        }
    }
    let n = ((width - 2) * (height - 2)) as f64;
    Ok((squares / n - (sum / n).powi(2)).max(0.0))
}

/// Share of the spectral energy of the luma, without the mean, at [`HIGH_BAND`] cycles per pixel and above in any direction.
/// In `[0, 1]`; 0 for a constant image.
///
/// # Errors
/// Those of [`laplacian_variance`].
pub fn high_band_share(image: &Image) -> Result<f64, MetricError> {
    let mut luma = luma(image)?;
    let (width, height) = (luma.width, luma.height);
    // The mean would add its rounding to the other bins.
    let mean = luma.data.iter().map(|v| f64::from(*v)).sum::<f64>() / luma.data.len() as f64;
    luma.data.iter_mut().for_each(|v| *v = cast::to_f32(f64::from(*v) - mean));
    let mut fft = Fft2::new(width, height);
    let no_extra = &mut vec![(); fft.half() * height];
    let sums = fft.spectrum(&luma, 0, no_extra, false, |kx, column, _| {
        let u = kx as f64 / width as f64;
        column.iter().enumerate().fold([0.0; 2], |[all, high], (ky, f)| {
            let v = ky.min(height - ky) as f64 / height as f64;
            let energy = f64::from(f.re).powi(2) + f64::from(f.im).powi(2);
            [all + energy, high + if u.hypot(v) >= HIGH_BAND { energy } else { 0.0 }]
        })
    });
    let of = |k: usize| sums.iter().enumerate().map(|(kx, s)| fft.multiplicity(kx) * s[k]).sum::<f64>();
    // Energy of the size of rounding counts as 0.
    let floor = (1e-6 * width as f64 * height as f64).powi(2);
    Ok(if of(0) > floor { of(1) / of(0) } else { 0.0 })
}

/// The luma as an image of one channel.
fn luma(image: &Image) -> Result<Image, MetricError> {
    check_image("a", image)?;
    check_finite("a", image)?;
    let (width, height) = (image.width, image.height);
    if image.channels != 1 && image.channels != 3 {
        return Err(MetricError::Channels { metric: "sharpness", got: image.channels, need: "1 or 3" });
    }
    if width.min(height) < 3 {
        let hint = "the Laplacian needs a neighbour on every side";
        return Err(MetricError::TooSmall { metric: "sharpness", need: 3, width, height, hint });
    }
    Ok(Image { width, height, channels: 1, data: opponent_planes(image).swap_remove(0).data })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// `½ + ¼ cos(2π (mx x / w + my y / h))`.
    fn wave(w: usize, h: usize, mx: usize, my: usize) -> Image {
        let at = |i: usize| {
            let turns = (mx * (i % w)) as f64 / w as f64 + (my * (i / w)) as f64 / h as f64;
            (0.5 + 0.25 * (TAU * turns).cos()) as f32
        };
        Image { width: w, height: h, channels: 1, data: (0..w * h).map(at).collect() }
    }

    fn sum(images: &[&Image]) -> Image {
        let data = (0..images[0].data.len()).map(|k| images.iter().map(|i| i.data[k]).sum::<f32>()).collect();
        Image { data, ..images[0].clone() }
    }

    #[test]
    fn the_high_band_is_separated_from_the_low_one() {
        let (low, high) = (wave(48, 40, 5, 0), wave(48, 40, 0, 14));
        assert!(high_band_share(&low).unwrap() < 1e-9);
        assert!((high_band_share(&high).unwrap() - 1.0).abs() < 1e-9);
        assert!((high_band_share(&sum(&[&low, &high])).unwrap() - 0.5).abs() < 1e-6);
        // Neither axis alone is high, both together are: hypot(9/48, 8/40) = 0.274.
        assert!((high_band_share(&wave(48, 40, 9, 8)).unwrap() - 1.0).abs() < 1e-9);
        let constant = Image { width: 9, height: 7, channels: 3, data: vec![0.7; 189] };
        assert_eq!((high_band_share(&constant).unwrap(), laplacian_variance(&constant).unwrap() < 1e-12), (0.0, true));
        let s = Sharpness::of(&constant, &constant).unwrap();
        assert_eq!(s.high_band, None);
    }

    /// A wave along x is an eigenvector of the Laplacian: `2 − 2 cos ω` times itself.
    #[test]
    fn the_laplacian_of_a_wave_is_known() {
        let (w, h, m) = (66, 20, 8);
        let omega = TAU * m as f64 / w as f64;
        let inner: Vec<f64> = (1..w - 1).map(|x| (2.0 - 2.0 * omega.cos()) * 0.25 * (omega * x as f64).cos()).collect();
        let mean = inner.iter().sum::<f64>() / inner.len() as f64;
        let want = inner.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / inner.len() as f64;
        assert!((laplacian_variance(&wave(w, h, m, 0)).unwrap() / want - 1.0).abs() < 1e-5);
    }

    #[test]
    fn a_blur_lowers_both_and_noise_raises_both() {
        let truth = sum(&[&wave(64, 64, 3, 2), &wave(64, 64, 20, 9), &wave(64, 64, 2, 25)]);
        let half = |i: &Image| {
            let next = |k: usize| i.data[k / 64 * 64 + (k + 1) % 64];
            Image { data: (0..4096).map(|k| 0.5 * (i.data[k] + next(k))).collect(), ..i.clone() }
        };
        let blurred = Sharpness::of(&half(&truth), &truth).unwrap();
        let sharper = Sharpness::of(&truth, &half(&truth)).unwrap();
        let [a, b] = [blurred.laplacian.unwrap(), blurred.high_band.unwrap()];
        assert!(a < 0.95 && b < 0.95, "{a} {b}");
        assert!((sharper.laplacian.unwrap() * a - 1.0).abs() < 1e-9);
        assert_eq!(Sharpness::of(&truth, &truth).unwrap(), Sharpness { laplacian: Some(1.0), high_band: Some(1.0) });
    }

    #[test]
    fn bad_input_is_an_error() {
        let small = Image::zeros(2, 9, 3);
        assert!(matches!(Sharpness::of(&small, &small), Err(MetricError::TooSmall { need: 3, .. })));
        assert!(matches!(high_band_share(&Image::zeros(9, 9, 2)), Err(MetricError::Channels { got: 2, .. })));
        let mut bad = Image::zeros(9, 9, 1);
        bad.data[12] = f32::NAN;
        assert!(matches!(laplacian_variance(&bad), Err(MetricError::NotFinite { x: 3, y: 1, .. })));
    }
}
