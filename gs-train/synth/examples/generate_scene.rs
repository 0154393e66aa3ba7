//! Writes a generated scene as a D-NeRF folder: `cargo run --example generate_scene -- balls out/balls 200`.

use std::path::Path;

use gs_synth::{SynthOptions, write};

fn main() -> Result<(), String> {
    let args: Vec<String> = std::env::args().collect();
    let [_, scene, dir, size] = args.as_slice() else {
        return Err("usage: generate_scene SCENE FOLDER SIZE".into());
    };
    let size = size.parse().map_err(|_| format!("\"{size}\" is no number of pixels"))?;
    let options = SynthOptions { size, ..SynthOptions::default() };
    let made = write(Path::new(dir), scene, &options, false).map_err(|e| e.report())?;
    println!("{} training views of \"{scene}\" in {dir}", made.dataset.train.len());
    Ok(())
}
