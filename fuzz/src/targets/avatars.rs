//! Filmed people: the files of the film, and the poses beside it.

use super::{Error, Target, as_it_is, characters, folders};
use crate::case::Case;
use gs_data::avatar::rig::{RigCamera, read_rig};
use gs_synth::avatar::{Atlas, AvatarOptions, write};
use serde_json::json;
use std::path::Path;

const SCENE: &str = "scene.json";
const POSES: &str = "poses.json";
const POSES_BINARY: &str = "poses.bin";

pub fn targets() -> Vec<Target> {
    let one = |name, share, seeds, run| Target { name, share, seeds, repair: as_it_is, run };
    vec![one("avatar", 6, film, open), one("poses", 8, poses, open_poses), one("rig_opencv", 2, rigs, read)]
}

fn open(case: &Case, dir: &Path) -> Result<(), String> {
    let data = folders::open(case, dir, "avatar")?;
    let scene = data.avatar.as_ref().expect("a film has its scene");
    // The file's numbers are finite; a product of large ones need not be.
    let finite = scene.frames.iter().all(|frame| scene.posed(frame).iter().all(|v| v.is_finite()));
    if finite { Ok(()) } else { Err("a vertex is not finite".into()) }
}

/// Writes a film of a small rigged character.
fn write_film(dir: &Path) -> Result<(), Error> {
    let template = tempfile::NamedTempFile::with_suffix(".glb")?;
    std::fs::write(template.path(), characters::small_glb())?;
    let options = AvatarOptions {
        template: template.path().display().to_string(),
        atlas: Atlas::Painted,
        per_ring: 4,
        rings: 1,
        frames: 2,
        size: 16,
        points: 4,
        ..AvatarOptions::default()
    };
    write(dir, &options, false, true)?;
    // The path of the template is another each time.
    let scene = std::fs::read_to_string(dir.join(SCENE))?.replace(&options.template, "actor.glb");
    Ok(std::fs::write(dir.join(SCENE), scene)?)
}

fn film(dir: &Path) -> Result<Vec<Case>, Error> {
    write_film(dir)?;
    let case = Case::of_folder(dir, &[SCENE, "cameras.json", "points/000000.ply"])?;
    Ok(vec![case.with("crops.json", r#"{"0": {"1": [2, 3]}}"#)])
}

/// As [`open`], with one of the two files of poses.
fn open_poses(case: &Case, dir: &Path) -> Result<(), String> {
    for name in [POSES, POSES_BINARY] {
        // It is there if the input before this one had it.
        let _ = std::fs::remove_file(dir.join(name));
    }
    open(case, dir)
}

fn read(case: &Case, dir: &Path) -> Result<(), String> {
    case.write(dir).map_err(|e| format!("the work folder: {e}"))?;
    let cameras = read_rig(dir).map_err(|e| e.to_string())?;
    let finite = |c: &RigCamera| c.k.iter().chain(&c.dist).all(|v| v.is_finite()) && c.rotation.is_finite();
    assert!(cameras.iter().all(|c| finite(c) && c.translation.is_finite()), "a camera that is not finite");
    Ok(())
}

/// Two cameras in OpenCV's YAML, one turned by a matrix, one by three numbers.
fn rigs(_dir: &Path) -> Result<Vec<Case>, Error> {
    let head = "%YAML:1.0\n---\nnames:\n   - \"1\"\n   - \"b\"\n";
    let matrix = |name: &str, data: &str| {
        format!("{name}: !!opencv-matrix\n   rows: 1\n   cols: 1\n   dt: d\n   data: [ {data} ]\n")
    };
    let k = "5.5e+02, 0., 320., 0., 551., 240.,\n       0., 0., 1.";
    let intri =
        [head, &matrix("K_1", k), &matrix("K_b", k), &matrix("dist_1", "0.1, 0., 0., 0., 0."), "H_1: 8\nW_1: 9\n"];
    let one = [matrix("Rot_1", "1., 0., 0., 0., 1., 0., 0., 0., 1."), matrix("T_1", "0., 1., 2.")].concat();
    let other = [matrix("R_b", "0.1, -0.2, 3."), matrix("T_b", "0., -1.5, .5")].concat();
    Ok(vec![Case::one("intri.yml", intri.concat()).with("extri.yml", [head, &one, &other].concat())])
}

/// Poses as text and in binary.
fn poses(dir: &Path) -> Result<Vec<Case>, Error> {
    write_film(dir)?;
    let node = json!({"translation": [0, 1, 0.5], "rotation": [0.9, 0.1, 0, 0], "scale": [1, 1, 2]});
    let text = json!({"0": {"nodes": {"upper": node}, "morphs": [0.5, 0]}, "1": {"morphs": [1, 0.25]}}).to_string();
    let name = b"lower";
    let head = [b"GS4DPOSE", &[1u32, 1, 2, 2].map(u32::to_le_bytes).concat()[..]].concat();
    let mut binary = [&head[..], &(name.len() as u16).to_le_bytes(), name].concat();
    for frame in 0..2u32 {
        binary.extend(frame.to_le_bytes());
        binary.extend([0.0, 1.0, 0.5, 0.9, 0.1, 0.0, 0.0, 1.0, 1.0, 2.0, 0.5, 0.25].map(f32::to_le_bytes).concat());
    }
    Ok(vec![Case::one(POSES, text), Case::one(POSES_BINARY, binary)])
}
