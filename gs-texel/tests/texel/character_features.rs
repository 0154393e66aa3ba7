//! Small characters made here: every feature against the independent evaluation, and what is mended and counted.

use crate::evaluate::Asset;
use crate::small_gltf::{ROWS, Small, small};
use gs_texel::{Character, CharacterError, ReadOptions, Skinning, load_character, parse_character};
use serde_json::json;
use std::fs;

/// Reads a small file in memory.
pub(crate) fn read(bytes: &[u8]) -> Result<Character, CharacterError> {
    parse_character(bytes, "small.glb", &ReadOptions::default())
}

/// What every character that is read must satisfy.
pub(crate) fn sound(c: &Character) {
    let (t, n) = (&c.template, c.template.vertices.len());
    assert!(t.vertices.iter().all(|v| v.is_finite()) && t.weights.len() == n);
    assert!(t.faces.iter().flatten().all(|&v| (v as usize) < n) && t.face_materials.len() == t.faces.len());
    assert!(t.weights.joints.iter().all(|&j| (j as usize) < c.skeleton.joints.len()));
    assert!(t.face_uvs.iter().flatten().all(|&v| (v as usize) < t.uvs.len()));
    assert!(t.morphs.iter().all(|m| m.offsets.len() == n) && t.morphs.len() == c.skeleton.rest_morphs.len());
    for clip in c.clips.iter().take(3) {
        let posed = c.posed(&clip.pose(&c.skeleton, 0.7), Skinning::Lbs);
        assert_eq!(posed.len(), n);
    }
    let quats = gs_texel::skin::rotations(
        &t.weights,
        &c.skeleton.skinning(&c.skeleton.rest_pose()),
        &Skinning::Dqs.blend(&t.weights, &c.skeleton.skinning(&c.skeleton.rest_pose())),
    );
    assert!(quats.iter().flatten().all(|v| v.is_finite()));
}

/// The character of a small file, after it has been held against the evaluator at several times.
fn verified(what: &str, s: &Small) -> Character {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("small.glb");
    fs::write(&path, s.glb()).unwrap();
    let c = load_character(&path, &ReadOptions::default()).unwrap_or_else(|e| panic!("{what}: {e}"));
    sound(&c);
    let asset = Asset::open(&path);
    assert_eq!(c.clips.len(), asset.clips(), "{what}");
    for t in [0.0, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0] {
        let posed = c.posed(&c.clips[0].pose(&c.skeleton, t), Skinning::Lbs);
        for (want, &v) in asset.vertices(Some(0), t).iter().zip(&c.source_vertices) {
            let got = posed[v as usize].to_array().map(f64::from);
            let far = (0..3).map(|k| (got[k] - want[k]).abs()).fold(0.0, f64::max);
            assert!(far < 1e-5, "{what} at {t}: {got:?} {want:?}");
        }
    }
    c
}

#[test]
fn every_feature_agrees_with_the_evaluation() {
    let c = verified("plain", &small());
    assert_eq!((c.template.vertices.len(), c.template.faces.len()), (2 * ROWS, 2 * (ROWS - 1)));
    assert_eq!(c.skeleton.nodes[c.skeleton.root as usize].name, "lower");
    let material = &c.template.materials[0];
    assert!(material.double_sided && material.cutout == Some(0.5));
    assert!((material.factor.x - 0.7354).abs() < 1e-3, "displayed: {}", material.factor);
    assert_eq!(c.fallbacks.list(), []);

    let mut strip = small();
    strip.primitive().as_object_mut().unwrap().remove("indices");
    strip.primitive()["mode"] = json!(5);
    assert_eq!(verified("strip", &strip).template.faces, c.template.faces);
    let mut fan = small();
    fan.primitive().as_object_mut().unwrap().remove("indices");
    fan.primitive()["mode"] = json!(6);
    assert_eq!(verified("fan", &fan).template.faces[1], [0, 2, 3]);

    let mut sparse = small();
    let rows = sparse.shorts(&[1, 5], "SCALAR", 1);
    let values = sparse.floats(&[5.0, 5.0, 5.0, -1.0, 0.0, 2.0], "VEC3", 3);
    let view = |s: &Small, a: usize| s.json["accessors"][a]["bufferView"].clone();
    let (rows, values) = (view(&sparse, rows), view(&sparse, values));
    let position = sparse.primitive()["attributes"]["POSITION"].as_u64().unwrap() as usize;
    sparse.json["accessors"][position]["sparse"] = json!({"count": 2, "values": {"bufferView": values},
        "indices": {"bufferView": rows, "componentType": 5123}});
    assert_eq!(verified("sparse", &sparse).template.vertices[1], glam::Vec3::splat(10.0), "in the world");

    let mut quantised = small();
    let weights: Vec<u8> = (0..2 * ROWS as u8).flat_map(|i| [255 - 30 * i, 30 * i, 0, 0]).collect();
    let weights = quantised.accessor(&weights, 5121, "VEC4", 2 * ROWS);
    quantised.json["accessors"][weights]["normalized"] = json!(true);
    let positions: Vec<u16> = (0..6 * ROWS as u16).map(|i| i * i * 97).collect();
    let positions = quantised.shorts(&positions, "VEC3", 3);
    quantised.json["accessors"][positions]["normalized"] = json!(true);
    quantised.primitive()["attributes"]["WEIGHTS_0"] = json!(weights);
    quantised.primitive()["attributes"]["POSITION"] = json!(positions);
    quantised.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    verified("quantised", &quantised);

    let mut rigid = small();
    rigid.json["nodes"][2]["mesh"] = json!(0);
    rigid.json["nodes"][1]["children"] = json!([2]);
    let both = verified("a rigid copy below a joint", &rigid);
    assert_eq!(both.template.vertices.len(), 4 * ROWS);

    let mut matrix = small();
    matrix.json["nodes"][0] =
        json!({"children": [1], "matrix": [0., -2., 0., 0., 3., 0., 0., 0., 0., 0., -1., 0., 4., 5., 6., 1.]});
    verified("a matrix", &matrix);

    let mut halves = small();
    let mut second = halves.primitive().clone();
    second.as_object_mut().unwrap().remove("material");
    halves.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(second);
    let both = verified("two primitives", &halves);
    assert_eq!((both.template.vertices.len(), both.source_vertices.len()), (2 * ROWS, 4 * ROWS), "welded");
    assert_eq!(both.template.face_materials.iter().filter(|m| **m == 1).count(), 2 * (ROWS - 1));
}

