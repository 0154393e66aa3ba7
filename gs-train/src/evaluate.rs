//! Scores of a method on a split of a data set.
//!
//! Frames are compared as they were rendered: `f32`, clamped to `[0, 1]`, not rounded to 8 bit unless [`Scoring::quantise`] asks for it, at full size unless
//! [`Scoring::half`] is set. SSIM is that of the 3DGS
//! family (zeros outside the image). Both averages of PSNR are given: the mean of the views' values (what papers of the
//! family print) and the PSNR of the mean squared error.
//!
//! Views with a mask, and those of filmed people by their coverage, are scored once more where it counts
//! ([`MaskedScores`]: DyCheck's masked PSNR and SSIM, [`gs_metrics::masked`]; DyCheck itself truncates drawings to 8 bit
//! first).

mod placed;

pub use placed::{RefinedCameras, place};

use crate::cameras::Correction;
use crate::device::Device;
use crate::loss::{fit_before, map_before};
use crate::method::MethodError;
use crate::model::Model;
use crate::ranks::{Share, ShareError};
use crate::timestamp::Timestamp;
use gs_core::{Camera, Image, Splats};
use gs_data::{DataError, Dataset, ImageCache, Split, View};
use gs_metrics::{
    Lpips, Mean, MetricError, Quantise, Scorer, Scores, Sharpness, SsimOptions, Summary, half_size, masked_mse,
    masked_perceptual_proxy, masked_ssim, mse, person_scores, psnr_from_mse, ssim,
};
use gs_raster::{DeviceError, Frame, RasterOptions};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// How the frames were compared, in words, for the report.
pub const PROTOCOL: &str = "f32 frames clamped to [0, 1], not quantised; SSIM 11x11 with zero padding; perceptual_proxy is not LPIPS; masked scores \
     where views carry masks: PSNR over weighted pixels, SSIM by partial convolution (DyCheck)";

/// Ridge of the maps of [`FittedScores`]: only what the pixels do not tell stays as it is.
const FIT_RIDGE: f64 = 1e-9;

/// What is added for [`FittedScores`].
const FITTED: &str =
    "; fitted: after the linear map of colours that brings each frame nearest to its image by least squares";

/// The same for maps with offsets.
const FITTED_WITH_OFFSET: &str = "; fitted: after the affine map of colours, an offset included, that brings each frame nearest to its image by least squares";

/// What is added for images of half size.
const HALF: &str = "; all reduced to half size by means of areas of 2x2 pixels before they are scored";

/// [`PROTOCOL`] of frames that are rounded or reduced, and of scores in the colours of the images, mapped with an offset or without.
fn protocol(scoring: &Scoring<'_>, offset: bool) -> String {
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
    fn of(
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

    fn mean(all: impl Iterator<Item = Self> + Clone) -> Option<Self> {
        let of = |score: fn(Self) -> Option<f64>| Mean::of(all.clone().filter_map(score)).value;
        all.clone().next().map(|first| Self { psnr: of(|s| s.psnr), ssim: of(|s| s.ssim), offset: first.offset })
    }

    /// What the frames were brought to, in words.
    pub fn colors(&self) -> &'static str {
        if self.offset { "in the colours of the images, offsets included" } else { "in the colours of the images" }
    }
}

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

/// The scores of a split.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvalReport {
    /// Name of the method, as in its entry.
    pub method: String,
    /// `train`, `val`, `test` or `extrapolate`.
    pub split: String,
    /// Colour behind the scene, in rendering and image alike.
    pub background: [f32; 3],
    /// Factor by which images and cameras were reduced.
    pub scale: f64,
    /// How the frames were compared.
    pub protocol: String,
    /// Network and checksum of the weights of LPIPS, where it was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips_weights: Option<String>,
    /// Means of the scores over `views`.
    pub mean: MeanScores,
    /// PSNR of the mean squared error over views, dB; absent when every view is perfect.
    pub psnr_of_mean_mse: Option<f64>,
    /// Views rendered without any error, left out of the mean PSNR.
    pub perfect_views: usize,
    /// Number of Gaussians the method may render at most.
    pub gaussians: usize,
    /// Bytes of all parameters as `f32`, without gradients and Adam moments.
    pub parameter_bytes: u64,
    /// Seconds of training, where known.
    pub train_seconds: Option<f64>,
    /// The scores of each view.
    pub views: Vec<ViewScores>,
    /// How cameras were corrected, where they were.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cameras: Option<RefinedCameras>,
    /// The scores beyond the last training time, in `metrics.json` of a run whose data have such views.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub extrapolate: Option<Box<EvalReport>>,
}

impl EvalReport {
    /// Mean PSNR beyond the last training time, dB, where it was scored.
    pub fn extrapolated_psnr(&self) -> Option<f64> {
        self.extrapolate.as_ref()?.mean.psnr
    }

