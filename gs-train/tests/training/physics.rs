//! Methods that learn a law of motion: what they learn of generated mechanics, and what follows from it.

use crate::support::*;
use gs_core::Time;
use gs_train::data::{Dataset, ImageCache, Split};
use gs_train::evaluate::evaluate;
use gs_train::moment::Moment;
use gs_train::physics_check::{PhysicsOptions, check};
use gs_train::synth::{self, SynthData, SynthOptions};
use gs_train::trainer::{TrainOptions, Trainer};
use std::sync::Arc;

/// A generated scene of four cameras at rest, the last quarter of the time kept for the future.
fn mechanics(name: &str) -> SynthData {
    let options = SynthOptions { size: 48, cameras: 4, held_out: 1, moments: 24, supersample: 2, ..Default::default() };
    synth::generate(name, &options).expect("generated scene")
}

fn trained(data: &Arc<Dataset>, method: &str, over: &str) -> Trainer {
    let mut config = gs_train::methods::MethodEntry::find(method).and_then(|m| m.config("tiny")).expect("preset");
    gs_train::methods::overlay(&mut config, over.parse().expect("TOML"));
    let options = TrainOptions { seed: 1, ..TrainOptions::default() };
    let mut trainer = Trainer::new(data.clone(), method, &config, options).expect("trainer");
    let steps = trainer.steps();
    run(&mut trainer, steps);
    trainer
}

fn score(trainer: &Trainer, data: &Dataset, split: Split) -> f64 {
    let background = trainer.method().schedule().background.evaluation_color();
    let report = evaluate(trainer.method(), data, split, background, &ImageCache::new(64 << 20, 1.0)).expect("scores");
    report.mean.psnr.expect("finite scores")
}

#[test]
fn a_thrown_ball_is_forecast_and_a_field_alone_cannot() {
    let scene = mechanics("falling");
    let data = Arc::new(scene.dataset);
    let (trace, field) = (trained(&data, "trace", ""), trained(&data, "defgs", ""));
    let [inside, beyond] = [Split::Test, Split::Extrapolate].map(|s| score(&trace, &data, s));
    let alone = score(&field, &data, Split::Extrapolate);
    println!("trace {inside:.2} dB inside, {beyond:.2} beyond; defgs {alone:.2} beyond");
    assert!(beyond > alone + 2.0, "{beyond} against {alone}");
    let particles = trace.method().particles().expect("a law");
    let report = check(&particles, &scene.truth, &PhysicsOptions::of(&particles, &scene.truth));
    println!("{}", report.to_text());
}

#[test]
fn a_forecast_does_not_depend_on_what_was_asked_before() {
    let data = Arc::new(mechanics("wheel").dataset);
    let short = "[schedule.stages.warm_up]\nsteps = 20\n[schedule.stages.dynamic]\nsteps = 40";
    for method in ["trace", "trace-4dgs", "defgs-nvfi"] {
        let trainer = trained(&data, method, short);
        let (camera, other) = (&data.train[0].camera, trained(&data, method, short));
        let at = |t: f32| Moment::new(Time::new(t).expect("time"));
        let times = [1.5, 0.8, 1.0, 0.2, 1.5, 3.0, 0.9];
        let asked: Vec<_> = times.iter().map(|t| trainer.method().splats(&at(*t), camera)).collect();
        for (t, splats) in times.iter().zip(asked).rev() {
            assert_eq!(other.method().splats(&at(*t), camera), splats, "{method} at {t}");
        }
    }
}
