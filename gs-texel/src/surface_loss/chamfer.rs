//! Mean squared distance to the nearest point, both ways:
//!
//! ```text
//! L = (1/N) Σ_p min_q |p − q|² + (1/|Q|) Σ_q min_p |q − p|²                                   (squared metres)
//! g_p = (2/N)(p − q_near(p)) + (2/|Q|) Σ_{q whose nearest is p} (p − q)
//! ```
//! Vertices are neither as many nor as even as points, so these distances also push vertices along the surface to where there
//! are few of them. With unit normals `n` held still, the part along the surface may count less, by `s` from 0 to 1
//! (0: distances to planes, Chen and Medioni 1992):
//! ```text
//! |e|²  becomes  (n·e)² + s |e − n (n·e)|²        e = p − q
//! ```
//! Between vertices a surface is its faces, so points may also be held against these ([`Chamfer::evaluate_faces`]), which
//! nothing pulls off a surface that the points lie on:
//! ```text
//! L = (1/|Q|) Σ_q |q − c|²     g_k = (2/|Q|) Σ_q b_k (c − q)     c = Σ b_k p_k, the nearest of the faces at q's nearest vertex
//! ```
//! Neighbours come from k-d trees in `f32` about the middle of `Q`: of points equally near to rounding either may be taken,
//! which moves the value by rounding. Distances are then taken in `f64`.

use super::{Point, SurfaceLoss};
use crate::surface::Topology;
use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

/// Queries per parallel block.
const BLOCK: usize = 512;

/// Points that no Chamfer distance can be taken of.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ChamferError {
    /// There are none.
    #[error("the {0} have no points, so nothing is nearest to anything; leave the Chamfer term out of this frame")]
    Empty(&'static str),
    /// A coordinate is NaN or infinite.
    #[error("row {row} of the {what} is not finite; repair or drop it")]
    NotFinite {
        /// Which points.
        what: &'static str,
        /// The first such row.
        row: usize,
    },
    /// No tree can be built (too many points in one place).
    #[error("the {what} cannot be indexed: {why}; thin out points that coincide")]
    Tree {
        /// Which points.
        what: &'static str,
        /// The index's own words.
        why: String,
    },
}

/// The measured points `Q` of a frame, indexed once.
pub struct Chamfer {
    target: Vec<DVec3>,
    middle: DVec3,
    tree: ImmutableKdTree<f32, 3>,
}

impl Chamfer {
    /// Indexes the measured points.
    ///
    /// # Errors
    /// If there are none, one is not finite, or too many lie in one place.
    pub fn new<P: Point>(target: &[P]) -> Result<Self, ChamferError> {
        const WHAT: &str = "measured points";
        let target: Vec<DVec3> = target.iter().map(|q| q.wide()).collect();
        check(&target, WHAT)?;
        let middle = target.iter().sum::<DVec3>() / target.len() as f64;
        let tree = index(&target, middle, WHAT)?;
        Ok(Self { target, middle, tree })
    }

    /// The loss of world positions `P`, and its gradient with respect to them.
    ///
    /// # Errors
    /// As [`Chamfer::new`], for the vertices.
    pub fn evaluate<P: Point>(&self, points: &[P]) -> Result<SurfaceLoss, ChamferError> {
        self.evaluate_along(points, |_, away| away)
    }

    /// The same, where distances along the surface count `slide` times as much as those along its unit normals; a vertex
    /// without a normal counts `slide` in all directions.
    ///
    /// # Errors
    /// As [`Chamfer::evaluate`].
    pub fn evaluate_sliding<P: Point>(
        &self,
        points: &[P],
        normals: &[P],
        slide: f64,
    ) -> Result<SurfaceLoss, ChamferError> {
        let along = |i: usize, away: DVec3| {
            let n = normals.get(i).map_or(DVec3::ZERO, |n| n.wide());
            (1.0 - slide) * n.dot(away) * n + slide * away
        };
        self.evaluate_along(points, along)
    }

