//! Rays against a mesh that may move: closest hits, occlusion, and refitting. The bounding volume hierarchy is that of `obvhs`.
//!
//! Faces with corners that are not finite are left out. Faces whose boxes have the same centre share one leaf entry, since
//! the builder takes quadratic time over them.

use crate::surface::{MeshError, check_faces};
use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::{Bvh2, builder::build_bvh2};
use obvhs::ray::{Ray, RayHit};
use obvhs::{Boundable, BvhBuildParams};
use std::time::Duration;

/// Barycentric coordinates this far below zero still hit, so that no ray passes between two adjacent triangles.
const BARY_TOLERANCE: f32 = 1e-6;
/// Boxes whose centres agree to this share of the scene's size share a leaf entry.
const CENTRE_TOLERANCE: f32 = 1e-6;
/// Share of a segment that [`Tracer::occluded`] leaves out at both ends.
const END_MARGIN: f32 = 1e-4;

/// Where a ray meets the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Row of the face that is hit.
    pub face: u32,
    /// Barycentric weights of its first and second corner; the third has `1 − bary[0] − bary[1]`.
    pub bary: [f32; 2],
    /// Ray parameter, above 0: the point is `origin + t · dir`.
    pub t: f32,
}

/// Triangles of a mesh, indexed for rays. Both sides of a face are hit.
///
/// ```
/// use glam::Vec3;
/// use gs_texel::bvh::Tracer;
///
/// let tracer = Tracer::new(&[Vec3::ZERO, Vec3::X, Vec3::Y], &[[0, 1, 2]])?;
/// let hit = tracer.hit(Vec3::new(0.25, 0.25, 3.0), -Vec3::Z).unwrap();
/// assert_eq!((hit.face, hit.bary, hit.t), (0, [0.5, 0.25], 3.0));
/// assert!(tracer.occluded(Vec3::new(0.25, 0.25, 1.0), Vec3::new(0.25, 0.25, -1.0)));
/// # Ok::<(), gs_texel::surface::MeshError>(())
/// ```
pub struct Tracer {
    bvh: Bvh2,
    /// Corners in the order of the leaves.
    triangles: Vec<[Vec3A; 3]>,
    /// Row of the face of each of `triangles`.
    rows: Vec<u32>,
    /// Leaf entry `i` holds `triangles[begins[i]..begins[i + 1]]`.
    begins: Vec<u32>,
    faces: Vec<[u32; 3]>,
    vertices: usize,
    dropped: usize,
}

struct Boxed(Aabb);

impl Boundable for Boxed {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

fn corners(vertices: &[Vec3], face: [u32; 3]) -> [Vec3A; 3] {
    face.map(|v| vertices[v as usize].to_vec3a())
}

fn bounds(triangles: &[[Vec3A; 3]]) -> Aabb {
    let mut out = Aabb::empty();
    triangles.as_flattened().iter().for_each(|&p| {
        out.extend(p);
    });
    out
}

impl Tracer {
    /// Indexes `faces`, triples of rows of `vertices`.
    ///
    /// # Errors
    /// If a face names a vertex that is not there.
    pub fn new(vertices: &[Vec3], faces: &[[u32; 3]]) -> Result<Self, MeshError> {
        check_faces(faces, vertices.len())?;
        let mut tracer = Self {
            bvh: Bvh2::default(),
            triangles: Vec::new(),
            rows: Vec::new(),
            begins: vec![0],
            faces: faces.to_vec(),
            vertices: vertices.len(),
            dropped: 0,
        };
        let groups = tracer.groups(vertices);
        if groups.is_empty() {
            return Ok(tracer);
        }
        let boxes: Vec<Boxed> = groups.iter().map(|b| Boxed(bounds(&tracer.gather(vertices, b)))).collect();
        tracer.bvh = build_bvh2(&boxes, BvhBuildParams::medium_build(), &mut Duration::default());
        for &group in &tracer.bvh.primitive_indices {
            let rows = &groups[group as usize];
            tracer.rows.extend(rows);
            tracer.begins.push(tracer.rows.len() as u32);
        }
        tracer.triangles = tracer.gather(vertices, &tracer.rows);
        Ok(tracer)
    }

