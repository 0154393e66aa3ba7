//! Every fault of a film of a person that the layout `avatar` names.

use crate::film::{Broken, names, open};
use gs_data::DataOptions;
use serde_json::{Value, json};

#[test]
fn faults_of_the_scene_are_named() {
    let film = Broken::new();
    let file = "scene.json";
    names(&film.scene("version", json!(2)), "data.field", &[file, "version", "2"]);
    names(&film.scene("units", json!("inch")), "data.field", &[file, "units", "inch"]);
    names(&film.scene("up", json!("z")), "data.field", &[file, "up", "\"z\""]);
    names(&film.scene("background", json!([1, 1, 1])), "data.field", &[file, "background", "schedule.background"]);
    names(&film.scene("background", json!("black")), "data.field", &[file, "background"]);
    names(&film.scene("fps", json!(0)), "data.field", &[file, "fps"]);
    names(&film.scene("fps", Value::Null), "data.field", &[file, "fps", "missing"]);
    names(&film.scene("clp", json!("walk")), "data.field", &[file, "clp", "misspelt"]);
    names(&film.scene("clip", json!("fly")), "data.field", &[file, "clip", "fly", "walk"]);
    names(&film.scene("skinning", json!("none")), "data.field", &[file, "skinning", "none"]);
    names(&film.scene("morph", json!(1)), "data.field", &[file, "morph"]);
    names(&film.scene("uv_set", json!(-1)), "data.field", &[file, "uv_set"]);
    names(&film.scene("frames", json!(3)), "data.field", &[file, "frames"]);
    names(&film.scene("frames", json!({"count": 0})), "data.field", &[file, "frames.count"]);
    names(&film.scene("frames", json!({"count": 1e18})), "data.field", &[file, "frames.count"]);
    names(&film.scene("splits", json!([1])), "data.field", &[file, "splits"]);
    names(&film.scene("splits", json!({"trian": [1]})), "data.field", &[file, "splits.trian"]);
    names(&film.scene("splits", json!({"train": [0, 7]})), "data.field", &[file, "splits.train[1]", "7"]);
    names(&film.scene("splits", json!({"train": [0, 1], "test": [1]})), "data.field", &[file, "splits.test[0]"]);
    names(&film.scene("splits", json!({"train": [0], "test": [1]})), "data.field", &[file, "splits.train"]);
    names(&film.scene("splits", json!({"test": [1]})), "data.empty", &[file]);
    names(&film.scene("template", json!("builtin:horse")), "data.field", &[file, "template", "builtin:person"]);
    names(&film.scene("template", json!("nobody.glb")), "data.character", &["nobody.glb"]);
    for outside in ["../actor.glb", "/etc/passwd", "file:///etc/passwd", "a/../../actor.glb"] {
        names(&film.scene("template", json!(outside)), "data.escape", &[file, "template", outside]);
    }
    film.put("actor.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    names(&film.scene("template", json!("actor.obj")), "data.character", &["actor.obj", "texture coordinates"]);
    // Frames that nobody photographed.
    let e = film.scene("frames", json!({"start": 0, "count": 3, "step": 2}));
    names(&e, "data.field", &["splits.train[1]"]);
    film.put(file, json!({"version": 1, "fps": 3.0, "frames": {"count": 5}, "template": "builtin:person"}).to_string());
    names(&open(film.dir.path()).unwrap_err(), "data.missing", &["images/000/000003.png", "8 of 20"]);
    let read = film.open_with(&DataOptions { allow_missing: true, ..DataOptions::default() }).unwrap();
    assert!(read.notes.iter().any(|n| n.contains("left out")), "{:?}", read.notes);
    film.put(
        file,
        json!({"version": 1, "fps": 3.0, "frames": {"count": 1_000_000}, "template": "builtin:person"}).to_string(),
    );
    names(&open(film.dir.path()).unwrap_err(), "data.missing", &["more"]);
    film.put(file, "{\"version\": 1,\n nonsense");
    names(&open(film.dir.path()).unwrap_err(), "data.syntax", &[file, "line 2"]);
}

#[test]
fn faults_of_cameras_are_named() {
    let film = Broken::new();
    let file = "cameras.json";
    names(&film.camera("role", json!("spare")), "data.field", &[file, "[1].role", "spare"]);
    names(&film.camera("role", Value::Null), "data.field", &[file, "[1].role", "missing"]);
    names(&film.camera("id", json!(0)), "data.field", &[file, "[1].id", "two cameras"]);
    names(&film.camera("id", json!(-1)), "data.field", &[file, "[1].id"]);
    names(&film.camera("w", json!(0.5)), "data.field", &[file, "[1].w"]);
    names(&film.camera("w", json!(17)), "data.image_size", &["images/001/000000.png", "16x16"]);
    names(&film.camera("K", json!([1, 2, 3])), "data.field", &[file, "[1].K"]);
    names(&film.camera("K", json!([-9, 0, 8, 0, 9, 8, 0, 0, 1])), "data.field", &[file, "[1].K"]);
    names(&film.camera("K", json!(["<NaN>", 0, 8, 0, 9, 8, 0, 0, 1])), "data.field", &[file, "[1].K[0]", "NaN"]);
    let mut e = film.cameras[1]["E"].clone();
    e[12] = json!(1.0);
    names(&film.camera("E", e), "data.field", &[file, "[1].E"]);
    let mut e = film.cameras[1]["E"].clone();
    e[0] = json!(3.0);
    names(&film.camera("E", e), "data.pose", &[file, "[1].E"]);
    names(&film.camera("pixel_center", json!("corner")), "data.field", &[file, "[1].pixel_center", "corner"]);
    names(&film.camera("dist", json!(vec![0.1; 8])), "data.camera_model", &[file, "[1].dist", "8 distortion"]);
    names(&film.camera("dist", json!("fisheye")), "data.camera_model", &[file, "[1].dist", "fisheye"]);
    film.put(file, "[]");
    names(&open(film.dir.path()).unwrap_err(), "data.empty", &[file]);
    let mut none = film.cameras.clone();
    none.as_array_mut().unwrap().iter_mut().for_each(|c| c["role"] = json!("train"));
    film.put(file, none.to_string());
    names(&open(film.dir.path()).unwrap_err(), "data.field", &[file, "role", "cond"]);
}