    /// The mean squared distance of the measured points to the faces of a surface: to the nearest of those at the vertex that
    /// is nearest. `topology` is that of `faces`.
    ///
    /// # Errors
    /// As [`Chamfer::evaluate`].
    pub fn evaluate_faces<P: Point>(
        &self,
        points: &[P],
        faces: &[[u32; 3]],
        topology: &Topology,
    ) -> Result<SurfaceLoss, ChamferError> {
        const WHAT: &str = "vertices";
        let points: Vec<DVec3> = points.iter().map(|p| p.wide()).collect();
        check(&points, WHAT)?;
        let moving = index(&points, self.middle, WHAT)?;
        let mut loss = SurfaceLoss::none(points.len());
        let share = 1.0 / self.target.len() as f64;
        for (&q, i) in self.target.iter().zip(nearest(&moving, &self.target, self.middle)) {
            let mut best = ([i; 3], [1.0, 0.0, 0.0], points[i as usize] - q);
            for &corner in topology.corners.row(i as usize) {
                let face = faces[corner as usize / 3];
                let corners = face.map(|v| points[v as usize]);
                let bary = nearest_in_triangle(q, corners);
                let away = (0..3).map(|k| bary[k] * corners[k]).sum::<DVec3>() - q;
                // False where a face has no area.
                if away.length_squared() < best.2.length_squared() {
                    best = (face, bary, away);
                }
            }
            let (face, bary, away) = best;
            loss.value += share * away.length_squared();
            (0..3).for_each(|k| loss.grad[face[k] as usize] += 2.0 * share * bary[k] * away);
        }
        Ok(loss)
    }

    /// `along` gives of a vertex and its distance `e` the vector `M e` of the loss `eᵀ M e`.
    fn evaluate_along<P: Point>(
        &self,
        points: &[P],
        along: impl Fn(usize, DVec3) -> DVec3,
    ) -> Result<SurfaceLoss, ChamferError> {
        const WHAT: &str = "vertices";
        let points: Vec<DVec3> = points.iter().map(|p| p.wide()).collect();
        check(&points, WHAT)?;
        let moving = index(&points, self.middle, WHAT)?;
        let mut loss = SurfaceLoss::none(points.len());
        let share = 1.0 / points.len() as f64;
        for (i, q) in nearest(&self.tree, &points, self.middle).into_iter().enumerate() {
            let away = points[i] - self.target[q as usize];
            let counts = along(i, away);
            loss.value += share * away.dot(counts);
            loss.grad[i] += 2.0 * share * counts;
        }
        let share = 1.0 / self.target.len() as f64;
        for (q, i) in nearest(&moving, &self.target, self.middle).into_iter().enumerate() {
            let away = points[i as usize] - self.target[q];
            let counts = along(i as usize, away);
            loss.value += share * away.dot(counts);
            loss.grad[i as usize] += 2.0 * share * counts;
        }
        Ok(loss)
    }
}

fn check(points: &[DVec3], what: &'static str) -> Result<(), ChamferError> {
    if points.is_empty() {
        return Err(ChamferError::Empty(what));
    }
    points.iter().position(|p| !p.is_finite()).map_or(Ok(()), |row| Err(ChamferError::NotFinite { what, row }))
}

fn local(point: DVec3, middle: DVec3) -> [f32; 3] {
    (point - middle).as_vec3().to_array()
}

fn index(points: &[DVec3], middle: DVec3, what: &'static str) -> Result<ImmutableKdTree<f32, 3>, ChamferError> {
    let flat: Vec<[f32; 3]> = points.iter().map(|p| local(*p, middle)).collect();
    ImmutableKdTree::new_from_slice(&flat).map_err(|e| ChamferError::Tree { what, why: format!("{e:?}") })
}

/// Row of the nearest indexed point, for each query.
fn nearest(tree: &ImmutableKdTree<f32, 3>, queries: &[DVec3], middle: DVec3) -> Vec<u32> {
    let mut out = vec![0; queries.len()];
    out.par_chunks_mut(BLOCK).zip(queries.par_chunks(BLOCK)).for_each(|(out, queries)| {
        for (row, query) in out.iter_mut().zip(queries) {
            *row = tree.query(&local(*query, middle)).nearest_one::<SquaredEuclidean<f32>>().execute().item;
        }
    });
    out
}

/// Barycentric coordinates of the point of a triangle that is nearest to `q` (Ericson 2005, "Real-Time Collision
/// Detection", 5.1.5). Not numbers where it has no area.
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
