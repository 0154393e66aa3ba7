//! An atlas for meshes without one: charts of faces of similar direction, projected along an axis and packed.
//!
//! Faces are grouped by the signed axis nearest to their normal. Faces of a group that are connected over edges are a chart,
//! projected along that axis, so lengths shrink by at most `√3`. A chart that overlaps itself is split into its triangles.
//! Charts are packed in rows at one common scale.
//!
//! ```
//! let plate = gs_texel::figure::plate(2.0, 4).template;
//! let corners = gs_texel::unwrap::unwrap(&plate.vertices, &plate.faces);
//! assert_eq!(corners.len(), plate.faces.len());
//! assert!(corners.as_flattened().iter().all(|p| p.min_element() > 0.0 && p.max_element() < 1.0));
//! ```

use crate::coverage::{Window, spans, to_fixed};
use crate::surface::NONE;
use glam::{Vec2, Vec3};
use std::collections::{HashMap, HashSet};

/// Largest gap between charts, as a share of the atlas's side.
const MAX_GAP: f32 = 0.006;
/// Sum of the gaps along a row of `√charts` charts, as a share of the atlas's side.
const ROW_GAPS: f32 = 0.25;
/// Side of the map on which charts are tested for self-overlap, texels.
const TEST_SIZE: usize = 1024;
/// The scale is multiplied by this factor until all charts fit.
const SHRINK: f32 = 0.97;

/// Texture coordinates of the corners of every face, inside `(0, 1)²`, without overlap. `vertices` must be finite and the
/// faces in range.
pub fn unwrap(vertices: &[Vec3], faces: &[[u32; 3]]) -> Vec<[Vec2; 3]> {
    // Scaled to unit size, so that neither differences nor products overflow.
    let size = vertices.iter().fold(f32::MIN_POSITIVE, |m, v| m.max(v.abs().max_element()));
    let at = |v: u32| vertices[v as usize] / size;
    let axes: Vec<u8> = faces.iter().map(|f| signed_axis(f.map(at))).collect();
    let mut chart = connected(faces, &axes);
    let flat: Vec<[Vec2; 3]> =
        faces.iter().zip(&axes).map(|(f, &axis)| f.map(|v| project_along(axis, at(v)))).collect();
    let packed = pack(&flat, &chart);
    let folded = folded(&packed, &chart);
    if folded.is_empty() {
        return packed;
    }
    let first = chart.iter().max().map_or(0, |c| c + 1);
    let apart = chart.iter_mut().filter(|c| folded.contains(c));
    apart.zip(first..).for_each(|(c, own)| *c = own);
    pack(&flat, &chart)
}

/// The signed axis nearest to a face's normal: 0 to 2 for `+x, +y, +z`, 3 to 5 for `−x, −y, −z`.
fn signed_axis([a, b, c]: [Vec3; 3]) -> u8 {
    let n = (b - a).cross(c - a);
    let axis = n.abs().max_position() as u8;
    if n[usize::from(axis)] < 0.0 { axis + 3 } else { axis }
}

/// A point projected along a signed axis.
fn project_along(axis: u8, p: Vec3) -> Vec2 {
    match axis {
        0 => Vec2::new(p.y, p.z),
        1 => Vec2::new(p.z, p.x),
        2 => Vec2::new(p.x, p.y),
        3 => Vec2::new(p.z, p.y),
        4 => Vec2::new(p.x, p.z),
        _ => Vec2::new(p.y, p.x),
    }
}

