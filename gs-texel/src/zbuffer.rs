//! Depth maps of a mesh: metric z at every pixel centre, `∞` where there is none.
//!
//! `1/z` is linear on the screen, so a triangle is a plane there; the nearest surface wins, whichever way it faces.
//! Triangles that reach behind the near plane are cut. A pixel's value depends on its triangles alone, not on the order,
//! the rows handled together or the window filled.

use crate::coverage::{REACH, Window, snap, spans};
use crate::surface::{CHUNK, NONE};
use glam::{DVec2, DVec3, Vec3};
use gs_core::Camera;
use rayon::prelude::*;

/// Rows filled by one task.
const BAND: usize = 32;

/// Depth of the nearest surface at each pixel centre.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Camera-space z, `∞` where nothing is; `height · width` values.
    pub depth: Vec<f32>,
}

impl DepthMap {
    /// The depth map of a mesh seen by `camera`; nothing nearer than `near` is drawn. `vertices` must be finite and the
    /// faces in range.
    pub fn new(vertices: &[Vec3], faces: &[[u32; 3]], camera: &Camera, near: f64) -> Self {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let mut map = Self { width, height, depth: vec![f32::INFINITY; width * height] };
        map.fill(&Screen::new(vertices, faces, camera, near), map.frame());
        map
    }

    /// z of pixel `(x, y)`.
    pub fn at(&self, x: usize, y: usize) -> f32 {
        self.depth[y * self.width + x]
    }

    /// The whole frame.
    pub(crate) fn frame(&self) -> Window {
        Window { x0: 0, y0: 0, x1: self.width, y1: self.height }
    }

    /// Draws `window` anew; the rest stays.
    pub(crate) fn fill(&mut self, screen: &Screen<'_>, window: Window) {
        if window.is_empty() {
            return;
        }
        let width = self.width;
        let rows = &mut self.depth[window.y0 * width..window.y1 * width];
        rows.par_chunks_mut(BAND * width).enumerate().for_each(|(band, rows)| {
            let y0 = window.y0 + band * BAND;
            rows.chunks_mut(width).for_each(|row| row[window.x0..window.x1].fill(f32::INFINITY));
            let band = Window { y0, y1: y0 + rows.len() / width, ..window };
            screen.draw(band, |_, y, x0, x1, plane| {
                plane.nearest(y, x0, &mut rows[(y - y0) * width + x0..(y - y0) * width + x1]);
            });
        });
    }
}

