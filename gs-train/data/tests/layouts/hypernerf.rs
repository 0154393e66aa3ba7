//! The reader of Nerfies and HyperNeRF captures on folders written here: geometry against the format's own formula, splits,
//! times, and every fault it names.

use std::path::Path;

use glam::{DMat3, DQuat, DVec2, DVec3, EulerRot};
use gs_data::{DataError, DataOptions, Dataset, ImageCache, TimeFrom, detect};
use serde_json::{Value, json};
use tempfile::TempDir;

const CENTRE: [f64; 3] = [0.3, -0.2, 1.5];
const SCALE: f64 = 0.25;
/// Full size of the pictures; `rgb/2x` holds them at half of it.
const SIZE: [u32; 2] = [40, 60];

/// A capture of `n` pictures whose first half trains.
struct Capture {
    dir: TempDir,
    dataset: Value,
    metadata: Value,
    scene: Value,
}

fn id(k: usize) -> String {
    format!("{k:06}")
}

/// Rotation to camera `k` and its centre, in the raw frame.
fn pose(k: usize) -> (DMat3, DVec3) {
    let a = k as f64;
    let q = DQuat::from_euler(EulerRot::XYZ, 0.1 * a, 0.2 - 0.05 * a, 0.3 * a);
    (DMat3::from_quat(q), DVec3::new(0.5 + 0.2 * a, -0.3, -4.0 + 0.1 * a))
}

fn camera(k: usize) -> Value {
    let (r, c) = pose(k);
    let row = |i: usize| [r.x_axis[i], r.y_axis[i], r.z_axis[i]];
    json!({
        "orientation": [row(0), row(1), row(2)], "position": c.to_array(), "focal_length": 50.0,
        "principal_point": [18.5, 31.25], "skew": 0.8, "pixel_aspect_ratio": 1.02,
        "radial_distortion": [0.05, -0.02, 0.001], "tangential_distortion": [0.002, -0.003], "image_size": SIZE,
    })
}

/// The format's projection of a point of the raw frame, in full-size pixels.
fn project(k: usize, world: DVec3) -> DVec2 {
    let (r, c) = pose(k);
    let p = r * (world - c);
    let (x, y) = (p.x / p.z, p.y / p.z);
    let rho = x * x + y * y;
    let d = 1.0 + rho * (0.05 + rho * (-0.02 + rho * 0.001));
    let (p1, p2) = (0.002, -0.003);
    let xd = x * d + 2.0 * p1 * x * y + p2 * (rho + 2.0 * x * x);
    let yd = y * d + 2.0 * p2 * x * y + p1 * (rho + 2.0 * y * y);
    DVec2::new(50.0 * xd + 0.8 * yd + 18.5, 50.0 * 1.02 * yd + 31.25)
}

impl Capture {
    fn new(n: usize) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let ids: Vec<String> = (0..n).map(id).collect();
        let tag = |k: usize| json!({"camera_id": k % 2, "time_id": k / 2, "warp_id": k, "appearance_id": k});
        let capture = Self {
            dataset: json!({"count": n, "ids": ids, "train_ids": ids[..n / 2], "val_ids": ids[n / 2..]}),
            metadata: (0..n).map(|k| (id(k), tag(k))).collect::<serde_json::Map<_, _>>().into(),
            scene: json!({"center": CENTRE, "scale": SCALE, "near": 0.1, "far": 2.0}),
            dir,
        };
        for k in 0..n {
            capture.put(&format!("camera/{}.json", id(k)), camera(k).to_string());
            for (folder, s) in [("rgb/1x", 1), ("rgb/2x", 2)] {
                let file = capture.path().join(format!("{folder}/{}.png", id(k)));
                std::fs::create_dir_all(file.parent().unwrap()).unwrap();
                image::RgbImage::from_pixel(SIZE[0] / s, SIZE[1] / s, image::Rgb([90; 3])).save(file).unwrap();
            }
        }
        capture.put("points.npy", npy(&[2, 3], &[0.3, -0.2, 1.5, 1.3, 0.8, 1.5]));
        capture
    }

    fn path(&self) -> &Path {
        self.dir.path()
    }

    fn put(&self, name: &str, contents: impl AsRef<[u8]>) {
        let file = self.path().join(name);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        // A new file: truncating one in place makes some file systems wait for the disk.
        let _ = std::fs::remove_file(&file);
        std::fs::write(file, contents).unwrap();
    }

    /// Opens it with its lists as they are now.
    fn open(&self, options: &DataOptions) -> Result<Dataset, DataError> {
        self.put("dataset.json", self.dataset.to_string());
        self.put("metadata.json", self.metadata.to_string().replace("\"<NaN>\"", "NaN"));
        self.put("scene.json", self.scene.to_string().replace("\"<NaN>\"", "NaN"));
        Dataset::open(self.path(), options)
    }
}

