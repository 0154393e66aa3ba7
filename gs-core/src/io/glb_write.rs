//! Writing binary glTF: attributes, nodes, animations, chunks.

use super::glb::{
    BINARY_CHUNK, COLOR_SPACE, EXTENSION, FLIPPED, FLOAT, JSON_CHUNK, MAGIC, RigidMotion, RigidPart, own, sh_names,
};
use super::{RawSplats, sigmoid};
use crate::{rot, sh};
use glam::Vec3;
use serde_json::{Map, Value, json};
use std::io::Write;

/// glTF's mode of points.
const POINTS: u64 = 0;

/// Linear light of a display-encoded value, 0..1 (IEC 61966-2-1).
fn linear(v: f32) -> f32 {
    if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// One vertex attribute to write.
struct Attribute {
    name: String,
    width: usize,
    values: Vec<f32>,
}

/// All attributes of the splats, in file order.
fn attributes(splats: &RawSplats) -> Vec<Attribute> {
    let new = |name: String, width, values| Attribute { name, width, values };
    let unit_xyzw = |q: &[f32; 4]| match rot::normalise(*q).wxyz {
        [0.0, 0.0, 0.0, 0.0] => [0.0, 0.0, 0.0, 1.0],
        [w, x, y, z] => [x, y, z, w],
    };
    let opacities: Vec<f32> = splats.logit_opacities.iter().map(|&o| sigmoid(o)).collect();
    let rows = || splats.sh.chunks_exact(splats.sh_width());
    let color = |(row, &o): (&[f32], &f32)| {
        let channel = |k: usize| linear((0.5 + sh::C0 as f32 * row.get(k).copied().unwrap_or(0.0)).clamp(0.0, 1.0));
        [channel(0), channel(1), channel(2), o]
    };
    let mut out = vec![
        new("POSITION".into(), 3, splats.means.iter().flat_map(|m| m.to_array()).collect()),
        new("COLOR_0".into(), 4, rows().zip(&opacities).flat_map(color).collect()),
        new(own("ROTATION"), 4, splats.quats.iter().flat_map(unit_xyzw).collect()),
        new(own("SCALE"), 3, splats.log_scales.iter().flat_map(|s| s.to_array().map(f32::exp)).collect()),
        new(own("OPACITY"), 1, opacities.clone()),
    ];
    for (k, name) in sh_names(splats.degree).enumerate() {
        out.push(new(name, 3, rows().flat_map(|r| r.iter().skip(3 * k).take(3).copied()).collect()));
    }
    out
}

/// A file under construction.
#[derive(Default)]
struct File {
    views: Vec<Value>,
    accessors: Vec<Value>,
    columns: Vec<Vec<f32>>,
    bytes: usize,
}

impl File {
    /// Adds a column of rows of `width` values; its accessor. `vertex`: it is a vertex attribute.
    fn add(&mut self, values: Vec<f32>, width: usize, vertex: bool) -> usize {
        let length = values.len() * 4;
        let mut view = json!({"buffer": 0, "byteOffset": self.bytes, "byteLength": length});
        if let Some(view) = view.as_object_mut().filter(|_| vertex) {
            view.insert("target".into(), json!(34962));
        }
        let kind = match width {
            1 => "SCALAR",
            3 => "VEC3",
            _ => "VEC4",
        };
        let count = values.len() / width.max(1);
        self.views.push(view);
        self.accessors
            .push(json!({"bufferView": self.accessors.len(), "componentType": FLOAT, "count": count, "type": kind}));
        self.bytes += length;
        self.columns.push(values);
        self.accessors.len() - 1
    }

    /// States the bounds of an accessor, which glTF requires of positions and times.
    fn bound(&mut self, accessor: usize, min: Value, max: Value) {
        if let Some(entry) = self.accessors.get_mut(accessor).and_then(Value::as_object_mut) {
            entry.insert("min".into(), min);
            entry.insert("max".into(), max);
        }
    }

    /// A mesh of one primitive.
    fn mesh(&mut self, splats: &RawSplats) -> Value {
        let turned = splats.clone().flipped(FLIPPED);
        let mut named = Map::new();
        for Attribute { name, width, values } in attributes(&turned) {
            named.insert(name, json!(self.add(values, width, true)));
        }
        let bound = |f: fn(Vec3, Vec3) -> Vec3| turned.means.iter().copied().reduce(f).unwrap_or_default().to_array();
        if let Some(position) = named.get("POSITION").and_then(Value::as_u64) {
            self.bound(position as usize, json!(bound(Vec3::min)), json!(bound(Vec3::max)));
        }
        let extension = json!({
            "kernel": "ellipse", "colorSpace": COLOR_SPACE,
            "projection": "perspective", "sortingMethod": "cameraDistance",
        });
        json!({"primitives": [{"mode": POINTS, "attributes": named, "extensions": {EXTENSION: extension}}]})
    }

    /// Samplers of translation and rotation of a motion, and the channels of `node` that they move.
    fn animate(&mut self, motion: &RigidMotion, node: usize, samplers: &mut Vec<Value>, channels: &mut Vec<Value>) {
        let times = self.add(motion.times.clone(), 1, false);
        let ends = [motion.times.first(), motion.times.last()].map(|t| json!([t.copied().unwrap_or_default()]));
        let [first, last] = ends;
        self.bound(times, first, last);
        let moved = motion.translations.iter().flat_map(|t| flipped_translation(*t)).collect();
        let turned = motion.rotations.iter().flat_map(|q| flipped_rotation(*q)).collect();
        for (path, width, values) in [("translation", 3, moved), ("rotation", 4, turned)] {
            let output = self.add(values, width, false);
            channels.push(json!({"sampler": samplers.len(), "target": {"node": node, "path": path}}));
            samplers.push(json!({"input": times, "output": output, "interpolation": "LINEAR"}));
        }
    }
}

/// Signs of the axes in the file.
fn signs() -> [f32; 3] {
    FLIPPED.map(|f| if f { -1.0 } else { 1.0 })
}

/// A translation as the file has it.
fn flipped_translation(t: Vec3) -> [f32; 3] {
    let [fx, fy, fz] = signs();
    [fx * t.x, fy * t.y, fz * t.z]
}

/// A rotation `(w, x, y, z)` as the file has it: x, y, z, w.
fn flipped_rotation([w, x, y, z]: [f32; 4]) -> [f32; 4] {
    let [fx, fy, fz] = signs();
    [fy * fz * x, fx * fz * y, fx * fy * z, w]
}

/// A node of a mesh; one that moves stands where its motion begins, for readers that play no animation.
fn node(mesh: usize, motion: &RigidMotion) -> Value {
    match (motion.translations.first(), motion.rotations.first()) {
        (Some(translation), Some(rotation)) => {
            let (translation, rotation) = (flipped_translation(*translation), flipped_rotation(*rotation));
            json!({"mesh": mesh, "translation": translation, "rotation": rotation})
        }
        _ => json!({"mesh": mesh}),
    }
}

fn invalid(text: impl Into<String>) -> std::io::Error {
    std::io::Error::new(std::io::ErrorKind::InvalidInput, text.into())
}

fn check(splats: &RawSplats, motion: &RigidMotion) -> std::io::Result<()> {
    splats.check_shape().map_err(|e| invalid(e.to_string()))?;
    splats.refuse_kernel("binary glTF")?;
    if splats.is_empty() {
        return Err(invalid("glTF cannot store a scene without splats"));
    }
    splats.check_storable()?;
    let RigidMotion { times, translations, rotations } = motion;
    let keys = times.len();
    let ascending = times.first().is_none_or(|t| *t >= 0.0) && times.is_sorted_by(|a, b| a < b);
    let finite = times.iter().chain(rotations.as_flattened()).all(|v| v.is_finite())
        && translations.iter().all(|t| t.is_finite());
    match translations.len() == keys && rotations.len() == keys && ascending && finite {
        true => Ok(()),
        false => Err(invalid("key frames have ascending times from 0 on, one finite translation and rotation each")),
    }
}

/// Writes splats as binary glTF with the extension.
///
/// # Errors
/// No splats, columns of unequal length, another kernel than the Gaussian, a value that is not finite, more than 4 GiB (as `InvalidInput`),
/// or the writer's own.
pub fn write(splats: &RawSplats, out: &mut dyn Write) -> std::io::Result<()> {
    write_pieces(&[(splats, &RigidMotion::default())], out)
}

/// Writes rigid parts in motion: a node for each part, and an animation if any has key frames.
///
/// # Errors
/// As [`write()`] for each part; key frames of unequal number, not ascending or not finite; no parts.
pub fn write_parts(parts: &[RigidPart], out: &mut dyn Write) -> std::io::Result<()> {
    let pieces: Vec<_> = parts.iter().map(|p| (&p.splats, &p.motion)).collect();
    write_pieces(&pieces, out)
}

fn write_pieces(pieces: &[(&RawSplats, &RigidMotion)], out: &mut dyn Write) -> std::io::Result<()> {
    if pieces.is_empty() {
        return Err(invalid("glTF cannot store a scene without splats"));
    }
    let (mut file, mut samplers, mut channels) = (File::default(), Vec::new(), Vec::new());
    let mut meshes = Vec::new();
    for (node, (splats, motion)) in pieces.iter().enumerate() {
        check(splats, motion)?;
        meshes.push(file.mesh(splats));
        if !motion.times.is_empty() {
            file.animate(motion, node, &mut samplers, &mut channels);
        }
    }
    let nodes: Vec<Value> = pieces.iter().enumerate().map(|(k, (_, motion))| node(k, motion)).collect();
    let mut document = json!({
        "asset": {"version": "2.0", "generator": "gs4d"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": (0..nodes.len()).collect::<Vec<_>>()}],
        "nodes": nodes,
        "meshes": meshes,
        "buffers": [{"byteLength": file.bytes}],
        "bufferViews": file.views,
        "accessors": file.accessors,
    });
    if let Some(document) = document.as_object_mut().filter(|_| !channels.is_empty()) {
        let motion = json!({"name": "motion", "samplers": samplers, "channels": channels});
        document.insert("animations".into(), json!([motion]));
    }
    let mut text = serde_json::to_vec(&document)?;
    text.resize(text.len().next_multiple_of(4), b' ');
    let size = |n: usize| u32::try_from(n).map_err(|_| invalid("more than 4 GiB"));
    out.write_all(MAGIC)?;
    for word in [2, size(12 + 16 + text.len() + file.bytes)?, size(text.len())?, JSON_CHUNK] {
        out.write_all(&word.to_le_bytes())?;
    }
    out.write_all(&text)?;
    out.write_all(&size(file.bytes)?.to_le_bytes())?;
    out.write_all(&BINARY_CHUNK.to_le_bytes())?;
    for column in &file.columns {
        let bytes: Vec<u8> = column.iter().flat_map(|v| v.to_le_bytes()).collect();
        out.write_all(&bytes)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::raw::tests::cloud;
    use super::*;

    #[test]
    fn splats_that_gltf_cannot_store_are_refused() {
        let mut raw = cloud(3, 0, 1);
        raw.kernel = crate::Kernel::Acutance { acutances: vec![0.5; 3] };
        assert!(write(&raw, &mut Vec::new()).unwrap_err().to_string().contains("another kernel"));
        let mut raw = cloud(3, 0, 1);
        raw.means[1].y = f32::NAN;
        assert!(write(&raw, &mut Vec::new()).unwrap_err().to_string().contains("row 1"));
        assert!(write(&RawSplats::default(), &mut Vec::new()).is_err());
    }
}
