//! The reader of `poses_bounds.npy` on folders written here: axes, splits, times, videos without frames, and its faults.

use std::path::Path;

use glam::DVec3;
use gs_core::Camera;
use gs_data::{DataError, DataOptions, Dataset, ImageCache, TimeFrom, detect};
use tempfile::TempDir;

/// Size the poses are meant for; frames are half of it.
const SIZE: [u32; 2] = [48, 36];

fn put(dir: &Path, name: &str, contents: impl AsRef<[u8]>) {
    let file = dir.join(name);
    std::fs::create_dir_all(file.parent().unwrap()).unwrap();
    let _ = std::fs::remove_file(&file);
    std::fs::write(file, contents).unwrap();
}

fn picture(dir: &Path, name: &str, size: [u32; 2]) {
    let file = dir.join(name);
    std::fs::create_dir_all(file.parent().unwrap()).unwrap();
    image::RgbImage::from_pixel(size[0], size[1], image::Rgb([90; 3])).save(file).unwrap();
}

fn cameras(n: usize) -> Vec<Camera> {
    let eye = |k: usize| DVec3::new(k as f64 - 1.5, -4.0, 0.3 * k as f64);
    (0..n).map(|k| Camera::look_at(SIZE[0], SIZE[1], 0.9, eye(k), DVec3::ZERO, DVec3::Z).unwrap()).collect()
}

/// `[R | c | (H, W, f)]` with columns down, right, backwards, then depths 1 and 8.
fn row(c: &Camera) -> [f64; 17] {
    let axes = c.rotation.transpose();
    let columns = [axes.y_axis, axes.x_axis, -axes.z_axis, c.position(), DVec3::new(36.0, 48.0, c.fx)];
    let mut row = [0.0; 17];
    for (k, value) in row[..15].iter_mut().enumerate() {
        *value = columns[k % 5][k / 5];
    }
    (row[15], row[16]) = (1.0, 8.0);
    row
}

fn poses(rows: &[[f64; 17]]) -> Vec<u8> {
    let mut dict = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({}, 17), }}", rows.len());
    dict.extend(std::iter::repeat_n(' ', 117 - dict.len()));
    dict.push('\n');
    let mut bytes = [&b"\x93NUMPY\x01\x00"[..], &118u16.to_le_bytes(), dict.as_bytes()].concat();
    bytes.extend(rows.iter().flatten().flat_map(|v| v.to_le_bytes()));
    bytes
}

/// A rig of `n` cameras with `frames` frames each at half size, in `camNN/images` or directly in `camNN`.
fn rig(n: usize, frames: usize, sub: &str) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    put(dir.path(), "poses_bounds.npy", poses(&cameras(n).iter().map(row).collect::<Vec<_>>()));
    for (k, frame) in (0..n).flat_map(|k| (0..frames).map(move |f| (k, f))) {
        picture(dir.path(), &format!("cam{k:02}{sub}/{frame:04}.png"), SIZE.map(|s| s / 2));
    }
    dir
}

fn open(dir: &TempDir) -> Result<Dataset, DataError> {
    Dataset::open(dir.path(), &DataOptions::default())
}

