//! Films of a generated scene, imported by the real programs, held against the true cameras.

use glam::{DMat3, DVec2, DVec3};
use gs_core::Camera;
use gs_data::{DataOptions, Dataset, Lens, View};
use gs_physics::kabsch::kabsch;
use gs4d_import::testkit::{FPS, arc, has, picture, through, write_video};
use gs4d_import::{CameraModel, Event, Imported, Rig, Settings, Source, import};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

const SIZE: [u32; 2] = [320, 240];

/// Whether the programs are there; says so if not.
fn programs(test: &str) -> bool {
    let all = has("ffmpeg", "-version") && has("colmap", "help");
    if !all {
        println!("SKIPPED {test}: ffmpeg and colmap are not both installed");
    }
    all
}

/// Writes a video; frame `k` is taken at `begin + k / FPS` by the camera of that frame.
fn film(path: &Path, begin: f64, frames: usize, camera: impl Fn(usize) -> Camera + Sync) -> PathBuf {
    let at = |k: usize| picture(&camera(k), begin + k as f64 / f64::from(FPS));
    write_video(path, &(0..frames).into_par_iter().map(at).collect::<Vec<_>>()).unwrap();
    path.to_path_buf()
}

fn imported(videos: Vec<PathBuf>, data: &Path, settings: &Settings) -> Imported {
    let tell = &mut |event: Event<'_>| {
        if let Event::Say(text) = event {
            println!("{text}");
        }
    };
    let done = import(data, &Source::Videos(videos), settings, false, Some(2), &AtomicBool::new(false), tell).unwrap();
    println!(
        "{} frames, {} points, reprojection {:?}, spread {:?}",
        done.frames, done.points, done.reprojection, done.spread
    );
    done
}

/// Errors of poses after the similarity that fits them best to the truth: angle, degrees; distance, share of the mean
/// distance of the cameras from what they look at; focal length, share.
struct Errors {
    angle: f64,
    distance: f64,
    focal: f64,
}

fn errors(pairs: &[(Camera, Camera)]) -> Errors {
    let axes = |c: &Camera| {
        let r = c.rotation.transpose();
        [r.x_axis, r.y_axis, r.z_axis]
    };
    let directions: Vec<(DVec3, DVec3)> = pairs.iter().flat_map(|(a, b)| axes(a).into_iter().zip(axes(b))).collect();
    // About the origin: directions have no place.
    let both: Vec<(DVec3, DVec3)> = directions.iter().flat_map(|&(a, b)| [(a, b), (-a, -b)]).collect();
    let rotation: DMat3 = kabsch(&both, None).rotation;
    let mean = |side: fn(&(Camera, Camera)) -> &Camera| {
        pairs.iter().map(|p| side(p).position()).sum::<DVec3>() / pairs.len() as f64
    };
    let (p0, q0) = (mean(|p| &p.0), mean(|p| &p.1));
    let moved = |c: &Camera| rotation * (c.position() - p0);
    let (over, under) = pairs
        .iter()
        .fold((0.0, 0.0), |(o, u), (a, b)| (o + moved(a).dot(b.position() - q0), u + moved(a).length_squared()));
    let scale = over / under;
    let mut worst = Errors { angle: 0.0, distance: 0.0, focal: 0.0 };
    for (a, b) in pairs {
        let turn = b.rotation * rotation * a.rotation.transpose();
        let cos = 0.5 * (turn.x_axis.x + turn.y_axis.y + turn.z_axis.z - 1.0);
        worst.angle = worst.angle.max(cos.clamp(-1.0, 1.0).acos().to_degrees());
        worst.distance = worst.distance.max((scale * moved(a)).distance(b.position() - q0) / 4.0);
        worst.focal = worst.focal.max((a.fx / b.fx - 1.0).abs());
    }
    println!(
        "worst of {} poses: {:.3} degrees, {:.3} % of the distance, focal length {:.2} %",
        pairs.len(),
        worst.angle,
        100.0 * worst.distance,
        100.0 * worst.focal
    );
    worst
}

fn views(data: &Path) -> Vec<View> {
    let data = Dataset::open(data, &DataOptions::default()).unwrap();
    let mut all: Vec<View> = data.train.into_iter().chain(data.val).chain(data.test).collect();
    all.sort_by(|a, b| a.name.cmp(&b.name));
    all
}

/// Films by `n` cameras at rest, the last of which begins `late` frames later.
fn rig(dir: &Path, n: usize, degrees: f64, frames: usize, late: f64) -> (Vec<PathBuf>, Vec<Camera>) {
    let cameras: Vec<Camera> = (0..n).map(|k| arc(k as f64, n as f64, degrees, SIZE)).collect();
    let begin = |k: usize| if k + 1 == n { late / f64::from(FPS) } else { 0.0 };
    let name = |k: usize| dir.join(format!("-film {k}%d.mp4"));
    let videos = cameras.iter().enumerate().map(|(k, c)| film(&name(k), begin(k), frames, |_| c.clone())).collect();
    (videos, cameras)
}

fn rig_errors(data: &Path, truth: &[Camera]) -> Errors {
    let all = views(data);
    let of = |k: usize| all.iter().find(|v| v.camera_id as usize == k).unwrap().camera.clone();
    errors(&truth.iter().enumerate().map(|(k, c)| (of(k), c.clone())).collect::<Vec<_>>())
}

