//! Captures of real layouts, shaped from a generated scene: trained on and inspected like any other data.

use crate::support::{STEPS, good, gs4d, text, train};
use gs_core::Camera;
use gs_core::io::images::write_png8;
use gs_synth::{self as synth, SynthData, SynthOptions};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

const SIDE: u32 = 32;
const VIEWS: u32 = 9;

fn scene() -> SynthData {
    let o = SynthOptions::of_views(SIDE, VIEWS, 0);
    synth::generate("waves", &o).unwrap()
}

fn put(file: &Path, contents: impl AsRef<[u8]>) {
    fs::create_dir_all(file.parent().unwrap()).unwrap();
    fs::write(file, contents).unwrap();
}

/// Writes what a camera sees at a time.
fn write_image(scene: &SynthData, camera: &Camera, t: f64, file: &Path) {
    let image = scene.truth.picture(camera, t);
    let rgb: Vec<u8> = image.over([1.0; 3]).data.iter().map(|v| (v * 255.0 + 0.5) as u8).collect();
    let mut bytes = Vec::new();
    write_png8(image.width, image.height, 3, &rgb, &mut bytes).unwrap();
    put(file, bytes);
}

/// The scene as HyperNeRF writes it: one moving camera, every third picture held out.
pub fn write_hypernerf(dir: &Path) {
    let scene = scene();
    let id = |k: usize| format!("{k:06}");
    let views = &scene.dataset.train;
    for (k, v) in views.iter().enumerate() {
        let (r, c) = (v.camera.rotation, &v.camera);
        let row = |i: usize| [r.x_axis[i], r.y_axis[i], r.z_axis[i]];
        let camera = json!({
            "orientation": [row(0), row(1), row(2)], "position": c.position().to_array(), "focal_length": c.fx,
            "principal_point": [c.cx, c.cy], "skew": 0.0, "pixel_aspect_ratio": 1.0, "radial_distortion": [0, 0, 0],
            "tangential_distortion": [0, 0], "image_size": [SIDE, SIDE],
        });
        put(&dir.join(format!("camera/{}.json", id(k))), camera.to_string());
        write_image(&scene, c, v.time.seconds, &dir.join(format!("rgb/1x/{}.png", id(k))));
    }
    let list = |keep: &dyn Fn(usize) -> bool| (0..views.len()).filter(|&k| keep(k)).map(id).collect::<Vec<_>>();
    let lists = json!({
        "count": VIEWS, "ids": list(&|_| true), "train_ids": list(&|k| k % 3 != 1), "val_ids": list(&|k| k % 3 == 1),
    });
    let tags: serde_json::Map<String, Value> =
        (0..views.len()).map(|k| (id(k), json!({"camera_id": 0, "time_id": k}))).collect();
    put(&dir.join("dataset.json"), lists.to_string());
    put(&dir.join("metadata.json"), Value::from(tags).to_string());
    put(&dir.join("scene.json"), json!({"center": [0, 0, 0], "scale": 1.0, "near": 2.0, "far": 6.0}).to_string());
}

/// The scene as Neu3D writes it: three cameras at rest with four frames each.
fn write_llff(dir: &Path) {
    let scene = scene();
    let mut values: Vec<f64> = Vec::new();
    for (k, v) in scene.dataset.train.iter().take(3).enumerate() {
        let (r, p) = (v.camera.rotation, v.camera.position());
        let side = f64::from(SIDE);
        for (axis, last) in [(0, side), (1, side), (2, v.camera.fx)] {
            // Row `axis` of [down, right, backwards | centre | (H, W, f)].
            let column = [r.x_axis, r.y_axis, r.z_axis][axis];
            values.extend([column[1], column[0], -column[2], p[axis], last]);
        }
        values.extend([2.0, 6.0]);
        for frame in 0..4 {
            let file = dir.join(format!("cam{k:02}/images/{frame:04}.png"));
            write_image(&scene, &v.camera, f64::from(frame) / 4.0, &file);
        }
    }
    let values: Vec<f32> = values.into_iter().map(|v| v as f32).collect();
    let mut bytes = Vec::new();
    gs_core::io::npy::write(&[3, 17], &values, &mut bytes).unwrap();
    put(&dir.join("poses_bounds.npy"), bytes);
}

/// Trains a few steps, and gives what the run says about its data.
fn origin(data: &Path, run: &Path, more: &[&str]) -> Value {
    train(data, run, more);
    let needs = good(&["inspect", text(run), "--json"]).json();
    assert!(!needs["needs"].as_array().unwrap().is_empty(), "{needs}");
    let file = run.join(format!("checkpoints/step-{STEPS:06}.gs4d"));
    assert_eq!(good(&["inspect", text(&file), "--json"]).json()["meta"]["step"], STEPS);
    assert!(good(&["eval", text(run), "--split", "test", "--json"]).json()["mean"]["psnr"].as_f64().unwrap() > 5.0);
    let provenance: Value = serde_json::from_slice(&fs::read(run.join("provenance.json")).unwrap()).unwrap();
    provenance["data"].clone()
}

#[test]
fn a_hypernerf_capture_is_trained_on() {
    let dir = tempfile::tempdir().unwrap();
    let (data, run) = (dir.path().join("data"), dir.path().join("run"));
    write_hypernerf(&data);
    let origin = origin(&data, &run, &[]);
    assert_eq!((&origin["layout"], &origin["views"]), (&json!("hypernerf"), &json!([6, 0, 3])), "{origin}");
    assert_eq!(origin["time_source"], "time_id of metadata.json");
    fs::write(data.join("camera/000000.json"), "{\"orientation\": 1}").unwrap();
    let none = dir.path().join("none");
    gs4d(&["train", text(&data), "-m", "static3d", "-o", text(&none)])
        .fails(3, &["orientation is 1", "camera/000000.json"]);
}

#[test]
fn a_rig_of_videos_is_trained_on() {
    let dir = tempfile::tempdir().unwrap();
    let (data, run) = (dir.path().join("data"), dir.path().join("run"));
    write_llff(&data);
    let origin = origin(&data, &run, &["--set", "data.scale=0.5"]);
    assert_eq!((&origin["layout"], &origin["views"]), (&json!("llff"), &json!([8, 0, 4])), "{origin}");
    let notes = origin["notes"].to_string();
    assert!(notes.contains("first camera is held out") && notes.contains("shrunk to 0.5"), "{notes}");
    fs::remove_dir_all(data.join("cam01")).unwrap();
    fs::write(data.join("cam01.mp4"), "video").unwrap();
    let none = dir.path().join("none");
    gs4d(&["train", text(&data), "-m", "static3d", "-o", text(&none)])
        .fails(3, &["videos without frames", "ffmpeg -i", "scale=16:16"]);
}
