//! Cameras whose clocks are early or late: offsets are found, and are state like any other.

use gs_core::Rng;
use gs_data::{Dataset, ImageCache, Split};
use gs_synth::SynthOptions;
use gs_train::evaluate::{EvalReport, evaluate};
use gs_train::registry::overlay;
use gs_train::testkit::{on_ranks, run, start, thread_difference, timeless};
use gs_train::trainer::{TrainOptions, Trainer};
use std::sync::Arc;

const TIME: &str = "cameras.time = true";

/// Films of fixed cameras.
fn films(name: &str, options: SynthOptions) -> Arc<Dataset> {
    Arc::new(gs_synth::generate(name, &SynthOptions { boundary: 1.0, ..options }).expect("scene").dataset)
}

/// Offsets of the clocks of cameras, normalised time, with mean zero.
fn offsets(cameras: usize, size: f32, seed: u64) -> Vec<f32> {
    let mut rng = Rng::new(seed, "clock noise", 0, 0);
    let drawn: Vec<f32> = (0..cameras).map(|_| size * rng.normal()).collect();
    let mean = drawn.iter().sum::<f32>() / cameras as f32;
    drawn.iter().map(|v| v - mean).collect()
}

/// The same films, the times of each training camera early by its offset.
fn disturbed(data: &Dataset, offsets: &[f32]) -> Arc<Dataset> {
    let mut noisy = data.clone();
    for view in &mut noisy.train {
        let by = offsets[view.camera_id as usize];
        let seconds = view.time.seconds / f64::from(view.time.normalised.max(1e-6));
        view.time.normalised -= by;
        view.time.seconds -= f64::from(by) * seconds;
    }
    Arc::new(noisy)
}

/// What a training on some data came to.
struct Outcome {
    scores: EvalReport,
    /// Root mean square of what is left of the offsets, the mean of all clocks taken away.
    error: f32,
}

/// Trains `fourdgs` to the end and scores the held-out views.
fn train(data: &Arc<Dataset>, offsets: &[f32], over: &[&str], seed: u64) -> Outcome {
    let registry = gs_methods::registry();
    let config = gs_train::testkit::config(registry, "fourdgs", "tiny", over);
    let mut trainer = start(registry, data, "fourdgs", &config, seed);
    let steps = trainer.steps();
    run(&mut trainer, steps);
    let images = ImageCache::new(64 << 20, 1.0);
    let scores = evaluate(trainer.model(), data, Split::Test, trainer.model().background(), &images).expect("scores");
    let found = |k: usize| {
        let view = data.train.iter().find(|view| view.camera_id as usize == k).expect("a view");
        trainer.model().cameras().of(view).unwrap_or_default().time
    };
    let left: Vec<f32> = offsets.iter().enumerate().map(|(k, by)| by - found(k)).collect();
    let mean = left.iter().sum::<f32>() / left.len() as f32;
    let error = (left.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / left.len() as f32).sqrt();
    Outcome { scores, error }
}

/// Right clocks, clocks that are off by about a frame, and the same with offsets learnt.
fn compare(scene: &str, variant: u64, steps: u32, seed: u64) -> [Outcome; 3] {
    let options =
        SynthOptions { size: 64, cameras: 6, held_out: 2, moments: 24, seed, variant, ..SynthOptions::default() };
    let truth = films(scene, options);
    let by = offsets(6, 0.04, seed);
    let noisy = disturbed(&truth, &by);
    let longer = format!(
        "[schedule]\nstages.fine.steps = {steps}\nlr.cloud.means.steps = {steps}\nlr.field.all.steps = {steps}\n\
         lr.field.planes.steps = {steps}"
    );
    let all = [
        train(&truth, &[0.0; 6], &[&longer], seed),
        train(&noisy, &by, &[&longer], seed),
        train(&noisy, &by, &[&longer, TIME], seed),
    ];
    for (name, o) in ["right", "off", "refined"].iter().zip(&all) {
        println!("| {scene} | {seed} | {name} | {:.2} | {:.4} |", o.scores.mean.psnr.unwrap_or(0.0), o.error);
    }
    all
}

#[test]
fn clocks_that_are_off_are_found_again() {
    let [right, off, refined] = compare("sheet", 0, 600, 0);
    let psnr = |o: &Outcome| o.scores.mean.psnr.expect("finite");
    assert!(refined.error < 0.5 * off.error, "{} {}", refined.error, off.error);
    assert!(psnr(&refined) > psnr(&off) + 0.5 * (psnr(&right) - psnr(&off)), "half of what was lost is back");
    let cameras = refined.scores.cameras.as_ref().expect("the scores say that clocks were refined");
    assert!(cameras.count == 6 && cameras.time > 0.01 && (cameras.turn, cameras.shift) == (0.0, 0.0));
}

