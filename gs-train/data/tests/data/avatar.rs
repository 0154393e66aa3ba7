//! Films of people: what the generator makes, what the layout `avatar` reads of it, and every fault it names.

use gs_core::io::Limits;
use gs_data::avatar::AvatarScene;
use gs_data::{DataError, DataOptions, Dataset, ImageCache, ImageSource, ImageU8, TimeFrom, View, detect};
use gs_synth::avatar::{AvatarOptions, Morphs, generate, write};
use gs_texel::maps_exr::load_layers;
use gs_texel::surface::Topology;
use gs_texel::surface_loss::{Chamfer, Colors};
use gs_texel::zbuffer::DepthMap;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use tempfile::TempDir;

fn small() -> AvatarOptions {
    AvatarOptions { per_ring: 8, rings: 2, frames: 5, size: 40, points: 400, ..AvatarOptions::default() }
}

/// A film that several tests look at.
fn film() -> &'static Dataset {
    static FILM: OnceLock<Dataset> = OnceLock::new();
    FILM.get_or_init(|| generate(&AvatarOptions { size: 96, ..small() }).unwrap())
}

fn scene(data: &Dataset) -> &AvatarScene {
    data.avatar.as_ref().unwrap()
}

fn pixels(view: &View) -> Arc<ImageU8> {
    ImageCache::new(0, 1.0).get(view).unwrap()
}

fn open(dir: &Path) -> Result<Dataset, DataError> {
    Dataset::open(dir, &DataOptions::default())
}

#[test]
fn roles_make_views_and_inputs() {
    let data = film();
    // Ring 0: 4 conditioning, 4 test cameras; ring 1: 8 that train.
    assert_eq!([data.train.len(), data.val.len(), data.test.len(), data.extrapolate.len()], [12 * 5, 0, 4 * 5, 0]);
    assert!(data.has_alpha && data.dynamic);
    let s = scene(data);
    assert_eq!((s.frames.len(), s.input_count(), s.fps), (5, 4, 5.0));
    let times: Vec<f32> = s.frames.iter().map(|f| f.time.normalised).collect();
    assert_eq!(times, [0.0, 0.25, 0.5, 0.75, 1.0]);
    for frame in &s.frames {
        assert_eq!(frame.inputs.iter().map(|v| v.camera_id).collect::<Vec<_>>(), [0, 2, 4, 6]);
        for input in &frame.inputs {
            assert_eq!(input.time, frame.time);
            assert!(data.train.contains(input), "inputs train, too");
        }
    }
    assert!(data.test.iter().all(|v| [1, 3, 5, 7].contains(&v.camera_id)));
    let points = data.points.as_ref().unwrap();
    let [low, high] = data.bounds.unwrap();
    assert_eq!((points.positions.len(), points.colors.len()), (20_000, 20_000));
    assert!(points.positions.iter().all(|p| p.cmpge(low).all() && p.cmple(high).all()));
    assert!((1.6..2.2).contains(&(high.y - low.y)), "a person of 1.75 m: {}", high.y - low.y);
}

#[test]
fn the_surface_is_where_the_pictures_show_it() {
    let data = film();
    for view in data.train.iter().step_by(7).chain(data.test.iter().step_by(3)) {
        let frame = scene(data).frame_at(view.time);
        let image = pixels(view);
        let (w, h) = (image.width as i64, image.height as i64);
        let alpha = |x: i64, y: i64| {
            if (0..w).contains(&x) && (0..h).contains(&y) { image.pixel(x as usize, y as usize)[3] } else { 0 }
        };
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in scene(data).true_surface(frame) {
            let at = view.camera.to_pixel(view.camera.to_camera(p.as_dvec3()));
            let (x, y) = (at.x.floor() as i64, at.y.floor() as i64);
            let near = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))).map(|(dx, dy)| alpha(x + dx, y + dy));
            assert!(near.max() > Some(0), "{} at {at} shows nothing", view.name);
            low = [low[0].min(at.x), low[1].min(at.y)];
            high = [high[0].max(at.x), high[1].max(at.y)];
        }
        // And nothing is shown where there is no surface.
        for (y, x) in (0..h).flat_map(|y| (0..w).map(move |x| (y, x))) {
            let (fx, fy) = (x as f64, y as f64);
            let outside = fx + 1.0 < low[0] || fx > high[0] || fy + 1.0 < low[1] || fy > high[1];
            assert!(!outside || alpha(x, y) == 0, "{} shows something at {x}, {y}", view.name);
            assert!(alpha(x, y) > 0 || image.pixel(x as usize, y as usize) == [0; 4], "colour is zero outside");
        }
    }
}