    fn gather(&self, vertices: &[Vec3], rows: &[u32]) -> Vec<[Vec3A; 3]> {
        rows.iter().map(|&f| corners(vertices, self.faces[f as usize])).collect()
    }

    /// Finite faces, grouped by the centre of their box; groups in order of their lowest face.
    fn groups(&mut self, vertices: &[Vec3]) -> Vec<Vec<u32>> {
        let finite = |f: &[u32; 3]| f.iter().all(|&v| vertices[v as usize].is_finite());
        let kept: Vec<u32> = (0..self.faces.len() as u32).filter(|&f| finite(&self.faces[f as usize])).collect();
        self.dropped = self.faces.len() - kept.len();
        let boxes: Vec<Aabb> = kept.iter().map(|&f| bounds(&[corners(vertices, self.faces[f as usize])])).collect();
        let scene = boxes.iter().fold(Aabb::empty(), |all, b| all.union(b));
        // Halves first: the sum of two huge corners would overflow.
        let centre = |b: &Aabb| b.min * 0.5 + b.max * 0.5;
        let step = ((scene.max * 0.5 - scene.min * 0.5).max_element() * 2.0 * CENTRE_TOLERANCE).max(f32::MIN_POSITIVE);
        let cell = |b: &Aabb| ((centre(b) - scene.min) / step).to_array().map(|v| v as u64);
        let mut keyed: Vec<([u64; 3], u32)> = boxes.iter().zip(&kept).map(|(b, &f)| (cell(b), f)).collect();
        keyed.sort_unstable();
        let of_rows = |same: &[([u64; 3], u32)]| same.iter().map(|k| k.1).collect::<Vec<u32>>();
        let mut groups: Vec<Vec<u32>> = keyed.chunk_by(|a, b| a.0 == b.0).map(of_rows).collect();
        groups.sort_unstable_by_key(|b| b[0]);
        groups
    }

    /// Moves the vertices. Boxes are refitted and the tree keeps its shape: large deformations make it slower, not wrong.
    /// Faces left out by [`Tracer::new`] stay out.
    ///
    /// # Errors
    /// If the number of vertices differs, or a face is not finite; the tracer is then unchanged.
    pub fn refit(&mut self, vertices: &[Vec3]) -> Result<(), MeshError> {
        if vertices.len() != self.vertices {
            return Err(MeshError::Rows { what: "vertices", got: vertices.len(), want: self.vertices });
        }
        let of_rows = self.rows.iter().flat_map(|&f| self.faces[f as usize]);
        if let Some(vertex) = of_rows.map(|v| v as usize).find(|&v| !vertices[v].is_finite()) {
            return Err(MeshError::NonFinite { vertex, at: vertices[vertex] });
        }
        self.triangles = self.gather(vertices, &self.rows);
        for node in self.bvh.nodes.iter_mut().filter(|n| n.is_leaf()) {
            let (first, count) = (node.first_index as usize, node.prim_count as usize);
            let places = self.begins[first] as usize..self.begins[first + count] as usize;
            node.set_aabb(bounds(&self.triangles[places]));
        }
        self.bvh.refit_all();
        Ok(())
    }

    /// Number of faces that [`Tracer::new`] left out because a corner was not finite.
    pub fn dropped(&self) -> usize {
        self.dropped
    }

    /// The closest hit along `origin + t·dir`, `t > 0`; `dir` may have any length but 0. `None` if there is none or the ray is
    /// not finite. Of faces at the same distance the lowest row is returned.
    pub fn hit(&self, origin: Vec3, dir: Vec3) -> Option<Hit> {
        let (ray, length) = unit_ray(origin, dir, 0.0, f32::INFINITY)?;
        if self.rows.is_empty() {
            return None;
        }
        let mut best: Option<Hit> = None;
        self.bvh.ray_traverse(ray, &mut RayHit::none(), |ray, entry| {
            let mut nearest = f32::INFINITY;
            for place in self.places(entry) {
                let Some((bary, t)) = intersect(&self.triangles[place], ray) else { continue };
                let face = self.rows[place];
                if best.is_none_or(|b| t < b.t || (t == b.t && face < b.face)) {
                    best = Some(Hit { face, bary, t });
                }
                nearest = nearest.min(t);
            }
            nearest
        });
        best.map(|hit| Hit { t: hit.t / length, ..hit })
    }

