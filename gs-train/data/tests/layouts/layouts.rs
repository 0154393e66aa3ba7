//! The readers on small folders made by hand: what they read, what they assume, and every fault they name.

use std::path::Path;

use glam::{DMat3, DVec2, DVec3};
use gs_core::Camera;
use gs_data::{DataError, DataOptions, Dataset, ImageCache, ImageSource, TimeFrom, detect};
use serde_json::{Value, json};
use tempfile::TempDir;

/// A folder with `n` images of 40×30 in `images/` and a ring of cameras around the origin.
pub(crate) struct Folder {
    dir: TempDir,
    pub(crate) cameras: Vec<Camera>,
}

impl Folder {
    pub(crate) fn new(n: usize, extension: &str) -> Self {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join("images")).unwrap();
        let mut cameras = Vec::new();
        for k in 0..n {
            let file = dir.path().join(format!("images/f{k:03}.{extension}"));
            image::RgbImage::from_pixel(40, 30, image::Rgb([k as u8 * 10, 50, 50])).save(file).unwrap();
            let angle = k as f64 * 0.7;
            let eye = DVec3::new(3.0 * angle.cos(), 3.0 * angle.sin(), 0.5 + 0.1 * k as f64);
            let c = Camera::look_at(40, 30, 0.8, eye, DVec3::ZERO, DVec3::Z).unwrap();
            cameras.push(Camera { cx: 19.0, cy: 16.5, fy: c.fx * 1.01, ..c });
        }
        Self { dir, cameras }
    }

    pub(crate) fn path(&self) -> &Path {
        self.dir.path()
    }

    pub(crate) fn put(&self, name: &str, contents: impl AsRef<[u8]>) {
        let file = self.path().join(name);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(file, contents).unwrap();
    }

    pub(crate) fn open(&self, options: &DataOptions) -> Result<Dataset, DataError> {
        Dataset::open(self.path(), options)
    }

    /// A `transforms.json` for all cameras.
    pub(crate) fn nerfstudio(&self) -> Value {
        let frames: Vec<Value> = (0..self.cameras.len())
            .map(|k| json!({"file_path": format!("images/f{k:03}.png"), "transform_matrix": opengl(&self.cameras[k])}))
            .collect();
        let c = &self.cameras[0];
        json!({"fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy, "w": 40, "h": 30, "frames": frames})
    }

    /// The same as a COLMAP text model.
    pub(crate) fn colmap_text(&self, model: &str) {
        self.put("sparse/0/cameras.txt", format!("# comment\n1 {model}\n"));
        let mut images = String::from("# comment\n");
        for (k, c) in self.cameras.iter().enumerate() {
            let (q, t) = (wxyz(c), c.translation);
            let pose = format!("{} {} {} {} {} {} {}", q[0], q[1], q[2], q[3], t.x, t.y, t.z);
            let observations = if k % 2 == 0 { "1.5 2.5 7 3.0 4.0 -1" } else { "" };
            images += &format!("{} {pose} 1 f{k:03}.png\n{observations}\n", k + 1);
        }
        self.put("sparse/0/images.txt", images);
        self.put("sparse/0/points3D.txt", "# c\n1 0.1 0.2 0.3 255 0 51 0.5 1 2 3 4\n2 -1 -2 -3 0 0 0 0.1\n");
    }

    fn pinhole(&self) -> String {
        let c = &self.cameras[0];
        format!("PINHOLE 40 30 {} {} {} {}", c.fx, c.fy, c.cx, c.cy)
    }
}

fn wxyz(c: &Camera) -> [f64; 4] {
    let q = glam::DQuat::from_mat3(&c.rotation);
    [q.w, q.x, q.y, q.z]
}

pub(crate) fn opengl(c: &Camera) -> [[f64; 4]; 4] {
    let r = c.rotation.transpose() * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let p = c.position();
    let row = |i: usize| [r.x_axis[i], r.y_axis[i], r.z_axis[i], p[i]];
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

/// Largest difference between where two cameras see a few points, in pixels.
pub(crate) fn apart(a: &Camera, b: &Camera) -> f64 {
    let pixel = |c: &Camera, p: DVec3| c.to_pixel(c.to_camera(p));
    [DVec3::ZERO, DVec3::new(0.3, -0.2, 0.4), DVec3::new(-0.5, 0.5, 0.1)]
        .map(|p| (pixel(a, p) - pixel(b, p)).length())
        .into_iter()
        .fold(0.0, f64::max)
}

pub(crate) fn number(name: &str) -> usize {
    name[1..].parse().unwrap()
}

#[test]
fn nerfstudio_cameras_are_the_cameras_and_every_eighth_is_held_out() {
    let f = Folder::new(10, "png");
    f.put("transforms.json", f.nerfstudio().to_string());
    assert_eq!(detect(f.path()).unwrap().name, "nerfstudio");
    let d = f.open(&DataOptions::default()).unwrap();
    assert_eq!((d.train.len(), d.val.len(), d.test.len(), d.dynamic, d.has_alpha), (8, 0, 2, false, false));
    for v in d.train.iter().chain(&d.test) {
        assert!(apart(&v.camera, &f.cameras[number(&v.name)]) < 1e-9);
        assert_eq!((v.camera.width, v.camera.height, v.lens), (40, 30, None));
    }
    assert_eq!((d.test[0].name.as_str(), d.test[1].name.as_str()), ("f000", "f008"));
    assert!(d.notes.iter().any(|n| n.contains("every 8th")), "{:?}", d.notes);
}

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
fn nerfstudio_splits_times_frames_and_points_are_used() {
    let f = Folder::new(4, "png");
    let mut j = f.nerfstudio();
    for k in 0..4 {
        j["frames"][k]["time"] = json!(k as f64 * 2.0);
    }
    j["frames"][2]["fl_x"] = json!(77.0);
    j["train_filenames"] = json!(["images/f000.png", "images/f003.png"]);
    j["val_filenames"] = json!(["images/f001.png"]);
    j["test_filenames"] = json!(["images/f002.png"]);
    j["ply_file_path"] = json!("points.ply");
    let head =
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    f.put("points.ply", format!("{head}1 2 3\n"));
    f.put("transforms.json", j.to_string());
    let d = f.open(&DataOptions::default()).unwrap();
    assert_eq!((d.train.len(), d.val.len(), d.test.len(), d.dynamic), (2, 1, 1, true));
    assert_eq!((d.train[1].time.normalised, d.train[1].time.seconds), (1.0, 6.0));
    assert!((d.test[0].time.normalised - 2.0 / 3.0).abs() < 1e-6);
    assert_eq!((d.test[0].camera.fx, d.train[0].camera.fx), (77.0, f.cameras[0].fx));
    assert_eq!(d.points.unwrap().positions, vec![glam::Vec3::new(1.0, 2.0, 3.0)]);
}

#[test]
fn distortion_is_kept_with_the_view_or_refused() {
    let f = Folder::new(3, "png");
    let mut j = f.nerfstudio();
    j["k1"] = json!(0.1);
    j["p2"] = json!(-0.01);
    f.put("transforms.json", j.to_string());
    let d = f.open(&DataOptions::default()).unwrap();
    let lens = d.train[0].lens.unwrap();
    assert_eq!((lens.k1, lens.p2), (0.1, -0.01));
    assert!(d.notes.iter().any(|n| n.contains("3 views are resampled to a pinhole")), "{:?}", d.notes);
    let image = ImageCache::new(0, 1.0).get(&d.train[0]).unwrap();
    assert_eq!((image.width, image.height), (40, 30));
    let e = f.open(&DataOptions { undistort: false, ..Default::default() }).unwrap_err();
    assert_eq!(e.code(), "data.camera_model");
    j["k4"] = json!(0.2);
    f.put("transforms.json", j.to_string());
    assert!(f.open(&DataOptions::default()).unwrap_err().to_string().contains("k4 = 0.2"));
    j["k4"] = json!(0);
    j["camera_model"] = json!("EQUIRECTANGULAR");
    f.put("transforms.json", j.to_string());
    assert_eq!(
        f.open(&DataOptions::default()).unwrap_err().to_string(),
        "camera model EQUIRECTANGULAR is not supported"
    );
}

#[test]
fn sizes_that_differ_rescale_intrinsics_exactly() {
    let f = Folder::new(3, "png");
    let mut j = f.nerfstudio();
    for (key, factor) in [("w", 4.0), ("h", 4.0), ("fl_x", 4.0), ("fl_y", 4.0), ("cx", 4.0), ("cy", 4.0)] {
        j[key] = json!(j[key].as_f64().unwrap() * factor);
    }
    f.put("transforms.json", j.to_string());
    let d = f.open(&DataOptions::default()).unwrap();
    assert!(d.train.iter().all(|v| apart(&v.camera, &f.cameras[number(&v.name)]) < 1e-9));
    assert!(d.notes.iter().any(|n| n.contains("160x120 against 40x30")), "{:?}", d.notes);
    j["w"] = json!(200.0);
    f.put("transforms.json", j.to_string());
    let e = f.open(&DataOptions::default()).unwrap_err();
    assert!(e.code() == "data.image_size" && e.to_string().contains("40x30, its camera is 200x120"), "{e}");
}

/// A JPEG file with an EXIF orientation.
fn jpeg(pixels: &image::RgbImage, orientation: u8) -> Vec<u8> {
    let mut out = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut out, 100);
    let exif = [b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0", [orientation, 0, 0, 0].as_slice(), &[0; 4]].concat();
    image::ImageEncoder::set_exif_metadata(&mut encoder, exif).unwrap();
    encoder.encode_image(pixels).unwrap();
    out
}

#[test]
fn images_on_their_side_are_turned_where_their_cameras_are_upright() {
    let open = |orientation: u8, [w, h]: [u32; 2]| {
        let f = Folder::new(9, "png");
        let mut j = f.nerfstudio();
        // Stored lying, 16 wide and 8 high, the left half bright.
        let pixels = image::RgbImage::from_fn(16, 8, |x, _| image::Rgb([if x < 8 { 240 } else { 10 }; 3]));
        for k in 0..9 {
            f.put(&format!("images/side_{k}.jpg"), jpeg(&pixels, orientation));
            j["frames"][k]["file_path"] = format!("images/side_{k}.jpg").into();
        }
        (j["w"], j["h"]) = (w.into(), h.into());
        (j["cx"], j["cy"]) = ((f64::from(w) / 2.0).into(), (f64::from(h) / 2.0).into());
        f.put("transforms.json", j.to_string());
        f.open(&DataOptions::default()).map(|data| {
            let image = ImageCache::new(1 << 20, 1.0).get(&data.train[0]).unwrap();
            let corners = [image.pixel(1, 1)[0], image.pixel(image.width - 2, image.height - 2)[0]];
            ([image.width, image.height], corners.map(|v| v > 128), data.notes.concat().contains("EXIF"))
        })
    };
    // 6: the first row is the right side, so what is stored on the left is above.
    assert_eq!(open(6, [8, 16]).unwrap(), ([8, 16], [true, false], true));
    assert_eq!(open(8, [8, 16]).unwrap(), ([8, 16], [false, true], true));
    // The camera is of the pixels as they are stored: COLMAP ignores the orientation.
    assert_eq!(open(6, [16, 8]).unwrap(), ([16, 8], [true, false], false));
    assert!(open(1, [8, 16]).unwrap_err().to_string().contains("16x8"));
}

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

#[test]
fn folders_layouts_and_images_that_are_not_there() {
    let nowhere = Dataset::open(Path::new("no/such/folder"), &DataOptions::default()).unwrap_err();
    assert_eq!((nowhere.code(), nowhere.exit_code()), ("data.path", 3));
    let f = Folder::new(2, "png");
    let e = f.open(&DataOptions::default()).unwrap_err();
    assert!(e.code() == "data.layout" && e.to_string().contains("looked for nvfi, blender, nerfstudio, colmap"), "{e}");
    let e = f.open(&DataOptions { layout: Some("blend".into()), ..Default::default() }).unwrap_err();
    assert!(e.to_string().contains("\"blend\" was asked for"), "{e}");
    f.put("transforms.json", f.nerfstudio().to_string());
    f.put("images/f001.png", b"not an image");
    assert_eq!(f.open(&DataOptions::default()).unwrap_err().code(), "data.image");
    std::fs::remove_file(f.path().join("images/f001.png")).unwrap();
    let e = f.open(&DataOptions::default()).unwrap_err();
    assert_eq!(e.to_string(), "1 of 2 images are missing: images/f001.png");
    let d = f.open(&DataOptions { allow_missing: true, hold_out: 0, ..Default::default() }).unwrap();
    assert_eq!(d.train.len(), 1);
    assert!(d.notes[0].starts_with("1 of 2 images are missing: images/f001.png"), "{:?}", d.notes);
    f.put("transforms.json", json!({"ply_file_path": "points.ply", "frames": [], "fl_x": 1}).to_string());
    assert_eq!(f.open(&DataOptions::default()).unwrap_err().code(), "data.empty");
    let mut j = f.nerfstudio();
    j["ply_file_path"] = json!("gone.ply");
    f.put("transforms.json", j.to_string());
    let e = f.open(&DataOptions { allow_missing: true, ..Default::default() }).unwrap_err();
    assert!(e.code() == "data.points" && e.to_string().contains("gone.ply"), "{e}");
    f.put("transforms.json", "x".repeat(65 << 20));
    let e = f.open(&DataOptions::default()).unwrap_err();
    assert_eq!((e.code(), e.exit_code()), ("limits.file", 5));
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

#[test]
fn errors_of_the_operating_system_name_the_file() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir(dir.path().join("transforms_train.json")).unwrap();
    let open = |layout: &str| {
        Dataset::open(dir.path(), &DataOptions { layout: Some(layout.into()), ..Default::default() }).unwrap_err()
    };
    let e = open("blender");
    assert_eq!((e.code(), e.exit_code()), ("io.read", 6));
    assert!(e.to_string().contains("transforms_train.json"), "{e}");
    let file = dir.path().join("file");
    std::fs::write(&file, "x").unwrap();
    let o = gs_synth::SynthOptions::of_views(8, 1, 0);
    let e = gs_synth::write(&file.join("scene"), "static", &o, false).unwrap_err();
    assert_eq!((e.code(), e.exit_code()), ("io.write", 6));
}

/// A point seen through the reader's camera lands where the file's own convention says.
#[test]
fn conventions_meet() {
    let f = Folder::new(2, "png");
    f.put("transforms.json", f.nerfstudio().to_string());
    let d = f.open(&DataOptions { hold_out: 0, ..Default::default() }).unwrap();
    let m = opengl(&f.cameras[1]);
    let world = DVec3::new(0.2, 0.3, -0.1);
    // OpenGL's own projection: x right, y up, looking along -z.
    let rel = world - DVec3::new(m[0][3], m[1][3], m[2][3]);
    let gl = [0, 1, 2].map(|j| (0..3).map(|i| m[i][j] * rel[i]).sum::<f64>());
    let c = &f.cameras[1];
    let want = DVec2::new(c.cx + c.fx * gl[0] / -gl[2], c.cy - c.fy * gl[1] / -gl[2]);
    let got = d.train[1].camera.to_pixel(d.train[1].camera.to_camera(world));
    assert!((got - want).length() < 1e-9, "{got} {want}");
}
