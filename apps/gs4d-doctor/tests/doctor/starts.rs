//! What there is to begin with: points, boxes, outlines and masks that mislead.

use crate::folder::{Folder, each};
use crate::{must_name, must_note};
use glam::{DMat4, DQuat, DVec3, Vec3};
use gs_core::Image;
use gs_core::io::images::save_png;
use gs_data::{DataOptions, Dataset, StartFrom, TimeFrom, write_start};
use gs4d_doctor::{CheckOptions, Verdict, examine};
use serde_json::{Value, json};

/// Views of the generated scene that train.
const VIEWS: usize = 60;

/// Gives a folder points of its hull, changed.
fn begin(folder: &Folder, count: usize, change: impl Fn(usize, Vec3) -> Vec3) {
    let data = Dataset::open(folder.dir(), &DataOptions::default()).expect("data");
    let mut start = data.start(Some(StartFrom::Hull), count, 0).expect("points");
    start.cloud.positions.iter_mut().enumerate().for_each(|(k, p)| *p = change(k, *p));
    write_start(folder.dir(), &start, false).expect("written");
}

/// The scene without alpha, over black.
fn without_alpha() -> Folder {
    let folder = Folder::of("static");
    let opaque = |i: &Image| {
        let over = each(i, |_, _, p| vec![p[0] * p[3], p[1] * p[3], p[2] * p[3], 1.0]);
        let data = over.data.as_chunks::<4>().0.iter().flat_map(|p| p[..3].to_vec()).collect();
        Image { channels: 3, data, ..over }
    };
    (0..VIEWS).for_each(|k| folder.paint(k, opaque));
    std::fs::remove_file(folder.path("transforms_test.json")).expect("removed");
    folder
}

#[test]
fn points_and_boxes_elsewhere_are_told() {
    let folder = Folder::of("static");
    begin(&folder, 200, |_, p| p * 30.0 + 80.0);
    must_name(&folder.look(), "init.frame", Verdict::Problem);
    std::fs::write(folder.path("scene.toml"), "[start]\nbounds = [[50, 50, 50], [60, 60, 60]]\n").expect("written");
    must_name(&folder.look(), "bound.unseen", Verdict::Problem);
    std::fs::write(folder.path("scene.toml"), "[start]\nbounds = [[1, 1, 1], [0, 2, 2]]\n").expect("written");
    must_name(&folder.look(), "data.field", Verdict::Problem);
    std::fs::write(folder.path("scene.toml"), "[start]\nbounds = [[-1, -1, -0.001], [1, 1, 0.001]]\n")
        .expect("written");
    must_note(&folder.look(), "bound.flat");
}

#[test]
fn points_that_are_few_or_stray_are_told() {
    let folder = Folder::of("static");
    begin(&folder, 20, |_, p| p);
    must_name(&folder.look(), "init.few", Verdict::Warning);
    let folder = Folder::of("static");
    begin(&folder, 200, |k, p| if k % 7 == 0 { p + Vec3::splat(500.0) } else { p });
    let text = std::fs::read_to_string(folder.path("scene.toml")).expect("file");
    let bounds = "bounds = [[-1.5, -1.5, -1.5], [1.5, 1.5, 1.5]]\n";
    std::fs::write(folder.path("scene.toml"), format!("{text}{bounds}")).expect("written");
    let checkup = folder.look();
    must_note(&checkup, "init.unseen");
    assert!(must_name(&checkup, "bound.points", Verdict::Warning).contains("14 %"));
}

#[test]
fn images_without_anything_to_begin_with_are_told() {
    let folder = without_alpha();
    assert!(must_name(&folder.look(), "init.random", Verdict::Warning).contains("no silhouettes"));
    let model = folder.path("sparse/0");
    std::fs::create_dir_all(&model).expect("folder");
    std::fs::write(model.join("cameras.txt"), "1 PINHOLE 128 128 150 150 64 64\n").expect("written");
    std::fs::write(model.join("images.txt"), "1 1 0 0 0 0 0 4 1 r_0.png\n\n").expect("written");
    let point = |k: u32| format!("{k} {} 0.1 0.0 200 100 50 0.5\n", 0.002 * f64::from(k));
    std::fs::write(model.join("points3D.txt"), (1..100).map(point).collect::<String>()).expect("written");
    assert!(must_name(&folder.look(), "init.missing", Verdict::Warning).contains("colmap"));
}