fn npy(shape: &[usize], values: &[f32]) -> Vec<u8> {
    let mut bytes = Vec::new();
    gs_core::io::npy::write(shape, values, &mut bytes).unwrap();
    bytes
}

#[test]
fn cameras_see_what_the_format_says() {
    let c = Capture::new(8);
    for (images, ratio) in [(Some("rgb/1x"), 1.0), (None, 0.5)] {
        let d = c.open(&DataOptions { images: images.map(str::to_owned), ..Default::default() }).unwrap();
        assert_eq!(
            (detect(c.path()).unwrap().name, d.layout, d.train.len(), d.test.len()),
            ("hypernerf", "hypernerf", 4, 4)
        );
        let mut worst: f64 = 0.0;
        for v in d.train.iter().chain(&d.test) {
            let k: usize = v.name.parse().unwrap();
            assert_eq!((f64::from(v.camera.width), v.camera_id), (40.0 * ratio, k as u32 % 2));
            for step in 0..20 {
                // Points in front of the camera, over the whole picture.
                let (r, centre) = pose(k);
                let s = f64::from(step);
                let ray = DVec3::new(0.35 * (s * 0.7).sin(), 0.55 * (s * 1.3).cos(), 1.0) * (2.0 + 0.1 * s);
                let world = centre + r.transpose() * ray;
                let want = project(k, world) * ratio;
                let normalised = (world - DVec3::from(CENTRE)) * SCALE;
                let pinhole = v.camera.to_pixel(v.camera.to_camera(normalised));
                let lens = v.lens.unwrap();
                assert!((lens.source_pixel(&v.camera, pinhole) - want).length() < 1e-9, "view {k}");
                // And back: the image's pixel through the inverse of lens and skew.
                let seen = (want - DVec2::new(v.camera.cx, v.camera.cy)) / DVec2::new(v.camera.fx, v.camera.fy);
                let back = lens.undistort(seen).unwrap() * DVec2::new(v.camera.fx, v.camera.fy)
                    + DVec2::new(v.camera.cx, v.camera.cy);
                worst = worst.max((back - pinhole).length());
            }
        }
        assert!(worst < 1e-3, "{worst} pixels after the round trip");
        println!("round trip through distortion and skew: {worst:.1e} pixels");
        assert_eq!(ImageCache::new(0, 1.0).get(&d.train[0]).unwrap().width as f64, 40.0 * ratio);
    }
}

