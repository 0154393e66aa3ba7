//! How frames are compared, in words.

use super::Scoring;
use gs_metrics::Quantise;

/// How the frames were compared, in words, for the report.
pub const PROTOCOL: &str = "f32 frames clamped to [0, 1], not quantised; SSIM 11x11 with zero padding; perceptual_proxy is not LPIPS; masked scores \
     where views carry masks: PSNR over weighted pixels, SSIM by partial convolution (DyCheck)";

/// What is added for [`FittedScores`](super::FittedScores).
const FITTED: &str =
    "; fitted: after the linear map of colours that brings each frame nearest to its image by least squares";

/// The same for maps with offsets.
const FITTED_WITH_OFFSET: &str = "; fitted: after the affine map of colours, an offset included, that brings each frame nearest to its image by least squares";

/// What is added for images of half size.
const HALF: &str = "; all reduced to half size by means of areas of 2x2 pixels before they are scored";

/// [`PROTOCOL`] of frames that are rounded or reduced, and of scores in the colours of the images, mapped with an offset or without.
pub(super) fn protocol(scoring: &Scoring<'_>, offset: bool) -> String {
    let of = |given: bool, words: &'static str| if given { words } else { "" };
    let fitted = if offset { FITTED_WITH_OFFSET } else { FITTED };
    format!("{}{}{}", rounded(scoring.quantise), of(scoring.half, HALF), of(scoring.fit_colors, fitted))
}

fn rounded(quantise: Quantise) -> String {
    let rounded = match quantise {
        Quantise::None => return PROTOCOL.to_owned(),
        Quantise::Round => "frames and ground-truth images clamped to [0, 1] and rounded to 8 bit",
        Quantise::Truncate => "frames clamped to [0, 1] and truncated to 8 bit, ground-truth images rounded",
    };
    PROTOCOL.replace("f32 frames clamped to [0, 1], not quantised", rounded)
}