    /// Whether a face lies between `a` and `b`; 1/10000 of the segment is left out at both ends. `true` if a point is not
    /// finite.
    pub fn occluded(&self, a: Vec3, b: Vec3) -> bool {
        let Some((ray, _)) = unit_ray(a, b - a, END_MARGIN, 1.0 - END_MARGIN) else { return a != b };
        !self.rows.is_empty()
            && !self.bvh.ray_traverse_miss(ray, |ray, entry| {
                let met = self.places(entry).any(|place| intersect(&self.triangles[place], ray).is_some());
                if met { 0.0 } else { f32::INFINITY }
            })
    }

    fn places(&self, entry: usize) -> std::ops::Range<usize> {
        self.begins[entry] as usize..self.begins[entry + 1] as usize
    }
}

/// A ray of unit direction, and the length of `dir`; `range` is in lengths of `dir`. `None` if it is not finite or has no
/// direction. (The library replaces components below 1e-7 in its box tests, so they must be of a unit vector.)
fn unit_ray(origin: Vec3, dir: Vec3, from: f32, to: f32) -> Option<(Ray, f32)> {
    // Squares of very short and very long directions leave the range of f32.
    let direction = dir.as_dvec3();
    let (length, unit) = (direction.length() as f32, (direction / direction.length()).as_vec3());
    let good = origin.is_finite() && unit.is_finite();
    good.then(|| (Ray::new(origin.to_vec3a(), unit.to_vec3a(), from * length, to * length), length))
}

/// Weights of the first two corners and distance, if the ray meets the triangle within its range. (Möller and Trumbore,
/// "Fast, minimum storage ray/triangle intersection", 1997.)
#[inline(always)]
fn intersect(t: &[Vec3A; 3], ray: &Ray) -> Option<([f32; 2], f32)> {
    let (e1, e2) = (t[1] - t[0], t[2] - t[0]);
    let p = ray.direction.cross(e2);
    let inverse = 1.0 / e1.dot(p);
    let s = ray.origin - t[0];
    let u = s.dot(p) * inverse;
    let q = s.cross(e1);
    let v = ray.direction.dot(q) * inverse;
    let distance = e2.dot(q) * inverse;
    // Comparisons with NaN (a triangle without area, or seen edge on) are false.
    let inside = u >= -BARY_TOLERANCE && v >= -BARY_TOLERANCE && u + v <= 1.0 + BARY_TOLERANCE;
    (inside && distance >= ray.tmin && distance <= ray.tmax).then_some(([1.0 - u - v, u], distance))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;
    use std::time::Instant;

    fn random_triangles(n: u32, seed: u64) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let mut rng = Rng::new(seed, "soup", 0, 0);
        let mut point = || Vec3::new(rng.range(-1.0, 1.0), rng.range(-1.0, 1.0), rng.range(-1.0, 1.0));
        let mut vertices = Vec::new();
        for _ in 0..n {
            let centre = point();
            vertices.extend((0..3).map(|_| centre + 0.2 * point()));
        }
        (vertices, (0..n).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect())
    }

    fn brute(vertices: &[Vec3], faces: &[[u32; 3]], origin: Vec3, dir: Vec3) -> Option<Hit> {
        let (ray, length) = unit_ray(origin, dir, 0.0, f32::INFINITY).unwrap();
        let hits = faces.iter().enumerate().filter_map(|(f, &face)| {
            let (bary, t) = intersect(&corners(vertices, face), &ray)?;
            Some(Hit { face: f as u32, bary, t })
        });
        let nearest = hits.min_by(|a, b| a.t.total_cmp(&b.t).then(a.face.cmp(&b.face)));
        nearest.map(|hit| Hit { t: hit.t / length, ..hit })
    }

