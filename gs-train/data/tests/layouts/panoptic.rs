//! The reader of PanopticSports clips on folders written here: geometry against the format's own formula, masks, splits,
//! times, and every fault it names.

use std::path::Path;

use glam::{DMat3, DQuat, DVec2, DVec3, EulerRot, Vec3};
use gs_data::{DataError, DataOptions, Dataset, ImageCache, ImageSource, detect};
use serde_json::{Value, json};
use tempfile::TempDir;

const FRAMES: usize = 5;
const SIZE: [u32; 2] = [40, 24];
/// Cameras 1, 2, 4 train and have masks; 7 is held out and has none.
const TRAIN: [u32; 3] = [1, 2, 4];
const TEST: [u32; 1] = [7];

struct Clip {
    dir: TempDir,
    train: Value,
    test: Value,
}

/// Calibration of a camera, its rotation to the camera and its centre.
fn rig(camera: u32) -> ([[f64; 3]; 3], DMat3, DVec3) {
    let a = f64::from(camera);
    let r = DMat3::from_quat(DQuat::from_euler(EulerRot::XYZ, 0.1 * a, 0.5 * a, -0.05));
    // Three metres in front of every camera lies the centre of the dome.
    let centre = DVec3::new(0.2, -1.3, 0.1) - r.transpose() * DVec3::new(0.0, 0.0, 3.0);
    ([[30.0 + a, 0.4 * a, 18.5], [0.0, 31.0, 13.25], [0.0, 0.0, 1.0]], r, centre)
}

fn w2c(camera: u32) -> [[f64; 4]; 4] {
    let (_, r, c) = rig(camera);
    let t = -(r * c);
    let row = |i: usize| [r.x_axis[i], r.y_axis[i], r.z_axis[i], t[i]];
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

fn meta(cameras: &[u32]) -> Value {
    let table = |cell: &dyn Fn(usize, u32) -> Value| -> Value {
        (0..FRAMES).map(|t| cameras.iter().map(|&c| cell(t, c)).collect::<Value>()).collect()
    };
    json!({
        "w": SIZE[0], "h": SIZE[1],
        "k": table(&|_, c| json!(rig(c).0)),
        "w2c": table(&|_, c| json!(w2c(c))),
        "fn": table(&|t, c| json!(format!("{c}/{:06}.jpg", t + 40))),
        "cam_id": table(&|_, c| json!(c)),
    })
}

impl Clip {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        for c in TRAIN.into_iter().chain(TEST) {
            std::fs::create_dir_all(dir.path().join(format!("ims/{c}"))).unwrap();
            std::fs::create_dir_all(dir.path().join(format!("seg/{c}"))).unwrap();
            for t in 40..40 + FRAMES {
                let grey = image::RgbImage::from_pixel(SIZE[0], SIZE[1], image::Rgb([c as u8 * 20; 3]));
                grey.save(dir.path().join(format!("ims/{c}/{t:06}.jpg"))).unwrap();
                let left = |x: u32, _| image::Luma([if x < SIZE[0] / 2 { 255u8 } else { 0 }]);
                if TRAIN.contains(&c) {
                    let file = dir.path().join(format!("seg/{c}/{t:06}.png"));
                    image::GrayImage::from_fn(SIZE[0], SIZE[1], left).save(file).unwrap();
                }
            }
        }
        Self { dir, train: meta(&TRAIN), test: meta(&TEST) }
    }

    fn path(&self) -> &Path {
        self.dir.path()
    }

    fn open(&self, options: &DataOptions) -> Result<Dataset, DataError> {
        let put = |name: &str, v: &Value| {
            let file = self.path().join(name);
            let _ = std::fs::remove_file(&file);
            std::fs::write(file, v.to_string().replace("\"<NaN>\"", "NaN")).unwrap();
        };
        put("train_meta.json", &self.train);
        put("test_meta.json", &self.test);
        Dataset::open(self.path(), options)
    }
}