/// The face nearest at each pixel centre, [`NONE`] where there is none; the lower number where two are equally near.
pub fn face_map(vertices: &[Vec3], faces: &[[u32; 3]], camera: &Camera, near: f64) -> Vec<u32> {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let screen = Screen::new(vertices, faces, camera, near);
    let mut out = vec![NONE; width * height];
    out.par_chunks_mut(BAND * width).enumerate().for_each(|(band, out)| {
        let y0 = band * BAND;
        let mut depth = vec![f32::INFINITY; out.len()];
        let band = Window { x0: 0, y0, x1: width, y1: y0 + out.len() / width };
        screen.draw(band, |face, y, x0, x1, plane| {
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

/// A vertex before and after projection.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Corner {
    /// Camera space.
    pub camera: DVec3,
    /// Pixels; meaningless behind the near plane.
    pub pixel: DVec2,
}

/// A mesh as a camera sees it.
pub(crate) struct Screen<'a> {
    camera: &'a Camera,
    near: f64,
    faces: &'a [[u32; 3]],
    pub corners: Vec<Corner>,
    /// First and last row of pixels each face may touch; empty where it cannot be seen.
    rows: Vec<[i32; 2]>,
}

impl<'a> Screen<'a> {
    pub fn new(vertices: &[Vec3], faces: &'a [[u32; 3]], camera: &'a Camera, near: f64) -> Self {
        let project = |v: &Vec3| {
            let q = camera.to_camera(v.as_dvec3());
            Corner { camera: q, pixel: camera.to_pixel(q) }
        };
        let corners: Vec<Corner> = vertices.par_iter().with_min_len(CHUNK).map(project).collect();
        let mut screen = Self { camera, near, faces, corners, rows: Vec::new() };
        let rows = |f: &[u32; 3]| screen.bounds(f).map_or([0, -1], |w| [w.y0 as i32, w.y1 as i32 - 1]);
        screen.rows = faces.par_iter().with_min_len(CHUNK).map(rows).collect();
        screen
    }

    /// Whether all corners lie in front and within reach, so that nothing must be cut.
    fn whole(&self, t: &[Corner; 3]) -> bool {
        let near = |c: &Corner| c.camera.z > self.near && c.pixel.abs().max_element() < REACH;
        t.iter().all(near)
    }

    /// The pixels whose centres a face may own, `None` if there are none.
    pub fn bounds(&self, face: &[u32; 3]) -> Option<Window> {
        let t = face.map(|v| self.corners[v as usize]);
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        if t.iter().all(|c| c.camera.z <= self.near) {
            return None;
        }
        if !self.whole(&t) {
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

    /// Calls `put(face, y, x0, x1, plane)` for the spans of all faces in `window`, faces ascending.
    pub fn draw(&self, window: Window, mut put: impl FnMut(u32, usize, usize, usize, &Plane)) {
        let (top, bottom) = (window.y0 as i32, window.y1 as i32);
        for (f, (face, rows)) in self.faces.iter().zip(&self.rows).enumerate() {
            if rows[0] >= bottom || rows[1] < top {
                continue;
            }
            let t = face.map(|v| self.corners[v as usize]);
            if self.whole(&t) {
                self.draw_one(t, window, |y, x0, x1, plane| put(f as u32, y, x0, x1, plane));
                continue;
            }
            let polygon = self.cut(t.map(|c| c.camera));
            for i in 2..polygon.len() {
                let t = [polygon[0], polygon[i - 1], polygon[i]];
                self.draw_one(t, window, |y, x0, x1, plane| put(f as u32, y, x0, x1, plane));
            }
        }
    }

    fn draw_one(&self, t: [Corner; 3], window: Window, mut put: impl FnMut(usize, usize, usize, &Plane)) {
        let mut plane = None;
        spans(t.map(|c| snap(c.pixel)), window, |y, x0, x1| {
            let plane = plane.get_or_insert_with(|| Plane::new(&t, self.camera.width));
            put(y, x0, x1, plane);
        });
    }

    /// The part of a triangle in front of the near plane and within reach of fixed point, as a convex polygon.
    fn cut(&self, triangle: [DVec3; 3]) -> Vec<Corner> {
        let c = self.camera;
        let reach = 0.5 * REACH;
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
            Corner { camera: q, pixel: c.to_pixel(q).clamp(DVec2::splat(-REACH), DVec2::splat(REACH)) }
        };
        polygon.into_iter().map(corner).collect()
    }
}

/// `1/z` of a triangle as a linear function of the pixel, held within that of its corners.
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

    /// What [`Plane::at`] needs of row `y`.
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

    /// Lowers `depth`, the pixels of row `y` from `x0` on, to this triangle's.
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
    fn windows_and_threads_change_no_bit_and_faces_are_the_nearest() {
        let camera = camera(80, 70);
        let mut rng = gs_core::Rng::new(5, "zbuffer", 0, 0);
        let v: Vec<Vec3> =
            (0..300).map(|_| Vec3::new(rng.range(-1.0, 1.0), rng.range(-1.0, 1.0), rng.range(-0.5, 3.0))).collect();
        let faces: Vec<[u32; 3]> = (0..100u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let map = DepthMap::new(&v, &faces, &camera, 0.05);
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(one.install(|| DepthMap::new(&v, &faces, &camera, 0.05)), map);
        let mut patched = map.clone();
        let window = Window { x0: 13, y0: 9, x1: 41, y1: 66 };
        for y in 9..66 {
            patched.depth[y * 80 + 13..y * 80 + 41].fill(-1.0);
        }
        patched.fill(&Screen::new(&v, &faces, &camera, 0.05), window);
        assert_eq!(patched, map);
        let nearest = face_map(&v, &faces, &camera, 0.05);
        for (face, z) in nearest.iter().zip(&map.depth) {
            assert_eq!(*face == NONE, z.is_infinite());
        }
        let only = |f: u32| DepthMap::new(&v, &[faces[f as usize]], &camera, 0.05);
        let f = nearest[35 * 80 + 40];
        assert!(f != NONE && only(f).at(40, 35) == map.at(40, 35));
    }
}
