//! Training cameras that are not quite right: corrections are found, and are state like any other.

use glam::{DQuat, DVec3};
use gs_core::{Camera, Rng};
use gs_data::{Dataset, ImageCache, Split};
use gs_physics::kabsch::kabsch;
use gs_synth::SynthOptions;
use gs_synth::avatar::{self, AvatarOptions};
use gs_train::evaluate::{EvalReport, evaluate};
use gs_train::registry::overlay;
use gs_train::saved;
use gs_train::testkit::{SHORT_FILM, on_ranks, run, start, thread_difference, timeless};
use gs_train::trainer::Trainer;
use std::sync::Arc;

const REFINE: &str = "cameras.refine = true";

/// Training cameras turned by 0.5° about random axes, and shifted by 1 % of their distance from the origin. Their focal lengths are
/// off by a factor of `1 ± focal`.
fn disturbed(data: &Dataset, focal: f64, seed: u64) -> Arc<Dataset> {
    let mut noisy = data.clone();
    for view in &mut noisy.train {
        let mut rng = Rng::new(seed, "camera noise", 0, view.camera_id.into());
        let mut direction = || DVec3::from_array(std::array::from_fn(|_| rng.normal().into())).normalize();
        let (turn, shift) = (direction() * 0.5f64.to_radians(), direction() * 0.01 * view.camera.position().length());
        let factor = if rng.normal() > 0.0 { 1.0 + focal } else { 1.0 - focal };
        view.camera = view.camera.moved(turn, shift);
        (view.camera.fx, view.camera.fy) = (factor * view.camera.fx, factor * view.camera.fy);
    }
    Arc::new(noisy)
}

/// Errors of poses once the world is brought to that of the truth by rotation, scale and shift.
struct PoseError {
    /// Root mean square of the angles, degrees.
    turn: f64,
    /// Root mean square of the distances of camera centres, as shares of the distance from the origin.
    shift: f64,
    /// Root mean square of how far points within a unit of the origin lie from their true place in the images, pixels.
    pixels: f64,
    /// Root mean square of the errors of focal lengths, as shares of them.
    focal: f64,
}

impl PoseError {
    fn of(cameras: &[Camera], truth: &[Camera]) -> Self {
        let count = cameras.len() as f64;
        // Camera centres, and the points that cameras look at.
        let points = |c: &Camera, like: &Camera| {
            let depth = like.to_camera(DVec3::ZERO).z;
            [c.position(), c.position() + c.forward() * depth]
        };
        let pairs: Vec<(DVec3, DVec3)> =
            cameras.iter().zip(truth).flat_map(|(c, t)| points(c, t).into_iter().zip(points(t, t))).collect();
        let world = kabsch(&pairs, None).rotation;
        let mean = |of: fn(&(DVec3, DVec3)) -> DVec3| pairs.iter().map(of).sum::<DVec3>() / pairs.len() as f64;
        let (from, to) = (world * mean(|p| p.0), mean(|p| p.1));
        let along: f64 = pairs.iter().map(|(p, q)| (world * *p - from).dot(*q - to)).sum();
        let scale = along / pairs.iter().map(|(p, _)| (world * *p - from).length_squared()).sum::<f64>();
        let mut squares = [0.0; 4];
        for (camera, truth) in cameras.iter().zip(truth) {
            let rotation = camera.rotation * world.transpose();
            let position = scale * (world * camera.position() - from) + to;
            let aligned = Camera { rotation, translation: -(rotation * position), ..camera.clone() };
            squares[0] += DQuat::from_mat3(&(truth.rotation.transpose() * rotation)).to_scaled_axis().length_squared();
            squares[1] += (position - truth.position()).length_squared() / truth.position().length_squared();
            let pixel = |c: &Camera, p: DVec3| c.to_pixel(c.to_camera(p));
            let points = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|p| [p, -p]);
            squares[2] += points.map(|p| pixel(&aligned, p).distance_squared(pixel(truth, p))).sum::<f64>() / 6.0;
            squares[3] += (camera.fx / truth.fx - 1.0).powi(2);
        }
        let [turn, shift, pixels, focal] = squares.map(|sum| (sum / count).sqrt());
        Self { turn: turn.to_degrees(), shift, pixels, focal }
    }
}

