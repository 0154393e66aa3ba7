//! Rays against a mesh that may move: closest hits, occlusion, and refitting (the boxes are `obvhs`'s).
//!
//! Faces with corners that are not finite are left out; faces whose boxes have the same middle share one box, since the
//! builder takes quadratic time over them.

use crate::surface::{MeshError, check_faces};
use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::{Bvh2, builder::build_bvh2};
use obvhs::ray::{Ray, RayHit};
use obvhs::{Boundable, BvhBuildParams};
use std::time::Duration;

/// Barycentric coordinates this far below zero still hit, so that no ray slips between two triangles.
const EDGE: f32 = 1e-6;
/// Boxes whose middles agree to this part of the scene share one.
const SAME_PLACE: f32 = 1e-6;
/// A segment of [`Tracer::occluded`] leaves out this part at both ends.
const END: f32 = 1e-4;

/// Where a ray meets the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Row of the face.
    pub face: u32,
    /// Weights of its first and second corner; the third has the rest.
    pub bary: [f32; 2],
    /// The point is `origin + t · dir`.
    pub t: f32,
}

/// A mesh to be met by rays. Both sides of a face count.
pub struct Tracer {
    bvh: Bvh2,
    /// Corners by place in the tree.
    triangles: Vec<[Vec3A; 3]>,
    /// Row of the face at each place.
    rows: Vec<u32>,
    /// Leaf entry `i` holds the places `begins[i]..begins[i + 1]`.
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
    /// A tracer of `faces` over `vertices`.
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
        let bundles = tracer.bundles(vertices);
        if bundles.is_empty() {
            return Ok(tracer);
        }
        let boxes: Vec<Boxed> = bundles.iter().map(|b| Boxed(bounds(&tracer.gather(vertices, b)))).collect();
        tracer.bvh = build_bvh2(&boxes, BvhBuildParams::medium_build(), &mut Duration::default());
        for &bundle in &tracer.bvh.primitive_indices {
            let rows = &bundles[bundle as usize];
            tracer.rows.extend(rows);
            tracer.begins.push(tracer.rows.len() as u32);
        }
        tracer.triangles = tracer.gather(vertices, &tracer.rows);
        Ok(tracer)
    }

    fn gather(&self, vertices: &[Vec3], rows: &[u32]) -> Vec<[Vec3A; 3]> {
        rows.iter().map(|&f| corners(vertices, self.faces[f as usize])).collect()
    }

    /// Finite faces, those of one place together; in order of their lowest face.
    fn bundles(&mut self, vertices: &[Vec3]) -> Vec<Vec<u32>> {
        let finite = |f: &[u32; 3]| f.iter().all(|&v| vertices[v as usize].is_finite());
        let kept: Vec<u32> = (0..self.faces.len() as u32).filter(|&f| finite(&self.faces[f as usize])).collect();
        self.dropped = self.faces.len() - kept.len();
        let boxes: Vec<Aabb> = kept.iter().map(|&f| bounds(&[corners(vertices, self.faces[f as usize])])).collect();
        let scene = boxes.iter().fold(Aabb::empty(), |all, b| all.union(b));
        // Halves first: the sum of two huge corners would overflow.
        let middle = |b: &Aabb| b.min * 0.5 + b.max * 0.5;
        let step = ((scene.max * 0.5 - scene.min * 0.5).max_element() * 2.0 * SAME_PLACE).max(f32::MIN_POSITIVE);
        let cell = |b: &Aabb| ((middle(b) - scene.min) / step).to_array().map(|v| v as u64);
        let mut keyed: Vec<([u64; 3], u32)> = boxes.iter().zip(&kept).map(|(b, &f)| (cell(b), f)).collect();
        keyed.sort_unstable();
        let of_rows = |same: &[([u64; 3], u32)]| same.iter().map(|k| k.1).collect::<Vec<u32>>();
        let mut bundles: Vec<Vec<u32>> = keyed.chunk_by(|a, b| a.0 == b.0).map(of_rows).collect();
        bundles.sort_unstable_by_key(|b| b[0]);
        bundles
    }

    /// The same faces over moved vertices: boxes are fitted anew, the tree stays (it gets slower, not wrong, under large
    /// deformation). Faces left out by [`Tracer::new`] stay out.
    ///
    /// # Errors
    /// Another number of vertices, or a face that is no longer finite; the tracer is then as before.
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

    /// Faces left out because a corner was not finite.
    pub fn dropped(&self) -> usize {
        self.dropped
    }

    /// The first face along `origin + t·dir`, `t > 0`; `dir` need not be unit. `None` also for a ray that is not finite.
    /// Of faces at the same distance the lowest is given.
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

    /// Whether a face lies between `a` and `b`; 1/10000 of the way is left out at both ends. Points that are not finite
    /// see nothing.
    pub fn occluded(&self, a: Vec3, b: Vec3) -> bool {
        let Some((ray, _)) = unit_ray(a, b - a, END, 1.0 - END) else { return a != b };
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
    let length = dir.length();
    let unit = dir / length;
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
    let inside = u >= -EDGE && v >= -EDGE && u + v <= 1.0 + EDGE;
    (inside && distance >= ray.tmin && distance <= ray.tmax).then_some(([1.0 - u - v, u], distance))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;
    use std::time::Instant;

    fn soup(n: u32, seed: u64) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let mut rng = Rng::new(seed, "soup", 0, 0);
        let mut point = || Vec3::new(rng.range(-1.0, 1.0), rng.range(-1.0, 1.0), rng.range(-1.0, 1.0));
        let mut vertices = Vec::new();
        for _ in 0..n {
            let middle = point();
            vertices.extend((0..3).map(|_| middle + 0.2 * point()));
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
            let between = hit.is_some_and(|h| h.t < 1.0 - 2.0 * END && h.t > 2.0 * END);
            let margin = hit.is_some_and(|h| (h.t - 1.0).abs() < 3.0 * END || h.t < 3.0 * END);
            assert!(margin || tracer.occluded(a, b) == between);
        }
        assert!(met > 10, "{met}");
    }

    #[test]
    fn hits_are_those_of_brute_force_also_after_a_refit() {
        let (mut v, f) = soup(400, 1);
        let mut tracer = Tracer::new(&v, &f).unwrap();
        agree(&tracer, &v, &f);
        v.iter_mut().for_each(|p| *p = Vec3::new(p.x + 0.5 * (3.0 * p.y).sin(), 1.3 * p.y, p.z - 0.2));
        tracer.refit(&v).unwrap();
        agree(&tracer, &v, &f);
    }

    #[test]
    fn a_million_shared_middles_are_no_trouble_and_nan_is_left_out() {
        let (mut v, mut f) = soup(50, 2);
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
