//! Frames after the last training time, for any method, and their scores where ground truth is known.
//!
//! The evaluation of the splats (*motion*) and the rasterisation (*render*) are timed separately: with a cached
//! extrapolation, a later frame should take no longer than an earlier one.
//!
//! Ground truth is [`Dataset::extrapolate`]: its views up to the last time are scored, and a rendered frame with the camera and
//! time of such a view has that view's scores.

use crate::Placing;
use gs_core::{Camera, Image, Time, cast};
use gs_data::{DataError, Dataset, ImageCache, Split, moments};
use gs_train::evaluate::{EvalError, EvalReport, ViewScores, clamped, evaluate};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::renderer::Renderer;
use gs_train::timestamp::Timestamp;
use serde::Serialize;
use std::time::Instant;

pub mod bodies;
pub mod page;
pub mod path;
pub mod physics;

pub use bodies::TimedBody;
pub use path::CameraPath;
pub use physics::Physics;

/// Largest number of frames of a forecast.
pub const MAX_FRAMES: usize = 10_000;
/// Difference up to which two times are equal, in frame intervals.
const TIME_TOLERANCE: f64 = 0.01;

/// A forecast that cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ForecastError {
    /// The end is not after the start, or not finite.
    #[error("there is nothing to forecast from {} to {}: the end must be later", cast::to_f32(*from), cast::to_f32(*until))]
    Empty {
        /// Start of the forecast, normalised time.
        from: f64,
        /// End of the forecast, normalised time.
        until: f64,
    },
    /// There would be no frame, too many, or the interval is not positive.
    #[error(
        "frames every {} from {} to {} are not possible: 1 to {MAX_FRAMES} are",
        cast::to_f32(*interval), cast::to_f32(*from), cast::to_f32(*until)
    )]
    Frames {
        /// Start of the forecast, normalised time.
        from: f64,
        /// End of the forecast, normalised time.
        until: f64,
        /// Time between frames, as a difference of normalised times.
        interval: f64,
    },
    /// There is no view of this name.
    #[error("no view is named \"{name}\"; there are {some}, …")]
    NoView {
        /// The name that was asked for.
        name: String,
        /// Names of the first views.
        some: String,
    },
    /// Images cannot be read, or frames cannot be compared.
    #[error(transparent)]
    Eval(#[from] EvalError),
}

/// Spacing of the frames of a forecast.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Spacing {
    /// A frame every so much normalised time.
    Interval(f64),
    /// So many evenly spaced frames, the last one at the end.
    Count(usize),
}

/// Frame times after `from` up to `until`, normalised.
///
/// ```
/// use gs4d_eval::forecast::{Spacing, times};
///
/// assert_eq!(times(0.5, 1.0, Spacing::Count(2))?, [0.75, 1.0]);
/// assert_eq!(times(0.5, 1.0, Spacing::Interval(0.375))?, [0.875]);
/// # Ok::<(), gs4d_eval::forecast::ForecastError>(())
/// ```
///
/// # Errors
/// If there are none, or more than [`MAX_FRAMES`].
pub fn times(from: f64, until: f64, spacing: Spacing) -> Result<Vec<f64>, ForecastError> {
    if !(until > from && until.is_finite() && from.is_finite()) {
        return Err(ForecastError::Empty { from, until });
    }
    let (count, interval) = match spacing {
        Spacing::Count(n) => (n as f64, (until - from) / n.max(1) as f64),
        Spacing::Interval(d) => (((until - from) / d + TIME_TOLERANCE).floor(), d),
    };
    if !(count >= 1.0 && count <= MAX_FRAMES as f64) {
        return Err(ForecastError::Frames { from, until, interval });
    }
    Ok((1..=cast::to_usize(count)).map(|k| from + k as f64 * interval).collect())
}

/// The clock of the data: seconds `start + rate t` at normalised time `t`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Clock {
    /// Seconds at normalised time 0.
    pub start: f64,
    /// Seconds per unit of normalised time: the duration of the sequence 0..1.
    pub rate: f64,
}

impl Clock {
    /// The clock of a data set; `None` where seconds equal the normalised time, or there is only one time.
    pub fn of(dataset: &Dataset) -> Option<Self> {
        let all = || dataset.train.iter().chain(&dataset.extrapolate).map(|v| v.time);
        let first = all().min_by(|a, b| a.normalised.total_cmp(&b.normalised))?;
        let last = all().max_by(|a, b| a.normalised.total_cmp(&b.normalised))?;
        let rate = (last.seconds - first.seconds) / f64::from(last.normalised - first.normalised);
        let start = first.seconds - rate * f64::from(first.normalised);
        let known = rate > 0.0 && rate.is_finite() && ((rate - 1.0).abs() > 1e-6 || start.abs() > 1e-6);
        known.then_some(Self { start, rate })
    }

