//! Temporal consistency of renders: tOF ([`gs_metrics::tof`]) against ground truth over the views of one camera.
//!
//! Flow between consecutive frames is meaningful only along a video: views of **one** camera, one per time, as a rule at most four
//! typical time steps of the data set apart. Anything else is an error; two that are further apart are no pair. A split of several
//! cameras is scored camera by camera ([`tof_by_camera`]).

use crate::folders::VideoScore;
use gs_data::{DataError, Dataset, Split, View};
pub use gs_metrics::MetricError;
use gs_metrics::{Quantise, Tof, TofOptions};
use gs_train::cameras::Correction;
use gs_train::evaluate::{EvalError, Scoring, place};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::ranks::Share;
use gs_train::renderer::Renderer;

/// Largest time step between the views of a pair, and largest median one, in median time steps of the data set.
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
    let views = video(dataset, dataset.views(split).iter().collect())?;
    Films::new(method, dataset.views(split), scoring)?.score(&views, options)
}

/// tOF of every camera of a split whose views are a video of enough frames that are large enough, in the order of the data. The others
/// are left out.
///
/// # Errors
/// As [`tof`]; if no camera has a score, why the one with the most views has none.
pub fn tof_by_camera(
    method: &Model,
    dataset: &Dataset,
    split: Split,
    scoring: &Scoring<'_>,
    options: TofOptions,
) -> Result<Vec<VideoScore>, TemporalError> {
    let all = dataset.views(split);
    let cameras = by_camera(all);
    let videos: Vec<_> = cameras.iter().filter_map(|views| video(dataset, views.clone()).ok()).collect();
    if videos.is_empty() {
        let longest = cameras.into_iter().max_by_key(Vec::len).filter(|views| views.len() > 1);
        return video(dataset, longest.unwrap_or_else(|| all.iter().collect())).map(|_| Vec::new());
    }
    let mut films = Films::new(method, all, scoring)?;
    let (mut scores, mut why) = (Vec::new(), None);
    for video in videos {
        match films.score(&video, options) {
            Ok(score) => scores.push(score),
            Err(e) if e.is_of_the_video() => {
                let longest: &mut (usize, _) = why.get_or_insert((0, None));
                if video.views.len() > longest.0 {
                    *longest = (video.views.len(), Some(e));
                }
            }
            Err(e) => return Err(e),
        }
    }
    match why.and_then(|(_, e)| e).filter(|_| scores.is_empty()) {
        Some(e) => Err(e),
        None => Ok(scores),
    }
}

impl TemporalError {
    /// Whether the views have no tOF, whatever the model draws.
    pub fn is_of_the_video(&self) -> bool {
        match self {
            Self::NoVideo(_) | Self::Cameras { .. } | Self::SameTime { .. } | Self::Sparse { .. } => true,
            Self::Metric { source, .. } => {
                matches!(source, MetricError::TooFewFrames { .. } | MetricError::TooSmall { .. })
            }
            Self::Method(_) | Self::Data(_) | Self::Place(_) => false,
        }
    }
}

/// Views of one camera in order of time.
struct Video<'a> {
    views: Vec<&'a View>,
    /// Longest time step of a pair, normalised.
    longest: f64,
}

/// Renders views of a split and scores them as videos.
struct Films<'a> {
    method: &'a Model,
    /// The views of the split, and the corrections of their cameras.
    all: &'a [View],
    corrections: Vec<Option<Correction>>,
    scoring: &'a Scoring<'a>,
    renderer: Renderer,
}

impl<'a> Films<'a> {
    fn new(method: &'a Model, all: &'a [View], scoring: &'a Scoring<'a>) -> Result<Self, TemporalError> {
        let Scoring { background, images, device, .. } = *scoring;
        let renderer = Renderer::on(device, method.raster_options(background))?;
        // In the order of the data, as for other scores.
        let corrections = place(method, all, background, images, &Share::default())?;
        Ok(Self { method, all, corrections, scoring, renderer })
    }

    fn score(&mut self, video: &Video<'_>, options: TofOptions) -> Result<VideoScore, TemporalError> {
        let Scoring { background, images, quantise, .. } = *self.scoring;
        let (mut tof, views) = (Tof::new(options), &video.views);
        for (k, &view) in views.iter().enumerate() {
            if k > 0 && time(view) - time(views[k - 1]) > video.longest {
                tof.cut();
            }
            let row = self.all.iter().position(|v| std::ptr::eq(v, view));
            let correction = row.and_then(|row| *self.corrections.get(row)?);
            let shown = correction.unwrap_or_default().corrected(view);
            let mut image = self.renderer.view(self.method, &shown, &images.camera(&shown))?;
            let mut truth = images.get(view)?.over(background);
            quantise.apply(&mut image);
            if quantise != Quantise::None {
                Quantise::Round.apply(&mut truth);
            }
            tof.add(&image, &truth).map_err(|source| TemporalError::Metric { view: view.name.clone(), source })?;
        }
        let last = views.last().map_or(String::new(), |v| v.name.clone());
        let score = tof.finish().map_err(|source| TemporalError::Metric { view: last, source })?;
        Ok(VideoScore::new(&score, |i| &views[i].name))
    }
}

/// Whether two views are of one camera. Equal poses are one, too: not all data sets name cameras.
fn same_camera(a: &View, b: &View) -> bool {
    a.camera_id == b.camera_id || a.camera == b.camera
}

/// The views of each camera, cameras in the order of the data.
fn by_camera(views: &[View]) -> Vec<Vec<&View>> {
    let mut cameras: Vec<Vec<&View>> = Vec::new();
    for view in views {
        match cameras.iter_mut().find(|c| c.first().is_some_and(|first| same_camera(first, view))) {
            Some(camera) => camera.push(view),
            None => cameras.push(vec![view]),
        }
    }
    cameras
}