#[test]
fn points_are_normalised_and_everything_assumed_is_noted() {
    let mut c = Capture::new(8);
    let d = c.open(&DataOptions::default()).unwrap();
    let points = d.points.clone().unwrap().positions;
    assert!(points[0].length() < 1e-6 && (points[1] - glam::Vec3::new(0.25, 0.25, 0.0)).length() < 1e-6);
    assert!(d.bounds.is_none(), "the points say where the scene is");
    let notes = d.notes.join("\n");
    for part in [
        "rgb/2x",
        "appearance ids are not used",
        "2 points without colours",
        "resampled to a pinhole",
        "40x60 against 20x30",
    ] {
        assert!(notes.contains(part), "{part}: {notes}");
    }
    std::fs::remove_file(c.path().join("points.npy")).unwrap();
    c.dataset["count"] = json!(9);
    let d = c.open(&DataOptions::default()).unwrap();
    assert!(d.points.is_none() && d.notes.iter().any(|n| n.contains("no points.npy")));
    assert!(d.notes.iter().any(|n| n.contains("count of 9 and lists 8 ids")), "{:?}", d.notes);
    let [low, high] = d.bounds.unwrap();
    assert!(low.x < high.x && high.max_element() < 5.0, "near and far, in the normalised frame: {low} {high}");
    let e = c.open(&DataOptions { undistort: false, ..Default::default() }).unwrap_err();
    assert_eq!(e.code(), "data.camera_model");
}

#[test]
fn times_are_ids_over_the_largest_id_of_all() {
    let mut c = Capture::new(8);
    let d = c.open(&DataOptions::default()).unwrap();
    let times = |d: &Dataset| d.train.iter().chain(&d.test).map(|v| v.time.normalised).collect::<Vec<_>>();
    let thirds = [0.0f32, 0.0, 1.0 / 3.0, 1.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0, 1.0, 1.0];
    assert!(times(&d).iter().zip(thirds).all(|(a, b)| (a - b).abs() < 1e-6), "{:?}", times(&d));
    assert!(d.dynamic && d.time_source.contains("time_id"), "{}", d.time_source);
    for k in 0..8 {
        c.metadata[id(k)].as_object_mut().unwrap().remove("time_id");
    }
    let d = c.open(&DataOptions::default()).unwrap();
    assert!((d.train[1].time.normalised - 1.0 / 7.0).abs() < 1e-6 && d.time_source.contains("warp_id"));
    let wide = DataOptions { time_range: Some("0..14".parse().unwrap()), ..Default::default() };
    assert!((c.open(&wide).unwrap().test[3].time.normalised - 0.5).abs() < 1e-6);
    let named = c.open(&DataOptions { time_from: TimeFrom::Name, ..Default::default() }).unwrap();
    assert_eq!(named.train[3].time.normalised, 1.0, "numbers of names span the training views, as in other layouts");
    assert!(named.time_source.contains("file name"), "{}", named.time_source);
}

#[test]
fn captures_without_val_ids_are_interpolated() {
    let mut c = Capture::new(11);
    c.dataset["val_ids"] = json!([]);
    let d = c.open(&DataOptions::default()).unwrap();
    let names = |views: &[gs_data::View]| views.iter().map(|v| v.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&d.train), [id(0), id(4), id(8)]);
    assert_eq!(names(&d.test), [id(2), id(6)], "after the last of training is not between");
    assert!(d.notes.iter().any(|n| n.contains("val_ids is empty")), "{:?}", d.notes);
    assert_eq!(d.test[1].time.normalised, 0.6, "the clock runs over all ids");
}

#[test]
fn data_scale_shrinks_any_layout() {
    let c = Capture::new(4);
    let full = c.open(&DataOptions { images: Some("rgb/1x".into()), ..Default::default() }).unwrap();
    let half = c.open(&DataOptions { images: Some("rgb/1x".into()), scale: 0.5, ..Default::default() }).unwrap();
    let (a, b) = (&full.train[0], &half.train[0]);
    assert_eq!((b.camera.width, b.camera.height, b.stored), (20, 30, Some(SIZE)));
    assert!((a.camera.fx - 2.0 * b.camera.fx).abs() < 1e-12 && a.lens == b.lens);
    assert_eq!(ImageCache::new(0, 1.0).get(b).unwrap().height, 30);
    for wrong in [0.0, 1.5, f64::NAN, -1.0] {
        let e = c.open(&DataOptions { scale: wrong, ..Default::default() }).unwrap_err();
        assert_eq!((e.code(), e.exit_code()), ("data.option", 2));
    }
}

