//! Generated dynamic scenes with exact ground truth: geometry, motion, depth, flow and segments at every time, without a
//! download.
//!
//! ```
//! use gs_data::ImageCache;
//! use gs_synth::{SynthOptions, generate};
//!
//! let options = SynthOptions::of_views(8, 3, 1);
//! let scene = generate("balls", &options)?;
//! let view = &scene.dataset.train[1];
//! assert_eq!((view.time.normalised, scene.dataset.dynamic), (0.5, true));
//! let image = ImageCache::new(0, 1.0).get(view)?; // RGBA, straight alpha
//! let depth = scene.truth.depth(&view.camera, 0.5); // camera-space z, 0 where nothing is visible
//! let visible: Vec<usize> = (0..8 * 8).filter(|&k| depth.data[k] > 0.0).collect();
//! assert!(!visible.is_empty() && visible.iter().all(|k| image.data[4 * k + 3] > 0));
//! assert_eq!(scene.truth.bodies()[0].name, "ball");
//! # Ok::<(), gs_data::DataError>(())
//! ```
//!
//! # Contents
//! * [`generate`] makes a scene of [`SCENES`] in memory. [`write()`] writes it in the D-NeRF layout, [`write_nerfies`] in that of Nerfies,
//!   [`write_maps`] the ground-truth maps beside it; [`blur`] adds motion blur to training images.
//! * Rigid bodies follow closed-form motions ([`motion`], derivatives and twists in [`rates`]), a sheet deforms ([`body`]). A small
//!   ray tracer ([`trace`]) renders them.
//! * [`Truth`] answers for any camera and time: depth, segments, flow, material points, poses, twists.
//! * [`avatar`]: films of a rigged person by rings of cameras.
//!
//! Cameras are those of D-NeRF: for training one random camera on the upper hemisphere per timestamp, held-out views from other
//! cameras at other times. With [`SynthOptions::cameras`] they are those of NVFi: static cameras that see every timestamp, of
//! which the last are held out for extrapolation.
//!
//! # Conventions
//! Those of [`gs_core`] and [`gs_data`]. World +z is up; every scene fits in the cube `[-1.3, 1.3]³` ([`HALF_SIDE`]), a variant may reach 1.32, cameras
//! look at the origin from a distance of 4 ([`CAMERA_RADIUS`]). Time is normalised to 0..1, velocities are per unit of it. Geometry
//! is `f64`. The result is a function of the options alone, bit for bit, for any number of threads.
//!
//! # What it leaves out
//! Shadows and textures from files but of filmed people ([`avatar`]), reflections, moving cameras with continuous paths; fluids and contact between bodies.
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

use std::sync::Arc;

use glam::Vec3;
use gs_core::{Time, cast};
use serde::{Deserialize, Serialize};

use gs_data::{DataError, Dataset, ImageSource, Lens, View};
use viewpoints::{Viewpoint, Viewpoints};
use write_nerfies::with_lens;

pub mod avatar;
pub mod blur;
pub mod body;
pub mod gains;
pub mod maps;
mod mechanics;
pub mod motion;
pub mod rates;
mod save;
pub mod scenes;
mod surface;
#[cfg(feature = "testkit")]
pub mod testkit;
pub mod trace;
mod truth;
mod variant;
mod viewpoints;
mod write;
mod write_nerfies;

pub use maps::write_maps;
pub use scenes::{SCENES, SynthScene};
pub use truth::{FlowMap, Truth};
pub use write::write;
pub use write_nerfies::write_nerfies;

/// Options of [`generate`]. Deserialising refuses unknown keys; the files of a generated scene record them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SynthOptions {
    /// Side of the square images, pixels.
    pub size: u32,
    /// Number of training views; view `k` of `n` is at time `k / (n − 1)`. With `cameras`, this and the next two are not used.
    pub train_views: u32,
    /// Number of validation views; view `k` of `n` is at time `(k + ½) / n`.
    pub val_views: u32,
    /// Number of test views; view `k` of `n` is at time `(k + ½) / n`.
    pub test_views: u32,
    /// Number of static training cameras, each with a view at every timestamp; 0: one camera per view.
    pub cameras: u32,
    /// Number of further static cameras, whose views are held out.
    pub held_out: u32,
    /// Number of timestamps of static cameras; timestamp `k` of `n` is at time `k / (n − 1)`.
    pub moments: u32,
    /// Views of static cameras later than this time, in (0, 1], are held out: [`Dataset::extrapolate`].
    pub boundary: f64,
    /// Seed of the camera positions.
    pub seed: u64,
    /// Variant of the scene: 0 as designed, others turned about z, at another pace (0.75 to 1.1), most with other colours and patterns.
    #[serde(skip_serializing_if = "is_zero")]
    pub variant: u64,
    /// Samples per pixel along each axis, 1 to 16; scenes with fine texture use at least [`SynthScene::least_supersample`].
    pub supersample: u32,
    /// Share of the brightness that depends on the light, 0..1. 0: every material point keeps its colour.
    pub shading: f64,
    /// Whether images have lens distortion, skew, non-square pixels and a principal point off the centre.
    pub lens: bool,
}

fn is_zero(variant: &u64) -> bool {
    *variant == 0
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
            variant: 0,
            supersample: 3,
            shading: 0.2,
            lens: false,
        }
    }
}

impl SynthOptions {
    /// Square images of `size` pixels from one moving camera: so many training and test views, no validation views.
    pub fn of_views(size: u32, train_views: u32, test_views: u32) -> Self {
        Self { size, train_views, val_views: 0, test_views, ..Self::default() }
    }
}