#[test]
#[ignore = "COLMAP takes a minute: cargo test -p gs4d-import --test films -- --ignored --nocapture"]
fn six_cameras_at_rest() {
    if !programs("six_cameras_at_rest") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let (videos, cameras) = rig(dir.path(), 6, 75.0, 52, 4.4);
    let data = dir.path().join("data");
    let done = imported(videos, &data, &Settings { moments: Some(2), ..Settings::default() });
    assert_eq!((done.rig, done.held_out.is_some()), (Rig::Fixed, true));
    // The film of the last camera begins 4.4 frames later, so it shows earlier what the first one shows.
    let offset = done.cameras[5].offset.expect("a clock that is known");
    assert!((offset + 4.4 / f64::from(FPS)).abs() < 0.5 / f64::from(FPS), "{offset}");
    let worst = rig_errors(&data, &cameras);
    assert!(worst.angle < 0.5 && worst.distance < 0.01);
}

#[test]
#[ignore = "COLMAP takes a minute: cargo test -p gs4d-import --test films -- --ignored --nocapture"]
fn two_cameras_at_rest() {
    if !programs("two_cameras_at_rest") {
        return;
    }
    for degrees in [15.0, 30.0] {
        let dir = tempfile::tempdir().unwrap();
        let (videos, cameras) = rig(dir.path(), 2, degrees, 40, 0.0);
        let data = dir.path().join("data");
        let settings = Settings { fov: Some(0.9f64.to_degrees()), moments: Some(2), ..Settings::default() };
        let done = imported(videos, &data, &settings);
        assert_eq!((done.rig, done.cameras.len()), (Rig::Fixed, 2));
        let worst = rig_errors(&data, &cameras);
        assert!(worst.angle < 0.5 && worst.distance < 0.01);
    }
}

#[test]
#[ignore = "COLMAP takes minutes: cargo test -p gs4d-import --test films -- --ignored --nocapture"]
fn one_moving_camera() {
    if !programs("one_moving_camera") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let path = |k: usize| arc(k as f64 / 10.0, 6.0, 60.0, SIZE);
    let video = film(&dir.path().join("walk.mp4"), 0.0, 52, path);
    let data = dir.path().join("data");
    let settings = Settings { keyframes: 18, ..Settings::default() };
    let done = imported(vec![video], &data, &settings);
    assert_eq!(done.rig, Rig::Moving);
    assert!(done.frames >= 50, "{} of 52 frames", done.frames);
    let pairs: Vec<(Camera, Camera)> = views(&data)
        .into_iter()
        .map(|v| (v.camera, path((v.time.seconds * f64::from(FPS)).round() as usize)))
        .collect();
    let worst = errors(&pairs);
    assert!(worst.angle < 0.5 && worst.distance < 0.01);
}

/// Angle, degrees, by which rays of the corners and of the middles of the edges of a distorted image differ at most from the true ones.
fn lens_error(found: &View, camera: &Camera, lens: &Lens) -> f64 {
    let ray = |c: &Camera, lens: &Lens, at: DVec2| {
        let p = lens.pinhole_pixel(c, at.x, at.y).unwrap();
        DVec3::new((p.x - c.cx) / c.fx, (p.y - c.cy) / c.fy, 1.0)
    };
    let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
    let grid = (0..9).map(|k| DVec2::new(f64::from(k % 3), f64::from(k / 3)) * 0.5 * size);
    let own = found.lens.unwrap_or_default();
    let angle = |at| ray(&found.camera, &own, at).angle_between(ray(camera, lens, at)).to_degrees();
    grid.map(angle).fold(0.0, f64::max)
}

/// Twenty frames of a camera that moves, through a lens. `fov` is the `--fov` of the import, degrees.
fn film_through(model: CameraModel, lens: &Lens, fov: Option<f64>) {
    if !programs(model.name()) {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let path = |k: usize| arc(k as f64 / 4.0, 6.0, 60.0, SIZE);
    let frame = |k: usize| through(lens, &path(k), k as f64 / f64::from(FPS));
    let (video, data) = (dir.path().join("walk.mp4"), dir.path().join("data"));
    write_video(&video, &(0..20).into_par_iter().map(frame).collect::<Vec<_>>()).unwrap();
    let settings = Settings { rig: Some(Rig::Moving), model: Some(model), fov, ..Settings::default() };
    assert!(imported(vec![video], &data, &settings).frames >= 18);
    let all = views(&data);
    let number = |v: &View| (v.time.seconds * f64::from(FPS)).round() as usize;
    let worst = errors(&all.iter().map(|v| (v.camera.clone(), path(number(v)))).collect::<Vec<_>>());
    let bent = lens_error(&all[0], &path(number(&all[0])), lens);
    println!("{}: rays of the lens within {bent:.3} degrees", model.name());
    assert!(worst.angle < 0.5 && worst.distance < 0.01 && bent < 0.3);
}

#[test]
#[ignore = "COLMAP takes minutes: cargo test -p gs4d-import --test films -- --ignored --nocapture"]
fn a_film_through_a_simple_lens() {
    film_through(CameraModel::SimpleRadial, &Lens { k1: -0.15, ..Lens::default() }, None);
}

#[test]
#[ignore = "COLMAP takes minutes: cargo test -p gs4d-import --test films -- --ignored --nocapture"]
fn a_film_through_a_lens_of_opencv() {
    let lens = Lens { k1: -0.2, k2: 0.05, p1: 0.004, p2: -0.003, ..Lens::default() };
    film_through(CameraModel::Opencv, &lens, None);
}

/// With the field of view that gives a fisheye without distortion the true focal length.
#[test]
#[ignore = "COLMAP takes minutes: cargo test -p gs4d-import --test films -- --ignored --nocapture"]
fn a_film_through_a_fisheye() {
    let lens = Lens { fisheye: true, k1: 0.05, k2: -0.01, ..Lens::default() };
    let fov = 2.0 * 0.45f64.tan();
    film_through(CameraModel::RadialFisheye, &lens, Some(fov.to_degrees()));
}
