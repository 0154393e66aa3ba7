//! The position of a body in a trained scene against a measured track, before and after the last training time.
//!
//! The body is the set of splats within a radius of the track at the last training time, weighted by opacity and
//! cross-section. Their weighted centroid is followed to the other times, so no track position after the last training time
//! is used. The offset of the centroid at that time is part of the error.

mod kalman;

use crate::moments::Moment;
use glam::{DMat3, DVec3};
use gs_core::io::{Limits, read_text};
use gs_core::{Camera, Splats, Time, cast};
use gs_data::Dataset;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::timestamp::Timestamp;
use kalman::Kalman;
use serde::Serialize;
use std::path::Path;

/// Measured positions of a body.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// Time and position (world units) of each measurement, in order of time.
    pub places: Vec<(Time, DVec3)>,
    /// The moments of the data.
    moments: Vec<Moment>,
}

/// A track that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TrackError {
    /// The model cannot produce its splats.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// The file cannot be read.
    #[error("cannot read {path}: {why}")]
    Read {
        /// Path of the track, as given.
        path: String,
        /// What the system said.
        why: String,
    },
    /// A line is not `frame,x,y,z`.
    #[error("{path}, line {line}: \"{text}\" is not frame,x,y,z with finite numbers")]
    Line {
        /// Path of the track, as given.
        path: String,
        /// Number of the line, from 1.
        line: usize,
        /// The line as the file holds it.
        text: String,
    },
    /// No splat is near the track at the last training time.
    #[error("no splat lies within {radius} of the track at time {t}; give a larger radius, or train longer")]
    Nothing {
        /// Radius around the track, world units.
        radius: f64,
        /// The last training time, normalised.
        t: f32,
    },
    /// The track has more frames than the data have times.
    #[error(
        "frame {frame} of the track lies beyond the {moments} moments of the data; the first line is the first moment"
    )]
    Beyond {
        /// The frame in the file.
        frame: f64,
        /// Number of moments of all views.
        moments: usize,
    },
    /// The track has no position at or before the last training time.
    #[error("the track has no place at or before the last training time {0}")]
    NoStart(f32),
}

impl Track {
    /// Reads lines `frame,x,y,z` (`#` starts a comment line). The smallest frame is the first moment of the data, and each
    /// following frame the next one.
    ///
    /// # Errors
    /// If the file cannot be read, a line is not four finite numbers, or there are more frames than moments.
    pub fn read(path: &Path, dataset: &Dataset) -> Result<Self, TrackError> {
        let moments = Moment::all(dataset);
        let lines = lines(path)?;
        let first = lines.iter().map(|l| l.0).fold(f64::INFINITY, f64::min);
        let place = |(frame, x): (f64, DVec3)| {
            let moment = moments.get(cast::to_usize((frame - first).round()));
            moment.map(|m| (m.time, x)).ok_or(TrackError::Beyond { frame, moments: moments.len() })
        };
        let mut places = lines.into_iter().map(place).collect::<Result<Vec<_>, _>>()?;
        places.sort_by(|a, b| a.0.normalised.total_cmp(&b.0.normalised));
        Ok(Self { places, moments })
    }

    /// Number of measurements up to the moment of a normalised time.
    fn until(&self, t: f32) -> usize {
        let last = Moment::nearest(&self.moments, t).map_or(t, |m| m.time.normalised);
        self.places.iter().filter(|p| p.0.normalised <= last).count()
    }
}

/// Frame and position of every line.
fn lines(path: &Path) -> Result<Vec<(f64, DVec3)>, TrackError> {
    let name = path.display().to_string();
    let text = read_text(path, &Limits::default());
    let text = text.map_err(|e| TrackError::Read { path: name.clone(), why: e.to_string() })?;
    let mut all = Vec::new();
    for (i, line) in text.lines().enumerate() {
        if line.trim().is_empty() || line.trim_start().starts_with('#') {
            continue;
        }
        let numbers: Vec<f64> = line.split(',').filter_map(|n| n.trim().parse().ok()).collect();
        match numbers[..] {
            [f, x, y, z] if numbers.iter().all(|n| n.is_finite()) => all.push((f, DVec3::new(x, y, z))),
            _ => return Err(TrackError::Line { path: name, line: i + 1, text: line.chars().take(60).collect() }),
        }
    }
    Ok(all)
}

