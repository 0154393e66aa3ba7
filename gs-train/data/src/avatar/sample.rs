//! Random points on a triangle mesh, uniform by area.

use glam::{DVec3, Vec3};
use gs_core::{Rng, cast};

/// A point on a face: row of the face, and its three barycentric coordinates.
pub type OnFace = (u32, [f32; 3]);

/// `n` points, uniform by area (Osada et al. 2002): a function of mesh, `n`, `seed` and `stream`, for example the number of a frame.
/// Empty where the mesh has no area.
///
/// ```
/// use gs_data::avatar::sample::{on_faces, places};
/// use glam::Vec3;
///
/// let (vertices, faces) = ([Vec3::ZERO, Vec3::X, Vec3::Y], [[0, 1, 2]]);
/// let points = places(&on_faces(&vertices, &faces, 100, 0, 0), &vertices, &faces);
/// assert!(points.len() == 100 && points.iter().all(|p| p.z == 0.0 && p.x >= 0.0 && p.y >= 0.0 && p.x + p.y <= 1.0 + 1e-6));
/// ```
pub fn on_faces(vertices: &[Vec3], faces: &[[u32; 3]], n: usize, seed: u64, stream: u32) -> Vec<OnFace> {
    let mut below = Vec::with_capacity(faces.len());
    let mut total = 0.0;
    for f in faces {
        let [a, b, c] = f.map(|v| vertices[v as usize].as_dvec3());
        total += DVec3::cross(b - a, c - a).length();
        below.push(total);
    }
    if !(total > 0.0 && total.is_finite()) {
        return Vec::new();
    }
    let point = |i: usize| {
        let mut rng = Rng::new(seed, "avatar.surface", stream, i as u64);
        let at = f64::from(rng.uniform()) * total;
        let face = below.partition_point(|&b| b <= at).min(faces.len() - 1);
        // Osada et al. 2002, "Shape distributions": uniform over the triangle.
        let (r, s) = (rng.uniform().sqrt(), rng.uniform());
        (cast::to_u32(face), [1.0 - r, r * (1.0 - s), r * s])
    };
    (0..n).map(point).collect()
}

/// Positions of points on faces, in the space of `vertices`.
pub fn places(points: &[OnFace], vertices: &[Vec3], faces: &[[u32; 3]]) -> Vec<Vec3> {
    let place = |(face, bary): &OnFace| {
        let corners = faces[*face as usize].map(|v| vertices[v as usize]);
        corners[0] * bary[0] + corners[1] * bary[1] + corners[2] * bary[2]
    };
    points.iter().map(place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_get_points_by_area_and_those_fill_them() {
        // Areas 1 and 3.
        let v = [[0., 0., 0.], [2., 0., 0.], [0., 1., 0.], [10., 0., 0.], [12., 0., 0.], [10., 3., 0.]].map(Vec3::from);
        let f = [[0, 1, 2], [3, 4, 5]];
        let points = on_faces(&v, &f, 40_000, 1, 0);
        let second = points.iter().filter(|p| p.0 == 1).count() as f64;
        assert!((second - 30_000.0).abs() < 4.0 * (40_000.0f64 * 0.25 * 0.75).sqrt(), "{second}");
        let on_first: Vec<Vec3> = places(&points, &v, &f).into_iter().filter(|p| p.x < 5.0).collect();
        let mean = on_first.iter().sum::<Vec3>() / on_first.len() as f32;
        assert!((mean - Vec3::new(2.0 / 3.0, 1.0 / 3.0, 0.0)).length() < 0.02, "{mean}");
        assert!(on_first.iter().all(|p| p.x >= 0.0 && p.y >= 0.0 && p.x / 2.0 + p.y <= 1.0 + 1e-5));
        assert_eq!(points[..10], on_faces(&v, &f, 10, 1, 0));
        assert_ne!(points[..10], on_faces(&v, &f, 10, 1, 1));
        assert!(on_faces(&v, &[[0, 0, 0]], 5, 1, 0).is_empty());
    }
}