    fn agree(tracer: &Tracer, vertices: &[Vec3], faces: &[[u32; 3]]) {
        let mut rng = Rng::new(9, "rays", 0, 0);
        let mut met = 0;
        for _ in 0..500 {
            let mut point = || Vec3::new(rng.range(-2.0, 2.0), rng.range(-2.0, 2.0), rng.range(-2.0, 2.0));
            let (a, b) = (point(), point());
            let hit = tracer.hit(a, b - a);
            assert_eq!(hit, brute(vertices, faces, a, b - a));
            if let Some(h) = hit {
                met += 1;
                let t = faces[h.face as usize].map(|v| vertices[v as usize]);
                let at = t[0] * h.bary[0] + t[1] * h.bary[1] + t[2] * (1.0 - h.bary[0] - h.bary[1]);
                assert!((at - (a + (b - a) * h.t)).length() < 1e-5);
            }
            let between = hit.is_some_and(|h| h.t < 1.0 - 2.0 * END_MARGIN && h.t > 2.0 * END_MARGIN);
            let margin = hit.is_some_and(|h| (h.t - 1.0).abs() < 3.0 * END_MARGIN || h.t < 3.0 * END_MARGIN);
            assert!(margin || tracer.occluded(a, b) == between);
        }
        assert!(met > 10, "{met}");
    }

    #[test]
    fn hits_are_those_of_brute_force_also_after_a_refit() {
        let (mut v, f) = random_triangles(400, 1);
        let mut tracer = Tracer::new(&v, &f).unwrap();
        agree(&tracer, &v, &f);
        v.iter_mut().for_each(|p| *p = Vec3::new(p.x + 0.5 * (3.0 * p.y).sin(), 1.3 * p.y, p.z - 0.2));
        tracer.refit(&v).unwrap();
        agree(&tracer, &v, &f);
    }

    #[test]
    fn a_million_shared_middles_are_no_trouble_and_nan_is_left_out() {
        let (mut v, mut f) = random_triangles(50, 2);
        let n = v.len() as u32;
        v.extend([Vec3::NAN, Vec3::splat(f32::INFINITY)]);
        f.extend([[0, 1, n], [n + 1, 2, 3], [5, 5, 5], [6, 6, 7]]);
        f.extend((0..32_000).map(|_| [0, 1, 2]));
        let start = Instant::now();
        let mut tracer = Tracer::new(&v, &f).unwrap();
        assert!(start.elapsed().as_secs_f64() < 2.0, "{:?}", start.elapsed());
        assert_eq!(tracer.dropped(), 2);
        let sound: Vec<[u32; 3]> = f[..50].to_vec();
        agree(&tracer, &v, &sound);
        assert_eq!(tracer.hit(Vec3::NAN, Vec3::X), None);
        assert!(tracer.occluded(Vec3::NAN, Vec3::X));
        let mut worse = v.clone();
        worse[1] = Vec3::NAN;
        assert!(matches!(tracer.refit(&worse), Err(MeshError::NonFinite { vertex: 1, .. })));
        agree(&tracer, &v, &sound);
    }

    #[test]
    fn nothing_is_hit_where_nothing_is() {
        let empty = Tracer::new(&[], &[]).unwrap();
        assert_eq!(empty.hit(Vec3::ZERO, Vec3::X), None);
        assert!(!empty.occluded(Vec3::ZERO, Vec3::X));
        let error = Tracer::new(&[Vec3::ZERO], &[[0, 0, 1]]).err().map(|e| e.to_string());
        assert!(error.is_some_and(|e| e.contains("names vertex 1")));
    }

    #[test]
    fn no_ray_slips_between_two_triangles() {
        let v = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.1], [1.0, 1.0, 0.0], [-1.0, 1.0, -0.1]].map(Vec3::from_array);
        let tracer = Tracer::new(&v, &[[0, 1, 2], [0, 2, 3]]).unwrap();
        let mut rng = Rng::new(4, "slip", 0, 0);
        for _ in 0..20_000 {
            let on_edge = v[0].lerp(v[2], rng.range(0.01, 0.99));
            let from = Vec3::new(rng.range(-1.0, 1.0), rng.range(-1.0, 1.0), 3.0);
            assert!(tracer.hit(from, on_edge - from).is_some() && tracer.occluded(from, from + 2.0 * (on_edge - from)));
        }
    }
}
