//! Small runs on generated scenes, shared by the training tests.

use gs_data::{Dataset, ImageCache, Split};
pub use gs_synth::testkit::{film, scene};
use gs_train::evaluate::evaluate;
use gs_train::registry::MethodEntry;
use gs_train::testkit::{self, config};
pub use gs_train::testkit::{SHORT_FILM, run};
use gs_train::trainer::Trainer;
use std::sync::Arc;

/// The methods that need no filmed person.
pub fn of_scenes() -> impl Iterator<Item = &'static MethodEntry> {
    gs_methods::registry().iter().filter(|m| !m.needs_avatar)
}

/// The `tiny` preset of a method, with TOML laid over its schedule.
pub fn tiny(method: &str, schedule: &str) -> toml::Table {
    config(gs_methods::registry(), method, "tiny", &[&format!("[schedule]\n{schedule}")])
}

/// A run of that configuration, seed 1.
pub fn trainer(data: &Arc<Dataset>, method: &str, schedule: &str) -> Trainer {
    testkit::start(gs_methods::registry(), data, method, &tiny(method, schedule), 1)
}

/// Mean PSNR over the test views, dB.
pub fn psnr(trainer: &Trainer, data: &Dataset) -> f64 {
    let background = trainer.model().background();
    let images = ImageCache::new(64 << 20, 1.0);
    let report = evaluate(trainer.model(), data, Split::Test, background, &images).expect("scores");
    report.mean.psnr.expect("finite scores")
}

/// The `tiny` preset with growth, pruning, a reset and a change of stage inside its 60 steps.
pub fn short(method: &str) -> toml::Table {
    testkit::short(gs_methods::registry(), method, &[])
}

/// A run of that configuration, seed 3.
pub fn start(method: &str, data: &Arc<Dataset>) -> Trainer {
    testkit::start(gs_methods::registry(), data, method, &short(method), 3)
}

/// The `tiny` preset of DUT, with TOML laid over it.
pub fn film_config(over: &[&str]) -> toml::Table {
    config(gs_methods::registry(), "dut", "tiny", over)
}
