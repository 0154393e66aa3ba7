//! The reader of NVFi's scenes on folders written here: nested, flat and labelled files, splits by time, cameras, boxes, and
//! every fault it names.

use std::path::Path;

use glam::{DMat3, DVec3, Vec3};
use gs_core::{Camera, Rng};
use gs_data::{DataError, DataOptions, Dataset, TimeFrom, View, detect};
use serde_json::{Value, json};
use tempfile::TempDir;

/// Frames of a sequence; frame `k` is at `k / FRAMES`.
const FRAMES: usize = 8;
const SIZE: u32 = 6;
/// Cameras that train and the one that is held out.
const TRAIN: [usize; 3] = [0, 1, 2];
const VAL: [usize; 1] = [3];

fn camera(k: usize) -> Camera {
    let a = k as f64;
    Camera::look_at(SIZE, SIZE, 0.8, DVec3::new(2.0 * a.cos(), 2.0 * a.sin(), 1.0), DVec3::ZERO, DVec3::Z).unwrap()
}

fn opengl(k: usize) -> Value {
    let c = camera(k);
    let r = c.rotation.transpose() * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let p = c.position();
    let row = |i: usize| json!([r.x_axis[i], r.y_axis[i], r.z_axis[i], p[i]]);
    json!([row(0), row(1), row(2), [0, 0, 0, 1]])
}

fn time(frame: usize) -> f64 {
    frame as f64 / FRAMES as f64
}

fn frame(split: &str, camera: usize, frame: usize) -> Value {
    json!({"file_path": format!("./{split}/c{camera}_{frame:02}"), "time": time(frame)})
}

/// A scene whose files are values to be changed before it is opened.
struct Scene {
    dir: TempDir,
    train: Value,
    val: Value,
    test: Value,
}

impl Scene {
    /// Training and held-out cameras up to frame 6 (0.75), all cameras after it; `form` makes a file of its frames.
    fn new(alpha: bool, form: fn(&str, &[usize], &[usize]) -> Value) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let (past, future, all) = ([0, 1, 2, 3, 4, 5, 6], [7], [0, 1, 2, 3]);
        for (split, cameras, frames) in
            [("train", &TRAIN[..], &past[..]), ("val", &VAL, &past), ("test", &all, &future)]
        {
            std::fs::create_dir(dir.path().join(split)).unwrap();
            for c in cameras {
                for k in frames {
                    let file = dir.path().join(format!("{split}/c{c}_{k:02}.png"));
                    if alpha {
                        image::RgbaImage::from_pixel(SIZE, SIZE, image::Rgba([9, 9, 9, 128])).save(file).unwrap();
                    } else {
                        image::RgbImage::from_pixel(SIZE, SIZE, image::Rgb([9, 9, 9])).save(file).unwrap();
                    }
                }
            }
        }
        Self {
            dir,
            train: form("train", &TRAIN, &past),
            val: form("val", &VAL, &past),
            test: form("test", &all, &future),
        }
    }

    fn nested() -> Self {
        Self::new(true, |split, cameras, frames| {
            let of = |c: usize| -> Value { frames.iter().map(|&k| frame(split, c, k)).collect() };
            let data: serde_json::Map<String, Value> = cameras
                .iter()
                .map(|&c| (format!("cam_{c}"), json!({"transform_matrix": opengl(c), "frames": of(c)})))
                .collect();
            json!({"camera_angle_x": 0.8, "data": data})
        })
    }

    fn flat(alpha: bool) -> Self {
        Self::new(alpha, |split, cameras, frames| {
            let one = |c: usize, k: usize| {
                let mut f = frame(split, c, k);
                f["transform_matrix"] = opengl(c);
                f
            };
            let all: Vec<Value> = cameras.iter().flat_map(|&c| frames.iter().map(move |&k| one(c, k))).collect();
            json!({"camera_angle_x": 0.8, "frames": all})
        })
    }

    fn path(&self) -> &Path {
        self.dir.path()
    }

    fn put(&self, name: &str, text: impl AsRef<[u8]>) {
        let _ = std::fs::remove_file(self.path().join(name));
        std::fs::write(self.path().join(name), text).unwrap();
    }

    fn open(&self, options: &DataOptions) -> Result<Dataset, DataError> {
        for (name, v) in [("train", &self.train), ("val", &self.val), ("test", &self.test)] {
            self.put(&format!("transforms_{name}.json"), v.to_string().replace("\"<NaN>\"", "NaN"));
        }
        Dataset::open(self.path(), options)
    }
}

