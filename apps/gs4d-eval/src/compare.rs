//! Scores of images against ground truth, with or without masks.
//!
//! PSNR in dB for a data range of 1; SSIM with an 11-tap Gaussian window and zeros outside, as the 3DGS family evaluates.
//! A mask adds masked scores: PSNR and SSIM of DyCheck ([`gs_metrics::masked`]) and the masked proxy.

use gs_core::Image;
use gs_metrics::{
    Lpips, Mean, MetricError, MsSsim, MsSsimOptions, Ssim, SsimOptions, mse, perceptual_proxy, psnr_from_mse,
    psnr_of_mean_mse,
};
use gs_train::evaluate::MaskedScores;
use serde::Serialize;

/// A metric of whole images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Metric {
    /// Peak signal-to-noise ratio, dB, for a data range of 1.
    Psnr,
    /// Structural similarity, 11-tap Gaussian window.
    Ssim,
    /// Multi-scale SSIM; needs both sides above 160 pixels.
    MsSsim,
    /// Weight-free perceptual distance; not LPIPS.
    PerceptualProxy,
}

impl Metric {
    /// Every metric, in the order of tables.
    pub const ALL: [Metric; 4] = [Metric::Psnr, Metric::Ssim, Metric::MsSsim, Metric::PerceptualProxy];
}

/// The scores of one image; `None` for metrics that were not requested or have no value.
#[derive(Clone, Debug, PartialEq, Default, Serialize)]
pub struct ImageScores {
    /// Name of the image, without extension.
    pub name: String,
    /// Whether the image equals its ground truth.
    #[serde(skip)]
    pub perfect: bool,
    /// Mean squared error over pixels and channels; absent if PSNR was not asked for.
    #[serde(skip)]
    pub mse: Option<f64>,
    /// PSNR, dB; absent where it is infinite, or not asked for.
    pub psnr: Option<f64>,
    /// SSIM, at most 1; absent if not asked for.
    pub ssim: Option<f64>,
    /// MS-SSIM, at most 1; absent if not asked for.
    pub ms_ssim: Option<f64>,
    /// Perceptual distance without weights, not LPIPS; less is better.
    pub perceptual_proxy: Option<f64>,
    /// LPIPS; absent if not asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lpips: Option<f64>,
    /// Scores within the mask; absent without mask, or with an empty one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub masked: Option<MaskedScores>,
}

/// Means of the scores over the images of a set.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Means {
    /// Mean of the finite PSNRs, dB.
    pub psnr: Option<f64>,
    /// Mean SSIM; absent if not asked for.
    pub ssim: Option<f64>,
    /// Mean MS-SSIM; absent if not asked for.
    pub ms_ssim: Option<f64>,
    /// Mean perceptual distance; absent if not asked for.
    pub perceptual_proxy: Option<f64>,
    /// Mean LPIPS; absent if not asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lpips: Option<f64>,
    /// Means of the masked scores, where there are masks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub masked: Option<MaskedScores>,
}

/// The scores of a set of images.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SetScores {
    /// Means of the scores over the images.
    pub mean: Means,
    /// PSNR of the mean squared error over all images, dB; absent where it is infinite.
    pub psnr_of_mean_mse: Option<f64>,
    /// Number of images equal to their ground truth; they are left out of the mean PSNR.
    pub perfect_views: usize,
    /// The scores of each image.
    pub views: Vec<ImageScores>,
}

/// Scores images one by one.
///
/// ```
/// use gs_core::Image;
/// use gs4d_eval::compare::{Comparer, Metric};
///
/// let grey = |v| Image { width: 16, height: 16, channels: 3, data: vec![v; 768] };
/// let mut comparer = Comparer::new(&[Metric::Psnr]);
/// comparer.add("a", &grey(0.5), &grey(0.25), None)?;
/// comparer.add("b", &grey(0.5), &grey(0.5), None)?;
/// let scores = comparer.finish();
/// assert_eq!((scores.views[0].mse, scores.perfect_views), (Some(0.0625), 1));
/// # Ok::<(), gs_metrics::MetricError>(())
/// ```
#[derive(Debug)]
pub struct Comparer {
    metrics: Vec<Metric>,
    lpips: Option<Lpips>,
    ssim: Ssim,
    ms_ssim: MsSsim,
    views: Vec<ImageScores>,
}

impl Comparer {
    /// A comparer for these metrics.
    pub fn new(metrics: &[Metric]) -> Self {
        let ssim = Ssim::new(SsimOptions::default());
        Self { metrics: metrics.to_vec(), lpips: None, ssim, ms_ssim: MsSsim::default(), views: Vec::new() }
    }

