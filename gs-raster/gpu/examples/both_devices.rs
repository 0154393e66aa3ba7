//! One scene on the GPU and on the CPU: time of a frame with its gradient, and how far the two are apart.
//!
//! `cargo run --release -p gs-gpu --example both_devices [splats] [side]`

use gs_core::SplatsGrad;
use gs_gpu::{Gpu, Renderer};
use gs_raster::{Frame, FrameGrad, RasterOptions, Rasterizer, ScreenStats, Workspace, measure};
use std::time::Instant;

/// Frames before the one that is timed.
const WARM_UP: usize = 3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1).map(|a| a.parse::<u32>());
    let n = args.next().transpose()?.unwrap_or(100_000);
    let side = args.next().transpose()?.unwrap_or(800);
    let (splats, camera, options) = (measure::scene(n as usize, 3), measure::camera(side), RasterOptions::default());
    let gpu = Gpu::open()?;
    let mut devices: [Box<dyn Rasterizer>; 2] = [Box::new(Renderer::new(&gpu)), Box::new(Workspace::new())];
    let mut frames = Vec::new();
    for device in &mut devices {
        let (mut frame, mut grad, mut stats) = (Frame::default(), SplatsGrad::default(), ScreenStats::default());
        let d = FrameGrad { rgb: vec![1.0; 3 * (side * side) as usize], ..FrameGrad::default() };
        let mut ms = [0.0; 2];
        for _ in 0..=WARM_UP {
            let start = Instant::now();
            device.render_into(splats.view(), &camera, &options, &mut frame)?;
            ms[0] = start.elapsed().as_secs_f64() * 1e3;
            device.render_backward_into(splats.view(), &camera, &options, &d, &mut grad, &mut stats)?;
            ms[1] = start.elapsed().as_secs_f64() * 1e3;
        }
        println!("{}: forward {:.1} ms, with its gradient {:.1} ms", device.device(), ms[0], ms[1]);
        frames.push((frame, grad));
    }
    let [(a, da), (b, db)] = [&frames[0], &frames[1]].map(|(frame, grad)| (&frame.rgb.data, &grad.opacities));
    let worst = |a: &[f32], b: &[f32]| a.iter().zip(b).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
    println!("largest difference: {:.1e} in the image, {:.1e} in dL/d opacity", worst(a, b), worst(da, db));
    Ok(())
}