#[test]
fn a_rig_of_videos_is_read() {
    for sub in ["/images", ""] {
        let dir = rig(3, 4, sub);
        let d = open(&dir).unwrap();
        assert_eq!((detect(dir.path()).unwrap().name, d.layout, d.train.len(), d.test.len()), ("llff", "llff", 8, 4));
        assert!(d.dynamic && d.test.iter().all(|v| v.camera_id == 0) && d.train.iter().all(|v| v.camera_id > 0));
        for v in d.train.iter().chain(&d.test) {
            let want = cameras(3)[v.camera_id as usize].scaled(0.5);
            assert!((v.camera.rotation - want.rotation).to_cols_array().iter().all(|x| x.abs() < 1e-12));
            assert!((v.camera.position() - want.position()).length() < 1e-12);
            assert!((v.camera.fx - want.fx).abs() < 1e-12 && (v.camera.cx, v.camera.cy) == (12.0, 9.0));
        }
        let times = |d: &Dataset| d.test.iter().map(|v| v.time.normalised).collect::<Vec<_>>();
        assert_eq!(times(&d), [0.0, 0.25, 0.5, 0.75], "k/n");
        for part in ["3 cameras with 4 frames each", "first camera is held out", "time k/4", "48x36 against 24x18"] {
            assert!(d.notes.iter().any(|n| n.contains(part)), "{part}: {:?}", d.notes);
        }
        assert_eq!(ImageCache::new(0, 1.0).get(&d.train[3]).unwrap().width, 24);
        let [low, high] = d.bounds.unwrap();
        assert!(low.y < -3.0 && high.y > 4.0 && low.x < -1.5, "all that is seen between the depths: {low} {high}");
        let with = |o: DataOptions| Dataset::open(dir.path(), &o).unwrap();
        let last = with(DataOptions { time_range: Some("0..3".parse().unwrap()), ..Default::default() });
        assert_eq!(times(&last)[3], 1.0, "k/(n - 1) on request");
        let clock = with(DataOptions { fps: Some(2.0), ..Default::default() });
        assert_eq!((times(&clock)[3], clock.test[3].time.seconds), (0.75, 1.5));
        let named = with(DataOptions { time_from: TimeFrom::Name, ..Default::default() });
        assert_eq!(times(&named), [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0]);
        let small = with(DataOptions { scale: 0.5, ..Default::default() });
        assert_eq!((small.train[0].camera.width, small.train[0].stored), (12, Some([24, 18])));
    }
}

#[test]
fn an_image_folder_of_cameras_that_was_asked_for_must_be_there() {
    let dir = rig(2, 2, "/images_2");
    let with =
        |images: &str| Dataset::open(dir.path(), &DataOptions { images: Some(images.into()), ..Default::default() });
    assert_eq!(with("images_2").unwrap().train.len(), 2);
    let beside = rig(2, 2, "");
    let o = DataOptions { images: Some("images_4".into()), ..Default::default() };
    for e in [with("images_4").unwrap_err(), Dataset::open(beside.path(), &o).unwrap_err()] {
        assert!(e.code() == "data.option" && e.to_string().contains("images_4"), "{e}");
    }
}

#[test]
fn videos_without_frames_name_the_command() {
    let dir = rig(3, 2, "/images");
    std::fs::remove_dir_all(dir.path().join("cam01")).unwrap();
    put(dir.path(), "cam01.mp4", "video");
    let e = open(&dir).unwrap_err();
    assert_eq!((e.code(), e.exit_code()), ("data.video", 3));
    let report = e.report();
    assert!(
        report.contains("ffmpeg -i \"$v\" -vf scale=24:18 -start_number 0 \"${v%.mp4}/images/%04d.png\""),
        "{report}"
    );
}

#[test]
fn counts_must_agree() {
    let dir = rig(3, 2, "/images");
    std::fs::remove_dir_all(dir.path().join("cam01")).unwrap();
    let e = open(&dir).unwrap_err();
    assert!(e.code() == "data.field" && e.to_string().contains("3 rows for 2 cameras"), "{e}");
    let dir = rig(3, 2, "/images");
    std::fs::remove_file(dir.path().join("cam02/images/0001.png")).unwrap();
    assert!(open(&dir).unwrap_err().to_string().contains("1 frames that are not named as the 2"), "fewer frames");
    picture(dir.path(), "cam02/images/0002.png", [24, 18]);
    assert!(open(&dir).unwrap_err().to_string().contains("2 frames that are not named as the 2"), "another moment");
    let dir = tempfile::tempdir().unwrap();
    put(dir.path(), "poses_bounds.npy", poses(&cameras(3).iter().map(row).collect::<Vec<_>>()));
    assert!(
        open(&dir).unwrap_err().to_string().contains("neither folders camNN nor an image folder: looked for images")
    );
    picture(dir.path(), "images/a.png", SIZE);
    assert!(open(&dir).unwrap_err().to_string().contains("3 rows for 1 images"));
}

