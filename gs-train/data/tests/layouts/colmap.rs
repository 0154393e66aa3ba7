//! COLMAP models made by hand: text and binary, images that are reduced or numbered anew, and every fault that is named.

use crate::layouts::{Folder, apart, number, wxyz};
use gs_data::{DataOptions, TimeFrom};

#[test]
fn colmap_text_and_binary_give_the_same_data() {
    let f = Folder::new(9, "png");
    f.colmap_text(&f.pinhole());
    let text = f.open(&DataOptions::default()).unwrap();
    assert_eq!((text.layout, text.train.len(), text.test.len()), ("colmap", 7, 2));
    for v in text.train.iter().chain(&text.test) {
        assert!(apart(&v.camera, &f.cameras[number(&v.name)]) < 1e-9);
    }
    let points = text.points.clone().unwrap();
    assert_eq!((points.positions.len(), points.colors[0]), (2, [1.0, 0.0, 0.2]));
    let (cameras, images, points) = binary_model(&f);
    f.put("sparse/0/cameras.bin", cameras);
    f.put("sparse/0/images.bin", images);
    f.put("sparse/0/points3D.bin", points);
    for name in ["cameras", "images", "points3D"] {
        std::fs::remove_file(f.path().join(format!("sparse/0/{name}.txt"))).unwrap();
    }
    let binary = f.open(&DataOptions::default()).unwrap();
    assert_eq!(binary, text);
}

/// `cameras.bin`, `images.bin`, `points3D.bin` of the text model.
fn binary_model(f: &Folder) -> (Vec<u8>, Vec<u8>, Vec<u8>) {
    let c = &f.cameras[0];
    let mut cameras = [&1u64.to_le_bytes()[..], &1u32.to_le_bytes(), &1u32.to_le_bytes()].concat();
    cameras.extend([40u64.to_le_bytes(), 30u64.to_le_bytes()].concat());
    cameras.extend([c.fx, c.fy, c.cx, c.cy].map(f64::to_le_bytes).concat());
    let mut images = (f.cameras.len() as u64).to_le_bytes().to_vec();
    for (k, c) in f.cameras.iter().enumerate() {
        images.extend((k as u32 + 1).to_le_bytes());
        images.extend(wxyz(c).map(f64::to_le_bytes).concat());
        images.extend(c.translation.to_array().map(f64::to_le_bytes).concat());
        images.extend(1u32.to_le_bytes());
        images.extend(format!("f{k:03}.png\0").bytes());
        images.extend(1u64.to_le_bytes());
        images.extend([0u8; 24]);
    }
    let mut points = 2u64.to_le_bytes().to_vec();
    for (p, rgb) in [([0.1, 0.2, 0.3], [255u8, 0, 51]), ([-1.0, -2.0, -3.0], [0, 0, 0])] {
        points.extend(9u64.to_le_bytes());
        points.extend(p.map(f64::to_le_bytes).concat());
        points.extend(rgb);
        points.extend(0.5f64.to_le_bytes());
        points.extend(1u64.to_le_bytes());
        points.extend([0u8; 8]);
    }
    (cameras, images, points)
}

#[test]
fn colmap_models_are_read_or_refused_by_name() {
    let f = Folder::new(2, "png");
    for (model, want) in [
        ("SIMPLE_PINHOLE 40 30 45 20 15", [0.0; 5]),
        ("SIMPLE_RADIAL 40 30 45 20 15 0.1", [0.1, 0.0, 0.0, 0.0, 0.0]),
        ("RADIAL 40 30 45 20 15 0.1 0.2", [0.1, 0.2, 0.0, 0.0, 0.0]),
        ("OPENCV 40 30 45 45 20 15 0.1 0.2 0.01 0.02", [0.1, 0.2, 0.0, 0.01, 0.02]),
    ] {
        f.colmap_text(model);
        let d = f.open(&DataOptions { hold_out: 0, ..Default::default() }).unwrap();
        let v = &d.train[0];
        assert_eq!((v.camera.fx, v.camera.fy, v.camera.cx, v.camera.cy), (45.0, 45.0, 20.0, 15.0));
        assert_eq!(v.lens.unwrap_or_default().to_array()[..5], want, "{model}");
    }
    for (model, want) in [
        ("FOV 40 30 45 45 20 15 0.9", "camera model FOV is not supported"),
        ("PINHOLE 40 30 45 45 20", "line 2.params is 3 numbers"),
        ("PINHOLE 40 30 45 45 20 nan", "line 2.params[3] is NaN"),
        ("PINHOLE 0 30 45 45 20 15", "line 2.size is 0x30"),
        ("PINHOLE 40 x 45 45 20 15", "line 2, height is x"),
        ("PINHOLE 40", "line 2, height is missing"),
    ] {
        f.colmap_text(model);
        assert_eq!(f.open(&DataOptions::default()).unwrap_err().to_string(), want);
    }
}

#[test]
fn colmap_finds_reduced_images_in_another_format() {
    let f = Folder::new(3, "png");
    let c = &f.cameras[0];
    f.colmap_text(&format!("PINHOLE 160 120 {} {} {} {}", 4.0 * c.fx, 4.0 * c.fy, 4.0 * c.cx, 4.0 * c.cy));
    std::fs::rename(f.path().join("images"), f.path().join("images_4")).unwrap();
    let images = std::fs::read_to_string(f.path().join("sparse/0/images.txt")).unwrap().replace(".png", ".JPG");
    f.put("sparse/0/images.txt", images);
    let d = f.open(&DataOptions { hold_out: 0, ..Default::default() }).unwrap();
    assert!(d.train.iter().all(|v| apart(&v.camera, &f.cameras[number(&v.name)]) < 1e-9));
    let notes = d.notes.join("\n");
    for part in ["images_4", "3 images have another extension", "160x120 against 40x30"] {
        assert!(notes.contains(part), "{notes}");
    }
}

