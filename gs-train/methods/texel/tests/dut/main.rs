//! DUT on small films of simple bodies.
//!
//! | property | tolerance |
//! |---|---|
//! | slope of geometric losses along the gradient | 2 % |
//! | in-mask PSNR of values of the texels' own, seen frames | 32 dB |
//! | in-mask PSNR of GauNet over-fitting four views of a frame; after its warm-up alone | 30 dB; 20 dB |
//! | GeoNet's offsets of a known morph, RMS error over RMS length | `morphs.rs` |

mod data;
mod draws;
mod gradients;
mod learning;
mod light;
mod morphs;
mod settings;
mod state;

use gs_core::{Camera, Params, Rng, SplatsGrad, SplatsRef};
use gs_data::{Dataset, ImageCache, Split};
use gs_method_texel::{Config, Dut, METHODS};
use gs_raster::ScreenStats;
use gs_synth::testkit::film;
use gs_train::evaluate::evaluate;
use gs_train::method::{Buffers, Method, MethodError, RenderView, ViewCtx};
use gs_train::registry::{Registry, own_settings};
use gs_train::scene::{InitConfig, SceneInfo};
use gs_train::testkit::{self, SHORT_FILM as SHORT, run};
use gs_train::timestamp::Timestamp;
use gs_train::trainer::{TrainOptions, Trainer};
use std::sync::Arc;

/// The methods of this crate.
fn registry() -> Registry {
    Registry::new(METHODS.to_vec())
}

fn config(over: &[&str]) -> toml::Table {
    testkit::config(&registry(), "dut", "tiny", over)
}

fn start(data: &Arc<Dataset>, config: &toml::Table) -> Trainer {
    testkit::start(&registry(), data, "dut", config, 3)
}

/// Mean in-mask PSNR of a split, dB.
fn in_mask(trainer: &Trainer, data: &Dataset, split: Split) -> f64 {
    let report = evaluate(trainer.model(), data, split, [0.0; 3], &ImageCache::new(64 << 20, 1.0)).expect("scores");
    report.mean.masked.and_then(|m| m.psnr).expect("masks")
}

const DIRECT: &str = "
mode = \"direct\"
[schedule]
stages.warm_up.steps = 0
";

/// GauNet's values are added to the reference Gaussians, at which it begins.
const RESIDUAL: &str = "
gaunet.residual = true
schedule.stages.warm_up.steps = 0
";

/// A bare method of a film at a step.
fn bare(data: &Dataset, config: &toml::Table, step: u32) -> Dut {
    let init: InitConfig = config["init"].clone().try_into().expect("init");
    let scene = SceneInfo::of(data, &init, 3).expect("scene");
    let config: Config = own_settings(config.clone()).try_into().expect("settings");
    let at = config.schedule.trainer.at(step);
    let mut dut = Dut::new(config, &scene).expect("method");
    dut.begin_step(&at);
    dut
}

/// A step that must not come to rendering.
struct Unrendered;

impl RenderView for Unrendered {
    fn render(&mut self, _: SplatsRef<'_>, _: &mut SplatsGrad) -> Result<&ScreenStats, MethodError> {
        panic!("nothing is rendered")
    }
}

/// Loss of a step without rendering, gradients left in the blocks.
fn unrendered(m: &mut Dut, at: Timestamp, camera: &Camera) -> f64 {
    let terms = m.step(&ViewCtx { at, camera, draw: 0, last: true }, &mut Unrendered).expect("step");
    terms.iter().map(|p| f64::from(p.1)).sum()
}

/// The mean textures.
fn mean(method: &(impl Buffers + ?Sized)) -> Vec<Vec<f32>> {
    let mut all = Vec::new();
    method.buffers(&mut |b| all.push(b.values.clone()));
    all
}
