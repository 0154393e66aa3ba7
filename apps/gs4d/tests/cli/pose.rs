//! `gs4d pose`: a character made here, posed as its keys say; refusals that name what is wrong.

use crate::support::{good, gs4d, text};
use std::fs;
use std::path::{Path, PathBuf};

/// A triangle on a node that is lifted by 2 in a second, its numbers in `tri.bin`.
fn character(folder: &Path, buffer: &str) -> PathBuf {
    let floats: [f32; 17] = [0., 0., 0., 1., 0., 0., 0., 1., 0., 0., 1., 0., 0., 0., 0., 2., 0.];
    let bytes: Vec<u8> = floats.iter().flat_map(|v| v.to_le_bytes()).collect();
    fs::write(folder.join("tri.bin"), bytes).unwrap();
    let accessor = |offset: usize, count: usize, kind: &str| {
        format!(r#"{{"bufferView":0,"byteOffset":{offset},"componentType":5126,"count":{count},"type":"{kind}"}}"#)
    };
    let accessors = [accessor(0, 3, "VEC3"), accessor(36, 2, "SCALAR"), accessor(44, 2, "VEC3")].join(",");
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],"buffers":[{{"uri":"{buffer}","byteLength":68}}],
        "bufferViews":[{{"buffer":0,"byteLength":68}}],"accessors":[{accessors}],"animations":[{{"name":"lift",
        "samplers":[{{"input":1,"output":2}}],"channels":[{{"sampler":0,"target":{{"node":0,"path":"translation"}}}}]}}]}}"#
    );
    let path = folder.join("tri.gltf");
    fs::write(&path, json).unwrap();
    path
}

#[test]
fn a_pose_is_written_as_a_mesh() {
    let dir = tempfile::tempdir().unwrap();
    let file = character(dir.path(), "tri.bin");
    let out = dir.path().join("a.obj");
    let call = ["pose", text(&file), "--clip", "lift", "--time", "0.5", "-o", text(&out)];
    let json = good(&[&call[..], &["--json"]].concat()).json();
    assert_eq!((json["vertices"].as_u64(), json["clips"][0]["seconds"].as_f64()), (Some(3), Some(1.0)));
    assert_eq!(fs::read_to_string(&out).unwrap(), "v 0 1 0\nv 1 1 0\nv 0 2 0\nf 1 2 3\n");
    gs4d(&call).fails(6, &["exists already"]);
    good(&[&call[..], &["-f", "--skinning", "dqs"]].concat());
    let ply = dir.path().join("a.ply");
    good(&["pose", text(&file), "-o", text(&ply)]);
    assert!(fs::read_to_string(&ply).unwrap().contains("0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"));
}

#[test]
fn a_motion_of_a_bvh_file_moves_a_character() {
    let dir = tempfile::tempdir().unwrap();
    let file = character(dir.path(), "tri.bin");
    let named = fs::read_to_string(&file).unwrap().replace(r#"{"mesh":0}"#, r#"{"name":"Pelvis","mesh":0}"#);
    fs::write(&file, named).unwrap();
    let (out, bvh) = (dir.path().join("a.obj"), dir.path().join("lift.bvh"));
    let text_of = |name: &str| {
        format!(
            "HIERARCHY ROOT {name} {{ OFFSET 0 0 0 CHANNELS 3 Xposition Yposition Zposition }} \
             MOTION Frames: 2 Frame Time: 1 0 0 0 0 2 0"
        )
    };
    fs::write(&bvh, text_of("Hips")).unwrap();
    let call = ["pose", text(&file), "--motion", text(&bvh), "--time", "0.5", "-o", text(&out)];
    good(&call);
    assert_eq!(fs::read_to_string(&out).unwrap(), "v 0 1 0\nv 1 1 0\nv 0 2 0\nf 1 2 3\n");
    fs::write(&bvh, text_of("bone")).unwrap();
    let again = [&call[..], &["-f"]].concat();
    gs4d(&again).fails(3, &["no joint of the motion (bone)", "(Pelvis)", "--partner JOINT=PARTNER"]);
    good(&[&again[..], &["--partner", "Pelvis=bone"]].concat());
    gs4d(&[&again[..], &["--partner", "Pelvis"]].concat()).fails(2, &["JOINT=PARTNER"]);
    fs::write(&bvh, "HIERARCHY").unwrap();
    gs4d(&again).fails(3, &["lift.bvh: line 1: the file ends where ROOT should be"]);
}

#[test]
fn wrong_calls_and_files_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let file = character(dir.path(), "tri.bin");
    let out = dir.path().join("a.obj");
    let to = |file: &Path, more: &[&str]| gs4d(&[&["pose", text(file), "-o", text(&out)], more].concat());
    to(&file, &["--clip", "jump"]).fails(2, &["jump", "`lift`"]);
    to(&file, &["--time", "1"]).fails(2, &["--clip"]);
    to(&file, &["--clip", "lift", "--time", "inf"]).fails(2, &["time"]);
    gs4d(&["pose", text(&file), "-o", text(&dir.path().join("a.fbx"))]).fails(2, &[".obj"]);
    to(&dir.path().join("absent.glb"), &[]).fails(6, &["absent.glb"]);
    to(&character(dir.path(), "absent.bin"), &[]).fails(6, &["absent.bin"]);
    for trick in ["../tri.bin", "%2e%2e/tri.bin", "/etc/hostname", "file:///etc/hostname", "https://x.org/a.bin"] {
        to(&character(dir.path(), trick), &[]).fails(3, &["its own folder"]);
    }
    assert!(!out.exists());
}