fn check_splits(d: &Dataset) {
    assert_eq!((d.layout, d.train.len(), d.val.len(), d.test.len(), d.extrapolate.len()), ("nvfi", 21, 0, 7, 4));
    assert_eq!(d.train.iter().map(|v| v.time.normalised).fold(0.0, f32::max), 0.75, "virtual times as they stand");
    assert!(d.extrapolate.iter().all(|v| v.time.normalised == 0.875));
    let mut cameras: Vec<u32> = d.extrapolate.iter().map(|v| v.camera_id).collect();
    cameras.sort_unstable();
    assert_eq!(cameras, [0, 1, 2, 3], "the future of seen and unseen cameras");
    assert!(d.test.iter().all(|v| v.camera_id == 3) && d.train.iter().all(|v| v.camera_id < 3));
    let near = |v: &View| {
        let k: usize = v.name.split(['c', '_']).nth(1).unwrap().parse().unwrap();
        (v.camera.position() - camera(k).position()).length() < 1e-9 && (v.camera.fx - camera(k).fx).abs() < 1e-9
    };
    assert!(d.train.iter().chain(&d.test).chain(&d.extrapolate).all(near));
}

#[test]
fn nested_and_flat_files_hold_the_same_scene() {
    let (nested, flat) = (Scene::nested(), Scene::flat(true));
    let (a, b) = (nested.open(&DataOptions::default()).unwrap(), flat.open(&DataOptions::default()).unwrap());
    assert_eq!(detect(nested.path()).unwrap().name, "nvfi");
    check_splits(&a);
    check_splits(&b);
    let same =
        |a: &View, b: &View| (&a.name, &a.camera, a.time, a.camera_id) == (&b.name, &b.camera, b.time, b.camera_id);
    let views = |d: &Dataset| [d.train.clone(), d.test.clone(), d.extrapolate.clone()].concat();
    assert!(views(&a).iter().zip(&views(&b)).all(|(a, b)| same(a, b)));
    assert_eq!(a.bounds, Some([Vec3::splat(-1.5), Vec3::splat(1.5)]), "objects have alpha");
    assert!(a.notes.join("\n").contains("4 cameras"), "{:?}", a.notes);
}

#[test]
fn boundaries_ranges_and_cameras_can_be_set() {
    let scene = Scene::nested();
    let with = |o: DataOptions| scene.open(&o).unwrap();
    let d = with(DataOptions { time_boundary: Some(0.5), ..Default::default() });
    assert_eq!([d.train.len(), d.test.len(), d.extrapolate.len()], [15, 5, 12]);
    // ParticleNeRF: the frame that is 1 lies before the end of the clip.
    let d = with(DataOptions { time_range: Some("0..0.75".parse().unwrap()), ..Default::default() });
    assert_eq!([d.train.len(), d.extrapolate.len()], [15, 12], "0.75 of the range by default");
    assert!((d.extrapolate.iter().map(|v| v.time.normalised).fold(0.0, f32::max) - 7.0 / 6.0).abs() < 1e-6);
    let d = with(DataOptions { test_cameras: vec![0, 3], ..Default::default() });
    assert_eq!([d.train.len(), d.test.len(), d.extrapolate.len()], [14, 14, 4]);
    let whole = with(DataOptions { time_boundary: Some(1.0), ..Default::default() });
    assert_eq!([whole.train.len(), whole.test.len(), whole.extrapolate.len()], [21, 11, 0]);
    // A folder whose training views end elsewhere states its own boundary.
    let mut short = Scene::flat(true);
    short.train["frames"].as_array_mut().unwrap().retain(|f| f["time"].as_f64().unwrap() <= 0.5);
    short.val["frames"].as_array_mut().unwrap().retain(|f| f["time"].as_f64().unwrap() <= 0.5);
    let d = short.open(&DataOptions::default()).unwrap();
    assert_eq!([d.train.len(), d.test.len(), d.extrapolate.len()], [15, 5, 4]);
}

