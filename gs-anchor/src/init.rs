//! Initial anchors from points (Scaffold-GS, Lu et al. 2024, section 3.2.1, and its reference code).
//!
//! ```text
//! points   every stride-th
//! ε        as given, or, if it is 0 or less, the median over the points of d²   (a squared distance, as published)
//! anchors  cell · ε for every different cell = round_half_even(p / ε), ordered by x, y, z
//! λ        ln √max(d², 1e-7) on all six axes, d² = mean squared distance to the 3 nearest other anchors
//! ```
//! Offsets, features and logits of motion are zero. With fewer than 4 anchors d² is ε².
//!
//! ```
//! use gs_anchor::{AnchorInit, AnchorShape, anchors_from_points};
//! use glam::Vec3;
//!
//! let shape = AnchorShape { offsets: 10, features: 32, dynamics: 0 };
//! let points = [Vec3::new(0.9, 0.0, 0.0), Vec3::new(1.1, 0.1, 0.0), Vec3::new(3.2, 0.0, 0.0)];
//! let made = anchors_from_points(&points, shape, &AnchorInit { voxel: 1.0, ..AnchorInit::default() })?;
//! assert_eq!(made.anchors.positions.value, [1.0, 0.0, 0.0, 3.0, 0.0, 0.0], "two points share a cell");
//! # Ok::<(), gs_anchor::InitError>(())
//! ```

use crate::anchors::{AnchorShape, Anchors};
use crate::lattice::{Cell, cell_of, position_of};
use glam::Vec3;
use gs_core::neighbours::{NeighbourError, mean_squared_distances};
use serde::{Deserialize, Serialize};

/// Lower limit of squared neighbour distances, world units².
const MIN_SQUARED_DISTANCE: f32 = 1e-7;
/// Number of anchors that have three neighbours each.
const MIN_ANCHORS: usize = 4;

/// Settings of the initial anchors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnchorInit {
    /// Side of the cells, ε, world units (published: 0.01); 0 or less: the median rule.
    pub voxel: f32,
    /// Every `stride`-th point is used, at least 1 (published: 1).
    pub stride: u32,
    /// Largest number of initial anchors; more are an error.
    pub max_anchors: u32,
}

impl Default for AnchorInit {
    fn default() -> Self {
        Self { voxel: 0.01, stride: 1, max_anchors: 1_000_000 }
    }
}

/// Anchors made of points, and the size of their cells.
#[derive(Clone, Debug, PartialEq)]
pub struct InitialAnchors {
    /// One anchor per occupied cell, ordered by x, y, z.
    pub anchors: Anchors,
    /// Side ε of the cells, world units; [`AnchorDensifyStep::voxel`](crate::AnchorDensifyStep::voxel) must be the same, also after a
    /// resume.
    pub voxel: f32,
}

/// Points that no anchors can be made of.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum InitError {
    /// The list of points is empty.
    #[error("there is no point to make anchors of; give the data a point cloud, or use random points")]
    NoPoints,
    /// [`AnchorInit::stride`] is 0.
    #[error("`stride` = 0: at least 1")]
    Stride,
    /// A coordinate is not finite.
    #[error("point {row} is {point}; remove points that are not finite")]
    NotFinite {
        /// Index of the point in the input.
        row: usize,
        /// Coordinates of the point, world units.
        point: Vec3,
    },
    /// The median rule gives a side of zero or one that is not finite, world units.
    #[error("the median rule gives cells of side {0}; more than half of the points coincide: set `voxel`, world units")]
    Median(f32),
    /// [`AnchorInit::voxel`] is not finite.
    #[error("`voxel` = {0}: a finite side, world units (0: the median rule)")]
    Voxel(f32),
    /// A point is too far from the origin for cells of this size.
    #[error(
        "point {row}, {point}, is more than 2^22 cells of side {voxel} from the origin; make `voxel` larger, or move or remove the point"
    )]
    TooFar {
        /// Index of the point in the input.
        row: usize,
        /// Coordinates of the point, world units.
        point: Vec3,
        /// Side ε of the cells, world units.
        voxel: f32,
    },
    /// More anchors than [`AnchorInit::max_anchors`].
    #[error(
        "{anchors} anchors with cells of side {voxel}, at most {cap} are allowed; make `voxel` or `stride` larger, or raise `max_anchors`"
    )]
    TooMany {
        /// Anchors the points would give.
        anchors: usize,
        /// Side ε of the cells, world units.
        voxel: f32,
        /// Most anchors there may be, [`AnchorInit::max_anchors`].
        cap: u32,
    },
    /// No k-d tree can be built of the points.
    #[error(transparent)]
    Neighbours(#[from] NeighbourError),
}

