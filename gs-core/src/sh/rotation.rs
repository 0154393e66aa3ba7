//! Rotation of spherical harmonics with a body: `f'(d) = f(Rᵀ d)`.
//!
//! The coefficients of each band rotate among themselves, `c' = D c`, by projection of the rotated basis onto the basis,
//!
//! ```text
//! D[k][m] = 4π Σ_j w_j Y_k(n_j) Y_m(Rᵀ n_j)
//! ```
//! over the 26 points of Lebedev's rule of degree 7 (axes, edges and corners of the cube), which is exact for products of two
//! functions of a band up to the third. Both factors have the parity of their band, so one of each two opposite points is
//! enough. `D` is orthogonal: the backward is the inverse rotation, and norms of coefficients are kept.

use super::{MAX_COEFFS, MAX_DEGREE, basis, coeffs};
use crate::real::Real;
use crate::rot::Mat3;
use std::sync::LazyLock;

/// Weights of an axis, an edge and a corner, normalised to sum 1 over the whole rule; doubled, as half of its points are used.
const WEIGHTS: [f64; 3] = [2.0 / 21.0, 8.0 / 105.0, 9.0 / 140.0];

/// One of each two opposite points, not normalised: three axes, six edges, four corners.
const POINTS: [[i8; 3]; 13] = [
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
    [1, 1, 0],
    [1, -1, 0],
    [1, 0, 1],
    [1, 0, -1],
    [0, 1, 1],
    [0, 1, -1],
    [1, 1, 1],
    [1, 1, -1],
    [1, -1, 1],
    [1, -1, -1],
];

/// The points as unit vectors, and `4π w Y_k` at each.
type Rule = [([f64; 3], [f64; MAX_COEFFS]); POINTS.len()];

static RULE: LazyLock<Rule> = LazyLock::new(|| {
    POINTS.map(|point| {
        let squares: i8 = point.iter().map(|v| v * v).sum();
        let n = point.map(|v| f64::from(v) / f64::from(squares).sqrt());
        let weight = 4.0 * std::f64::consts::PI * WEIGHTS[squares as usize - 1];
        (n, basis(n, MAX_DEGREE).map(|y| weight * y))
    })
});

/// The matrix that rotates SH coefficients up to a degree, one block per band.
#[derive(Clone, Copy, Debug)]
pub struct ShRotation<T> {
    /// `D` by rows; entries between bands are zero.
    matrix: [[T; MAX_COEFFS]; MAX_COEFFS],
    degree: u8,
}

impl<T: Real> ShRotation<T> {
    /// For the rotation `r` (rows of its matrix) and coefficients up to `degree` (at most 3).
    pub fn new(r: &Mat3<T>, degree: u8) -> Self {
        let zero = r[0][0].lit(0.0);
        let mut matrix = [[zero; MAX_COEFFS]; MAX_COEFFS];
        for (n, weighted) in RULE.iter() {
            let n = n.map(|v| zero.lit(v));
            let inverse: [T; 3] = std::array::from_fn(|b| r[0][b] * n[0] + r[1][b] * n[1] + r[2][b] * n[2]);
            let rotated = basis(inverse, degree);
            for band in (1..=degree).map(|band| coeffs(band - 1)..coeffs(band)) {
                for k in band.clone() {
                    for m in band.clone() {
                        matrix[k][m] = matrix[k][m] + zero.lit(weighted[k]) * rotated[m];
                    }
                }
            }
        }
        matrix[0][0] = zero.lit(1.0);
        Self { matrix, degree }
    }

    /// Rotates the coefficients of one splat in place, `[(degree + 1)², 3]` flat.
    pub fn apply(&self, sh: &mut [T]) {
        self.multiply(sh, |k, m| self.matrix[k][m]);
    }

    /// Backward of [`ShRotation::apply`], in place: cotangents of rotated coefficients become those of the unrotated ones. The
    /// rotation has no gradient.
    pub fn apply_backward(&self, d_sh: &mut [T]) {
        self.multiply(d_sh, |k, m| self.matrix[m][k]);
    }