#[test]
fn offsets_are_the_same_bits_for_any_threads_and_ranks_and_after_a_resume() {
    let options = SynthOptions { size: 32, cameras: 3, held_out: 1, moments: 5, ..SynthOptions::default() };
    let truth = films("balls", options);
    let data = disturbed(&truth, &offsets(3, 0.05, 1));
    let registry = gs_methods::registry();
    let config = gs_train::testkit::short(registry, "fourdgs", &[TIME, "schedule.batch = 3"]);
    let begin = || start(registry, &data, "fourdgs", &config, 3);
    assert_eq!(thread_difference(begin, 40), 0.0);
    let mut whole = begin();
    run(&mut whole, 20);
    let half = whole.state();
    run(&mut whole, 20);
    let end = timeless(whole.state());
    let learnt = end.tensor("cameras.time").expect("kept").to_vec();
    assert!(learnt.len() == 3 && learnt.iter().all(|v| *v != 0.0), "{learnt:?}");
    let poses = end.tensor("cameras.turn").expect("kept");
    assert!(poses.iter().all(|v| *v == 0.0), "poses rest");
    let mut resumed = Trainer::resume(registry, data.clone(), &half, None, 1 << 20).expect("resume");
    run(&mut resumed, 20);
    assert!(timeless(resumed.state()) == end, "resumed");
    // A run that is to learn no more keeps its offsets, and one that learnt none can begin to.
    let mut rests = config.clone();
    overlay(&mut rests, "cameras.time = false".parse().expect("TOML"));
    let mut resting = Trainer::resume(registry, data.clone(), &whole.state(), Some(&rests), 1 << 20).expect("resume");
    let before = resting.model().cameras().correction(1).time;
    run(&mut resting, 10);
    assert!(before != 0.0 && resting.model().cameras().correction(1).time == before);
    let mut none = start(registry, &data, "fourdgs", &rests, 3);
    run(&mut none, 5);
    let mut late = Trainer::resume(registry, data.clone(), &none.state(), Some(&config), 1 << 20).expect("resume");
    run(&mut late, 35);
    assert!(late.model().cameras().correction(1).time != 0.0);
    let ended = on_ranks(registry, &data, begin(), 2, |mut trainer| {
        run(&mut trainer, 40);
        trainer.gather().expect("state");
        timeless(trainer.state())
    });
    assert!(ended == end, "two ranks");
}

#[test]
fn held_out_images_of_a_moving_camera_have_the_clock_of_its_film() {
    let options = SynthOptions { size: 32, cameras: 3, held_out: 1, moments: 5, ..SynthOptions::default() };
    let mut data = Dataset::clone(&disturbed(&films("balls", options), &offsets(3, 0.05, 1)));
    for (k, view) in data.train.iter_mut().enumerate() {
        view.camera.translation.x += 1e-3 * k as f64;
    }
    data.test.iter_mut().for_each(|view| view.camera_id = 1);
    let data = Arc::new(data);
    let registry = gs_methods::registry();
    let config = gs_train::testkit::short(registry, "fourdgs", &[TIME, "schedule.batch = 3"]);
    let mut trainer = start(registry, &data, "fourdgs", &config, 3);
    run(&mut trainer, 40);
    let film = data.train.iter().find(|view| view.camera_id == 1).expect("a view");
    let learnt = trainer.model().cameras().of(film).expect("a correction").time;
    let images = ImageCache::new(1 << 20, 1.0);
    let scores = evaluate(trainer.model(), &data, Split::Test, [0.0; 3], &images).expect("scores");
    let placed: Vec<_> = scores.views.iter().map(|v| v.camera.map(|c| c.time)).collect();
    assert!(learnt != 0.0 && placed.iter().all(|time| *time == Some(learnt)), "{learnt}: {placed:?}");
}

#[test]
fn images_of_one_time_have_no_clock() {
    let options = SynthOptions { size: 16, train_views: 4, test_views: 1, ..SynthOptions::default() };
    let data = Arc::new(gs_synth::generate("balls", &options).expect("scene").dataset);
    let registry = gs_methods::registry();
    let config = gs_train::testkit::short(registry, "fourdgs", &[TIME]);
    let error = Trainer::new(registry, data, "fourdgs", &config, TrainOptions::default()).map(drop).unwrap_err();
    assert!(error.to_string().contains("no camera has training images of several times"), "{error}");
}

/// The table of `docs/guide/data.md`: scenes on which no rate was chosen.
#[test]
#[ignore = "minutes: cargo test -p gs-train --test train clocks:: -- --ignored --nocapture"]
fn the_table_of_clocks() {
    for scene in ["sheet", "balls", "wheel"] {
        for seed in 101..104 {
            compare(scene, 7, 1800, seed);
        }
    }
}
