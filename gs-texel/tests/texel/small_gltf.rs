//! A small character made in memory: a strip of quads on two joints with texture coordinates, morphs and a clip.

use serde_json::{Value, json};

/// JSON and binary chunk of a GLB under construction.
#[derive(Clone)]
pub struct Small {
    pub json: Value,
    pub bin: Vec<u8>,
}

impl Small {
    /// Appends bytes as a buffer view; its number.
    pub fn view(&mut self, bytes: &[u8]) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let view = json!({"buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len()});
        self.bin.extend_from_slice(bytes);
        let views = self.json["bufferViews"].as_array_mut().unwrap();
        views.push(view);
        views.len() - 1
    }

    /// Appends an accessor over bytes; its number.
    pub fn accessor(&mut self, bytes: &[u8], component: u32, kind: &str, count: usize) -> usize {
        let view = self.view(bytes);
        let accessor = json!({"bufferView": view, "componentType": component, "type": kind, "count": count});
        let accessors = self.json["accessors"].as_array_mut().unwrap();
        accessors.push(accessor);
        accessors.len() - 1
    }

    pub fn floats(&mut self, values: &[f32], kind: &str, width: usize) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.accessor(&bytes, 5126, kind, values.len() / width)
    }

    pub fn shorts(&mut self, values: &[u16], kind: &str, width: usize) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.accessor(&bytes, 5123, kind, values.len() / width)
    }

    pub fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        json["buffers"] = json!([{"byteLength": self.bin.len()}]);
        let mut text = json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bin = self.bin.clone();
        bin.resize(bin.len().next_multiple_of(4), 0);
        let total = 12 + 8 + text.len() + 8 + bin.len();
        let mut out = b"glTF\x02\0\0\0".to_vec();
        out.extend((total as u32).to_le_bytes());
        out.extend((text.len() as u32).to_le_bytes());
        out.extend(b"JSON");
        out.extend(text);
        out.extend((bin.len() as u32).to_le_bytes());
        out.extend(b"BIN\0");
        out.extend(bin);
        out
    }

    pub fn primitive(&mut self) -> &mut Value {
        &mut self.json["meshes"][0]["primitives"][0]
    }
}

/// Vertices of the strip: two columns, `ROWS` rows.
pub const ROWS: usize = 4;

/// The character.
pub fn small() -> Small {
    let empty = json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 3]}],
        "nodes": [
            {"name": "root", "children": [1], "translation": [0.1, 0.2, 0.3], "scale": [2.0, 2.0, 2.0]},
            {"name": "lower", "children": [2], "rotation": [0.0, 0.0, 0.38268343, 0.92387953]},
            {"name": "upper", "translation": [0.0, 1.5, 0.0]},
            {"name": "skin", "mesh": 0, "skin": 0, "translation": [9.0, 9.0, 9.0]}
        ],
        "accessors": [], "bufferViews": [],
        "materials": [{"name": "cloth", "pbrMetallicRoughness": {"baseColorFactor": [0.5, 1.0, 0.25, 1.0]},
            "alphaMode": "MASK", "doubleSided": true}],
        "meshes": [{"name": "strip", "weights": [0.25, 0.0], "primitives": [{"attributes": {}, "material": 0}]}],
        "skins": [{"joints": [1, 2]}], "animations": []
    });
    let mut s = Small { json: empty, bin: Vec::new() };
    let n = 2 * ROWS;
    let corner = |i: usize| [(i % 2) as f32, (i / 2) as f32];
    let positions: Vec<f32> = (0..n).flat_map(|i| [corner(i)[0], corner(i)[1], 0.1 * i as f32]).collect();
    let uvs: Vec<f32> = (0..n).flat_map(|i| [corner(i)[0], corner(i)[1] / (ROWS - 1) as f32]).collect();
    let up = |i: usize| corner(i)[1] / (ROWS - 1) as f32;
    let weights: Vec<f32> = (0..n).flat_map(|i| [1.0 - up(i), up(i), 0.0, 0.0]).collect();
    let joints: Vec<u8> = (0..n).flat_map(|_| [0, 1, 0, 0]).collect();
    let faces: Vec<u16> = (0..ROWS as u16 - 1).flat_map(|r| [0, 1, 2, 2, 1, 3].map(|k| 2 * r + k)).collect();
    let position = s.floats(&positions, "VEC3", 3);
    let uv = s.floats(&uvs, "VEC2", 2);
    let joints = s.accessor(&joints, 5121, "VEC4", n);
    let weights = s.floats(&weights, "VEC4", 4);
    let indices = s.shorts(&faces, "SCALAR", 1);
    let deltas: Vec<f32> = (0..n).flat_map(|i| [0.0, 0.0, (i % 3) as f32 * 0.2]).collect();
    let morph = s.floats(&deltas, "VEC3", 3);
    let mut bind = [0.0f32; 32];
    (0..2).for_each(|m| (0..4).for_each(|k| bind[16 * m + 5 * k] = 1.0));
    bind[16 + 13] = -1.5;
    let binds = s.floats(&bind, "MAT4", 16);
    let times = s.floats(&[0.5, 1.0, 2.0], "SCALAR", 1);
    let turns = s.floats(&[0., 0., 0., 1., 0.6, 0., 0., 0.8, 0., -0.8, 0., -0.6], "VEC4", 4);
    let lifts: Vec<f32> = (0..27).map(|k| (k * k % 7) as f32 * 0.1).collect();
    let lifts = s.floats(&lifts, "VEC3", 3);
    let morphs = s.floats(&[0.0, 1.0, 1.0, 0.0, 0.5, 0.5], "SCALAR", 1);
    s.json["skins"][0]["inverseBindMatrices"] = json!(binds);
    *s.primitive() = json!({"material": 0, "indices": indices, "targets": [{"POSITION": morph}, {"POSITION": morph}],
        "attributes": {"POSITION": position, "TEXCOORD_0": uv, "JOINTS_0": joints, "WEIGHTS_0": weights}});
    s.json["animations"] = json!([{"name": "move",
        "samplers": [{"input": times, "output": turns}, {"input": times, "output": lifts, "interpolation": "CUBICSPLINE"},
            {"input": times, "output": morphs, "interpolation": "STEP"}],
        "channels": [{"sampler": 0, "target": {"node": 2, "path": "rotation"}},
            {"sampler": 1, "target": {"node": 1, "path": "translation"}},
            {"sampler": 2, "target": {"node": 3, "path": "weights"}}]}]);
    s
}