    /// Mean over views of a score less that of the same view in another report, over the views that have it in both: of PSNR those that
    /// neither shows without error. The difference of two means would be over different views. None without such a view.
    pub fn less(&self, other: &Self, score: impl Fn(&ViewScores) -> Option<f64>) -> Option<f64> {
        let pairs = self.views.iter().zip(&other.views).filter(|(a, b)| a.name == b.name);
        Mean::of(pairs.filter_map(|(a, b)| Some(score(a)? - score(b)?))).value
    }
}

/// Why a split was not scored.
#[derive(Debug, thiserror::Error)]
pub enum EvalError {
    /// No view in the split.
    #[error("the data set has no {0} views; choose another split")]
    NoViews(&'static str),
    /// An image cannot be read.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The method cannot draw a view.
    #[error("view {view}: {source}")]
    Method {
        /// Name of the view in its data set.
        view: String,
        /// Why the method gave no splats.
        source: Box<MethodError>,
    },
    /// The device that renders failed.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// Another rank that scores views failed.
    #[error(transparent)]
    Rank(#[from] ShareError),
    /// A frame cannot be compared.
    #[error("view {view}: {source}")]
    Metric {
        /// Name of the view in its data set.
        view: String,
        /// Why the images cannot be compared.
        source: MetricError,
    },
}

/// The name of a split.
pub fn split_name(split: Split) -> &'static str {
    match split {
        Split::Train => "train",
        Split::Val => "val",
        Split::Test => "test",
        Split::Extrapolate => "extrapolate",
    }
}

/// Renders every view of a split over `background` and scores it against its image.
///
/// # Errors
/// If the split is empty, an image cannot be read, or a frame is not finite.
pub fn evaluate(
    model: &Model,
    dataset: &Dataset,
    split: Split,
    background: [f32; 3],
    images: &ImageCache,
) -> Result<EvalReport, EvalError> {
    let (share, device) = Default::default();
    evaluate_with(model, dataset, split, &Scoring::new(background, images, &share, &device))
}

/// How views are rendered and scored, and who does it.
#[derive(Clone, Copy)]
pub struct Scoring<'a> {
    /// Colour behind the scene, in rendering and image alike.
    pub background: [f32; 3],
    /// The images of the data.
    pub images: &'a ImageCache,
    /// The ranks that share the work: each view is scored by one of them, and the report is the same on all.
    pub share: &'a Share,
    /// What renders.
    pub device: &'a Device,
    /// Rounding of frames to 8 bit; unless it is [`Quantise::None`], ground-truth images are rounded over their background.
    pub quantise: Quantise,
    /// Reduces frames, ground-truth images and masks to half size before they are scored ([`half_size`]), after rounding.
    pub half: bool,
    /// Scores LPIPS as well.
    pub lpips: Option<&'a Lpips>,
    /// Scores in the colours of the images as well ([`FittedScores`]), which methods that were trained so always get; never at half size.
    pub fit_colors: bool,
    /// Draws as programs draw that know splats alone: 3DGS's dilation, near plane of files, anti-aliased if true; none: as the model was
    /// trained.
    pub plain: Option<bool>,
}

impl<'a> Scoring<'a> {
    /// Frames that are neither rounded nor reduced, without LPIPS, in their own colours.
    pub fn new(background: [f32; 3], images: &'a ImageCache, share: &'a Share, device: &'a Device) -> Self {
        let (quantise, half, lpips, fit_colors, plain) = Default::default();
        Self { background, images, share, device, quantise, half, lpips, fit_colors, plain }
    }

    /// The scores of the frame of a view, and its mean squared error. Of a filmed person, the person counts. Colours are fitted with an offset or without.
    fn of_frame(
        &self,
        view: &View,
        frame: &Frame,
        is_person: bool,
        offset: bool,
        scorer: &mut Scorer,
    ) -> Result<(ViewScores, f64), EvalError> {
        let image = self.images.get(view)?;
        let mut truth = image.over(self.background);
        let mut mask = self.images.mask(view)?.or_else(|| is_person.then(|| Arc::new(image.alpha())));
        let mut rendered = clamped(frame);
        if self.quantise != Quantise::None {
            self.quantise.apply(&mut rendered);
            Quantise::Round.apply(&mut truth);
        }
        if self.half {
            (rendered, truth) = (half_size(&rendered), half_size(&truth));
            mask = mask.map(|mask| Arc::new(half_size(&mask)));
        }
        let mask = mask.as_deref();
        let mut scored = || {
            let scores = scorer.score(&rendered, &truth)?;
            let of = ViewScores::of(view, &scores, [&rendered, &truth], mask, self.lpips)?;
            let fitted = self.fit_colors.then(|| FittedScores::of(frame, self, &truth, mask, offset));
            let fitted = fitted.transpose()?.flatten();
            Ok((ViewScores { fitted, ..of }, scores.mse))
        };
        scored().map_err(|source| EvalError::Metric { view: view.name.clone(), source })
    }
}

