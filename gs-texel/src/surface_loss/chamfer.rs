//! Mean squared distance to the nearest point, both ways:
//!
//! ```text
//! L = (1/N) Σ_p min_q |p − q|² + (1/|Q|) Σ_q min_p |q − p|²                                   (squared metres)
//! g_p = (2/N)(p − q_near(p)) + (2/|Q|) Σ_{q whose nearest is p} (p − q)
//! ```
//! Vertices differ from points in number and density, so these distances also move vertices along the surface to where there
//! are few of them. With constant unit normals `n`, the tangential part may be weighted by `s` from 0 to 1 (0: distances to
//! planes, Chen and Medioni 1992):
//! ```text
//! |e|²  becomes  (n·e)² + s |e − n (n·e)|²        e = p − q
//! ```
//! Distances from points to faces instead of vertices: [`Chamfer::evaluate_faces`].
//!
//! Neighbours come from k-d trees in `f32` relative to the centroid of `Q`; ties within `f32` rounding are broken either way.
//! Distances are then computed in `f64`.

use super::{Point, SurfaceLoss};
use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

/// Queries per parallel block.
pub(super) const BLOCK: usize = 512;

/// Inputs without a Chamfer distance.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ChamferError {
    /// A set of points is empty.
    #[error("the {0} have no points, so nothing is nearest to anything; leave the Chamfer term out of this frame")]
    Empty(&'static str),
    /// A coordinate is NaN or infinite.
    #[error("row {row} of the {what} is not finite; repair or drop it")]
    NotFinite {
        /// Name of the set: measured points or vertices.
        what: &'static str,
        /// First row that is not finite.
        row: usize,
    },
    /// The numbers of colours and measured points differ.
    #[error("{got} colours of {want} measured points: every point needs one, or none has")]
    Colors {
        /// Number of colours given.
        got: usize,
        /// Number of measured points given.
        want: usize,
    },
    /// No tree can be built (too many points in one place).
    #[error("the {what} cannot be indexed: {why}; thin out points that coincide")]
    Tree {
        /// Name of the set: measured points or vertices.
        what: &'static str,
        /// Message of the k-d tree.
        why: String,
    },
}

/// The measured points `Q` of a frame, indexed for nearest-neighbour queries.
pub struct Chamfer {
    pub(super) target: Vec<DVec3>,
    pub(super) centroid: DVec3,
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
        let centroid = target.iter().sum::<DVec3>() / target.len() as f64;
        let tree = index(&target, centroid, WHAT)?;
        Ok(Self { target, centroid, tree })
    }

    /// The loss of world positions `P` of vertices, and its gradient by them.
    ///
    /// # Errors
    /// As [`Chamfer::new`], for the vertices.
    pub fn evaluate<P: Point>(&self, points: &[P]) -> Result<SurfaceLoss, ChamferError> {
        self.evaluate_along(points, |_, error| error)
    }

    /// [`Chamfer::evaluate`] with weight `slide`, 0 to 1, on the tangential part of distances and 1 on the part along the unit
    /// normals. Vertices without a normal have weight `slide` in all directions.
    ///
    /// # Errors
    /// As [`Chamfer::evaluate`].
    pub fn evaluate_anisotropic<P: Point>(
        &self,
        points: &[P],
        normals: &[P],
        slide: f64,
    ) -> Result<SurfaceLoss, ChamferError> {
        let along = |i: usize, error: DVec3| {
            let n = normals.get(i).map_or(DVec3::ZERO, |n| n.wide());
            (1.0 - slide) * n.dot(error) * n + slide * error
        };
        self.evaluate_along(points, along)
    }

    /// The vertices of a surface, checked and indexed.
    pub(super) fn vertices<P: Point>(&self, points: &[P]) -> Result<(Vec<DVec3>, Tree), ChamferError> {
        const WHAT: &str = "vertices";
        let points: Vec<DVec3> = points.iter().map(|p| p.wide()).collect();
        check(&points, WHAT)?;
        let tree = index(&points, self.centroid, WHAT)?;
        Ok((points, tree))
    }

    /// `along` maps a vertex and its distance vector `e` to `M e` of the loss `eᵀ M e`.
    fn evaluate_along<P: Point>(
        &self,
        points: &[P],
        along: impl Fn(usize, DVec3) -> DVec3,
    ) -> Result<SurfaceLoss, ChamferError> {
        let (points, moving) = self.vertices(points)?;
        let mut loss = SurfaceLoss::none(points.len());
        let share = 1.0 / points.len() as f64;
        for (i, q) in nearest(&self.tree, &points, self.centroid).into_iter().enumerate() {
            let error = points[i] - self.target[q as usize];
            let weighted = along(i, error);
            loss.value += share * error.dot(weighted);
            loss.grad[i] += 2.0 * share * weighted;
        }
        let share = 1.0 / self.target.len() as f64;
        for (q, i) in nearest(&moving, &self.target, self.centroid).into_iter().enumerate() {
            let error = points[i as usize] - self.target[q];
            let weighted = along(i as usize, error);
            loss.value += share * error.dot(weighted);
            loss.grad[i as usize] += 2.0 * share * weighted;
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

pub(super) fn local(point: DVec3, centroid: DVec3) -> [f32; 3] {
    (point - centroid).as_vec3().to_array()
}

fn index(points: &[DVec3], centroid: DVec3, what: &'static str) -> Result<Tree, ChamferError> {
    let flat: Vec<[f32; 3]> = points.iter().map(|p| local(*p, centroid)).collect();
    ImmutableKdTree::new_from_slice(&flat).map_err(|e| ChamferError::Tree { what, why: format!("{e:?}") })
}

/// Row of the nearest indexed point, for each query.
fn nearest(tree: &Tree, queries: &[DVec3], centroid: DVec3) -> Vec<u32> {
    let mut out = vec![0; queries.len()];
    out.par_chunks_mut(BLOCK).zip(queries.par_chunks(BLOCK)).for_each(|(out, queries)| {
        for (row, query) in out.iter_mut().zip(queries) {
            *row = tree.query(&local(*query, centroid)).nearest_one::<SquaredEuclidean<f32>>().execute().item;
        }
    });
    out
}