/// Makes anchors of the given shape from points, world units.
///
/// # Errors
/// No points, points that are not finite or too far away for the cells, cells of no size, too many anchors.
pub fn anchors_from_points(
    points: &[Vec3],
    shape: AnchorShape,
    init: &AnchorInit,
) -> Result<InitialAnchors, InitError> {
    if init.stride == 0 {
        return Err(InitError::Stride);
    }
    if let Some(row) = points.iter().position(|p| !p.is_finite()) {
        return Err(InitError::NotFinite { row, point: points[row] });
    }
    let stride = init.stride as usize;
    let used: Vec<Vec3> = points.iter().copied().step_by(stride).collect();
    if used.is_empty() {
        return Err(InitError::NoPoints);
    }
    let voxel = voxel_of(&used, init.voxel)?;
    let cell = |(row, &point): (usize, &Vec3)| {
        cell_of(point, voxel).ok_or(InitError::TooFar { row: row * stride, point, voxel })
    };
    let mut cells = used.iter().enumerate().map(cell).collect::<Result<Vec<Cell>, _>>()?;
    cells.sort_unstable();
    cells.dedup();
    if cells.len() > init.max_anchors as usize {
        return Err(InitError::TooMany { anchors: cells.len(), voxel, cap: init.max_anchors });
    }
    let positions: Vec<Vec3> = cells.into_iter().map(|c| position_of(c, voxel.into())).collect();
    let log_scales = log_scales(&positions, voxel)?;
    Ok(InitialAnchors { anchors: Anchors::new(shape, &positions, &log_scales), voxel })
}

fn voxel_of(points: &[Vec3], wanted: f32) -> Result<f32, InitError> {
    if !wanted.is_finite() {
        return Err(InitError::Voxel(wanted));
    }
    if wanted > 0.0 {
        return Ok(wanted);
    }
    let mut distances = mean_squared_distances(points)?;
    // The ⌊n/2⌋-th smallest, counted from 1; of a single point the only one.
    let middle = (distances.len() / 2).max(1) - 1;
    let median = *distances.select_nth_unstable_by(middle, f32::total_cmp).1;
    if median > 0.0 && median.is_finite() { Ok(median) } else { Err(InitError::Median(median)) }
}

