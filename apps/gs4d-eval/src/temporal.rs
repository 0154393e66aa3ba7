//! Motion of a method against that of the photographs: tOF ([`gs_metrics::tof`]) over the views of one camera.
//!
//! Flow is estimated between neighbours in time, so it means something only along a video: views of **one** camera, one at a
//! time, at most every [`MOST_SKIPPED`]-th moment of the data set. Anything else is refused.

use crate::folders::VideoScore;
use gs_data::{DataError, Dataset, ImageCache, Split, View};
use gs_metrics::{MetricError, Tof, TofOptions};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::renderer::Renderer;

/// Distance of neighbouring views at most, in typical distances between the moments of the data set.
pub const MOST_SKIPPED: f64 = 4.0;

/// Why a run has no motion score.
#[derive(Debug, thiserror::Error)]
pub enum TemporalError {
    /// The method cannot be asked for its splats.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// Too few views to speak of motion.
    #[error("tOF needs a video, and this split has {0} views")]
    NoVideo(usize),
    /// The views are not of one camera.
    #[error("tOF needs the views of one camera: {first} and {second} are of different ones")]
    Cameras {
        /// A view.
        first: String,
        /// A view of another camera.
        second: String,
    },
    /// Two views of the same moment.
    #[error("tOF needs one view for each moment: {first} and {second} have the same time")]
    SameTime {
        /// A view.
        first: String,
        /// Another.
        second: String,
    },
    /// The views are too far apart in time.
    #[error(
        "tOF is not defined for sparse times: views lie {gap:.3} apart, the moments of the data {step:.3} (at most {} of \
         these; times from 0 to 1)",
        MOST_SKIPPED
    )]
    Sparse {
        /// Typical distance of the views in normalised time.
        gap: f64,
        /// Typical distance between moments of the data set.
        step: f64,
    },
    /// A photograph cannot be read.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Frames that cannot be compared.
    #[error("view {view}: {source}")]
    Metric {
        /// The view.
        view: String,
        /// The metric's reason.
        source: MetricError,
    },
}

/// tOF of the views of a split, drawn over `background`, in the order of time.
///
/// # Errors
/// Views that are no video, photographs that cannot be read, frames that cannot be compared.
pub fn tof(
    method: &Model,
    dataset: &Dataset,
    split: Split,
    background: [f32; 3],
    photographs: &ImageCache,
    options: TofOptions,
) -> Result<VideoScore, TemporalError> {
    let views = video(dataset, split)?;
    let mut renderer = Renderer::new(method.raster_options(background));
    let mut tof = Tof::new(options);
    for view in &views {
        let image = renderer.view(method, view, &photographs.camera(view))?;
        let truth = photographs.get(view)?.over(background);
        tof.add(&image, &truth).map_err(|source| TemporalError::Metric { view: view.name.clone(), source })?;
    }
    let last = views.last().map_or(String::new(), |v| v.name.clone());
    let score = tof.finish().map_err(|source| TemporalError::Metric { view: last, source })?;
    Ok(VideoScore::new(&score, |i| &views[i].name))
}

/// The views of a split in the order of time, if they are a video.
fn video(dataset: &Dataset, split: Split) -> Result<Vec<&View>, TemporalError> {
    let mut views: Vec<&View> = dataset.views(split).iter().collect();
    views.sort_by(|a, b| a.time.normalised.total_cmp(&b.time.normalised));
    let Some(first) = views.first().filter(|_| views.len() > 1) else {
        return Err(TemporalError::NoVideo(views.len()));
    };
    // Where the data name no cameras, equal poses say as much.
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
    if gap > MOST_SKIPPED * step * (1.0 + 1e-6) { Err(TemporalError::Sparse { gap, step }) } else { Ok(views) }
}

/// Median distance between neighbouring distinct times; 0 for one.
fn typical_gap(times: impl Iterator<Item = f64>) -> f64 {
    let mut times: Vec<f64> = times.collect();
    times.sort_by(f64::total_cmp);
    let mut gaps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).filter(|g| *g > 0.0).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).copied().unwrap_or(0.0)
}
