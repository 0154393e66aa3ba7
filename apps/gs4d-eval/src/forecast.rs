//! Frames after the last training time, for any method, and what they are worth where the truth is known.
//!
//! The way from a time to splats (*motion*) and from splats to a picture (*drawing*) are timed apart: a method that keeps what
//! it knows of the future should draw a later frame in no more time than any other.
//!
//! Truth is [`Dataset::extrapolate`]: its views up to the last time asked for are scored, moment by moment, and a drawn frame
//! whose camera and time are those of such a view has that view's scores.

use gs_core::{Camera, Image, Time};
use gs_data::{DataError, Dataset, ImageCache, Split};
use gs_train::evaluate::{EvalError, EvalReport, ViewScores, clamped, evaluate};
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::renderer::Renderer;
use gs_train::timestamp::Timestamp;
use serde::Serialize;
use std::time::Instant;

pub mod page;
pub mod path;
pub mod physics;

pub use path::CameraPath;
pub use physics::Physics;

/// Most frames of a forecast.
pub const MOST_FRAMES: usize = 10_000;
/// Times this close, in distances between frames, are the same.
const SAME: f64 = 0.01;

/// Why there is no forecast.
#[derive(Debug, thiserror::Error)]
pub enum ForecastError {
    /// Nothing lies between the two times.
    #[error("there is nothing to forecast from {from} to {until}: the end must be later")]
    Empty {
        /// First time.
        from: f64,
        /// Last time.
        until: f64,
    },
    /// Too many frames, or a distance that is none.
    #[error("frames every {interval} from {from} to {until} are not possible: 1 to {MOST_FRAMES} are")]
    Frames {
        /// First time.
        from: f64,
        /// Last time.
        until: f64,
        /// Distance of frames.
        interval: f64,
    },
    /// No view has that name.
    #[error("no view is named \"{name}\"; there are {some}, …")]
    NoView {
        /// The name asked for.
        name: String,
        /// A few that there are.
        some: String,
    },
    /// Photographs cannot be read, or frames cannot be compared.
    #[error(transparent)]
    Eval(#[from] EvalError),
}

/// How frames lie between two times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Spacing {
    /// This far apart, normalised.
    Interval(f64),
    /// So many, evenly, the last one at the end.
    Count(usize),
}

/// Times after `from` up to `until`, normalised.
///
/// # Errors
/// If there are none, or too many.
pub fn times(from: f64, until: f64, spacing: Spacing) -> Result<Vec<f64>, ForecastError> {
    if !(until > from && until.is_finite() && from.is_finite()) {
        return Err(ForecastError::Empty { from, until });
    }
    let (count, interval) = match spacing {
        Spacing::Count(n) => (n as f64, (until - from) / n.max(1) as f64),
        Spacing::Interval(d) => (((until - from) / d + SAME).floor(), d),
    };
    if !(count >= 1.0 && count <= MOST_FRAMES as f64) {
        return Err(ForecastError::Frames { from, until, interval });
    }
    Ok((1..=count as usize).map(|k| from + k as f64 * interval).collect())
}

/// The data's clock: seconds `start + rate t` at normalised time `t`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Clock {
    /// Reading at normalised time 0.
    pub start: f64,
    /// Seconds that the whole sequence (0..1) takes.
    pub rate: f64,
}

impl Clock {
    /// The clock of a data set; none where it only repeats the normalised time, or the scene stands still.
    pub fn of(dataset: &Dataset) -> Option<Self> {
        let all = || dataset.train.iter().chain(&dataset.extrapolate).map(|v| v.time);
        let first = all().min_by(|a, b| a.normalised.total_cmp(&b.normalised))?;
        let last = all().max_by(|a, b| a.normalised.total_cmp(&b.normalised))?;
        let rate = (last.seconds - first.seconds) / f64::from(last.normalised - first.normalised);
        let start = first.seconds - rate * f64::from(first.normalised);
        let known = rate > 0.0 && rate.is_finite() && ((rate - 1.0).abs() > 1e-6 || start.abs() > 1e-6);
        known.then_some(Self { start, rate })
    }