/// What a training on some data came to.
struct Outcome {
    scores: EvalReport,
    error: PoseError,
}

impl Outcome {
    fn psnr(&self) -> f64 {
        self.scores.mean.psnr.expect("finite")
    }
}

/// Trains a method, preset `tiny` with changes, to the end, and scores the held-out views.
fn train(method: &str, data: &Arc<Dataset>, truth: &Dataset, over: &[&str], seed: u64) -> Outcome {
    let config = gs_train::testkit::config(gs_methods::registry(), method, "tiny", over);
    let mut trainer = start(gs_methods::registry(), data, method, &config, seed);
    let steps = trainer.steps();
    run(&mut trainer, steps);
    let model = trainer.model();
    let images = ImageCache::new(64 << 20, 1.0);
    let scores = evaluate(model, data, Split::Test, model.background(), &images).expect("scores");
    let correct = |view| model.cameras().of(view).unwrap_or_default().apply(&view.camera);
    let cameras: Vec<Camera> = data.train.iter().map(correct).collect();
    let true_cameras: Vec<Camera> = truth.train.iter().map(|view| view.camera.clone()).collect();
    Outcome { scores, error: PoseError::of(&cameras, &true_cameras) }
}

fn scene(name: &str, size: u32, views: u32, seed: u64) -> Arc<Dataset> {
    let options = SynthOptions { seed, supersample: 4, ..SynthOptions::of_views(size, views, 6) };
    Arc::new(gs_synth::generate(name, &options).expect("scene").dataset)
}

#[test]
fn disturbed_cameras_are_found_again() {
    let truth = scene("static", 64, 30, 0);
    let noisy = disturbed(&truth, 0.0, 0);
    let longer = "schedule.stages.all.steps = 600";
    let [right, wrong] = [&truth, &noisy].map(|data| train("static3d", data, &truth, &[longer], 0));
    let refined = train("static3d", &noisy, &truth, &[longer, REFINE], 0);
    assert!(refined.error.pixels < 0.4 * wrong.error.pixels, "{} {}", refined.error.pixels, wrong.error.pixels);
    assert!(refined.psnr() > wrong.psnr() + 0.5 * (right.psnr() - wrong.psnr()), "half of what was lost is back");
    let cameras = refined.scores.cameras.as_ref().expect("the scores say that cameras were refined");
    assert!(cameras.count == 30 && cameras.turn > 0.1 && cameras.shift > 0.0 && cameras.focal == 0.0);
    assert!(refined.scores.views.iter().all(|v| v.camera.is_some()) && right.scores.cameras.is_none());
}

/// Short runs with all kinds of corrections, of a cloud and of anchors.
fn short(method: &str) -> toml::Table {
    let over = [REFINE, "cameras.focal = true", "schedule.batch = 3"];
    gs_train::testkit::short(gs_methods::registry(), method, &over)
}

#[test]
fn corrections_are_the_same_bits_for_any_threads_and_ranks_and_after_a_resume() {
    let data = disturbed(&scene("balls", 32, 7, 0), 0.0, 0);
    let registry = gs_methods::registry();
    for method in ["fourdgs", "scaffold"] {
        let begin = || start(registry, &data, method, &short(method), 3);
        assert_eq!(thread_difference(begin, 40), 0.0, "{method}");
        let mut whole = begin();
        run(&mut whole, 20);
        let half = whole.state();
        run(&mut whole, 20);
        let end = timeless(whole.state());
        for block in ["cameras.turn", "cameras.shift", "cameras.focal"] {
            assert!(end.tensor(block).expect("kept").iter().any(|v| *v != 0.0), "{method}: {block} learns");
        }
        let mut resumed = Trainer::resume(registry, data.clone(), &half, None, 1 << 20).expect("resume");
        run(&mut resumed, 20);
        assert!(timeless(resumed.state()) == end, "{method}: resumed");
        for ranks in [2, 3] {
            let ended = on_ranks(registry, &data, begin(), ranks, |mut trainer| {
                run(&mut trainer, 40);
                trainer.gather().expect("state");
                timeless(trainer.state())
            });
            assert!(ended == end, "{method}: {ranks} ranks");
        }
    }
}