/// The position of the body at one time of the track.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TrackPoint {
    /// Normalised time of the point.
    pub t: f32,
    /// Seconds on the clock of the data.
    pub seconds: f64,
    /// Track entries after the last one in the training span; 0 or less within it.
    pub ahead: i64,
    /// Centroid of the body, world units.
    pub place: [f64; 3],
    /// Distance from the measured position, world units.
    pub error: f64,
    /// The same distance for extrapolation at the velocity of the last two measurements in the training span;
    /// none for a single one.
    pub constant_velocity: Option<f64>,
    /// The same for the least-squares parabola through the measurements in the training span; none for fewer than four.
    pub measured_parabola: Option<f64>,
    /// The same for the parabola through the body's own places at these times.
    pub own_parabola: Option<f64>,
    /// The same for a Kalman filter of nearly constant acceleration over the measurements in the training span; none for fewer than
    /// five.
    pub kalman: Option<f64>,
}

/// A model against a track.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrackReport {
    /// Number of splats of the body.
    pub splats: usize,
    /// The body at every time of the track.
    pub moments: Vec<TrackPoint>,
    /// Acceleration of the centroid after the last training time, world units per second squared, by a least-squares parabola.
    pub acceleration: Option<[f64; 3]>,
    /// The same for the measured positions at these times.
    pub measured_acceleration: Option<[f64; 3]>,
    /// Standard deviation of [`Self::measured_acceleration`], from what the parabola leaves unexplained, errors of the positions taken as independent.
    pub measured_deviation: Option<[f64; 3]>,
}

impl TrackReport {
    /// A text table of the times after the last training time, then the accelerations.
    pub fn text(&self) -> String {
        let mut text = format!("a body of {} splats against its measured track\n", self.splats);
        let heads = ["error", "constant velocity", "measured parabola", "measured Kalman", "own parabola"];
        text.push_str(&format!("{:>8}  {:>6}", "time", "ahead"));
        heads.iter().for_each(|head| text.push_str(&format!("  {head:>17}")));
        for m in self.moments.iter().filter(|m| m.ahead >= 0) {
            text.push_str(&format!("\n{:>8.4}  {:>6}", m.t, m.ahead));
            for value in [Some(m.error), m.constant_velocity, m.measured_parabola, m.kalman, m.own_parabola] {
                text.push_str(&value.map_or(format!("  {:>17}", "-"), |v| format!("  {v:>17.4}")));
            }
        }
        text.push('\n');
        let all = [
            ("acceleration, forecast", self.acceleration),
            ("acceleration, measured", self.measured_acceleration),
            ("  standard deviation", self.measured_deviation),
        ];
        for (name, [x, y, z]) in all.into_iter().filter_map(|(name, a)| Some((name, a?))) {
            text.push_str(&format!("{name}: {x:.2} {y:.2} {z:.2} units/s²\n"));
        }
        text
    }
}

/// Follows the body of a track through a model; `last_time` is the last training time, normalised, `radius` in world units.
///
/// # Errors
/// If the track starts after `last_time` or no splat is near it.
pub fn follow(
    method: &Model,
    camera: &Camera,
    track: &Track,
    last_time: f32,
    radius: f64,
) -> Result<TrackReport, TrackError> {
    let seen = track.until(last_time);
    let Some(anchor) = seen.checked_sub(1) else { return Err(TrackError::NoStart(last_time)) };
    let (begin, from) = track.places[anchor];
    let body = Body::near(&method.all_splats(&Timestamp::new(begin), camera)?, from, radius);
    let Some(body) = body else { return Err(TrackError::Nothing { radius, t: begin.normalised }) };
    let before = anchor.checked_sub(1).map(|i| track.places[i]).filter(|(t, _)| begin.normalised > t.normalised);
    let velocity = before.map(|(t, x)| (from - x) / f64::from(begin.normalised - t.normalised));
    let own = |(t, _): &(Time, DVec3)| Ok((t.seconds, body.centre(&method.all_splats(&Timestamp::new(*t), camera)?)));
    let ours = track.places.iter().map(own).collect::<Result<Vec<_>, MethodError>>()?;
    let theirs: Vec<_> = track.places.iter().map(|(t, x)| (t.seconds, *x)).collect();
    let [measured, own] = [&theirs, &ours].map(|places| Parabola::through(&places[..seen]));
    let kalman = Kalman::of(&theirs[..seen]);
    let point = |i: usize| {
        let ((t, x), (_, place)) = (track.places[i], ours[i]);
        let straight = velocity.map(|v| from + v * f64::from(t.normalised - begin.normalised));
        let off = |p: &Parabola| p.at(t.seconds).distance(x);
        TrackPoint {
            t: t.normalised,
            seconds: t.seconds,
            ahead: i as i64 - anchor as i64,
            place: place.to_array(),
            error: place.distance(x),
            constant_velocity: straight.map(|s| s.distance(x)),
            measured_parabola: measured.as_ref().map(off),
            own_parabola: own.as_ref().map(off),
            kalman: kalman.map(|k| k.at(t.seconds).distance(x)),
        }
    };
    let [forecast, ahead] = [&ours, &theirs].map(|places| Parabola::through(&places[anchor..]));
    Ok(TrackReport {
        splats: body.rows.len(),
        moments: (0..ours.len()).map(point).collect(),
        acceleration: forecast.map(|p| p.acceleration()),
        measured_acceleration: ahead.map(|p| p.acceleration()),
        measured_deviation: ahead.map(|p| p.deviation.to_array()),
    })
}

