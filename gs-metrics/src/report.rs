//! Scores of views and their means.
//!
//! A view without error has a PSNR of `+∞`. Means are therefore over the **finite** values, with counts of the infinite and of
//! the NaN values that were left out.
//!
//! ```
//! use gs_core::Image;
//! use gs_metrics::{Scorer, SsimOptions, Summary};
//! let flat = |v: f32| Image { width: 32, height: 32, channels: 3, data: vec![v; 3072] };
//! let mut scorer = Scorer::new(SsimOptions::default());
//! let scores = [scorer.score(&flat(0.5), &flat(0.5))?, scorer.score(&flat(0.5), &flat(0.6))?];
//! let summary = Summary::of(&scores);
//! assert_eq!((summary.views, summary.mean_psnr.finite, summary.mean_psnr.infinite), (2, 1, 1));
//! assert_eq!(summary.mean_psnr.to_string(), "20.0000 (1 infinite)");
//! # Ok::<(), gs_metrics::MetricError>(())
//! ```

use gs_core::Image;

use crate::error::MetricError;
use crate::ms_ssim::{MsSsim, MsSsimOptions};
use crate::perceptual::perceptual_proxy;
use crate::psnr::{mse, psnr_from_mse, psnr_of_mean_mse};
use crate::ssim::{Ssim, SsimOptions};

/// A mean of finite values, with counts of the values left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mean {
    /// Mean of the finite values; `None` if there are none.
    pub value: Option<f64>,
    /// Number of values in the mean.
    pub finite: usize,
    /// Number of infinite values left out (for PSNR: views without error).
    pub infinite: usize,
    /// Number of NaN values left out.
    pub nan: usize,
}

impl Mean {
    /// The mean of the finite ones among `values`, added in order.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut out = Self { value: None, finite: 0, infinite: 0, nan: 0 };
        let mut sum = 0.0;
        for v in values {
            if v.is_finite() {
                sum += v;
                out.finite += 1;
            } else if v.is_nan() {
                out.nan += 1;
            } else {
                out.infinite += 1;
            }
        }
        out.value = (out.finite > 0).then(|| sum / out.finite as f64);
        out
    }
}

impl std::fmt::Display for Mean {
    /// The value to four places, and the counts left out if there are any: `31.2046 (1 infinite)`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.value {
            Some(v) => write!(f, "{v:.4}")?,
            None if self.infinite > 0 => write!(f, "inf")?,
            None => write!(f, "none")?,
        }
        match (self.infinite, self.nan) {
            (0, 0) => Ok(()),
            (i, 0) => write!(f, " ({i} infinite)"),
            (0, n) => write!(f, " ({n} NaN)"),
            (i, n) => write!(f, " ({i} infinite, {n} NaN)"),
        }
    }
}

/// All scores of one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scores {
    /// Mean squared error over pixels and channels, data range 1.
    pub mse: f64,
    /// PSNR in dB, `+∞` for identical images.
    pub psnr: f64,
    /// Mean SSIM with the options of the [`Scorer`].
    pub ssim: f64,
    /// MS-SSIM of five levels; `None` where a side is at most 160 pixels.
    pub ms_ssim: Option<f64>,
    /// The weight-free [proxy](crate::perceptual); not LPIPS.
    pub perceptual_proxy: f64,
}

/// Scores one view after another and keeps its buffers.
#[derive(Clone, Debug, Default)]
pub struct Scorer {
    ssim: Ssim,
    ms_ssim: MsSsim,
}

impl Scorer {
    /// A scorer with the given options of SSIM; MS-SSIM has its defaults.
    pub fn new(options: SsimOptions) -> Self {
        Self { ssim: Ssim::new(options), ms_ssim: MsSsim::default() }
    }

    /// All scores of a render against its ground-truth image, both `[H, W, 1 or 3]` in `[0, 1]`.
    ///
    /// # Errors
    /// Those of the metrics. An image too small for MS-SSIM is no error: its [`Scores::ms_ssim`] is `None`.
    pub fn score(&mut self, image: &Image, truth: &Image) -> Result<Scores, MetricError> {
        let mse = mse(image, truth)?;
        let large = image.width.min(image.height) > MsSsimOptions::default().side_limit();
        Ok(Scores {
            mse,
            psnr: psnr_from_mse(mse),
            ssim: self.ssim.value(image, truth)?,
            ms_ssim: if large { Some(self.ms_ssim.value(image, truth)?) } else { None },
            perceptual_proxy: perceptual_proxy(image, truth)?,
        })
    }
}

/// Means of [`Scores`] over views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Number of views that were scored.
    pub views: usize,
    /// Mean of the PSNRs of the views in dB, as papers of the 3DGS family report it; views without error are counted apart.
    pub mean_psnr: Mean,
    /// PSNR in dB of the mean MSE of the views; `+∞` if all errors are 0, `None` for no views.
    pub psnr_of_mean_mse: Option<f64>,
    /// Mean of [`Scores::ssim`] over all views.
    pub ssim: Mean,
    /// Mean MS-SSIM over the views that are large enough for it.
    pub ms_ssim: Mean,
    /// Mean of the perceptual proxy.
    pub perceptual_proxy: Mean,
}

impl Summary {
    /// Means of `scores`, added in order.
    pub fn of(scores: &[Scores]) -> Self {
        let mses: Vec<f64> = scores.iter().map(|s| s.mse).collect();
        Self {
            views: scores.len(),
            mean_psnr: Mean::of(scores.iter().map(|s| s.psnr)),
            psnr_of_mean_mse: psnr_of_mean_mse(&mses),
            ssim: Mean::of(scores.iter().map(|s| s.ssim)),
            ms_ssim: Mean::of(scores.iter().filter_map(|s| s.ms_ssim)),
            perceptual_proxy: Mean::of(scores.iter().map(|s| s.perceptual_proxy)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(v: f32) -> Image {
        Image { width: 32, height: 32, channels: 3, data: vec![v; 3072] }
    }

    #[test]
    fn infinities_and_nan_are_counted_not_averaged() {
        let m = Mean::of([20.0, f64::INFINITY, 30.0, f64::NAN]);
        assert_eq!(m, Mean { value: Some(25.0), finite: 2, infinite: 1, nan: 1 });
        assert_eq!(m.to_string(), "25.0000 (1 infinite, 1 NaN)");
        assert_eq!(Mean::of([f64::INFINITY]).to_string(), "inf (1 infinite)");
        assert_eq!(Mean::of([]).to_string(), "none");
    }

    #[test]
    fn an_infinite_psnr_is_not_in_the_mean() {
        let mut scorer = Scorer::new(SsimOptions::default());
        let scores = [(0.5, 0.5), (0.5, 0.6), (0.5, 0.51)].map(|(a, b)| scorer.score(&flat(a), &flat(b)).unwrap());
        let s = Summary::of(&scores);
        assert_eq!((s.views, s.mean_psnr.finite, s.mean_psnr.infinite), (3, 2, 1));
        assert!((s.mean_psnr.value.unwrap() - 30.0).abs() < 1e-4);
        assert!((s.psnr_of_mean_mse.unwrap() - psnr_from_mse((0.01 + 0.0001) / 3.0)).abs() < 1e-4);
        assert_eq!((s.ms_ssim.value, scores[0].ssim, scores[0].perceptual_proxy), (None, 1.0, 0.0));
        assert!(Scorer::default().score(&flat(f32::NAN), &flat(0.0)).is_err());
        assert_eq!(Summary::of(&[]).psnr_of_mean_mse, None);
    }
}