#[test]
fn a_film_depends_on_its_options_alone() {
    let options = AvatarOptions { per_ring: 4, rings: 1, frames: 2, ..small() };
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| generate(&options).unwrap())
    };
    let one = with(1);
    assert!(one == with(3));
    assert!(one != generate(&AvatarOptions { seed: 1, ..options.clone() }).unwrap(), "the points have a seed");
}

#[test]
fn more_samples_change_only_borders_and_texture() {
    let with = |supersample| {
        generate(&AvatarOptions { per_ring: 4, rings: 1, frames: 1, size: 96, supersample, ..small() }).unwrap()
    };
    let (usual, dense) = (with(4), with(16));
    let (mut alpha, mut colour, mut inside) = (0.0, 0.0f64, 0);
    for (a, b) in usual.train.iter().zip(&dense.train) {
        for (p, q) in pixels(a).data.chunks_exact(4).zip(pixels(b).data.chunks_exact(4)) {
            alpha = f64::max(alpha, (f64::from(p[3]) - f64::from(q[3])).abs() / 255.0);
            if p[3] == 255 && q[3] == 255 {
                inside += 1;
                colour += (0..3).map(|c| f64::from(p[c]) - f64::from(q[c])).map(|d| d * d).sum::<f64>() / 3.0;
            }
        }
    }
    let rmse = (colour / f64::from(inside)).sqrt() / 255.0;
    println!("4x4 against 16x16 samples: alpha off by at most {alpha:.3}, colour by {rmse:.5} (root mean square)");
    assert!(alpha < 0.25 && rmse < 0.01, "{alpha} {rmse}");
}

#[test]
fn morphs_are_shown_known_or_left_out() {
    let with = |morph| generate(&AvatarOptions { per_ring: 4, rings: 1, morph, ..small() }).unwrap();
    let [gt, apply, ignore] = [Morphs::Gt, Morphs::Apply, Morphs::Ignore].map(with);
    let largest = |data: &Dataset, k: usize| {
        let s = scene(data);
        let offsets = s.true_offsets(&s.frames[k]).unwrap();
        offsets.iter().map(|d| d.length()).fold(0.0, f32::max)
    };
    assert!(largest(&gt, 2) > 0.015, "{}", largest(&gt, 2));
    assert_eq!((largest(&apply, 2), largest(&ignore, 2)), (0.0, 0.0));
    let surface = |data: &Dataset| scene(data).true_surface(&scene(data).frames[2]);
    assert_eq!(surface(&gt), surface(&apply));
    assert_ne!(surface(&gt), surface(&ignore));
    let (s, t) = (scene(&gt), scene(&ignore));
    assert_eq!(s.posed(&s.frames[2]), t.posed(&t.frames[2]), "what is known is the same");
    assert_eq!(pixels(&gt.train[2]), pixels(&apply.train[2]));
    assert_ne!(pixels(&gt.train[2]), pixels(&ignore.train[2]));
}

#[test]
fn morphs_act_one_by_one() {
    let with = |names: &[&str]| {
        let only_morphs = names.iter().map(|n| n.to_string()).collect();
        generate(&AvatarOptions { per_ring: 4, rings: 1, only_morphs, ..small() }).unwrap()
    };
    let films = [with(&[]), with(&["breathe"]), with(&["swing"]), with(&["swing", "breathe"])];
    let [all, breathe, swing, both] = films.each_ref().map(|f| scene(f).frames[1].true_morphs.clone().unwrap());
    assert!(all.iter().all(|w| w.abs() > 0.1), "{all:?}");
    assert_eq!((breathe, swing, both), (vec![all[0], 0.0], vec![0.0, all[1]], all));
}

