//! Distances from measured points to the faces of a surface:
//!
//! ```text
//! L = (1/|Q|) Σ_q min_f |q − c_f|²     c_f = Σ b_k p_k, the nearest point of face f
//! ```
//! The loss is 0 for a surface that contains the points, so it leaves tangential motion free. Where points have colours `C_q`
//! and the surface the texture `C(f, b)`, the nearest point in position and colour is used (colours as in Park et al. 2017,
//! "Colored point cloud registration revisited"):
//! ```text
//! L = (1/|Q|) Σ_q min_f ( |q − c_f|² + w |C_q − C(f, b)|² )                       w: squared metres
//! ```
//! `b` follows the corners: with `r = q − c`, `E` the edges from corner 0, `u = (b_1, b_2)` and `Eᵀ r = 0`,
//! ```text
//! du = (EᵀE)⁻¹ (dEᵀ r − Eᵀ (dp_0 + dE u))
//! ```
//! and the same for one edge where `c` lies on it; at a corner `b` is constant. Candidates are the faces around the 16 vertices
//! nearest to `q`. They may miss a large face with many vertices of another part close behind it.

use super::chamfer::{BLOCK, Chamfer, ChamferError, local};
use super::{Point, SurfaceLoss};
use crate::surface::Topology;
use crate::template::Template;
use glam::DVec3;
use kiddo::SquaredEuclidean;
use rayon::prelude::*;
use std::num::NonZero;

/// Vertices whose faces are candidates for the nearest one.
const NEIGHBOURS: usize = 16;

/// A colour at every point of a surface.
pub trait SurfaceColors: Sync {
    /// Display-encoded colour at barycentric coordinates of a face, and its derivative by each of them.
    fn at(&self, face: usize, bary: [f64; 3]) -> (DVec3, [DVec3; 3]);
}

impl SurfaceColors for Template {
    fn at(&self, face: usize, bary: [f64; 3]) -> (DVec3, [DVec3; 3]) {
        let (color, slopes) = self.colour_and_slopes(face, bary.map(|b| b as f32));
        (color.truncate().as_dvec3(), slopes.map(|s| s.truncate().as_dvec3()))
    }
}

/// Colours of both sides for [`Chamfer::evaluate_faces`].
#[derive(Clone, Copy)]
pub struct Colors<'a> {
    /// `C(f, b)`: colours of the surface.
    pub paint: &'a dyn SurfaceColors,
    /// Display-encoded colours of the measured points, one row each.
    pub points: &'a [[f32; 3]],
    /// `w`: weight of squared colour differences, squared metres.
    pub weight: f64,
}

/// The nearest point of a face, and its cost.
#[derive(Clone, Copy)]
struct Foot {
    corners: [u32; 3],
    bary: [f64; 3],
    /// Vector from `q` to the foot.
    error: DVec3,
    cost: f64,
    /// Derivative of the cost by the barycentric coordinates.
    d_bary: [f64; 3],
}

impl Chamfer {
    /// The mean squared distance of the measured points to the faces of a surface, with colours if given:
    /// `(1/|Q|) Σ_q min_f (|q − c_f|² + w |C_q − C(f, b)|²)`, and its gradient by `points`. `topology` is that of `faces`.
    ///
    /// # Errors
    /// As [`Chamfer::evaluate`], and if the numbers of colours and measured points differ.
    pub fn evaluate_faces<P: Point>(
        &self,
        points: &[P],
        faces: &[[u32; 3]],
        topology: &Topology,
        colors: Option<&Colors<'_>>,
    ) -> Result<SurfaceLoss, ChamferError> {
        if let Some(c) = colors.filter(|c| c.points.len() != self.target.len()) {
            return Err(ChamferError::Colors { got: c.points.len(), want: self.target.len() });
        }
        let (points, moving) = self.vertices(points)?;
        let surface = Surface { points: &points, faces, topology, reach: reach(&points, faces) };
        let wanted = NonZero::new(NEIGHBOURS).unwrap_or(NonZero::<usize>::MIN);
        let foot = |(k, &q): (usize, &DVec3)| {
            let near = moving.query(&local(q, self.centroid)).nearest_n::<SquaredEuclidean<f32>>(wanted).execute();
            surface.foot(q, near.iter().map(|n| n.item as usize), colors.map(|c| (c, c.points[k])))
        };
        let feet: Vec<Option<Foot>> = self.target.par_iter().enumerate().with_min_len(BLOCK).map(foot).collect();
        let mut loss = SurfaceLoss::none(points.len());
        let share = 1.0 / self.target.len() as f64;
        for Foot { corners, bary, error, cost, d_bary } in feet.into_iter().flatten() {
            loss.value += share * cost;
            let at = corners.map(|v| points[v as usize]);
            let moved = foot_backward(at, bary, -error, d_bary);
            for k in 0..3 {
                loss.grad[corners[k] as usize] += share * (2.0 * bary[k] * error + moved[k]);
            }
        }
        Ok(loss)
    }
}

