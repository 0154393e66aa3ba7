//! Welding: vertices that files split at seams are merged, so that each point of the surface has one row.
//!
//! Vertices are merged if position, weights and morph offsets have equal bits, or if positions and offsets differ by at most
//! 1e-6 of the size of the bounding box per coordinate and weights by at most 1e-4.

use crate::character::Character;
use crate::template::{Morph, SkinWeights};
use glam::{Vec2, Vec3, Vec4};
use std::collections::HashMap;

/// Tolerance of positions and offsets, as a share of the longest side of the bounding box.
const POSITION_TOLERANCE: f32 = 1e-6;
/// Tolerance of weights.
const WEIGHT_TOLERANCE: f32 = 1e-4;
/// Maximum number of vertices compared per grid cell (more of them differ in weights only).
const MAX_CANDIDATES: usize = 32;

/// Vertices and triangles as listed in the file, before welding.
#[derive(Default)]
pub(super) struct RawMesh {
    pub(super) points: Vec<Vec3>,
    pub(super) weights: SkinWeights,
    /// Display-encoded colours, one per point; white where the file has none.
    pub(super) colors: Vec<Vec4>,
    /// Whether the file has vertex colours.
    pub(super) has_colors: bool,
    /// Morph offsets that are not 0 as `(vertex, morph, offset)`, sorted.
    pub(super) deltas: Vec<(u32, u32, Vec3)>,
    /// Names of the morphs.
    pub(super) morphs: Vec<String>,
    pub(super) faces: Vec<[u32; 3]>,
    pub(super) material_uvs: Vec<Option<[Vec2; 3]>>,
    pub(super) face_materials: Vec<u16>,
}

/// The attributes that are compared in welding.
#[derive(Clone, Copy)]
struct Vertex<'a> {
    point: Vec3,
    joints: &'a [u32],
    weights: &'a [f32],
    deltas: &'a [(u32, u32, Vec3)],
}

impl Vertex<'_> {
    fn bits(&self) -> Vec<u32> {
        let mut bits = self.point.to_array().map(|v| (v + 0.0).to_bits()).to_vec();
        bits.extend(self.joints);
        bits.extend(self.weights.iter().map(|w| w.to_bits()));
        bits.extend(self.deltas.iter().flat_map(|(_, k, d)| [*k].into_iter().chain(d.to_array().map(f32::to_bits))));
        bits
    }

    fn near(&self, other: &Self, tolerance: f32) -> bool {
        let close = |a: Vec3, b: Vec3| (a - b).abs().max_element() <= tolerance;
        close(self.point, other.point)
            && self.joints == other.joints
            && self.weights.iter().zip(other.weights).all(|(a, b)| (a - b).abs() <= WEIGHT_TOLERANCE)
            && self.deltas.len() == other.deltas.len()
            && self.deltas.iter().zip(other.deltas).all(|(a, b)| a.1 == b.1 && close(a.2, b.2))
    }
}

/// Bounds of the morph offsets of every vertex.
fn delta_rows(mesh: &RawMesh) -> Vec<usize> {
    let n = mesh.points.len() as u32;
    (0..=n).map(|i| mesh.deltas.partition_point(|d| d.0 < i)).collect()
}