#[test]
fn a_template_that_is_not_in_metres_is_named() {
    let noted = |template: &str| {
        let options = AvatarOptions { template: template.into(), per_ring: 4, rings: 1, frames: 1, ..small() };
        generate(&options).unwrap().notes.iter().any(|n| n.contains("a unit is taken for a metre"))
    };
    assert!(!noted("builtin:person"));
    let Some(folder) = gs_core::testkit::shared("data/gltf_public") else { return };
    assert!(noted(folder.join("Fox.glb").to_str().unwrap()));
    assert!(!noted(folder.join("CesiumMan.glb").to_str().unwrap()));
}

#[test]
fn points_lie_on_the_true_surface() {
    let s = scene(film());
    let frame = &s.frames[2];
    let points = frame.points.as_ref().unwrap().read().unwrap();
    assert_eq!(points.positions.len(), 400);
    let (surface, faces) = (s.true_surface(frame), &s.character.template.faces);
    for p in points.positions.iter().step_by(20) {
        let off = |f: &[u32; 3]| {
            let [a, b, c] = f.map(|v| surface[v as usize]);
            let n = (b - a).cross(c - a).normalize_or_zero();
            let centre = (a + b + c) / 3.0;
            let reach = [a, b, c].iter().map(|q| q.distance(centre)).fold(0.0, f32::max);
            if p.distance(centre) <= reach + 1e-5 { (*p - a).dot(n).abs() } else { f32::INFINITY }
        };
        assert!(faces.iter().map(off).fold(f32::INFINITY, f32::min) < 1e-5);
    }
    // They have the colours of the surface there.
    let colors = points.colors.as_ref().unwrap();
    let topology = Topology::new(faces, surface.len()).unwrap();
    let chamfer = Chamfer::new(&points.positions).unwrap();
    let away = |points: &[[f32; 3]]| {
        let colors = Colors { paint: &s.character.template, points, weight: 0.05 };
        chamfer.evaluate_faces(&surface, faces, &topology, Some(&colors)).unwrap().value
    };
    assert!(away(colors) < 1e-5 && away(&[[0.5; 3]; 400]) > 1e-3, "{} {}", away(colors), away(&[[0.5; 3]; 400]));
}

/// Whether a film read back is the one in memory: everything exactly but cameras, whose files go through decimal matrices
/// and the nearest rotation.
fn assert_same(read: &Dataset, made: &Dataset) {
    let near = |a: &View, b: &View| {
        let (p, q) = (&a.camera, &b.camera);
        let numbers = [p.fx - q.fx, p.fy - q.fy, p.cx - q.cx, p.cy - q.cy];
        assert!(numbers.iter().all(|d| d.abs() < 1e-9), "{}", a.name);
        assert!(p.viewmat().abs_diff_eq(q.viewmat(), 1e-12), "{}", a.name);
        assert_eq!((&a.name, a.time, a.camera_id, a.lens), (&b.name, b.time, b.camera_id, b.lens));
        assert_eq!(pixels(a), pixels(b));
    };
    for (a, b) in [(&read.train, &made.train), (&read.test, &made.test), (&read.extrapolate, &made.extrapolate)] {
        assert_eq!(a.len(), b.len());
        a.iter().zip(b).for_each(|(a, b)| near(a, b));
    }
    assert_eq!((&read.points, read.bounds, read.has_alpha), (&made.points, made.bounds, made.has_alpha));
    let (r, m) = (scene(read), scene(made));
    assert!(r.character == m.character && r.skinning == m.skinning && r.fps == m.fps);
    assert_eq!(r.frames.len(), m.frames.len());
    for (a, b) in r.frames.iter().zip(&m.frames) {
        assert_eq!((a.number, a.time, &a.pose, &a.true_morphs), (b.number, b.time, &b.pose, &b.true_morphs));
        a.inputs.iter().zip(&b.inputs).for_each(|(a, b)| near(a, b));
        let points = |f: &gs_data::avatar::AvatarFrame| f.points.as_ref().unwrap().read().unwrap();
        assert_eq!(points(a), points(b));
    }
}

