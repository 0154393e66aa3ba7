//! The rigid motion that fits weighted pairs of points best (Kabsch 1976), by Horn's quaternions (1987).
//!
//! ```text
//! min Σ w |R p + t − q|²     p̄, q̄ weighted means     S = Σ w (p − p̄)(q − q̄)ᵀ     t = q̄ − R p̄
//! R maximises tr(R S): the eigenvector of the largest eigenvalue of Horn's symmetric 4 × 4 matrix of S, by Jacobi's method
//! ```
//! The eigenvector is a quaternion, so `R` is always a rotation: a mirror image gives the best rotation, not a reflection.
//! The gap to the second eigenvalue is `2 (σ₂ ± σ₃)` of the singular values of `S`. Where it vanishes (points on a line, one point,
//! a mirrored symmetric set) the rotation is free in part: the eigenspace's rotation by the smallest angle is taken, and
//! the fit says so.
//!
//! Way back, without derivatives of eigenvectors: with `A = R S` (symmetric at the optimum) and `δR = [φ]× R`,
//! `(tr A · I − A) φ = vee((R δS)ᵀ − R δS)`.

use glam::{DMat3, DQuat, DVec3};

/// Sweeps of Jacobi's method at most; 4 × 4 matrices need about 6.
const SWEEPS: usize = 15;
/// Eigenvalues closer than this times the norm of `S` are one (twice `σ₂ / σ₁ ≤ 1e-6`).
const SAME: f64 = 2e-6;
/// Rounding of second moments, relative to moments about the reference points.
const NOISE: f64 = 1e-14;

/// How far a rigid motion is determined by its pairs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Freedom {
    /// One rotation is best.
    None,
    /// Rotations about a line or point fit alike; the one with the smallest angle was taken.
    Turn,
    /// The weight is too small or something is not finite: the identity.
    All,
}

/// The rigid motion `q = R p + t`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rigid {
    /// `R`.
    pub turn: DMat3,
    /// `t`, world units.
    pub shift: DVec3,
    /// Whether it is determined.
    pub freedom: Freedom,
}

impl Rigid {
    /// Nothing moves; nothing was determined.
    pub const IDENTITY: Self = Self { turn: DMat3::IDENTITY, shift: DVec3::ZERO, freedom: Freedom::All };

    /// Where a point goes.
    pub fn apply(&self, p: DVec3) -> DVec3 {
        self.turn * p + self.shift
    }
}

/// Sums over weighted pairs, relative to two reference points (near the pairs, lest digits cancel).
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

    /// Of pairs with weights (1 each if `None`), about the first pair.
    pub fn of(pairs: &[(DVec3, DVec3)], weights: Option<&[f64]>) -> Self {
        let mut sums = Self::about(pairs.first().map_or([DVec3::ZERO; 2], |&(p, q)| [p, q]));
        for (i, &(p, q)) in pairs.iter().enumerate() {
            sums.add(weights.map_or(1.0, |w| w[i]), p, q);
        }
        sums
    }

    /// Adds a pair.
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

    /// Sum of the weights.
    pub fn weight(&self) -> f64 {
        self.weight
    }

    /// `p̄` and `q̄`.
    pub fn means(&self) -> [DVec3; 2] {
        [0, 1].map(|k| self.references[k] + self.first[k] / self.weight)
    }

    /// `S = Σ w (p − p̄)(q − q̄)ᵀ`.
    pub fn covariance(&self) -> DMat3 {
        let (p, q) = (self.first[0] / self.weight, self.first[1]);
        self.cross - DMat3::from_cols(p * q.x, p * q.y, p * q.z)
    }

    /// The best rigid motion; the identity if the weight is at most `least_weight` or anything is not finite.
    pub fn fit(&self, least_weight: f64) -> Rigid {
        let finite = self.cross.is_finite() && self.first.iter().all(|f| f.is_finite());
        if !finite || self.weight.is_nan() || self.weight <= least_weight.max(0.0) {
            return Rigid::IDENTITY;
        }
        let noise = NOISE * (self.squares[0] * self.squares[1]).sqrt();
        let (turn, unique) = rotation(&self.covariance(), noise);
        let [p, q] = self.means();
        Rigid { turn, shift: q - turn * p, freedom: if unique { Freedom::None } else { Freedom::Turn } }
    }

    /// `√(Σ w |R p + t − q|² / Σ w)`, world units, for the best or any other rigid motion.
    pub fn residual(&self, motion: &Rigid) -> f64 {
        let [p, q] = self.means();
        let spread = |k: usize| self.squares[k] - self.first[k].length_squared() / self.weight;
        let s = self.covariance();
        let inner = spread(0) + spread(1) - 2.0 * trace(&(motion.turn * s));
        (inner.max(0.0) / self.weight + (motion.apply(p) - q).length_squared()).sqrt()
    }
}