#[test]
fn cameras_see_what_the_format_says() {
    let clip = Clip::new();
    let d = clip.open(&DataOptions::default()).unwrap();
    assert_eq!(
        (detect(clip.path()).unwrap().name, d.layout, d.has_alpha, d.dynamic),
        ("panoptic", "panoptic", false, true)
    );
    assert_eq!((d.train.len(), d.test.len(), d.val.len()), (15, 5, 0));
    for v in d.train.iter().chain(&d.test) {
        let (k, r, centre) = rig(v.camera_id);
        assert!(v.name.starts_with(&format!("{}_0000", v.camera_id)), "{}", v.name);
        for step in 0..10 {
            let s = f64::from(step);
            let ray = DVec3::new(0.5 * (s * 0.7).sin(), 0.4 * (s * 1.3).cos(), 1.0) * (1.0 + s);
            let world = centre + r.transpose() * ray;
            let (x, y) = (ray.x / ray.z, ray.y / ray.z);
            let want = DVec2::new(k[0][0] * x + k[0][1] * y + k[0][2], k[1][1] * y + k[1][2]);
            let pinhole = v.camera.to_pixel(v.camera.to_camera(world));
            let seen = v.lens.unwrap().source_pixel(&v.camera, pinhole);
            assert!((seen - want).length() < 1e-9, "{}: {seen} {want}", v.name);
        }
    }
    let [low, high] = d.bounds.unwrap();
    assert!((0.5 * (low + high) - Vec3::new(0.2, -1.3, 0.1)).length() < 1e-5, "the dome is where all look");
    assert!((high - low - Vec3::splat(6.6)).length() < 1e-4, "{low} {high}");
    let notes = d.notes.join("\n");
    for part in ["background is black", "15 of 20 views have a mask", "30 seconds", "points in the dome"] {
        assert!(notes.contains(part), "{part}: {notes}");
    }
}

#[test]
fn frames_are_seconds_and_the_training_span_is_zero_to_one() {
    let clip = Clip::new();
    let d = clip.open(&DataOptions::default()).unwrap();
    for (t, views) in d.train.chunks(3).enumerate() {
        assert!(
            views
                .iter()
                .all(|v| v.time.normalised == t as f32 / 4.0 && (v.time.seconds - t as f64 / 30.0).abs() < 1e-12)
        );
    }
    assert_eq!(d.test[4].time.normalised, 1.0);
    let slow = DataOptions { fps: Some(10.0), time_range: Some("0..0.5".parse().unwrap()), ..Default::default() };
    let d = clip.open(&slow).unwrap();
    assert!((d.train[14].time.normalised - 0.8).abs() < 1e-6 && (d.train[14].time.seconds - 0.4).abs() < 1e-12);
    let some = DataOptions { first_frame: 1, frame_count: 4, frame_step: 2, cameras: vec![1, 7], ..Default::default() };
    let d = clip.open(&some).unwrap();
    assert_eq!(d.train.iter().map(|v| v.name.as_str()).collect::<Vec<_>>(), ["1_000041", "1_000043"]);
    assert_eq!((d.test.len(), d.train[1].time.normalised), (2, 1.0));
}

#[test]
fn a_boundary_keeps_the_future_of_every_camera() {
    let clip = Clip::new();
    let half = DataOptions { time_boundary: Some(0.5), ..Default::default() };
    let d = clip.open(&half).unwrap();
    assert_eq!([d.train.len(), d.test.len(), d.extrapolate.len()], [9, 3, 8]);
    assert_eq!(d.train[8].time.normalised, 0.5);
    let seen =
        |c: u32| d.extrapolate.iter().filter(|v| v.camera_id == c).map(|v| v.time.normalised).collect::<Vec<_>>();
    for camera in TRAIN.into_iter().chain(TEST) {
        assert_eq!(seen(camera), [0.75, 1.0]);
    }
    assert!(d.extrapolate.iter().any(|v| v.mask.is_some()), "masked scores work there, too");
    std::fs::write(clip.path().join("scene.toml"), "[time]\nboundary = 0.8\n").unwrap();
    assert_eq!(clip.open(&DataOptions::default()).unwrap().extrapolate.len(), 4);
    assert_eq!(clip.open(&half).unwrap().extrapolate.len(), 8, "what the user sets wins");
    std::fs::write(clip.path().join("scene.toml"), "[time]\nboundry = 0.8\n").unwrap();
    let e = clip.open(&half).unwrap_err();
    assert!(e.code() == "data.syntax" && e.report().contains("boundry"), "{}", e.report());
}