#[test]
fn what_is_written_is_read_back() {
    let cases = [
        AvatarOptions { test_every: 3, ..small() },
        AvatarOptions { clip: Some("wave".into()), fps: Some(12.5), morph: Morphs::Apply, per_ring: 4, ..small() },
        AvatarOptions { template: "builtin:cylinder".into(), clip: Some("twist".into()), rings: 1, ..small() },
        AvatarOptions { template: "builtin:sphere".into(), frames: 1, rings: 1, per_ring: 4, ..small() },
    ];
    for options in cases {
        let dir = tempfile::tempdir().unwrap();
        let made = write(dir.path(), &options, false, false).unwrap();
        assert_eq!(detect(dir.path()).unwrap().name, "avatar");
        let read = open(dir.path()).unwrap();
        assert_same(&read, &made);
        assert!(made == generate(&options).unwrap());
        let e = write(dir.path(), &options, false, false).unwrap_err();
        assert_eq!(e.code(), "io.exists");
    }
}

#[test]
fn test_frames_are_held_out() {
    let data = generate(&AvatarOptions { per_ring: 4, frames: 8, test_every: 4, ..small() }).unwrap();
    // Frames 2 and 6 of 8 are for tests; cameras: 4 cond, 2 train, 2 test.
    assert_eq!((data.train.len(), data.test.len()), (6 * 6, 2 * 8));
    assert_eq!(scene(&data).frames.len(), 8, "inputs of test frames are there");
    let test = data.test.iter().find(|v| v.name.ends_with("f000006")).unwrap();
    assert_eq!(scene(&data).frame_at(test.time).number, 6);
}

#[test]
fn depth_is_that_of_the_depth_buffer_and_positions_project_back() {
    let dir = tempfile::tempdir().unwrap();
    let options = AvatarOptions { rings: 1, per_ring: 4, frames: 2, size: 128, ..small() };
    write(dir.path(), &options, true, false).unwrap();
    let data = open(dir.path()).unwrap();
    let (mut covered, mut off, mut worst) = (0, 0, 0.0f64);
    for view in &data.train {
        let frame = scene(&data).frame_at(view.time);
        let file = dir.path().join(format!("gt/{:03}/{:06}.exr", view.camera_id, frame.number));
        let layers = load_layers(&file, &Limits::default()).unwrap();
        let map = |name: &str| &layers.iter().find(|l| l.name == name).unwrap().map;
        let buffer = DepthMap::new(
            &scene(&data).true_surface(frame),
            &scene(&data).character.template.faces,
            &view.camera,
            1e-3,
        );
        for (i, (&z, &want)) in map("depth").data.iter().zip(&buffer.depth).enumerate() {
            covered += usize::from(z > 0.0);
            if (z > 0.0) != want.is_finite() {
                off += 1;
                continue;
            }
            if z > 0.0 {
                let far = f64::from((z - want).abs() / want);
                off += usize::from(far > 1e-5);
                worst = worst.max(far);
                let (x, y) = (i % 128, i / 128);
                let at = glam::Vec3::from_slice(map("P").pixel(x, y)).as_dvec3();
                let at = view.camera.to_pixel(view.camera.to_camera(at));
                assert!((at.x - x as f64 - 0.5).abs() < 1e-2 && (at.y - y as f64 - 0.5).abs() < 1e-2, "{at}");
                let n = glam::Vec3::from_slice(map("N").pixel(x, y));
                assert!((n.length() - 1.0).abs() < 1e-4);
            }
        }
    }
    println!("{covered} pixels, {off} differ, worst relative depth error {worst:.2e}");
    assert!(covered > 5_000 && off * 1000 <= covered, "{off} of {covered}");
}

