//! Quaternions `(w, x, y, z)` of any length, their rotation matrices, and the backward functions of both.
//!
//! ```text
//! q  = q̃ / max(|q̃|, 1e-12)
//! R  = | 1-2(y²+z²)  2(xy-wz)    2(xz+wy)   |
//!      | 2(xy+wz)    1-2(x²+z²)  2(yz-wx)   |
//!      | 2(xz-wy)    2(yz+wx)    1-2(x²+y²) |
//! ```
//! The zero quaternion is the identity rotation with zero gradient (`q = 0` makes every off-diagonal term vanish), as in
//! gsplat. All functions are generic over [`Real`]. This module is the only place that uses glam's `xyzw` order.
//!
//! ```
//! use gs_core::rot::{conjugate, hamilton, matrix, normalise};
//!
//! let q = normalise([1.0, 0.0, 0.0, 1.0]).wxyz; // a quarter turn about z: x goes to y
//! let x_axis = matrix(q).map(|row| row[0]);
//! assert!((x_axis[1] - 1.0f64).abs() < 1e-15 && x_axis[0].abs() < 1e-15);
//! assert_eq!(hamilton([0.0, 1.0, 0.0, 0.0], conjugate([0.0, 1.0, 0.0, 0.0])), [1.0, 0.0, 0.0, 0.0]);
//! ```

use crate::real::Real;
use glam::Quat;

/// Lengths below this are treated as this (the quaternion then shrinks to zero, hence to the identity).
const MIN_QUAT_NORM: f64 = 1e-12;

/// A 3×3 matrix as rows: entry `[r][c]` is row `r`, column `c`.
pub type Mat3<T> = [[T; 3]; 3];

/// A normalised quaternion, and what [`normalise_backward`] needs.
#[derive(Clone, Copy, Debug)]
pub struct UnitQuat<T> {
    /// `(w, x, y, z)`, of unit length (or zero for a zero input).
    pub wxyz: [T; 4],
    /// Reciprocal length of the raw quaternion, `1 / max(|q̃|, 1e-12)`.
    pub inv_norm: T,
    /// 1 where the length was above 1e-12, else 0: whether the length has a gradient.
    pub free: T,
}

/// Normalises a raw quaternion of any length. Scaled by its largest entry first, so that tiny or huge quaternions
/// neither underflow nor overflow in `f32`.
#[inline(always)]
pub fn normalise<T: Real>(raw: [T; 4]) -> UnitQuat<T> {
    let [w, x, y, z] = raw;
    let zero = w.lit(0.0);
    let one = w.lit(1.0);
    let big = w.max(-w).max(x.max(-x)).max(y.max(-y)).max(z.max(-z));
    let scale = zero.select_lt(big, big, one);
    let [a, b, c, d] = [w / scale, x / scale, y / scale, z / scale];
    let norm = (a * a + b * b + c * c + d * d).sqrt() * scale;
    let floor = w.lit(MIN_QUAT_NORM);
    let inv_norm = one / norm.max(floor);
    let wxyz = [w * inv_norm, x * inv_norm, y * inv_norm, z * inv_norm];
    UnitQuat { wxyz, inv_norm, free: floor.select_lt(norm, one, zero) }
}

/// Backward of [`normalise`]: `d_q̃ = (d_q − q (q·d_q)) / |q̃|`, without the projection below the length 1e-12.
#[inline(always)]
pub fn normalise_backward<T: Real>(q: &UnitQuat<T>, d_q: [T; 4]) -> [T; 4] {
    let u = q.wxyz;
    let along = (u[0] * d_q[0] + u[1] * d_q[1] + u[2] * d_q[2] + u[3] * d_q[3]) * q.free;
    [
        (d_q[0] - u[0] * along) * q.inv_norm,
        (d_q[1] - u[1] * along) * q.inv_norm,
        (d_q[2] - u[2] * along) * q.inv_norm,
        (d_q[3] - u[3] * along) * q.inv_norm,
    ]
}

/// Rotation matrix (rows) of a unit quaternion.
#[inline(always)]
pub fn matrix<T: Real>(unit_wxyz: [T; 4]) -> Mat3<T> {
    let [w, x, y, z] = unit_wxyz;
    let one = w.lit(1.0);
    let two = w.lit(2.0);
    [
        [one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)],
    ]
}