#[test]
fn numbers_in_names_are_no_virtual_times() {
    let scene = Scene::flat(true);
    let by_name = DataOptions { time_from: TimeFrom::Name, ..Default::default() };
    let d = scene.open(&by_name).unwrap();
    assert_eq!([d.train.len(), d.test.len(), d.extrapolate.len()], [21, 11, 0]);
    assert_eq!(d.train.iter().map(|v| v.time.normalised).fold(0.0, f32::max), 1.0, "frames 0 to 6");
    let half = scene.open(&DataOptions { time_boundary: Some(0.5), ..by_name }).unwrap();
    assert_eq!([half.train.len(), half.test.len(), half.extrapolate.len()], [12, 4, 16], "of frames 0 to 7");
}

#[test]
fn intrinsics_and_lenses_of_files_cameras_and_frames_are_used() {
    let mut scene = Scene::nested();
    scene.train["k1"] = json!(0.1);
    scene.train["data"]["cam_1"]["fl_x"] = json!(7.0);
    scene.train["data"]["cam_1"]["frames"][2]["cx"] = json!(2.5);
    let d = scene.open(&DataOptions::default()).unwrap();
    let view = |name: &str| d.train.iter().find(|v| v.name == name).unwrap();
    assert!(d.train.iter().all(|v| v.lens.is_some_and(|lens| lens.k1 == 0.1)));
    assert!(d.extrapolate.iter().all(|v| v.lens.is_none()), "of another file");
    let own = &view("c1_02").camera;
    assert_eq!((own.fx, own.fy, own.cx, view("c1_03").camera.cx), (7.0, 7.0, 2.5, 3.0));
    assert!((view("c0_02").camera.fx - camera(0).fx).abs() < 1e-9);
    assert!(d.notes.iter().any(|n| n.contains("21 views are resampled to a pinhole")), "{:?}", d.notes);
}

#[test]
fn a_flat_folder_is_told_by_its_future_or_by_its_maker() {
    let mut scene = Scene::flat(true);
    let last = scene.train["frames"].as_array_mut().unwrap().last_mut().unwrap();
    last["time"] = json!(1.0);
    assert_eq!(scene.open(&DataOptions::default()).unwrap().layout, "blender", "training views reach the end: D-NeRF");
    scene.put("scene.toml", "[time]\nboundary = 0.75\n");
    let d = scene.open(&DataOptions::default()).unwrap();
    assert_eq!((d.layout, d.train.len(), d.extrapolate.len()), ("nvfi", 20, 5));
    scene.put("scene.toml", "");
    assert_eq!(scene.open(&DataOptions::default()).unwrap().layout, "blender");
    let asked = DataOptions { layout: Some("nvfi".into()), ..Default::default() };
    assert_eq!(scene.open(&asked).unwrap().extrapolate.len(), 5);
}

#[test]
fn rooms_have_no_alpha_and_hold_their_cameras() {
    let mut scene = Scene::flat(false);
    let d = scene.open(&DataOptions::default()).unwrap();
    assert!(!d.has_alpha);
    assert_eq!(d.bounds, Some([Vec3::new(-3.03, -3.03, -0.03), Vec3::new(3.03, 3.03, 6.03)]));
    for frame in scene.train["frames"].as_array_mut().unwrap() {
        frame["transform_matrix"][2][3] = json!(9.0);
    }
    let d = scene.open(&DataOptions::default()).unwrap();
    let [low, high] = d.bounds.unwrap();
    assert!(high != Vec3::new(3.03, 3.03, 6.03) && (high - low).min_element() > 1.0, "around the rig: {low} {high}");
}

