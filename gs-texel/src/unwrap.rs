//! An atlas for meshes that have none: pieces of the surface that face the same way, laid flat side by side.
//!
//! Faces are sorted by the axis their normal is nearest to (six ways); what hangs together over edges is a chart, seen along
//! that axis, so lengths shrink by `√3` at most. A chart that folds over itself is cut into its triangles. Charts are packed
//! in rows at one scale for all.

use crate::coverage::{Window, snap, spans};
use crate::surface::NONE;
use glam::{Vec2, Vec3};
use std::collections::{HashMap, HashSet};

/// Free space between charts, as a share of the atlas, where there are few of them.
const GAP: f32 = 0.006;
/// All gaps together take about this share of the atlas at most, squared.
const GAPS: f32 = 0.25;
/// Side of the map on which charts are looked at for folds, texels.
const LOOK: usize = 1024;
/// The scale shrinks by this factor until all charts fit.
const SHRINK: f32 = 0.97;

/// Texture coordinates of the corners of every face, inside `(0, 1)²`; no point belongs to two charts. `vertices` are finite
/// and the faces in range.
pub fn unwrap(vertices: &[Vec3], faces: &[[u32; 3]]) -> Vec<[Vec2; 3]> {
    // Of unit size, so that neither differences nor products leave the range of numbers.
    let size = vertices.iter().fold(f32::MIN_POSITIVE, |m, v| m.max(v.abs().max_element()));
    let at = |v: u32| vertices[v as usize] / size;
    let ways: Vec<u8> = faces.iter().map(|f| way(f.map(at))).collect();
    let mut chart = connected(faces, &ways);
    let flat: Vec<[Vec2; 3]> = faces.iter().zip(&ways).map(|(f, &way)| f.map(|v| seen_along(way, at(v)))).collect();
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

/// The axis a normal is nearest to: 0 to 2 for `x, y, z`, three more where it points the other way.
fn way([a, b, c]: [Vec3; 3]) -> u8 {
    let n = (b - a).cross(c - a);
    let axis = n.abs().max_position() as u8;
    if n[usize::from(axis)] < 0.0 { axis + 3 } else { axis }
}

/// A point seen along an axis.
fn seen_along(way: u8, p: Vec3) -> Vec2 {
    match way {
        0 => Vec2::new(p.y, p.z),
        1 => Vec2::new(p.z, p.x),
        2 => Vec2::new(p.x, p.y),
        3 => Vec2::new(p.z, p.y),
        4 => Vec2::new(p.x, p.z),
        _ => Vec2::new(p.y, p.x),
    }
}

/// The chart of every face: faces of one way that hang together over edges.
fn connected(faces: &[[u32; 3]], ways: &[u8]) -> Vec<u32> {
    let mut parent: Vec<u32> = (0..faces.len() as u32).collect();
    let mut known: HashMap<(u8, [u32; 2]), u32> = HashMap::new();
    for (f, (face, &way)) in faces.iter().zip(ways).enumerate() {
        for [p, q] in [[face[0], face[1]], [face[1], face[2]], [face[2], face[0]]] {
            let other = *known.entry((way, [p.min(q), p.max(q)])).or_insert(f as u32);
            let (a, b) = (top(&mut parent, f as u32), top(&mut parent, other));
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    (0..faces.len() as u32).map(|f| top(&mut parent, f)).collect()
}

/// The lowest face of a set, with shorter ways to it.
fn top(parent: &mut [u32], mut f: u32) -> u32 {
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
    let gap = GAP.min(GAPS / (order.len().max(1) as f32).sqrt());
    let side = order.iter().fold(0.0f32, |m, (_, s)| m.max(s.max_element()));
    let mut scale = if side > 0.0 { (1.0 - 2.0 * gap) / side } else { 1.0 };
    let places = loop {
        match rows(&order, scale, gap) {
            Some(places) => break places,
            // Charts of no size fit, for gaps alone do.
            None => scale *= if scale > f32::MIN_POSITIVE { SHRINK } else { 0.0 },
        }
    };
    let place = |(corners, c): (&[Vec2; 3], &u32)| {
        let (low, at) = (boxes[c][0], places[c]);
        corners.map(|p| at + (p - low) * scale)
    };
    flat.iter().zip(chart).map(place).collect()
}

/// Where the low corner of each chart goes at a scale; none if they do not fit.
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

/// Charts of which some texel has two faces.
fn folded(packed: &[[Vec2; 3]], chart: &[u32]) -> HashSet<u32> {
    let frame = Window { x0: 0, y0: 0, x1: LOOK, y1: LOOK };
    let (mut owner, mut found) = (vec![NONE; LOOK * LOOK], HashSet::new());
    for (corners, &c) in packed.iter().zip(chart) {
        spans(corners.map(|p| snap(p.as_dvec2() * LOOK as f64)), frame, |y, x0, x1| {
            for o in &mut owner[y * LOOK + x0..y * LOOK + x1] {
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