/// Backward of [`matrix`]: cotangents of the four entries, taken as independent.
#[inline(always)]
pub fn matrix_backward<T: Real>(unit_wxyz: [T; 4], d: &Mat3<T>) -> [T; 4] {
    let [w, x, y, z] = unit_wxyz;
    let two = w.lit(2.0);
    let (s01, s02, s12) = (d[0][1] + d[1][0], d[0][2] + d[2][0], d[1][2] + d[2][1]);
    let (a10, a02, a21) = (d[1][0] - d[0][1], d[0][2] - d[2][0], d[2][1] - d[1][2]);
    [
        two * (x * a21 + y * a02 + z * a10),
        two * (w * a21 + y * s01 + z * s02 - two * x * (d[1][1] + d[2][2])),
        two * (w * a02 + x * s01 + z * s12 - two * y * (d[0][0] + d[2][2])),
        two * (w * a10 + x * s02 + y * s12 - two * z * (d[0][0] + d[1][1])),
    ]
}

/// Hamilton product `a ⊗ b`: the rotation `b` followed by `a`.
#[inline(always)]
pub fn hamilton<T: Real>(a: [T; 4], b: [T; 4]) -> [T; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

/// Conjugate `(w, −x, −y, −z)`: the inverse rotation of a unit quaternion.
#[inline(always)]
pub fn conjugate<T: Real>([w, x, y, z]: [T; 4]) -> [T; 4] {
    [w, -x, -y, -z]
}

/// glam's `xyzw` quaternion from a `wxyz` one.
pub fn to_glam(wxyz: [f32; 4]) -> Quat {
    Quat::from_xyzw(wxyz[1], wxyz[2], wxyz[3], wxyz[0])
}

/// A `wxyz` quaternion from glam's `xyzw` one.
pub fn from_glam(q: Quat) -> [f32; 4] {
    [q.w, q.x, q.y, q.z]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    fn raw(rng: &mut Rng) -> [f64; 4] {
        std::array::from_fn(|_| f64::from(rng.normal()))
    }

    #[test]
    fn agrees_with_glam() {
        let mut rng = Rng::new(1, "rot", 0, 0);
        for _ in 0..100 {
            let q = normalise(raw(&mut rng)).wxyz.map(|v| v as f32);
            let ours = matrix(q);
            let theirs = glam::Mat3::from_quat(to_glam(q));
            for (r, row) in ours.iter().enumerate() {
                for (c, v) in row.iter().enumerate() {
                    assert!((v - theirs.col(c)[r]).abs() < 1e-6);
                }
            }
            assert_eq!(from_glam(to_glam(q)), q);
            assert_eq!(from_glam(to_glam(q).conjugate()), conjugate(q));
        }
    }

    #[test]
    fn zero_is_identity_without_gradient() {
        let q = normalise([0.0f32; 4]);
        assert_eq!(matrix(q.wxyz), [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
        let d = matrix_backward(q.wxyz, &[[1.0; 3]; 3]);
        assert_eq!(normalise_backward(&q, d), [0.0; 4]);
    }

    #[test]
    fn length_does_not_matter_even_at_the_ends_of_f32() {
        for s in [1e-10f32, 1e-5, 1.0, 1e18, 1e30] {
            let q = normalise([0.5 * s, -0.5 * s, 0.5 * s, 0.5 * s]);
            for (v, e) in q.wxyz.iter().zip([0.5, -0.5, 0.5, 0.5]) {
                assert!((v - e).abs() < 1e-6, "scale {s}: {v}");
            }
        }
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let mut rng = Rng::new(2, "rot", 0, 0);
        for _ in 0..50 {
            let q = raw(&mut rng);
            let weight: Mat3<f64> = std::array::from_fn(|_| std::array::from_fn(|_| f64::from(rng.normal())));
            let loss = |q: [f64; 4]| -> f64 {
                let m = matrix(normalise(q).wxyz);
                (0..9).map(|i| m[i / 3][i % 3] * weight[i / 3][i % 3]).sum()
            };
            let unit = normalise(q);
            let got = normalise_backward(&unit, matrix_backward(unit.wxyz, &weight));
            for k in 0..4 {
                let h = 1e-6;
                let (mut hi, mut lo) = (q, q);
                hi[k] += h;
                lo[k] -= h;
                let want = (loss(hi) - loss(lo)) / (2.0 * h);
                assert!((got[k] - want).abs() < 1e-7 * (1.0 + want.abs()), "{k}: {} {want}", got[k]);
            }
        }
    }

    #[test]
    fn hamilton_composes_rotations() {
        let mut rng = Rng::new(3, "rot", 0, 0);
        let (a, b) = (normalise(raw(&mut rng)).wxyz, normalise(raw(&mut rng)).wxyz);
        let (ma, mb, mab) = (matrix(a), matrix(b), matrix(hamilton(a, b)));
        for r in 0..3 {
            for c in 0..3 {
                let want: f64 = (0..3).map(|k| ma[r][k] * mb[k][c]).sum();
                assert!((mab[r][c] - want).abs() < 1e-12);
            }
        }
    }
}
