//! Time and error of a frame on the GPU, and the time of each phase.
//!
//! `cargo bench -p gs-gpu` prints, for each case, what its phases take on the device (without what is copied), then one row
//! with the copies beside the CPU's row; rows go to `target/speed-error/gs-gpu.jsonl`. Without a GPU it says so.

use criterion::Criterion;
use gs_core::Splats;
use gs_gpu::{Gpu, GpuError, GpuOptions, Renderer};
use gs_raster::measure::{Device, camera, device_rows, kernels, rows, scene};
use gs_raster::{Frame, FrameGrad, RasterOptions, ScreenStats};
use std::time::{Duration, Instant};

/// Frames of which the median is taken.
const RUNS: usize = 11;
/// Frames are rendered this long before they are timed.
const WARM_UP: Duration = Duration::from_secs(1);
/// Pairs of splat and pixel that the reference goes through when the error is measured.
const ERROR_PAIRS: f64 = 1e8;

/// Milliseconds of each phase on the device: medians over [`RUNS`] frames of the same bits.
fn phases(gpu: &Gpu, splats: &Splats, side: u32) -> Result<Vec<(&'static str, f64)>, GpuError> {
    let (camera, options, mut renderer) = (camera(side), RasterOptions::default(), Renderer::new(gpu));
    let d = FrameGrad { rgb: vec![1.0; 3 * (side * side) as usize], ..FrameGrad::default() };
    let (mut grad, mut stats, mut frame) = (Default::default(), ScreenStats::default(), Frame::default());
    // The first frame compiles the kernels and finds the room that it needs; the others raise the device's clock.
    let start = Instant::now();
    while start.elapsed() < WARM_UP {
        renderer.render_into(splats, &camera, &options, &mut frame)?;
        renderer.render_backward_into(splats, &camera, &options, &d, &mut grad, &mut stats)?;
    }
    renderer.time_phases();
    let (first, mut all, mut repeats) = ((frame.clone(), grad.clone()), Vec::new(), true);
    for _ in 0..RUNS {
        renderer.render_into(splats, &camera, &options, &mut frame)?;
        renderer.render_backward_into(splats, &camera, &options, &d, &mut grad, &mut stats)?;
        repeats &= (&frame, &grad) == (&first.0, &first.1);
        all.push(renderer.times()?);
    }
    println!("{RUNS} frames and gradients: {}", if repeats { "the same bits" } else { "different bits" });
    let Some(names) = all.first() else { return Ok(Vec::new()) };
    let middle = |k: usize| {
        let mut ms: Vec<f64> = all.iter().map(|times| times[k].1).collect();
        ms.sort_by(f64::total_cmp);
        ms[RUNS / 2]
    };
    Ok(names.iter().enumerate().map(|(k, (name, _))| (*name, middle(k))).collect())
}

fn print_phases(gpu: &Gpu, name: &str, splats: &Splats, side: u32) {
    match phases(gpu, splats, side) {
        Ok(times) => {
            let total: f64 = times.iter().map(|t| t.1).sum();
            let text: Vec<_> = times.iter().map(|(name, ms)| format!("{name} {ms:.3}")).collect();
            println!("{name}@{side}: {} = {total:.3} ms on the device", text.join(" + "));
        }
        Err(e) => println!("{name}@{side}: {e}"),
    }
}

fn case(gpu: &Gpu, name: &str, splats: &Splats, side: u32) {
    print_phases(gpu, name, splats, side);
    let on = Device { krate: "gs-gpu", name: gpu.name().to_owned() };
    let (camera, options) = (camera(side), RasterOptions::default());
    let error_side = ((ERROR_PAIRS / splats.len() as f64).sqrt() as u32).min(48);
    let mut renderer = Renderer::new(gpu);
    match device_rows(&mut renderer, &on, name, splats, &camera, &options, RUNS, error_side) {
        Ok(rows) => rows.iter().for_each(|row| row.append(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))),
        Err(e) => println!("{name}@{side}: {e}"),
    }
    for row in rows(name, splats, &camera, &options, RUNS, error_side) {
        println!("{row}");
    }
}

fn main() {
    let gpu = match Gpu::open() {
        Ok(gpu) => gpu,
        Err(e) => return println!("SKIPPED: {e}"),
    };
    println!("{}", gpu.description());
    let mut criterion =
        Criterion::default().sample_size(10).measurement_time(Duration::from_secs(2)).configure_from_args();
    let (splats, view, options) = (scene(10_000, 3), camera(256), RasterOptions::default());
    let (mut renderer, mut frame) = (Renderer::new(&gpu), Frame::default());
    criterion.bench_function("syn10k@256 forward", |b| {
        b.iter(|| renderer.render_into(&splats, &view, &options, &mut frame).expect("a frame"));
    });
    criterion.final_summary();
    case(&gpu, "syn10k", &splats, 256);
    for (name, kernel) in kernels(100_000) {
        case(&gpu, &format!("syn100k {name}"), &Splats { kernel, ..scene(100_000, 3) }, 800);
    }
    match Gpu::open_with(&GpuOptions { float_atomics: true, ..GpuOptions::default() }) {
        Ok(gpu) if !gpu.float_atomics() => println!("float atomics: {} has none", gpu.name()),
        Ok(gpu) => print_phases(&gpu, "syn100k by float atomics", &scene(100_000, 3), 800),
        Err(e) => println!("float atomics: {e}"),
    }
    if !gpu.is_software() {
        case(&gpu, "syn1M", &scene(1_000_000, 3), 1600);
    }
}
