//! Frames of one moving camera in the folders of Nvidia's dynamic scenes, written here as binary COLMAP models.

use std::path::Path;

use glam::{DQuat, DVec2, DVec3};
use gs_core::Camera;
use gs_data::{DataOptions, Dataset, ImageCache, TimeFrom, detect};
use tempfile::TempDir;

const SIZE: [u32; 2] = [60, 40];

fn camera(k: usize) -> Camera {
    let eye = DVec3::new(0.2 * k as f64, -0.3, -4.0);
    let c = Camera::look_at(SIZE[0], SIZE[1], 0.9, eye, DVec3::new(0.1, 0.0, 0.3), -DVec3::Y).unwrap();
    Camera { fx: 62.0, fy: 63.0, cx: 28.5, cy: 21.25, ..c }
}

/// A smooth picture on the pinhole's plane.
fn paint(at: DVec2) -> f64 {
    128.0 + 60.0 * (at.x * 0.2).sin() + 60.0 * (at.y * 0.15).cos()
}

/// Where the files' own formula shows the point of the plane `z = 1`: OPENCV with these coefficients.
const OPENCV: [f64; 4] = [0.08, -0.02, 0.002, -0.001];

fn bend(p: DVec2) -> DVec2 {
    let [k1, k2, p1, p2] = OPENCV;
    let r2 = p.length_squared();
    let radial = 1.0 + k1 * r2 + k2 * r2 * r2;
    DVec2::new(
        p.x * radial + 2.0 * p1 * p.x * p.y + p2 * (r2 + 2.0 * p.x * p.x),
        p.y * radial + p1 * (r2 + 2.0 * p.y * p.y) + 2.0 * p2 * p.x * p.y,
    )
}

/// The image: each pixel's plane point by fixed-point iteration, then the paint of the pinhole there.
fn distorted_image(c: &Camera) -> image::GrayImage {
    image::GrayImage::from_fn(SIZE[0], SIZE[1], |i, j| {
        let seen = DVec2::new((f64::from(i) + 0.5 - c.cx) / c.fx, (f64::from(j) + 0.5 - c.cy) / c.fy);
        let mut p = seen;
        for _ in 0..50 {
            p += seen - bend(p);
        }
        image::Luma([paint(DVec2::new(c.fx * p.x + c.cx, c.fy * p.y + c.cy)).round() as u8])
    })
}

/// A capture of `n` frames, listed in the model from last to first.
fn capture(n: usize) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let (sparse, images) = (dir.path().join("dense/sparse"), dir.path().join("dense/images"));
    std::fs::create_dir_all(&sparse).unwrap();
    std::fs::create_dir_all(&images).unwrap();
    let first = camera(0);
    let mut cameras = [&1u64.to_le_bytes()[..], &1i32.to_le_bytes(), &4i32.to_le_bytes()].concat();
    cameras.extend(SIZE.map(|s| u64::from(s).to_le_bytes()).concat());
    let params = [first.fx, first.fy, first.cx, first.cy].into_iter().chain(OPENCV);
    cameras.extend(params.flat_map(f64::to_le_bytes));
    let mut rows = (n as u64).to_le_bytes().to_vec();
    for k in (0..n).rev() {
        let c = camera(k);
        let q = DQuat::from_mat3(&c.rotation);
        rows.extend((k as i32 + 1).to_le_bytes());
        rows.extend([q.w, q.x, q.y, q.z].map(f64::to_le_bytes).concat());
        rows.extend(c.translation.to_array().map(f64::to_le_bytes).concat());
        rows.extend(1i32.to_le_bytes());
        rows.extend(format!("{k:03}.png\0").bytes());
        rows.extend(0u64.to_le_bytes());
        distorted_image(&c).save(images.join(format!("{k:03}.png"))).unwrap();
    }
    std::fs::write(sparse.join("cameras.bin"), cameras).unwrap();
    std::fs::write(sparse.join("images.bin"), rows).unwrap();
    dir
}

fn open(dir: &Path, options: &DataOptions) -> Dataset {
    Dataset::open(dir, options).unwrap()
}