/// A generated scene: data set and ground truth.
#[derive(Clone, Debug)]
pub struct SynthData {
    /// Views with their images in memory.
    pub dataset: Dataset,
    /// Exact geometry and motion of the same scene.
    pub truth: Truth,
}

/// Horizontal field of view, radians, as in D-NeRF's synthetic scenes.
pub const FOV_X: f64 = 0.691_111_207_008_361_8;
/// Distance of the cameras from the origin, world units, as in D-NeRF's synthetic scenes.
pub const CAMERA_RADIUS: f64 = 4.0;
/// Half side of the cube around the origin that holds every scene, world units.
pub const HALF_SIDE: f32 = 1.3;
/// Most memory for all images together.
const MAX_IMAGE_BYTES: u64 = 8 << 30;

/// The ground truth of a scene of [`SCENES`], without rendering any view.
///
/// ```
/// use glam::DVec3;
///
/// let truth = gs_synth::truth("falling", &Default::default())?; // a thrown ball: constant acceleration
/// let ball = truth.rates_of(0, 0.5).unwrap();
/// assert_eq!(ball.centre[2], DVec3::new(0.0, 0.0, -4.4));
/// assert_eq!(ball.turn[0], DVec3::ZERO);
/// # Ok::<(), gs_data::DataError>(())
/// ```
///
/// # Errors
/// Those of [`generate`].
pub fn truth(name: &str, options: &SynthOptions) -> Result<Truth, DataError> {
    let scene = SCENES.iter().find(|s| s.name == name).ok_or_else(|| DataError::Option {
        name: "scene",
        value: name.into(),
        rule: format!("one of {}", SCENES.iter().map(|s| s.name).collect::<Vec<_>>().join(", ")),
    })?;
    check(options)?;
    let options = &SynthOptions { supersample: options.supersample.max(scene.least_supersample), ..*options };
    let mut bodies = (scene.bodies)();
    variant::vary(&mut bodies, options.variant, scene.fastest);
    Ok(Truth::new(bodies, scene.name, scene.dynamic, options))
}

/// The ground truth of a scene that was written to a folder, from its `truth.json`; none without that file, or if it names no
/// scene of [`SCENES`].
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

/// Generates a scene of [`SCENES`] in memory; for an example see the crate page.
///
/// # Errors
/// `data.option` if there is no scene of this name, or an option is out of its domain.
pub fn generate(name: &str, options: &SynthOptions) -> Result<SynthData, DataError> {
    let truth = truth(name, options)?;
    let dynamic = truth.dynamic();
    let viewpoints = Viewpoints::of(truth.options(), dynamic)?;
    let render = |split: Vec<Viewpoint>| split.into_iter().map(|v| view(&truth, v)).collect::<Result<Vec<_>, _>>();
    let source = if dynamic { viewpoints.time_source } else { "static" };
    let dataset = Dataset {
        root: Default::default(),
        layout: "synth",
        train: render(viewpoints.train)?,
        val: render(viewpoints.val)?,
        test: render(viewpoints.test)?,
        extrapolate: render(viewpoints.extrapolate)?,
        points: None,
        has_alpha: true,
        dynamic: dynamic && viewpoints.training_times > 1,
        time_source: source.into(),
        bounds: Some([Vec3::splat(-HALF_SIDE), Vec3::splat(HALF_SIDE)]),
        avatar: None,
        max_image_mib: None,
        notes: notes(&truth, viewpoints.times),
    };
    Ok(SynthData { dataset, truth })
}

/// Name and seed of the scene and, where bodies move periodically, whether the timestamps resolve it: evenly spaced ones
/// `1/(n − 1)` apart resolve up to `(n − 1)/2` cycles (Nyquist).
fn notes(truth: &Truth, count: u32) -> Vec<String> {
    let SynthOptions { seed, variant, .. } = *truth.options();
    let variant = if variant > 0 { format!(", variant {variant}") } else { String::new() };
    let mut notes = vec![format!("generated scene \"{}\", seed {seed}{variant}", truth.scene())];
    let fastest = truth.bodies().iter().map(|b| b.cycles()).fold(0.0, f64::max);
    if truth.dynamic() && fastest > 0.0 {
        let nyquist = 0.5 * f64::from(count.saturating_sub(1));
        let times = if truth.options().cameras > 0 { "timestamps" } else { "training times" };
        let shown = (1e3 * fastest).round() / 1e3;
        let verdict = if fastest < nyquist { "resolve" } else { "do not resolve" };
        notes.push(format!(
            "the fastest motion makes {shown} cycles; {count} {times} {verdict} it (up to {nyquist} cycles)"
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
            "above 0, at most 1: the share of the time that training views cover",
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

/// Renders a view.
fn view(truth: &Truth, at: Viewpoint) -> Result<View, DataError> {
    let (camera, lens) = match truth.options().lens {
        true => with_lens(at.camera),
        false => (at.camera, Lens::default()),
    };
    let image = truth.distorted_image(&camera, &lens, at.time);
    let time = if truth.dynamic() { Time::new(cast::to_f32(at.time)) } else { Ok(Time::default()) };
    let time = time.map_err(|e| DataError::Option {
        name: "time",
        value: e.value.to_string(),
        rule: "a finite number".into(),
    })?;
    let view = View::new(at.name, camera, time, ImageSource::Memory(Arc::new(image)), at.camera_id);
    Ok(View { lens: (!lens.is_pinhole()).then_some(lens), ..view })
}