/// What opening says after a change of one file.
fn fault(change: impl FnOnce(&mut Capture)) -> DataError {
    let mut c = Capture::new(4);
    c.open(&DataOptions::default()).expect("without the change it opens");
    change(&mut c);
    c.open(&DataOptions::default()).unwrap_err()
}

fn camera_fault(change: impl FnOnce(&mut Value)) -> DataError {
    fault(|c| {
        let mut j = camera(1);
        change(&mut j);
        c.put("camera/000001.json", j.to_string().replace("\"<NaN>\"", "NaN"));
    })
}

#[test]
fn every_fault_is_named() {
    type Change = fn(&mut Value);
    let cameras: [(Change, &str, &str); 10] = [
        (|j| j["orientation"][1][2] = json!("<NaN>"), "data.field", "orientation[1][2] is NaN"),
        (|j| j["orientation"][1] = json!([1.0]), "data.field", "orientation[1] is [1.0]"),
        (|j| j["orientation"] = json!([[2, 0, 0], [0, 2, 0], [0, 0, 2]]), "data.pose", "lengths 2.0000"),
        (|j| j["orientation"] = json!([[1, 0, 0], [0, 1, 0], [0, 0, -1]]), "data.pose", "mirrored"),
        (|j| j["position"] = json!([1.0, 2.0]), "data.field", "position is [1.0,2.0]"),
        (|j| j["focal_length"] = json!(-3), "data.field", "focal_length is -3"),
        (|j| j["focal_length"] = json!(1e300), "data.field", "no usable camera"),
        (|j| j["radial_distortion"] = json!([0.1]), "data.field", "radial_distortion is [0.1]"),
        (|j| drop(j.as_object_mut().unwrap().remove("principal_point")), "data.field", "principal_point is missing"),
        (|j| j["image_size"] = json!([40, 10]), "data.image_size", "its camera is 40x10"),
    ];
    for (change, code, text) in cameras {
        let e = camera_fault(change);
        assert!(e.code() == code && e.to_string().contains(text), "{text}: {e}");
    }
    type Edit = fn(&mut Capture);
    let edits: [(Edit, &str, &str); 14] = [
        (|c| c.scene["scale"] = json!("<NaN>"), "data.field", "scale is NaN"),
        (|c| c.scene["scale"] = json!(0.0), "data.field", "scale is 0"),
        (|c| drop(c.scene.as_object_mut().unwrap().remove("center")), "data.field", "center is missing"),
        (|c| c.metadata["000001"]["time_id"] = json!("<NaN>"), "data.field", "000001.time_id is NaN"),
        (|c| c.metadata["000001"]["time_id"] = json!(1e30), "data.field", "000001.time_id is 1000"),
        (|c| c.metadata["000001"]["camera_id"] = json!(-1), "data.field", "000001.camera_id is -1"),
        (|c| drop(c.metadata.as_object_mut().unwrap().remove("000003")), "data.field", "000003 is missing"),
        (|c| c.dataset["train_ids"][0] = json!(7), "data.field", "train_ids[0] is 7"),
        (|c| c.dataset["val_ids"][0] = json!("000000"), "data.field", "val_ids, id \"000000\" is in train_ids of"),
        (|c| c.dataset["train_ids"] = json!([]), "data.empty", "gives no training view"),
        (|c| c.put("points.npy", npy(&[3, 2], &[0.0; 6])), "data.field", "shape is [3, 2], not n rows of 3"),
        (|c| c.put("points.npy", npy(&[1, 3], &[0.0, f32::NAN, 0.0])), "data.syntax", "must be finite"),
        (
            |c| std::fs::remove_file(c.path().join("rgb/2x/000001.png")).unwrap(),
            "data.missing",
            "1 of 2 images are missing: rgb/2x/000001.png",
        ),
        (|c| std::fs::remove_file(c.path().join("camera/000002.json")).unwrap(), "io.read", "camera/000002.json"),
    ];
    for (edit, code, text) in edits {
        let e = fault(edit);
        assert!(e.code() == code && e.to_string().contains(text), "{text}: {} {e}", e.code());
    }
}

