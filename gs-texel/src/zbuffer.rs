//! Depth maps of a mesh: camera-space z at every pixel centre, `∞` where no face covers it.
//!
//! `1/z` is linear on the screen, so each triangle is a plane there. The nearest surface wins, whichever way it faces.
//! Triangles that reach behind the near plane are clipped. A pixel's value depends neither on the order of the faces nor on
//! the rows handled together.

use crate::coverage::{MAX_COORDINATE, Window, spans, to_fixed};
use crate::surface::{CHUNK, NONE};
use glam::{DVec2, DVec3, Vec3};
use gs_core::Camera;
use rayon::prelude::*;

/// Pixel rows filled by one task.
const BAND_ROWS: usize = 32;

/// Depth of the nearest surface at each pixel centre.
///
/// ```
/// use glam::{DVec3, Vec3};
/// use gs_core::Camera;
/// use gs_texel::zbuffer::DepthMap;
///
/// // A triangle in the plane z = 2, much larger than the frame.
/// let camera = Camera::look_at(8, 6, 1.0, DVec3::ZERO, DVec3::Z, -DVec3::Y)?;
/// let vertices = [[-9.0, -9.0, 2.0], [9.0, -9.0, 2.0], [0.0, 9.0, 2.0]].map(Vec3::from_array);
/// let map = DepthMap::new(&vertices, &[[0, 1, 2]], &camera, 0.05);
/// assert!(map.depth.iter().all(|&z| z == 2.0));
/// # Ok::<(), gs_core::camera::CameraError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    /// Width of the map in pixels.
    pub width: usize,
    /// Height of the map in pixels.
    pub height: usize,
    /// Camera-space z in world units, `∞` where no face is; `height · width` values, row-major.
    pub depth: Vec<f32>,
}

impl DepthMap {
    /// The depth map of a mesh seen by `camera`. Surfaces nearer than `near` are clipped off. `vertices` must be finite and
    /// the faces in range.
    pub fn new(vertices: &[Vec3], faces: &[[u32; 3]], camera: &Camera, near: f64) -> Self {
        ProjectedMesh::new(vertices, faces, camera, near).depth_map()
    }

    /// z of pixel `(x, y)`, column and row.
    pub fn at(&self, x: usize, y: usize) -> f32 {
        self.depth[y * self.width + x]
    }
}

/// The number of the nearest face at each pixel centre, row-major, [`NONE`] where there is none. Of two equally near faces
/// the lower number. `vertices` must be finite and the faces in range.
pub fn face_map(vertices: &[Vec3], faces: &[[u32; 3]], camera: &Camera, near: f64) -> Vec<u32> {
    ProjectedMesh::new(vertices, faces, camera, near).face_map()
}

/// A vertex in camera space and projected.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Corner {
    /// Camera-space position.
    pub(crate) camera: DVec3,
    /// Position in pixels; meaningless behind the near plane.
    pub(crate) pixel: DVec2,
}

/// A mesh projected into a camera.
pub(crate) struct ProjectedMesh<'a> {
    camera: &'a Camera,
    near: f64,
    faces: &'a [[u32; 3]],
    pub(crate) corners: Vec<Corner>,
    /// First and last pixel row that each face may cover; an empty range where it is out of the frame.
    rows: Vec<[i32; 2]>,
}

impl<'a> ProjectedMesh<'a> {
    pub(crate) fn new(vertices: &[Vec3], faces: &'a [[u32; 3]], camera: &'a Camera, near: f64) -> Self {
        let project = |v: &Vec3| {
            let q = camera.to_camera(v.as_dvec3());
            Corner { camera: q, pixel: camera.to_pixel(q) }
        };
        let corners: Vec<Corner> = vertices.par_iter().with_min_len(CHUNK).map(project).collect();
        let mut mesh = Self { camera, near, faces, corners, rows: Vec::new() };
        let rows = |f: &[u32; 3]| mesh.bounds(f).map_or([0, -1], |w| [w.y0 as i32, w.y1 as i32 - 1]);
        mesh.rows = faces.par_iter().with_min_len(CHUNK).map(rows).collect();
        mesh
    }

