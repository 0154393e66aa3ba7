//! Real spherical harmonics up to degree 3, in the order and signs of 3DGS `.ply` files.
//!
//! ```text
//! rgb_c = max(0, 0.5 + Σ_k Y_k(d) · sh[k][c])        d = (mean − camera) / |mean − camera|
//! ```
//! The basis is written as polynomials in `(x, y, z)`; [`basis_backward`] treats the three as independent, and
//! [`direction_backward`] projects onto the sphere. Singular input: `mean = camera` (the direction is then zero).
//!
//! ```
//! use gs_core::sh;
//!
//! // Degree 0 is the same from every direction: rgb = 0.5 + C0 · sh_dc.
//! let (d, distance) = sh::direction([0.0f64, 0.0, 3.0], [0.0; 3]);
//! assert_eq!((d, distance), ([0.0, 0.0, 1.0], 1.0 / 3.0)); // unit vector, reciprocal distance
//! let y = sh::basis(d, 1);
//! assert_eq!((y[0], y[1], y[3]), (sh::C0, 0.0, 0.0)); // of the first band only z remains
//! assert!(y[2] > 0.48);
//! ```

use crate::real::{Real, dot3};

mod rotation;

pub use rotation::ShRotation;

/// Coefficients per channel at the highest degree, 3.
pub const MAX_COEFFS: usize = 16;
/// Highest SH degree supported, that of 3DGS.
pub const MAX_DEGREE: u8 = 3;

/// Value of the constant basis function, `½ √(1/π)`: `sh_0 = (rgb − 0.5) / C0`.
pub const C0: f64 = 0.282_094_791_773_878_14;
const C1: f64 = 0.488_602_511_902_919_9;
const C2: [f64; 5] = [
    1.092_548_430_592_079_2,
    -1.092_548_430_592_079_2,
    0.315_391_565_252_520_05,
    -1.092_548_430_592_079_2,
    0.546_274_215_296_039_6,
];
const C3: [f64; 7] = [
    -0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    -0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    -0.457_045_799_464_465_8,
    1.445_305_721_320_277,
    -0.590_043_589_926_643_5,
];

/// Number of coefficients per channel for a degree: `(degree + 1)²`.
pub const fn coeffs(degree: u8) -> usize {
    (degree as usize + 1) * (degree as usize + 1)
}

/// The 16 basis functions at the unit vector `d`; those above `degree` are zero.
#[inline(always)]
pub fn basis<T: Real>(d: [T; 3], degree: u8) -> [T; MAX_COEFFS] {
    let [x, y, z] = d;
    let c = |v: f64| x.lit(v);
    let mut out = [c(0.0); MAX_COEFFS];
    out[0] = c(C0);
    if degree >= 1 {
        out[1] = c(-C1) * y;
        out[2] = c(C1) * z;
        out[3] = c(-C1) * x;
    }
    if degree >= 2 {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        out[4] = c(C2[0]) * x * y;
        out[5] = c(C2[1]) * y * z;
        out[6] = c(C2[2]) * (c(2.0) * zz - xx - yy);
        out[7] = c(C2[3]) * x * z;
        out[8] = c(C2[4]) * (xx - yy);
        if degree >= 3 {
            let ring = c(4.0) * zz - xx - yy;
            out[9] = c(C3[0]) * y * (c(3.0) * xx - yy);
            out[10] = c(C3[1]) * x * y * z;
            out[11] = c(C3[2]) * y * ring;
            out[12] = c(C3[3]) * z * (c(2.0) * zz - c(3.0) * (xx + yy));
            out[13] = c(C3[4]) * x * ring;
            out[14] = c(C3[5]) * z * (xx - yy);
            out[15] = c(C3[6]) * x * (xx - c(3.0) * yy);
        }
    }
    out
}

/// Backward of [`basis`]: cotangent of `(x, y, z)`, taken as independent, from cotangents `g` of the values.
#[inline(always)]
pub fn basis_backward<T: Real>(d: [T; 3], degree: u8, g: &[T; MAX_COEFFS]) -> [T; 3] {
    let [x, y, z] = d;
    let c = |v: f64| x.lit(v);
    let mut out = [c(0.0); 3];
    if degree >= 1 {
        out = [c(-C1) * g[3], c(-C1) * g[1], c(C1) * g[2]];
    }
    if degree >= 2 {
        let (g4, g5, g6) = (c(C2[0]) * g[4], c(C2[1]) * g[5], c(2.0 * C2[2]) * g[6]);
        let (g7, g8) = (c(C2[3]) * g[7], c(2.0 * C2[4]) * g[8]);
        out[0] = out[0] + g4 * y - g6 * x + g7 * z + g8 * x;
        out[1] = out[1] + g4 * x + g5 * z - g6 * y - g8 * y;
        out[2] = out[2] + g5 * y + c(2.0) * g6 * z + g7 * x;
    }
    if degree >= 3 {
        let (xx, yy, zz, xy) = (x * x, y * y, z * z, x * y);
        let k: [T; 7] = std::array::from_fn(|i| c(C3[i]) * g[9 + i]);
        let (two, three, four, six) = (c(2.0), c(3.0), c(4.0), c(6.0));
        out[0] = out[0] + six * k[0] * xy + k[1] * y * z - two * k[2] * xy - six * k[3] * x * z
            + k[4] * (four * zz - three * xx - yy)
            + two * k[5] * x * z
            + three * k[6] * (xx - yy);
        out[1] = out[1] + three * k[0] * (xx - yy) + k[1] * x * z + k[2] * (four * zz - xx - three * yy)
            - six * k[3] * y * z
            - two * k[4] * xy
            - two * k[5] * y * z
            - six * k[6] * xy;
        out[2] = out[2]
            + k[1] * xy
            + c(8.0) * k[2] * y * z
            + three * k[3] * (two * zz - xx - yy)
            + c(8.0) * k[4] * x * z
            + k[5] * (xx - yy);
    }
    out
}

