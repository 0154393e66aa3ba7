//! Temporal consistency of renders: tOF ([`gs_metrics::tof`]) against ground truth over the views of one camera.
//!
//! Flow between consecutive frames is meaningful only along a video: views of **one** camera, one per time, at most four
//! typical time steps of the data set apart. Anything else is an error.

use crate::folders::VideoScore;
use gs_data::{DataError, Dataset, Split, View};
use gs_metrics::{MetricError, Tof, TofOptions};
use gs_train::evaluate::{EvalError, Scoring, place};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::ranks::Share;
use gs_train::renderer::Renderer;

/// Largest median time step between views, in median time steps of the data set.
pub(crate) const MAX_SKIPPED: f64 = 4.0;

/// Views that have no tOF.
#[derive(Debug, thiserror::Error)]
pub enum TemporalError {
    /// A view cannot be rendered.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// The split has fewer than two views.
    #[error("tOF needs a video, and this split has {0} views")]
    NoVideo(usize),
    /// The views are not of one camera.
    #[error("tOF needs the views of one camera: {first} and {second} are of different ones")]
    Cameras {
        /// Name of a view of one camera.
        first: String,
        /// Name of a view of another camera.
        second: String,
    },
    /// Two views have the same time.
    #[error("tOF needs one view per time: {first} and {second} have the same time")]
    SameTime {
        /// Name of the first view.
        first: String,
        /// Name of the other view at the same time.
        second: String,
    },
    /// The views are too far apart in time.
    #[error(
        "tOF is not defined for sparse times: views lie {gap:.3} apart, the times of the data {step:.3} (at most {} of \
         these; times from 0 to 1)",
        MAX_SKIPPED
    )]
    Sparse {
        /// Median time step between the views, normalised.
        gap: f64,
        /// Median time step of the data set, normalised.
        step: f64,
    },
    /// A ground-truth image cannot be read.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A held-out camera cannot be placed in a scene whose cameras were refined.
    #[error(transparent)]
    Place(#[from] EvalError),
    /// The metric refuses the frames of a view.
    #[error("view {view}: {source}")]
    Metric {
        /// Name of the view in the data set.
        view: String,
        /// Why its frames cannot be compared.
        source: MetricError,
    },
}

/// tOF of the views of a split, in order of time; one rank renders them all.
///
/// # Errors
/// If the views are no video, an image cannot be read, frames cannot be compared, or the device fails.
pub fn tof(
    method: &Model,
    dataset: &Dataset,
    split: Split,
    scoring: &Scoring<'_>,
    options: TofOptions,
) -> Result<VideoScore, TemporalError> {
    let views = video(dataset, split)?;
    let Scoring { background, images, device, .. } = *scoring;
    let mut renderer = Renderer::on(device, method.raster_options(background))?;
    let mut tof = Tof::new(options);
    // In the order of the data, as for other scores.
    let all = dataset.views(split);
    let corrections = place(method, all, background, images, &Share::default())?;
    for &view in &views {
        let row = all.iter().position(|v| std::ptr::eq(v, view));
        let shown = row.and_then(|row| corrections[row]).unwrap_or_default().corrected(view);
        let image = renderer.view(method, &shown, &images.camera(&shown))?;
        let truth = images.get(view)?.over(background);
        tof.add(&image, &truth).map_err(|source| TemporalError::Metric { view: view.name.clone(), source })?;
    }
    let last = views.last().map_or(String::new(), |v| v.name.clone());
    let score = tof.finish().map_err(|source| TemporalError::Metric { view: last, source })?;
    Ok(VideoScore::new(&score, |i| &views[i].name))
}

/// The views of a split in order of time, if they form a video.
fn video(dataset: &Dataset, split: Split) -> Result<Vec<&View>, TemporalError> {
    let mut views: Vec<&View> = dataset.views(split).iter().collect();
    views.sort_by(|a, b| a.time.normalised.total_cmp(&b.time.normalised));
    let Some(first) = views.first().filter(|_| views.len() > 1) else {
        return Err(TemporalError::NoVideo(views.len()));
    };
    // Equal poses are one camera, too: not all data sets name cameras.
    let other = |v: &&&View| v.camera_id != first.camera_id && v.camera != first.camera;
    if let Some(other) = views.iter().find(other) {
        return Err(TemporalError::Cameras { first: first.name.clone(), second: other.name.clone() });
    }
    let time = |v: &View| f64::from(v.time.normalised);
    if let Some(w) = views.windows(2).find(|w| time(w[0]) == time(w[1])) {
        return Err(TemporalError::SameTime { first: w[0].name.clone(), second: w[1].name.clone() });
    }
    let splits = [Split::Train, Split::Val, Split::Test, Split::Extrapolate];
    let all = splits.map(|s| dataset.views(s).iter().map(time)).into_iter().flatten();
    let (gap, step) = (typical_gap(views.iter().map(|v| time(v))), typical_gap(all));
    if gap > MAX_SKIPPED * step * (1.0 + 1e-6) { Err(TemporalError::Sparse { gap, step }) } else { Ok(views) }
}

/// Median step between distinct times; 0 for one time.
fn typical_gap(times: impl Iterator<Item = f64>) -> f64 {
    let mut times: Vec<f64> = times.collect();
    times.sort_by(f64::total_cmp);
    let mut gaps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).filter(|g| *g > 0.0).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).copied().unwrap_or(0.0)
}