#[test]
fn masks_belong_to_their_pictures_and_cameras_can_be_held_out() {
    let clip = Clip::new();
    let d = clip.open(&DataOptions { test_cameras: vec![2], scale: 0.5, ..Default::default() }).unwrap();
    assert_eq!((d.train.len(), d.test.len()), (15, 5), "camera 7 trains, camera 2 does not");
    assert!(d.test.iter().all(|v| v.camera_id == 2 && v.mask.is_some()));
    let cache = ImageCache::new(0, 1.0);
    for v in d.train.iter().chain(&d.test) {
        let mask = cache.mask(v).unwrap();
        assert_eq!(mask.is_some(), v.camera_id != 7);
        if let (Some(mask), Some(ImageSource::File(file))) = (mask, &v.mask) {
            assert!(file.starts_with(clip.path().join(format!("seg/{}", v.camera_id))), "{}", file.display());
            assert_eq!((mask.shape(), cache.get(v).unwrap().width), ((20, 12, 1), 20));
            // The sensor leans by less than a pixel.
            assert!(mask.pixel(8, 6)[0] == 1.0 && mask.pixel(12, 6)[0] == 0.0);
        }
    }
}

#[test]
fn only_what_masks_show_is_left_when_asked() {
    let clip = Clip::new();
    let d = clip.open(&DataOptions { cut_out: true, scale: 0.5, ..Default::default() }).unwrap();
    let all = clip.open(&DataOptions::default()).unwrap();
    let masked = |views: &[gs_data::View]| views.iter().filter(|v| v.mask.is_some()).count();
    assert!(masked(&all.test) < all.test.len(), "camera 7 has no masks");
    assert_eq!((d.train.len(), d.test.len()), (masked(&all.train), masked(&all.test)));
    assert!(d.notes.iter().any(|n| n.contains("5 views without a mask are left out")), "{:?}", d.notes);
    let image = ImageCache::new(0, 1.0).get(&d.train[0]).unwrap();
    assert!(image.pixel(8, 6)[3] == 255 && image.pixel(12, 6)[3] == 0);
    std::fs::remove_dir_all(clip.path().join("seg")).unwrap();
    let e = clip.open(&DataOptions { cut_out: true, ..Default::default() }).unwrap_err();
    assert!(e.to_string().contains("data.cut_out"), "{e}");
}

#[test]
fn points_come_from_arrays() {
    let clip = Clip::new();
    let row = [1.0f32, 2.0, 3.0, 1.0, 0.5, 2.0, 1.0];
    let mut bytes = Vec::new();
    gs_core::io::npy::write(&[2, 7], &[row, row].concat(), &mut bytes).unwrap();
    std::fs::write(clip.path().join("init_pt_cld.npy"), &bytes).unwrap();
    let d = clip.open(&DataOptions::default()).unwrap();
    let points = d.points.unwrap();
    assert_eq!((points.positions[1], points.colors[1]), (Vec3::new(1.0, 2.0, 3.0), [1.0, 0.5, 1.0]));
    assert!(d.bounds.is_none() && d.notes.iter().any(|n| n.contains("init_pt_cld.npy: 2")), "{:?}", d.notes);
    std::fs::write(clip.path().join("init_pt_cld.npz"), &bytes).unwrap();
    let e = clip.open(&DataOptions::default()).unwrap_err();
    assert!(e.code() == "data.syntax" && e.to_string().contains("no ZIP archive"), "{e}");
}

fn fault(change: impl FnOnce(&mut Clip)) -> DataError {
    let mut clip = Clip::new();
    clip.open(&DataOptions::default()).expect("without the change it opens");
    change(&mut clip);
    clip.open(&DataOptions::default()).unwrap_err()
}

