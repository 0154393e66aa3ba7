//! What a posed, deformed surface should look like, as losses with gradients: near the points that were measured
//! ([`Chamfer`]), smooth ([`laplacian`]), of the lengths of the template ([`Isometry`]), without creases
//! ([`NormalConsistency`]).
//!
//! ```text
//! L_geo = L_cham + λ_lap L_lap + λ_iso L_iso + λ_nc L_nc
//! ```
//! (DUT, supplement.) Chamfer and Laplacian look at world positions, the other two at the deformed bind pose.
//!
//! Positions may be `f32` or `f64`; everything is worked out in `f64`, in the order of the tables, so results are the same
//! bits for any number of threads. Meshes have some ten thousand vertices: beside a network step this costs nothing.
//! Positions must be finite, and numbers of vertices in range.

mod chamfer;
mod faces;
mod isometry;
mod laplacian;
mod normals;

pub use chamfer::{Chamfer, ChamferError};
pub use faces::{Colors, NEIGHBOURS, Paint};
pub use isometry::{Isometry, IsometryRule};
pub use laplacian::laplacian;
pub use normals::{NormalConsistency, NormalRule};

use glam::{DVec3, Vec3};

/// Twice the area of a triangle below which it has no normal and no say, square metres.
pub const DEGENERATE: f64 = 1e-12;

/// A position of either precision.
pub trait Point: Copy + Send + Sync {
    /// The same in `f64`.
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

/// A loss and what it asks of each vertex.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct SurfaceLoss {
    /// The value.
    pub value: f64,
    /// `dL/d` position, one row per vertex.
    pub grad: Vec<DVec3>,
}

impl SurfaceLoss {
    fn none(vertices: usize) -> Self {
        Self { value: 0.0, grad: vec![DVec3::ZERO; vertices] }
    }

    /// Adds `weight` times another loss of the same vertices.
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

/// Pulls the cotangent of [`area_normal`] back to the corners.
fn area_normal_backward<P: Point>(points: &[P], face: [u32; 3], d: DVec3, grad: &mut [DVec3]) {
    let [a, b, c] = face.map(|v| points[v as usize].wide());
    let (at_b, at_c) = ((c - a).cross(d), d.cross(b - a));
    grad[face[0] as usize] -= at_b + at_c;
    grad[face[1] as usize] += at_b;
    grad[face[2] as usize] += at_c;
}

/// Share of each edge in a mean over vertices of means over their edges: `(1/|N_a| + 1/|N_b|)/N`, `N` the vertices that have
/// edges.
fn ring_shares(edges: &[[u32; 2]]) -> Vec<f64> {
    let count = edges.iter().flatten().max().map_or(0, |v| *v as usize + 1);
    let mut valence = vec![0u32; count];
    edges.iter().flatten().for_each(|&v| valence[v as usize] += 1);
    let touched = valence.iter().filter(|v| **v > 0).count() as f64;
    let share = |[a, b]: &[u32; 2]| [a, b].map(|v| 1.0 / f64::from(valence[*v as usize])).iter().sum::<f64>() / touched;
    edges.iter().map(share).collect()
}
