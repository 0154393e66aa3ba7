//! What the law of TRACE adds to a step of training: the field alone (`defgs`), `trace`, and `trace` with the law in every step it can
//! act in (`physics.direct = 0`) take turns, step by step, so that what else the machine does meets all. The stage `follow`, in which no
//! law acts, is left out. Rows go to the terminal and to `target/speed-error/gs-train.jsonl`.

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

/// What is compared, the first with the others.
const CASES: [Case; 3] = [
    Case { name: "defgs", method: "defgs", over: "" },
    Case { name: "trace", method: "trace", over: "" },
    Case { name: "trace, direct 0", method: "trace", over: "physics.direct = 0.0" },
];

/// A method with settings laid over its preset `fast`.
#[derive(Clone, Copy)]
struct Case {
    name: &'static str,
    method: &'static str,
    over: &'static str,
}

fn trainer(scene: &Arc<Dataset>, Case { method, over, .. }: Case, splats: usize) -> Trainer {
    let mut config = gs_methods::registry().find(method).and_then(|m| m.config("fast")).expect("a preset");
    let still = format!(
        "[init]\npoints = {splats}\n[schedule.density]\nuntil = 0\n\
         [schedule.stages]\nwarm_up.steps = 100\nfollow.steps = 0\ndynamic.steps = {}",
        BEFORE + TIMED - 100
    );
    for text in [still.as_str(), over] {
        overlay(&mut config, text.parse().expect("TOML"));
    }
    Trainer::new(gs_methods::registry(), scene.clone(), method, &config, TrainOptions::default()).expect("a run")
}

/// Milliseconds a step and mean absolute difference from the images, in the order of [`CASES`].
fn take_turns(scene: &Arc<Dataset>, splats: usize) -> [[f64; 2]; CASES.len()] {
    let mut trainers = CASES.map(|case| trainer(scene, case, splats));
    let mut sums = [[0.0; 2]; CASES.len()];
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
            for (Case { name, .. }, [ms, l1]) in CASES.into_iter().zip(rows) {
                BenchRow {
                    krate: "gs-train",
                    case: format!("step of {size}x{size}"),
                    variant: name.into(),
                    n: splats,
                    threads,
                    ms,
                    work: splats as f64,
                    error: Some(l1),
                    error_kind: "mean absolute difference from the images",
                }
                .append(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
            }
            let [alone, others @ ..] = rows.map(|[ms, _]| ms);
            for (Case { name, .. }, ms) in CASES.into_iter().skip(1).zip(others) {
                println!("{name} / defgs, {size}x{size}, {splats} splats, {threads}t: {:.3}", ms / alone);
            }
        }
    }
}
