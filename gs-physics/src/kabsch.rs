//! The rigid motion that fits weighted pairs of points best (Kabsch 1976), by Horn's quaternions (1987).
//!
//! ```text
//! min Σ w |R p + t − q|²     p̄, q̄ weighted means     S = Σ w (p − p̄)(q − q̄)ᵀ     t = q̄ − R p̄
//! R maximises tr(R S): the eigenvector of the largest eigenvalue of Horn's symmetric 4 × 4 matrix of S, by Jacobi's method
//! ```
//! The eigenvector is a quaternion, so `R` is always a rotation: a mirror image gives the best rotation, not a reflection.
//! The gap to the second eigenvalue is `2 (σ₂ ± σ₃)` of the singular values of `S`. Where it vanishes (points on a line, one
//! point, a mirrored symmetric set) several rotations fit alike: the one of the eigenspace with the smallest angle is taken,
//! and [`Rigid::status`] reports it.

use glam::{DMat3, DQuat, DVec3};

/// Largest number of sweeps of Jacobi's method; 4 × 4 matrices need about 6.
const MAX_SWEEPS: usize = 15;
/// Eigenvalues closer than this times the norm of `S` count as equal (twice `σ₂ / σ₁ ≤ 1e-6`).
const EIGENVALUE_TOLERANCE: f64 = 2e-6;
/// Rounding error of second moments, relative to moments about the reference points.
const MOMENT_ROUNDING: f64 = 1e-14;

/// How far a rigid motion is determined by its pairs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FitStatus {
    /// Exactly one rotation fits best.
    Unique,
    /// Rotations about a line or point fit alike; the one with the smallest angle was taken.
    AmbiguousRotation,
    /// The weight is too small or a value is not finite; the motion is the identity.
    Undetermined,
}

/// The rigid motion `q = R p + t`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rigid {
    /// The rotation matrix `R`, of determinant 1.
    pub rotation: DMat3,
    /// The translation `t`, world units.
    pub translation: DVec3,
    /// Whether the pairs determine the motion.
    pub status: FitStatus,
}

impl Rigid {
    /// No motion, [`FitStatus::Undetermined`].
    pub const IDENTITY: Self =
        Self { rotation: DMat3::IDENTITY, translation: DVec3::ZERO, status: FitStatus::Undetermined };

    /// `R p + t` of a point.
    pub fn apply(&self, p: DVec3) -> DVec3 {
        self.rotation * p + self.translation
    }
}

/// Sums over weighted pairs, relative to two reference points (near the pairs, to avoid cancellation).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairSums {
    references: [DVec3; 2],
    weight: f64,
    first: [DVec3; 2],
    cross: DMat3,
    squares: [f64; 2],
}

impl PairSums {
    /// No pairs yet, about reference points of the `p` and of the `q`.
    pub fn about(references: [DVec3; 2]) -> Self {
        Self { references, weight: 0.0, first: [DVec3::ZERO; 2], cross: DMat3::ZERO, squares: [0.0; 2] }
    }

    /// Sums of pairs with weights (1 each if `None`), about the first pair.
    pub fn of(pairs: &[(DVec3, DVec3)], weights: Option<&[f64]>) -> Self {
        let mut sums = Self::about(pairs.first().map_or([DVec3::ZERO; 2], |&(p, q)| [p, q]));
        for (i, &(p, q)) in pairs.iter().enumerate() {
            sums.add(weights.map_or(1.0, |w| w[i]), p, q);
        }
        sums
    }

    /// Adds the pair `(p, q)` with weight `w`.
    #[inline]
    pub fn add(&mut self, w: f64, p: DVec3, q: DVec3) {
        let (p, q) = (p - self.references[0], q - self.references[1]);
        let wq = q * w;
        self.weight += w;
        self.first[0] += p * w;
        self.first[1] += wq;
        // Column c of p qᵀ is p q_c.
        self.cross.x_axis += p * wq.x;
        self.cross.y_axis += p * wq.y;
        self.cross.z_axis += p * wq.z;
        self.squares[0] += w * p.length_squared();
        self.squares[1] += wq.dot(q);
    }

    /// Adds sums about the same references.
    pub fn merge(&mut self, other: &Self) {
        debug_assert_eq!(self.references, other.references, "sums about different points");
        self.weight += other.weight;
        self.cross += other.cross;
        for k in 0..2 {
            self.first[k] += other.first[k];
            self.squares[k] += other.squares[k];
        }
    }

    /// The weighted means `p̄` and `q̄`.
    pub fn means(&self) -> [DVec3; 2] {
        [0, 1].map(|k| self.references[k] + self.first[k] / self.weight)
    }

    /// `S = Σ w (p − p̄)(q − q̄)ᵀ`.
    pub fn covariance(&self) -> DMat3 {
        let (p, q) = (self.first[0] / self.weight, self.first[1]);
        self.cross - DMat3::from_cols(p * q.x, p * q.y, p * q.z)
    }