/// A film on the disk that tests damage.
struct Broken {
    dir: TempDir,
    scene: Value,
    cameras: Value,
}

impl Broken {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let options =
            AvatarOptions { per_ring: 4, rings: 1, frames: 3, size: 16, points: 10, ..AvatarOptions::default() };
        write(dir.path(), &options, false, false).unwrap();
        let read = |name: &str| serde_json::from_slice(&std::fs::read(dir.path().join(name)).unwrap()).unwrap();
        Self { scene: read("scene.json"), cameras: read("cameras.json"), dir }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn put(&self, name: &str, text: impl AsRef<[u8]>) -> &Self {
        std::fs::write(self.path(name), text).unwrap();
        self
    }

    fn open_with(&self, options: &DataOptions) -> Result<Dataset, DataError> {
        Dataset::open(self.dir.path(), options)
    }

    /// The fault of `scene.json` with one field changed.
    fn scene(&self, key: &str, value: Value) -> DataError {
        let mut scene = self.scene.clone();
        scene[key] = value;
        self.put("scene.json", scene.to_string());
        let e = open(self.dir.path()).unwrap_err();
        self.put("scene.json", self.scene.to_string());
        e
    }

    /// The fault of `cameras.json` with one field of camera 1 changed.
    fn camera(&self, key: &str, value: Value) -> DataError {
        let mut cameras = self.cameras.clone();
        cameras[1][key] = value;
        self.put("cameras.json", cameras.to_string().replace("\"<NaN>\"", "NaN"));
        let e = open(self.dir.path()).unwrap_err();
        self.put("cameras.json", self.cameras.to_string());
        e
    }
}

/// The report of a fault must name these.
fn names(e: &DataError, code: &str, words: &[&str]) {
    let report = e.report();
    assert_eq!(e.code(), code, "{report}");
    words.iter().for_each(|w| assert!(report.contains(w), "`{w}` is not in: {report}"));
}

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