/// The best rigid motion of pairs with weights (1 each if `None`), by [`PairSums`].
pub fn kabsch(pairs: &[(DVec3, DVec3)], weights: Option<&[f64]>) -> Rigid {
    PairSums::of(pairs, weights).fit(0.0)
}

/// The rotation that maximises `tr(R S)`, and whether it is the only one. Entries of `S` are good to `noise`.
fn rotation(s: &DMat3, noise: f64) -> (DMat3, bool) {
    let norm = (s.x_axis.length_squared() + s.y_axis.length_squared() + s.z_axis.length_squared()).sqrt();
    let (values, vectors) = eigen(horn(s));
    let top = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let near = (SAME * norm).max(noise);
    let mut q = [0.0; 4];
    let mut members = 0;
    for (value, v) in values.iter().zip(&vectors) {
        if top - value <= near {
            // The projection of the identity quaternion on the eigenspace turns least.
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
fn eigen<const N: usize>(mut a: [[f64; N]; N]) -> ([f64; N], [[f64; N]; N]) {
    let mut v: [[f64; N]; N] = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(i == j)));
    let scale = a.iter().flatten().map(|x| x * x).sum::<f64>();
    for _ in 0..SWEEPS {
        let off: f64 = (0..N).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| a[i][j] * a[i][j]).sum();
        if off <= scale * 1e-40 {
            break;
        }
        for p in 0..N {
            for q in p + 1..N {
                turn_away(&mut a, &mut v, p, q);
            }
        }
    }
    (std::array::from_fn(|k| a[k][k]), v)
}

/// One Jacobi rotation: makes `a[p][q]` zero.
fn turn_away<const N: usize>(a: &mut [[f64; N]; N], v: &mut [[f64; N]; N], p: usize, q: usize) {
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

fn trace(m: &DMat3) -> f64 {
    m.x_axis.x + m.y_axis.y + m.z_axis.z
}

fn skew(a: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, a.z, -a.y), DVec3::new(-a.z, 0.0, a.x), DVec3::new(a.y, -a.x, 0.0))
}

/// Cotangents of a fit, ready for every pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairAdjoint {
    weight: f64,
    means: [DVec3; 2],
    d_covariance: DMat3,
    d_means: [DVec3; 2],
}

impl PairAdjoint {
    /// Of the fit `motion` of `sums`, from cotangents of `R` and `t`. Where the rotation is nearly free the smallest
    /// eigenvalue of `tr A · I − A` is held at `1e-6` of the largest; a fit of [`Freedom::All`] gives zeros.
    pub fn of(sums: &PairSums, motion: &Rigid, d_turn: &DMat3, d_shift: DVec3) -> Self {
        if motion.freedom == Freedom::All {
            let zero = [DVec3::ZERO; 2];
            return Self { weight: 1.0, means: zero, d_covariance: DMat3::ZERO, d_means: zero };
        }
        let (s, r, means) = (sums.covariance(), motion.turn, sums.means());
        // t = q̄ − R p̄.
        let d_turn = *d_turn - DMat3::from_cols(d_shift * means[0].x, d_shift * means[0].y, d_shift * means[0].z);
        let a = r * s;
        let m = std::array::from_fn::<f64, 3, _>(|i| trace(&(d_turn.transpose() * (skew(DVec3::AXES[i]) * r))));
        let h = DMat3::from_diagonal(DVec3::splat(trace(&a))) - (a + a.transpose()) * 0.5;
        let y = solve(&h, DVec3::from_array(m));
        let d_covariance = r.transpose() * skew(y) * -1.0;
        Self { weight: sums.weight, means, d_covariance, d_means: [-(r.transpose() * d_shift), d_shift] }
    }

    /// Cotangents of a pair's weight, `p` and `q`.
    pub fn pair(&self, w: f64, p: DVec3, q: DVec3) -> (f64, DVec3, DVec3) {
        let (p, q) = (p - self.means[0], q - self.means[1]);
        let (sq, sp) = (self.d_covariance * q, self.d_covariance.transpose() * p);
        let [dp, dq] = self.d_means.map(|d| d / self.weight);
        (p.dot(sq) + p.dot(dp) + q.dot(dq), (sq + dp) * w, (sp + dq) * w)
    }
}

/// `h⁻¹ m` for symmetric positive semi-definite `h` with its small eigenvalues raised.
fn solve(h: &DMat3, m: DVec3) -> DVec3 {
    let (values, vectors) = eigen(h.transpose().to_cols_array_2d());
    let top = values.iter().copied().fold(0.0, f64::max);
    let part = |(value, v): (&f64, &[f64; 3])| {
        let v = DVec3::from_array(*v);
        v * (v.dot(m) / value.max(1e-6 * top).max(f64::MIN_POSITIVE))
    };
    values.iter().zip(&vectors).map(part).sum()
}

#[cfg(test)]
mod tests;
