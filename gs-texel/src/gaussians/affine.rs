//! The covariance of a Gaussian under the full matrix `R`, factored into rotation and standard deviations again:
//!
//! ```text
//! M = R Rot(r̂) diag(s) = U diag(σ) Vᵀ        Σ = M Mᵀ = U diag(σ²) Uᵀ
//! ```
//! by one-sided Jacobi rotations of the columns of `M`, which keep small standard deviations as accurate as large ones, and
//! leave the axes unchanged if `R` is rigid. Backward, with `Ω` an infinitesimal rotation of `U` about its own axes:
//! ```text
//! G' = Uᵀ g_Σ U:  G'_ii = g_σi/(2σ_i),   G'_ij = g_Ωij/(2 (σ_j² − σ_i²))        g_M = 2 U G' diag(σ) Vᵀ
//! ```
//! Where two standard deviations are nearly equal, the cotangents of rotation and scales do not determine the gradient of a
//! shear of their plane; that part is set to zero. Everything is `f64`.

use super::row::Number;
use crate::skin::quat_of;
use glam::{DMat3, DVec3};
use gs_core::{covariance, rot};

/// Jacobi sweeps; three columns need about four.
const MAX_SWEEPS: usize = 12;
/// Cosine below which columns count as orthogonal.
const ORTHOGONAL: f64 = 1e-15;
/// The same for columns of nearly equal length: a rigid matrix in `f32` is orthogonal to this, and any rotation of such
/// columns would do.
const ORTHOGONAL_IF_EQUAL: f64 = 1e-6;
/// Columns shorter than this share of the longest count as zero.
const MIN_RATIO: f64 = 1e-12;
/// Relative difference below which squared standard deviations count as equal.
const EQUAL_TOLERANCE: f64 = 1e-5;

/// The axes of a Gaussian after skinning, with what backward needs.
pub(super) struct Axes {
    linear: DMat3,
    unit: [f64; 4],
    before: [f64; 3],
    /// `U`, a rotation.
    axes: DMat3,
    /// `σ`.
    after: [f64; 3],
    /// `V`.
    mixing: DMat3,
}

impl Axes {
    /// Takes the linear part `R` (rows), the quaternion `r̂` (used through [`rot::matrix`], also if not of unit length) and the
    /// standard deviations before skinning.
    pub(super) fn of<T: Number>(linear: &rot::Mat3<T>, unit: [T; 4], scale: [T; 3]) -> Self {
        let linear = from_rows(linear.map(|r| r.map(T::wide)));
        let (unit, before) = (unit.map(T::wide), scale.map(T::wide));
        let m = linear * from_rows(rot::matrix(unit)) * DMat3::from_diagonal(DVec3::from_array(before));
        let (mut columns, mut mixing) = ([m.x_axis, m.y_axis, m.z_axis], [DVec3::X, DVec3::Y, DVec3::Z]);
        for _ in 0..MAX_SWEEPS {
            let turned = [(0, 1), (0, 2), (1, 2)].map(|(p, q)| orthogonalise(&mut columns, &mut mixing, p, q));
            if turned == [false; 3] {
                break;
            }
        }
        let (axes, after) = directions(&columns, &mut mixing);
        let mixing = DMat3::from_cols(mixing[0], mixing[1], mixing[2]);
        Self { linear, unit, before, axes, after, mixing }
    }

    /// Quaternion `(w, x, y, z)` and standard deviations after skinning.
    pub(super) fn gaussian(&self) -> ([f64; 4], [f64; 3]) {
        (quat_of(&self.axes), self.after)
    }