    fn multiply(&self, sh: &mut [T], entry: impl Fn(usize, usize) -> T) {
        let zero = self.matrix[0][0].lit(0.0);
        for band in 1..=self.degree {
            let range = coeffs(band - 1)..coeffs(band);
            for channel in 0..3 {
                let mut out = [zero; 7];
                for (o, k) in out.iter_mut().zip(range.clone()) {
                    *o = range.clone().fold(zero, |sum, m| sum + entry(k, m) * sh[3 * m + channel]);
                }
                out.into_iter().zip(range.clone()).for_each(|(o, k)| sh[3 * k + channel] = o);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Rng, rot};

    /// f64: sums of 13 products, then of 7, of order one.
    const F64_TOLERANCE: f64 = 2e-12;
    /// The same in f32.
    const F32_TOLERANCE: f64 = 1e-5;

    fn random<const N: usize>(rng: &mut Rng) -> [f64; N] {
        std::array::from_fn(|_| f64::from(rng.normal()))
    }

    fn unit(v: [f64; 3]) -> [f64; 3] {
        super::super::direction(v, [0.0; 3]).0
    }

    /// Analytic truth: the rotated function at `d` is the function at `Rᵀ d`.
    #[test]
    fn the_rotated_function_at_d_is_the_function_at_the_inversely_rotated_d() {
        let mut rng = Rng::new(3, "sh-turn", 0, 0);
        for degree in 0..=3u8 {
            for case in 0..20 {
                // The identity and a half turn are among them.
                let raw = match case {
                    0 => [1.0, 0.0, 0.0, 0.0],
                    1 => [0.0, 0.6, 0.0, -0.8],
                    _ => random::<4>(&mut rng),
                };
                let r = rot::matrix(rot::normalise(raw).wxyz);
                let sh: Vec<f64> = random::<48>(&mut rng)[..3 * coeffs(degree)].to_vec();
                let (mut rotated, d) = (sh.clone(), unit(random(&mut rng)));
                ShRotation::new(&r, degree).apply(&mut rotated);
                let back: [f64; 3] = std::array::from_fn(|b| (0..3).map(|a| r[a][b] * d[a]).sum());
                let value = |sh: &[f64], d: [f64; 3], channel: usize| -> f64 {
                    let terms = basis(d, degree).into_iter().zip(sh.chunks(3));
                    terms.map(|(y, c)| y * c[channel]).sum()
                };
                for channel in 0..3 {
                    let (got, want) = (value(&rotated, d, channel), value(&sh, back, channel));
                    assert!((got - want).abs() < F64_TOLERANCE * (1.0 + want.abs()), "{degree} {case}: {got} {want}");
                }

                let narrow: rot::Mat3<f32> = r.map(|row| row.map(|v| v as f32));
                let mut single: Vec<f32> = sh.iter().map(|v| *v as f32).collect();
                ShRotation::new(&narrow, degree).apply(&mut single);
                let close = |(a, b): (&f32, &f64)| (f64::from(*a) - b).abs() < F32_TOLERANCE;
                assert!(single.iter().zip(&rotated).all(close), "f32 at degree {degree}");
            }
        }
    }

    /// `⟨g, D c⟩ = ⟨Dᵀ g, c⟩`, and `Dᵀ` undoes `D`.
    #[test]
    fn backward_is_the_transpose_and_the_inverse() {
        let mut rng = Rng::new(4, "sh-turn", 0, 0);
        let rotation = ShRotation::new(&rot::matrix(rot::normalise(random::<4>(&mut rng)).wxyz), 3);
        let (sh, g) = (random::<48>(&mut rng), random::<48>(&mut rng));
        let (mut rotated, mut d_sh) = (sh, g);
        rotation.apply(&mut rotated);
        rotation.apply_backward(&mut d_sh);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        assert!((dot(&rotated, &g) - dot(&sh, &d_sh)).abs() < 1e-12);
        rotation.apply_backward(&mut rotated);
        assert!(rotated.iter().zip(&sh).all(|(a, b)| (a - b).abs() < 1e-13));
    }
}
