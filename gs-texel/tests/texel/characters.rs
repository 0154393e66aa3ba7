//! Real characters against an evaluation of their own: plain `f64` arithmetic over the JSON, sharing no code with the
//! crate. Every vertex of every file at several times, within 1e-5 of the size of the posed mesh.

use crate::evaluate::Asset;
use gs_core::testkit::shared;
use gs_texel::write_mesh::{write_obj, write_ply};
use gs_texel::{Character, ReadOptions, Skinning, load_character};
use std::path::{Path, PathBuf};

/// Skinned positions may differ by this share of the size.
const TOLERANCE: f64 = 1e-5;

fn files() -> Vec<PathBuf> {
    let Some(folder) = shared("data/gltf_public") else { return Vec::new() };
    let mut found = Vec::new();
    let mut folders = vec![folder];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "glb" || e == "gltf") {
                found.push(path);
            }
        }
    }
    found.sort();
    assert!(found.len() >= 8, "{found:?}");
    found
}

fn name(path: &Path) -> String {
    path.file_stem().unwrap().to_string_lossy().into_owned()
}

/// Largest distance between the crate's vertices and the evaluator's, relative to the size of the mesh.
fn distance(character: &Character, asset: &Asset, clip: Option<usize>, t: f64) -> f64 {
    let pose = match clip {
        Some(c) => character.clips[c].pose(&character.skeleton, t),
        None => character.skeleton.rest_pose(),
    };
    let posed = character.posed(&pose, Skinning::Lbs);
    let want = asset.vertices(clip, t);
    assert_eq!(want.len(), character.source_vertices.len());
    let (mut low, mut high, mut worst) = ([f64::MAX; 3], [f64::MIN; 3], 0.0f64);
    for (want, &v) in want.iter().zip(&character.source_vertices) {
        let got = posed[v as usize].to_array().map(f64::from);
        for k in 0..3 {
            low[k] = low[k].min(want[k]);
            high[k] = high[k].max(want[k]);
            worst = worst.max((got[k] - want[k]).abs());
        }
    }
    worst / (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max)
}

