//! A film whose poses come from a BVH file: the layout's field `motion`.

use gs_data::{DataError, DataOptions, Dataset};
use gs_synth::avatar::{AvatarOptions, write};
use gs_texel::skin::rotation_of;
use gs_texel::{Clip, Skeleton};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::Path;

/// Degrees about z, x and y whose rotations, in this order, make up a matrix.
fn angles(m: &glam::DMat3) -> [f64; 3] {
    let (z, x, y) = glam::DQuat::from_mat3(m).to_euler(glam::EulerRot::ZXY);
    [z, x, y].map(f64::to_degrees)
}

/// A motion as a BVH file in centimetres, `names` for the joints.
fn bvh(skeleton: &Skeleton, clip: &Clip, fps: f64, frames: u32, names: impl Fn(&str) -> String) -> String {
    fn joint(out: &mut String, s: &Skeleton, n: u32, names: &dyn Fn(&str) -> String) {
        let (node, root) = (&s.nodes[n as usize], s.nodes[n as usize].parent.is_none());
        let o = 100.0 * node.rest.translation;
        let places = if root { "6 Xposition Yposition Zposition" } else { "3" };
        let kind = if root { "ROOT" } else { "JOINT" };
        write!(out, "{kind} {}\n{{\nOFFSET {} {} {}\n", names(&node.name), o.x, o.y, o.z).unwrap();
        writeln!(out, "CHANNELS {places} Zrotation Xrotation Yrotation").unwrap();
        let below: Vec<u32> = (0..s.nodes.len() as u32).filter(|&c| s.nodes[c as usize].parent == Some(n)).collect();
        below.iter().for_each(|&c| joint(out, s, c, names));
        if below.is_empty() {
            out.push_str("End Site\n{\nOFFSET 0 5 0\n}\n");
        }
        out.push_str("}\n");
    }
    /// Rows of the joints in the order of the file.
    fn order(s: &Skeleton, n: u32, rows: &mut Vec<u32>) {
        rows.push(n);
        (0..s.nodes.len() as u32).filter(|&c| s.nodes[c as usize].parent == Some(n)).for_each(|c| order(s, c, rows));
    }
    let mut out = "HIERARCHY\n".to_owned();
    joint(&mut out, skeleton, 0, &names);
    let mut rows = Vec::new();
    order(skeleton, 0, &mut rows);
    writeln!(out, "MOTION\nFrames: {frames}\nFrame Time: {}", 1.0 / fps).unwrap();
    for k in 0..frames {
        let pose = clip.pose(skeleton, f64::from(k) / fps);
        let mut numbers: Vec<f64> = Vec::new();
        for &n in &rows {
            let local = &pose.locals[n as usize];
            if n == 0 {
                numbers.extend((100.0 * local.translation).to_array());
            }
            numbers.extend(angles(&rotation_of(local.affine().matrix3).unwrap()));
        }
        writeln!(out, "{}", numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" ")).unwrap();
    }
    out
}

fn edit(dir: &Path, fields: &[(&str, Value)]) {
    let file = dir.join("scene.json");
    let mut scene: Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    fields.iter().for_each(|(key, value)| scene[*key] = value.clone());
    std::fs::write(file, scene.to_string()).unwrap();
}

fn open(dir: &Path) -> Result<Dataset, DataError> {
    Dataset::open(dir, &DataOptions::default())
}

#[test]
fn a_motion_from_a_file_poses_the_template_as_its_own_clip_does() {
    let dir = tempfile::tempdir().unwrap();
    let options = AvatarOptions { per_ring: 4, rings: 1, frames: 6, size: 16, points: 10, ..AvatarOptions::default() };
    write(dir.path(), &options, false, false).unwrap();
    let own = open(dir.path()).unwrap();
    let own = own.avatar.as_deref().unwrap();
    let (skeleton, walk) = (&own.character.skeleton, own.character.clip("walk").unwrap());
    // Names of another convention.
    let mixamo = |name: &str| {
        let (side, part) = name.split_once(' ').filter(|n| ["left", "right"].contains(&n.0)).unwrap_or(("", name));
        let known =
            [("upper arm", "Arm"), ("fore arm", "ForeArm"), ("thigh", "UpLeg"), ("shin", "Leg"), ("chest", "Spine2")];
        let part = known.iter().find(|k| k.0 == part).map_or(part, |k| k.1);
        format!("mixamorig:{side}{part}")
    };
    std::fs::write(dir.path().join("walk.bvh"), bvh(skeleton, walk, own.fps, 6, mixamo)).unwrap();
    edit(dir.path(), &[("clip", Value::Null), ("motion", json!("walk.bvh"))]);
    let read = open(dir.path()).unwrap();
    let read = read.avatar.as_deref().unwrap();
    assert_eq!(read.frames.len(), own.frames.len());
    let resting = own.posed(&gs_data::avatar::AvatarFrame { pose: skeleton.rest_pose(), ..own.frames[2].clone() });
    for (a, b) in own.frames.iter().zip(&read.frames) {
        let (a, b) = (own.posed(a), read.posed(b));
        let far = |other: &[glam::Vec3]| a.iter().zip(other).map(|(a, b)| a.distance(*b)).fold(0.0f32, f32::max);
        assert!(far(&b) < 1e-4, "{}", far(&b));
        assert!(far(&resting) > 0.1, "it moves");
    }
}

#[test]
fn motions_that_do_not_fit_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let options = AvatarOptions { per_ring: 4, rings: 1, frames: 2, size: 16, points: 10, ..AvatarOptions::default() };
    write(dir.path(), &options, false, false).unwrap();
    let text = "HIERARCHY ROOT tail { OFFSET 0 0 0 CHANNELS 1 Xrotation } MOTION Frames: 2 Frame Time: 0.5 0 90";
    std::fs::write(dir.path().join("tail.bvh"), text).unwrap();
    std::fs::write(dir.path().join("none.bvh"), "HIERARCHY").unwrap();
    let fault = |fields: &[(&str, Value)]| {
        edit(dir.path(), &[("clip", Value::Null), ("motion", Value::Null), ("motion_names", Value::Null)]);
        edit(dir.path(), fields);
        let e = open(dir.path()).unwrap_err();
        (e.code(), e.report())
    };
    let motion = ("motion", json!("tail.bvh"));
    for (fields, code, words) in [
        (vec![motion.clone()], "data.field", "give partners in motion_names"),
        (vec![motion.clone(), ("clip", json!("walk"))], "data.field", "give one of them"),
        (vec![motion.clone(), ("motion_names", json!({"hips": 3}))], "data.field", "motion_names"),
        (
            vec![motion.clone(), ("motion_names", json!({"hip": "tail"}))],
            "data.field",
            "`hip` is no joint of the skeleton",
        ),
        (vec![("motion", json!("none.bvh"))], "data.character", "the file ends where ROOT should be"),
        (vec![("motion", json!("../x.bvh"))], "data.escape", "x.bvh"),
    ] {
        let found = fault(&fields);
        assert!(found.0 == code && found.1.contains(words), "{fields:?}: {found:?}");
    }
    edit(dir.path(), &[motion, ("motion_names", json!({"hips": "tail"}))]);
    let data = open(dir.path()).unwrap();
    let scene = data.avatar.as_deref().unwrap();
    let turned = scene.character.clips.last().unwrap().pose(&scene.character.skeleton, 0.5).locals[0].rotation;
    assert!((turned[1].abs() - 0.5f64.sqrt()).abs() < 1e-9, "a quarter turn about x: {turned:?}");
}
