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
//! Points may also be held against faces: [`Chamfer::evaluate_faces`].
//!
//! Neighbours come from k-d trees in `f32` about the middle of `Q`: of points equally near to rounding either may be taken,
//! which moves the value by rounding. Distances are then taken in `f64`.

use super::{Point, SurfaceLoss};
use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

/// Queries per parallel block.
pub(super) const BLOCK: usize = 512;

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
    /// There are not as many colours as points.
    #[error("{got} colours of {want} measured points: every point needs one, or none has")]
    Colors {
        /// Colours present.
        got: usize,
        /// Points.
        want: usize,
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
    pub(super) target: Vec<DVec3>,
    pub(super) middle: DVec3,
    tree: Tree,
}

type Tree = ImmutableKdTree<f32, 3>;

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

    /// A surface's vertices, verified and indexed.
    pub(super) fn vertices<P: Point>(&self, points: &[P]) -> Result<(Vec<DVec3>, Tree), ChamferError> {
        const WHAT: &str = "vertices";
        let points: Vec<DVec3> = points.iter().map(|p| p.wide()).collect();
        check(&points, WHAT)?;
        let tree = index(&points, self.middle, WHAT)?;
        Ok((points, tree))
    }

    /// `along` gives of a vertex and its distance `e` the vector `M e` of the loss `eᵀ M e`.
    fn evaluate_along<P: Point>(
        &self,
        points: &[P],
        along: impl Fn(usize, DVec3) -> DVec3,
    ) -> Result<SurfaceLoss, ChamferError> {
        let (points, moving) = self.vertices(points)?;
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

pub(super) fn local(point: DVec3, middle: DVec3) -> [f32; 3] {
    (point - middle).as_vec3().to_array()
}

fn index(points: &[DVec3], middle: DVec3, what: &'static str) -> Result<Tree, ChamferError> {
    let flat: Vec<[f32; 3]> = points.iter().map(|p| local(*p, middle)).collect();
    ImmutableKdTree::new_from_slice(&flat).map_err(|e| ChamferError::Tree { what, why: format!("{e:?}") })
}

/// Row of the nearest indexed point, for each query.
fn nearest(tree: &Tree, queries: &[DVec3], middle: DVec3) -> Vec<u32> {
    let mut out = vec![0; queries.len()];
    out.par_chunks_mut(BLOCK).zip(queries.par_chunks(BLOCK)).for_each(|(out, queries)| {
        for (row, query) in out.iter_mut().zip(queries) {
            *row = tree.query(&local(*query, middle)).nearest_one::<SquaredEuclidean<f32>>().execute().item;
        }
    });
    out
}
