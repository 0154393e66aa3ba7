//! What the law of TRACE adds to a step of training: `trace` and the field alone (`defgs`) take turns, step by step, so that
//! what else the machine does meets both. Rows go to the terminal and to `target/speed-error/gs-train.jsonl`.

use gs_core::speed::BenchRow;
use gs_data::Dataset;
use gs_synth::{self as synth, SynthOptions};
use gs_train::registry::overlay;
use gs_train::trainer::{TrainOptions, Trainer};
use std::sync::Arc;

/// Steps before the clock starts: the warm-up, and caches.
const BEFORE: u32 = 300;
/// Steps that are timed.
const TIMED: u32 = 1000;
/// The last of these say how well images are met.
const LAST: u32 = 200;

const METHODS: [&str; 2] = ["defgs", "trace"];

fn trainer(scene: &Arc<Dataset>, method: &str, splats: usize) -> Trainer {
    let mut config = gs_methods::registry().find(method).and_then(|m| m.config("fast")).expect("a preset");
    let still = format!(
        "[init]\npoints = {splats}\n[schedule.density]\nuntil = 0\n\
         [schedule.stages.warm_up]\nsteps = 100\n[schedule.stages.dynamic]\nsteps = {}",
        BEFORE + TIMED - 100
    );
    overlay(&mut config, still.parse().expect("TOML"));
    Trainer::new(gs_methods::registry(), scene.clone(), method, &config, TrainOptions::default()).expect("a run")
}

/// Milliseconds a step and mean absolute difference from the images, in the order of [`METHODS`].
fn take_turns(scene: &Arc<Dataset>, splats: usize) -> [[f64; 2]; 2] {
    let mut trainers = METHODS.map(|m| trainer(scene, m, splats));
    let mut sums = [[0.0; 2]; 2];
    for step in 1..=BEFORE + TIMED {
        for (trainer, [ms, l1]) in trainers.iter_mut().zip(&mut sums) {
            let report = trainer.step().expect("a step");
            if step > BEFORE {
                *ms += report.ms.total / f64::from(TIMED);
            }
            if step > BEFORE + TIMED - LAST {
                *l1 += report.loss.l1 / f64::from(LAST);
            }
        }
    }
    sums
}

fn main() {
    for (size, splats) in [(100, 2000), (200, 4000)] {
        let options = SynthOptions { size, cameras: 8, ..SynthOptions::default() };
        let scene = Arc::new(synth::generate("falling", &options).expect("a scene").dataset);
        for threads in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            let rows = pool.install(|| take_turns(&scene, splats));
            for (method, [ms, l1]) in METHODS.into_iter().zip(rows) {
                BenchRow {
                    krate: "gs-train",
                    case: format!("step of {size}x{size}"),
                    variant: method.into(),
                    n: splats,
                    threads,
                    ms,
                    work: splats as f64,
                    error: Some(l1),
                    error_kind: "mean absolute difference from the images",
                }
                .append(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
            }
            println!("trace / defgs, {size}x{size}, {splats} splats, {threads}t: {:.3}", rows[1][0] / rows[0][0]);
        }
    }
}