#[test]
fn poses_crops_masks_and_lenses_are_read() {
    let film = Broken::new();
    let plain = open(film.dir.path()).unwrap();
    // A pose over that of the motion.
    film.put(
        "poses.json",
        json!({"1": {"nodes": {"head": {"rotation": [2, 0, 0, 0]}}, "morphs": [0.5, 0.0]}}).to_string(),
    );
    let posed = open(film.dir.path()).unwrap();
    let s = scene(&posed);
    let head = s.character.skeleton.node("head").unwrap() as usize;
    assert_eq!(s.frames[1].pose.locals[head].rotation, [2.0, 0.0, 0.0, 0.0]);
    assert_eq!(s.frames[1].true_morphs, Some(vec![0.5, 0.0]));
    assert_eq!(s.frames[0].pose, scene(&plain).frames[0].pose);
    for (poses, words) in [
        (json!({"1": {"nodes": {"tail": {}}}}), &["1.nodes.tail", "no node"][..]),
        (json!({"1": {"nodes": {"head": {"rotation": [0, 0, 0, 0]}}}}), &["1.nodes.head.rotation"]),
        (json!({"1": {"nodes": {"head": {"scale": [1, 1]}}}}), &["1.nodes.head.scale"]),
        (json!({"1": {"morphs": [1.0]}}), &["1.morphs"]),
        (json!({"first": {}}), &["first", "whole numbers"]),
    ] {
        film.put("poses.json", poses.to_string());
        names(&open(film.dir.path()).unwrap_err(), "data.field", &[&["poses.json"], words].concat());
    }
    std::fs::remove_file(film.path("poses.json")).unwrap();
    // A part of the sensor: the same rays.
    let file = film.path("images/001/000002.png");
    let whole = image::open(&file).unwrap();
    whole.crop_imm(3, 5, 10, 8).save(&file).unwrap();
    assert_eq!(open(film.dir.path()).unwrap_err().code(), "data.image_size");
    film.put("crops.json", json!({"2": {"1": [3, 5]}}).to_string());
    let cropped = open(film.dir.path()).unwrap();
    let (a, b) = (&scene(&plain).frames[2].inputs[1].camera, &scene(&cropped).frames[2].inputs[1].camera);
    assert_eq!((b.width, b.height, a.cx - b.cx, a.cy - b.cy, a.fx - b.fx), (10, 8, 3.0, 5.0, 0.0));
    film.put("crops.json", json!({"2": {"1": [3]}}).to_string());
    names(&open(film.dir.path()).unwrap_err(), "data.field", &["crops.json", "2.1"]);
    film.put("crops.json", json!({"2": {"1": [3, 5]}}).to_string());
    // A mask in place of alpha.
    let file = film.path("images/000/000001.png");
    let rgba = image::open(&file).unwrap().to_rgba8();
    image::DynamicImage::from(rgba.clone()).to_rgb8().save(&file).unwrap();
    names(&open(film.dir.path()).unwrap_err(), "data.field", &["masks/000/000001.png", "missing"]);
    std::fs::create_dir_all(film.path("masks/000")).unwrap();
    let alpha = image::GrayImage::from_fn(16, 16, |x, y| image::Luma([rgba.get_pixel(x, y)[3]]));
    alpha.save(film.path("masks/000/000001.png")).unwrap();
    let masked = open(film.dir.path()).unwrap();
    let input = &scene(&masked).frames[1].inputs[0];
    assert!(matches!(&input.mask, Some(ImageSource::File(_))) && !masked.has_alpha);
    let cut = AvatarScene::input_pixels(input, &ImageCache::new(0, 1.0)).unwrap();
    let trained = masked.train.iter().find(|v| v.name == input.name).unwrap();
    assert!(pixels(trained).alpha() == cut.alpha() && cut.data.chunks_exact(4).any(|p| p[3] == 0), "not opaque");
    assert_eq!(cut.data, rgba.into_raw(), "colour and coverage as before");
    // Pixel centres at whole numbers, and a lens.
    let mut cameras = film.cameras.clone();
    cameras[2]["pixel_center"] = json!("integer");
    cameras[2]["dist"] = json!([0.1, 0.0, 0.0, 0.0]);
    film.put("cameras.json", cameras.to_string());
    let read = open(film.dir.path()).unwrap();
    let view = &scene(&read).frames[0].inputs[2];
    assert_eq!((view.camera.cx, view.lens.map(|l| l.k1)), (8.5, Some(0.1)));
    let e = film.open_with(&DataOptions { undistort: false, ..DataOptions::default() }).unwrap_err();
    assert_eq!(e.code(), "data.camera_model");
}

#[test]
fn views_of_a_frame_without_inputs_are_left_out_with_it() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &small(), false, false).unwrap();
    for camera in [0, 2, 4, 6] {
        std::fs::remove_file(dir.path().join(format!("images/{camera:03}/000002.png"))).unwrap();
    }
    let data = Dataset::open(dir.path(), &DataOptions { allow_missing: true, ..DataOptions::default() }).unwrap();
    assert_eq!((data.train.len(), data.test.len(), scene(&data).frames.len()), (12 * 4, 4 * 4, 4));
    assert!(data.train.iter().chain(&data.test).all(|v| scene(&data).frame_at(v.time).time == v.time));
    let note = "frame 2 has no input and is left out with its 12 views";
    assert!(data.notes.iter().any(|n| n == note), "{:?}", data.notes);
}

