//! Generated scenes whose truth is known exactly: geometry, motion, depth, flow and segments at every moment, without a
//! download.
//!
//! Bodies follow closed-form motions ([`motion`]); a small ray tracer ([`trace`]) photographs them as D-NeRF does: one
//! camera per time on the upper hemisphere for training, other cameras at other times held out. Everything is a function of the
//! options alone, whatever the number of threads.

use std::sync::Arc;

use glam::{DVec3, Vec3};
use gs_core::{Camera, Rng, Time};
use serde::{Deserialize, Serialize};

use crate::data::{DataError, Dataset, ImageSource, Lens, View};
use write_nerfies::with_lens;

pub mod body;
pub mod maps;
pub mod motion;
pub mod scenes;
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
    /// Training views; view `k` of `n` is taken at time `k / (n − 1)`.
    pub train_views: u32,
    /// Validation views.
    pub val_views: u32,
    /// Test views; view `k` of `n` is taken at time `(k + ½) / n`.
    pub test_views: u32,
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
    let options = truth.options();
    let dynamic = truth.dynamic();
    let split = |purpose: &str, n: u32, time: &dyn Fn(u32) -> f64| {
        (0..n).map(|k| photograph(&truth, purpose, k, time(k))).collect::<Result<Vec<_>, _>>()
    };
    let (n, val, test) = (options.train_views, options.val_views, options.test_views);
    let held_out = |count: u32| move |k: u32| (f64::from(k) + 0.5) / f64::from(count);
    let train = split("synth.train", n, &|k| f64::from(k) / f64::from((n - 1).max(1)))?;
    let dataset = Dataset {
        root: Default::default(),
        layout: "synth",
        train,
        val: split("synth.val", val, &held_out(val))?,
        test: split("synth.test", test, &held_out(test))?,
        extrapolate: Vec::new(),
        points: None,
        has_alpha: true,
        dynamic: dynamic && n > 1,
        time_source: if dynamic { "generated: view index over 0..1" } else { "static" }.into(),
        bounds: Some([Vec3::splat(-HALF_SIDE), Vec3::splat(HALF_SIDE)]),
        notes: notes(&truth, n),
    };
    Ok(SynthData { dataset, truth })
}

/// What was generated and, where bodies move periodically, whether the training times resolve it: evenly spaced times `1/(n −
/// 1)` apart show up to `(n − 1)/2` cycles (Nyquist).
fn notes(truth: &Truth, train_views: u32) -> Vec<String> {
    let mut notes = vec![format!("generated scene \"{}\", seed {}", truth.scene(), truth.options().seed)];
    let fastest = truth.bodies().iter().map(|b| b.cycles()).fold(0.0, f64::max);
    if truth.dynamic() && fastest > 0.0 {
        let nyquist = 0.5 * f64::from(train_views.saturating_sub(1));
        let verdict = if fastest < nyquist { "resolve" } else { "do not resolve" };
        notes.push(format!(
            "the fastest motion makes {fastest} cycles; {train_views} training times {verdict} it (up to {nyquist} cycles)"
        ));
    }
    notes
}

fn check(o: &SynthOptions) -> Result<(), DataError> {
    let wrong = |name, value: String, rule: &str| Err(DataError::Option { name, value, rule: rule.into() });
    if !(1..=4096).contains(&o.size) {
        return wrong("size", o.size.to_string(), "1 to 4096 pixels");
    }
    if o.train_views == 0 {
        return wrong("train_views", "0".into(), "at least one");
    }
    if !(1..=16).contains(&o.supersample) {
        return wrong("supersample", o.supersample.to_string(), "1 to 16");
    }
    if !(0.0..=1.0).contains(&o.shading) {
        return wrong("shading", o.shading.to_string(), "0 to 1");
    }
    let views = u64::from(o.train_views) + u64::from(o.val_views) + u64::from(o.test_views);
    if views * u64::from(o.size) * u64::from(o.size) * 4 > MAX_IMAGE_BYTES {
        return wrong("train_views", o.train_views.to_string(), "all images together below 8 GiB");
    }
    Ok(())
}

/// A view from a random point of the upper hemisphere.
fn photograph(truth: &Truth, purpose: &str, k: u32, t: f64) -> Result<View, DataError> {
    let camera = hemisphere_camera(truth.options(), purpose, k)?;
    let (camera, lens) = match truth.options().lens {
        true => with_lens(camera),
        false => (camera, Lens::default()),
    };
    let image = truth.photograph(&camera, &lens, t);
    let time = if truth.dynamic() { Time::new(t as f32) } else { Ok(Time::default()) };
    let time = time.map_err(|e| DataError::Option {
        name: "time",
        value: e.value.to_string(),
        rule: "a finite number".into(),
    })?;
    let view = View::new(format!("r_{k:03}"), camera, time, ImageSource::Memory(Arc::new(image)), k);
    Ok(View { lens: (!lens.is_pinhole()).then_some(lens), ..view })
}

fn hemisphere_camera(o: &SynthOptions, purpose: &str, k: u32) -> Result<Camera, DataError> {
    let mut rng = Rng::new(o.seed, purpose, 0, u64::from(k));
    let azimuth = f64::from(rng.uniform()) * std::f64::consts::TAU;
    let z = f64::from(rng.range(0.1, 0.95));
    let flat = (1.0 - z * z).sqrt();
    let eye = DVec3::new(flat * azimuth.cos(), flat * azimuth.sin(), z) * CAMERA_RADIUS;
    Camera::look_at(o.size, o.size, FOV_X, eye, DVec3::ZERO, DVec3::Z).map_err(|e| DataError::Option {
        name: "size",
        value: o.size.to_string(),
        rule: e.to_string(),
    })
}
