//! A generated scene as a Nerfies folder: one camera per picture, as a single moving camera takes them.
//!
//! ```text
//! dataset.json, metadata.json     ids train_000 … and test_000 …; when and by which camera (0 trains, 1 is held out)
//! scene.json                      the frame of the files is the world of truth.json: centre 0, scale 1
//! camera/ID.json                  pose, intrinsics and distortion at full size
//! rgb/1x/ID.png, rgb/2x/ID.png    over white: photographs have no alpha
//! points.npy                      [P, 3] points of the surfaces the training cameras face, all at time 0
//! truth.json                      what really happened
//! ```
//! Times are whole `time_id`s there: with `n` training and `m` test views and `L = lcm(n − 1, 2m)`, training view `k` has
//! `k L / (n − 1)`, test view `k` has `(2k + 1) L / 2m`. The layout has no third split: validation views are left out.

use std::path::Path;

use gs_core::io::npy;
use gs_core::{Camera, Rng};
use rayon::prelude::*;
use serde_json::{Map, Value, json};

use super::write::{truth_json, vacant, write_json};
use super::{CAMERA_RADIUS, HALF_SIDE, SynthData, SynthOptions, Truth, generate};
use gs_data::{DataError, ImageSource, ImageU8, Lens, View};

/// Rays cast for the points.
const RAYS: u32 = 4000;

/// A picture to write.
struct Shot<'a> {
    id: String,
    time: u64,
    camera: u32,
    view: &'a View,
}

/// Generates a scene and writes it to `dir` in the Nerfies layout, see the head of this module. Unless `overwrite` is set
/// the folder must be empty or absent.
///
/// # Errors
/// `data.option` for cameras at rest, for an odd size, which has no half, and for more moments than the layout can number; `io.exists` if the
/// folder holds files, `io.write` if writing fails, else as [`generate`].
pub fn write_nerfies(dir: &Path, name: &str, options: &SynthOptions, overwrite: bool) -> Result<SynthData, DataError> {
    vacant(dir, overwrite)?;
    if options.cameras > 0 {
        let rule = "0: the Nerfies layout is for one moving camera; the D-NeRF layout has cameras at rest".into();
        return Err(DataError::Option { name: "cameras", value: options.cameras.to_string(), rule });
    }
    if options.size % 2 == 1 {
        let rule = "an even number: the layout also holds pictures of half the size".into();
        return Err(DataError::Option { name: "size", value: options.size.to_string(), rule });
    }
    let clock = Clock::of(options)?;
    let data = generate(name, options)?;
    let shots = shots(&data, &clock);
    for folder in ["camera", "rgb/1x", "rgb/2x"] {
        let folder = dir.join(folder);
        std::fs::create_dir_all(&folder).map_err(|e| DataError::write(&folder, e))?;
    }
    shots.par_iter().try_for_each(|shot| {
        write_json(&dir.join(format!("camera/{}.json", shot.id)), &camera(shot.view))?;
        let ImageSource::Memory(image) = &shot.view.image else { return Ok(()) };
        let opaque = over_white(image);
        save_rgb(&dir.join(format!("rgb/1x/{}.png", shot.id)), &opaque)?;
        let half = opaque.box_downscaled(image.width / 2, image.height / 2);
        save_rgb(&dir.join(format!("rgb/2x/{}.png", shot.id)), &half)
    })?;
    write_json(&dir.join("dataset.json"), &lists(&shots))?;
    write_json(&dir.join("metadata.json"), &tags(&shots))?;
    write_json(&dir.join("scene.json"), &frame())?;
    write_json(&dir.join("truth.json"), &truth_json(&data.truth))?;
    save_points(&dir.join("points.npy"), &data)?;
    Ok(data)
}

/// The clock of `time_id`s: ids from one training view to the next, from one half of a test view's share to the next.
struct Clock {
    train: u64,
    test: u64,
}

impl Clock {
    fn of(options: &SynthOptions) -> Result<Self, DataError> {
        let steps = u64::from(options.train_views).saturating_sub(1).max(1);
        let halves = (2 * u64::from(options.test_views)).max(1);
        let last = steps / gcd(steps, halves) * halves;
        if last > u64::from(u32::MAX) {
            let rule =
                format!("so many that {} training views and they have a common clock of 32 bits", options.train_views);
            return Err(DataError::Option { name: "test_views", value: options.test_views.to_string(), rule });
        }
        Ok(Self { train: last / steps, test: last / halves })
    }
}