/// A labelled folder: every camera, frames 0 to 7.
fn labelled() -> Scene {
    let scene = Scene::nested();
    let mut frames = Vec::new();
    for (split, cameras, times) in [("train", &TRAIN[..], 0..7), ("test", &[0, 1, 2][..], 7..8)] {
        for &c in cameras {
            for k in times.clone() {
                let name = format!("{split}/c{c}_{k:02}");
                let map = vec![k as f32; (SIZE * SIZE) as usize];
                let mut bytes = Vec::new();
                gs_core::io::npy::write(&[SIZE as usize; 2], &map, &mut bytes).unwrap();
                std::fs::create_dir_all(scene.path().join("segm")).unwrap();
                scene.put(&format!("segm/{c}_{k}.npy"), bytes);
                frames.push(json!({"img_path": name, "segm_path": format!("segm/{c}_{k}"), "time": time(k),
                    "transform_matrix": opengl(c)}));
            }
        }
    }
    scene.put("transforms.json", json!({"camera_angle_x": 0.8, "frames": frames}).to_string());
    scene
}

#[test]
fn label_maps_belong_to_their_pictures() {
    let scene = labelled();
    assert_eq!(detect(scene.path()).unwrap().name, "nvfi");
    let d = Dataset::open(scene.path(), &DataOptions::default()).unwrap();
    assert_eq!([d.train.len(), d.test.len(), d.extrapolate.len()], [21, 0, 3]);
    for v in d.train.iter().chain(&d.extrapolate) {
        let frame = (v.time.normalised * FRAMES as f32).round() as usize;
        let labels = v.labels.as_ref().unwrap();
        assert!(labels.ends_with(format!("segm/{}_{frame}.npy", v.camera_id)), "{}", labels.display());
    }
    let faults: [(&str, Value, &str, &str); 4] = [
        (
            "segm_path",
            json!("segm/none"),
            "data.field",
            "frames[2].segm_path is \"segm/none.npy\", which does not exist",
        ),
        ("segm_path", json!("../../x"), "data.escape", "../../x"),
        ("segm_path", json!(3), "data.field", "frames[2].segm_path is 3"),
        ("img_path", Value::Null, "data.field", "frames[2].img_path is missing"),
    ];
    let good = std::fs::read_to_string(scene.path().join("transforms.json")).unwrap();
    for (key, value, code, text) in faults {
        let mut file: Value = serde_json::from_str(&good).unwrap();
        file["frames"][2][key] = value;
        scene.put("transforms.json", file.to_string());
        let e = Dataset::open(scene.path(), &DataOptions::default()).unwrap_err();
        assert!(e.code() == code && e.to_string().contains(text), "{text}: {} {e}", e.code());
    }
}

