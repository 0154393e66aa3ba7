//! The readers on real captures. The captures are not part of the repository: each test says so and passes when its
//! folder is absent (`GS4D_SHARED`, else `../shared` beside the workspace).

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec2, DVec3};
use gs_core::Camera;
use gs_data::{DataOptions, Dataset, ImageCache, ImageU8, View, detect};

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

/// The same five images by `poses_bounds.npy` and by the COLMAP model: one rig, up to the similarity between the two worlds.
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
    assert!(llff.iter().zip(&colmap).all(|(a, b)| a.image == b.image), "the same images");
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
    // Any other pairing of rows and images is far off.
    let mut turned = rig(&colmap);
    turned.rotate_left(1);
    let wrong = residuals(&rig(&llff), &turned);
    assert!(wrong.centre > 10.0 * fit.centre && wrong.degrees > 10.0 * fit.degrees, "{wrong:?}");
}

#[test]
fn panoptic_basketball() {
    let Some(dir) = capture("panoptic_basketball_f040-069") else { return };
    let d = Dataset::open(&dir, &DataOptions { test_cameras: vec![1, 14], ..Default::default() }).unwrap();
    assert_eq!((d.layout, d.train.len(), d.test.len(), d.dynamic), ("panoptic", 870, 60, true));
    assert!(d.test.iter().all(|v| v.mask.is_some()), "cameras 1 and 14 are masked");
    assert!((d.scene_extent() - 3.4).abs() < 0.1, "{}", d.scene_extent());
    let [low, high] = d.scene_bounds();
    assert!(
        (0.5 * (low + high) - glam::Vec3::new(0.0, -1.3, 0.0)).length() < 0.1 && (high.x - low.x - 6.1).abs() < 0.2
    );
    let cache = ImageCache::new(0, 0.5);
    let mask = cache.mask(&d.test[0]).unwrap().unwrap();
    let part = mask.data.iter().sum::<f32>() / mask.data.len() as f32;
    assert!(mask.shape() == (320, 180, 1) && part > 0.02 && part < 0.3, "{part}");
    let cloud = d.initial_points(4000, 0).unwrap();
    let people = &cloud.positions[..2000];
    let mean: glam::Vec3 = people.iter().sum::<glam::Vec3>() / 2000.0;
    println!("hull of the people: mean {mean}");
    // The floor is at y = 0, y points down; players are less than 2.5 m tall with arms raised.
    let inside = people.iter().filter(|p| p.y > -2.6 && p.y < 0.3 && p.x.hypot(p.z) < 2.6).count();
    assert!(inside > 1900, "{inside} of 2000 points where players can be");
}

/// The pixel convention, by the pictures alone: the ball (red, in free flight in frames 50 to 66) is found in all views and
/// triangulated. Cameras stand all around it, so pixel centres that are off by a constant leave that constant in the mean
/// residual along x. Centres at +½ leave less than 0.2 pixels, centres at whole numbers 0.4.
#[test]
fn panoptic_future() {
    let Some(dir) = capture("panoptic_basketball_f040-069") else { return };
    let whole = Dataset::open(&dir, &DataOptions::default()).unwrap();
    let o = DataOptions { time_boundary: Some(0.75), ..Default::default() };
    let d = Dataset::open(&dir, &o).unwrap();
    // 30 frames: numbers 0 to 21 lie within 0.75 · 29.
    let per_frame = [whole.train.len() / 30, whole.test.len() / 30];
    assert_eq!([d.train.len(), d.test.len()], per_frame.map(|n| 22 * n));
    assert_eq!(d.extrapolate.len(), 8 * (per_frame[0] + per_frame[1]));
    let last = d.train.iter().map(|v| v.time.normalised).fold(0.0, f32::max);
    assert!((f64::from(last) - 21.0 / 29.0).abs() < 1e-6, "{last}");
    assert_eq!(d.extrapolate.iter().map(|v| v.time.normalised).fold(0.0, f32::max), 1.0);
}

