//! Poses a rigged character and writes its mesh: `cargo run --example pose -- FILE [CLIP] [SECONDS] > posed.obj`.

use gs_texel::write_mesh::write_obj;
use gs_texel::{ReadOptions, Skinning, load_character};
use std::error::Error;
use std::io::{BufWriter, Write, stdout};
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let file = PathBuf::from(arguments.first().ok_or("give a .glb, .gltf or .obj file")?);
    let character = load_character(&file, &ReadOptions { textures: false, ..ReadOptions::default() })?;
    for clip in &character.clips {
        eprintln!("clip `{}`, {} s", clip.name, clip.duration());
    }
    let pose = match arguments.get(1) {
        None => character.skeleton.rest_pose(),
        Some(name) => {
            let clip = character.clip(name).ok_or("no clip of that name")?;
            clip.pose(&character.skeleton, arguments.get(2).map_or(Ok(0.0), |t| t.parse())?)
        }
    };
    let mut out = BufWriter::new(stdout().lock());
    write_obj(&character, &character.posed(&pose, Skinning::Lbs), &mut out)?;
    Ok(out.flush()?)
}
