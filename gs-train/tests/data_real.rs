//! The readers on real captures. The captures are not part of the repository: each test says so and passes when its
//! folder is absent (`GS4D_SHARED`, else `../shared` beside the workspace).

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec2, DVec3};
use gs_core::Camera;
use gs_train::data::{DataOptions, Dataset, ImageCache, View, detect};

fn capture(name: &str) -> Option<PathBuf> {
    gs_core::testkit::shared(&format!("data/{name}"))
}

#[test]
fn dnerf_mutant() {
    let Some(dir) = capture("dnerf_mutant_400") else { return };
    let d = Dataset::open(&dir, &DataOptions::default()).unwrap();
    assert_eq!((d.layout, d.train.len(), d.val.len(), d.test.len()), ("blender", 150, 20, 20));
    assert!(d.dynamic && d.has_alpha);
    assert_eq!((d.train[0].time.normalised, d.train[149].time.normalised), (0.0, 1.0));
    assert!((d.scene_extent() - 1.1 * 4.03).abs() < 0.7, "{}", d.scene_extent());
    let cache = ImageCache::new(64 << 20, 1.0);
    for v in d.train.iter().chain(&d.test).step_by(17) {
        assert_eq!((v.camera.width, v.camera.height), (400, 400));
        assert!((v.camera.position().length() - 4.031).abs() < 0.01);
        let image = cache.get(v).unwrap();
        let at = v.camera.to_pixel(v.camera.to_camera(DVec3::ZERO));
        assert!(image.pixel(at.x as usize, at.y as usize)[3] > 200, "the origin is inside every silhouette");
    }
    let cloud = d.initial_points(5000, 0).unwrap();
    let (low, high) =
        cloud.positions.iter().fold((glam::Vec3::MAX, glam::Vec3::MIN), |(l, h), p| (l.min(*p), h.max(*p)));
    println!("hull of the creature: {low} to {high}");
    // Known near t = 0.5: x -0.83..0.75, y -0.87..0.18, z -0.71..0.79.
    assert!(low.x < -0.7 && high.x > 0.6 && low.z < -0.6 && high.z > 0.6, "{low} {high}");
    assert!(low.min_element() > -1.29 && high.max_element() < 1.29, "smaller than the box: {low} {high}");
}

#[test]
fn fox() {
    let Some(dir) = capture("fox_270x480") else { return };
    let d = Dataset::open(&dir, &DataOptions::default()).unwrap();
    assert_eq!((d.layout, d.train.len(), d.test.len(), d.dynamic), ("nerfstudio", 43, 7, false));
    let v = &d.train[0];
    assert_eq!((v.camera.fx, v.camera.cy, v.lens.unwrap().k1), (343.88, 241.317, 0.0578421));
    let image = ImageCache::new(0, 0.5).get(v).unwrap();
    assert_eq!((image.width, image.height), (135, 240));
    println!("{}", d.notes.join("\n"));
}

/// The untouched file lists 67 frames at four times the size; 17 images are not there.
#[test]
fn fox_with_missing_images_and_other_sizes() {
    let Some(dir) = capture("fox_270x480") else { return };
    let copy = tempfile::tempdir().unwrap();
    std::fs::create_dir(copy.path().join("images")).unwrap();
    for entry in std::fs::read_dir(dir.join("images")).unwrap() {
        let from = entry.unwrap().path();
        std::fs::copy(&from, copy.path().join("images").join(from.file_name().unwrap())).unwrap();
    }
    std::fs::copy(dir.join("original_transforms_1080x1920.json"), copy.path().join("transforms.json")).unwrap();
    let e = Dataset::open(copy.path(), &DataOptions::default()).unwrap_err();
    assert_eq!(e.code(), "data.missing");
    let text = e.to_string();
    assert!(
        text.starts_with("17 of 67 images are missing: images/") && text.matches("images/").count() == 17,
        "{text}"
    );
    let d = Dataset::open(copy.path(), &DataOptions { allow_missing: true, ..Default::default() }).unwrap();
    assert_eq!(d.train.len() + d.test.len(), 50);
    let original = Dataset::open(&dir, &DataOptions::default()).unwrap();
    let (a, b) = (&d.train[5].camera, &original.train[5].camera);
    assert!((a.fx - b.fx).abs() < 1e-9 && (a.cx - b.cx).abs() < 1e-9 && (a.width, a.height) == (270, 480));
}

