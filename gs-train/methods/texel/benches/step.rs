//! Time and error of a training step of DUT on a film, stage by stage. Rows go to the terminal and to
//! `target/speed-error/gs-method-texel.jsonl`; `work` counts texels.

use criterion::Criterion;
use gs_core::speed::{BenchRow, Stopwatch};
use gs_method_texel::METHODS;
use gs_synth::testkit::film;
use gs_train::registry::Registry;
use gs_train::testkit::{config, run, start, thread_difference};

/// Steps before the clock starts: caches. As many are compared between threads.
const BEFORE: u32 = 10;

const STAGES: [&str; 3] = ["geometry", "warm_up", "main"];

fn main() {
    let mut criterion = Criterion::default().sample_size(10).without_plots().configure_from_args();
    let registry = Registry::new(METHODS.to_vec());
    let data = film("person", 128, 2);
    for stage in STAGES {
        let steps = |s| format!("schedule.stages.{s}.steps = {}\n", if s == stage { 1_000_000 } else { 0 });
        // A warm-up has something to learn where GauNet does not begin at its end.
        let residual = format!("gaunet.residual = {}", stage != "warm_up");
        let config = config(&registry, "dut", "tiny", &[&STAGES.map(steps).concat(), &residual]);
        let begin = || start(&registry, &data, "dut", &config, 1);
        let error = Some(thread_difference(begin, BEFORE));
        for threads in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            let (mut laps, mut trainer) = (Stopwatch::default(), begin());
            pool.install(|| run(&mut trainer, BEFORE));
            criterion.bench_function(&format!("step/{stage}/{threads}t"), |b| {
                b.iter_custom(|calls| pool.install(|| laps.run(calls, || drop(run(&mut trainer, 1)))))
            });
            let Some(ms) = laps.median_ms() else { continue };
            let n = trainer.model().splat_count();
            BenchRow {
                krate: "gs-method-texel",
                case: format!("step of {stage}, 128x128"),
                variant: "dut tiny".into(),
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