#[test]
fn paths_and_sizes_are_bounded() {
    for bad in ["../../secret", "/etc/passwd", "C:\\x"] {
        let e = fault(|c| {
            c.dataset["train_ids"][0] = json!(bad);
            c.metadata[bad] = json!({"time_id": 0});
        });
        assert!(["data.escape", "io.read"].contains(&e.code()), "{bad}: {} {e}", e.code());
        assert!(!e.to_string().contains("passwd") || !e.to_string().contains("cannot read /etc"), "{e}");
    }
    let c = Capture::new(4);
    c.open(&DataOptions::default()).unwrap();
    c.put("metadata.json", format!("{{\"a\": [{}0]}}", "0,".repeat(2 << 20)));
    let e = Dataset::open(c.path(), &DataOptions::default()).unwrap_err();
    assert_eq!((e.code(), e.exit_code()), ("limits.file", 5));
    c.put("metadata.json", "[".repeat(100_000));
    assert_eq!(Dataset::open(c.path(), &DataOptions::default()).unwrap_err().code(), "data.syntax");
    let e = c.open(&DataOptions { images: Some("../rgb".into()), ..Default::default() }).unwrap_err();
    assert_eq!(e.code(), "data.escape");
    std::fs::remove_dir_all(c.path().join("rgb")).unwrap();
    let e = c.open(&DataOptions::default()).unwrap_err();
    assert!(e.code() == "data.layout" && e.to_string().contains("rgb/16x"), "{e}");
}

/// The capture as DyCheck writes it: camera 0 trains, 1 and 2 are held out and have masks; alpha where there is depth.
fn dycheck() -> Capture {
    let mut c = Capture::new(6);
    for k in 0..6 {
        let camera = [0, 0, 0, 1, 1, 2][k];
        c.metadata[id(k)] = json!({"warp_id": k % 3, "appearance_id": k % 3, "camera_id": camera});
        let half = |x: u32, _| image::Rgba([200, 100, 50, if x < 10 { 0 } else { 255 }]);
        image::RgbaImage::from_fn(20, 30, half).save(c.path().join(format!("rgb/2x/{}.png", id(k)))).unwrap();
    }
    for k in 0..3 {
        c.put(&format!("depth/2x/{}.npy", id(k)), npy(&[30, 20], &[1.0; 600]));
    }
    std::fs::create_dir_all(c.path().join("covisible/2x/val")).unwrap();
    for k in 3..5 {
        let top = |_, y: u32| image::Luma([if y < 15 { 255u8 } else { 0 }]);
        image::GrayImage::from_fn(20, 30, top).save(c.path().join(format!("covisible/2x/val/{}.png", id(k)))).unwrap();
    }
    c.put("splits/train.json", json!({"frame_names": [id(0), id(1), id(2)], "time_ids": [0, 1, 2]}).to_string());
    c.put("splits/val.json", json!({"frame_names": [id(3), id(4), id(5)], "camera_ids": [1, 1, 2]}).to_string());
    c.dataset["val_ids"] = json!([]);
    let extra = json!({"factor": 2, "fps": 10.0, "bbox": [[-0.5, -0.4, -0.3], [0.5, 0.4, 0.3]], "lookat": [0, 0, 0]});
    c.put("extra.json", extra.to_string());
    c
}

