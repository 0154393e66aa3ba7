//! From scales and rotation to a 3D covariance, and back: `M = R diag(s)`, `Σ = M Mᵀ`.
//!
//! Scales are standard deviations in world units; only their squares matter, so a negative or zero scale is legal.
//!
//! ```
//! use gs_core::{covariance, rot};
//!
//! let r = rot::matrix([1.0, 0.0, 0.0, 0.0]);
//! let sigma = covariance::covariance(&covariance::factor(&r, [1.0, 2.0, 3.0]));
//! assert_eq!(sigma, [1.0, 0.0, 0.0, 4.0, 0.0, 9.0]); // xx, xy, xz, yy, yz, zz
//! ```

use crate::real::Real;
use crate::rot::Mat3;

/// `M = R diag(s)`: the factor whose columns are the splat's axes scaled by their standard deviations.
#[inline(always)]
pub fn factor<T: Real>(rotation: &Mat3<T>, scales: [T; 3]) -> Mat3<T> {
    std::array::from_fn(|r| std::array::from_fn(|c| rotation[r][c] * scales[c]))
}

/// Backward of [`factor`]: cotangents of the rotation matrix and of the scales, from that of `M`.
#[inline(always)]
pub fn factor_backward<T: Real>(rotation: &Mat3<T>, scales: [T; 3], d_factor: &Mat3<T>) -> (Mat3<T>, [T; 3]) {
    let d_rotation = std::array::from_fn(|r| std::array::from_fn(|c| d_factor[r][c] * scales[c]));
    let d_scales = std::array::from_fn(|c| {
        rotation[0][c] * d_factor[0][c] + rotation[1][c] * d_factor[1][c] + rotation[2][c] * d_factor[2][c]
    });
    (d_rotation, d_scales)
}

/// `Σ = M Mᵀ`, as its six independent entries `xx, xy, xz, yy, yz, zz`.
#[inline(always)]
pub fn covariance<T: Real>(m: &Mat3<T>) -> [T; 6] {
    let e = |a: usize, b: usize| m[a][0] * m[b][0] + m[a][1] * m[b][1] + m[a][2] * m[b][2];
    [e(0, 0), e(0, 1), e(0, 2), e(1, 1), e(1, 2), e(2, 2)]
}

/// Backward of [`covariance`]: `d_M = 2 d_Σ M` for the symmetric 3×3 cotangent whose off-diagonal entries are half of
/// the packed ones in `d` (each packed off-diagonal entry stands for two of the matrix).
#[inline(always)]
pub fn covariance_backward<T: Real>(m: &Mat3<T>, d: [T; 6]) -> Mat3<T> {
    let half = d[0].lit(0.5);
    let full = [[d[0], d[1] * half, d[2] * half], [d[1] * half, d[3], d[4] * half], [d[2] * half, d[4] * half, d[5]]];
    let two = d[0].lit(2.0);
    std::array::from_fn(|r| {
        std::array::from_fn(|c| two * (full[r][0] * m[0][c] + full[r][1] * m[1][c] + full[r][2] * m[2][c]))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;
    use crate::rot;

    fn covariance_of(q: [f64; 4], s: [f64; 3]) -> [f64; 6] {
        covariance(&factor(&rot::matrix(rot::normalise(q).wxyz), s))
    }

    #[test]
    fn axis_aligned_truth() {
        assert_eq!(covariance_of([1.0, 0.0, 0.0, 0.0], [1.0, 2.0, 3.0]), [1.0, 0.0, 0.0, 4.0, 0.0, 9.0]);
    }

    #[test]
    fn sign_and_length_of_the_quaternion_do_not_matter() {
        let (q, s) = ([0.3, -0.2, 0.7, 0.1], [0.5, 0.1, 2.0]);
        let a = covariance_of(q, s);
        let b = covariance_of(q.map(|v| -3.0 * v), [-0.5, 0.1, -2.0]);
        for (x, y) in a.iter().zip(b) {
            assert!((x - y).abs() < 1e-14);
        }
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let mut rng = Rng::new(4, "cov", 0, 0);
        for _ in 0..50 {
            let x: [f64; 7] = std::array::from_fn(|_| f64::from(rng.normal()));
            let w: [f64; 6] = std::array::from_fn(|_| f64::from(rng.normal()));
            let split = |x: [f64; 7]| ([x[0], x[1], x[2], x[3]], [x[4], x[5], x[6]]);
            let loss = |x: [f64; 7]| {
                let (q, s) = split(x);
                covariance_of(q, s).iter().zip(&w).map(|(a, b)| a * b).sum::<f64>()
            };
            let (q, s) = split(x);
            let unit = rot::normalise(q);
            let r = rot::matrix(unit.wxyz);
            let (d_r, d_s) = factor_backward(&r, s, &covariance_backward(&factor(&r, s), w));
            let d_q = rot::normalise_backward(&unit, rot::matrix_backward(unit.wxyz, &d_r));
            let got = [d_q[0], d_q[1], d_q[2], d_q[3], d_s[0], d_s[1], d_s[2]];
            for k in 0..7 {
                let (mut hi, mut lo) = (x, x);
                hi[k] += 1e-6;
                lo[k] -= 1e-6;
                let want = (loss(hi) - loss(lo)) / 2e-6;
                assert!((got[k] - want).abs() < 1e-6 * (1.0 + want.abs()), "{k}: {} {want}", got[k]);
            }
        }
    }
}
