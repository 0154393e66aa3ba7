//! Faults of characters: each is a typed error that says where; whatever the bytes, no panic and no wait.

use crate::character_features::{read, sound};
use crate::small_gltf::small;
use gs_core::Rng;
use gs_texel::{CharacterError, ReadOptions, Skinning, load_character, parse_character};
use serde_json::{Value, json};
use std::fs;
use std::time::{Duration, Instant};

/// Mutated files.
const MUTATIONS: u32 = 6_000;
/// Longest a small file may take, on a loaded machine.
const TIME: Duration = Duration::from_secs(1);

/// A fault put into the JSON, and words of the error.
type Fault = (fn(&mut Value), &'static [&'static str]);

#[test]
fn faults_are_named() {
    let faults: &[Fault] = &[
        (|j| j["accessors"][0]["count"] = json!(9), &["accessor 0", "needs 108 bytes"]),
        (|j| j["accessors"][0]["count"] = json!(u64::MAX), &["accessor 0", "memory"]),
        (|j| j["accessors"][0]["byteOffset"] = json!(u64::MAX), &["accessor 0"]),
        (|j| j["accessors"][0]["type"] = json!("VEC2"), &["accessor 0", "Vec2"]),
        (|j| j["accessors"][0]["componentType"] = json!(77), &["accessor 0", "type"]),
        (|j| j["accessors"][0]["bufferView"] = json!(99), &["buffer view 99"]),
        (|j| j["bufferViews"][0]["byteLength"] = json!(1u64 << 40), &["buffer view 0", "beyond"]),
        (|j| j["bufferViews"][0]["byteOffset"] = json!(u64::MAX), &["buffer view 0"]),
        (|j| j["bufferViews"][0]["buffer"] = json!(1), &["buffer view 0"]),
        (|j| j["bufferViews"][0]["byteStride"] = json!(4), &["accessor 0", "stride"]),
        (|j| j["nodes"][2]["children"] = json!([0]), &["own ancestors"]),
        (|j| j["nodes"][2]["children"] = json!([2]), &["node 2", "two parents"]),
        (|j| j["nodes"][2]["children"] = json!([50]), &["no child 50"]),
        (|j| j["nodes"][0]["rotation"] = json!([0, 0, 0, 0]), &["node 0", "length 0"]),
        (|j| j["nodes"][0]["scale"] = json!([1e39, 1, 1]), &["number out of range", "column"]),
        (|j| j["nodes"][3]["mesh"] = json!(4), &["mesh 4"]),
        (|j| j["nodes"][3]["skin"] = json!(4), &["skin 4"]),
        (|j| j["skins"][0]["joints"] = json!([1]), &["joint 1 of 1"]),
        (|j| j["skins"][0]["joints"] = json!([1, 88]), &["skin 0"]),
        (|j| j["skins"][0]["joints"] = json!([1, 2, 0]), &["skin 0", "fewer"]),
        (|j| j["meshes"][0]["primitives"][0]["material"] = json!(7), &["material"]),
        (|j| j["meshes"][0]["primitives"][0]["indices"] = json!(1), &["accessor 1"]),
        (|j| j["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(0), &["accessor 0"]),
        (|j| j["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = json!(3), &["accessor 3", "whole"]),
        (|j| j["meshes"][0]["primitives"] = json!([]), &["no triangles"]),
        (|j| j["animations"][0]["channels"][0]["sampler"] = json!(9), &["channel 0", "sampler"]),
        (|j| j["animations"][0]["channels"][0]["target"]["node"] = json!(9), &["node 9"]),
        (|j| j["animations"][0]["samplers"][0]["output"] = json!(3), &["channel 0", "values"]),
        (|j| j["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]), &["KHR_draco_mesh_compression"]),
        (|j| j["extensionsRequired"] = json!(["EXT_meshopt_compression"]), &["EXT_meshopt_compression"]),
        (|j| j["extensionsRequired"] = json!(["KHR_texture_basisu"]), &["KHR_texture_basisu"]),
        (|j| drop(j.as_object_mut().unwrap().remove("asset")), &["no glTF 2.0"]),
        (|j| j["nodes"][0]["matrix"] = json!([1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]), &["node 0", "shear"]),
    ];
    for (k, (fault, words)) in faults.iter().enumerate() {
        let mut s = small();
        fault(&mut s.json);
        let error = read(&s.glb()).map(|_| ()).expect_err(&format!("fault {k}: {words:?}")).to_string();
        assert!(words.iter().all(|w| error.contains(w)), "fault {k}: {words:?} in {error}");
        assert!(error.starts_with("small.glb") && error.contains(';'), "{error}");
    }
}

#[test]
fn values_that_are_not_finite_are_found_at_the_border() {
    let accessors = small().json["accessors"].as_array().unwrap().len();
    let mut met = 0;
    for a in 0..accessors {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut s = small();
            if s.json["accessors"][a]["componentType"] != 5126 {
                continue;
            }
            let view = s.json["accessors"][a]["bufferView"].as_u64().unwrap() as usize;
            let at = s.json["bufferViews"][view]["byteOffset"].as_u64().unwrap() as usize;
            s.bin[at..at + 4].copy_from_slice(&bad.to_le_bytes());
            let error = read(&s.glb()).unwrap_err();
            assert!(matches!(error, CharacterError::NotFinite { row: 0, component: 0, .. }), "{error}");
            assert!(error.to_string().contains(&format!("accessor {a}")), "{error}");
            met += 1;
        }
    }
    assert!(met >= 24);
    let mut back = small();
    let times = back.floats(&[1.0, 0.5, 2.0], "SCALAR", 1);
    back.json["animations"][0]["samplers"][0]["input"] = json!(times);
    assert!(read(&back.glb()).unwrap_err().to_string().contains("back in time"));
}

#[test]
fn nothing_outside_the_folder_is_read() {
    let root = tempfile::tempdir().unwrap();
    let inside = root.path().join("asset");
    fs::create_dir_all(inside.join("sub dir")).unwrap();
    let s = small();
    let mut json = s.json.clone();
    for place in [root.path().join("canary.bin"), inside.join("good.bin"), inside.join("sub dir/good.bin")] {
        fs::write(place, &s.bin).unwrap();
    }
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(root.path().join("canary.bin"), inside.join("link.bin")).unwrap();
        std::os::unix::fs::symlink("/dev/zero", inside.join("zero.bin")).unwrap();
    }
    let canary = root.path().join("canary.bin").display().to_string();
    let mut open = |uri: &str, length: usize| {
        json["buffers"] = json!([{"uri": uri, "byteLength": length}]);
        fs::write(inside.join("a.gltf"), json.to_string()).unwrap();
        load_character(&inside.join("a.gltf"), &ReadOptions::default())
    };
    for good in ["good.bin", "./good.bin", "sub%20dir/good.bin", "sub dir/good.bin"] {
        sound(&open(good, s.bin.len()).unwrap_or_else(|e| panic!("{good}: {e}")));
    }
    let file_url = format!("file://{canary}");
    let mut tricks = vec![
        "../canary.bin",
        "%2e%2e/canary.bin",
        "sub dir/../../canary.bin",
        "..%2Fcanary.bin",
        &canary,
        &file_url,
        "C:\\canary.bin",
        "..\\canary.bin",
        "http://localhost/x.bin",
        "%FF",
        "%",
        "",
        "good.bin%00",
        "data:,xyz",
        "data:;base64,!!!!",
    ];
    if cfg!(unix) {
        tricks.extend(["link.bin", "zero.bin"]);
    }
    for trick in tricks {
        let error = open(trick, s.bin.len()).map(|_| ()).expect_err(trick);
        assert!(matches!(error, CharacterError::Path { .. }), "{trick}: {error}");
        assert!(error.to_string().contains("own folder"), "{error}");
    }
    let error = open("absent.bin", 4).unwrap_err().to_string();
    assert!(error.contains("absent.bin") && error.contains("open"), "{error}");
    assert!(open("good.bin", s.bin.len() + 1).unwrap_err().to_string().contains("buffer 0"));
    assert!(open("sub dir", 4).unwrap_err().to_string().contains("regular file"));
}

#[test]
fn every_cut_is_an_error() {
    let bytes = small().glb();
    sound(&read(&bytes).unwrap());
    for cut in 0..bytes.len() {
        let error = read(&bytes[..cut]).map(|_| ()).expect_err(&format!("cut at {cut} of {}", bytes.len()));
        assert!(error.to_string().contains(';'), "{error}");
    }
    for rubbish in [&b"x"[..], &[0; 4], &[0xff; 33]] {
        assert!(read(&[&bytes, rubbish].concat()).is_err());
    }
}

/// One random change.
fn mutate(bytes: &mut [u8], r: &mut Rng) {
    const TOKENS: [&str; 10] =
        ["-1", "1e999", "4294967295", "null", "[", "}", "99", "0", "1e39", "18446744073709551616"];
    let at = r.below(bytes.len().max(1) as u32) as usize;
    let span = (1 + r.below(8) as usize).min(bytes.len() - at);
    match r.below(6) {
        0 => bytes[at..at + span].iter_mut().for_each(|b| *b ^= 1 << r.below(8)),
        1 => bytes[at..at + span].iter_mut().for_each(|b| *b = r.bits() as u8),
        2 => bytes[at..at + span].fill([0, 0xff, 0x7f, b'9'][r.below(4) as usize]),
        3 => {
            let token = TOKENS[r.below(10) as usize].as_bytes();
            let n = token.len().min(bytes.len() - at);
            bytes[at..at + n].copy_from_slice(&token[..n]);
        }
        4 => {
            let copy = bytes[at..at + span].to_vec();
            let to = r.below((bytes.len() - span) as u32 + 1) as usize;
            bytes[to..to + span].copy_from_slice(&copy);
        }
        _ => bytes[at] = b"0123456789"[r.below(10) as usize],
    }
}

#[test]
fn mutated_files_give_a_sound_character_or_a_typed_error() {
    let seed = small().glb();
    let obj =
        b"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0.5\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\nf 2/1 4/2 3/3\n";
    let mut good = [0; 2];
    for case in 0..MUTATIONS {
        let mut r = Rng::new(2026, "characters", case, 0);
        let kind = usize::from(case % 6 == 5);
        let mut bytes = if kind == 0 { seed.clone() } else { obj.to_vec() };
        for _ in 0..1 + r.below(4) {
            mutate(&mut bytes, &mut r);
        }
        let start = Instant::now();
        let options = ReadOptions {
            textures: false,
            auto_uv: r.below(2) == 0,
            repack: r.below(2) == 0,
            ..ReadOptions::default()
        };
        if let Ok(c) = parse_character(&bytes, "mutated", &options) {
            sound(&c);
            good[kind] += 1;
        }
        assert!(start.elapsed() < TIME, "case {case}: {:?}", start.elapsed());
    }
    println!("{MUTATIONS} mutations, still good: {good:?}");
    assert!(good[0] > 0 && good[1] > 0 && good[0] + good[1] < MUTATIONS);
}

#[test]
fn counts_beyond_the_bytes_cost_nothing() {
    let bomb = |change: fn(&mut Value)| {
        let mut s = small();
        change(&mut s.json);
        let start = Instant::now();
        let error = read(&s.glb()).map(|_| ()).expect_err("a bomb").to_string();
        assert!(start.elapsed() < TIME && error.contains("memory"), "{error}");
    };
    // Zeros that no byte stands for.
    bomb(|j| {
        j["accessors"][0]["count"] = json!(1u64 << 31);
        j["accessors"][0]["sparse"] = json!({"count": 0, "indices": {"bufferView": 0, "componentType": 5123},
            "values": {"bufferView": 0}});
        drop(j["accessors"][0].as_object_mut().unwrap().remove("bufferView"));
    });
    // One mesh referenced by very many primitives and nodes.
    bomb(|j| {
        let primitive = j["meshes"][0]["primitives"][0].clone();
        j["meshes"][0]["primitives"] = json!(vec![primitive; 300]);
        let node = json!({"mesh": 0, "skin": 0});
        let first = j["nodes"].as_array().unwrap().len();
        j["nodes"].as_array_mut().unwrap().extend(vec![node; 500]);
        j["scenes"][0]["nodes"] = json!((0..1).chain(first..first + 500).collect::<Vec<_>>());
    });
    bomb(|j| j["extras"] = json!(vec![json!({}); 400_001]));
    for text in ["[".repeat(1 << 20), format!("{{\"a\":{}", "[".repeat(1 << 20)), "{\"a\":".repeat(100_000)] {
        let start = Instant::now();
        assert!(read(text.as_bytes()).is_err());
        assert!(start.elapsed() < TIME);
    }
}

#[test]
fn obj_templates() {
    let dir = tempfile::tempdir().unwrap();
    let cube = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n";
    let path = dir.path().join("quad.obj");
    fs::write(&path, format!("mtllib quad.mtl\nusemtl red\n{cube}")).unwrap();
    let open = || load_character(&path, &ReadOptions { need_uvs: true, ..ReadOptions::default() });
    assert!(open().unwrap_err().to_string().contains("quad.mtl"));
    fs::write(dir.path().join("quad.mtl"), "newmtl red\nKd 0.8 0.1 0\n").unwrap();
    let c = open().unwrap();
    assert_eq!((c.template.vertices.len(), c.template.faces.len(), c.template.uvs.len()), (4, 2, 4));
    assert_eq!(c.template.corner_uvs(0).unwrap()[0], glam::Vec2::new(0.0, 1.0), "v is turned downwards");
    assert_eq!(c.template.colour(0, [0.3, 0.3, 0.4]).x, 0.8);
    assert_eq!(c.posed(&c.skeleton.rest_pose(), Skinning::Lbs), c.template.vertices);
    for colour in ["Kd", "Kd 0.5", "Ka 0.5 0.5", "Ks 1", "Ke 1 1"] {
        fs::write(dir.path().join("quad.mtl"), format!("newmtl red\n{colour}\n")).unwrap();
        let error = open().unwrap_err().to_string();
        assert!(error.contains("quad.mtl: line 2") && error.contains("a colour has three"), "{colour}: {error}");
    }
    for (text, words) in [
        ("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
        ("v 0 0 0\nv 1e999 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt inf 0\nf 1/1 2/1 3/1\n", "not finite"),
        ("v 0 0 0\nf 1 2 3\n", "no OBJ"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "no texture coordinates"),
        ("mtllib ../secret.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "own folder"),
        ("mtllib /etc/passwd\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "own folder"),
        ("", "no triangles"),
    ] {
        fs::write(&path, text).unwrap();
        let error = open().unwrap_err().to_string();
        assert!(error.contains(words), "{text:?}: {error}");
    }
}
