//! Blender's `transforms_train.json` made by hand: cameras, times, and every field that is wrong is named.

use crate::layouts::{Folder, apart, number, opengl};
use glam::DVec3;
use gs_core::Camera;
use gs_data::{DataError, DataOptions, ImageSource};
use serde_json::{Value, json};

/// Blender's matrices with cameras that look past the origin, each with a shift sideways: a wrong sign of the translation
/// along x is invisible while all cameras look at the origin.
#[test]
fn blender_cameras_need_not_look_at_the_origin() {
    let mut f = Folder::new(5, "png");
    for (k, c) in f.cameras.iter_mut().enumerate() {
        c.translation += DVec3::new(0.7 - 0.1 * k as f64, 0.3, 0.2);
        (c.cx, c.cy, c.fy) = (20.0, 15.0, c.fx);
    }
    let frames: Vec<Value> = (0..5)
        .map(|k| json!({"file_path": format!("images/f{k:03}"), "time": 0.25 * k as f64, "transform_matrix": opengl(&f.cameras[k])}))
        .collect();
    f.put("transforms_train.json", json!({"camera_angle_x": 0.8, "frames": frames}).to_string());
    let d = f.open(&DataOptions::default()).unwrap();
    assert_eq!((d.layout, d.train.len()), ("blender", 5));
    for v in &d.train {
        let want = &f.cameras[number(&v.name)];
        assert!(apart(&v.camera, want) < 1e-9, "{}", v.name);
        let mirrored = Camera { translation: want.translation * DVec3::new(-1.0, 1.0, 1.0), ..want.clone() };
        assert!(apart(&v.camera, &mirrored) > 1.0, "the test would see the sign");
    }
}

#[test]
fn blender_scenes_may_be_static_and_lack_splits() {
    let f = Folder::new(3, "jpg");
    let frames: Vec<Value> = (0..3)
        .map(|k| json!({"file_path": format!("./images/f{k:03}"), "transform_matrix": opengl(&f.cameras[k])}))
        .collect();
    f.put("transforms_train.json", json!({"camera_angle_x": 0.8, "frames": frames}).to_string());
    let d = f.open(&DataOptions::default()).unwrap();
    assert_eq!((d.layout, d.train.len(), d.dynamic, d.has_alpha), ("blender", 3, false, false));
    assert!(d.notes.iter().any(|n| n.contains("no transforms_test.json")), "{:?}", d.notes);
    let c = &d.train[1].camera;
    assert!((c.fx - 20.0 / 0.4f64.tan()).abs() < 1e-12 && c.fx == c.fy && (c.cx, c.cy) == (20.0, 15.0));
    assert!((c.position() - f.cameras[1].position()).length() < 1e-12);
    let ImageSource::File(path) = &d.train[1].image else { panic!("a file") };
    assert!(path.ends_with("images/f001.jpg"));
}

/// A Blender folder whose JSON was changed.
fn blender_fault(change: impl Fn(&mut Value), options: &DataOptions) -> DataError {
    let f = Folder::new(4, "png");
    let mut frames = f.nerfstudio()["frames"].clone();
    for k in 0..4 {
        frames[k]["time"] = json!(k as f64 / 3.0);
    }
    let mut j = json!({"camera_angle_x": 0.8, "frames": frames});
    f.put("transforms_train.json", j.to_string());
    f.open(options).expect("without the change it opens");
    change(&mut j);
    f.put("transforms_train.json", j.to_string().replace("\"<NaN>\"", "NaN"));
    f.open(options).unwrap_err()
}

#[test]
fn every_field_that_is_wrong_is_named() {
    let fault = |change: &dyn Fn(&mut Value)| blender_fault(change, &DataOptions::default());
    for (change, code, text) in [
        (
            &(|j: &mut Value| j["frames"][2]["time"] = json!(1.3)) as &dyn Fn(&mut Value),
            "data.time",
            "frame \"f002\" has time 1.3; 1 of 4 training times lie outside 0..1, all frames are in 0..1.3",
        ),
        (&|j| j["frames"][1]["time"] = json!("<NaN>"), "data.field", "frames[1].time is NaN"),
        (&|j| j["frames"][1]["time"] = json!("x"), "data.field", "frames[1].time is \"x\""),
        (&|j| j["frames"][1]["time"] = Value::Null, "data.field", "frames[1].time is missing"),
        (&|j| j["camera_angle_x"] = json!("<NaN>"), "data.field", "camera_angle_x is NaN"),
        (&|j| j["camera_angle_x"] = json!(3.5), "data.field", "camera_angle_x is 3.5"),
        (&|j| j["camera_angle_x"] = Value::Null, "data.field", "frames[0] is without focal length"),
        (
            &|j| j["frames"][3]["transform_matrix"][1][2] = json!("<NaN>"),
            "data.field",
            "frames[3].transform_matrix[1][2] is NaN",
        ),
        (
            &|j| j["frames"][3]["transform_matrix"][0] = json!([1, 2]),
            "data.field",
            "frames[3].transform_matrix[0] is [1,2]",
        ),
        (&|j| j["frames"][0]["transform_matrix"] = Value::Null, "data.field", "frames[0].transform_matrix is null"),
        (&|j| j["frames"][0]["transform_matrix"][0][3] = json!(1e300), "data.field", "frames[0] is no usable camera"),
        (&|j| j["frames"][0]["file_path"] = json!(7), "data.field", "frames[0].file_path is 7"),
        (
            &|j| j["frames"][0]["file_path"] = json!("../../etc/x.png"),
            "data.escape",
            "path \"../../etc/x.png\" leaves the data folder",
        ),
        (
            &|j| j["frames"][0]["file_path"] = json!("/etc/x.png"),
            "data.escape",
            "path \"/etc/x.png\" leaves the data folder",
        ),
        (&|j| j["frames"] = json!([]), "data.empty", "gives no training view"),
        (&|j| j["frames"] = json!(3), "data.syntax", "a list"),
    ] {
        let e = fault(change);
        assert_eq!(e.code(), code, "{e}");
        assert!(e.to_string().contains(text), "{e}");
        let report = e.report();
        assert!(
            report.contains("transforms_train.json") && report.contains("\n  why  ") && report.contains("\n  do   ")
        );
        assert_eq!(e.exit_code(), 3);
    }
    let scaled = fault(&|j| {
        for i in 0..3 {
            for k in 0..3 {
                let v = j["frames"][2]["transform_matrix"][i][k].as_f64().unwrap();
                j["frames"][2]["transform_matrix"][i][k] = json!(2.0 * v);
            }
        }
    });
    assert!(scaled.code() == "data.pose" && scaled.report().contains("frames[2].transform_matrix"), "{scaled}");
}

#[test]
fn a_wider_time_range_accepts_what_the_default_refuses() {
    let f = Folder::new(2, "png");
    let mut frames = f.nerfstudio()["frames"].clone();
    (frames[0]["time"], frames[1]["time"]) = (json!(0.0), json!(1.3));
    f.put("transforms_train.json", json!({"camera_angle_x": 0.8, "frames": frames}).to_string());
    let e = f.open(&DataOptions::default()).unwrap_err();
    assert!(e.fix().starts_with("--set data.time_range=0..1.3"));
    let options = DataOptions { time_range: Some("0..1.3".parse().unwrap()), ..Default::default() };
    let d = f.open(&options).unwrap();
    assert_eq!((d.train[1].time.normalised, d.train[1].time.seconds), (1.0, 1.3));
}