/// Of clouds, anchors and particles in a first stage, of a filmed person in all of them.
#[test]
fn every_method_learns_corrections() {
    let registry = gs_methods::registry();
    let balls = scene("balls", 32, 7, 0);
    let (template, rings, points) = ("builtin:cylinder".into(), 1, 4000);
    let options = AvatarOptions { template, size: 32, frames: 2, rings, points, ..AvatarOptions::default() };
    let film = Arc::new(avatar::generate(&options).expect("film"));
    for entry in registry {
        let (data, config) = if entry.needs_avatar {
            (&film, gs_train::testkit::config(registry, entry.name, "tiny", &[SHORT_FILM, REFINE]))
        } else {
            (&balls, gs_train::testkit::short(registry, entry.name, &[REFINE]))
        };
        let mut trainer = start(registry, data, entry.name, &config, 3);
        // The images of a film count in its last stage.
        let steps = if entry.needs_avatar { trainer.steps() } else { 10 };
        run(&mut trainer, steps);
        let state = trainer.state();
        let turns = state.tensor("cameras.turn").expect("kept");
        let found = turns.iter().all(|v| v.is_finite()) && turns.iter().any(|v| *v != 0.0);
        assert!(found, "{}: {turns:?}", entry.name);
    }
}

#[test]
fn images_of_a_resting_camera_share_a_correction() {
    let options = SynthOptions { size: 32, cameras: 3, held_out: 1, moments: 4, ..SynthOptions::default() };
    let film = Arc::new(gs_synth::generate("balls", &options).expect("scene").dataset);
    let registry = gs_methods::registry();
    let mut trainer = start(registry, &film, "fourdgs", &short("fourdgs"), 1);
    let cameras = trainer.model().cameras();
    assert_eq!((film.train.len() % 3, cameras.known().len()), (0, 3));
    assert!(film.train.iter().all(|view| cameras.row(view) == Some(view.camera_id as usize)));
    assert!(film.test.iter().all(|view| cameras.row(view).is_none()));
    run(&mut trainer, 30);
    let images = ImageCache::new(1 << 20, 1.0);
    let scores = evaluate(trainer.model(), &film, Split::Test, [0.0; 3], &images).expect("scores");
    let first = scores.views[0].camera.expect("placed");
    assert!(first != Default::default() && scores.views.iter().all(|v| v.camera == Some(first)), "placed together");
    // A scene that is loaded knows its cameras, and keeps their corrections when these are to learn no more.
    let mut still = short("fourdgs");
    overlay(&mut still, "cameras.refine = false".parse().expect("TOML"));
    let loaded = saved::load(registry, &trainer.state(), Some(&still)).expect("loads");
    let learnt = trainer.model().cameras().correction(1);
    assert!(learnt != Default::default() && loaded.model.cameras().correction(1) == learnt);
    let mut resumed = Trainer::resume(registry, film.clone(), &trainer.state(), Some(&still), 1 << 20).expect("resume");
    run(&mut resumed, 10);
    assert_eq!(resumed.model().cameras().correction(1), learnt);
}

#[test]
fn cameras_rest_unless_they_are_told_to_learn() {
    let data = scene("static", 16, 3, 0);
    let config = gs_train::testkit::config(gs_methods::registry(), "static3d", "tiny", &[]);
    let mut trainer = start(gs_methods::registry(), &data, "static3d", &config, 1);
    run(&mut trainer, 2);
    trainer.model().visit(&mut |p| assert!(!p.name.starts_with("cameras."), "{}", p.name));
    assert!(trainer.model().cameras().is_empty() && trainer.state().meta.get("corrected_cameras").is_none());
    let images = ImageCache::new(1 << 20, 1.0);
    let scores = evaluate(trainer.model(), &data, Split::Test, [0.0; 3], &images).expect("scores");
    assert!(scores.cameras.is_none() && scores.views.iter().all(|v| v.camera.is_none()));
}