#[test]
fn outlines_that_tell_nothing_or_lies_are_told() {
    let folder = Folder::of("static");
    std::fs::remove_file(folder.path("transforms_test.json")).expect("removed");
    let whole = |i: &Image| each(i, |x, y, p| vec![p[0], p[1], p[2], if x + y == 0 { 0.99 } else { 1.0 }]);
    (0..VIEWS).for_each(|k| folder.paint(k, whole));
    assert!(must_name(&folder.look(), "images.alpha", Verdict::Warning).contains("1 everywhere"));

    // Images under the poses of others.
    let folder = Folder::of("static");
    folder.edit("train", |v| {
        let frames = v["frames"].as_array_mut().expect("frames");
        let names: Vec<Value> = frames.iter().map(|f| f["file_path"].clone()).collect();
        frames.iter_mut().enumerate().for_each(|(k, f)| f["file_path"] = names[(7 * k + 13) % names.len()].clone());
    });
    must_name(&folder.look(), "poses.silhouettes", Verdict::Warning);
}

#[test]
fn a_camera_that_only_turns_is_told() {
    let folder = Folder::of("static");
    folder.poses(|k, _| DMat4::from_rotation_translation(DQuat::from_rotation_y(0.1 * k as f64), DVec3::Z));
    must_name(&folder.look(), "poses.still", Verdict::Warning);
}

#[test]
fn what_is_assumed_is_told() {
    let folder = Folder::of("balls-opaque");
    let exam =
        CheckOptions { data: DataOptions { time_from: TimeFrom::Order, ..Default::default() }, ..Default::default() };
    must_note(&examine(folder.dir(), &exam), "time.assumed");
    // The files of another layout beside those of the first.
    std::fs::create_dir(folder.path("ims")).expect("folder");
    std::fs::write(folder.path("train_meta.json"), "{}").expect("written");
    let checkup = folder.look();
    must_note(&checkup, "layout.ambiguous");
    let found = checkup.findings.iter().find(|f| f.code == "layout.ambiguous").expect("finding");
    assert!(found.fix.as_ref().is_some_and(|f| f.starts_with("--layout ")), "{found:?}");
}

/// A clip of the layout `panoptic` with masks, which `paint` makes for a camera and a frame.
fn masked(paint: impl Fn(usize, usize) -> Option<Image>) -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("folder");
    let (cameras, frames, size) = (4, 3, 48);
    let k = json!([[40.0, 0.0, 24.0], [0.0, 40.0, 24.0], [0.0, 0.0, 1.0]]);
    let pose = |c: usize| {
        let turn = DMat4::from_rotation_y(0.4 * c as f64);
        let m = (DMat4::from_translation(DVec3::Z * 3.0) * turn).transpose().to_cols_array_2d();
        json!(m)
    };
    let table = |cell: &dyn Fn(usize, usize) -> Value| -> Value {
        (0..frames).map(|t| (0..cameras).map(|c| cell(t, c)).collect::<Value>()).collect()
    };
    let meta = json!({
        "w": size, "h": size,
        "k": table(&|_, _| k.clone()),
        "w2c": table(&|_, c| pose(c)),
        "fn": table(&|t, c| json!(format!("{c}/{t:06}.png"))),
        "cam_id": table(&|_, c| json!(c)),
    });
    std::fs::write(dir.path().join("train_meta.json"), meta.to_string()).expect("written");
    for (c, t) in (0..cameras).flat_map(|c| (0..frames).map(move |t| (c, t))) {
        for folder in ["ims", "seg"] {
            std::fs::create_dir_all(dir.path().join(format!("{folder}/{c}"))).expect("folder");
        }
        let shade = |x: usize, y: usize, ch: usize| ((x * (3 + ch) + y * 5 + 7 * c + 11 * t) % 48) as f32 / 47.0;
        let pixel = |i: usize| shade(i / 3 % size, i / 3 / size, i % 3);
        let data = (0..3 * size * size).map(pixel).collect();
        let photo = Image { width: size, height: size, channels: 3, data };
        save_png(&dir.path().join(format!("ims/{c}/{t:06}.png")), &photo, false).expect("written");
        if let Some(mask) = paint(c, t) {
            save_png(&dir.path().join(format!("seg/{c}/{t:06}.png")), &mask, false).expect("written");
        }
    }
    dir
}

#[test]
fn masks_that_cannot_be_used_are_named() {
    let even = |value: f32| Image { width: 48, height: 48, channels: 1, data: vec![value; 48 * 48] };
    let dir = masked(|c, t| Some(even(if (c, t) == (2, 1) { 0.0 } else { 1.0 })));
    let checkup = examine(dir.path(), &CheckOptions::default());
    assert!(must_name(&checkup, "masks.empty", Verdict::Warning).contains("2_000001"), "{:?}", checkup.findings);
    let whole = std::fs::read(dir.path().join("seg/1/000000.png")).expect("mask");
    std::fs::write(dir.path().join("seg/1/000000.png"), &whole[..whole.len() - 20]).expect("written");
    let text = must_name(&examine(dir.path(), &CheckOptions::default()), "masks.unreadable", Verdict::Problem);
    assert!(text.contains("seg"), "{text}");
}