#[test]
fn panoptic_pixel_centres_are_at_one_half() {
    let Some(dir) = capture("panoptic_basketball_f040-069") else { return };
    let track = std::fs::read_to_string(dir.join("derived_ball_track.csv")).unwrap();
    let options = DataOptions { first_frame: 10, frame_count: 17, ..Default::default() };
    let d = Dataset::open(&dir, &options).unwrap();
    let cache = ImageCache::new(0, 1.0);
    let (mut half, mut whole) = (Vec::new(), Vec::new());
    for line in track.lines().filter(|l| l.starts_with(['5', '6'])) {
        let row: Vec<f64> = line.split(',').map(|v| v.parse().unwrap()).collect();
        let start = DVec3::new(row[1], row[2], row[3]);
        let frame = format!("_{:06}", row[0] as u32);
        let seen: Vec<(&Camera, DVec2)> = d
            .train
            .iter()
            .filter(|v| v.name.ends_with(&frame))
            .filter_map(|v| Some((&v.camera, ball(&cache.get(v).unwrap(), &v.camera, start)?)))
            .collect();
        if seen.len() >= 6 {
            half.extend(residuals_x(&seen, start, 0.5));
            whole.extend(residuals_x(&seen, start, 0.0));
        }
    }
    let mean = |r: &[f64]| r.iter().sum::<f64>() / r.len() as f64;
    println!(
        "{} sightings; mean residual along x: {:+.3} px at +1/2, {:+.3} px at whole numbers",
        half.len(),
        mean(&half),
        mean(&whole)
    );
    assert!(half.len() > 200 && mean(&half).abs() < 0.2 && mean(&whole) < -0.3, "{} {}", mean(&half), mean(&whole));
}

/// Mean index of the ball's pixels around where it should be; none unless all of a round red blob is in sight.
fn ball(image: &ImageU8, c: &Camera, near: DVec3) -> Option<DVec2> {
    let p = c.to_camera(near);
    let (at, reach) = (c.to_pixel(p), 1.6 * 0.12 * c.fx / p.z);
    let low = at - DVec2::splat(reach);
    let high = at + DVec2::splat(reach);
    if low.min_element() < 0.0 || high.x > f64::from(c.width) || high.y > f64::from(c.height) {
        return None;
    }
    let (mut sum, mut count, mut rim) = (DVec2::ZERO, 0.0, 0);
    let (mut first, mut last) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for j in low.y as usize..high.y as usize {
        for i in low.x as usize..high.x as usize {
            let [r, g, b, _] = image.pixel(i, j).map(f64::from);
            let index = DVec2::new(i as f64, j as f64);
            let away = (index + DVec2::splat(0.5) - at).length();
            if away < reach && r > 60.0 && r > 1.6 * g && r > 1.6 * b {
                (sum, count, first, last) = (sum + index, count + 1.0, first.min(index), last.max(index));
                rim += u32::from(away > reach - 1.5);
            }
        }
    }
    let size = last - first + DVec2::ONE;
    let round = (size.x - size.y).abs() < 0.2 * size.max_element() && count > 0.7 * 0.785 * size.x * size.y;
    (count > 50.0 && rim <= 3 && round).then(|| sum / count)
}

/// Residuals along x of the point nearest to all sightings, whose pixel centres lie at `index + offset`.
fn residuals_x(seen: &[(&Camera, DVec2)], start: DVec3, offset: f64) -> Vec<f64> {
    let mut at = start;
    let residual = |c: &Camera, index: DVec2, at: DVec3| index + DVec2::splat(offset) - c.to_pixel(c.to_camera(at));
    for _ in 0..8 {
        let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
        for (c, index) in seen {
            let r = residual(c, *index, at);
            let p = c.to_camera(at);
            let turn = c.rotation.transpose();
            for (row, r) in
                [(DVec3::new(c.fx, 0.0, -c.fx * p.x / p.z), r.x), (DVec3::new(0.0, c.fy, -c.fy * p.y / p.z), r.y)]
            {
                let g = turn * (row / p.z);
                a += DMat3::from_cols(g * g.x, g * g.y, g * g.z);
                b += g * r;
            }
        }
        at += a.inverse() * b;
    }
    seen.iter().map(|(c, index)| residual(c, *index, at)).filter(|r| r.length() < 4.0).map(|r| r.x).collect()
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
