//! Writing a generated scene as a Nerfies folder: one pose per image, as of a single moving camera.
//!
//! ```text
//! dataset.json, metadata.json     ids train_000 … and test_000 …; time and camera of each (0 trains, 1 is held out)
//! scene.json                      the frame of the files is the world of truth.json: centre 0, scale 1
//! camera/ID.json                  pose, intrinsics and distortion at full size
//! rgb/1x/ID.png, rgb/2x/ID.png    over white: the layout has no alpha
//! extra.json                      time ids per unit of the scene's time
//! points.npy                      [P, 3] surface points visible to training cameras, all at time 0
//! truth.json                      ground truth
//! ```
//! Times are whole `time_id`s: with `n` training and `m` test views and `L = lcm(n − 1, 2m)`, training view `k` has
//! `k L / (n − 1)`, test view `k` has `(2k + 1) L / 2m`. The layout has no third split: validation views are left out.

use std::path::Path;

use gs_core::io::npy;
use gs_core::{Camera, Rng, cast};
use rayon::prelude::*;
use serde_json::{Map, Value, json};

use super::save::{create_dir, save, save_json, save_rgb};
use super::write::{check_vacant, truth_json};
use super::{CAMERA_RADIUS, HALF_SIDE, SynthData, SynthOptions, Truth, generate};
use gs_data::{DataError, ImageSource, ImageU8, Lens, View};

/// Number of rays cast for `points.npy`.
const RAYS: u32 = 4000;

/// A view to write.
struct Entry<'a> {
    id: String,
    time: u64,
    camera: u32,
    view: &'a View,
}

/// Generates a scene and writes it to `dir` in the Nerfies layout, one training camera per image, held-out ones as a second camera. Unless `overwrite` is set
/// the folder must be empty or absent.
///
/// # Errors
/// `data.option` for static cameras, for an odd size, which has no half, and for more timestamps than `u32` can number;
/// `io.exists` if the folder holds files, `io.write` if writing fails, else as [`generate`].
pub fn write_nerfies(dir: &Path, name: &str, options: &SynthOptions, overwrite: bool) -> Result<SynthData, DataError> {
    check_vacant(dir, overwrite)?;
    if options.cameras > 0 {
        let rule = "0: the Nerfies layout is for one moving camera; the D-NeRF layout has static cameras".into();
        return Err(DataError::Option { name: "cameras", value: options.cameras.to_string(), rule });
    }
    if options.size % 2 == 1 {
        let rule = "an even number: the layout also holds images of half the size".into();
        return Err(DataError::Option { name: "size", value: options.size.to_string(), rule });
    }
    let ids = TimeIds::of(options)?;
    let data = generate(name, options)?;
    let entries = entries(&data, &ids);
    for folder in ["camera", "rgb/1x", "rgb/2x"] {
        create_dir(dir.join(folder))?;
    }
    entries.par_iter().try_for_each(|entry| {
        save_json(&dir.join(format!("camera/{}.json", entry.id)), &camera(entry.view))?;
        let ImageSource::Memory(image) = &entry.view.image else { return Ok(()) };
        let opaque = over_white(image);
        save_rgb(&dir.join(format!("rgb/1x/{}.png", entry.id)), &opaque)?;
        let half = opaque.box_downscaled(image.width / 2, image.height / 2);
        save_rgb(&dir.join(format!("rgb/2x/{}.png", entry.id)), &half)
    })?;
    save_json(&dir.join("dataset.json"), &lists(&entries))?;
    save_json(&dir.join("metadata.json"), &tags(&entries))?;
    save_json(&dir.join("scene.json"), &frame())?;
    // So the data's own clock is that of the truth.
    save_json(&dir.join("extra.json"), &json!({"fps": ids.per_unit()}))?;
    save_json(&dir.join("truth.json"), &truth_json(&data.truth))?;
    save_points(&dir.join("points.npy"), &data)?;
    Ok(data)
}

/// Steps of `time_id` from one training view to the next, and of half the interval between test views.
struct TimeIds {
    train: u64,
    test: u64,
    /// Number of those halves in the sequence.
    halves: u64,
}

impl TimeIds {
    fn of(options: &SynthOptions) -> Result<Self, DataError> {
        let steps = u64::from(options.train_views).saturating_sub(1).max(1);
        let halves = (2 * u64::from(options.test_views)).max(1);
        let last = steps / gcd(steps, halves) * halves;
        if last > u64::from(u32::MAX) {
            let rule =
                format!("so many that {} training views and they have a common clock of 32 bits", options.train_views);
            return Err(DataError::Option { name: "test_views", value: options.test_views.to_string(), rule });
        }
        Ok(Self { train: last / steps, test: last / halves, halves })
    }

    /// Ids from time 0 to 1.
    fn per_unit(&self) -> u64 {
        self.test * self.halves
    }
}

