//! Draws a splat file: `cargo run --release -p gs-raster --example draw_ply -- scene.ply cameras.json out.ppm`.
//!
//! Without arguments it draws a random scene of its own and prints the picture's statistics.

use gs_core::io::{Limits, load_cameras, load_splats};
use gs_raster::measure::{camera, scene};
use gs_raster::{Frame, RasterOptions, Workspace, render};
use std::io::Write;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let (splats, camera, out) = match args.as_slice() {
        [ply, cameras, out] => {
            let limits = Limits::default();
            let splats = load_splats(ply.as_ref(), &limits)?.to_splats()?;
            let first =
                load_cameras(cameras.as_ref(), &limits)?.into_iter().next().ok_or("the camera file is empty")?;
            (splats, first.camera, Some(out))
        }
        _ => (scene(20_000, 3), camera(400), None),
    };
    let mut workspace = Workspace::new();
    let start = std::time::Instant::now();
    let frame = render(&splats, &camera, &RasterOptions::default(), &mut workspace);
    let mean = frame.alpha.iter().sum::<f32>() / frame.alpha.len() as f32;
    println!(
        "{} splats, {}x{}: {:.1} ms, mean alpha {mean:.3}, {} of {} tile entries used",
        splats.len(),
        frame.width,
        frame.height,
        start.elapsed().as_secs_f64() * 1e3,
        workspace.entries_used(),
        workspace.entries(),
    );
    if let Some(out) = out {
        write_ppm(&frame, std::fs::File::create_new(out)?)?;
    }
    Ok(())
}

/// Portable pixmap: the simplest picture format there is.
fn write_ppm(frame: &Frame, file: std::fs::File) -> std::io::Result<()> {
    let mut to = std::io::BufWriter::new(file);
    write!(to, "P6\n{} {}\n255\n", frame.width, frame.height)?;
    let bytes: Vec<u8> = frame.rgb.iter().map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8).collect();
    to.write_all(&bytes)?;
    to.flush()
}
