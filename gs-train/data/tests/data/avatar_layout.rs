//! What the layout `avatar` reads of a film of a person: all that was written, and what options leave of it.

use crate::film::{Broken, names, open, pixels, scene, small};
use gs_data::avatar::AvatarScene;
use gs_data::{DataOptions, Dataset, ImageCache, ImageSource, TimeFrom, View, detect};
use gs_synth::avatar::{AvatarOptions, Morphs, generate, write};
use serde_json::{Value, json};

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