    /// The same with LPIPS, if there is one.
    pub fn with_lpips(self, lpips: Option<Lpips>) -> Self {
        Self { lpips, ..self }
    }

    /// Scores an image `[H, W, C]` against its ground truth, and within the mask `[H, W, 1]` if there is one.
    ///
    /// # Errors
    /// If shapes differ, values are not finite, or an image is too small for SSIM.
    pub fn add(&mut self, name: &str, image: &Image, truth: &Image, mask: Option<&Image>) -> Result<(), MetricError> {
        let mut scores =
            ImageScores { name: name.to_owned(), perfect: image.data == truth.data, ..ImageScores::default() };
        for metric in self.metrics.clone() {
            match metric {
                Metric::Psnr => scores.mse = Some(mse(image, truth)?),
                Metric::Ssim => scores.ssim = Some(self.ssim.value(image, truth)?),
                Metric::MsSsim if image.width.min(image.height) > MsSsimOptions::default().side_limit() => {
                    scores.ms_ssim = Some(self.ms_ssim.value(image, truth)?);
                }
                Metric::MsSsim => {}
                Metric::PerceptualProxy => scores.perceptual_proxy = Some(perceptual_proxy(image, truth)?),
            }
        }
        scores.lpips = self.lpips.as_ref().map(|lpips| lpips.distance(image, truth)).transpose()?;
        scores.masked = mask.map(|m| MaskedScores::of(image, truth, m, self.lpips.as_ref())).transpose()?.flatten();
        scores.psnr = scores.mse.map(psnr_from_mse).filter(|p| p.is_finite());
        self.views.push(scores);
        Ok(())
    }

    /// The scores of all images, and their means.
    pub fn finish(self) -> SetScores {
        let mean = |value: fn(&ImageScores) -> Option<f64>| Mean::of(self.views.iter().filter_map(value)).value;
        let mses: Vec<f64> = self.views.iter().filter_map(|v| v.mse).collect();
        SetScores {
            mean: Means {
                psnr: mean(|v| v.psnr),
                ssim: mean(|v| v.ssim),
                ms_ssim: mean(|v| v.ms_ssim),
                perceptual_proxy: mean(|v| v.perceptual_proxy),
                lpips: mean(|v| v.lpips),
                masked: MaskedScores::mean(self.views.iter().filter_map(|v| v.masked)),
            },
            psnr_of_mean_mse: psnr_of_mean_mse(&mses).filter(|p| p.is_finite()),
            perfect_views: self.views.iter().filter(|v| v.perfect).count(),
            views: self.views,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(v: f32) -> Image {
        Image { width: 24, height: 16, channels: 3, data: vec![v; 24 * 16 * 3] }
    }

    #[test]
    fn perfect_images_are_counted_and_means_are_of_the_rest() {
        let mut c = Comparer::new(&Metric::ALL);
        c.add("same", &flat(0.5), &flat(0.5), None).unwrap();
        c.add("off", &flat(0.5), &flat(0.6), None).unwrap();
        let s = c.finish();
        let mut unasked = Comparer::new(&[Metric::Ssim]);
        unasked.add("same", &flat(0.5), &flat(0.5), None).unwrap();
        let unasked = unasked.finish();
        assert_eq!((unasked.perfect_views, unasked.mean.psnr, unasked.psnr_of_mean_mse), (1, None, None));
        assert!((s.mean.psnr.unwrap() - 20.0).abs() < 1e-4 && s.perfect_views == 1 && s.views[0].psnr.is_none());
        assert!((s.psnr_of_mean_mse.unwrap() - psnr_from_mse(0.005)).abs() < 1e-4);
        assert_eq!((s.views[0].ssim, s.mean.ms_ssim), (Some(1.0), None));
    }

    #[test]
    fn masks_score_apart_and_metrics_are_chosen() {
        let mut image = flat(0.5);
        image.pixel_mut(0, 0).fill(1.0);
        let mut mask = Image { width: 24, height: 16, channels: 1, data: vec![1.0; 24 * 16] };
        mask.data[0] = 0.0;
        let mut c = Comparer::new(&[Metric::Psnr]);
        c.add("a", &image, &flat(0.5), Some(&mask)).unwrap();
        let s = c.finish();
        assert_eq!((s.perfect_views, s.mean.ssim, s.mean.perceptual_proxy), (0, None, None));
        let masked = s.mean.masked.unwrap();
        assert_eq!((masked.psnr, masked.ssim, masked.perceptual_proxy), (None, Some(1.0), 0.0));
        assert!(s.mean.psnr.unwrap() < 40.0, "the whole image has an error");
        assert!(Comparer::new(&[Metric::Psnr]).add("a", &image, &Image::zeros(3, 3, 3), None).is_err());
    }
}
