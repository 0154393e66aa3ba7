//! Scores of a view, and their means over the views of a split.

use super::{FittedScores, MaskedScores};
use crate::cameras::Correction;
use gs_core::Image;
use gs_data::View;
use gs_metrics::{Lpips, Mean, MetricError, Scores, Sharpness, Summary};
use serde::{Deserialize, Serialize};

/// The scores of one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewScores {
    /// Name of the view in its data set.
    pub name: String,
    /// Normalised time of the view.
    pub time: f32,
    /// dB; absent for a perfect view (infinite).
    pub psnr: Option<f64>,
    /// SSIM, at most 1 (equal).
    pub ssim: f64,
    /// Multi-scale SSIM; absent where a side is at most 160 pixels.
    pub ms_ssim: Option<f64>,
    /// The weight-free perceptual distance of gs-metrics.
    pub perceptual_proxy: f64,
    /// LPIPS, where it was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips: Option<f64>,
    /// Variance of the Laplacian over that of the image: below 1 blurred; absent where the image is even.
    #[serde(default)]
    pub laplacian_ratio: Option<f64>,
    /// Share of high frequencies over that of the image, likewise.
    #[serde(default)]
    pub high_band_ratio: Option<f64>,
    /// Scores where the view's mask counts; absent without a mask, or with an empty one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub masked: Option<MaskedScores>,
    /// Scores in the colours of the image, where those were asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fitted: Option<FittedScores>,
    /// The correction that the view's camera was rendered with, where cameras were refined.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<Correction>,
}

/// Means of [`ViewScores`] over the views of a split.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeanScores {
    /// Mean of the finite PSNRs, dB.
    pub psnr: Option<f64>,
    /// Mean SSIM; absent without views.
    pub ssim: Option<f64>,
    /// Mean MS-SSIM of the views that have one.
    pub ms_ssim: Option<f64>,
    /// Mean perceptual distance; absent without views.
    pub perceptual_proxy: Option<f64>,
    /// Mean LPIPS, where it was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips: Option<f64>,
    /// Mean ratio of Laplacian variances of the views that have one.
    #[serde(default)]
    pub laplacian_ratio: Option<f64>,
    /// Mean ratio of high-frequency shares, likewise.
    #[serde(default)]
    pub high_band_ratio: Option<f64>,
    /// Means of the masked scores, where views have them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub masked: Option<MaskedScores>,
    /// Means of the scores in the colours of the images, where those were asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fitted: Option<FittedScores>,
}

impl ViewScores {
    /// Of a frame and its image, both rounded and reduced as the scoring says.
    pub(super) fn of(
        view: &View,
        scores: &Scores,
        [image, truth]: [&Image; 2],
        mask: Option<&Image>,
        lpips: Option<&Lpips>,
    ) -> Result<Self, MetricError> {
        // Images too small for a Laplacian have no sharpness.
        let sharpness = Sharpness::of(image, truth).ok();
        Ok(Self {
            name: view.name.clone(),
            time: view.time.normalised,
            psnr: scores.psnr.is_finite().then_some(scores.psnr),
            ssim: scores.ssim,
            ms_ssim: scores.ms_ssim,
            perceptual_proxy: scores.perceptual_proxy,
            lpips: lpips.map(|lpips| lpips.distance(image, truth)).transpose()?,
            laplacian_ratio: sharpness.and_then(|s| s.laplacian),
            high_band_ratio: sharpness.and_then(|s| s.high_band),
            camera: None,
            fitted: None,
            masked: mask.map(|m| MaskedScores::of(image, truth, m, lpips)).transpose()?.flatten(),
        })
    }

    /// The scores whose means are taken, with the mean squared error.
    pub(super) fn with_mse(&self, mse: f64) -> Scores {
        let psnr = self.psnr.unwrap_or(f64::INFINITY);
        Scores { mse, psnr, ssim: self.ssim, ms_ssim: self.ms_ssim, perceptual_proxy: self.perceptual_proxy }
    }
}

/// Means over views; `summary` is of the same views.
pub(super) fn mean_scores(summary: &Summary, views: &[ViewScores]) -> MeanScores {
    let mean = |ratio: fn(&ViewScores) -> Option<f64>| Mean::of(views.iter().filter_map(ratio)).value;
    MeanScores {
        psnr: summary.mean_psnr.value,
        ssim: summary.ssim.value,
        ms_ssim: summary.ms_ssim.value,
        perceptual_proxy: summary.perceptual_proxy.value,
        lpips: mean(|v| v.lpips),
        laplacian_ratio: mean(|v| v.laplacian_ratio),
        high_band_ratio: mean(|v| v.high_band_ratio),
        masked: MaskedScores::mean(views.iter().filter_map(|v| v.masked)),
        fitted: FittedScores::mean(views.iter().filter_map(|v| v.fitted)),
    }
}