/// The same by these ranks on this device.
///
/// # Errors
/// As [`evaluate`], and if another rank or the device fails.
pub fn evaluate_with(
    model: &Model,
    dataset: &Dataset,
    split: Split,
    scoring: &Scoring<'_>,
) -> Result<EvalReport, EvalError> {
    evaluate_splats(model, &|at, camera| model.splats(at, camera), dataset, split, scoring)
}

/// The same of splats that stand in for those of a model (files read back, say).
///
/// # Errors
/// As [`evaluate_with`].
pub fn evaluate_splats(
    model: &Model,
    splats: &dyn Fn(&Timestamp, &Camera) -> Result<Splats, MethodError>,
    dataset: &Dataset,
    split: Split,
    scoring: &Scoring<'_>,
) -> Result<EvalReport, EvalError> {
    let exposure = model.schedule().exposure;
    let fit_colors = scoring.fit_colors || exposure.fit;
    let scoring = &Scoring { fit_colors: fit_colors && !scoring.half, ..*scoring };
    let Scoring { background, images, share, device, .. } = *scoring;
    let views = dataset.views(split);
    if views.is_empty() {
        return Err(EvalError::NoViews(split_name(split)));
    }
    let options = match scoring.plain {
        Some(antialias) => RasterOptions { background, antialias, ..RasterOptions::default() },
        None => model.raster_options(background),
    };
    let (mut rasterizer, mut frame, mut scorer) =
        (device.open()?, Frame::default(), Scorer::new(SsimOptions::default()));
    let corrections = place(model, views, background, images, share)?;
    let scored = share.each(views.len(), |k| {
        let view = &views[k];
        let correction = corrections[k].unwrap_or_default();
        let camera = correction.apply(&images.camera(view));
        let splats = splats(&Timestamp::new(correction.at(view.time)), &camera);
        let splats = splats.map_err(|e| EvalError::Method { view: view.name.clone(), source: Box::new(e) })?;
        rasterizer.render_into(splats.view(), &camera, &options, &mut frame)?;
        let (scores, mse) = scoring.of_frame(view, &frame, dataset.avatar.is_some(), exposure.offset, &mut scorer)?;
        Ok::<_, EvalError>((ViewScores { camera: corrections[k], ..scores }, mse))
    })?;
    Ok(report(model, split, scoring, scored))
}

/// The report of views with their mean squared errors.
fn report(model: &Model, split: Split, scoring: &Scoring<'_>, scored: Vec<(ViewScores, f64)>) -> EvalReport {
    let scores: Vec<Scores> = scored.iter().map(|(view, mse)| view.with_mse(*mse)).collect();
    let summary = Summary::of(&scores);
    let views: Vec<ViewScores> = scored.into_iter().map(|(view, _)| view).collect();
    EvalReport {
        method: model.name().to_owned(),
        split: split_name(split).to_owned(),
        background: scoring.background,
        scale: scoring.images.scale(),
        protocol: protocol(scoring, model.schedule().exposure.offset),
        lpips_weights: scoring.lpips.map(Lpips::weights),
        mean: mean_scores(&summary, &views),
        psnr_of_mean_mse: summary.psnr_of_mean_mse.filter(|v| v.is_finite()),
        perfect_views: summary.mean_psnr.infinite,
        gaussians: model.splat_count(),
        parameter_bytes: 4 * model.param_count() as u64,
        train_seconds: None,
        views,
        cameras: RefinedCameras::of(model),
        extrapolate: None,
    }
}

/// The scores of a split and, beside them, those of the views beyond the last training time, where there are any.
///
/// # Errors
/// As [`evaluate_with`].
pub fn evaluate_with_future(
    model: &Model,
    dataset: &Dataset,
    split: Split,
    scoring: &Scoring<'_>,
) -> Result<EvalReport, EvalError> {
    let mut report = evaluate_with(model, dataset, split, scoring)?;
    if !dataset.extrapolate.is_empty() {
        let future = evaluate_with(model, dataset, Split::Extrapolate, scoring)?;
        report.extrapolate = Some(Box::new(future));
    }
    Ok(report)
}

fn mean_scores(summary: &Summary, views: &[ViewScores]) -> MeanScores {
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

impl ViewScores {
    fn of(
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
    fn with_mse(&self, mse: f64) -> Scores {
        let psnr = self.psnr.unwrap_or(f64::INFINITY);
        Scores { mse, psnr, ssim: self.ssim, ms_ssim: self.ms_ssim, perceptual_proxy: self.perceptual_proxy }
    }
}

/// The colours of a frame as an image in `[0, 1]`.
pub fn clamped(frame: &Frame) -> Image {
    let data = frame.rgb.data.iter().map(|v| v.clamp(0.0, 1.0)).collect();
    Image { width: frame.rgb.width, height: frame.rgb.height, channels: 3, data }
}