/// What a training on true cameras, on disturbed ones, and with either refined came to. True cameras that are refined show what
/// placing the held-out cameras brings, and how far the images draw right poses away.
fn compare(label: &str, method: &str, truth: &Arc<Dataset>, over: &[&str], focal: f64, seed: u64) -> [Outcome; 4] {
    let noisy = disturbed(truth, focal, seed);
    let learn = if focal > 0.0 { "cameras = { refine = true, focal = true }" } else { REFINE };
    let all = [(truth, ""), (truth, learn), (&noisy, ""), (&noisy, learn)]
        .map(|(data, learn)| train(method, data, truth, &[over, &[learn]].concat(), seed));
    for (name, o) in ["true", "true, refined", "disturbed", "disturbed, refined"].iter().zip(&all) {
        let PoseError { turn, shift, pixels, focal } = o.error;
        let [shift, focal] = [shift, focal].map(|share| 100.0 * share);
        println!("| {label} | {seed} | {name} | {:.2} | {turn:.2} | {shift:.2} | {focal:.2} | {pixels:.2} |", o.psnr());
    }
    all
}

/// 2000 steps and more splats.
const LONGER: &str = "
[schedule]
stages.all.steps = 2000
lr.cloud.means.steps = 2000
density.until = 1000
density.max_splats = 6000
";

const ANTIALIAS: &str = "schedule.antialias = true";

/// A table of `docs/guide/data.md`.
#[test]
#[ignore = "minutes: cargo test -p gs-train --test train cameras:: -- --ignored --nocapture"]
fn the_table_of_disturbed_cameras() {
    // What is left of the error in the images, and of the loss of PSNR, at most.
    let cases = [
        ("poses", "", 0.0, 0.2, 0.3),
        ("poses, antialias", ANTIALIAS, 0.0, 0.2, 0.7),
        ("poses and focal lengths", "", 0.01, 0.33, 0.3),
    ];
    for (label, over, focal, share, less) in cases {
        for seed in 0..3 {
            let truth = scene("static", 128, 40, seed);
            let [right, _, wrong, refined] = compare(label, "static3d", &truth, &[LONGER, over], focal, seed);
            assert!(refined.error.pixels < share * wrong.error.pixels);
            assert!(refined.psnr() > right.psnr() - less);
        }
    }
}

/// Another: films of resting cameras around something that moves.
#[test]
#[ignore = "minutes: cargo test -p gs-train --test train cameras:: -- --ignored --nocapture"]
fn the_table_of_disturbed_films() {
    let longer = "[schedule]\nstages.fine.steps = 1800\nlr.cloud.means.steps = 1800\nlr.field.all.steps = 1800\n\
                  lr.field.planes.steps = 1800";
    // The share of the lost PSNR that is back, at least.
    let cases = [
        ("sheet", "sheet", "", 0.9),
        ("sheet", "sheet, antialias", ANTIALIAS, 0.9),
        ("balls", "balls", "", 0.9),
        ("balls", "balls, antialias", ANTIALIAS, 0.6),
    ];
    for (name, label, over, share) in cases {
        for seed in 0..3 {
            let options =
                SynthOptions { size: 96, cameras: 8, held_out: 2, moments: 24, seed, ..SynthOptions::default() };
            let options = SynthOptions { boundary: 1.0, variant: 3, ..options };
            let films = Arc::new(gs_synth::generate(name, &options).expect("scene").dataset);
            let [right, _, wrong, refined] = compare(label, "fourdgs", &films, &[longer, over], 0.0, seed);
            let [right, wrong, refined] = [right, wrong, refined].map(|o| o.psnr());
            assert!(refined - wrong > share * (right - wrong));
        }
    }
}