    /// The unit of time of the data, and how many of it the sequence 0..1 lasts: `s`, or 1 `sequence` without a clock.
    pub fn unit(clock: Option<Self>) -> (&'static str, f64) {
        clock.map_or(("sequence", 1.0), |c| ("s", c.rate))
    }

    /// The [`Time`] of normalised time `t`; without a clock, seconds equal `t`.
    pub fn time(clock: Option<Self>, t: f64) -> Time {
        Time { normalised: cast::to_f32(t), seconds: clock.map_or(t, |c| c.start + c.rate * t) }
    }
}

/// A rendered frame and its cost.
pub struct Frame {
    /// RGB in `[0, 1]`, `[H, W, 3]`.
    pub image: Image,
    /// Milliseconds to evaluate the splats at the time.
    pub motion_ms: f64,
    /// Milliseconds to rasterise the splats.
    pub render_ms: f64,
}

/// Renders one frame.
///
/// # Errors
/// If the model cannot produce its splats.
pub fn draw(method: &Model, renderer: &mut Renderer, camera: &Camera, time: Time) -> Result<Frame, MethodError> {
    let start = Instant::now();
    let splats = method.splats(&Timestamp::new(time), camera)?;
    let motion = start.elapsed();
    let start = Instant::now();
    let image = clamped(renderer.render(&splats, camera)?);
    let ms = |d: std::time::Duration| 1e3 * d.as_secs_f64();
    Ok(Frame { image, motion_ms: ms(motion), render_ms: ms(start.elapsed()) })
}

/// Scores at one moment: means over its views, which cameras took almost together ([`gs_data::moments`]).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TimestampScores {
    /// Mean normalised time of the views.
    pub time: f64,
    /// Normalised time since the last training time.
    pub beyond: f64,
    /// Number of views of this moment.
    pub views: usize,
    /// Mean PSNR, dB; absent where all views are perfect.
    pub psnr: Option<f64>,
    /// Mean SSIM over these views.
    pub ssim: f64,
    /// Mean PSNR within masks, dB; absent without masks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub masked_psnr: Option<f64>,
}

/// Scores of the views beyond the last training time.
pub struct Truth {
    /// Scores of every view beyond the last training time.
    pub report: EvalReport,
    cameras: Vec<Camera>,
    /// The moment of each view, normalised time.
    moments: Vec<f32>,
}

impl Truth {
    /// Scores the views of [`Dataset::extrapolate`] up to a normalised time; `None` if there are none. `placed` gives their
    /// cameras as [`CameraPath`] has them.
    ///
    /// # Errors
    /// If an image cannot be read or a frame is not finite.
    pub fn of(
        method: &Model,
        dataset: &Dataset,
        until: f64,
        background: [f32; 3],
        images: &ImageCache,
        placed: &Placing<'_>,
    ) -> Result<Option<Self>, EvalError> {
        let known = dataset.extrapolate.iter().filter(|v| f64::from(v.time.normalised) <= until + 1e-6);
        let known = Dataset { extrapolate: known.cloned().collect(), ..dataset.without_views() };
        if known.extrapolate.is_empty() {
            return Ok(None);
        }
        let report = evaluate(method, &known, Split::Extrapolate, background, images)?;
        let cameras = known.extrapolate.iter().map(|v| images.camera(&placed(v))).collect();
        Ok(Some(Self { report, cameras, moments: moments::of_views(&known.extrapolate) }))
    }

    /// The scores of the view with this camera and time, if there is one; `interval` is the time between frames.
    pub fn frame(&self, camera: &Camera, time: f64, interval: f64) -> Option<&ViewScores> {
        let near = |v: &ViewScores| (f64::from(v.time) - time).abs() <= TIME_TOLERANCE * interval;
        self.report.views.iter().zip(&self.cameras).find(|(v, c)| near(v) && *c == camera).map(|(v, _)| v)
    }

