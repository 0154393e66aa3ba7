//! Small runs on generated scenes, shared by the training tests.

use gs_data::{Dataset, ImageCache, Split};
use gs_synth::avatar::{self, AvatarOptions};
use gs_synth::{self as synth, SynthOptions};
use gs_train::evaluate::evaluate;
use gs_train::method::MethodEntry;
use gs_train::trainer::{StepReport, TrainOptions, Trainer};
use std::sync::Arc;

/// A generated scene of small images.
pub fn scene(name: &str, size: u32, views: u32) -> Arc<Dataset> {
    let options = SynthOptions {
        size,
        train_views: views,
        val_views: 0,
        test_views: 4,
        supersample: 2,
        ..SynthOptions::default()
    };
    Arc::new(synth::generate(name, &options).expect("generated scene").dataset)
}

/// The methods that need no filmed person.
pub fn of_scenes() -> impl Iterator<Item = &'static MethodEntry> {
    gs_methods::registry().iter().filter(|m| !m.needs_avatar)
}

/// The `tiny` preset of a method, with TOML laid over its schedule.
pub fn tiny(method: &str, schedule: &str) -> toml::Table {
    let mut config = gs_methods::registry().find(method).and_then(|m| m.config("tiny")).expect("preset");
    let over = format!("[schedule]\n{schedule}").parse().expect("TOML");
    gs_train::method::overlay(&mut config, over);
    config
}

/// A run of that configuration, seed 1.
pub fn trainer(data: &Arc<Dataset>, method: &str, schedule: &str) -> Trainer {
    let options = TrainOptions { seed: 1, ..TrainOptions::default() };
    Trainer::new(gs_methods::registry(), data.clone(), method, &tiny(method, schedule), options).expect("trainer")
}

/// Makes steps.
pub fn run(trainer: &mut Trainer, steps: u32) -> Vec<StepReport> {
    (0..steps).map(|_| trainer.step().expect("step")).collect()
}

/// Mean PSNR over the test views, dB.
pub fn psnr(trainer: &Trainer, data: &Dataset) -> f64 {
    let background = trainer.model().background();
    let images = ImageCache::new(64 << 20, 1.0);
    let report = evaluate(trainer.model(), data, Split::Test, background, &images).expect("scores");
    report.mean.psnr.expect("finite scores")
}

/// A short schedule with growth, pruning, a reset and a change of stage inside its 60 steps: of clouds …
const SHORT: &str = "
density.from = 5
density.until = 55
density.every = 10
density.reset_every = 25
density.max_splats = 300
sh_every = 20
";

/// … and of anchors.
const SHORT_ANCHORS: &str = "
[adapt]
observe_from = 0
from = 5
until = 55
every = 10
grad = 2e-5
";

/// The `tiny` preset with that schedule.
pub fn short(method: &str) -> toml::Table {
    let anchored = tiny(method, "").contains_key("adapt");
    let mut config = tiny(method, if anchored { "" } else { SHORT });
    if anchored {
        gs_train::method::overlay(&mut config, SHORT_ANCHORS.parse().expect("TOML"));
    }
    let stages = config["schedule"]["stages"].as_table_mut().expect("stages");
    let count = stages.len() as i64;
    for (_, stage) in stages.iter_mut() {
        let stage = stage.as_table_mut().expect("stage");
        stage.insert("steps".into(), (60 / count).into());
    }
    config["init"].as_table_mut().expect("init").insert("points".into(), 150.into());
    config
}

/// A run of that configuration, seed 3.
pub fn start(method: &str, data: &Arc<Dataset>) -> Trainer {
    Trainer::new(
        gs_methods::registry(),
        data.clone(),
        method,
        &short(method),
        TrainOptions { seed: 3, ..TrainOptions::default() },
    )
    .expect("trainer")
}

/// A film of a body made here.
pub fn film(template: &str, size: u32, frames: u32) -> Arc<Dataset> {
    let template = format!("builtin:{template}");
    let options = AvatarOptions { template, size, frames, rings: 1, points: 4000, ..AvatarOptions::default() };
    Arc::new(avatar::generate(&options).expect("film"))
}

/// DUT with networks of 32 texels a side, one stage after the other.
pub const FILM_SHORT: &str = "
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

/// The `tiny` preset of DUT, with TOML laid over it.
pub fn film_config(over: &[&str]) -> toml::Table {
    let mut config = gs_methods::registry().find("dut").and_then(|m| m.config("tiny")).expect("preset");
    over.iter().for_each(|o| gs_train::method::overlay(&mut config, o.parse().expect("TOML")));
    config
}