/// Rows of splats with weights of sum 1.
struct Body {
    rows: Vec<(usize, f64)>,
}

impl Body {
    fn near(splats: &Splats, place: DVec3, radius: f64) -> Option<Self> {
        let near = |i: &usize| splats.means[*i].as_dvec3().distance(place) <= radius;
        let weight = |i: usize| {
            let s = splats.scales[i].abs().as_dvec3();
            // Mean cross-section of an ellipsoid, up to a factor: needles and dust count little.
            (i, f64::from(splats.opacities[i]) * (s.x * s.y + s.y * s.z + s.z * s.x))
        };
        let mut rows: Vec<(usize, f64)> = (0..splats.len()).filter(near).map(weight).collect();
        let sum: f64 = rows.iter().map(|r| r.1).sum();
        rows.iter_mut().for_each(|r| r.1 /= sum);
        (sum > 0.0).then_some(Self { rows })
    }

    fn centre(&self, splats: &Splats) -> DVec3 {
        self.rows.iter().map(|&(i, w)| splats.means[i].as_dvec3() * w).sum()
    }
}

/// The least-squares parabola through places and times.
#[derive(Clone, Copy, Debug)]
struct Parabola {
    middle: f64,
    /// Place, velocity and acceleration at `middle`.
    derivatives: [DVec3; 3],
    /// Standard deviation of the acceleration.
    deviation: DVec3,
}

impl Parabola {
    /// Through `(seconds, position)`; `None` for fewer than four, or times that do not tell a parabola.
    fn through(places: &[(f64, DVec3)]) -> Option<Self> {
        if places.len() < 4 {
            return None;
        }
        let n = places.len() as f64;
        let middle = places.iter().map(|p| p.0).sum::<f64>() / n;
        let (mut normal, mut right) = (DMat3::ZERO, [DVec3::ZERO; 3]);
        for &(t, x) in places {
            let t = t - middle;
            let row = DVec3::new(1.0, t, 0.5 * t * t);
            normal += DMat3::from_cols(row * row.x, row * row.y, row * row.z);
            (0..3).for_each(|k| right[k] += row * x[k]);
        }
        let inverse = normal.inverse();
        let axes = right.map(|r| inverse * r);
        let derivatives = [0, 1, 2].map(|k| DVec3::from_array(axes.map(|axis| axis[k])));
        let fit = Self { middle, derivatives, deviation: DVec3::ZERO };
        let left = |&(t, x): &(f64, DVec3)| (x - fit.at(t)) * (x - fit.at(t));
        let variance = places.iter().map(left).sum::<DVec3>() / (n - 3.0) * inverse.z_axis.z;
        let deviation = DVec3::from_array(variance.to_array().map(f64::sqrt));
        derivatives.iter().all(|d| d.is_finite()).then_some(Self { deviation, ..fit })
    }

    fn at(&self, seconds: f64) -> DVec3 {
        let (t, [x, v, a]) = (seconds - self.middle, self.derivatives);
        x + v * t + a * (0.5 * t * t)
    }

