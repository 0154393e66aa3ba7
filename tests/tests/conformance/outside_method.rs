//! A method that no crate of gs4d knows: Spacetime Gaussians, written in [`crate::spacetime`] with a settings file of its own, put
//! into a registry here, and trained, saved, resumed and scored by the library as it is.

use crate::spacetime;
use gs_data::{Dataset, ImageCache, Split};
use gs_synth::SynthOptions;
use gs_synth::testkit::dataset;
use gs_train::checkpoint::Checkpoint;
use gs_train::conformance;
use gs_train::evaluate::evaluate;
use gs_train::registry::{Registry, overlay};
use gs_train::testkit::timeless;
use gs_train::trainer::{TrainOptions, Trainer};
use gs4d_report::Report;
use std::sync::Arc;

/// The methods of gs4d and the one from outside.
fn registry() -> Registry {
    let known = gs_methods::registry().iter().copied();
    Registry::new(known.chain([spacetime::ENTRY]).collect())
}

fn tiny() -> toml::Table {
    registry().find("spacetime").and_then(|m| m.config("tiny")).expect("preset")
}

fn start(data: &Arc<Dataset>, method: &str, config: &toml::Table) -> Trainer {
    Trainer::new(&registry(), data.clone(), method, config, TrainOptions::default()).expect("trainer")
}

/// Trains up to a step.
fn run(trainer: &mut Trainer, until: u32) {
    while trainer.steps_done() < until {
        trainer.step().expect("step");
    }
}

fn held_out_psnr(trainer: &Trainer, data: &Dataset) -> f64 {
    let images = ImageCache::new(64 << 20, 1.0);
    let report = evaluate(trainer.model(), data, Split::Test, trainer.model().background(), &images).expect("scores");
    report.mean.psnr.expect("finite scores")
}

/// Eight cameras at rest film 12 moments at 48 × 48 pixels; two more are held out. After 600 steps their mean PSNR is 27.20 dB,
/// that of `static3d` with the same points, schedule and number of splats 20.95 dB.
#[test]
fn it_learns_motion_and_resumes_from_a_file() {
    let cameras = SynthOptions { cameras: 8, held_out: 2, moments: 12, boundary: 1.0, ..SynthOptions::default() };
    let data = dataset("balls", &SynthOptions { size: 48, supersample: 2, ..cameras });
    let mut config = tiny();
    let mut moving = start(&data, "spacetime", &config);
    run(&mut moving, 350);
    let folder = tempfile::tempdir().expect("folder");
    let file = folder.path().join("half");
    moving.state().save(&file).expect("saved");
    run(&mut moving, 600);

    let loaded = Checkpoint::load(&file).expect("loaded");
    let mut resumed = Trainer::resume(&registry(), data.clone(), &loaded, None, 64 << 20).expect("resumed");
    assert_eq!(resumed.steps_done(), 350);
    run(&mut resumed, 600);
    assert!(timeless(resumed.state()) == timeless(moving.state()), "the resumed run ends in the same bits");

    config.remove("time");
    let mut still = start(&data, "static3d", &config);
    run(&mut still, 600);
    let [with, without] = [&moving, &still].map(|trainer| held_out_psnr(trainer, &data));
    println!("spacetime {with:.2} dB, static3d {without:.2} dB");
    assert!(with > without + 4.0 && with > 25.0, "{with:.2} dB, {without:.2} dB without motion");
    assert!(moving.model().splat_count() > 1000, "densification took part");
}

/// Gradients, row blocks, odd times, resuming, threads and learning rates, in 60 steps with 20 to 24 splats.
#[test]
fn it_passes_every_check() {
    let data = dataset("balls", &SynthOptions::of_views(32, 6, 0));
    let mut config = tiny();
    let short = "
        init.points = 20
        schedule.sh_every = 20
        schedule.stages.all.steps = 60
        schedule.density = { from = 5, until = 55, every = 10, reset_every = 25, max_splats = 24 }
    ";
    overlay(&mut config, short.parse().expect("TOML"));
    conformance::check(&registry(), "spacetime", &data, &config).unwrap_or_else(|e| panic!("{e}"));
}

/// Its section stands in the report, which has not heard of it.
#[test]
fn it_brings_a_section_of_the_report() {
    let data = dataset("balls", &SynthOptions::of_views(16, 2, 0));
    let method = start(&data, "spacetime", &tiny()).model().report_section(&[]).expect("a section");
    let html = Report { method, ..Report::default() }.html().expect("a page");
    for shown in ["<h2>Temporal opacity</h2>", "aria-label=\"Presence, mean over splats, against normalised time\""] {
        assert!(html.contains(shown), "{shown}");
    }
    let without =
        start(&data, "static3d", &registry().find("static3d").and_then(|m| m.config("tiny")).expect("preset"));
    assert_eq!(without.model().report_section(&[]).expect("none"), None);
}

/// A block that nobody gave a learning rate is found by name.
#[test]
fn a_forgotten_learning_rate_is_named() {
    let data = dataset("balls", &SynthOptions::of_views(16, 2, 0));
    let mut config = tiny();
    config["schedule"]["lr"]["motion"].as_table_mut().expect("rates").remove("spin");
    let error = conformance::check(&registry(), "spacetime", &data, &config).expect_err("found");
    assert_eq!((error.check, error.place.as_str()), ("rates", "motion.spin"));
}
