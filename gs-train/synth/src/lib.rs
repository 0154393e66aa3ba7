//! Generated scenes whose truth is known exactly: geometry, motion, depth, flow and segments at every moment, without a
//! download.
//!
//! Bodies follow closed-form motions ([`motion`]); a small ray tracer ([`trace`]) photographs them as D-NeRF does: one
//! camera per time on the upper hemisphere for training, other cameras at other times held out; or, with
//! [`SynthOptions::cameras`], as NVFi does: cameras at rest that photograph every moment, of which the last are the future.
//! Everything is a function of the options alone, whatever the number of threads.

use std::sync::Arc;

use glam::Vec3;
use gs_core::Time;
use serde::{Deserialize, Serialize};

use gs_data::{DataError, Dataset, ImageSource, Lens, View};
use shots::{Shot, Shots};
use write_nerfies::with_lens;

pub mod avatar;
pub mod blur;
pub mod body;
pub mod maps;
mod mechanics;
pub mod motion;
pub mod rates;
pub mod scenes;
mod shots;
mod surface;
pub mod trace;
mod truth;
mod write;
mod write_nerfies;

pub use maps::write_maps;
pub use scenes::{SCENES, SynthScene};
pub use truth::{FlowMap, Truth};
pub use write::write;
pub use write_nerfies::write_nerfies;

/// What to generate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SynthOptions {
    /// Side of the square images, pixels.
    pub size: u32,
    /// Training views; view `k` of `n` is taken at time `k / (n − 1)`. With `cameras`, this and the next two do nothing.
    pub train_views: u32,
    /// Validation views.
    pub val_views: u32,
    /// Test views; view `k` of `n` is taken at time `(k + ½) / n`.
    pub test_views: u32,
    /// Training cameras at rest, each of which photographs every moment; 0: a camera for each view.
    pub cameras: u32,
    /// Cameras at rest beside them whose pictures are held out.
    pub held_out: u32,
    /// Moments the cameras at rest photograph; moment `k` of `n` is at time `k / (n − 1)`.
    pub moments: u32,
    /// Pictures of cameras at rest that are later than this (0 to 1) are the future: [`Dataset::extrapolate`].
    pub boundary: f64,
    /// Seed of the cameras.
    pub seed: u64,
    /// Samples per pixel along each axis; a scene with fine texture takes at least its own number.
    pub supersample: u32,
    /// Part of the brightness that depends on the light, 0..1. 0: every material point keeps its colour.
    pub shading: f64,
    /// Whether pictures are taken through a lens that distorts, with leaning columns and the principal point off centre.
    pub lens: bool,
}

impl Default for SynthOptions {
    fn default() -> Self {
        Self {
            size: 200,
            train_views: 100,
            val_views: 10,
            test_views: 20,
            cameras: 0,
            held_out: 2,
            moments: 40,
            boundary: 0.75,
            seed: 0,
            supersample: 3,
            shading: 0.2,
            lens: false,
        }
    }
}

/// A generated scene.
#[derive(Clone, Debug)]
pub struct SynthData {
    /// Views with images in memory.
    pub dataset: Dataset,
    /// What really happened.
    pub truth: Truth,
}

/// Horizontal field of view, radians, and distance of the cameras, as in D-NeRF's synthetic scenes.
pub const FOV_X: f64 = 0.691_111_207_008_361_8;
/// Distance of the cameras from the origin.
pub const CAMERA_RADIUS: f64 = 4.0;
/// Half the side of the cube that holds every scene.
pub const HALF_SIDE: f32 = 1.3;
/// Most memory that images may take.
const MAX_IMAGE_BYTES: u64 = 8 << 30;

/// The truth of a scene, without taking its pictures.
///
/// # Errors
/// As [`generate`].
pub fn truth(name: &str, options: &SynthOptions) -> Result<Truth, DataError> {
    let scene = SCENES.iter().find(|s| s.name == name).ok_or_else(|| DataError::Option {
        name: "scene",
        value: name.into(),
        rule: format!("one of {}", SCENES.iter().map(|s| s.name).collect::<Vec<_>>().join(", ")),
    })?;
    check(options)?;
    let options = &SynthOptions { supersample: options.supersample.max(scene.least_supersample), ..*options };
    Ok(Truth::new((scene.bodies)(), scene.name, scene.dynamic, options))
}

/// The truth of the generated scene that was written to a folder; none if the folder holds no `truth.json` of a scene there is.
pub fn truth_of(dir: &std::path::Path) -> Option<Truth> {
    #[derive(Deserialize)]
    struct Written {
        scene: String,
        options: SynthOptions,
    }
    let text = std::fs::read_to_string(dir.join("truth.json")).ok()?;
    let written: Written = serde_json::from_str(&text).ok()?;
    truth(&written.scene, &written.options).ok()
}

