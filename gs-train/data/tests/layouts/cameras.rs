//! Which views share a camera, intrinsics that Blender's files state, and lenses that are fisheyes.

use crate::layouts::{Folder, apart, number, opengl};
use gs_data::{DataOptions, ImageCache, Lens, View};
use serde_json::{Value, json};

#[test]
fn views_of_one_pose_are_of_one_camera_in_all_splits() {
    let f = Folder::new(6, "png");
    let frame = |k: usize, camera: usize| {
        let pose = opengl(&f.cameras[camera]);
        json!({"file_path": format!("images/f{k:03}.png"), "time": 0.2 * k as f64, "transform_matrix": pose})
    };
    let ids = |views: &[View]| views.iter().map(|v| v.camera_id).collect::<Vec<_>>();
    let list = |frames: [Value; 3]| json!({"camera_angle_x": 0.8, "frames": frames}).to_string();
    f.put("transforms_train.json", list([frame(0, 4), frame(2, 2), frame(5, 4)]));
    f.put("transforms_test.json", list([frame(1, 2), frame(3, 5), frame(4, 4)]));
    let d = f.open(&DataOptions::default()).unwrap();
    assert_eq!((d.layout, ids(&d.train), ids(&d.test)), ("blender", vec![0, 1, 0], vec![1, 2, 0]));
    let mut rig = json!({"camera_angle_x": 0.8, "frames": (0..6).map(|k| frame(k, k % 2)).collect::<Vec<_>>()});
    let read = |rig: &Value| {
        let f = Folder::new(6, "png");
        f.put("transforms.json", rig.to_string());
        f.open(&DataOptions::default()).unwrap()
    };
    // The first is held out.
    let d = read(&rig);
    assert_eq!((d.layout, ids(&d.train), ids(&d.test)), ("nerfstudio", vec![0, 1, 0, 1, 0], vec![1]));
    for k in 0..6 {
        rig["frames"][k]["camera_index"] = json!(k / 3);
    }
    assert_eq!(ids(&read(&rig).train), [0, 0, 1, 1, 1], "what the file says counts");
}

/// Beside the field of view, for all frames or one, in pixels of a larger image.
#[test]
fn blender_files_may_state_intrinsics_and_lenses() {
    let f = Folder::new(3, "png");
    let mut j = f.nerfstudio();
    for key in ["w", "h", "fl_x", "fl_y", "cx", "cy"] {
        j[key] = json!(j[key].as_f64().unwrap() * 2.0);
    }
    (j["camera_angle_x"], j["k1"], j["frames"][1]["p2"]) = (json!(0.5), json!(0.05), json!(0.01));
    f.put("transforms_train.json", j.to_string());
    let d = f.open(&DataOptions::default()).unwrap();
    assert_eq!((d.layout, d.train.len()), ("blender", 3));
    assert!(d.train.iter().all(|v| apart(&v.camera, &f.cameras[number(&v.name)]) < 1e-9));
    let lens = Lens { k1: 0.05, ..Lens::default() };
    let lenses: Vec<Lens> = d.train.iter().map(|v| v.lens.unwrap()).collect();
    assert_eq!(lenses, [lens, Lens { p2: 0.01, ..lens }, lens]);
    assert!(d.notes.iter().any(|n| n.contains("3 views are resampled to a pinhole")), "{:?}", d.notes);
    let e = f.open(&DataOptions { undistort: false, ..Default::default() }).unwrap_err();
    assert_eq!(e.code(), "data.camera_model");
}

#[test]
fn fisheyes_are_read_and_removed() {
    let f = Folder::new(3, "png");
    let mut j = f.nerfstudio();
    j["camera_model"] = json!("OPENCV_FISHEYE");
    j["k1"] = json!(0.05);
    j["frames"][1]["k4"] = json!(-0.002);
    f.put("transforms.json", j.to_string());
    let lenses = |views: &[View]| views.iter().map(|v| v.lens.unwrap()).collect::<Vec<_>>();
    let d = f.open(&DataOptions::default()).unwrap();
    let fisheye = Lens { fisheye: true, k1: 0.05, ..Lens::default() };
    assert_eq!(lenses(&d.train), [Lens { k4: -0.002, ..fisheye }, fisheye]);
    let image = ImageCache::new(0, 1.0).get(&d.train[0]).unwrap();
    assert_eq!((image.width, image.height), (40, 30));
    // instant-ngp's scripts write a flag.
    j.as_object_mut().unwrap().remove("camera_model");
    j["is_fisheye"] = json!(true);
    f.put("transforms.json", j.to_string());
    assert_eq!(lenses(&f.open(&DataOptions::default()).unwrap().train), lenses(&d.train));
    j["p1"] = json!(0.01);
    f.put("transforms.json", j.to_string());
    assert!(f.open(&DataOptions::default()).unwrap_err().to_string().contains("with p1 = 0.01"));

    let models = [
        ("OPENCV_FISHEYE 40 30 45 46 20 15 0.05 0.01 0.02 -0.002", [0.05, 0.01, 0.02, -0.002]),
        ("RADIAL_FISHEYE 40 30 45 20 15 0.05 0.01", [0.05, 0.01, 0.0, 0.0]),
        ("SIMPLE_RADIAL_FISHEYE 40 30 45 20 15 0", [0.0; 4]),
    ];
    for (model, [k1, k2, k3, k4]) in models {
        let f = Folder::new(3, "png");
        f.colmap_text(model);
        let d = f.open(&DataOptions::default()).unwrap();
        let lens = Lens { fisheye: true, k1, k2, k3, k4, ..Lens::default() };
        assert_eq!((d.layout, lenses(&d.train)), ("colmap", vec![lens; 2]), "{model}");
    }
}