/// The chart of every face: faces of one axis connected over edges.
fn connected(faces: &[[u32; 3]], axes: &[u8]) -> Vec<u32> {
    let mut parent: Vec<u32> = (0..faces.len() as u32).collect();
    let mut known: HashMap<(u8, [u32; 2]), u32> = HashMap::new();
    for (f, (face, &axis)) in faces.iter().zip(axes).enumerate() {
        for [p, q] in [[face[0], face[1]], [face[1], face[2]], [face[2], face[0]]] {
            let other = *known.entry((axis, [p.min(q), p.max(q)])).or_insert(f as u32);
            let (a, b) = (root(&mut parent, f as u32), root(&mut parent, other));
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    (0..faces.len() as u32).map(|f| root(&mut parent, f)).collect()
}

/// The lowest face of a set (union-find with path halving).
fn root(parent: &mut [u32], mut f: u32) -> u32 {
    while parent[f as usize] != f {
        parent[f as usize] = parent[parent[f as usize] as usize];
        f = parent[f as usize];
    }
    f
}

/// Charts in rows, the tallest first, at one scale.
fn pack(flat: &[[Vec2; 3]], chart: &[u32]) -> Vec<[Vec2; 3]> {
    let mut boxes: HashMap<u32, [Vec2; 2]> = HashMap::new();
    for (corners, &c) in flat.iter().zip(chart) {
        let [low, high] = boxes.entry(c).or_insert([corners[0]; 2]);
        *low = corners.iter().fold(*low, |a, b| a.min(*b));
        *high = corners.iter().fold(*high, |a, b| a.max(*b));
    }
    let mut order: Vec<(u32, Vec2)> = boxes.iter().map(|(&c, [low, high])| (c, *high - *low)).collect();
    order.sort_by(|a, b| b.1.y.total_cmp(&a.1.y).then(a.0.cmp(&b.0)));
    let gap = MAX_GAP.min(ROW_GAPS / (order.len().max(1) as f32).sqrt());
    let side = order.iter().fold(0.0f32, |m, (_, s)| m.max(s.max_element()));
    let mut scale = if side > 0.0 { (1.0 - 2.0 * gap) / side } else { 1.0 };
    let places = loop {
        match rows(&order, scale, gap) {
            Some(places) => break places,
            // Charts of size 0 fit, since the gaps alone do.
            None => scale *= if scale > f32::MIN_POSITIVE { SHRINK } else { 0.0 },
        }
    };
    let place = |(corners, c): (&[Vec2; 3], &u32)| {
        let (low, at) = (boxes[c][0], places[c]);
        corners.map(|p| at + (p - low) * scale)
    };
    flat.iter().zip(chart).map(place).collect()
}

/// Position of the lowest corner of each chart at a scale; `None` if they do not fit.
fn rows(order: &[(u32, Vec2)], scale: f32, gap: f32) -> Option<HashMap<u32, Vec2>> {
    let mut places = HashMap::with_capacity(order.len());
    let (mut at, mut tall) = (Vec2::splat(gap), 0.0f32);
    for &(chart, size) in order {
        let size = size * scale;
        if at.x + size.x + gap > 1.0 {
            at = Vec2::new(gap, at.y + tall + gap);
            tall = 0.0;
        }
        if at.x + size.x + gap > 1.0 || at.y + size.y + gap > 1.0 {
            return None;
        }
        places.insert(chart, at);
        at.x += size.x + gap;
        tall = tall.max(size.y);
    }
    Some(places)
}

/// Charts with a texel in two of their faces.
fn folded(packed: &[[Vec2; 3]], chart: &[u32]) -> HashSet<u32> {
    let frame = Window { x0: 0, y0: 0, x1: TEST_SIZE, y1: TEST_SIZE };
    let (mut owner, mut found) = (vec![NONE; TEST_SIZE * TEST_SIZE], HashSet::new());
    for (corners, &c) in packed.iter().zip(chart) {
        spans(corners.map(|p| to_fixed(p.as_dvec2() * TEST_SIZE as f64)), frame, |y, x0, x1| {
            for o in &mut owner[y * TEST_SIZE + x0..y * TEST_SIZE + x1] {
                if *o == c {
                    found.insert(c);
                }
                *o = c;
            }
        });
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure;
    use crate::texels::{TexelOptions, TexelTable};

    fn table(vertices: &[Vec3], faces: &[[u32; 3]]) -> (Vec<[Vec2; 3]>, TexelTable) {
        let corners = unwrap(vertices, faces);
        let uvs: Vec<Vec2> = corners.as_flattened().to_vec();
        let face_uvs: Vec<[u32; 3]> = (0..faces.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
        let table = TexelTable::build(faces, &uvs, &face_uvs, 512, &TexelOptions::default()).unwrap();
        (corners, table)
    }

    #[test]
    fn a_person_is_laid_out_without_overlap_and_evenly() {
        let person = figure::person().template;
        let (corners, table) = table(&person.vertices, &person.faces);
        assert!(corners.as_flattened().iter().all(|p| p.min_element() > 0.0 && p.max_element() < 1.0));
        assert_eq!(table.report.overlaps, 0);
        assert!(table.len() > 512 * 512 / 4, "{} texels are used", table.len());
        // Texels per area differ by the slant alone.
        let area = |f: usize| {
            let [a, b, c] = person.faces[f].map(|v| person.vertices[v as usize]);
            (b - a).cross(c - a).length()
        };
        let density: Vec<f32> = (0..person.faces.len())
            .filter(|&f| area(f) > 1e-6)
            .map(|f| {
                let [a, b, c] = corners[f];
                (b - a).perp_dot(c - a) / area(f)
            })
            .collect();
        let (low, high) = density.iter().fold((f32::MAX, 0.0f32), |(l, h), &d| (l.min(d), h.max(d)));
        assert!(low > 0.0 && high / low < 3f32.sqrt() * 1.05, "{low} to {high}, no face is mirrored");
    }

    #[test]
    fn a_ramp_that_winds_over_itself_is_cut() {
        // One and a half turns of a spiral stair of quads, all facing up.
        let ring = |k: u32, r: f32| {
            let turn = k as f32 / 16.0 * std::f32::consts::TAU;
            Vec3::new(r * turn.sin(), 0.05 * k as f32, r * turn.cos())
        };
        let vertices: Vec<Vec3> = (0..=24).flat_map(|k| [ring(k, 1.0), ring(k, 2.0)]).collect();
        let quad = |k: u32| [[2 * k, 2 * k + 1, 2 * k + 2], [2 * k + 2, 2 * k + 1, 2 * k + 3]];
        let faces: Vec<[u32; 3]> = (0..24).flat_map(quad).collect();
        let (_, table) = table(&vertices, &faces);
        assert_eq!((table.report.overlaps, table.report.unseen_faces), (0, 0));
    }

    #[test]
    fn meshes_of_no_size_get_some_place() {
        let corners = unwrap(&[Vec3::ZERO; 3], &[[0, 1, 2]; 5]);
        assert!(corners.as_flattened().iter().all(|p| p.is_finite() && p.max_element() < 1.0));
        assert!(unwrap(&[], &[]).is_empty());
    }
}