/// Generates a scene in memory.
///
/// # Errors
/// `data.option` if there is no such scene, or an option is out of its domain.
pub fn generate(name: &str, options: &SynthOptions) -> Result<SynthData, DataError> {
    let truth = truth(name, options)?;
    let dynamic = truth.dynamic();
    let shots = Shots::of(truth.options(), dynamic)?;
    let take = |shots: Vec<Shot>| shots.into_iter().map(|s| photograph(&truth, s)).collect::<Result<Vec<_>, _>>();
    let source = if dynamic { shots.time_source } else { "static" };
    let dataset = Dataset {
        root: Default::default(),
        layout: "synth",
        train: take(shots.train)?,
        val: take(shots.val)?,
        test: take(shots.test)?,
        extrapolate: take(shots.extrapolate)?,
        points: None,
        has_alpha: true,
        dynamic: dynamic && shots.training_moments > 1,
        time_source: source.into(),
        bounds: Some([Vec3::splat(-HALF_SIDE), Vec3::splat(HALF_SIDE)]),
        avatar: None,
        notes: notes(&truth, shots.moments),
    };
    Ok(SynthData { dataset, truth })
}

/// What was generated and, where bodies move periodically, whether the training times resolve it: evenly spaced times `1/(n −
/// 1)` apart show up to `(n − 1)/2` cycles (Nyquist).
fn notes(truth: &Truth, moments: u32) -> Vec<String> {
    let mut notes = vec![format!("generated scene \"{}\", seed {}", truth.scene(), truth.options().seed)];
    let fastest = truth.bodies().iter().map(|b| b.cycles()).fold(0.0, f64::max);
    if truth.dynamic() && fastest > 0.0 {
        let nyquist = 0.5 * f64::from(moments.saturating_sub(1));
        let times = if truth.options().cameras > 0 { "moments" } else { "training times" };
        let shown = (1e3 * fastest).round() / 1e3;
        let verdict = if fastest < nyquist { "resolve" } else { "do not resolve" };
        notes.push(format!(
            "the fastest motion makes {shown} cycles; {moments} {times} {verdict} it (up to {nyquist} cycles)"
        ));
    }
    notes
}

fn check(o: &SynthOptions) -> Result<(), DataError> {
    let wrong = |name, value: String, rule: &str| Err(DataError::Option { name, value, rule: rule.into() });
    if !(1..=4096).contains(&o.size) {
        return wrong("size", o.size.to_string(), "1 to 4096 pixels");
    }
    if o.cameras == 0 && o.train_views == 0 {
        return wrong("train_views", "0".into(), "at least one");
    }
    if o.cameras > 0 && o.moments < 2 {
        return wrong("moments", o.moments.to_string(), "at least two");
    }
    if !(o.boundary > 0.0 && o.boundary <= 1.0) {
        return wrong(
            "boundary",
            o.boundary.to_string(),
            "above 0, at most 1: the part of the time that may be learnt from",
        );
    }
    if !(1..=16).contains(&o.supersample) {
        return wrong("supersample", o.supersample.to_string(), "1 to 16");
    }
    if !(0.0..=1.0).contains(&o.shading) {
        return wrong("shading", o.shading.to_string(), "0 to 1");
    }
    let (name, value, views) = match o.cameras {
        0 => {
            ("train_views", o.train_views, u64::from(o.train_views) + u64::from(o.val_views) + u64::from(o.test_views))
        }
        n => ("cameras", n, (u64::from(n) + u64::from(o.held_out)).saturating_mul(u64::from(o.moments))),
    };
    let bytes = views.saturating_mul(u64::from(o.size) * u64::from(o.size) * 4);
    if bytes > MAX_IMAGE_BYTES {
        return wrong(name, value.to_string(), "all images together below 8 GiB");
    }
    Ok(())
}

/// Takes a picture.
fn photograph(truth: &Truth, shot: Shot) -> Result<View, DataError> {
    let (camera, lens) = match truth.options().lens {
        true => with_lens(shot.camera),
        false => (shot.camera, Lens::default()),
    };
    let image = truth.photograph(&camera, &lens, shot.time);
    let time = if truth.dynamic() { Time::new(shot.time as f32) } else { Ok(Time::default()) };
    let time = time.map_err(|e| DataError::Option {
        name: "time",
        value: e.value.to_string(),
        rule: "a finite number".into(),
    })?;
    let view = View::new(shot.name, camera, time, ImageSource::Memory(Arc::new(image)), shot.camera_id);
    Ok(View { lens: (!lens.is_pinhole()).then_some(lens), ..view })
}