/// A surface to search for nearest points.
struct Surface<'a> {
    points: &'a [DVec3],
    faces: &'a [[u32; 3]],
    topology: &'a Topology,
    /// Largest distance from each vertex to another corner of its faces.
    reach: Vec<f64>,
}

impl Surface<'_> {
    /// The foot of least cost of `q` on the faces around some vertices; `None` if no face there has an area.
    fn foot(
        &self,
        q: DVec3,
        near: impl Iterator<Item = usize>,
        color: Option<(&Colors<'_>, [f32; 3])>,
    ) -> Option<Foot> {
        let mut best: Option<Foot> = None;
        let cheapest = |best: &Option<Foot>| best.map_or(f64::INFINITY, |b| b.cost);
        for v in near {
            let least = (self.points[v].distance(q) - self.reach[v]).max(0.0);
            if least * least >= cheapest(&best) {
                continue;
            }
            for f in self.topology.corners.row(v).iter().map(|corner| *corner as usize / 3) {
                let corners = self.faces[f];
                let [a, b, c] = corners.map(|v| self.points[v as usize]);
                // A face without an area has no foot.
                if is_flat(b - a, c - a) {
                    continue;
                }
                let bary = nearest_in_triangle(q, [a, b, c]);
                let error = bary[0] * a + bary[1] * b + bary[2] * c - q;
                let mut foot = Foot { corners, bary, error, cost: error.length_squared(), d_bary: [0.0; 3] };
                if foot.cost.is_nan() || foot.cost >= cheapest(&best) {
                    continue;
                }
                if let Some((colors, wanted)) = color {
                    let (found, slopes) = colors.paint.at(f, bary);
                    let error = found - DVec3::from(wanted.map(f64::from));
                    foot.cost += colors.weight * error.length_squared();
                    foot.d_bary = slopes.map(|s| 2.0 * colors.weight * error.dot(s));
                }
                if foot.cost < cheapest(&best) {
                    best = Some(foot);
                }
            }
        }
        best
    }
}

/// Whether the face of these edges has no area to speak of: the sine of their angle is below 1e-7.
fn is_flat(e: DVec3, f: DVec3) -> bool {
    e.cross(f).length_squared() <= 1e-14 * e.length_squared() * f.length_squared()
}

/// The longest edge at each vertex.
fn reach(points: &[DVec3], faces: &[[u32; 3]]) -> Vec<f64> {
    let mut reach = vec![0.0f64; points.len()];
    for face in faces {
        for (a, b) in [(0, 1), (1, 2), (2, 0)].map(|(i, j)| (face[i] as usize, face[j] as usize)) {
            let length = points[a].distance(points[b]);
            reach[a] = reach[a].max(length);
            reach[b] = reach[b].max(length);
        }
    }
    reach
}

/// Backward of a foot's barycentric coordinates to the corners; `r` is the vector from the foot to the point.
fn foot_backward(at: [DVec3; 3], bary: [f64; 3], r: DVec3, d_bary: [f64; 3]) -> [DVec3; 3] {
    let mut d = [DVec3::ZERO; 3];
    let inside: Vec<usize> = (0..3).filter(|&k| bary[k] > 0.0).collect();
    match inside[..] {
        [i, j] => {
            let edge = at[j] - at[i];
            let w = (d_bary[j] - d_bary[i]) / edge.length_squared();
            d[j] = w * (r - bary[j] * edge);
            d[i] = -w * (r + bary[i] * edge);
        }
        [_, _, _] => {
            let (e, f) = (at[1] - at[0], at[2] - at[0]);
            let (ee, ef, ff) = (e.length_squared(), e.dot(f), f.length_squared());
            let (gu, gv) = (d_bary[1] - d_bary[0], d_bary[2] - d_bary[0]);
            let determinant = ee * ff - ef * ef;
            let (wu, wv) = ((ff * gu - ef * gv) / determinant, (ee * gv - ef * gu) / determinant);
            let along = wu * e + wv * f;
            d[0] = -bary[0] * along - (wu + wv) * r;
            d[1] = wu * r - bary[1] * along;
            d[2] = wv * r - bary[2] * along;
        }
        _ => {}
    }
    d
}

/// Barycentric coordinates of the point of a triangle that is nearest to `q` (Ericson 2005, "Real-Time Collision
/// Detection", 5.1.5), which has an area.
fn nearest_in_triangle(q: DVec3, [a, b, c]: [DVec3; 3]) -> [f64; 3] {
    let (ab, ac) = (b - a, c - a);
    let (d1, d2) = (ab.dot(q - a), ac.dot(q - a));
    let (d3, d4) = (ab.dot(q - b), ac.dot(q - b));
    let (d5, d6) = (ab.dot(q - c), ac.dot(q - c));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let (of_a, of_b, of_c) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    if of_c <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let t = d1 / (d1 - d3);
        return [1.0 - t, t, 0.0];
    }
    if of_b <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let t = d2 / (d2 - d6);
        return [1.0 - t, 0.0, t];
    }
    if of_a <= 0.0 && d4 >= d3 && d5 >= d6 {
        let t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - t, t];
    }
    [of_a, of_b, of_c].map(|v| v / (of_a + of_b + of_c))
}
