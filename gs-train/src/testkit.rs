//! Short runs for the tests and benches of methods (feature `testkit`). Every function panics where it fails.

use crate::registry::{Registry, overlay};
use crate::trainer::{StepReport, TrainOptions, Trainer};
use gs_data::Dataset;
use std::sync::Arc;

/// Growth, pruning, a reset and steps of the SH degree inside 60 steps: of clouds …
const SHORT_CLOUD: &str = "
init.points = 150
[schedule]
density.from = 5
density.until = 55
density.every = 10
density.reset_every = 25
density.max_splats = 300
sh_every = 20
";

/// … and of anchors.
const SHORT_ANCHORS: &str = "
init.points = 150
[adapt]
observe_from = 0
from = 5
until = 55
every = 10
grad = 2e-5
";

/// Of films: networks of 32 texels a side, one stage after the other in 15 steps.
pub const SHORT_FILM: &str = "
cache_mib = 64
[textures]
unproject = 32
geo = 16
gau = 32
[gaunet]
residual = false
[gaunet.net]
width = 8
levels = 2
[geonet]
width = 16
[schedule]
stages.geometry.steps = 5
stages.warm_up.steps = 4
stages.main.steps = 6
";

/// A preset of a method with TOML laid over it, one after the other.
pub fn config(registry: &Registry, method: &str, preset: &str, over: &[&str]) -> toml::Table {
    let mut config = registry.find(method).and_then(|m| m.config(preset)).expect("preset");
    over.iter().for_each(|o| overlay(&mut config, o.parse().expect("TOML")));
    config
}

/// The `tiny` preset of a method of clouds or anchors, 60 steps in stages of one length, with TOML laid over it.
pub fn short(registry: &Registry, method: &str, over: &[&str]) -> toml::Table {
    let mut config = config(registry, method, "tiny", &[]);
    let short = if config.contains_key("adapt") { SHORT_ANCHORS } else { SHORT_CLOUD };
    overlay(&mut config, short.parse().expect("TOML"));
    let stages = config["schedule"]["stages"].as_table_mut().expect("stages");
    let count = stages.len() as i64;
    stages.iter_mut().for_each(|(_, stage)| stage["steps"] = (60 / count).into());
    over.iter().for_each(|o| overlay(&mut config, o.parse().expect("TOML")));
    config
}

/// A run before its first step.
pub fn start(registry: &Registry, data: &Arc<Dataset>, method: &str, config: &toml::Table, seed: u64) -> Trainer {
    let options = TrainOptions { seed, ..TrainOptions::default() };
    Trainer::new(registry, data.clone(), method, config, options).expect("trainer")
}

/// Makes steps.
pub fn run(trainer: &mut Trainer, steps: u32) -> Vec<StepReport> {
    (0..steps).map(|_| trainer.step().expect("step")).collect()
}

/// Largest difference of a value of the state after so many steps on one thread and on two: 0 by contract.
pub fn thread_difference(start: impl Fn() -> Trainer + Sync, steps: u32) -> f64 {
    let [one, two] = [1, 2].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
        pool.install(|| {
            let mut trainer = start();
            run(&mut trainer, steps);
            trainer.state().tensors
        })
    });
    assert!(one.iter().map(|t| (&t.0, t.1.len())).eq(two.iter().map(|t| (&t.0, t.1.len()))), "the same tensors");
    let pairs = one.iter().zip(&two).flat_map(|(a, b)| a.1.iter().zip(&b.1));
    pairs.map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max)
}