fn log_scales(positions: &[Vec3], voxel: f32) -> Result<Vec<f32>, InitError> {
    let squared = if positions.len() < MIN_ANCHORS {
        vec![voxel * voxel; positions.len()]
    } else {
        mean_squared_distances(positions)?
    };
    // Huge scenes square beyond f32: half of the logarithm is taken of the largest finite square then.
    Ok(squared.into_iter().map(|d| 0.5 * d.clamp(MIN_SQUARED_DISTANCE, f32::MAX).ln()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Params as _;

    const SHAPE: AnchorShape = AnchorShape { offsets: 2, features: 4, dynamics: 2 };

    fn init(voxel: f32) -> AnchorInit {
        AnchorInit { voxel, ..AnchorInit::default() }
    }

    fn grid(n: i32, spacing: f32) -> Vec<Vec3> {
        let at = |i: i32| Vec3::new((i % n) as f32, (i / n % n) as f32, (i / n / n) as f32) * spacing;
        (0..n * n * n).map(at).collect()
    }

    #[test]
    fn points_of_one_cell_are_one_anchor() {
        let mut points = grid(4, 0.5);
        points.extend(grid(4, 0.5).iter().map(|p| *p + Vec3::splat(0.1)));
        let got = anchors_from_points(&points, SHAPE, &init(0.5)).unwrap();
        assert_eq!((got.anchors.len(), got.voxel), (64, 0.5));
        assert_eq!(got.anchors.position(0), Vec3::ZERO);
        assert_eq!(got.anchors.position(1), Vec3::new(0.0, 0.0, 0.5), "ordered by x, y, z");
        // Every lattice point has three neighbours one cell away.
        assert!(got.anchors.log_scales.value.iter().all(|l| (l - 0.5f32.ln()).abs() < 1e-6));
        for block in [&got.anchors.offsets, &got.anchors.features, got.anchors.dynamics.as_ref().unwrap()] {
            assert!(block.value.iter().all(|v| *v == 0.0), "{}", block.name);
        }
        assert_eq!(got.anchors.param_count(), 64 * (3 + 6 + 4 + 6 + 2));
    }

    #[test]
    fn stride_takes_every_second_point() {
        let points: Vec<Vec3> = (0..11).map(|i| Vec3::X * i as f32).collect();
        let got = anchors_from_points(&points, SHAPE, &AnchorInit { stride: 2, ..init(1.0) }).unwrap();
        assert_eq!((got.anchors.len(), got.anchors.position(1).x), (6, 2.0));
    }

    #[test]
    fn the_median_rule_takes_the_lower_middle_of_squared_distances() {
        // Distances to three neighbours are (1, 4, 9), (1, 1, 4), (1, 1, 4), (1, 4, 9) over 3.
        let points: Vec<Vec3> = (0..4).map(|i| Vec3::X * i as f32).collect();
        assert_eq!(anchors_from_points(&points, SHAPE, &init(0.0)).unwrap().voxel, 2.0);
        assert_eq!(anchors_from_points(&points, SHAPE, &init(-1.0)).unwrap().voxel, 2.0);
        assert_eq!(anchors_from_points(&points[..1], SHAPE, &init(0.0)).unwrap().voxel, 1.0);
        assert_eq!(anchors_from_points(&[Vec3::ONE; 9], SHAPE, &init(0.0)), Err(InitError::Median(0.0)));
    }

    #[test]
    fn few_anchors_are_as_large_as_a_cell() {
        for n in 1..4 {
            let points: Vec<Vec3> = (0..n).map(|i| Vec3::X * i as f32).collect();
            let got = anchors_from_points(&points, SHAPE, &init(0.25)).unwrap();
            assert!(got.anchors.log_scales.value.iter().all(|l| (l - 0.25f32.ln()).abs() < 1e-6));
        }
        let tiny = anchors_from_points(&[Vec3::ZERO], SHAPE, &init(1e-6)).unwrap();
        assert!((tiny.anchors.log_scales.value[0] - 0.5 * 1e-7f32.ln()).abs() < 1e-5);
    }

    #[test]
    fn what_cannot_be_anchors_is_refused_by_name() {
        let refuse = |points: &[Vec3], init: AnchorInit| anchors_from_points(points, SHAPE, &init).unwrap_err();
        assert_eq!(refuse(&[], init(0.1)), InitError::NoPoints);
        assert!(matches!(refuse(&[Vec3::ZERO, Vec3::NAN], init(0.1)), InitError::NotFinite { row: 1, .. }));
        assert!(matches!(refuse(&[Vec3::ZERO, Vec3::X * 1e6], init(1e-3)), InitError::TooFar { row: 1, .. }));
        assert_eq!(refuse(&[Vec3::ZERO], AnchorInit { stride: 0, ..init(0.1) }), InitError::Stride);
        assert!(matches!(refuse(&[Vec3::ZERO], init(f32::NAN)), InitError::Voxel(_)));
        let cap = AnchorInit { max_anchors: 26, ..init(1.0) };
        assert_eq!(refuse(&grid(3, 1.0), cap), InitError::TooMany { anchors: 27, voxel: 1.0, cap: 26 });
    }

    #[test]
    fn scenes_of_any_size_have_finite_scales() {
        for size in [1e-4f32, 1.0, 1e18] {
            let got = anchors_from_points(&grid(3, size), SHAPE, &init(size)).unwrap();
            assert_eq!(got.anchors.len(), 27);
            assert!(got.anchors.log_scales.value.iter().all(|l| l.is_finite()), "{size}");
        }
    }
}