    /// The best rigid motion; the identity if the weight is at most `min_weight` or a value is not finite.
    pub fn fit(&self, min_weight: f64) -> Rigid {
        let finite = self.cross.is_finite() && self.first.iter().all(|f| f.is_finite());
        if !finite || self.weight.is_nan() || self.weight <= min_weight.max(0.0) {
            return Rigid::IDENTITY;
        }
        let noise = MOMENT_ROUNDING * (self.squares[0] * self.squares[1]).sqrt();
        let (rotation, unique) = best_rotation(&self.covariance(), noise);
        let [p, q] = self.means();
        let status = if unique { FitStatus::Unique } else { FitStatus::AmbiguousRotation };
        Rigid { rotation, translation: q - rotation * p, status }
    }
}

/// The rigid motion that fits pairs `(p, q)` with weights (1 each if `None`) best; in several parts by [`PairSums`].
///
/// ```
/// use glam::{DMat3, DVec3};
/// use gs_physics::kabsch::{FitStatus, kabsch};
/// let r = DMat3::from_rotation_z(0.5);
/// let pairs = [DVec3::X, DVec3::Y, DVec3::Z].map(|p| (p, r * p + DVec3::ONE));
/// let fit = kabsch(&pairs, None);
/// assert!(fit.status == FitStatus::Unique && fit.rotation.abs_diff_eq(r, 1e-12));
/// assert!((fit.translation - DVec3::ONE).length() < 1e-12);
/// // Two points leave the rotation about their line open.
/// assert_eq!(kabsch(&pairs[..2], None).status, FitStatus::AmbiguousRotation);
/// ```
pub fn kabsch(pairs: &[(DVec3, DVec3)], weights: Option<&[f64]>) -> Rigid {
    PairSums::of(pairs, weights).fit(0.0)
}

/// The rotation that maximises `tr(R S)`, and whether it is the only one. Entries of `S` are accurate to `noise`.
fn best_rotation(s: &DMat3, noise: f64) -> (DMat3, bool) {
    let norm = (s.x_axis.length_squared() + s.y_axis.length_squared() + s.z_axis.length_squared()).sqrt();
    let (values, vectors) = eigen(horn(s));
    let top = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let near = (EIGENVALUE_TOLERANCE * norm).max(noise);
    let mut q = [0.0; 4];
    let mut members = 0;
    for (value, v) in values.iter().zip(&vectors) {
        if top - value <= near {
            // The projection of the identity quaternion on the eigenspace has the smallest angle.
            members += 1;
            q = std::array::from_fn(|k| q[k] + v[0] * v[k]);
        }
    }
    let length = |q: &[f64; 4]| q.iter().map(|x| x * x).sum::<f64>().sqrt();
    if members == 1 || length(&q) < 1e-8 {
        let first = values.iter().position(|v| *v == top).unwrap_or(0);
        q = vectors[first];
    }
    let scale = 1.0 / length(&q);
    let [w, x, y, z] = q.map(|c| c * scale);
    (DMat3::from_quat(DQuat::from_xyzw(x, y, z, w)), members == 1)
}

/// Horn's symmetric matrix: `qᵀ N q = tr(R(q) S)` for unit quaternions `(w, x, y, z)`.
fn horn(s: &DMat3) -> [[f64; 4]; 4] {
    // glam stores columns: `col.row`.
    let (xx, xy, xz) = (s.x_axis.x, s.y_axis.x, s.z_axis.x);
    let (yx, yy, yz) = (s.x_axis.y, s.y_axis.y, s.z_axis.y);
    let (zx, zy, zz) = (s.x_axis.z, s.y_axis.z, s.z_axis.z);
    [
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ]
}

/// Eigenvalues and eigenvectors (rows) of a symmetric matrix by cyclic Jacobi rotations.
fn eigen(mut a: [[f64; 4]; 4]) -> ([f64; 4], [[f64; 4]; 4]) {
    let mut v: [[f64; 4]; 4] = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(i == j)));
    let scale = a.iter().flatten().map(|x| x * x).sum::<f64>();
    for _ in 0..MAX_SWEEPS {
        let off: f64 = (0..4).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| a[i][j] * a[i][j]).sum();
        if off <= scale * 1e-40 {
            break;
        }
        for p in 0..4 {
            for q in p + 1..4 {
                jacobi_rotate(&mut a, &mut v, p, q);
            }
        }
    }
    (std::array::from_fn(|k| a[k][k]), v)
}

/// One Jacobi rotation: makes `a[p][q]` zero.
fn jacobi_rotate(a: &mut [[f64; 4]; 4], v: &mut [[f64; 4]; 4], p: usize, q: usize) {
    if a[p][q] == 0.0 {
        return;
    }
    let theta = 0.5 * (a[q][q] - a[p][p]) / a[p][q];
    let t = if theta.is_finite() { theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt()) } else { 0.0 };
    let c = 1.0 / (t * t + 1.0).sqrt();
    let s = t * c;
    for row in a.iter_mut() {
        (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
    }
    for m in [a, v] {
        let (above, below) = m.split_at_mut(q);
        for (x, y) in above[p].iter_mut().zip(&mut below[0]) {
            (*x, *y) = (c * *x - s * *y, s * *x + c * *y);
        }
    }
}

#[cfg(test)]
mod tests;
