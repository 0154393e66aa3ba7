//! Times a PLY and a camera file: `cargo run --release -p gs-raster --example peers -- scene.ply camera.json [runs]`.
//!
//! Prints forward and forward + backward medians for one and two threads and each instruction set, beside the machine's
//! roofline, so that times can be compared between machines. Without arguments it times a random scene.

use gs_core::io::{Limits, load_cameras, load_splats};
use gs_core::speed::median_seconds;
use gs_raster::measure::{Roofline, camera, scene};
use gs_raster::{
    Frame, FrameGrad, RasterOptions, ScreenStats, SimdLevel, Workspace, render_backward_into, render_into,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let limits = Limits::default();
    let (splats, camera) = match args.as_slice() {
        [ply, file, ..] => {
            let splats = load_splats(ply.as_ref(), &limits)?.to_splats()?;
            (splats, load_cameras(file.as_ref(), &limits)?.remove(0).camera)
        }
        _ => (scene(100_000, 3), camera(800)),
    };
    let runs = args.get(2).map_or(Ok(11), |r| r.parse())?;
    println!("{} splats, {}x{}", splats.len(), camera.width, camera.height);
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        for simd in [SimdLevel::Auto, SimdLevel::Avx2] {
            pool.install(|| time(&splats, &camera, simd, runs));
        }
    }
    Ok(())
}

fn time(splats: &gs_core::Splats, camera: &gs_core::Camera, simd: SimdLevel, runs: usize) {
    let roofs = Roofline::measure(simd);
    let options = RasterOptions { simd, ..Default::default() };
    let (mut workspace, mut frame) = (Workspace::new(), Frame::default());
    let n = (camera.width * camera.height) as usize;
    let d = FrameGrad { rgb: (0..3 * n).map(|i| (i % 7) as f32 - 3.0).collect(), ..Default::default() };
    let (mut grad, mut stats) = (Default::default(), ScreenStats::default());
    let forward = median_seconds(runs, || render_into(splats, camera, &options, &mut workspace, &mut frame));
    let both = median_seconds(runs, || {
        render_into(splats, camera, &options, &mut workspace, &mut frame);
        render_backward_into(splats, camera, &options, &mut workspace, &d, &mut grad, &mut stats);
    });
    println!(
        "{} threads {simd:?}: forward {:.2} ms, forward+backward {:.2} ms | roof {:.0} GFLOP/s, {:.1} Gexp/s | {:.1} / {:.1} GFLOP-equivalents | {} entries, {} used, {:.0} MB",
        roofs.threads,
        1e3 * forward,
        1e3 * both,
        roofs.fma,
        roofs.exp2,
        forward * roofs.fma,
        both * roofs.fma,
        workspace.entries(),
        workspace.entries_used(),
        workspace.bytes() as f64 * 1e-6,
    );
}