    /// Whether all corners lie in front of the near plane and within fixed-point range, so that no clipping is needed.
    fn needs_no_clip(&self, t: &[Corner; 3]) -> bool {
        let near = |c: &Corner| c.camera.z > self.near && c.pixel.abs().max_element() < MAX_COORDINATE;
        t.iter().all(near)
    }

    /// The pixels whose centres a face may cover, `None` if there are none.
    fn bounds(&self, face: &[u32; 3]) -> Option<Window> {
        let t = face.map(|v| self.corners[v as usize]);
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        if t.iter().all(|c| c.camera.z <= self.near) {
            return None;
        }
        if !self.needs_no_clip(&t) {
            return Some(Window { x0: 0, y0: 0, x1: width, y1: height });
        }
        let [a, b, c] = t.map(|c| c.pixel);
        let (lo, hi) = (a.min(b).min(c), a.max(b).max(c));
        // Rounding of corners moves them by less than 1/256; a float below 0 becomes 0.
        let window = Window {
            x0: (lo.x - 0.51).ceil() as usize,
            y0: (lo.y - 0.51).ceil() as usize,
            x1: width.min((hi.x + 0.51).floor().max(0.0) as usize),
            y1: height.min((hi.y + 0.51).floor().max(0.0) as usize),
        };
        (!window.is_empty()).then_some(window)
    }

    /// z of the nearest face at each pixel centre.
    pub(crate) fn depth_map(&self) -> DepthMap {
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        let mut depth = vec![f32::INFINITY; width * height];
        depth.par_chunks_mut((BAND_ROWS * width).max(1)).enumerate().for_each(|(band, rows)| {
            let y0 = band * BAND_ROWS;
            self.rasterise(Window { x0: 0, y0, x1: width, y1: y0 + rows.len() / width }, |_, y, x0, x1, plane| {
                plane.nearest(y, x0, &mut rows[(y - y0) * width + x0..(y - y0) * width + x1]);
            });
        });
        DepthMap { width, height, depth }
    }

    /// The nearest face at each pixel centre, the lower number where two are equally near.
    pub(crate) fn face_map(&self) -> Vec<u32> {
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        let mut out = vec![NONE; width * height];
        out.par_chunks_mut((BAND_ROWS * width).max(1)).enumerate().for_each(|(band, out)| {
            let y0 = band * BAND_ROWS;
            let mut depth = vec![f32::INFINITY; out.len()];
            let band = Window { x0: 0, y0, x1: width, y1: y0 + out.len() / width };
            self.rasterise(band, |face, y, x0, x1, plane| {
                let at = (y - y0) * width;
                for x in x0..x1 {
                    let z = plane.at(plane.row(y), x);
                    // Faces come in ascending order.
                    if z < depth[at + x] {
                        (depth[at + x], out[at + x]) = (z, face);
                    }
                }
            });
        });
        out
    }

    /// Calls `put(face, y, x0, x1, plane)` for the spans of all faces in `window`, faces ascending.
    fn rasterise(&self, window: Window, mut put: impl FnMut(u32, usize, usize, usize, &Plane)) {
        let (top, bottom) = (window.y0 as i32, window.y1 as i32);
        for (f, (face, rows)) in self.faces.iter().zip(&self.rows).enumerate() {
            if rows[0] >= bottom || rows[1] < top {
                continue;
            }
            let t = face.map(|v| self.corners[v as usize]);
            if self.needs_no_clip(&t) {
                self.rasterise_one(t, window, |y, x0, x1, plane| put(f as u32, y, x0, x1, plane));
                continue;
            }
            let polygon = self.clipped(t.map(|c| c.camera));
            for i in 2..polygon.len() {
                let t = [polygon[0], polygon[i - 1], polygon[i]];
                self.rasterise_one(t, window, |y, x0, x1, plane| put(f as u32, y, x0, x1, plane));
            }
        }
    }