#[test]
fn dycheck_captures_have_masks_depth_and_a_clock() {
    let c = dycheck();
    let d = c.open(&DataOptions::default()).unwrap();
    assert_eq!((d.train.len(), d.test.len(), d.has_alpha), (3, 3, false));
    assert!(d.train.iter().all(|v| v.camera_id == 0 && v.mask.is_none() && v.depth.as_ref().unwrap().file.is_file()));
    let depth = d.train[1].depth.as_ref().unwrap();
    assert!(depth.file.ends_with("depth/2x/000001.npy"));
    // Metres of the raw frame, which the normalised one scales.
    let raw = c.open(&DataOptions { normalise: false, ..Default::default() }).unwrap();
    let ratio = d.scene_extent() / raw.scene_extent();
    assert!(
        (depth.unit - f64::from(ratio)).abs() < 1e-5 && raw.train[1].depth.as_ref().unwrap().unit == 1.0,
        "{}",
        depth.unit
    );
    assert_eq!((d.train[2].time.normalised, d.train[2].time.seconds), (1.0, 0.2));
    let cache = ImageCache::new(1 << 20, 1.0);
    let opaque = cache.get(&d.train[0]).unwrap();
    assert!(opaque.data.chunks_exact(4).all(|p| p == [200, 100, 50, 255]), "alpha is no transparency here");
    let masks: Vec<_> = d.test.iter().map(|v| cache.mask(v).unwrap()).collect();
    assert!(masks[2].is_none() && d.test[2].depth.is_none());
    let mask = masks[0].as_ref().unwrap();
    assert_eq!((mask.pixel(10, 5), mask.pixel(10, 25)), (&[1.0][..], &[0.0][..]));
    let full = c.open(&DataOptions { images: Some("rgb/1x".into()), ..Default::default() }).unwrap();
    assert_eq!(cache.mask(&full.test[0]).unwrap().unwrap().shape(), (40, 60, 1), "a mask fits pictures of any size");
    let notes = d.notes.join("\n");
    for part in ["splits/train.json", "alpha, which is not used", "2 of 3 held-out views have a mask"] {
        assert!(notes.contains(part), "{part}: {notes}");
    }
    let other = c.open(&DataOptions { test_cameras: vec![2], ..Default::default() }).unwrap();
    assert_eq!((other.train.len(), other.test.len()), (5, 1));
    std::fs::remove_file(c.path().join("points.npy")).unwrap();
    let box_of = |normalise| c.open(&DataOptions { normalise, ..Default::default() }).unwrap().bounds.unwrap();
    assert_eq!(box_of(true)[1], glam::Vec3::new(0.5, 0.4, 0.3));
    let raw = glam::Vec3::new(0.5, 0.4, 0.3) / SCALE as f32 + DVec3::from(CENTRE).as_vec3();
    assert!((box_of(false)[1] - raw).length() < 1e-5);
}

#[test]
fn the_raw_frame_and_the_bare_focal_length_are_on_request() {
    let c = Capture::new(8);
    let bare = DataOptions { center_pp: true, normalise: false, ..Default::default() };
    let d = c.open(&bare).unwrap();
    for v in &d.train {
        let k: usize = v.name.parse().unwrap();
        assert!((v.camera.position() - pose(k).1).length() < 1e-12, "the raw frame");
        assert_eq!((v.camera.fx, v.camera.fy, v.camera.cx, v.camera.cy, v.lens), (25.0, 25.0, 10.0, 15.0, None));
    }
    assert!((d.points.unwrap().positions[1] - glam::Vec3::new(1.3, 0.8, 1.5)).length() < 1e-6);
    assert!(d.notes.iter().any(|n| n.contains("data.center_pp")), "{:?}", d.notes);
    let head = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n";
    let color = "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n";
    c.put("points3D_downsample2.ply", format!("{head}{color}1.3 0.8 1.5 255 0 51\n"));
    let cloud = c.open(&DataOptions::default()).unwrap().points.unwrap();
    assert!((cloud.positions[0] - glam::Vec3::new(0.25, 0.25, 0.0)).length() < 1e-6, "the dense cloud goes first");
    assert_eq!(cloud.colors, [[1.0, 0.0, 0.2]]);
    let mut old = camera(1);
    let j = old.as_object_mut().unwrap();
    let tangential = j.remove("tangential_distortion").unwrap();
    j.insert("tangential".into(), tangential);
    c.put("camera/000001.json", old.to_string());
    let d = c.open(&DataOptions::default()).unwrap();
    assert_eq!(d.train[0].lens, d.train[1].lens, "files of 2021 call it tangential");
}