#[test]
fn frames_are_moments_in_order_of_names() {
    let dir = capture(17);
    assert_eq!(detect(dir.path()).unwrap().name, "nvidia");
    let d = open(dir.path(), &DataOptions::default());
    assert_eq!((d.layout, d.dynamic, d.train.len(), d.test.len()), ("nvidia", true, 14, 3));
    assert_eq!(d.test.iter().map(|v| v.name.as_str()).collect::<Vec<_>>(), ["000", "008", "016"]);
    for v in d.train.iter().chain(&d.test) {
        let k: usize = v.name.parse().unwrap();
        assert!((f64::from(v.time.normalised) - k as f64 / 16.0).abs() < 1e-6, "{} at {}", v.name, v.time.normalised);
        assert!((v.camera.position() - camera(k).position()).length() < 1e-12);
        assert_eq!((v.camera.fx, v.camera.cy), (62.0, 21.25), "the principal point is honoured");
    }
    assert!(d.notes.iter().any(|n| n.contains("k/16")), "{:?}", d.notes);
    let wide = DataOptions { time_range: Some("0..17".parse().unwrap()), ..Default::default() };
    assert!((open(dir.path(), &wide).test[1].time.normalised - 8.0 / 17.0).abs() < 1e-6, "k/n as the reference");
    let named = DataOptions { time_from: TimeFrom::Name, ..Default::default() };
    assert_eq!(open(dir.path(), &named).train[0].time.normalised, 0.0, "by number, the training span is 0..1");
    let inner = open(&dir.path().join("dense"), &DataOptions::default());
    assert_eq!((inner.layout, inner.dynamic), ("colmap", false));
}

/// Points that frames 1, 9 and nobody saw.
#[test]
fn points_that_were_seen_after_the_boundary_alone_are_left_out() {
    let dir = capture(17);
    let write = |tracks: [&[u32]; 3]| {
        let mut points = 3u64.to_le_bytes().to_vec();
        for (k, track) in tracks.into_iter().enumerate() {
            points.extend((k as u64).to_le_bytes());
            points.extend([k as f64, 0.5, -1.0].map(f64::to_le_bytes).concat());
            points.extend([0, 128, 255]);
            points.extend(0.25f64.to_le_bytes());
            points.extend((track.len() as u64).to_le_bytes());
            points.extend(track.iter().flat_map(|image| [*image, 7].map(u32::to_le_bytes).concat()));
        }
        std::fs::write(dir.path().join("dense/sparse/points3D.bin"), points).unwrap();
    };
    write([&[2, 10], &[10], &[]]);
    let whole = open(dir.path(), &DataOptions::default());
    let half = open(dir.path(), &DataOptions { time_boundary: Some(0.5), ..Default::default() });
    assert_eq!(whole.points.unwrap().positions.len(), 3);
    assert!(half.train.iter().any(|v| v.name == "001") && half.extrapolate.iter().any(|v| v.name == "009"));
    assert_eq!(half.points.unwrap().positions, [glam::Vec3::new(0.0, 0.5, -1.0)]);
    assert!(half.notes.iter().any(|n| n.contains("2 of 3 points")), "{:?}", half.notes);
    write([&[]; 3]);
    let half = open(dir.path(), &DataOptions { time_boundary: Some(0.5), ..Default::default() });
    assert_eq!(half.points.unwrap().positions.len(), 3);
    assert!(half.notes.iter().any(|n| n.contains("does not say which images saw its points")), "{:?}", half.notes);
}

#[test]
fn images_become_those_of_the_pinhole() {
    let dir = capture(3);
    let d = open(dir.path(), &DataOptions { hold_out: 0, ..Default::default() });
    for v in &d.train {
        let lens = v.lens.unwrap();
        let c = &v.camera;
        let straight = ImageCache::new(0, 1.0).get(v).unwrap();
        let mut worst = 0;
        for k in 0..40 {
            let at = DVec2::new(7.5 + f64::from(k % 8) * 6.0, 5.5 + f64::from(k / 8) * 6.0);
            let p = DVec2::new((at.x - c.cx) / c.fx, (at.y - c.cy) / c.fy);
            let want = bend(p) * DVec2::new(c.fx, c.fy) + DVec2::new(c.cx, c.cy);
            assert!((lens.source_pixel(c, at) - want).length() < 1e-9);
            let back = lens.undistort(bend(p)).unwrap();
            assert!(((back - p) * c.fx).length() < 1e-3, "projected and back, in pixels");
            let got = straight.pixel(at.x as usize, at.y as usize)[0];
            worst = worst.max((f64::from(got) - paint(at)).abs() as u32);
        }
        assert!(worst <= 2, "{worst} of 255 off the pinhole's picture");
    }
}