    /// Scores per moment, in order of time; `last` is the last training time, normalised.
    pub fn moments(&self, last: f64) -> Vec<TimestampScores> {
        let mut views: Vec<(f32, &ViewScores)> = self.moments.iter().copied().zip(&self.report.views).collect();
        views.sort_by(|a, b| a.0.total_cmp(&b.0));
        let of = |group: &[(f32, &ViewScores)]| {
            let mean = |value: fn(&ViewScores) -> Option<f64>| {
                gs_metrics::Mean::of(group.iter().filter_map(|(_, v)| value(v))).value
            };
            let time = f64::from(group[0].0);
            TimestampScores {
                time,
                beyond: time - last,
                views: group.len(),
                psnr: mean(|v| v.psnr),
                ssim: mean(|v| Some(v.ssim)).unwrap_or(0.0),
                masked_psnr: mean(|v| v.masked?.psnr),
            }
        };
        views.chunk_by(|a, b| a.0 == b.0).map(of).collect()
    }
}

impl From<DataError> for ForecastError {
    fn from(e: DataError) -> Self {
        Self::Eval(e.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_data::View;
    use gs_synth::{SynthOptions, generate};
    use gs_train::registry::section;
    use gs_train::scene::SceneInfo;

    /// Three cameras that see the same moments, each late by its own thousandth.
    #[test]
    fn cameras_that_are_not_quite_together_are_scored_as_one_moment() {
        let o = SynthOptions { size: 24, cameras: 3, moments: 6, supersample: 1, ..SynthOptions::default() };
        let mut data = generate("balls", &o).unwrap().dataset;
        let entry = gs_methods::registry().find("static3d").unwrap();
        let config = entry.config("tiny").unwrap();
        let scene = SceneInfo::of(&data, &section("static3d", &config, "init").unwrap(), 0).unwrap();
        let (model, images) = (entry.model(&config, &scene).unwrap(), ImageCache::new(16 << 20, 1.0));
        let late = |view: &View| {
            let normalised = view.time.normalised + 1e-3 * view.camera_id as f32;
            View { time: Time { normalised, ..view.time }, ..view.clone() }
        };
        data.extrapolate = data.train.iter().map(late).collect();
        let truth = Truth::of(&model, &data, 2.0, [0.0; 3], &images, &|view| view.clone()).unwrap().unwrap();
        let moments = truth.moments(-0.5);
        assert!(moments.len() > 2 && 3 * moments.len() == data.train.len(), "{moments:?}");
        assert!(moments.iter().all(|m| m.views == 3), "{moments:?}");
        assert!(moments.is_sorted_by(|a, b| a.time < b.time), "{moments:?}");
        assert!(moments.iter().all(|m| m.beyond == m.time + 0.5), "{moments:?}");
    }

    #[test]
    fn frames_follow_each_other_after_the_last_training_time() {
        let near = |a: &[f64], b: &[f64]| a.len() == b.len() && a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-12);
        assert!(near(&times(0.75, 1.5, Spacing::Count(3)).unwrap(), &[1.0, 1.25, 1.5]));
        assert!(near(&times(0.5, 1.0, Spacing::Interval(0.2)).unwrap(), &[0.7, 0.9]));
        // Sixtieths that do not quite add up reach the end all the same.
        assert_eq!(times(0.75, 1.0, Spacing::Interval(f64::from(1.0f32 / 60.0))).unwrap().len(), 15);
        for (from, until, spacing) in [
            (1.0, 1.0, Spacing::Count(3)),
            (0.5, f64::NAN, Spacing::Count(3)),
            (0.5, 1.0, Spacing::Count(0)),
            (0.5, 1.0, Spacing::Count(MAX_FRAMES + 1)),
            (0.5, 1.0, Spacing::Interval(0.0)),
            (0.5, 1.0, Spacing::Interval(-1.0)),
            (0.5, 1.0, Spacing::Interval(2.0)),
            (0.5, 1.0, Spacing::Interval(1e-9)),
        ] {
            assert!(times(from, until, spacing).is_err(), "{from} {until} {spacing:?}");
        }
    }

    #[test]
    fn the_clock_is_the_one_of_the_data() {
        let options = SynthOptions::of_views(8, 5, 0);
        let mut data = generate("balls", &options).unwrap().dataset;
        assert_eq!(Clock::of(&data), None, "it repeats the normalised time");
        data.train.iter_mut().for_each(|v| v.time.seconds = 3.0 + 10.0 * f64::from(v.time.normalised));
        let clock = Clock::of(&data).unwrap();
        assert!((clock.start - 3.0).abs() < 1e-9 && (clock.rate - 10.0).abs() < 1e-9);
        assert!((Clock::time(Some(clock), 1.5).seconds - 18.0).abs() < 1e-9);
        data.train.truncate(1);
        assert_eq!(Clock::of(&data), None, "one moment has no rate");
    }
}
