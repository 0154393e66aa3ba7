//! Time and error of a frame, by kernel, instruction set and threads. How cost grows is in `gs4d bench --table growth`.
//!
//! `cargo bench -p gs-raster` prints criterion's statistics of the three reference cases, then one row per case,
//! instruction set and thread count, beside the machine's roofline; rows go to `target/speed-error/gs-raster.jsonl`.

use criterion::Criterion;
use gs_core::{Camera, Kernel, Splats};
use gs_raster::measure::{Roofline, camera, kernels, rows, scene};
use gs_raster::{
    Frame, FrameGrad, RasterOptions, ScreenStats, SimdLevel, Workspace, render_backward_into, render_into,
};
use std::time::Duration;

fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool")
}

fn criterion_cases(c: &mut Criterion) {
    for (name, n, side) in [("syn10k@256", 10_000, 256), ("syn100k@800", 100_000, 800)] {
        let (splats, camera) = (scene(n, 3), camera(side));
        let options = RasterOptions::default();
        let (mut workspace, mut frame) = (Workspace::new(), Frame::default());
        let d = FrameGrad { rgb: vec![1.0; 3 * (side * side) as usize], ..FrameGrad::default() };
        let (mut grad, mut stats) = (Default::default(), ScreenStats::default());
        c.bench_function(&format!("{name} forward"), |b| {
            b.iter(|| render_into(&splats, &camera, &options, &mut workspace, &mut frame));
        });
        c.bench_function(&format!("{name} forward+backward"), |b| {
            b.iter(|| {
                render_into(&splats, &camera, &options, &mut workspace, &mut frame);
                render_backward_into(&splats, &camera, &options, &mut workspace, &d, &mut grad, &mut stats);
            });
        });
    }
}

fn record(case: &str, splats: &Splats, camera: &Camera, simd: SimdLevel) {
    record_with(case, splats, camera, &RasterOptions { simd, ..RasterOptions::default() });
}

fn record_with(case: &str, splats: &Splats, camera: &Camera, options: &RasterOptions) {
    for row in rows(case, splats, camera, options, 11, 48) {
        row.append(env!("CARGO_MANIFEST_DIR"));
    }
}

/// Every kernel on the same splats; and for soft and sharp ones, exact supports beside the published rasteriser's box
/// of three standard deviations.
fn kernel_rows(n: usize, side: u32) {
    let camera = camera(side);
    for (name, kernel) in kernels(n) {
        record(name, &Splats { kernel, ..scene(n, 3) }, &camera, SimdLevel::Auto);
    }
    for (name, lambda, beta) in [("soft", 0.05, 0.5), ("sharp", 1.0, 0.9)] {
        let kernel = Kernel::Frequency { lambdas: vec![lambda; n], betas: vec![beta; n] };
        let splats = Splats { kernel, ..scene(n, 3) };
        for (support, box_sigmas) in [("exact", f64::INFINITY), ("3 sigma", 3.0)] {
            let options = RasterOptions { box_sigmas, ..RasterOptions::default() };
            record_with(&format!("{name}, {support}"), &splats, &camera, &options);
        }
    }
}

fn main() {
    let mut criterion =
        Criterion::default().sample_size(10).measurement_time(Duration::from_secs(2)).configure_from_args();
    criterion_cases(&mut criterion);
    criterion.final_summary();
    for threads in [1, 2] {
        println!("kernels, {threads} threads");
        pool(threads).install(|| kernel_rows(100_000, 800));
    }
    let big = scene(100_000, 3);
    for simd in [SimdLevel::Auto, SimdLevel::Avx2, SimdLevel::Portable] {
        for threads in [1, 2] {
            pool(threads).install(|| {
                let roofs = Roofline::measure(simd);
                println!("{threads} threads, {simd:?}: {:.0} GFLOP/s FMA, {:.1} Gexp/s", roofs.fma, roofs.exp2);
                record("syn100k", &big, &camera(800), simd);
            });
        }
    }
}