#[test]
fn images_are_static_and_every_eighth_is_held_out() {
    let dir = tempfile::tempdir().unwrap();
    put(dir.path(), "poses_bounds.npy", poses(&cameras(10).iter().map(row).collect::<Vec<_>>()));
    (0..10).for_each(|k| picture(dir.path(), &format!("images/IMG_{k}.png"), SIZE));
    let d = open(&dir).unwrap();
    assert_eq!((d.layout, d.train.len(), d.test.len(), d.dynamic), ("llff", 8, 2, false));
    assert_eq!((d.test[1].name.as_str(), d.test[1].camera_id), ("IMG_8", 8));
    let o = DataOptions { time_from: TimeFrom::Order, ..Default::default() };
    assert!(Dataset::open(dir.path(), &o).unwrap().dynamic, "times on request");
    // Beside another layout's files, that layout is chosen as before; --layout decides otherwise.
    put(dir.path(), "sparse/0/cameras.txt", "");
    put(dir.path(), "sparse/0/images.txt", "");
    assert_eq!(detect(dir.path()).unwrap().name, "colmap");
    let o = DataOptions { layout: Some("llff".into()), ..Default::default() };
    assert_eq!(Dataset::open(dir.path(), &o).unwrap().layout, "llff");
}

#[test]
fn one_camera_trains() {
    let d = open(&rig(1, 3, "/images")).unwrap();
    assert_eq!((d.train.len(), d.test.len()), (3, 0));
}

#[test]
fn rows_that_are_wrong_are_named() {
    type Change = fn(&mut [f64; 17]);
    let changes: [(Change, &str, &str); 7] = [
        (|r| r[3] = f64::NAN, "data.syntax", "must be finite"),
        (|r| r[4] = 0.0, "data.field", "row 1 is of size 48x0"),
        (|r| r[9] = 1e9, "data.field", "row 1 is of size 1000000000x36"),
        (|r| r[14] = -5.0, "data.field", "focal length -5"),
        (|r| r[0] += 3.0, "data.pose", "row 1 has no rotation"),
        (|r| [0, 5, 10].iter().for_each(|&k| r[k] = -r[k]), "data.pose", "mirrored"),
        (|r| r[9] = 20.0, "data.image_size", "its camera is 20x36"),
    ];
    for (change, code, text) in changes {
        let dir = rig(3, 2, "/images");
        let mut rows: Vec<[f64; 17]> = cameras(3).iter().map(row).collect();
        change(&mut rows[1]);
        put(dir.path(), "poses_bounds.npy", poses(&rows));
        let e = open(&dir).unwrap_err();
        assert!(e.code() == code && e.to_string().contains(text), "{text}: {} {e}", e.code());
    }
    let dir = rig(2, 2, "/images");
    let whole = std::fs::read(dir.path().join("poses_bounds.npy")).unwrap();
    for cut in (0..whole.len()).step_by(3) {
        put(dir.path(), "poses_bounds.npy", &whole[..cut]);
        assert_eq!(open(&dir).unwrap_err().code(), "data.syntax", "cut at {cut}");
    }
    let text = |from: &str, to: &str| String::from_utf8_lossy(&whole[..128]).replace(from, to).into_bytes();
    for (from, to) in [("(2, 17)", "(9999999999, 17)"), ("(2, 17)", "(17, 2)"), ("(2, 17)", "(34,)"), ("<f8", "<i8")] {
        let mut bytes = [&whole[..8], &text(from, to)[10..]].concat();
        bytes.extend(&whole[128..]);
        put(dir.path(), "poses_bounds.npy", bytes);
        let e = open(&dir).unwrap_err();
        assert!(["data.syntax", "data.field"].contains(&e.code()), "{to}: {e}");
    }
}

#[cfg(unix)]
#[test]
fn frames_stay_inside_the_folder() {
    let outside = tempfile::tempdir().unwrap();
    picture(outside.path(), "0000.png", [24, 18]);
    let dir = rig(2, 1, "/images");
    std::fs::remove_dir_all(dir.path().join("cam01/images")).unwrap();
    std::os::unix::fs::symlink(outside.path(), dir.path().join("cam01/images")).unwrap();
    assert_eq!(open(&dir).unwrap_err().code(), "data.escape");
    let o = DataOptions { images: Some("../..".into()), ..Default::default() };
    assert_eq!(Dataset::open(dir.path(), &o).unwrap_err().code(), "data.escape");
}
