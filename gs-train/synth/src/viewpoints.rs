//! Cameras and times of the views of a generated scene. Every camera is on the upper hemisphere and looks at the origin.
//!
//! Without static cameras every view has a camera of its own at a random position. With them, camera `i` of all is at the
//! `i`-th point of the sequence R₂ (Roberts 2018: multiples of the plastic number's powers, modulo 1; any run of successive
//! points is spread evenly), the held-out ones last.

use glam::DVec3;
use gs_core::{Camera, Rng};

use super::{CAMERA_RADIUS, FOV_X, SynthOptions};
use gs_data::DataError;

/// Camera and time of a view.
pub(super) struct Viewpoint {
    pub(super) name: String,
    pub(super) camera: Camera,
    /// Number of the camera.
    pub(super) camera_id: u32,
    /// Normalised time.
    pub(super) time: f64,
}

/// Cameras and times of all views of a scene, by split.
pub(super) struct Viewpoints {
    pub(super) train: Vec<Viewpoint>,
    pub(super) val: Vec<Viewpoint>,
    pub(super) test: Vec<Viewpoint>,
    pub(super) extrapolate: Vec<Viewpoint>,
    /// Number of evenly spaced timestamps from 0 to 1.
    pub(super) times: u32,
    /// Number of timestamps of training views.
    pub(super) training_times: u32,
    /// [`gs_data::Dataset::time_source`].
    pub(super) time_source: &'static str,
}

/// Tolerance for times rounded in files, as readers have it.
const SLACK: f64 = 1e-6;

impl Viewpoints {
    /// The views that the options ask for.
    pub(super) fn of(o: &SynthOptions, dynamic: bool) -> Result<Self, DataError> {
        if o.cameras > 0 { Self::of_static_cameras(o, dynamic) } else { Self::of_random_cameras(o) }
    }

    /// A random camera for each view.
    fn of_random_cameras(o: &SynthOptions) -> Result<Self, DataError> {
        let split = |purpose: &str, n: u32, time: &dyn Fn(u32) -> f64| {
            let viewpoint = |k| {
                let camera = random_camera(o, purpose, k)?;
                Ok(Viewpoint { name: format!("r_{k:03}"), camera, camera_id: k, time: time(k) })
            };
            (0..n).map(viewpoint).collect::<Result<Vec<_>, DataError>>()
        };
        let held_out = |count: u32| move |k: u32| (f64::from(k) + 0.5) / f64::from(count);
        Ok(Self {
            train: split("synth.train", o.train_views, &|k| timestamp(k, o.train_views))?,
            val: split("synth.val", o.val_views, &held_out(o.val_views))?,
            test: split("synth.test", o.test_views, &held_out(o.test_views))?,
            extrapolate: Vec::new(),
            times: o.train_views,
            training_times: o.train_views,
            time_source: "generated: view index over 0..1",
        })
    }

    /// Static cameras; in every split camera after camera, each ascending in time. A static scene has one timestamp.
    fn of_static_cameras(o: &SynthOptions, dynamic: bool) -> Result<Self, DataError> {
        let times = if dynamic { o.moments } else { 1 };
        let past = (0..times).filter(|&k| timestamp(k, times) <= o.boundary + SLACK).map(|_| 1).sum();
        let split = |cameras: std::ops::Range<u32>, indices: std::ops::Range<u32>| {
            let mut split_views = Vec::new();
            for camera_id in cameras {
                let camera = static_camera(o, camera_id)?;
                split_views.extend(indices.clone().map(|k| Viewpoint {
                    name: format!("c{camera_id:02}_t{k:03}"),
                    camera: camera.clone(),
                    camera_id,
                    time: timestamp(k, times),
                }));
            }
            Ok::<_, DataError>(split_views)
        };
        let all = o.cameras + o.held_out;
        Ok(Self {
            train: split(0..o.cameras, 0..past)?,
            val: Vec::new(),
            test: split(o.cameras..all, 0..past)?,
            extrapolate: split(0..all, past..times)?,
            times,
            training_times: past,
            time_source: "generated: timestamp index over 0..1",
        })
    }
}

/// Time of timestamp `k` of `n`.
fn timestamp(k: u32, n: u32) -> f64 {
    f64::from(k) / f64::from(n.saturating_sub(1).max(1))
}

/// A camera at a random position.
fn random_camera(o: &SynthOptions, purpose: &str, k: u32) -> Result<Camera, DataError> {
    let mut rng = Rng::new(o.seed, purpose, 0, u64::from(k));
    let turn = f64::from(rng.uniform());
    camera_at(o, turn, f64::from(rng.range(0.1, 0.95)))
}

/// Static camera `i`.
fn static_camera(o: &SynthOptions, i: u32) -> Result<Camera, DataError> {
    /// 1/ρ and 1/ρ², ρ³ = ρ + 1.
    const STEPS: [f64; 2] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_2];
    let mut rng = Rng::new(o.seed, "synth.rig", 0, 0);
    let [turn, height] = STEPS.map(|step| (f64::from(rng.uniform()) + step * f64::from(i)).fract());
    camera_at(o, turn, 0.15 + 0.75 * height)
}

/// The camera at the azimuth `2π turn`, with `z` as the sine of its elevation.
fn camera_at(o: &SynthOptions, turn: f64, z: f64) -> Result<Camera, DataError> {
    let azimuth = turn * std::f64::consts::TAU;
    let flat = (1.0 - z * z).sqrt();
    let eye = DVec3::new(flat * azimuth.cos(), flat * azimuth.sin(), z) * CAMERA_RADIUS;
    Camera::look_at(o.size, o.size, FOV_X, eye, DVec3::ZERO, DVec3::Z).map_err(|e| DataError::Option {
        name: "size",
        value: o.size.to_string(),
        rule: e.to_string(),
    })
}