#[test]
fn options_choose_views_but_not_inputs() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &small(), false, false).unwrap();
    let with = |o: DataOptions| Dataset::open(dir.path(), &o);
    let d = DataOptions::default;
    let half = with(DataOptions { scale: 0.5, ..d() }).unwrap();
    assert!(half.train.iter().chain(&scene(&half).frames[3].inputs).all(|v| v.camera.width == 20));
    let few = with(DataOptions { cameras: vec![1, 9], ..d() }).unwrap();
    assert_eq!((few.train.len(), few.test.len(), scene(&few).input_count()), (5, 5, 4));
    let early = with(DataOptions { time_boundary: Some(0.5), ..d() }).unwrap();
    assert_eq!((early.train.len(), early.extrapolate.len()), (12 * 3, 16 * 2));
    assert_eq!(scene(&early).frame_at(early.extrapolate[0].time).number, 3);
    let still = with(DataOptions { first_frame: 3, frame_count: 1, ..d() }).unwrap();
    assert_eq!((still.dynamic, scene(&still).frames.len(), scene(&still).frames[0].number), (false, 1, 3));
    let slow = with(DataOptions { fps: Some(2.0), ..d() }).unwrap();
    assert_eq!(scene(&slow).frames[4].time.seconds, 2.0);
    let e = with(DataOptions { time_from: TimeFrom::Order, ..d() }).unwrap_err();
    names(&e, "data.option", &["data.time_from"]);
    let e = with(DataOptions { time_shift: Some("2:1".parse().unwrap()), ..d() }).unwrap_err();
    names(&e, "data.option", &["data.time_shift", "renumber"]);
    let ood = json!({"train": [0, 1, 2], "test": [3], "ood": [4]});
    let mut scene_json: Value = serde_json::from_slice(&std::fs::read(dir.path().join("scene.json")).unwrap()).unwrap();
    scene_json["splits"] = ood;
    std::fs::write(dir.path().join("scene.json"), scene_json.to_string()).unwrap();
    let split = with(d()).unwrap();
    assert_eq!([split.train.len(), split.test.len(), split.extrapolate.len()], [36, 16, 4]);
    assert_eq!(split.extrapolate[0].time.normalised, 2.0, "the training frames are 0 to 1");
}

#[test]
fn options_of_the_generator_have_domains() {
    let o = small;
    for (options, words) in [
        (AvatarOptions { per_ring: 6, ..o() }, "multiple of 4"),
        (AvatarOptions { rings: 4, ..o() }, "rings"),
        (AvatarOptions { frames: 0, ..o() }, "frames"),
        (AvatarOptions { size: 0, ..o() }, "size"),
        (AvatarOptions { supersample: 2, ..o() }, "supersample"),
        (AvatarOptions { test_every: 1, ..o() }, "test_every"),
        (AvatarOptions { fps: Some(f64::NAN), ..o() }, "fps"),
        (AvatarOptions { frames: 100_000, size: 2048, ..o() }, "8 GiB"),
        (AvatarOptions { clip: Some("fly".into()), ..o() }, "walk, wave, turn"),
        (AvatarOptions { template: "builtin:horse".into(), ..o() }, "builtin:person"),
        (AvatarOptions { only_morphs: vec!["fly".into()], ..o() }, "breathe, swing"),
    ] {
        names(&generate(&options).unwrap_err(), "data.option", &[words]);
    }
}

/// Characters of others, if the shared folder is there.
#[test]
fn characters_from_files_travel_with_their_film() {
    let Some(folder) = gs_core::testkit::shared("data/gltf_public") else { return };
    for name in ["CesiumMan.glb", "Fox.glb", "kenney_character_rigid_parts/character.glb"] {
        let file = folder.join(name);
        let dir = tempfile::tempdir().unwrap();
        let template = file.to_string_lossy().into_owned();
        let options = AvatarOptions { template, rings: 1, per_ring: 4, ..small() };
        let made = match write(dir.path(), &options, false, false) {
            Ok(made) => made,
            Err(e) => panic!("{name}: {}", e.report()),
        };
        assert_same(&open(dir.path()).unwrap(), &made);
        let covered = pixels(&made.train[0]).data.chunks_exact(4).filter(|p| p[3] > 0).count();
        println!("{name}: {covered} of {} pixels show it", 40 * 40);
        assert!(covered > 40);
    }
}
