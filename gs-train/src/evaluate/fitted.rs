//! Scores in the colours of the images.

use super::Scoring;
use crate::loss::{fit_before, map_before};
use gs_core::Image;
use gs_metrics::{Mean, MetricError, SsimOptions, masked_mse, masked_ssim, mse, psnr_from_mse, ssim};
use gs_raster::Frame;
use serde::{Deserialize, Serialize};

/// Ridge of the maps of [`FittedScores`]: only what the pixels do not tell stays as it is.
const FIT_RIDGE: f64 = 1e-9;

/// Scores after the map of colours that brings a frame nearest to its image by least squares ([`gs_metrics::ColorMap`]): affine where the schedule has
/// [`offset`](crate::loss::ExposureConfig::offset), else linear. Where a view has a mask, of what counts there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FittedScores {
    /// dB; absent for no error (infinite).
    pub psnr: Option<f64>,
    /// SSIM; absent where a masked side has less than 11 pixels.
    pub ssim: Option<f64>,
    /// Whether the maps have offsets.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub offset: bool,
}

impl FittedScores {
    /// Of a frame, not clamped, and its image, both over the background of the scoring; rounded as it says. None for an empty mask.
    pub(super) fn of(
        frame: &Frame,
        scoring: &Scoring<'_>,
        truth: &Image,
        mask: Option<&Image>,
        offset: bool,
    ) -> Result<Option<Self>, MetricError> {
        if mask.is_some_and(|m| m.data.iter().all(|w| *w <= 0.0)) {
            return Ok(None);
        }
        let background = scoring.background;
        let mut fitted = Image::default();
        let map = fit_before(frame, background, truth, mask, FIT_RIDGE, offset, &mut fitted)?;
        map_before(&map, frame, background, &mut fitted);
        fitted.data.iter_mut().for_each(|v| *v = v.clamp(0.0, 1.0));
        scoring.quantise.apply(&mut fitted);
        let (mse, ssim) = match mask {
            Some(mask) => (masked_mse(&fitted, truth, mask), masked_ssim(&fitted, truth, mask).ok().map(|s| s.whole)),
            None => (mse(&fitted, truth), Some(ssim(&fitted, truth, &SsimOptions::default())?)),
        };
        Ok(Some(Self { psnr: Some(psnr_from_mse(mse?)).filter(|v| v.is_finite()), ssim, offset }))
    }

    /// Means over views, each over those that have a value; none without any.
    pub(super) fn mean(all: impl Iterator<Item = Self> + Clone) -> Option<Self> {
        let of = |score: fn(Self) -> Option<f64>| Mean::of(all.clone().filter_map(score)).value;
        all.clone().next().map(|first| Self { psnr: of(|s| s.psnr), ssim: of(|s| s.ssim), offset: first.offset })
    }

    /// What the frames were brought to, in words.
    pub fn colors(&self) -> &'static str {
        if self.offset { "in the colours of the images, offsets included" } else { "in the colours of the images" }
    }
}
