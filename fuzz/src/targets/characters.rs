//! Characters: glTF, GLB and OBJ; motions: BVH.

use super::{Error, Target, as_it_is, images, splats::glb_of};
use crate::case::Case;
use gs_texel::read::parse_motion;
use gs_texel::retarget::retarget;
use gs_texel::{Character, ReadOptions, Skinning, load_character, parse_character};
use serde_json::json;
use std::path::Path;

#[path = "../../../gs-texel/tests/texel/small_gltf.rs"]
mod small_gltf;

pub fn targets() -> Vec<Target> {
    let one = |name, share, seeds, run| Target { name, share, seeds, repair: as_it_is, run };
    vec![
        one("char_glb", 4, glb_seeds, |c, _| {
            parse_character(&glb_of(c), "a.glb", &ReadOptions::default()).map(sound).map_err(|e| e.to_string())
        }),
        one("char_gltf", 3, gltf_seeds, |c, d| load(c, d, "a.gltf")),
        one("char_obj", 3, obj_seeds, |c, d| load(c, d, "a.obj")),
        one("motion_bvh", 2, bvh_seeds, |c, _| motion(c)),
    ]
}

/// JSON and binary chunk of a small rigged character; with a texture if asked.
fn small(texture: bool) -> Result<Case, Error> {
    let mut s = small_gltf::small();
    if texture {
        let view = s.view(&images::png(4, 4, 4)?);
        s.json["images"] = json!([{"bufferView": view, "mimeType": "image/png"}]);
        s.json["textures"] = json!([{"source": 0}]);
        s.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({"index": 0});
    }
    s.json["buffers"] = json!([{"byteLength": s.bin.len()}]);
    Ok(Case::one("json", s.json.to_string()).with("bin", s.bin))
}

/// A small rigged character as a GLB file.
pub fn small_glb() -> Vec<u8> {
    small_gltf::small().glb()
}

fn glb_seeds(_: &Path) -> Result<Vec<Case>, Error> {
    Ok(vec![small(false)?, small(true)?, Case::one("a", small_glb())])
}

fn gltf_seeds(dir: &Path) -> Result<Vec<Case>, Error> {
    let mut s = small_gltf::small();
    s.json["buffers"] = json!([{"byteLength": s.bin.len(), "uri": "a.bin"}]);
    s.json["images"] = json!([{"uri": "a.png"}]);
    s.json["textures"] = json!([{"source": 0}]);
    s.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({"index": 0});
    Case::one("a.png", images::png(4, 4, 4)?).write(dir)?;
    Ok(vec![Case::one("a.gltf", s.json.to_string()).with("a.bin", s.bin)])
}

fn obj_seeds(dir: &Path) -> Result<Vec<Case>, Error> {
    Case::one("a.png", images::png(4, 4, 4)?).write(dir)?;
    let obj = "mtllib a.mtl\no a\nv 0 0 0\nv 1 0 0\nv 1 1 0.5\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\nusemtl m\n\
        f 1/1/1 2/2/1 3/3/1 4/1/1\nf -1/-1 -2/-2 -3/-3\n";
    let mtl = "newmtl m\nKd 0.5 0.6 0.7\nd 0.5\nmap_Kd a.png\n";
    Ok(vec![Case::one("a.obj", obj).with("a.mtl", mtl)])
}

fn bvh_seeds(_: &Path) -> Result<Vec<Case>, Error> {
    let bvh = "HIERARCHY\nROOT Hips\n{\nOFFSET 0 90 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n\
        JOINT LeftUpLeg\n{\nOFFSET 9 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n{\nOFFSET 0 -40 0\n}\n}\n}\n\
        MOTION\nFrames: 2\nFrame Time: 0.04\n0 90 0 0 0 0 0 0 0\n1 90 2 10 20 30 -5 0 5\n";
    Ok(vec![Case::one("a.bvh", bvh)])
}

/// A motion, brought to the skeleton of the built-in person where joints correspond.
fn motion(case: &Case) -> Result<(), String> {
    let m = parse_motion(case.first(), "a.bvh").map_err(|e| e.to_string())?;
    assert!(
        m.frame_time > 0.0
            && m.skeleton.nodes.iter().enumerate().all(|(n, node)| node.parent.is_none_or(|p| (p as usize) < n))
    );
    let pose = m.clip.pose(&m.skeleton, 0.7 * m.clip.duration());
    assert_eq!(m.skeleton.globals(&pose).len(), m.skeleton.nodes.len());
    let person = gs_texel::figure::person();
    if let Ok(moved) = retarget(&m.skeleton, &m.clip, &person.skeleton, &Default::default()) {
        let values = moved.clip.channels.iter().flat_map(|c| &c.values);
        assert!(values.clone().all(|v| v.is_finite()), "a pose that is not finite");
    }
    Ok(())
}

fn load(case: &Case, dir: &Path, name: &str) -> Result<(), String> {
    case.write(dir).map_err(|e| format!("the work folder: {e}"))?;
    load_character(&dir.join(name), &ReadOptions::default()).map(sound).map_err(|e| e.to_string())
}

/// What every character that is read satisfies.
fn sound(c: Character) {
    let (t, n) = (&c.template, c.template.vertices.len());
    assert!(t.vertices.iter().all(|v| v.is_finite()) && t.weights.len() == n);
    assert!(t.faces.iter().flatten().all(|&v| (v as usize) < n) && t.face_materials.len() == t.faces.len());
    assert!(t.weights.joints.iter().all(|&j| (j as usize) < c.skeleton.joints.len()));
    assert!(t.face_uvs.iter().flatten().all(|&v| (v as usize) < t.uvs.len()));
    for clip in c.clips.iter().take(3) {
        assert_eq!(c.posed(&clip.pose(&c.skeleton, 0.7), Skinning::Lbs).len(), n);
    }
}
