//! Spherical harmonics that turn with a body: `f'(d) = f(Rᵀ d)`.
//!
//! Each band turns into itself, `c' = D c`, by the projection of what was turned onto the basis,
//!
//! ```text
//! D[k][m] = 4π Σ_j w_j Y_k(n_j) Y_m(Rᵀ n_j)
//! ```
//! over the 26 points of Lebedev's rule of degree 7 (axes, edges and corners of the cube), which is exact for products of two
//! functions of a band up to the third. Both factors have the parity of their band, so one of each two opposite points is
//! enough. `D` is orthogonal: the way back is that of the inverse turn, and lengths of coefficients stay.

use super::{MAX_COEFFS, MAX_DEGREE, basis, coeffs};
use crate::real::Real;
use crate::rot::Mat3;
use std::sync::LazyLock;

/// Weights of an axis, an edge and a corner, for the whole rule to add up to 1; doubled, as half of the points are used.
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

/// The points as unit vectors, and `4π w Y_k` there.
type Rule = [([f64; 3], [f64; MAX_COEFFS]); POINTS.len()];

static RULE: LazyLock<Rule> = LazyLock::new(|| {
    POINTS.map(|point| {
        let squares: i8 = point.iter().map(|v| v * v).sum();
        let n = point.map(|v| f64::from(v) / f64::from(squares).sqrt());
        let weight = 4.0 * std::f64::consts::PI * WEIGHTS[squares as usize - 1];
        (n, basis(n, MAX_DEGREE).map(|y| weight * y))
    })
});

/// How coefficients up to a degree turn.
#[derive(Clone, Copy, Debug)]
pub struct ShTurn<T> {
    /// `D`, by rows; entries between bands are zero.
    matrix: [[T; MAX_COEFFS]; MAX_COEFFS],
    degree: u8,
}

impl<T: Real> ShTurn<T> {
    /// The turn by a rotation (rows of its matrix), for coefficients up to `degree` (at most 3).
    pub fn new(r: &Mat3<T>, degree: u8) -> Self {
        let zero = r[0][0].lit(0.0);
        let mut matrix = [[zero; MAX_COEFFS]; MAX_COEFFS];
        for (n, here) in RULE.iter() {
            let n = n.map(|v| zero.lit(v));
            let turned: [T; 3] = std::array::from_fn(|b| r[0][b] * n[0] + r[1][b] * n[1] + r[2][b] * n[2]);
            let there = basis(turned, degree);
            for band in (1..=degree).map(|band| coeffs(band - 1)..coeffs(band)) {
                for k in band.clone() {
                    for m in band.clone() {
                        matrix[k][m] = matrix[k][m] + zero.lit(here[k]) * there[m];
                    }
                }
            }
        }
        matrix[0][0] = zero.lit(1.0);
        Self { matrix, degree }
    }

    /// Turns a splat's coefficients in place, `[(degree + 1)², 3]` flat.
    pub fn apply(&self, sh: &mut [T]) {
        self.multiply(sh, |k, m| self.matrix[k][m]);
    }

    /// Turns cotangents of turned coefficients back, in place; the rotation itself counts as a constant.
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
    const WIDE: f64 = 2e-12;
    /// The same in f32.
    const NARROW: f64 = 1e-5;

    fn random<const N: usize>(rng: &mut Rng) -> [f64; N] {
        std::array::from_fn(|_| f64::from(rng.normal()))
    }

    fn unit(v: [f64; 3]) -> [f64; 3] {
        super::super::direction(v, [0.0; 3]).0
    }

    /// Analytic truth: a turned function seen from `d` is the function seen from `Rᵀ d`.
    #[test]
    fn turned_lobes_are_seen_from_the_turned_direction() {
        let mut rng = Rng::new(3, "sh-turn", 0, 0);
        for degree in 0..=3u8 {
            for case in 0..20 {
                // Turns by nothing and by half a turn are among them.
                let raw = match case {
                    0 => [1.0, 0.0, 0.0, 0.0],
                    1 => [0.0, 0.6, 0.0, -0.8],
                    _ => random::<4>(&mut rng),
                };
                let r = rot::matrix(rot::normalise(raw).wxyz);
                let sh: Vec<f64> = random::<48>(&mut rng)[..3 * coeffs(degree)].to_vec();
                let (mut turned, d) = (sh.clone(), unit(random(&mut rng)));
                ShTurn::new(&r, degree).apply(&mut turned);
                let back: [f64; 3] = std::array::from_fn(|b| (0..3).map(|a| r[a][b] * d[a]).sum());
                let seen = |sh: &[f64], d: [f64; 3], channel: usize| -> f64 {
                    let terms = basis(d, degree).into_iter().zip(sh.chunks(3));
                    terms.map(|(y, c)| y * c[channel]).sum()
                };
                for channel in 0..3 {
                    let (got, want) = (seen(&turned, d, channel), seen(&sh, back, channel));
                    assert!((got - want).abs() < WIDE * (1.0 + want.abs()), "{degree} {case}: {got} {want}");
                }

                let narrow: rot::Mat3<f32> = r.map(|row| row.map(|v| v as f32));
                let mut single: Vec<f32> = sh.iter().map(|v| *v as f32).collect();
                ShTurn::new(&narrow, degree).apply(&mut single);
                let close = |(a, b): (&f32, &f64)| (f64::from(*a) - b).abs() < NARROW;
                assert!(single.iter().zip(&turned).all(close), "f32 at degree {degree}");
            }
        }
    }

    /// `⟨g, D c⟩ = ⟨Dᵀ g, c⟩`, and `Dᵀ` undoes `D`.
    #[test]
    fn the_way_back_is_the_transpose_and_the_inverse() {
        let mut rng = Rng::new(4, "sh-turn", 0, 0);
        let turn = ShTurn::new(&rot::matrix(rot::normalise(random::<4>(&mut rng)).wxyz), 3);
        let (sh, g) = (random::<48>(&mut rng), random::<48>(&mut rng));
        let (mut turned, mut pulled) = (sh, g);
        turn.apply(&mut turned);
        turn.apply_backward(&mut pulled);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        assert!((dot(&turned, &g) - dot(&sh, &pulled)).abs() < 1e-12);
        turn.apply_backward(&mut turned);
        assert!(turned.iter().zip(&sh).all(|(a, b)| (a - b).abs() < 1e-13));
    }
}