    fn acceleration(&self) -> [f64; 3] {
        self.derivatives[2].to_array()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_synth::{self as synth, SynthOptions};

    #[test]
    fn a_parabola_is_found_and_goes_on() {
        let (a, v) = (DVec3::new(0.0, 9.81, -1.0), DVec3::new(3.0, -2.0, 0.5));
        let places: Vec<(f64, DVec3)> = (0..8)
            .map(|k| (1.5 + f64::from(k) / 30.0, v * f64::from(k) / 30.0 + a * (f64::from(k) / 30.0).powi(2) * 0.5))
            .collect();
        let found = Parabola::through(&places[..5]).unwrap();
        assert!(DVec3::from_array(found.acceleration()).distance(a) < 1e-8);
        assert!(found.at(places[7].0).distance(places[7].1) < 1e-9, "and goes on");
        assert!(found.deviation.length() < 1e-6, "nothing is left unexplained");
        assert!(Parabola::through(&places[..3]).is_none());
        assert!(Parabola::through(&[places[0]; 5]).is_none(), "one time says nothing");
    }

    /// Over 400 tracks with independent errors of 1 cm, accelerations spread as their stated deviation says.
    #[test]
    fn the_deviation_of_an_acceleration_is_how_far_it_spreads() {
        let (mut spread, mut stated) = (0.0, 0.0);
        for track in 0..400 {
            let mut rng = gs_core::Rng::new(3, "track", 0, track);
            let mut error = || 0.01 * f64::from(rng.normal());
            let places: Vec<_> = (0..10)
                .map(|k| f64::from(k) / 30.0)
                .map(|t| (t, DVec3::Y * 4.905 * t * t + DVec3::new(error(), error(), error())))
                .collect();
            let fit = Parabola::through(&places).unwrap();
            spread += (DVec3::from_array(fit.acceleration()) - 9.81 * DVec3::Y).length_squared();
            stated += fit.deviation.length_squared();
        }
        let ratio: f64 = (spread / stated).sqrt();
        assert!((0.9..1.1).contains(&ratio), "{ratio}");
    }

    #[test]
    fn lines_are_read_and_faults_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("track.csv");
        std::fs::write(&path, "# frame,x,y,z\n41,1,2,3\n40, 0.5,0,-1e-1\n\n").unwrap();
        let options = SynthOptions::of_views(8, 3, 0);
        let data = synth::generate("balls", &options).unwrap().dataset;
        let track = Track::read(&path, &data).unwrap();
        assert_eq!(track.places[0].1, DVec3::new(0.5, 0.0, -0.1));
        assert_eq!((track.places[0].0, track.places[1].0), (data.train[0].time, data.train[1].time));
        for (text, fault) in [("40,1,2\n", "line 1"), ("40,1,2,nan\n", "line 1"), ("1,0,0,0\n9,0,0,0", "3 moments")] {
            std::fs::write(&path, text).unwrap();
            assert!(Track::read(&path, &data).unwrap_err().to_string().contains(fault), "{text}");
        }
        assert!(Track::read(&dir.path().join("none"), &data).is_err());
    }

    /// Four cameras, each late by its own thousandth, and a test camera that is later still.
    #[test]
    fn frames_are_moments_even_where_cameras_are_not_quite_together() {
        let options =
            SynthOptions { size: 8, cameras: 4, held_out: 1, moments: 6, supersample: 1, ..SynthOptions::default() };
        let mut data = synth::generate("balls", &options).unwrap().dataset;
        for view in [&mut data.train, &mut data.test, &mut data.extrapolate].into_iter().flatten() {
            view.time.normalised += 1e-3 * view.camera_id as f32;
        }
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("track.csv");
        let lines = |frames: std::ops::Range<u32>| frames.map(|k| format!("{k},0,0,{k}\n")).collect::<String>();
        std::fs::write(&path, lines(7..13)).unwrap();
        let track = Track::read(&path, &data).unwrap();
        for (k, (time, x)) in track.places.iter().enumerate() {
            assert!((time.normalised - (0.2 * k as f32 + 2e-3)).abs() < 1e-6 && x.z == 7.0 + k as f64, "{time:?} {x}");
        }
        // The last training camera is before the mean of its moment.
        let last = data.train.iter().filter(|v| v.camera_id < 2).map(|v| v.time.normalised).fold(0.0, f32::max);
        assert_eq!((track.places.len(), track.until(last), track.until(0.0)), (6, 4, 1));
        std::fs::write(&path, lines(7..14)).unwrap();
        assert!(Track::read(&path, &data).unwrap_err().to_string().contains("beyond the 6 moments"));
    }
}