    /// Cotangents of `r̂` and of the standard deviations before skinning.
    pub(super) fn backward(&self, d_quat: [f64; 4], d_scale: [f64; 3]) -> ([f64; 4], [f64; 3]) {
        let q = quat_of(&self.axes);
        let turn = |axis: usize| {
            let mut half = [0.0; 4];
            half[axis + 1] = 0.5;
            rot::hamilton(q, half).iter().zip(d_quat).map(|(a, b)| a * b).sum::<f64>()
        };
        let [x, y, z] = [turn(0), turn(1), turn(2)];
        let [s0, s1, s2] = self.after.map(|s| s * s);
        let share = |d: f64, from: f64, to: f64| {
            if (to - from).abs() <= EQUAL_TOLERANCE * to.max(from) { 0.0 } else { d / (to - from) }
        };
        // Twice G', off the diagonal.
        let (xy, xz, yz) = (-share(z, s0, s1), share(y, s0, s2), -share(x, s1, s2));
        let [a, b, c] = self.after;
        let inner = DMat3::from_cols(
            DVec3::new(d_scale[0], xy * a, xz * a),
            DVec3::new(xy * b, d_scale[1], yz * b),
            DVec3::new(xz * c, yz * c, d_scale[2]),
        );
        let d_m = to_rows(self.axes * inner * self.mixing.transpose());
        let turned = to_rows(self.linear * from_rows(rot::matrix(self.unit)));
        let (d_turned, d_before) = covariance::factor_backward(&turned, self.before, &d_m);
        let d_rotation = to_rows(self.linear.transpose() * from_rows(d_turned));
        (rot::matrix_backward(self.unit, &d_rotation), d_before)
    }
}

/// Whether squared lengths count as equal.
fn nearly_equal(a: f64, b: f64) -> bool {
    (a - b).abs() <= EQUAL_TOLERANCE * a.max(b)
}

/// Makes columns `p` and `q` orthogonal by the smaller of the two rotations. Returns whether they were not.
fn orthogonalise(columns: &mut [DVec3; 3], mixing: &mut [DVec3; 3], p: usize, q: usize) -> bool {
    let (a, b, along) = (columns[p].length_squared(), columns[q].length_squared(), columns[p].dot(columns[q]));
    let limit = if nearly_equal(a, b) { ORTHOGONAL_IF_EQUAL } else { ORTHOGONAL };
    if along.abs() <= limit * (a * b).sqrt() {
        return false;
    }
    let ratio = (b - a) / (2.0 * along);
    let tangent = ratio.signum() / (ratio.abs() + (1.0 + ratio * ratio).sqrt());
    let cosine = 1.0 / (1.0 + tangent * tangent).sqrt();
    for v in [columns, mixing] {
        let (x, y) = (v[p], v[q]);
        v[p] = cosine * (x - tangent * y);
        v[q] = cosine * (y + tangent * x);
    }
    true
}

/// The rotation whose columns point along `columns`, and their lengths; columns of `mixing` change sign with theirs.
fn directions(columns: &[DVec3; 3], mixing: &mut [DVec3; 3]) -> (DMat3, [f64; 3]) {
    let lengths = columns.map(DVec3::length);
    let mut order = [0, 1, 2];
    order.sort_by(|i, j| lengths[*j].total_cmp(&lengths[*i]));
    let [first, second, third] = order;
    let mut axes = [DVec3::ZERO; 3];
    axes[first] = columns[first].try_normalize().unwrap_or(DVec3::X);
    let flat = lengths[second] <= MIN_RATIO * lengths[first];
    let beside = columns[second].reject_from_normalized(axes[first]);
    axes[second] = if flat { axes[first].any_orthonormal_vector() } else { beside.normalize() };
    axes[third] = axes[first].cross(axes[second]).normalize();
    // An odd permutation of columns flips the orientation.
    if (second + 3 - first) % 3 == 2 {
        axes[third] = -axes[third];
    }
    if columns[third].dot(axes[third]) < 0.0 {
        mixing[third] = -mixing[third];
    }
    (DMat3::from_cols(axes[0], axes[1], axes[2]), lengths)
}

fn from_rows(m: rot::Mat3<f64>) -> DMat3 {
    DMat3::from_cols_array_2d(&m).transpose()
}

fn to_rows(m: DMat3) -> rot::Mat3<f64> {
    m.transpose().to_cols_array_2d()
}