#[test]
fn every_vertex_of_every_character_is_where_an_independent_evaluation_puts_it() {
    for path in files() {
        let character = load_character(&path, &ReadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        let asset = Asset::open(&path);
        assert_eq!(character.clips.len(), asset.clips());
        let mut worst = distance(&character, &asset, None, 0.0);
        for (c, clip) in character.clips.iter().enumerate() {
            let end = clip.duration();
            for share in [-0.1, 0.0, 0.137, 0.5, 0.811, 1.0, 1.3] {
                worst = worst.max(distance(&character, &asset, Some(c), share * end));
            }
        }
        let (t, s) = (&character.template, &character.skeleton);
        println!(
            "{:20} {} vertices ({} in the file), {} triangles, {} texture coordinates, {} materials, {} joints, \
             {} morphs, {} clips, {:?}: error {worst:.1e}",
            name(&path),
            t.vertices.len(),
            character.source_vertices.len(),
            t.faces.len(),
            t.uvs.len(),
            t.materials.len() - 1,
            s.joints.len(),
            t.morphs.len(),
            character.clips.len(),
            character.fallbacks.list(),
        );
        assert!(worst < TOLERANCE, "{}: {worst:e}", path.display());
    }
}

#[test]
fn invariants_of_what_is_read() {
    for path in files() {
        for options in [ReadOptions::default(), ReadOptions { auto_uv: true, need_uvs: true, ..ReadOptions::default() }]
        {
            let c = load_character(&path, &options).unwrap();
            let (t, n) = (&c.template, c.template.vertices.len());
            assert_eq!(t.weights.len(), n);
            for i in 0..n {
                let sum: f64 = t.weights.row(i).map(|(_, w)| f64::from(w)).sum();
                assert!(
                    (sum - 1.0).abs() < 1e-6 && t.weights.row(i).all(|(j, _)| (j as usize) < c.skeleton.joints.len())
                );
            }
            assert!(t.faces.iter().flatten().all(|&v| (v as usize) < n));
            assert!(t.face_uvs.is_empty() || t.face_uvs.len() == t.faces.len());
            assert!(t.material_uvs.is_empty() || t.material_uvs.len() == t.faces.len());
            assert!(t.face_uvs.iter().flatten().all(|&v| (v as usize) < t.uvs.len()));
            assert!(t.face_materials.iter().all(|&m| usize::from(m) < t.materials.len()));
            assert!(c.skeleton.nodes.iter().enumerate().all(|(i, n)| n.parent.is_none_or(|p| (p as usize) < i)));
            if options.auto_uv {
                assert_eq!(t.face_uvs.len(), t.faces.len());
                assert!(t.uvs.iter().all(|uv| uv.min_element() > 0.0 && uv.max_element() < 1.0));
            }
        }
    }
}

#[test]
fn textures_are_where_faces_read_them() {
    let Some(folder) = shared("data/gltf_public") else { return };
    let character = folder.join("kenney_character_rigid_parts/character.glb");
    let open = |options: &ReadOptions| load_character(&character, options).unwrap();
    let (plain, grid) = (open(&ReadOptions::default()), open(&ReadOptions { auto_uv: true, ..ReadOptions::default() }));
    let bare = open(&ReadOptions { textures: false, ..ReadOptions::default() });
    assert!(bare.template.materials.iter().all(|m| m.texture.is_none()));
    let mut colours = std::collections::BTreeSet::new();
    for face in 0..plain.template.faces.len() {
        let third = [1.0 / 3.0; 3];
        let colour = plain.template.colour(face, third);
        assert_eq!(colour, grid.template.colour(face, third), "another atlas shows the same colours");
        colours.insert((colour * 255.0).as_uvec4().to_array());
    }
    assert!(colours.len() > 3, "a palette of several colours: {colours:?}");
}

#[test]
fn materials_get_cells_of_their_own() {
    let Some(truck) = shared("data/gltf_public/CesiumMilkTruck.glb") else { return };
    let c = load_character(&truck, &ReadOptions { repack: true, ..ReadOptions::default() }).unwrap();
    let t = &c.template;
    let cell = |m: u16| {
        let faces = t.face_materials.iter().zip(&t.face_uvs).filter(|(k, _)| **k == m);
        let uvs: Vec<_> = faces.flat_map(|(_, f)| f.map(|k| t.uvs[k as usize])).collect();
        let low = uvs.iter().copied().reduce(glam::Vec2::min);
        low.zip(uvs.iter().copied().reduce(glam::Vec2::max))
    };
    let cells: Vec<_> = (0..t.materials.len() as u16).filter_map(cell).collect();
    assert!(cells.len() > 1);
    for (i, a) in cells.iter().enumerate() {
        for b in &cells[..i] {
            let apart = a.1.x <= b.0.x || b.1.x <= a.0.x || a.1.y <= b.0.y || b.1.y <= a.0.y;
            assert!(apart, "{a:?} {b:?}");
        }
    }
}

#[test]
fn posed_meshes_are_written() {
    let Some(fox) = shared("data/gltf_public/Fox.glb") else { return };
    let character = load_character(&fox, &ReadOptions::default()).unwrap();
    let clip = character.clip("Walk").unwrap();
    let posed = character.posed(&clip.pose(&character.skeleton, 0.3), Skinning::Lbs);
    let (mut obj, mut ply) = (Vec::new(), Vec::new());
    write_obj(&character, &posed, &mut obj).unwrap();
    write_ply(&character, &posed, &mut ply).unwrap();
    let options = tobj::LoadOptions::default();
    let (models, _) = tobj::load_obj_buf(&mut obj.as_slice(), &options, |_| Ok(Default::default())).unwrap();
    assert_eq!(models[0].mesh.indices.len(), 3 * character.template.faces.len());
    let listed = obj.split(|b| *b == b'\n').filter(|line| line.starts_with(b"v ")).count();
    assert_eq!(listed, character.source_vertices.len());
    let text = String::from_utf8(ply).unwrap();
    assert_eq!(text.lines().count(), 9 + character.source_vertices.len() + character.template.faces.len());
    // Each triangle of the text is the triangle of the template.
    for (corner, index) in models[0].mesh.indices.iter().enumerate() {
        let want = posed[character.template.faces[corner / 3][corner % 3] as usize];
        let at = 3 * *index as usize;
        assert_eq!(models[0].mesh.positions[at..at + 3], want.to_array());
    }
}