/// The model calls its images 3, 5, 0, 14, 8 (.jpg); the folder holds 1 to 5 (.png): they are paired in order of number.
#[test]
fn neu3d_colmap() {
    let Some(dir) = capture("neu3d_flame_steak_5view_llff_colmap") else { return };
    let options = DataOptions { hold_out: 0, layout: Some("colmap".into()), ..Default::default() };
    let d = Dataset::open(&dir, &options).unwrap();
    let pairs = "0.jpg is 1.png, 3.jpg is 2.png, 5.jpg is 3.png, 8.jpg is 4.png, 14.jpg is 5.png";
    assert!(d.notes.iter().any(|n| n.contains(pairs)), "{:?}", d.notes);
    // The pictures themselves say that the order is right: points land on their colours, in another order they do not.
    let paired = colour_error(&d);
    let other = renamed(&dir, ["3", "5", "0", "14", "8"]);
    let wrong = colour_error(&Dataset::open(other.path(), &options).unwrap());
    println!("median colour difference of projected points: {paired:.3}, in another order {wrong:.3}");
    assert!(paired < 0.07 && wrong > 1.5 * paired, "points land on their colours: {paired} against {wrong}");
}

/// The same five photographs by `poses_bounds.npy` and by the model: one rig, up to the similarity between the two worlds.
#[test]
fn neu3d_llff_agrees_with_colmap() {
    let Some(dir) = capture("neu3d_flame_steak_5view_llff_colmap") else { return };
    let read = |layout: &str| {
        let options = DataOptions { hold_out: 0, layout: Some(layout.into()), ..Default::default() };
        let d = Dataset::open(&dir, &options).unwrap();
        assert_eq!((d.layout, d.train.len(), d.dynamic), (layout, 5, false));
        let mut views = d.train;
        views.sort_by(|a, b| a.name.cmp(&b.name));
        views
    };
    assert_eq!(detect(&dir).unwrap().name, "colmap", "a model beside the poses is preferred, as before");
    let (llff, colmap) = (read("llff"), read("colmap"));
    assert!(llff.iter().zip(&colmap).all(|(a, b)| a.image == b.image), "the same photographs");
    let rig = |views: &[View]| views.iter().map(|v| v.camera.clone()).collect::<Vec<_>>();
    let fit = residuals(&rig(&llff), &rig(&colmap));
    println!(
        "LLFF against COLMAP: centres {:.2} % of the rig, rotations {:.3} degrees, focal lengths {:.2} %, principal points {:.2} px",
        100.0 * fit.centre,
        fit.degrees,
        100.0 * fit.focal,
        fit.principal
    );
    assert!(fit.centre < 0.02 && fit.degrees < 0.5 && fit.focal < 0.01 && fit.principal < 0.5, "{fit:?}");
    // Any other pairing of rows and photographs is far off.
    let mut turned = rig(&colmap);
    turned.rotate_left(1);
    let wrong = residuals(&rig(&llff), &turned);
    assert!(wrong.centre > 10.0 * fit.centre && wrong.degrees > 10.0 * fit.degrees, "{wrong:?}");
}

/// Largest differences of two rigs after the similarity between them is removed.
#[derive(Debug)]
struct Residuals {
    /// Distance of centres, as a part of the largest distance of a centre from the mean.
    centre: f64,
    /// Angle between rotations.
    degrees: f64,
    /// Relative difference of focal lengths.
    focal: f64,
    /// Distance of principal points, pixels.
    principal: f64,
}

