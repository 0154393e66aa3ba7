//! Scores where the mask of a view counts.

use gs_core::Image;
use gs_metrics::{
    Lpips, Mean, MetricError, masked_mse, masked_perceptual_proxy, masked_ssim, person_scores, psnr_from_mse,
};
use serde::{Deserialize, Serialize};

/// Scores where the mask of a view counts, or their means over the views that have one with any weight.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MaskedScores {
    /// dB; absent for no error (infinite).
    pub psnr: Option<f64>,
    /// SSIM over the whole map, where places that see nothing of the mask count 1: the published number. Absent where a
    /// side has less than 11 pixels.
    pub ssim: Option<f64>,
    /// SSIM over places that see something of the mask.
    pub ssim_seen: Option<f64>,
    /// The weight-free perceptual distance under the mask; not LPIPS.
    pub perceptual_proxy: f64,
    /// Part of the pixels that count.
    pub part: f64,
    /// PSNR over the whole frame, both images black outside the eroded mask: as papers on avatars report it
    /// ([`gs_metrics::person`]), dB. Absent for no error.
    #[serde(default)]
    pub frame_psnr: Option<f64>,
    /// SSIM by the same protocol, over the box of the mask.
    #[serde(default)]
    pub box_ssim: Option<f64>,
    /// LPIPS by DyCheck's protocol ([`Lpips::masked`]), where it was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips: Option<f64>,
}

impl MaskedScores {
    /// The scores of an image against its truth, `[H, W, 3]`, where `mask`, `[H, W, 1]`, counts. None for an empty mask.
    ///
    /// # Errors
    /// Different shapes, a mask of another shape or with negative weights, a value that is not finite, or those of [`Lpips::masked`].
    pub fn of(image: &Image, truth: &Image, mask: &Image, lpips: Option<&Lpips>) -> Result<Option<Self>, MetricError> {
        let mse = match masked_mse(image, truth, mask) {
            Err(MetricError::EmptyMask) => return Ok(None),
            other => other?,
        };
        let ssim = match masked_ssim(image, truth, mask) {
            Err(MetricError::TooSmall { .. }) => None,
            other => Some(other?),
        };
        let person = person_scores(image, truth, mask)?;
        Ok(Some(Self {
            frame_psnr: Some(psnr_from_mse(person.mse)).filter(|v| v.is_finite()),
            box_ssim: person.ssim,
            lpips: lpips.map(|lpips| lpips.masked(image, truth, mask)).transpose()?,
            psnr: Some(psnr_from_mse(mse)).filter(|v| v.is_finite()),
            ssim: ssim.map(|s| s.whole),
            ssim_seen: ssim.map(|s| s.seen),
            perceptual_proxy: masked_perceptual_proxy(image, truth, mask)?,
            part: mask.data.iter().map(|w| f64::from(*w)).sum::<f64>() / mask.data.len() as f64,
        }))
    }

    /// Means over views, each over those that have a value; none without any.
    pub fn mean(all: impl Iterator<Item = Self> + Clone) -> Option<Self> {
        let of = |value: fn(&Self) -> Option<f64>| Mean::of(all.clone().filter_map(|s| value(&s))).value;
        Some(Self {
            part: of(|s| Some(s.part))?,
            frame_psnr: of(|s| s.frame_psnr),
            box_ssim: of(|s| s.box_ssim),
            lpips: of(|s| s.lpips),
            psnr: of(|s| s.psnr),
            ssim: of(|s| s.ssim),
            ssim_seen: of(|s| s.ssim_seen),
            perceptual_proxy: of(|s| Some(s.perceptual_proxy))?,
        })
    }
}
