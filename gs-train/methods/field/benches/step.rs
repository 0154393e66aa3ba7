//! Time and error of a training step of moving clouds at a fixed number of splats. Rows go to the terminal and to
//! `target/speed-error/gs-method-field.jsonl`; `work` counts splats.

use criterion::Criterion;
use gs_core::speed::{BenchRow, Stopwatch};
use gs_method_field::METHODS;
use gs_synth::SynthOptions;
use gs_synth::testkit::dataset;
use gs_train::registry::Registry;
use gs_train::testkit::{config, run, start, thread_difference};

/// Steps before the clock starts: those of the cloud alone, and caches. As many are compared between threads.
const BEFORE: u32 = 20;

/// Without density control, and more steps in motion than are measured.
const FIXED: &str = "
init.points = 5000
schedule.density.until = 0
";

fn main() {
    let mut criterion = Criterion::default().sample_size(10).without_plots().configure_from_args();
    let registry = Registry::new(METHODS.to_vec());
    let data = dataset("sheet", &SynthOptions::of_views(200, 12, 0));
    for method in ["fourdgs", "grid4d"] {
        let mut config = config(&registry, method, "fast", &[FIXED]);
        for (_, stage) in config["schedule"]["stages"].as_table_mut().expect("stages").iter_mut() {
            let dynamic = stage["dynamic"].as_bool().unwrap_or(false);
            stage["steps"] = if dynamic { 1_000_000 } else { 2 }.into();
        }
        let begin = || start(&registry, &data, method, &config, 1);
        let error = Some(thread_difference(begin, BEFORE));
        for threads in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            let (mut laps, mut trainer) = (Stopwatch::default(), begin());
            pool.install(|| run(&mut trainer, BEFORE));
            criterion.bench_function(&format!("step/{method}/{threads}t"), |b| {
                b.iter_custom(|calls| pool.install(|| laps.run(calls, || drop(run(&mut trainer, 1)))))
            });
            let Some(ms) = laps.median_ms() else { continue };
            let n = trainer.model().splat_count();
            BenchRow {
                krate: "gs-method-field",
                case: "step of 200x200".into(),
                variant: method.into(),
                n,
                threads,
                ms,
                work: n as f64,
                error,
                error_kind: "largest difference between 1 and 2 threads",
            }
            .append(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
        }
    }
    criterion.final_summary();
}