/// Time of a view, normalised.
fn time(view: &View) -> f64 {
    f64::from(view.time.normalised)
}

/// These views in order of time, if they form a video.
fn video<'a>(dataset: &Dataset, mut views: Vec<&'a View>) -> Result<Video<'a>, TemporalError> {
    views.sort_by(|a, b| a.time.normalised.total_cmp(&b.time.normalised));
    let Some(first) = views.first().filter(|_| views.len() > 1) else {
        return Err(TemporalError::NoVideo(views.len()));
    };
    if let Some(other) = views.iter().find(|v| !same_camera(first, v)) {
        return Err(TemporalError::Cameras { first: first.name.clone(), second: other.name.clone() });
    }
    if let Some(w) = views.windows(2).find(|w| time(w[0]) == time(w[1])) {
        return Err(TemporalError::SameTime { first: w[0].name.clone(), second: w[1].name.clone() });
    }
    let splits = [Split::Train, Split::Val, Split::Test, Split::Extrapolate];
    let all = splits.map(|s| dataset.views(s).iter().map(time)).into_iter().flatten();
    let (gap, step) = (typical_gap(views.iter().map(|v| time(v))), typical_gap(all));
    let longest = MAX_SKIPPED * step * (1.0 + 1e-6);
    if gap > longest { Err(TemporalError::Sparse { gap, step }) } else { Ok(Video { views, longest }) }
}

/// Median step between distinct times; 0 for one time.
fn typical_gap(times: impl Iterator<Item = f64>) -> f64 {
    let mut times: Vec<f64> = times.collect();
    times.sort_by(f64::total_cmp);
    let mut gaps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).filter(|g| *g > 0.0).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_data::ImageCache;
    use gs_synth::{self as synth, SynthOptions};
    use gs_train::registry::section;
    use gs_train::scene::SceneInfo;

    fn generated(options: SynthOptions) -> Dataset {
        synth::generate("balls", &SynthOptions { size: 48, ..options }).unwrap().dataset
    }

    fn by_cameras(data: &Dataset) -> Result<Vec<VideoScore>, TemporalError> {
        by_cameras_with(data, TofOptions { trim: false, crop: false })
    }

    /// Scores of a model that rests.
    fn by_cameras_with(data: &Dataset, options: TofOptions) -> Result<Vec<VideoScore>, TemporalError> {
        let entry = gs_methods::registry().find("static3d").unwrap();
        let config = entry.config("tiny").unwrap();
        let scene = SceneInfo::of(data, &section("static3d", &config, "init").unwrap(), 0).unwrap();
        let model = entry.model(&config, &scene).unwrap();
        let (images, share, device) = (ImageCache::new(16 << 20, 1.0), Share::default(), Default::default());
        let scoring = Scoring::new([0.0; 3], &images, &share, &device);
        tof_by_camera(&model, data, Split::Test, &scoring, options)
    }

    #[test]
    fn every_camera_that_filmed_is_scored_by_itself() {
        let data = generated(SynthOptions { cameras: 2, held_out: 2, moments: 8, ..SynthOptions::default() });
        let both = by_cameras(&data).unwrap();
        let moments = data.test.len() / 2;
        assert_eq!(both.iter().map(|s| s.pairs.len()).collect::<Vec<_>>(), [moments - 1; 2]);
        assert!(both[0].mean > 0.0 && (both[0].mean - both[1].mean).abs() > 1e-9, "{both:?}");
        let first = data.test[0].camera_id;
        let mut alone = data.clone();
        alone.test.retain(|v| v.camera_id == first);
        assert_eq!(by_cameras(&alone).unwrap(), both[..1]);
        // One image of the other camera is no video.
        alone.test.extend(data.test.iter().find(|v| v.camera_id != first).cloned());
        assert_eq!(by_cameras(&alone).unwrap(), both[..1]);
    }

    #[test]
    fn a_hole_is_no_pair_and_a_short_video_spoils_no_other() {
        let mut data = generated(SynthOptions { cameras: 2, held_out: 1, moments: 16, ..SynthOptions::default() });
        data.test.drain(4..9);
        let score = by_cameras(&data).unwrap();
        assert_eq!(score[0].pairs.len(), data.test.len() - 2);
        assert!(score[0].pairs.iter().all(|p| p.name != data.test[4].name), "the first after the hole");

        let mut data = generated(SynthOptions { cameras: 2, held_out: 2, moments: 8, ..SynthOptions::default() });
        let first = data.test[0].camera_id;
        let mut of_second = 0;
        data.test.retain(|v| {
            of_second += u32::from(v.camera_id != first);
            v.camera_id == first || of_second <= 3
        });
        let trimmed = |data: &Dataset| by_cameras_with(data, TofOptions { trim: true, crop: false });
        assert_eq!(trimmed(&data).unwrap().len(), 1);
        data.test.retain(|v| v.camera_id != first);
        assert!(matches!(trimmed(&data), Err(TemporalError::Metric { source: MetricError::TooFewFrames { .. }, .. })));
    }

    #[test]
    fn cameras_that_did_not_film_have_no_score() {
        let data = generated(SynthOptions { train_views: 6, val_views: 1, test_views: 4, ..SynthOptions::default() });
        assert!(matches!(by_cameras(&data), Err(TemporalError::Cameras { .. })), "a camera for each view");
        let mut twice = generated(SynthOptions { cameras: 2, held_out: 1, moments: 8, ..SynthOptions::default() });
        twice.test.push(View { name: "again".into(), ..twice.test[0].clone() });
        assert!(matches!(by_cameras(&twice), Err(TemporalError::SameTime { .. })));
    }
}
