//! One row per point of the surface: vertices that files split at seams become one again.
//!
//! First vertices of equal bits (position, weights, morph offsets), then those closer than 1e-6 of the size of the
//! whole, per coordinate, with the same weights and offsets to 1e-4 and that tolerance.

use crate::character::Character;
use crate::template::{Morph, SkinWeights};
use glam::{Vec2, Vec3, Vec4};
use std::collections::HashMap;

/// Tolerance, as a share of the longest side of the bounding box.
const NEAR: f32 = 1e-6;
/// Tolerance of weights.
const SAME_WEIGHT: f32 = 1e-4;
/// Points looked at in one cell of tolerance size at most (more differ in weights alone).
const CROWD: usize = 32;

/// Triangles as a file has them.
#[derive(Default)]
pub(super) struct Soup {
    pub points: Vec<Vec3>,
    pub weights: SkinWeights,
    /// Display-encoded colours, one per point, and whether the file has any.
    pub colors: Vec<Vec4>,
    pub painted: bool,
    /// `(vertex, morph, offset)`, vertices in order, morphs in order for each.
    pub deltas: Vec<(u32, u32, Vec3)>,
    /// Names of the morphs.
    pub morphs: Vec<String>,
    pub faces: Vec<[u32; 3]>,
    pub paint: Vec<Option<[Vec2; 3]>>,
    pub face_materials: Vec<u16>,
}

/// What makes two vertices one.
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
            && self.weights.iter().zip(other.weights).all(|(a, b)| (a - b).abs() <= SAME_WEIGHT)
            && self.deltas.len() == other.deltas.len()
            && self.deltas.iter().zip(other.deltas).all(|(a, b)| a.1 == b.1 && close(a.2, b.2))
    }
}

/// Ranges of the offsets of every vertex.
fn delta_rows(soup: &Soup) -> Vec<usize> {
    let n = soup.points.len() as u32;
    (0..=n).map(|i| soup.deltas.partition_point(|d| d.0 < i)).collect()
}

/// Moves a soup into the character's template; `paint` has a row per triangle if any has one, zeros where it has none,
/// and is empty where none has.
pub(super) fn weld(soup: Soup, character: &mut Character) {
    let rows = delta_rows(&soup);
    let vertices: Vec<Vertex> = (soup.points.iter().zip(soup.weights.begins.array_windows()))
        .zip(rows.array_windows())
        .map(|((&point, &[from, to]), &[first, end])| Vertex {
            point,
            joints: soup.weights.joints.get(from as usize..to as usize).unwrap_or(&[]),
            weights: soup.weights.weights.get(from as usize..to as usize).unwrap_or(&[]),
            deltas: soup.deltas.get(first..end).unwrap_or(&[]),
        })
        .collect();
    let mut welder = Welder::new(&soup.points);
    let numbers: Vec<u32> = vertices.iter().map(|v| welder.number(*v)).collect();
    let kept = welder.kept;
    let template = &mut character.template;
    template.vertices = kept.iter().map(|v| v.point).collect();
    template.weights = SkinWeights::default();
    for v in &kept {
        template.weights.push(v.joints.iter().copied().zip(v.weights.iter().copied()), 0);
    }
    let blank = vec![Vec3::ZERO; kept.len()];
    template.morphs = soup.morphs.iter().map(|m| Morph { name: m.clone(), offsets: blank.clone() }).collect();
    for (i, v) in kept.iter().enumerate() {
        for &(_, k, delta) in v.deltas {
            let offset = template.morphs.get_mut(k as usize).and_then(|m| m.offsets.get_mut(i));
            offset.into_iter().for_each(|o| *o = delta);
        }
    }
    let any_paint = soup.paint.iter().any(Option::is_some);
    for ((face, paint), &material) in soup.faces.iter().zip(&soup.paint).zip(&soup.face_materials) {
        let [a, b, c] = face.map(|v| numbers.get(v as usize).copied().unwrap_or(0));
        if a == b || b == c || c == a {
            character.fallbacks.collapsed_faces += 1;
            continue;
        }
        template.faces.push([a, b, c]);
        template.face_materials.push(material);
        if soup.painted {
            template.face_colors.push(face.map(|v| soup.colors.get(v as usize).copied().unwrap_or(Vec4::ONE)));
        }
        if any_paint {
            template.paint.push(paint.unwrap_or([Vec2::ZERO; 3]));
        }
    }
    character.file_vertices = numbers;
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
        let tolerance = (NEAR * (high - low).max_element()).max(f32::MIN_POSITIVE);
        Self { exact: HashMap::new(), cells: HashMap::new(), kept: Vec::new(), origin: low, tolerance }
    }

    /// The number of the kept vertex that this one is.
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
        let candidates = cells.filter_map(|c| self.cells.get(&c)).flat_map(|c| c.iter().take(CROWD));
        candidates.copied().find(|&k| self.kept.get(k as usize).is_some_and(|o| o.near(v, self.tolerance)))
    }
}
