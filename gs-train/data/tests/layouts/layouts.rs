//! Small folders made by hand: what readers make of images and of Nerfstudio's cameras, and what they say of files that are not there.

use std::path::Path;

use glam::{DMat3, DVec2, DVec3};
use gs_core::Camera;
use gs_data::{DataError, DataOptions, Dataset, ImageCache, detect};
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

    pub(crate) fn pinhole(&self) -> String {
        let c = &self.cameras[0];
        format!("PINHOLE 40 30 {} {} {} {}", c.fx, c.fy, c.cx, c.cy)
    }
}

pub(crate) fn wxyz(c: &Camera) -> [f64; 4] {
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
