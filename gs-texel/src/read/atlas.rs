//! Atlas coordinates from texture coordinates.

use super::ReadOptions;
use crate::character::Fallbacks;
use crate::template::Template;
use crate::unwrap::unwrap;
use glam::Vec2;
use std::collections::HashMap;

/// Fills `uvs` and `face_uvs`: from the texture coordinates (shifted by integers into `[0, 1]²`), in one cell per material, or
/// by a new unwrap. Leaves them empty if there are no coordinates and no unwrap is asked for.
pub(super) fn lay_out(template: &mut Template, options: &ReadOptions) {
    let corners: Vec<[Vec2; 3]> = if options.auto_uv {
        unwrap(&template.vertices, &template.faces)
    } else if template.material_uvs.is_empty() {
        return;
    } else {
        let shifted = |corners: &[Vec2; 3]| {
            let low = corners[0].min(corners[1]).min(corners[2]);
            let high = corners[0].max(corners[1]).max(corners[2]);
            // A triangle inside one copy of a repeated texture moves to the first copy.
            let shift = ((low + high) * 0.5).floor();
            let fits = (low - shift).min_element() >= 0.0 && (high - shift).max_element() <= 1.0;
            if fits { corners.map(|c| c - shift) } else { *corners }
        };
        template.material_uvs.iter().map(shifted).collect()
    };
    let corners = if options.repack && !options.auto_uv { repacked(template, corners) } else { corners };
    if corners == template.material_uvs {
        template.material_uvs.clear();
    }
    let mut known: HashMap<(u32, [u32; 2]), u32> = HashMap::new();
    for (face, corners) in template.faces.iter().zip(&corners) {
        let mut number = |k: usize| {
            let (vertex, uv) = (face.get(k).copied().unwrap_or(0), corners.get(k).copied().unwrap_or(Vec2::ZERO));
            *known.entry((vertex, uv.to_array().map(f32::to_bits))).or_insert_with(|| {
                template.uvs.push(uv);
                template.uvs.len() as u32 - 1
            })
        };
        template.face_uvs.push([number(0), number(1), number(2)]);
    }
}

/// One cell of a square grid per material in use.
fn repacked(template: &Template, corners: Vec<[Vec2; 3]>) -> Vec<[Vec2; 3]> {
    let mut used: Vec<u16> = template.face_materials.clone();
    used.sort_unstable();
    used.dedup();
    let side = (used.len() as f64).sqrt().ceil().max(1.0) as usize;
    let place = |material: &u16, corners: [Vec2; 3]| {
        let cell = used.binary_search(material).unwrap_or(0);
        let cell = Vec2::new((cell % side) as f32, (cell / side) as f32);
        corners.map(|c| (cell + c.clamp(Vec2::ZERO, Vec2::ONE)) / side as f32)
    };
    template.face_materials.iter().zip(corners).map(|(m, c)| place(m, c)).collect()
}

/// Counts triangles without area, in space and in the atlas.
pub(super) fn count_flat(template: &Template, fallbacks: &mut Fallbacks) {
    let point = |v: u32| template.vertices.get(v as usize).copied().unwrap_or_default().as_dvec3();
    let flat = |face: &&[u32; 3]| {
        let [a, b, c] = face.map(point);
        (b - a).cross(c - a).length_squared() == 0.0
    };
    let uv = |v: u32| template.uvs.get(v as usize).copied().unwrap_or_default().as_dvec2();
    let flat_uv = |face: &&[u32; 3]| {
        let [a, b, c] = face.map(uv);
        (b - a).perp_dot(c - a) == 0.0
    };
    fallbacks.flat_faces = template.faces.iter().filter(flat).count();
    fallbacks.flat_face_uvs = template.face_uvs.iter().filter(flat_uv).count();
}
