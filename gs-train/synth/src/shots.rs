//! Who photographs a generated scene, and when. Every camera stands on the upper hemisphere and looks at the origin.
//!
//! Without cameras at rest every view has a camera of its own at a random place. With them, camera `i` of all stands at the
//! `i`-th point of the sequence R₂ (Roberts 2018: multiples of the plastic number's powers, modulo 1; any run of successive
//! points is spread evenly), the held-out ones last.

use glam::DVec3;
use gs_core::{Camera, Rng};

use super::{CAMERA_RADIUS, FOV_X, SynthOptions};
use gs_data::DataError;

/// One picture to take.
pub(super) struct Shot {
    pub(super) name: String,
    pub(super) camera: Camera,
    /// Which camera stands there.
    pub(super) camera_id: u32,
    /// When, normalised.
    pub(super) time: f64,
}

/// All pictures of a scene.
pub(super) struct Shots {
    pub(super) train: Vec<Shot>,
    pub(super) val: Vec<Shot>,
    pub(super) test: Vec<Shot>,
    pub(super) extrapolate: Vec<Shot>,
    /// Different times from 0 to 1, evenly spaced.
    pub(super) moments: u32,
    /// Different times of training views.
    pub(super) training_moments: u32,
    /// Where times come from, for people.
    pub(super) time_source: &'static str,
}

/// Rounding of times that are written to files; the same slack as readers have.
const SLACK: f64 = 1e-6;

impl Shots {
    /// The pictures that the options ask for.
    pub(super) fn of(o: &SynthOptions, dynamic: bool) -> Result<Self, DataError> {
        if o.cameras > 0 { Self::of_cameras_at_rest(o, dynamic) } else { Self::of_many_cameras(o) }
    }

    /// A camera for each view.
    fn of_many_cameras(o: &SynthOptions) -> Result<Self, DataError> {
        let split = |purpose: &str, n: u32, time: &dyn Fn(u32) -> f64| {
            let shot = |k| {
                let camera = somewhere(o, purpose, k)?;
                Ok(Shot { name: format!("r_{k:03}"), camera, camera_id: k, time: time(k) })
            };
            (0..n).map(shot).collect::<Result<Vec<_>, DataError>>()
        };
        let held_out = |count: u32| move |k: u32| (f64::from(k) + 0.5) / f64::from(count);
        Ok(Self {
            train: split("synth.train", o.train_views, &|k| moment(k, o.train_views))?,
            val: split("synth.val", o.val_views, &held_out(o.val_views))?,
            test: split("synth.test", o.test_views, &held_out(o.test_views))?,
            extrapolate: Vec::new(),
            moments: o.train_views,
            training_moments: o.train_views,
            time_source: "generated: view index over 0..1",
        })
    }

    /// Cameras at rest; in every list camera after camera, each with its moments in order. A scene at rest has one moment.
    fn of_cameras_at_rest(o: &SynthOptions, dynamic: bool) -> Result<Self, DataError> {
        let moments = if dynamic { o.moments } else { 1 };
        let past = (0..moments).filter(|&k| moment(k, moments) <= o.boundary + SLACK).count() as u32;
        let split = |cameras: std::ops::Range<u32>, moments_of: std::ops::Range<u32>| {
            let mut shots = Vec::new();
            for camera_id in cameras {
                let camera = spread(o, camera_id)?;
                shots.extend(moments_of.clone().map(|k| Shot {
                    name: format!("c{camera_id:02}_t{k:03}"),
                    camera: camera.clone(),
                    camera_id,
                    time: moment(k, moments),
                }));
            }
            Ok::<_, DataError>(shots)
        };
        let all = o.cameras + o.held_out;
        Ok(Self {
            train: split(0..o.cameras, 0..past)?,
            val: Vec::new(),
            test: split(o.cameras..all, 0..past)?,
            extrapolate: split(0..all, past..moments)?,
            moments,
            training_moments: past,
            time_source: "generated: moment index over 0..1",
        })
    }
}

/// Time of moment `k` of `n`.
fn moment(k: u32, n: u32) -> f64 {
    f64::from(k) / f64::from(n.saturating_sub(1).max(1))
}

/// A camera at a random place.
fn somewhere(o: &SynthOptions, purpose: &str, k: u32) -> Result<Camera, DataError> {
    let mut rng = Rng::new(o.seed, purpose, 0, u64::from(k));
    let turn = f64::from(rng.uniform());
    looking(o, turn, f64::from(rng.range(0.1, 0.95)))
}

/// Camera `i` of those at rest.
fn spread(o: &SynthOptions, i: u32) -> Result<Camera, DataError> {
    /// 1/ρ and 1/ρ², ρ³ = ρ + 1.
    const STEPS: [f64; 2] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_2];
    let mut rng = Rng::new(o.seed, "synth.rig", 0, 0);
    let [turn, height] = STEPS.map(|step| (f64::from(rng.uniform()) + step * f64::from(i)).fract());
    looking(o, turn, 0.15 + 0.75 * height)
}

/// The camera at `turn` times a whole turn of azimuth, with `z` as the sine of its elevation.
fn looking(o: &SynthOptions, turn: f64, z: f64) -> Result<Camera, DataError> {
    let azimuth = turn * std::f64::consts::TAU;
    let flat = (1.0 - z * z).sqrt();
    let eye = DVec3::new(flat * azimuth.cos(), flat * azimuth.sin(), z) * CAMERA_RADIUS;
    Camera::look_at(o.size, o.size, FOV_X, eye, DVec3::ZERO, DVec3::Z).map_err(|e| DataError::Option {
        name: "size",
        value: o.size.to_string(),
        rule: e.to_string(),
    })
}
