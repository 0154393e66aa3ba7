//! Time and error of training: Adam against its definition in `f64`, and the phases of a step of each method. Rows go to
//! the terminal and to `target/speed-error/gs-train.jsonl`.

use std::collections::BTreeMap;
use std::sync::Arc;

use criterion::Criterion;
use gs_core::speed::{BenchRow, median_seconds};
use gs_core::{Param, Rng};
use gs_synth::{self as synth, SynthOptions};
use gs_train::adam::{Adam, Refused, Update};

use gs_train::trainer::{Phases, TrainOptions, Trainer};

/// A block of `rows × 51` values (the parameters of a cloud at SH degree 3 but for its centres, quats and scales).
fn block(rows: usize) -> Param {
    let mut rng = Rng::new(1, "bench", 0, 0);
    Param::rows("bench", 51, (0..rows * 51).map(|_| rng.normal()).collect())
}

/// Worst absolute difference from the definition in `f64` after ten updates at learning rate 1e-2.
fn adam_error() -> f64 {
    let (b1, b2, lr, eps) = (f64::from(0.9f32), f64::from(0.999f32), f64::from(1e-2f32), f64::from(1e-15f32));
    let (mut p, mut adam, mut rng) = (block(100), Adam::default(), Rng::new(2, "bench", 0, 0));
    let mut want: Vec<[f64; 3]> = p.value.iter().map(|&v| [f64::from(v), 0.0, 0.0]).collect();
    for t in 1..=10 {
        for (g, [value, m, v]) in p.grad.iter_mut().zip(&mut want) {
            *g = 1e-3 * rng.normal();
            let g = f64::from(*g);
            *m = b1 * *m + (1.0 - b1) * g;
            *v = b2 * *v + (1.0 - b2) * g * g;
            *value -= lr * (*m / (1.0 - b1.powi(t))) / ((*v / (1.0 - b2.powi(t))).sqrt() + eps);
        }
        adam.update(
            &mut p,
            Update { rate: 1e-2, eps: 1e-15, sparse: false, weight_decay: 0.0, ramp: 0 },
            &mut Refused::default(),
        );
    }
    p.value.iter().zip(&want).map(|(a, b)| (f64::from(*a) - b[0]).abs()).fold(0.0, f64::max)
}

fn adam_rows(criterion: &mut Criterion) {
    let error = adam_error();
    for (variant, sparse, share) in [("exact", false, 1), ("rows seen, all", true, 1), ("rows seen, a tenth", true, 10)]
    {
        let (rows, mut adam) = (100_000, Adam::default());
        let update_rule = Update { rate: 1e-3, eps: 1e-15, sparse, weight_decay: 0.0, ramp: 0 };
        let mut p = block(rows);
        for threads in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            let mut update = || {
                // Gradients are cleared by an update: one value brings a row back to life.
                p.grad.iter_mut().step_by(51 * share).for_each(|g| *g = 1e-3);
                pool.install(|| adam.update(&mut p, update_rule, &mut Refused::default()));
            };
            let ms = 1e3 * median_seconds(15, &mut update);
            BenchRow {
                krate: "gs-train",
                case: "adam".into(),
                variant: variant.into(),
                n: rows * 51,
                threads,
                ms,
                work: (rows * 51) as f64,
                error: (!sparse).then_some(error),
                error_kind: "worst absolute after 10 updates of 1e-2",
            }
            .append(env!("CARGO_MANIFEST_DIR"));
            criterion.bench_function(&format!("adam/{variant}/5.1M/{threads}t"), |b| b.iter(&mut update));
        }
    }
}

/// Mean milliseconds of each phase over the last steps of a short run of the `fast` preset with 20 000 splats at 400×400.
fn phases(method: &str, threads: usize) -> (BTreeMap<&'static str, f64>, usize) {
    let options = SynthOptions::of_views(400, 12, 0);
    let dataset = Arc::new(synth::generate("sheet", &options).expect("a scene").dataset);
    let mut config = gs_methods::registry().find(method).and_then(|m| m.config("fast")).expect("a preset");
    let fixed = match config.contains_key("anchors") {
        true => "init.points = 4000", // five splats each
        false => "init.points = 20000\nschedule.density.until = 0\nschedule.density.max_splats = 20000",
    };
    gs_train::registry::overlay(&mut config, fixed.parse().expect("TOML"));
    for (_, stage) in config["schedule"]["stages"].as_table_mut().expect("stages").iter_mut() {
        let dynamic = stage["dynamic"].as_bool().unwrap_or(false);
        stage.as_table_mut().expect("a stage").insert("steps".into(), if dynamic { 30 } else { 20 }.into());
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
    pool.install(|| {
        let mut trainer =
            Trainer::new(gs_methods::registry(), dataset, method, &config, TrainOptions::default()).expect("a run");
        let (skip, mut sums) = (trainer.steps() - 15, BTreeMap::new());
        for step in 1..=trainer.steps() {
            let ms = trainer.step().expect("a step").ms;
            if step > skip {
                named(&ms).into_iter().for_each(|(name, v)| *sums.entry(name).or_insert(0.0) += v / 15.0);
            }
        }
        (sums, trainer.model().splat_count())
    })
}

fn named(ms: &Phases) -> [(&'static str, f64); 7] {
    [
        ("data", ms.data),
        ("field", ms.field),
        ("raster forward", ms.raster_forward),
        ("loss", ms.loss),
        ("raster backward", ms.raster_backward),
        ("adam", ms.adam),
        ("step", ms.total),
    ]
}

fn phase_rows() {
    for entry in gs_methods::registry().iter().filter(|m| !m.needs_avatar) {
        for threads in [1, 2] {
            let (ms, splats) = phases(entry.name, threads);
            let line: Vec<String> = ms.iter().map(|(name, ms)| format!("{name} {ms:.2}")).collect();
            println!("{:9} fast, {splats} splats, 400x400, {threads}t  ms: {}", entry.name, line.join("  "));
            for (case, ms) in ms {
                BenchRow {
                    krate: "gs-train",
                    case: format!("train {case}"),
                    variant: entry.name.into(),
                    n: splats,
                    threads,
                    ms,
                    work: splats as f64,
                    error: None,
                    error_kind: "see the parts",
                }
                .append(env!("CARGO_MANIFEST_DIR"));
            }
        }
    }
}

fn main() {
    let quick = std::time::Duration::from_millis(200);
    let mut criterion = Criterion::default()
        .sample_size(10)
        .warm_up_time(quick / 4)
        .measurement_time(quick)
        .without_plots()
        .configure_from_args();
    adam_rows(&mut criterion);
    phase_rows();
    criterion.final_summary();
}