    fn rasterise_one(&self, t: [Corner; 3], window: Window, mut put: impl FnMut(usize, usize, usize, &Plane)) {
        let mut plane = None;
        spans(t.map(|c| to_fixed(c.pixel)), window, |y, x0, x1| {
            let plane = plane.get_or_insert_with(|| Plane::new(&t, self.camera.width));
            put(y, x0, x1, plane);
        });
    }

    /// The part of a triangle in front of the near plane and within fixed-point range, as a convex polygon.
    fn clipped(&self, triangle: [DVec3; 3]) -> Vec<Corner> {
        let c = self.camera;
        let reach = 0.5 * MAX_COORDINATE;
        let planes = [
            (DVec3::Z, self.near),
            (DVec3::new(c.fx, 0.0, reach + c.cx), 0.0),
            (DVec3::new(-c.fx, 0.0, reach - c.cx), 0.0),
            (DVec3::new(0.0, c.fy, reach + c.cy), 0.0),
            (DVec3::new(0.0, -c.fy, reach - c.cy), 0.0),
        ];
        let mut polygon = triangle.to_vec();
        for (normal, least) in planes {
            let old = std::mem::take(&mut polygon);
            let height = |p: DVec3| normal.dot(p) - least;
            for (i, &p) in old.iter().enumerate() {
                let q = old[(i + 1) % old.len()];
                let (hp, hq) = (height(p), height(q));
                if hp >= 0.0 {
                    polygon.push(p);
                }
                // From the inner to the outer end, so that neighbours compute the same point.
                match (hp >= 0.0, hq >= 0.0) {
                    (true, false) => polygon.push(p + (q - p) * (hp / (hp - hq))),
                    (false, true) => polygon.push(q + (p - q) * (hq / (hq - hp))),
                    _ => {}
                }
            }
        }
        let corner = |q: DVec3| {
            let q = q.with_z(q.z.max(self.near));
            Corner {
                camera: q,
                pixel: c.to_pixel(q).clamp(DVec2::splat(-MAX_COORDINATE), DVec2::splat(MAX_COORDINATE)),
            }
        };
        polygon.into_iter().map(corner).collect()
    }
}

/// `1/z` of a triangle as a linear function of the pixel, clamped to the range of its corners.
pub(crate) struct Plane {
    /// `1/z` at the centre of pixel `(column, 0)`.
    base: f64,
    down: f64,
    right: f32,
    column: f32,
    low: f32,
    high: f32,
}

impl Plane {
    fn new(t: &[Corner; 3], width: u32) -> Self {
        let [i, j, k] = t.map(|c| 1.0 / c.camera.z);
        let [a, b, c] = t.map(|c| c.pixel);
        let (p, q) = (b - a, c - a);
        let area = p.perp_dot(q);
        let (mut right, mut down) = (((j - i) * q.y - (k - i) * p.y) / area, ((k - i) * p.x - (j - i) * q.x) / area);
        if !(right.is_finite() && down.is_finite()) {
            (right, down) = (0.0, 0.0);
        }
        let column = a.x.floor().clamp(0.0, f64::from(width));
        let base = i + right * (column + 0.5 - a.x) + down * (0.5 - a.y);
        let (low, high) = (i.min(j).min(k) as f32, i.max(j).max(k) as f32);
        Self { base, down, right: right as f32, column: column as f32, low, high }
    }

    /// The row term of [`Plane::at`] for row `y`.
    #[inline(always)]
    fn row(&self, y: usize) -> f32 {
        (self.base + self.down * y as f64) as f32
    }

    /// z at the centre of pixel `x` of a row.
    #[inline(always)]
    fn at(&self, row: f32, x: usize) -> f32 {
        let inverse = row + self.right * (x as i32 as f32 - self.column);
        let inverse = if inverse > self.high { self.high } else { inverse };
        1.0 / if inverse < self.low { self.low } else { inverse }
    }

