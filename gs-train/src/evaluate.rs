//! Scores of a method on a split of a data set.
//!
//! Frames are compared as they were drawn: `f32`, clamped to `[0, 1]`, not rounded to 8 bit. SSIM is that of the 3DGS
//! family (zeros outside the image). Both averages of PSNR are given: the mean of the views' values (what papers of the
//! family print) and the PSNR of the mean squared error.

use crate::data::{DataError, Dataset, ImageCache, Split};
use crate::methods::Method;
use crate::moment::Moment;
use gs_core::{Image, Params};
use gs_metrics::{Mean, MetricError, Scorer, Scores, Sharpness, SsimOptions, Summary};
use gs_raster::{Frame, Workspace, render_into};
use serde::{Deserialize, Serialize};

/// How the frames were compared, in words, for the report.
pub const PROTOCOL: &str =
    "f32 frames clamped to [0, 1], not quantised; SSIM 11x11 with zero padding; perceptual_proxy is not LPIPS";

/// The scores of one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewScores {
    /// Name of the view.
    pub name: String,
    /// Normalised time.
    pub time: f32,
    /// dB; absent for a perfect view (infinite).
    pub psnr: Option<f64>,
    /// Structural similarity.
    pub ssim: f64,
    /// Multi-scale SSIM; absent where a side is at most 160 pixels.
    pub ms_ssim: Option<f64>,
    /// The weight-free perceptual distance of gs-metrics.
    pub perceptual_proxy: f64,
    /// Variance of the Laplacian over that of the photograph: below 1 blurred; absent where the photograph is even.
    #[serde(default)]
    pub laplacian_ratio: Option<f64>,
    /// Share of high frequencies over that of the photograph, likewise.
    #[serde(default)]
    pub high_band_ratio: Option<f64>,
}

/// Means over views.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeanScores {
    /// Mean of the finite PSNRs, dB.
    pub psnr: Option<f64>,
    /// Mean SSIM.
    pub ssim: Option<f64>,
    /// Mean MS-SSIM of the views that have one.
    pub ms_ssim: Option<f64>,
    /// Mean perceptual distance.
    pub perceptual_proxy: Option<f64>,
    /// Mean ratio of Laplacian variances of the views that have one.
    #[serde(default)]
    pub laplacian_ratio: Option<f64>,
    /// Mean ratio of high-frequency shares, likewise.
    #[serde(default)]
    pub high_band_ratio: Option<f64>,
}

/// The scores of a split.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvalReport {
    /// Name of the method.
    pub method: String,
    /// `train`, `val` or `test`.
    pub split: String,
    /// Colour behind the scene, in drawing and photograph alike.
    pub background: [f32; 3],
    /// Factor by which photographs and cameras were reduced.
    pub scale: f64,
    /// How the frames were compared.
    pub protocol: String,
    /// Means over views.
    pub mean: MeanScores,
    /// PSNR of the mean squared error over views, dB; absent when every view is perfect.
    pub psnr_of_mean_mse: Option<f64>,
    /// Views drawn without any error, left out of the mean PSNR.
    pub perfect_views: usize,
    /// Number of Gaussians.
    pub gaussians: usize,
    /// Bytes of all parameters as `f32`, without gradients and moments.
    pub parameter_bytes: u64,
    /// Seconds of training, where known.
    pub train_seconds: Option<f64>,
    /// The scores of each view.
    pub views: Vec<ViewScores>,
}

/// Why an evaluation failed.
#[derive(Debug, thiserror::Error)]
pub enum EvalError {
    /// No view in the split.
    #[error("the data set has no {0} views; choose another split")]
    NoViews(&'static str),
    /// A photograph cannot be read.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A frame cannot be compared.
    #[error("view {view}: {source}")]
    Metric {
        /// Name of the view.
        view: String,
        /// The metric's reason.
        source: MetricError,
    },
}

/// The name of a split.
pub fn split_name(split: Split) -> &'static str {
    match split {
        Split::Train => "train",
        Split::Val => "val",
        Split::Test => "test",
    }
}

/// Draws every view of a split over `background` and scores it against its photograph.
///
/// # Errors
/// If the split is empty, a photograph cannot be read, or a frame is not finite.
pub fn evaluate(
    method: &dyn Method,
    dataset: &Dataset,
    split: Split,
    background: [f32; 3],
    photographs: &ImageCache,
) -> Result<EvalReport, EvalError> {
    let views = dataset.views(split);
    if views.is_empty() {
        return Err(EvalError::NoViews(split_name(split)));
    }
    let options = method.schedule().raster_options(background);
    let (mut workspace, mut frame, mut scorer) =
        (Workspace::new(), Frame::default(), Scorer::new(SsimOptions::default()));
    let mut scores: Vec<Scores> = Vec::with_capacity(views.len());
    let mut sharpness: Vec<Option<Sharpness>> = Vec::with_capacity(views.len());
    for view in views {
        let camera = photographs.camera(view);
        let splats = method.splats(&Moment::new(view.time), &camera);
        render_into(&splats, &camera, &options, &mut workspace, &mut frame);
        let truth = photographs.get(view)?.over(background);
        let image = clamped(&frame);
        let score = scorer.score(&image, &truth);
        // Images too small for a Laplacian have no sharpness.
        sharpness.push(Sharpness::of(&image, &truth).ok());
        scores.push(score.map_err(|source| EvalError::Metric { view: view.name.clone(), source })?);
    }
    let summary = Summary::of(&scores);
    let all = views.iter().zip(&scores).zip(&sharpness);
    let views: Vec<ViewScores> =
        all.map(|((view, s), sharp)| view_scores(&view.name, view.time.normalised, s, *sharp)).collect();
    let mean = |ratio: fn(&ViewScores) -> Option<f64>| Mean::of(views.iter().filter_map(ratio)).value;
    Ok(EvalReport {
        method: method.name().to_owned(),
        split: split_name(split).to_owned(),
        background,
        scale: photographs.scale(),
        protocol: PROTOCOL.to_owned(),
        mean: MeanScores {
            psnr: summary.mean_psnr.value,
            ssim: summary.ssim.value,
            ms_ssim: summary.ms_ssim.value,
            perceptual_proxy: summary.perceptual_proxy.value,
            laplacian_ratio: mean(|v| v.laplacian_ratio),
            high_band_ratio: mean(|v| v.high_band_ratio),
        },
        psnr_of_mean_mse: summary.psnr_of_mean_mse.filter(|v| v.is_finite()),
        perfect_views: summary.mean_psnr.infinite,
        gaussians: method.len(),
        parameter_bytes: 4 * Params::param_count(method) as u64,
        train_seconds: None,
        views,
    })
}

fn view_scores(name: &str, time: f32, s: &Scores, sharpness: Option<Sharpness>) -> ViewScores {
    ViewScores {
        name: name.to_owned(),
        time,
        psnr: s.psnr.is_finite().then_some(s.psnr),
        ssim: s.ssim,
        ms_ssim: s.ms_ssim,
        perceptual_proxy: s.perceptual_proxy,
        laplacian_ratio: sharpness.and_then(|s| s.laplacian),
        high_band_ratio: sharpness.and_then(|s| s.high_band),
    }
}

/// The colours of a frame as an image in `[0, 1]`.
pub fn clamped(frame: &Frame) -> Image {
    let data = frame.rgb.iter().map(|v| v.clamp(0.0, 1.0)).collect();
    Image { width: frame.width, height: frame.height, channels: 3, data }
}
