//! Loss terms of a posed, deformed surface, with gradients: distance to measured points ([`Chamfer`]), smoothness
//! ([`laplacian`]), edge lengths of the template ([`Isometry`]), and similar neighbouring normals ([`NormalConsistency`]).
//!
//! ```text
//! L_geo = L_cham + λ_lap L_lap + λ_iso L_iso + λ_nc L_nc
//! ```
//! (DUT, supplement.) Chamfer and Laplacian take world positions, the other two the deformed bind pose.
//!
//! Positions may be `f32` or `f64`; sums are in `f64` and in the order of the tables, so results are the same bits for any
//! number of threads. Positions must be finite, and vertex rows in range.
//!
//! ```
//! use glam::DVec3;
//! use gs_texel::surface_loss::Chamfer;
//!
//! let points = [DVec3::ZERO, DVec3::X, DVec3::Y];
//! // A shift by 0.1 along z: 0.01 from the vertices to the points and 0.01 back.
//! let loss = Chamfer::new(&points.map(|p| p + 0.1 * DVec3::Z))?.evaluate(&points)?;
//! assert!((loss.value - 0.02).abs() < 1e-15);
//! assert!((loss.grad[0] + 4.0 / 3.0 * 0.1 * DVec3::Z).length() < 1e-15);
//! # Ok::<(), gs_texel::surface_loss::ChamferError>(())
//! ```

mod chamfer;
mod faces;
mod isometry;
mod laplacian;
mod normals;

pub use chamfer::{Chamfer, ChamferError};
pub use faces::{Colors, SurfaceColors};
pub use isometry::{Isometry, IsometryRule};
pub use laplacian::laplacian;
pub use normals::{NormalConsistency, NormalRule};

use glam::{DVec3, Vec3};

/// Triangles of less than half this area have no normal and no weight, square metres.
const MIN_DOUBLE_AREA: f64 = 1e-12;

/// A position in `f32` ([`Vec3`]) or `f64` ([`DVec3`]).
pub trait Point: Copy + Send + Sync {
    /// The position in `f64`.
    fn wide(self) -> DVec3;
}

impl Point for Vec3 {
    fn wide(self) -> DVec3 {
        self.as_dvec3()
    }
}

impl Point for DVec3 {
    fn wide(self) -> DVec3 {
        self
    }
}

/// A loss and its gradient by vertex positions.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct SurfaceLoss {
    /// Value of the loss, in the units of its equation.
    pub value: f64,
    /// Gradient by positions, one row per vertex.
    pub grad: Vec<DVec3>,
}

impl SurfaceLoss {
    fn none(vertices: usize) -> Self {
        Self { value: 0.0, grad: vec![DVec3::ZERO; vertices] }
    }

    /// Adds `weight` times another loss of the same vertices, gradient included.
    pub fn add(&mut self, weight: f64, other: &Self) {
        self.value += weight * other.value;
        self.grad.iter_mut().zip(&other.grad).for_each(|(a, b)| *a += weight * *b);
    }
}

/// `(b − a) × (c − a)` of a face: its normal times twice its area.
fn area_normal<P: Point>(points: &[P], face: [u32; 3]) -> DVec3 {
    let [a, b, c] = face.map(|v| points[v as usize].wide());
    (b - a).cross(c - a)
}

/// Backward of [`area_normal`] to the corners; adds to `grad`.
fn area_normal_backward<P: Point>(points: &[P], face: [u32; 3], d: DVec3, grad: &mut [DVec3]) {
    let [a, b, c] = face.map(|v| points[v as usize].wide());
    let (at_b, at_c) = ((c - a).cross(d), d.cross(b - a));
    grad[face[0] as usize] -= at_b + at_c;
    grad[face[1] as usize] += at_b;
    grad[face[2] as usize] += at_c;
}

/// Weight of each edge in a mean over vertices of means over their edges: `(1/|N_a| + 1/|N_b|)/N`, `N` the vertices that have
/// edges.
fn ring_shares(edges: &[[u32; 2]]) -> Vec<f64> {
    let count = edges.iter().flatten().max().map_or(0, |v| *v as usize + 1);
    let mut valence = vec![0u32; count];
    edges.iter().flatten().for_each(|&v| valence[v as usize] += 1);
    let touched = valence.iter().filter(|v| **v > 0).count() as f64;
    let share = |[a, b]: &[u32; 2]| [a, b].map(|v| 1.0 / f64::from(valence[*v as usize])).iter().sum::<f64>() / touched;
    edges.iter().map(share).collect()
}
