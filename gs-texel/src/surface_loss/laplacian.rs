//! Squared distance of each vertex from the mean of its neighbours:
//!
//! ```text
//! L = (1/3N) Σ_i |δ_i|²      δ_i = (1/|N_i|) Σ_{j∈N_i} p_j − p_i
//! g_i = (2/3N) ( Σ_{j∈N_i} δ_j/|N_j| − δ_i )
//! ```

use super::{Point, SurfaceLoss};
use crate::surface::Topology;
use glam::DVec3;

/// The Laplacian loss of world positions, and its gradient. Vertices without neighbours do not contribute.
pub fn laplacian<P: Point>(points: &[P], topology: &Topology) -> SurfaceLoss {
    let mut loss = SurfaceLoss::none(points.len());
    let share = 1.0 / (3 * points.len().max(1)) as f64;
    for (i, p) in points.iter().enumerate() {
        let near = topology.ring.row(i);
        if near.is_empty() {
            continue;
        }
        let each = 1.0 / near.len() as f64;
        let delta = near.iter().map(|&j| points[j as usize].wide()).sum::<DVec3>() * each - p.wide();
        loss.value += share * delta.length_squared();
        let d_delta = 2.0 * share * delta;
        loss.grad[i] -= d_delta;
        near.iter().for_each(|&j| loss.grad[j as usize] += d_delta * each);
    }
    loss
}
