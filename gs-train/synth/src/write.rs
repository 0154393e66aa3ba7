//! Writing a generated scene as a D-NeRF folder, with its ground truth in `truth.json`.

use std::path::Path;

use glam::{DMat3, DQuat, DVec3};
use gs_core::Camera;
use rayon::prelude::*;
use serde_json::{Value, json};

use super::body::Body;
use super::save::{create_dir, save, save_json, save_png};
use super::{FOV_X, SynthData, SynthOptions, Truth, generate};
use gs_data::{DataError, ImageSource, View};

/// Number of times, evenly over 0..1, at which `truth.json` gives poses.
const TRUTH_TIMES: u32 = 101;

/// Generates a scene and writes it to `dir`: `transforms_{train,val,test}.json`, `{train,val,test}/r_000.png` …,
/// `truth.json`. With static cameras there is no validation split, the images of training cameras (`train`) and of held-out
/// ones (`test`) are `c00_t000.png` …, extrapolation views included, and `scene.toml` states the boundary. Unless
/// `overwrite` is set the folder must be empty or absent.
///
/// ```
/// use gs_data::{DataOptions, Dataset};
/// use gs_synth::{SynthOptions, write};
///
/// # let folder = tempfile::tempdir().unwrap();
/// let options = SynthOptions::of_views(8, 2, 1);
/// let made = write(folder.path(), "static", &options, true)?;
/// let read = Dataset::open(folder.path(), &DataOptions::default())?;
/// assert_eq!((read.layout, read.train.len()), ("blender", 2));
/// assert!(read.train[1].camera.position().abs_diff_eq(made.dataset.train[1].camera.position(), 1e-9));
/// # Ok::<(), gs_data::DataError>(())
/// ```
///
/// # Errors
/// `data.option` if there is a lens, `io.exists` if the folder holds files, `io.write` if writing fails, else as
/// [`generate`].
pub fn write(dir: &Path, name: &str, options: &SynthOptions, overwrite: bool) -> Result<SynthData, DataError> {
    check_vacant(dir, overwrite)?;
    if options.lens {
        let rule = "false: the D-NeRF layout has pinholes only; the Nerfies layout has lenses".into();
        return Err(DataError::Option { name: "lens", value: "true".into(), rule });
    }
    let data = generate(name, options)?;
    for (split, views) in splits(&data) {
        let folder = create_dir(dir.join(split))?;
        views.par_iter().try_for_each(|v| match &v.image {
            ImageSource::Memory(image) => save_png(&folder.join(format!("{}.png", v.name)), image),
            ImageSource::File(_) => Ok(()),
        })?;
        save_json(&dir.join(format!("transforms_{split}.json")), &transforms(split, &views, data.truth.dynamic()))?;
    }
    if options.cameras > 0 && data.truth.dynamic() {
        let text =
            format!("# Later pictures, of every camera, are the future.\n[time]\nboundary = {:?}\n", options.boundary);
        save(&dir.join("scene.toml"), text.as_bytes())?;
    }
    save_json(&dir.join("truth.json"), &truth_json(&data.truth))?;
    Ok(data)
}

/// The views by the folder of their images: extrapolation views are with the others of their camera.
pub(super) fn splits(data: &SynthData) -> Vec<(&'static str, Vec<&View>)> {
    let (sets, cameras) = (&data.dataset, data.truth.options().cameras);
    let (seen, held_out): (Vec<_>, Vec<_>) = sets.extrapolate.iter().partition(|v| v.camera_id < cameras);
    let train = ("train", sets.train.iter().chain(seen).collect());
    let test = ("test", sets.test.iter().chain(held_out).collect());
    match cameras {
        0 => vec![train, ("val", sets.val.iter().collect()), test],
        _ => vec![train, test],
    }
}

/// Checks that a data set may be written to a folder.
pub(super) fn check_vacant(dir: &Path, overwrite: bool) -> Result<(), DataError> {
    let occupied = std::fs::read_dir(dir).is_ok_and(|mut entries| entries.next().is_some());
    if dir.is_file() || (occupied && !overwrite) {
        return Err(DataError::Occupied { path: dir.to_path_buf() });
    }
    Ok(())
}

fn transforms(split: &str, views: &[&View], dynamic: bool) -> Value {
    let frame = |v: &&View| {
        let mut f = json!({
            "file_path": format!("./{split}/{}", v.name),
            "transform_matrix": opengl_c2w(&v.camera),
        });
        if dynamic {
            f["time"] = json!(v.time.seconds);
        }
        f
    };
    json!({ "camera_angle_x": FOV_X, "frames": views.iter().map(frame).collect::<Vec<_>>() })
}

/// Camera to world with OpenGL axes: our y and z columns negated.
fn opengl_c2w(camera: &Camera) -> [[f64; 4]; 4] {
    let r = camera.rotation.transpose() * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let c = camera.position();
    let row = |i: usize| [r.x_axis[i], r.y_axis[i], r.z_axis[i], c[i]];
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

pub(super) fn truth_json(truth: &Truth) -> Value {
    let times: Vec<f64> = (0..TRUTH_TIMES).map(|k| f64::from(k) / f64::from(TRUTH_TIMES - 1)).collect();
    let bodies: Vec<Value> = truth.bodies().iter().map(|b| body_json(b, &times)).collect();
    json!({
        "about": "world = rotation(w,x,y,z) * body + translation; time is normalised; a sheet also moves along z in its frame, see its shape; \
                  twist: the velocity field v + w x position and its first derivative, about the world's origin; \
                  tracks: where material points of the surface are at the times of the poses",
        "scene": truth.scene(),
        "options": truth.options(),
        "bodies": bodies,
    })
}

fn body_json(b: &Body, times: &[f64]) -> Value {
    let poses: Vec<Value> = times.iter().map(|&t| pose_json(b, t)).collect();
    let track = |p: DVec3| -> Value {
        let at: Vec<[f64; 3]> = times.iter().map(|&t| b.position_of(p, t).to_array()).collect();
        json!({ "body": p.to_array(), "world": at })
    };
    let tracks: Vec<Value> = b.shape.landmarks().into_iter().map(track).collect();
    json!({
        "name": b.name, "class": b.class(), "shape": b.shape, "motion": b.motion, "deforms": b.is_sheet(),
        "poses": poses, "tracks": tracks,
    })
}

fn pose_json(b: &Body, t: f64) -> Value {
    let pose = b.motion.at(t);
    let q = DQuat::from_mat3(&pose.rotation);
    let q = if q.w < 0.0 { -q } else { q };
    let mut json = json!({ "time": t, "rotation": [q.w, q.x, q.y, q.z], "translation": pose.translation.to_array() });
    if !b.is_sheet() {
        let m = b.motion.rates(t).twist(DVec3::ZERO);
        json["twist"] = json!({ "v": m.twist.v, "w": m.twist.w, "v_rate": m.rate.v, "w_rate": m.rate.w });
    }
    json
}
