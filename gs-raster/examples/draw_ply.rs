//! Renders a splat file: `cargo run --release -p gs-raster --example draw_ply -- scene.ply cameras.json out.ppm`.
//!
//! Uses the file's kernel if it has one, and draws anti-aliased if it says so. Without arguments it renders a random scene
//! with each kernel and prints the statistics of the images.

use gs_core::io::{Limits, load_cameras, load_splats};
use gs_core::{Camera, Splats};
use gs_raster::measure::{camera, kernels, scene};
use gs_raster::{Frame, RasterOptions, Workspace, render};
use std::io::Write;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [ply, cameras, out] = args.as_slice() else {
        let n = 20_000;
        for (name, kernel) in kernels(n) {
            render_timed(name, &Splats { kernel, ..scene(n, 3) }, &camera(400), &RasterOptions::default());
        }
        return Ok(());
    };
    let limits = Limits::default();
    let raw = load_splats(ply.as_ref(), &limits)?;
    let (splats, options) =
        (raw.to_splats()?, RasterOptions { antialias: raw.antialiased, ..RasterOptions::default() });
    let first = load_cameras(cameras.as_ref(), &limits)?.into_iter().next().ok_or("the camera file is empty")?;
    write_ppm(&render_timed(ply, &splats, &first.camera, &options), std::fs::File::create_new(out)?)?;
    Ok(())
}

/// Renders, and prints time and statistics.
fn render_timed(name: &str, splats: &Splats, camera: &Camera, options: &RasterOptions) -> Frame {
    let mut workspace = Workspace::new();
    let start = std::time::Instant::now();
    let frame = render(splats, camera, options, &mut workspace);
    let mean = frame.alpha.iter().sum::<f32>() / frame.alpha.len() as f32;
    println!(
        "{name}: {} splats, {}x{}: {:.1} ms, mean alpha {mean:.3}, {} of {} tile entries used",
        splats.len(),
        frame.rgb.width,
        frame.rgb.height,
        start.elapsed().as_secs_f64() * 1e3,
        workspace.entries_used(),
        workspace.entries(),
    );
    frame
}

/// Writes a portable pixmap (binary PPM), values clamped to `[0, 1]`.
fn write_ppm(frame: &Frame, file: std::fs::File) -> std::io::Result<()> {
    let mut to = std::io::BufWriter::new(file);
    write!(to, "P6\n{} {}\n255\n", frame.rgb.width, frame.rgb.height)?;
    let bytes: Vec<u8> = frame.rgb.data.iter().map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8).collect();
    to.write_all(&bytes)?;
    to.flush()
}