/// Training and test views with their ids and times; a static scene has one timestamp.
fn entries<'a>(data: &'a SynthData, ids: &TimeIds) -> Vec<Entry<'a>> {
    let rate = u64::from(data.truth.dynamic());
    let entry = |split: &str, camera, k: usize, view, time| Entry { id: format!("{split}_{k:03}"), time, camera, view };
    let (train, test) = (data.dataset.train.iter().enumerate(), data.dataset.test.iter().enumerate());
    let train = train.map(|(k, v)| entry("train", 0, k, v, rate * ids.train * k as u64));
    let test = test.map(|(k, v)| entry("test", 1, k, v, rate * ids.test * (2 * k as u64 + 1)));
    train.chain(test).collect()
}

fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

fn lists(entries: &[Entry]) -> Value {
    let of = |camera: u32| entries.iter().filter(|s| s.camera == camera).map(|s| s.id.as_str()).collect::<Vec<_>>();
    let all: Vec<_> = entries.iter().map(|s| s.id.as_str()).collect();
    json!({ "count": all.len(), "num_exemplars": of(0).len(), "ids": all, "train_ids": of(0), "val_ids": of(1) })
}

fn tags(entries: &[Entry]) -> Value {
    let tag =
        |s: &Entry| json!({ "time_id": s.time, "warp_id": s.time, "appearance_id": s.time, "camera_id": s.camera });
    entries.iter().map(|s| (s.id.clone(), tag(s))).collect::<Map<_, _>>().into()
}

/// Near and far depth of a sphere around the scene, from the distance of all cameras.
fn frame() -> Value {
    let reach = f64::from(HALF_SIDE) * 3.0f64.sqrt();
    json!({ "scale": 1.0, "center": [0.0, 0.0, 0.0], "near": CAMERA_RADIUS - reach, "far": CAMERA_RADIUS + reach })
}

fn camera(view: &View) -> Value {
    let Camera { rotation: r, fx, fy, cx, cy, width, height, .. } = &view.camera;
    let lens = view.lens.unwrap_or_default();
    let row = |i: usize| r.row(i).to_array();
    json!({
        "orientation": [row(0), row(1), row(2)],
        "position": view.camera.position().to_array(),
        "focal_length": fx,
        "principal_point": [cx, cy],
        "skew": lens.skew * fx,
        "pixel_aspect_ratio": fy / fx,
        "radial_distortion": [lens.k1, lens.k2, lens.k3],
        "tangential_distortion": [lens.p1, lens.p2],
        "image_size": [width, height],
    })
}

/// The camera with another principal point and non-square pixels, and a lens: every intrinsic that the layout has.
pub(super) fn with_lens(camera: Camera) -> (Camera, Lens) {
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let camera = Camera { fy: 1.02 * camera.fy, cx: 0.53 * width, cy: 0.48 * height, ..camera };
    (camera, Lens { k1: -0.12, k2: 0.03, k3: -0.004, p1: 0.002, p2: -0.003, skew: 0.01, ..Lens::default() })
}

fn over_white(image: &ImageU8) -> ImageU8 {
    let over = |p: &[u8]| {
        let alpha = f32::from(p[3]) / 255.0;
        let blend = |c: u8| cast::to_u8(f32::from(c) * alpha + 255.0 * (1.0 - alpha) + 0.5);
        [blend(p[0]), blend(p[1]), blend(p[2]), 255]
    };
    ImageU8 { data: image.data.chunks_exact(4).flat_map(over).collect(), ..*image }
}

/// Writes the intersections of random rays of the training cameras at time 0; no file if there are none.
fn save_points(file: &Path, data: &SynthData) -> Result<(), DataError> {
    let each = RAYS.div_ceil(cast::to_u32(data.dataset.train.len()));
    let points: Vec<f32> =
        data.dataset.train.iter().enumerate().flat_map(|(k, v)| visible_points(&data.truth, k, v, each)).collect();
    if points.is_empty() {
        return Ok(());
    }
    let mut bytes = Vec::new();
    npy::write(&[points.len() / 3, 3], &points, &mut bytes).map_err(|e| DataError::write(file, e))?;
    save(file, &bytes)
}

fn visible_points(truth: &Truth, number: usize, view: &View, rays: u32) -> Vec<f32> {
    let mut rng = Rng::new(truth.options().seed, "synth.points", 0, number as u64);
    let (width, height) = (view.camera.width as f32, view.camera.height as f32);
    let aim = |_| (f64::from(rng.range(0.0, width)), f64::from(rng.range(0.0, height)));
    let hits = (0..rays).map(aim).filter_map(|(u, v)| truth.hit(&view.camera, 0.0, u, v));
    hits.flat_map(|hit| hit.world.as_vec3().to_array()).collect()
}