    /// The time of a normalised one.
    pub fn time(clock: Option<Self>, t: f64) -> Time {
        Time { normalised: t as f32, seconds: clock.map_or(t, |c| c.start + c.rate * t) }
    }
}

/// A drawn frame and what it took.
pub struct Frame {
    /// The picture, in `[0, 1]`.
    pub image: Image,
    /// Milliseconds from the time to splats.
    pub motion_ms: f64,
    /// Milliseconds from splats to the picture.
    pub drawing_ms: f64,
}

/// Draws one frame.
///
/// # Errors
/// If the method cannot be asked for its splats.
pub fn draw(method: &Model, renderer: &mut Renderer, camera: &Camera, time: Time) -> Result<Frame, MethodError> {
    let begun = Instant::now();
    let splats = method.splats(&Timestamp::new(time), camera)?;
    let motion = begun.elapsed();
    let drawn = Instant::now();
    let image = clamped(renderer.render(&splats, camera));
    let ms = |d: std::time::Duration| 1e3 * d.as_secs_f64();
    Ok(Frame { image, motion_ms: ms(motion), drawing_ms: ms(drawn.elapsed()) })
}

/// Scores at one moment, means over the views there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MomentScores {
    /// Normalised time.
    pub time: f64,
    /// How far beyond the last training time, normalised.
    pub beyond: f64,
    /// Views.
    pub views: usize,
    /// dB; absent where all views are perfect.
    pub psnr: Option<f64>,
    /// Structural similarity.
    pub ssim: f64,
    /// dB where masks count, where views have masks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub masked_psnr: Option<f64>,
}

/// The truth about a future.
pub struct Truth {
    /// Scores of every view of it.
    pub report: EvalReport,
    cameras: Vec<Camera>,
}

impl Truth {
    /// Scores the views of the future up to a time; none if there is no such view.
    ///
    /// # Errors
    /// If a photograph cannot be read or a frame is not finite.
    pub fn of(
        method: &Model,
        dataset: &Dataset,
        until: f64,
        background: [f32; 3],
        photographs: &ImageCache,
    ) -> Result<Option<Self>, EvalError> {
        let known = dataset.extrapolate.iter().filter(|v| f64::from(v.time.normalised) <= until + 1e-6);
        let known = Dataset { extrapolate: known.cloned().collect(), ..dataset.without_views() };
        if known.extrapolate.is_empty() {
            return Ok(None);
        }
        let report = evaluate(method, &known, Split::Extrapolate, background, photographs)?;
        let cameras = known.extrapolate.iter().map(|v| photographs.camera(v)).collect();
        Ok(Some(Self { report, cameras }))
    }

    /// The scores of the view with this camera and time, if there is one; `interval` is the distance between frames.
    pub fn frame(&self, camera: &Camera, time: f64, interval: f64) -> Option<&ViewScores> {
        let near = |v: &ViewScores| (f64::from(v.time) - time).abs() <= SAME * interval;
        self.report.views.iter().zip(&self.cameras).find(|(v, c)| near(v) && *c == camera).map(|(v, _)| v)
    }

    /// Scores moment by moment, in order of time; `last` is the last training time.
    pub fn moments(&self, last: f64) -> Vec<MomentScores> {
        let mut views: Vec<&ViewScores> = self.report.views.iter().collect();
        views.sort_by(|a, b| a.time.total_cmp(&b.time));
        let of = |group: &[&ViewScores]| {
            let mean = |value: fn(&ViewScores) -> Option<f64>| {
                gs_metrics::Mean::of(group.iter().filter_map(|v| value(v))).value
            };
            let time = f64::from(group[0].time);
            MomentScores {
                time,
                beyond: time - last,
                views: group.len(),
                psnr: mean(|v| v.psnr),
                ssim: mean(|v| Some(v.ssim)).unwrap_or(0.0),
                masked_psnr: mean(|v| v.masked?.psnr),
            }
        };
        views.chunk_by(|a, b| a.time == b.time).map(of).collect()
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
    use gs_synth::{SynthOptions, generate};

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
            (0.5, 1.0, Spacing::Count(MOST_FRAMES + 1)),
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
        let options = SynthOptions { size: 8, train_views: 5, val_views: 0, test_views: 0, ..SynthOptions::default() };
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