/// A vertex of the small strip as its file has it.
fn in_the_file(i: usize) -> glam::Vec3 {
    glam::Vec3::new((i % 2) as f32, (i / 2) as f32, 0.1 * i as f32)
}

#[test]
fn vertices_have_the_unit_of_the_world() {
    let scaled = |scale: f32| {
        let mut s = small();
        s.json["nodes"][0]["scale"] = json!([scale, scale, scale]);
        s
    };
    // Vertices in centimetres under a node in metres.
    let c = verified("centimetres", &scaled(0.01));
    let at_rest = c.skeleton.skinning(&c.skeleton.rest_pose());
    assert!(at_rest.iter().all(|a| (a.matrix3.determinant() - 1.0).abs() < 1e-6), "{at_rest:?}");
    for (i, (v, delta)) in c.template.vertices.iter().zip(&c.template.morphs[0].offsets).enumerate() {
        assert!(v.abs_diff_eq(0.01 * in_the_file(i), 1e-6), "{i}: {v}");
        assert!((delta.z - 0.002 * (i % 3) as f32).abs() < 1e-6, "{i}: {delta}");
    }
    // What has the unit but for rounding keeps its bits.
    let c = verified("metres", &scaled(1.0005));
    assert!(c.template.vertices.iter().enumerate().all(|(i, v)| *v == in_the_file(i)));
    assert_eq!(c.skeleton.joints[1].inverse_bind.translation, glam::DVec3::new(0.0, -1.5, 0.0));
    let error = read(&scaled(3e38).glb()).unwrap_err().to_string();
    assert!(error.contains("beyond the range of numbers"), "{error}");
}

#[test]
fn mirrored_parts_keep_their_outside() {
    let part = |scale: [f32; 3]| {
        let mut s = small();
        let json = s.json.as_object_mut().unwrap();
        json.remove("skins");
        json.remove("animations");
        s.json["nodes"] = json!([{"mesh": 0, "scale": scale}]);
        s.json["scenes"][0]["nodes"] = json!([0]);
        read(&s.glb()).unwrap().template
    };
    let (plain, mirrored) = (part([1.0; 3]), part([-1.0, 1.0, 1.0]));
    let normal = |t: &gs_texel::Template, face: usize| {
        let [a, b, c] = t.faces[face].map(|v| t.vertices[v as usize]);
        (b - a).cross(c - a)
    };
    assert_eq!((plain.faces.len(), mirrored.faces.len()), (2 * (ROWS - 1), 2 * (ROWS - 1)));
    for face in 0..plain.faces.len() {
        let (a, b) = (normal(&plain, face), normal(&mirrored, face));
        assert!(b.abs_diff_eq(glam::Vec3::new(-a.x, a.y, a.z), 1e-6), "{face}: {a} {b}");
        let uvs = mirrored.corner_uvs(face).unwrap();
        for (v, uv) in mirrored.faces[face].map(|v| mirrored.vertices[v as usize]).into_iter().zip(uvs) {
            assert!(uv.abs_diff_eq(glam::Vec2::new(-v.x, v.y / (ROWS - 1) as f32), 1e-6), "{face}: {v} {uv}");
        }
    }
}

#[test]
fn texture_coordinates_go_through_their_transform() {
    let mut s = small();
    let transform = json!({"offset": [0.1, 0.2], "rotation": std::f64::consts::FRAC_PI_2, "scale": [0.5, 0.25]});
    s.json["textures"] = json!([{"source": 0}]);
    s.json["images"] = json!([{"uri": "absent.png"}]);
    s.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] =
        json!({"index": 0, "extensions": {"KHR_texture_transform": transform}});
    let bare = ReadOptions { textures: false, ..ReadOptions::default() };
    let c = parse_character(&s.glb(), "small.glb", &bare).unwrap();
    // A quarter turn counter-clockwise, v down: (u, v) becomes (v, −u).
    let corner = c.template.corner_uvs(0).unwrap()[1];
    assert!((corner - glam::Vec2::new(0.1, 0.2 - 0.5)).length() < 1e-6, "{corner}");
    let error = read(&s.glb()).unwrap_err().to_string();
    assert!(error.contains("absent.png") && error.contains("read from memory"), "{error}");
}