/// A model that names its images 3, 5, 20 (.jpg) and a folder that counts them 1, 3, 4 (.png): one stem coincides and is wrong.
#[test]
fn colmap_images_numbered_anew_are_paired_in_order_and_only_then() {
    let f = Folder::new(3, "png");
    f.colmap_text(&f.pinhole());
    let mut text = std::fs::read_to_string(f.path().join("sparse/0/images.txt")).unwrap();
    for (from, to) in [("f000.png", "20.jpg"), ("f001.png", "3.jpg"), ("f002.png", "5.jpg")] {
        text = text.replace(from, to);
    }
    f.put("sparse/0/images.txt", &text);
    for (from, to) in [("f000", "4"), ("f001", "1"), ("f002", "3")] {
        std::fs::rename(f.path().join(format!("images/{from}.png")), f.path().join(format!("images/{to}.png")))
            .unwrap();
    }
    let options = DataOptions { hold_out: 0, ..Default::default() };
    let d = f.open(&options).unwrap();
    for (name, camera) in [("4", 0), ("1", 1), ("3", 2)] {
        let v = d.train.iter().find(|v| v.name == name).unwrap();
        assert!(apart(&v.camera, &f.cameras[camera]) < 1e-9, "{name}");
    }
    let note = d.notes.iter().find(|n| n.contains("paired in order of number")).unwrap();
    assert!(note.contains("3.jpg is 1.png, 5.jpg is 3.png, 20.jpg is 4.png"), "{note}");
    // One image too many, a name that is no number, or a name that is right: nothing is paired.
    let refused = |name: &str| {
        std::fs::copy(f.path().join("images/1.png"), f.path().join("images").join(name)).unwrap();
        let e = f.open(&options).unwrap_err();
        std::fs::remove_file(f.path().join("images").join(name)).unwrap();
        assert_eq!(e.code(), "data.missing", "{name}: {e}");
    };
    refused("7.png");
    refused("20.jpg");
    std::fs::rename(f.path().join("images/4.png"), f.path().join("images/x4.png")).unwrap();
    assert_eq!(f.open(&options).unwrap_err().code(), "data.missing", "a name without number");
    std::fs::rename(f.path().join("images/x4.png"), f.path().join("images/20.jpg")).unwrap();
    let e = f.open(&options).unwrap_err();
    assert_eq!(e.code(), "data.missing", "one name is right, so names mean something: {e}");
}

#[test]
fn colmap_times_come_only_on_request() {
    let f = Folder::new(4, "png");
    f.colmap_text(&f.pinhole());
    let with = |time_from, fps| f.open(&DataOptions { hold_out: 0, time_from, fps, ..Default::default() }).unwrap();
    assert!(!with(TimeFrom::File, None).dynamic);
    let d = with(TimeFrom::Name, Some(30.0));
    assert_eq!((d.dynamic, d.train[3].time.normalised, d.train[3].time.seconds), (true, 1.0, 0.1));
    assert!(d.time_source.contains("30 frames per second"), "{}", d.time_source);
}

#[test]
fn colmap_rows_that_are_wrong_are_named() {
    let f = Folder::new(3, "png");
    let fault = |from: &str, to: &str, file: &str| {
        f.colmap_text("PINHOLE 40 30 45 45 20 15");
        let name = format!("sparse/0/{file}.txt");
        let text = std::fs::read_to_string(f.path().join(&name)).unwrap();
        let changed = text.replacen(from, to, 1);
        assert_ne!(text, changed);
        f.put(&name, changed);
        f.open(&DataOptions::default()).unwrap_err()
    };
    let qw = wxyz(&f.cameras[0])[0].to_string();
    for (from, to, file, want) in [
        (qw.as_str(), "nan", "images", "images[0].qw is NaN"),
        (qw.as_str(), "30", "images", "images[0].qvec has no rotation"),
        (" 1 f001.png", " 5 f001.png", "images", "images[1].camera_id is 5, which cameras does not list"),
        (" 1 f001.png", " 1 ../../f001.png", "images", "leaves the data folder"),
        (" 1 f001.png", " 1", "images", "name is missing"),
        ("0.2 0.3", "inf 0.3", "points3D", "points3D[0].y is inf"),
        ("255 0 51", "256 0 51", "points3D", "red is 256"),
    ] {
        let e = fault(from, to, file);
        assert!(e.to_string().contains(want), "{e}");
    }
    std::fs::rename(f.path().join("images"), f.path().join("pictures")).unwrap();
    f.colmap_text(&f.pinhole());
    let e = f.open(&DataOptions::default()).unwrap_err();
    assert!(e.to_string().contains("no image folder"), "{e}");
    let d = f.open(&DataOptions { images: Some("pictures".into()), ..Default::default() }).unwrap();
    assert_eq!(d.train.len() + d.test.len(), 3);
    let away = f.open(&DataOptions { images: Some("../pictures".into()), ..Default::default() }).unwrap_err();
    assert_eq!(away.code(), "data.escape");
}