#[test]
fn every_fault_is_named() {
    type Edit = fn(&mut Clip);
    let edits: [(Edit, &str, &str); 16] = [
        (|c| c.train["k"][2][1][0][2] = json!("<NaN>"), "data.field", "k[2][1][0][2] is NaN"),
        (|c| c.train["k"][2][1] = json!([[1, 0, 2], [0, 1, 2], [0, 0, 2]]), "data.field", "k[2][1] is"),
        (|c| c.train["k"][2][1] = json!([[-1, 0, 2], [0, 1, 2], [0, 0, 1]]), "data.field", "k[2][1] is"),
        (|c| c.train["w2c"][0][2][1][3] = json!("<NaN>"), "data.field", "w2c[0][2][1][3] is NaN"),
        (|c| c.train["w2c"][0][2][0][0] = json!(7.0), "data.pose", "w2c[0][2] has no rotation"),
        (|c| drop(c.train["w2c"][3].as_array_mut().unwrap().pop()), "data.field", "w2c[3] is 2 cameras long, k is 3"),
        (|c| drop(c.train["fn"].as_array_mut().unwrap().pop()), "data.field", "fn is 4 frames long, k is 5"),
        (|c| c.train["fn"] = json!("ims"), "data.field", "fn is "),
        (|c| c.train["fn"][0] = json!(7), "data.field", "fn[0] is 7"),
        (|c| c.train["fn"][0][0] = json!(7), "data.field", "fn[0][0] is 7"),
        (|c| c.train["fn"][0][0] = json!("../../x.jpg"), "data.escape", "../../x.jpg"),
        (|c| c.train["fn"][0][0] = json!("1/9.jpg"), "data.missing", "1 of 15 images are missing: ims/1/9.jpg"),
        (|c| c.train["cam_id"][1][0] = json!(1.5), "data.field", "cam_id[1][0] is 1.5"),
        (|c| drop(c.train.as_object_mut().unwrap().remove("w2c")), "data.field", "w2c is missing"),
        (|c| c.train["w"] = json!("wide"), "data.field", "w is \"wide\""),
        (|c| c.train["h"] = json!(300), "data.image_size", "its camera is 40x300"),
    ];
    for (edit, code, text) in edits {
        let e = fault(edit);
        assert!(e.code() == code && e.to_string().contains(text), "{text}: {} {e}", e.code());
        assert!(e.place().is_some_and(|p| !p.file.as_os_str().is_empty()), "{e}");
    }
    let e = fault(|c| {
        let file = c.path().join("seg/2/000041.png");
        image::GrayImage::new(9, 9).save(file).unwrap();
    });
    assert!(e.code() == "data.image_size" && e.to_string().contains("000041.png is 9x9"), "{e}");
    let e = fault(|c| c.train = json!([]));
    assert_eq!(e.code(), "data.syntax", "{e}");
    let empty = json!({"w": 4, "h": 4, "k": [], "w2c": [], "fn": [], "cam_id": []});
    assert_eq!(fault(|c| c.train = empty).code(), "data.empty");
}

/// Any byte changed gives a data set or a typed error.
#[test]
fn mutated_lists_give_data_or_an_error() {
    let clip = Clip::new();
    clip.open(&DataOptions::default()).unwrap();
    let file = clip.path().join("train_meta.json");
    let whole = std::fs::read(&file).unwrap();
    let mut outcomes = [0, 0];
    for k in 0..400u64 {
        let mut rng = gs_core::Rng::new(5, "mutate.panoptic", 0, k);
        let mut bytes = whole.clone();
        let at = rng.below(bytes.len() as u32) as usize;
        match rng.below(3) {
            0 => bytes[at] = rng.bits() as u8,
            1 => drop(bytes.remove(at)),
            _ => bytes.truncate(at),
        }
        std::fs::remove_file(&file).unwrap();
        std::fs::write(&file, bytes).unwrap();
        match Dataset::open(clip.path(), &DataOptions::default()) {
            Ok(d) => {
                outcomes[0] += 1;
                assert!(d.train.iter().all(|v| v.camera.check().is_ok()));
            }
            Err(e) => {
                outcomes[1] += 1;
                assert!(e.report().contains("\n  do   "), "{e}");
            }
        }
    }
    assert!(outcomes[0] > 20 && outcomes[1] > 100, "both happen: {outcomes:?}");
}