#[test]
fn every_fault_is_named() {
    type Edit = fn(&mut Scene);
    let edits: [(Edit, &str, &str); 18] = [
        (|s| s.train["data"] = json!({}), "data.empty", "transforms_train.json gives no training view"),
        (|s| s.val["data"] = json!([1, 2]), "data.field", "data is"),
        (|s| s.train["data"]["cam_1"] = json!(7), "data.field", "data.cam_1 is 7"),
        (|s| s.train["data"]["cam_1"]["frames"] = json!({"0": 1}), "data.field", "data.cam_1.frames is"),
        (|s| s.train["data"]["cam_1"]["frames"][2] = json!([1]), "data.field", "data.cam_1.frames[2] is [1]"),
        (
            |s| s.train["data"]["cam_1"]["frames"][2]["time"] = json!("x"),
            "data.field",
            "data.cam_1.frames[2].time is \"x\"",
        ),
        (|s| s.train["data"]["cam_1"]["frames"][2]["time"] = json!("<NaN>"), "data.field", "frames[2].time is NaN"),
        (|s| s.train["data"]["cam_1"]["frames"][2]["time"] = Value::Null, "data.field", "frames[2].time is missing"),
        (|s| s.train["data"]["cam_1"]["frames"][2]["time"] = json!(1.5), "data.time", "has time 1.5"),
        (|s| s.train["data"]["cam_1"]["frames"][2]["file_path"] = json!(1), "data.field", "frames[2].file_path is 1"),
        (
            |s| s.train["data"]["cam_1"]["frames"][2]["file_path"] = json!("../../etc/passwd"),
            "data.escape",
            "../../etc/passwd",
        ),
        (|s| s.train["data"]["cam_1"]["frames"][2]["file_path"] = json!("no"), "data.missing", "1 of 21 images"),
        (
            |s| s.train["data"]["cam_1"]["transform_matrix"][1][3] = json!("<NaN>"),
            "data.field",
            "transform_matrix[1][3]",
        ),
        (|s| s.train["data"]["cam_1"]["transform_matrix"][1][1] = json!(9.0), "data.pose", "has no rotation"),
        (
            |s| drop(s.test["data"]["cam_0"].as_object_mut().unwrap().remove("transform_matrix")),
            "data.field",
            "data.cam_0.transform_matrix is missing",
        ),
        (|s| s.test["camera_angle_x"] = json!(4), "data.field", "camera_angle_x is 4"),
        (
            |s| drop(s.test.as_object_mut().unwrap().remove("camera_angle_x")),
            "data.field",
            "data.cam_0.frames[0] is without focal length",
        ),
        (|s| s.test["data"]["cam_0"]["transform_matrix"] = json!(1), "data.field", "transform_matrix is 1"),
    ];
    for (edit, code, text) in edits {
        let mut scene = Scene::nested();
        edit(&mut scene);
        let e = scene.open(&DataOptions::default()).unwrap_err();
        assert!(e.code() == code && e.to_string().contains(text), "{text}: {} {e}", e.code());
        assert!(e.report().contains("\n  do   "), "{}", e.report());
    }
    let twice = Scene::nested();
    twice.open(&DataOptions::default()).unwrap();
    twice.put("transforms_train.json", r#"{"camera_angle_x": 0.8, "data": {"a": {}, "a": {}}}"#);
    let e = Dataset::open(twice.path(), &DataOptions::default()).unwrap_err();
    assert!(e.to_string().contains("camera \"a\" appears twice"), "{e}");
}

/// Any byte changed gives a data set or a typed error, nested and flat.
#[test]
fn mutated_files_give_data_or_an_error() {
    for scene in [Scene::nested(), Scene::flat(true)] {
        scene.open(&DataOptions::default()).unwrap();
        let whole = std::fs::read(scene.path().join("transforms_train.json")).unwrap();
        let mut outcomes = [0, 0];
        for k in 0..600u64 {
            let mut rng = Rng::new(5, "mutate.nvfi", 0, k);
            let mut bytes = whole.clone();
            let at = rng.below(bytes.len() as u32) as usize;
            match rng.below(8) {
                0..4 => bytes[at] = rng.bits() as u8,
                4..7 => drop(bytes.remove(at)),
                _ => bytes.truncate(at),
            }
            scene.put("transforms_train.json", bytes);
            match Dataset::open(scene.path(), &DataOptions::default()) {
                Ok(d) => {
                    outcomes[0] += 1;
                    let all = d.train.iter().chain(&d.test).chain(&d.extrapolate);
                    assert!(all.clone().all(|v| v.camera.check().is_ok() && v.time.normalised.is_finite()));
                }
                Err(e) => {
                    outcomes[1] += 1;
                    assert!(e.report().contains("\n  do   "), "{e}");
                }
            }
        }
        assert!(outcomes[0] > 20 && outcomes[1] > 100, "both happen: {outcomes:?}");
    }
}