/// The similarity takes `b` to `a`: the rotation nearest to the mean of `A_iᵀ B_i` (world-to-camera rotations), then scale
/// and shift of the centres by least squares.
fn residuals(a: &[Camera], b: &[Camera]) -> Residuals {
    let sum = a.iter().zip(b).fold(DMat3::ZERO, |m, (a, b)| m + a.rotation.transpose() * b.rotation);
    let mut turn = sum * (1.0 / a.len() as f64);
    for _ in 0..20 {
        turn = (turn + turn.inverse().transpose()) * 0.5;
    }
    let mean = |c: &[Camera]| c.iter().map(Camera::position).sum::<DVec3>() / c.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let arms: Vec<(DVec3, DVec3)> =
        a.iter().zip(b).map(|(a, b)| (a.position() - mean_a, turn * (b.position() - mean_b))).collect();
    let dot: f64 = arms.iter().map(|(p, q)| p.dot(*q)).sum();
    let scale = dot / arms.iter().map(|(_, q)| q.length_squared()).sum::<f64>();
    let size = arms.iter().map(|(p, _)| p.length()).fold(0.0, f64::max);
    let most = |values: Vec<f64>| values.into_iter().fold(0.0, f64::max);
    let both = || a.iter().zip(b);
    let angle = |(a, b): (&Camera, &Camera)| {
        let r = a.rotation * turn * b.rotation.transpose();
        (0.5 * (r.x_axis.x + r.y_axis.y + r.z_axis.z - 1.0)).clamp(-1.0, 1.0).acos().to_degrees()
    };
    Residuals {
        centre: most(arms.iter().map(|(p, q)| (*p - *q * scale).length() / size).collect()),
        degrees: most(both().map(angle).collect()),
        focal: most(both().map(|(a, b)| (a.fx / b.fx - 1.0).abs().max((a.fy / b.fy - 1.0).abs())).collect()),
        principal: most(both().map(|(a, b)| DVec2::new(a.cx - b.cx, a.cy - b.cy).length()).collect()),
    }
}

/// A copy of the capture with images 1 to 5 under other names.
fn renamed(dir: &Path, names: [&str; 5]) -> tempfile::TempDir {
    let copy = tempfile::tempdir().unwrap();
    for folder in ["images_4", "sparse/0"] {
        std::fs::create_dir_all(copy.path().join(folder)).unwrap();
    }
    for name in ["cameras", "images", "points3D"] {
        let file = format!("sparse/0/{name}.bin");
        std::fs::copy(dir.join(&file), copy.path().join(&file)).unwrap();
    }
    for (k, name) in names.iter().enumerate() {
        let from = dir.join(format!("images_4/{}.png", k + 1));
        std::fs::copy(from, copy.path().join(format!("images_4/{name}.png"))).unwrap();
    }
    copy
}

/// Median difference between the colours of points and of the pixels they project to.
fn colour_error(d: &Dataset) -> f32 {
    assert_eq!((d.layout, d.train.len(), d.dynamic), ("colmap", 5, false));
    let points = d.points.as_ref().unwrap();
    assert_eq!(points.positions.len(), 2137);
    assert!(d.notes.join("\n").contains("2692x2019 against 676x507"), "{:?}", d.notes);
    let cache = ImageCache::new(64 << 20, 1.0);
    let mut error = Vec::new();
    for v in &d.train {
        assert_eq!((v.camera.width, v.camera.height), (676, 507));
        let image = cache.get(v).unwrap();
        for (p, color) in points.positions.iter().zip(&points.colors) {
            let c = v.camera.to_camera(p.as_dvec3());
            let at: DVec2 = v.camera.to_pixel(c);
            if c.z > 0.0 && at.x > 0.0 && at.y > 0.0 && at.x < 676.0 && at.y < 507.0 {
                let got = image.pixel(at.x as usize, at.y as usize);
                error.push((0..3).map(|k| (f32::from(got[k]) / 255.0 - color[k]).abs()).sum::<f32>() / 3.0);
            }
        }
    }
    error.sort_by(f32::total_cmp);
    assert!(error.len() > 5000, "{} projections", error.len());
    error[error.len() / 2]
}