/// Welds a mesh into the character's template. `material_uvs` gets one row per triangle, zeros for triangles without coordinates; it
/// stays empty if no triangle has any.
pub(super) fn weld(mesh: RawMesh, character: &mut Character) {
    let rows = delta_rows(&mesh);
    let vertices: Vec<Vertex> = (mesh.points.iter().zip(mesh.weights.begins.array_windows()))
        .zip(rows.array_windows())
        .map(|((&point, &[from, to]), &[first, end])| Vertex {
            point,
            joints: mesh.weights.joints.get(from as usize..to as usize).unwrap_or(&[]),
            weights: mesh.weights.weights.get(from as usize..to as usize).unwrap_or(&[]),
            deltas: mesh.deltas.get(first..end).unwrap_or(&[]),
        })
        .collect();
    let mut welder = Welder::new(&mesh.points);
    let numbers: Vec<u32> = vertices.iter().map(|v| welder.number(*v)).collect();
    let kept = welder.kept;
    let template = &mut character.template;
    template.vertices = kept.iter().map(|v| v.point).collect();
    template.weights = SkinWeights::default();
    for v in &kept {
        template.weights.push(v.joints.iter().copied().zip(v.weights.iter().copied()), 0);
    }
    let blank = vec![Vec3::ZERO; kept.len()];
    template.morphs = mesh.morphs.iter().map(|m| Morph { name: m.clone(), offsets: blank.clone() }).collect();
    for (i, v) in kept.iter().enumerate() {
        for &(_, k, delta) in v.deltas {
            let offset = template.morphs.get_mut(k as usize).and_then(|m| m.offsets.get_mut(i));
            offset.into_iter().for_each(|o| *o = delta);
        }
    }
    let any_uvs = mesh.material_uvs.iter().any(Option::is_some);
    for ((face, uvs), &material) in mesh.faces.iter().zip(&mesh.material_uvs).zip(&mesh.face_materials) {
        let [a, b, c] = face.map(|v| numbers.get(v as usize).copied().unwrap_or(0));
        if a == b || b == c || c == a {
            character.fallbacks.collapsed_faces += 1;
            continue;
        }
        template.faces.push([a, b, c]);
        template.face_materials.push(material);
        if mesh.has_colors {
            template.face_colors.push(face.map(|v| mesh.colors.get(v as usize).copied().unwrap_or(Vec4::ONE)));
        }
        if any_uvs {
            template.material_uvs.push(uvs.unwrap_or([Vec2::ZERO; 3]));
        }
    }
    character.source_vertices = numbers;
}

struct Welder<'a> {
    exact: HashMap<Vec<u32>, u32>,
    /// Kept vertices by cell.
    cells: HashMap<[i32; 3], Vec<u32>>,
    kept: Vec<Vertex<'a>>,
    origin: Vec3,
    tolerance: f32,
}

impl<'a> Welder<'a> {
    fn new(points: &[Vec3]) -> Self {
        let low = points.iter().copied().reduce(Vec3::min).unwrap_or(Vec3::ZERO);
        let high = points.iter().copied().reduce(Vec3::max).unwrap_or(Vec3::ZERO);
        let tolerance = (POSITION_TOLERANCE * (high - low).max_element()).max(f32::MIN_POSITIVE);
        Self { exact: HashMap::new(), cells: HashMap::new(), kept: Vec::new(), origin: low, tolerance }
    }

    /// The row of the welded vertex of `v`, added if it is new.
    fn number(&mut self, v: Vertex<'a>) -> u32 {
        let bits = v.bits();
        if let Some(&number) = self.exact.get(&bits) {
            return number;
        }
        // Cells of twice the tolerance: what is near lies in this or a neighbouring cell.
        let cell = ((v.point - self.origin) / (2.0 * self.tolerance)).to_array().map(|x| x.floor() as i32);
        let number = self.near(&v, cell).unwrap_or_else(|| {
            self.kept.push(v);
            let number = self.kept.len() as u32 - 1;
            self.cells.entry(cell).or_default().push(number);
            number
        });
        self.exact.insert(bits, number);
        number
    }

    fn near(&self, v: &Vertex<'_>, [x, y, z]: [i32; 3]) -> Option<u32> {
        let steps = || -1..=1;
        let around = steps().flat_map(|dx| steps().flat_map(move |dy| steps().map(move |dz| [dx, dy, dz])));
        let cells = around.map(|[dx, dy, dz]| [x.saturating_add(dx), y.saturating_add(dy), z.saturating_add(dz)]);
        let candidates = cells.filter_map(|c| self.cells.get(&c)).flat_map(|c| c.iter().take(MAX_CANDIDATES));
        candidates.copied().find(|&k| self.kept.get(k as usize).is_some_and(|o| o.near(v, self.tolerance)))
    }
}