#[test]
fn faults_of_dycheck_captures_are_named() {
    type Edit = fn(&Capture);
    let edits: [(Edit, &str, &str); 6] = [
        (
            |c| c.put("splits/val.json", "{\"frame_names\": [\"000003\"], \"time_ids\": []}"),
            "data.field",
            "time_ids is 0",
        ),
        (|c| c.put("splits/val.json", "{\"frame_names\": [\"../x\"]}"), "data.field", "../x is missing"),
        (|c| c.put("extra.json", "{\"fps\": -1}"), "data.field", "fps is -1"),
        (|c| c.put("extra.json", "{\"bbox\": [[0, 1, 2]]}"), "data.field", "bbox is [[0,1,2]]"),
        (|c| c.put("extra.json", "{\"bbox\": [[0, 1, 2], [NaN, 1, 2]]}"), "data.field", "bbox[1][0] is NaN"),
        (
            |c| image::GrayImage::new(9, 9).save(c.path().join("covisible/2x/val/000004.png")).unwrap(),
            "data.image_size",
            "000004.png is 9x9",
        ),
    ];
    for (edit, code, text) in edits {
        let c = dycheck();
        edit(&c);
        let e = c.open(&DataOptions::default()).unwrap_err();
        assert!(e.code() == code && e.to_string().contains(text), "{text}: {} {e}", e.code());
    }
}

#[test]
fn faults_of_a_split_name_its_own_file() {
    let fault = |names: Value| {
        let c = dycheck();
        c.put("splits/val.json", json!({ "frame_names": names }).to_string());
        let e = c.open(&DataOptions::default()).unwrap_err();
        assert!(e.place().unwrap().file.ends_with("splits/val.json"), "{}", e.report());
        e.to_string()
    };
    assert!(fault(json!([id(3), id(1)])).starts_with("frame_names, id \"000001\" is in frame_names of"));
    assert!(fault(json!([id(3), 4])).starts_with("frame_names[1] is 4"));
}

/// Any byte changed in any of the lists gives a data set or a typed error.
#[test]
fn mutated_lists_give_data_or_an_error() {
    let c = Capture::new(4);
    c.open(&DataOptions::default()).unwrap();
    let mut outcomes = [0, 0];
    for name in ["dataset.json", "metadata.json", "scene.json", "camera/000000.json", "points.npy"] {
        let whole = std::fs::read(c.path().join(name)).unwrap();
        for k in 0..150u64 {
            let mut rng = gs_core::Rng::new(9, "mutate.hypernerf", 0, k);
            let mut bytes = whole.clone();
            let at = rng.below(bytes.len() as u32) as usize;
            match rng.below(3) {
                0 => bytes[at] = rng.bits() as u8,
                1 => bytes.truncate(at),
                _ => bytes.insert(at, b"0123456789eE.-[]{}\",:"[rng.below(21) as usize]),
            }
            c.put(name, &bytes);
            match Dataset::open(c.path(), &DataOptions::default()) {
                Ok(d) => {
                    outcomes[0] += 1;
                    assert!(d.train.iter().all(|v| v.camera.check().is_ok() && v.time.normalised.is_finite()));
                }
                Err(e) => {
                    outcomes[1] += 1;
                    assert!(e.report().contains("\n  do   "), "{e}");
                }
            }
        }
        c.put(name, &whole);
    }
    assert!(outcomes.iter().all(|&n| n > 50), "both happen: {outcomes:?}");
}
