//! Milliseconds of a step of training on the GPU and on the CPU, and how far apart the losses of one step are.
//!
//! `cargo bench -p gs-train-gpu` prints a row for each method and device, from the same state, behind a warm-up; rows go to
//! `target/speed-error/gs-train-gpu.jsonl`. Without a GPU it says so. The CPU's row is of all threads.

use criterion::Criterion;
use gs_core::speed::BenchRow;
use gs_data::Dataset;
use gs_gpu::Gpu;
use gs_methods::registry;
use gs_synth::testkit::scene;
use gs_train::checkpoint::Checkpoint;
use gs_train::testkit;
use gs_train::trainer::Trainer;
use std::sync::Arc;

/// Side of the images, pixels.
const SIDE: u32 = 200;
/// Number of first points, of which all become splats.
const SPLATS: usize = 20_000;
/// Steps made before those that are timed: past the warm-up of every method.
const BEFORE: u32 = 40;
/// Steps timed.
const TIMED: u32 = 20;

/// A run of a method after its warm-up, of a fixed number of splats.
fn begun(data: &Arc<Dataset>, method: &str) -> Checkpoint {
    let fixed = format!("init.points = {SPLATS}\nschedule.density.until = 0\nschedule.density.max_splats = {SPLATS}");
    let config = testkit::short(registry(), method, &[&fixed]);
    let mut trainer = testkit::start(registry(), data, method, &config, 1);
    testkit::run(&mut trainer, BEFORE);
    trainer.state()
}

/// Median milliseconds of the steps that follow a state, the loss of the first, and the number of splats.
fn steps(data: &Arc<Dataset>, state: &Checkpoint, gpu: Option<&Gpu>) -> (f64, f64, usize) {
    let trainer = Trainer::resume(registry(), data.clone(), state, None, 1 << 28).expect("a run");
    let mut trainer = match gpu {
        Some(gpu) => trainer.on(&gs_train_gpu::device(gpu)).expect("a device"),
        None => trainer,
    };
    let reports = testkit::run(&mut trainer, TIMED);
    let mut ms: Vec<f64> = reports.iter().map(|r| r.ms.total).collect();
    ms.sort_by(f64::total_cmp);
    (ms[ms.len() / 2], reports[0].loss.total, reports[0].splats)
}

fn main() {
    let gpu = match Gpu::open() {
        Ok(gpu) => gpu,
        Err(e) => return println!("SKIPPED: {e}"),
    };
    println!("{}", gpu.description());
    Criterion::default().configure_from_args().final_summary();
    let data = scene("balls", SIDE, 8);
    for method in ["static3d", "fourdgs", "defgs"] {
        let state = begun(&data, method);
        let (cpu, want, n) = steps(&data, &state, None);
        let (device, got, _) = steps(&data, &state, Some(&gpu));
        let rows =
            [("cpu", rayon::current_num_threads(), cpu, None), (gpu.name(), 0, device, Some((got / want - 1.0).abs()))];
        for (variant, threads, ms, error) in rows {
            let row = BenchRow {
                krate: "gs-train-gpu",
                case: format!("{method} step@{SIDE}"),
                variant: variant.to_owned(),
                n,
                threads,
                ms,
                work: n as f64,
                error,
                error_kind: "relative, loss of a step against the CPU's",
            };
            row.append(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
        }
    }
}
