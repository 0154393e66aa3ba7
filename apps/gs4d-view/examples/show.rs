//! Shows a splat file, or two red and blue splats, until Enter is pressed.
//!
//! ```text
//! cargo run --release -p gs4d-view --example show -- [scene.ply]
//! ```

use gs_core::io::{Limits, load_splats};
use gs_core::{Color, Kernel, Splats};
use gs4d_view::{Options, Packing, REQUEST_TIME, Show, Stage, start};
use std::error::Error;
use std::net::Ipv4Addr;

fn main() -> Result<(), Box<dyn Error>> {
    let (splats, antialiased) = match std::env::args().nth(1) {
        Some(path) => {
            let raw = load_splats(path.as_ref(), &Limits::default())?;
            (raw.to_splats()?, raw.antialiased)
        }
        None => (two(), false),
    };
    let stage = Stage::new(vec![Show::splats("scene".into(), splats).antialiased(antialiased)]);
    let (host, packing) = (Ipv4Addr::LOCALHOST.into(), Packing::Png);
    let device = gs_train::device::Device::default();
    let options = Options { host, port: 7007, packing, share: None, request_time: REQUEST_TIME, device };
    let server = start(stage, &options)?;
    println!("{}\nEnter ends it", server.url);
    std::io::stdin().read_line(&mut String::new())?;
    Ok(())
}

fn two() -> Splats {
    Splats {
        means: vec![glam::Vec3::ZERO, glam::Vec3::new(0.3, 0.0, 0.5)],
        quats: vec![[1.0, 0.0, 0.0, 0.0]; 2],
        scales: vec![glam::Vec3::splat(0.2); 2],
        opacities: vec![0.9, 0.8],
        color: Color::Rgb(vec![[0.9, 0.2, 0.1], [0.1, 0.3, 0.9]]),
        kernel: Kernel::Gaussian,
    }
}
