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

mod fitted;
mod masked;
mod placed;
mod protocol;
mod scores;

pub use fitted::FittedScores;
pub use masked::MaskedScores;
pub use placed::{RefinedCameras, place};
pub use protocol::PROTOCOL;
pub use scores::{MeanScores, ViewScores};

use crate::device::Device;
use crate::method::MethodError;
use crate::model::Model;
use crate::ranks::{Share, ShareError};
use crate::timestamp::Timestamp;
use gs_core::{Camera, Image, Splats};
use gs_data::{DataError, Dataset, ImageCache, Split, View};
use gs_metrics::{Lpips, Mean, MetricError, Quantise, Scorer, Scores, SsimOptions, Summary, half_size};
use gs_raster::{DeviceError, Frame, RasterOptions};
use protocol::protocol;
use scores::mean_scores;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

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

/// The colours of a frame as an image in `[0, 1]`.
pub fn clamped(frame: &Frame) -> Image {
    let data = frame.rgb.data.iter().map(|v| v.clamp(0.0, 1.0)).collect();
    Image { width: frame.rgb.width, height: frame.rgb.height, channels: 3, data }
}