    /// `depth = min(depth, z)` for the pixels of row `y` from `x0` on.
    #[inline(always)]
    fn nearest(&self, y: usize, x0: usize, depth: &mut [f32]) {
        let row = self.row(y);
        for (i, d) in depth.iter_mut().enumerate() {
            let z = self.at(row, x0 + i);
            *d = if z < *d { z } else { *d };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(width: u32, height: u32) -> Camera {
        Camera::look_at(width, height, 1.0, DVec3::ZERO, DVec3::Z, -DVec3::Y).unwrap()
    }

    const PLATE: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

    #[test]
    fn a_tilted_plane_has_its_analytic_depth() {
        let camera = camera(97, 61);
        // z = 3 + x + y/2, far wider than the frame.
        let corner = |x: f32, y: f32| Vec3::new(x, y, 3.0 + x + 0.5 * y);
        let v = [corner(-1.9, -1.9), corner(9.0, -1.9), corner(9.0, 9.0), corner(-1.9, 9.0)];
        let map = DepthMap::new(&v, &PLATE, &camera, 0.05);
        let mut met = 0;
        for y in 0..61 {
            for x in 0..97 {
                let ray = camera.ray(x as f64 + 0.5, y as f64 + 0.5);
                let ray = ray / ray.z;
                let want = 3.0 / (1.0 - ray.x - 0.5 * ray.y);
                let at = ray * want;
                if at.x > -1.8 && at.y > -1.8 && at.x < 8.9 && at.y < 8.9 {
                    met += 1;
                    assert!((f64::from(map.at(x, y)) / want - 1.0).abs() < 2e-6, "{x} {y}");
                }
            }
        }
        assert!(met > 5000, "{met}");
    }

    #[test]
    fn a_floor_through_the_camera_is_cut_and_keeps_its_depth() {
        let camera = camera(64, 64);
        // A floor half a metre below, from far behind to far before the camera: corners beyond any fixed point.
        let v = [[-1e7, 0.5, -1e7], [1e7, 0.5, -1e7], [1e7, 0.5, 1e7], [-1e7, 0.5, 1e7]].map(Vec3::from_array);
        let map = DepthMap::new(&v, &PLATE, &camera, 0.05);
        for y in 0..64 {
            let slope = (y as f64 + 0.5 - camera.cy) / camera.fy;
            for x in 0..64 {
                let got = f64::from(map.at(x, y));
                if y < 32 {
                    assert_eq!(got, f64::INFINITY);
                } else {
                    assert!((got * slope / 0.5 - 1.0).abs() < 1e-4, "{x} {y}: {got}");
                }
            }
        }
        let behind = v.map(|p| p - Vec3::Z * 2e7);
        assert!(DepthMap::new(&behind, &PLATE, &camera, 0.05).depth.iter().all(|d| d.is_infinite()));
    }

    #[test]
    fn threads_change_no_bit_and_faces_are_the_nearest() {
        let camera = camera(80, 70);
        let mut rng = gs_core::Rng::new(5, "zbuffer", 0, 0);
        let v: Vec<Vec3> =
            (0..300).map(|_| Vec3::new(rng.range(-1.0, 1.0), rng.range(-1.0, 1.0), rng.range(-0.5, 3.0))).collect();
        let faces: Vec<[u32; 3]> = (0..100u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let map = DepthMap::new(&v, &faces, &camera, 0.05);
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(one.install(|| DepthMap::new(&v, &faces, &camera, 0.05)), map);
        let nearest = face_map(&v, &faces, &camera, 0.05);
        for (face, z) in nearest.iter().zip(&map.depth) {
            assert_eq!(*face == NONE, z.is_infinite());
        }
        let only = |f: u32| DepthMap::new(&v, &[faces[f as usize]], &camera, 0.05);
        let f = nearest[35 * 80 + 40];
        assert!(f != NONE && only(f).at(40, 35) == map.at(40, 35));
    }
}
