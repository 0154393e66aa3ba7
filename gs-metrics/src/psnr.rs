//! Mean squared error and peak signal-to-noise ratio.
//!
//! `mse = Σ (a − b)² / (H·W·C)`, `psnr = −10 log10(mse)` dB for a data range of 1. Identical images have `mse = 0` and
//! `psnr = +∞`. Over a set of views two averages are in use, which differ (Jensen): the **mean of the PSNRs**, in dB, which
//! the 3DGS family reports, and the **PSNR of the mean error**. [`crate::report`] gives both.
//!
//! Differences are taken in `f64` and summed in chunks of fixed length and order: the value is bitwise the same for any
//! number of threads.
//!
//! ```
//! use gs_core::Image;
//! use gs_metrics::{mse, psnr, psnr_of_mean_mse};
//! let black = Image::zeros(8, 8, 3);
//! let grey = Image { data: vec![0.5; 192], ..black.clone() };
//! assert_eq!(mse(&black, &grey)?, 0.25);
//! assert!((psnr(&black, &grey)? - 6.0206).abs() < 1e-4);
//! assert_eq!(psnr(&grey, &grey)?, f64::INFINITY);
//! assert_eq!(psnr_of_mean_mse(&[0.01, 0.19]), Some(10.0));
//! # Ok::<(), gs_metrics::MetricError>(())
//! ```

use gs_core::Image;
use rayon::prelude::*;

use crate::error::{MetricError, check_pair, explain_non_finite};

/// Number of values of one partial sum.
const CHUNK: usize = 1 << 14;
/// Independent accumulators of one chunk.
const LANES: usize = 16;

/// Mean squared difference over pixels and channels of two `[H, W, C]` images; 0 for identical ones.
///
/// # Errors
/// Different shapes, no pixels, more than 4 channels, or a value that is not finite.
pub fn mse(a: &Image, b: &Image) -> Result<f64, MetricError> {
    check_pair(a, b)?;
    let partial: Vec<f64> =
        a.data.par_chunks(CHUNK).zip(b.data.par_chunks(CHUNK)).map(|(x, y)| sum_of_squares(x, y)).collect();
    let mean = partial.iter().sum::<f64>() / a.data.len() as f64;
    if mean.is_finite() { Ok(mean) } else { Err(explain_non_finite("MSE", a, b)) }
}

/// `Σ (x − y)²` with [`LANES`] accumulators joined in order.
fn sum_of_squares(x: &[f32], y: &[f32]) -> f64 {
    let mut lanes = [0.0f64; LANES];
    let (xs, ys) = (x.chunks_exact(LANES), y.chunks_exact(LANES));
    let (x_tail, y_tail) = (xs.remainder(), ys.remainder());
    for (x, y) in xs.zip(ys) {
        for k in 0..LANES {
            let d = f64::from(x[k]) - f64::from(y[k]);
            lanes[k] += d * d;
        }
    }
    for (k, (x, y)) in x_tail.iter().zip(y_tail).enumerate() {
        let d = f64::from(*x) - f64::from(*y);
        lanes[k] += d * d;
    }
    lanes.iter().sum()
}

/// `−10 log10(mse)` in dB for a data range of 1; `+∞` for an error of 0, NaN for a negative or NaN one.
pub fn psnr_from_mse(mse: f64) -> f64 {
    -10.0 * mse.log10()
}

/// Peak signal-to-noise ratio of two `[H, W, C]` images of data range 1, in dB: `+∞` for identical images.
///
/// # Errors
/// Those of [`mse`].
pub fn psnr(a: &Image, b: &Image) -> Result<f64, MetricError> {
    mse(a, b).map(psnr_from_mse)
}

/// PSNR in dB of the mean of the views' errors, `−10 log10(mean mse)`: at most the mean of the views' PSNRs, and finite
/// unless every error is 0. `None` for no views.
pub fn psnr_of_mean_mse(mses: &[f64]) -> Option<f64> {
    let sum: f64 = mses.iter().sum();
    (!mses.is_empty()).then(|| psnr_from_mse(sum / mses.len() as f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    fn noise(w: usize, h: usize, c: usize, seed: u64) -> Image {
        let mut rng = Rng::new(seed, "psnr test", 0, 0);
        let data = (0..w * h * c).map(|_| rng.uniform()).collect();
        Image { width: w, height: h, channels: c, data }
    }

    #[test]
    fn known_values() {
        let a = Image::zeros(40, 40, 3);
        let mut b = a.clone();
        assert_eq!(psnr(&a, &b).unwrap(), f64::INFINITY);
        b.data.fill(0.5);
        assert!((psnr(&a, &b).unwrap() - 10.0 * 4f64.log10()).abs() < 1e-12);
        b.data.fill(1.0);
        assert_eq!(psnr(&a, &b).unwrap(), 0.0);
        b.data[17] = f32::NAN;
        assert_eq!(psnr(&a, &b).unwrap_err(), MetricError::NotFinite { which: "b", x: 5, y: 0, channel: 2 });
        b.data[17] = f32::INFINITY;
        assert!(psnr(&a, &b).is_err() && psnr(&b, &b).is_err());
    }

    #[test]
    fn every_length_agrees_with_a_plain_loop_for_any_pool() {
        for n in (1..40).chain([CHUNK - 1, CHUNK + 1, 3 * CHUNK + 7]) {
            let (a, b) = (noise(n, 1, 1, 1), noise(n, 1, 1, 2));
            let plain: f64 = a.data.iter().zip(&b.data).map(|(x, y)| (f64::from(*x) - f64::from(*y)).powi(2)).sum();
            let got = mse(&a, &b).unwrap();
            assert!((got - plain / n as f64).abs() < 1e-13, "{n}");
            for threads in [1, 2, 4] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                assert_eq!(pool.install(|| mse(&a, &b).unwrap()).to_bits(), got.to_bits());
            }
        }
    }

    #[test]
    fn the_two_averages_differ() {
        let mses = [0.01, 0.0001];
        let mean: f64 = mses.iter().map(|m| psnr_from_mse(*m)).sum::<f64>() / 2.0;
        assert!((mean - 30.0).abs() < 1e-12);
        assert!((psnr_of_mean_mse(&mses).unwrap() - 22.967_086).abs() < 1e-6);
        assert_eq!(psnr_of_mean_mse(&[]), None);
        assert_eq!(psnr_of_mean_mse(&[0.0]), Some(f64::INFINITY));
        assert!(psnr_from_mse(f64::NAN).is_nan());
    }
}