/// Unit vector from the camera to the mean, and the reciprocal distance (0 where they coincide).
#[inline(always)]
pub fn direction<T: Real>(mean: [T; 3], camera: [T; 3]) -> ([T; 3], T) {
    let v: [T; 3] = std::array::from_fn(|i| mean[i] - camera[i]);
    let zero = v[0].lit(0.0);
    let norm = dot3(v, v).sqrt();
    let inv = zero.select_lt(norm, v[0].lit(1.0) / norm, zero);
    (v.map(|c| c * inv), inv)
}

/// Backward of [`direction`]: cotangent of the mean, `(d_dir − d (d·d_dir)) / |mean − camera|`.
#[inline(always)]
pub fn direction_backward<T: Real>(d: [T; 3], inv_distance: T, d_dir: [T; 3]) -> [T; 3] {
    let along = dot3(d, d_dir);
    std::array::from_fn(|i| (d_dir[i] - d[i] * along) * inv_distance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    fn vector(rng: &mut Rng) -> [f64; 3] {
        std::array::from_fn(|_| f64::from(rng.normal()))
    }

    /// Analytic truth: the functions are orthonormal on the sphere.
    #[test]
    fn basis_is_orthonormal() {
        let (rings, steps) = (64usize, 128usize);
        let mut gram = [[0.0f64; 16]; 16];
        for i in 0..rings {
            // Midpoint in azimuth is exact for these degrees; Gauss–Legendre would be in z, midpoint is close enough.
            let z = -1.0 + (2.0 * i as f64 + 1.0) / rings as f64;
            let r = (1.0 - z * z).sqrt();
            for j in 0..steps {
                let a = std::f64::consts::TAU * (j as f64 + 0.5) / steps as f64;
                let y = basis([r * a.cos(), r * a.sin(), z], 3);
                let w = 4.0 * std::f64::consts::PI / (rings * steps) as f64;
                for p in 0..16 {
                    for q in 0..16 {
                        gram[p][q] += w * y[p] * y[q];
                    }
                }
            }
        }
        for (p, row) in gram.iter().enumerate() {
            for (q, v) in row.iter().enumerate() {
                let want = if p == q { 1.0 } else { 0.0 };
                assert!((v - want).abs() < 5e-3, "{p} {q}: {v}");
            }
        }
    }

    #[test]
    fn lower_degree_is_a_prefix() {
        let d = direction([0.3f64, -0.2, 0.9], [0.0; 3]).0;
        let full = basis(d, 3);
        for degree in 0..=3u8 {
            let part = basis(d, degree);
            for k in 0..16 {
                assert_eq!(part[k], if k < coeffs(degree) { full[k] } else { 0.0 });
            }
        }
    }

    #[test]
    fn gradient_through_the_view_direction_matches_finite_differences() {
        let mut rng = Rng::new(5, "sh", 0, 0);
        for degree in 0..=3u8 {
            for _ in 0..30 {
                let (mean, camera) = (vector(&mut rng), vector(&mut rng));
                let weights: [f64; 16] = std::array::from_fn(|_| f64::from(rng.normal()));
                let loss = |m: [f64; 3]| {
                    let y = basis(direction(m, camera).0, degree);
                    y.iter().zip(&weights).map(|(a, b)| a * b).sum::<f64>()
                };
                let (d, inv) = direction(mean, camera);
                let got = direction_backward(d, inv, basis_backward(d, degree, &weights));
                for k in 0..3 {
                    let (mut hi, mut lo) = (mean, mean);
                    hi[k] += 1e-6;
                    lo[k] -= 1e-6;
                    let want = (loss(hi) - loss(lo)) / 2e-6;
                    assert!((got[k] - want).abs() < 1e-6 * (1.0 + want.abs()), "degree {degree}: {} {want}", got[k]);
                }
            }
        }
    }

    #[test]
    fn coincident_camera_gives_no_direction_and_no_gradient() {
        let (d, inv) = direction([1.0f32, 2.0, 3.0], [1.0, 2.0, 3.0]);
        assert_eq!((d, inv), ([0.0; 3], 0.0));
        assert_eq!(direction_backward(d, inv, [1.0; 3]), [0.0; 3]);
    }
}