#[test]
fn what_can_be_mended_is_mended_and_counted() {
    let mut s = small();
    let mut weights = vec![0.5f32; 8 * ROWS];
    weights[..4].copy_from_slice(&[0.0; 4]);
    weights[4..8].copy_from_slice(&[-0.5, 2.0, 0.0, 0.0]);
    let weights = s.floats(&weights, "VEC4", 4);
    s.primitive()["attributes"]["WEIGHTS_0"] = json!(weights);
    let flat: Vec<f32> = (0..2 * ROWS).flat_map(|i| [i as f32, 0.0, 0.0]).collect();
    let flat = s.floats(&flat, "VEC3", 3);
    s.primitive()["attributes"]["POSITION"] = json!(flat);
    let uv = s.floats(&[0.25; 4 * ROWS], "VEC2", 2);
    s.primitive()["attributes"]["TEXCOORD_0"] = json!(uv);
    s.primitive()["targets"] = json!([]);
    let mut points = s.primitive().clone();
    points["mode"] = json!(0);
    s.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(points);
    let c = read(&s.glb()).unwrap();
    sound(&c);
    let f = c.fallbacks;
    assert_eq!((f.unbound_vertices, f.mended_weights), (1, 2 * ROWS - 1));
    assert_eq!((f.flat_faces, f.flat_face_uvs), (6, 6));
    assert_eq!((f.ignored_primitives, f.ignored_channels), (1, 1), "weights of a mesh without morphs");
    // All bind matrices are the identity: of joints equally near the first.
    assert_eq!(c.template.weights.row(0).collect::<Vec<_>>(), [(0, 1.0)]);
    assert_eq!(c.template.weights.row(1).collect::<Vec<_>>(), [(1, 1.0)]);
    assert_eq!(f.list().len(), 6);
}

#[test]
fn vertices_without_weights_follow_the_nearest_joint() {
    let mut s = small();
    let at = |y: f32| [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., -y, 0., 1.];
    let binds = s.floats(&[at(0.0), at(2.0)].concat(), "MAT4", 16);
    s.json["skins"][0]["inverseBindMatrices"] = json!(binds);
    let weights = s.floats(&[0.0; 8 * ROWS], "VEC4", 4);
    s.primitive()["attributes"]["WEIGHTS_0"] = json!(weights);
    let c = read(&s.glb()).unwrap();
    assert_eq!(c.fallbacks.unbound_vertices, 2 * ROWS);
    for (i, v) in c.template.vertices.iter().enumerate() {
        // In the world the joints are 4 apart, and row 1 is as far from both.
        let near = u32::from(v.y > 2.0);
        assert!(v.y == 2.0 || c.template.weights.row(i).eq([(near, 1.0)]), "{v}");
    }
}

#[test]
fn colours_of_vertices_show_where_there_is_no_texture() {
    let mut s = small();
    let red: Vec<u16> = (0..2 * ROWS).flat_map(|i| [if i < 2 { u16::MAX } else { 0 }, 0, 0]).collect();
    let red = s.shorts(&red, "VEC3", 3);
    s.json["accessors"][red]["normalized"] = json!(true);
    s.primitive()["attributes"]["COLOR_0"] = json!(red);
    let c = read(&s.glb()).unwrap();
    let t = &c.template;
    assert_eq!(t.face_colors.len(), t.faces.len());
    let factor = t.materials[0].factor;
    for (face, corners) in t.faces.iter().enumerate() {
        for (k, &v) in corners.iter().enumerate() {
            let bary = std::array::from_fn(|i| if i == k { 1.0 } else { 0.0 });
            let lit = if t.vertices[v as usize].y == 0.0 { 1.0 } else { 0.0 };
            assert!(t.colour(face, bary).abs_diff_eq(factor * glam::Vec4::new(lit, 0.0, 0.0, 1.0), 1e-6));
        }
    }
    assert!(read(&small().glb()).unwrap().template.face_colors.is_empty());
}

#[test]
fn missing_texture_coordinates_are_an_error_only_where_they_are_needed() {
    let mut s = small();
    s.primitive()["attributes"].as_object_mut().unwrap().remove("TEXCOORD_0");
    let read = |options: &ReadOptions| parse_character(&s.glb(), "small.glb", options);
    assert!(read(&ReadOptions::default()).unwrap().template.face_uvs.is_empty());
    let need = ReadOptions { need_uvs: true, ..ReadOptions::default() };
    assert!(matches!(read(&need), Err(CharacterError::NoUv { .. })));
    let c = read(&ReadOptions { auto_uv: true, ..need }).unwrap();
    assert_eq!((c.template.face_uvs.len(), c.template.uvs.len()), (6, 2 * ROWS), "one chart");
}