/// Training and test views with their names and times; a scene at rest has one moment.
fn shots<'a>(data: &'a SynthData, clock: &Clock) -> Vec<Shot<'a>> {
    let rate = u64::from(data.truth.dynamic());
    let shot = |split: &str, camera, k: usize, view, time| Shot { id: format!("{split}_{k:03}"), time, camera, view };
    let (train, test) = (data.dataset.train.iter().enumerate(), data.dataset.test.iter().enumerate());
    let train = train.map(|(k, v)| shot("train", 0, k, v, rate * clock.train * k as u64));
    let test = test.map(|(k, v)| shot("test", 1, k, v, rate * clock.test * (2 * k as u64 + 1)));
    train.chain(test).collect()
}

fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

fn lists(shots: &[Shot]) -> Value {
    let of = |camera: u32| shots.iter().filter(|s| s.camera == camera).map(|s| s.id.as_str()).collect::<Vec<_>>();
    let all: Vec<_> = shots.iter().map(|s| s.id.as_str()).collect();
    json!({ "count": all.len(), "num_exemplars": of(0).len(), "ids": all, "train_ids": of(0), "val_ids": of(1) })
}

fn tags(shots: &[Shot]) -> Value {
    let tag =
        |s: &Shot| json!({ "time_id": s.time, "warp_id": s.time, "appearance_id": s.time, "camera_id": s.camera });
    shots.iter().map(|s| (s.id.clone(), tag(s))).collect::<Map<_, _>>().into()
}

/// Every scene lies within a ball around the origin, which every camera looks at from one distance.
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

/// The camera with another principal point, pixels that are not square, and what its lens does: all the layout can tell.
pub(super) fn with_lens(camera: Camera) -> (Camera, Lens) {
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let bent = Camera { fy: 1.02 * camera.fy, cx: 0.53 * width, cy: 0.48 * height, ..camera };
    (bent, Lens { k1: -0.12, k2: 0.03, k3: -0.004, p1: 0.002, p2: -0.003, skew: 0.01 })
}

fn over_white(image: &ImageU8) -> ImageU8 {
    let over = |p: &[u8]| {
        let alpha = f32::from(p[3]) / 255.0;
        let blend = |c: u8| (f32::from(c) * alpha + 255.0 * (1.0 - alpha) + 0.5) as u8;
        [blend(p[0]), blend(p[1]), blend(p[2]), 255]
    };
    ImageU8 { data: image.data.chunks_exact(4).flat_map(over).collect(), ..*image }
}

fn save_rgb(file: &Path, image: &ImageU8) -> Result<(), DataError> {
    let rgb: Vec<u8> = image.data.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    let (width, height) = (image.width as u32, image.height as u32);
    image::save_buffer(file, &rgb, width, height, image::ExtendedColorType::Rgb8)
        .map_err(|e| DataError::write(file, std::io::Error::other(e)))
}

/// Where random rays of the training cameras meet the bodies at time 0; no file if none does.
fn save_points(file: &Path, data: &SynthData) -> Result<(), DataError> {
    let each = RAYS.div_ceil(data.dataset.train.len() as u32);
    let points: Vec<f32> =
        data.dataset.train.iter().enumerate().flat_map(|(k, v)| seen(&data.truth, k, v, each)).collect();
    if points.is_empty() {
        return Ok(());
    }
    let mut bytes = Vec::new();
    let written = npy::write(&[points.len() / 3, 3], &points, &mut bytes);
    written.and_then(|()| std::fs::write(file, bytes)).map_err(|e| DataError::write(file, e))
}

fn seen(truth: &Truth, number: usize, view: &View, rays: u32) -> Vec<f32> {
    let mut rng = Rng::new(truth.options().seed, "synth.points", 0, number as u64);
    let (width, height) = (view.camera.width as f32, view.camera.height as f32);
    let aim = |_| (f64::from(rng.range(0.0, width)), f64::from(rng.range(0.0, height)));
    let hits = (0..rays).map(aim).filter_map(|(u, v)| truth.hit(&view.camera, 0.0, u, v));
    hits.flat_map(|hit| hit.world.as_vec3().to_array()).collect()
}
