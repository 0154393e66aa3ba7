//! Rotations from rotation vectors, rigid transforms from twists, and their backward passes.
//!
//! ```text
//! φ = h w,  x = φ·φ = θ²
//! R = I + A [φ]× + B [φ]×²        A = sin θ / θ      B = (1 − cos θ) / θ² = ½ (sin(θ/2) / (θ/2))²
//! p = V u,  V = I + B [φ]× + C [φ]×²                 C = (1 − A) / θ²
//! q = (cos(θ/2), s φ)             s = sin(θ/2) / θ
//! A = Σ (−x)ᵏ/(2k+1)!   B = Σ (−x)ᵏ/(2k+2)!   C = Σ (−x)ᵏ/(2k+3)!
//! ```
//! All of them are entire functions of `θ²`: series are used up to [`Scalar::SERIES`], so nothing is ever divided by a
//! small `‖w‖`, and values and gradients are smooth through zero. The half angle keeps `B` free of cancellation beyond.

use crate::scalar::Scalar;
use crate::vec3::{V3, add, add_scaled, scale};
use gs_core::real::{cross3, dot3};
use gs_core::rot::{conjugate, hamilton};

const TERMS: usize = 10;

/// `(−1)ᵏ wₖ / (2k + offset)!` with `wₖ = 1`, or `2k + 2` where the series is a divided difference.
const fn series(offset: usize, divided: bool) -> [f64; TERMS] {
    let mut out = [0.0; TERMS];
    let mut k = 0;
    while k < TERMS {
        let mut f = 1.0;
        let mut i = 2 * k + offset;
        while i > 1 {
            f *= i as f64;
            i -= 1;
        }
        let weight = if divided { (2 * k + 2) as f64 } else { 1.0 };
        out[k] = if k % 2 == 0 { weight / f } else { -weight / f };
        k += 1;
    }
    out
}

const SINC: [f64; TERMS] = series(1, false);
const SECOND: [f64; TERMS] = series(2, false);
const THIRD: [f64; TERMS] = series(3, false);
const D_SINC: [f64; TERMS] = series(3, true);
const D_SECOND: [f64; TERMS] = series(4, true);
const D_THIRD: [f64; TERMS] = series(5, true);

#[inline(always)]
fn horner<T: Scalar>(c: &[f64; TERMS], x: T) -> T {
    let mut sum = x.lit(c[T::TERMS - 1]);
    for k in (0..T::TERMS - 1).rev() {
        sum = sum.mul_add(x, x.lit(c[k]));
    }
    sum
}

/// A rotation vector `φ` and the functions of its angle.
#[derive(Clone, Copy)]
pub(crate) struct Rotation<T> {
    phi: V3<T>,
    theta2: T,
    /// `cos(θ/2)`, and `cos(θ/2) − 1` without cancellation.
    cos_half: T,
    cos_less_one: T,
    /// `s = sin(θ/2) / θ`.
    s: T,
    a: T,
    b: T,
}

impl<T: Scalar> Rotation<T> {
    #[inline(always)]
    pub(crate) fn new(phi: V3<T>) -> Self {
        let x = dot3(phi, phi);
        let quarter = x * x.lit(0.25);
        let one = x.lit(1.0);
        let (mut cos_less_one, mut sinc_half) = (-quarter * horner(&SECOND, quarter), horner(&SINC, quarter));
        if x.any_above(T::SERIES) {
            let limit = x.lit(T::SERIES);
            let half = x.max(limit).sqrt() * x.lit(0.5);
            let (sin, cos) = half.sin_cos();
            cos_less_one = limit.select_lt(x, cos - one, cos_less_one);
            sinc_half = limit.select_lt(x, sin / half, sinc_half);
        }
        let s = sinc_half * x.lit(0.5);
        let cos_half = one + cos_less_one;
        Self { phi, theta2: x, cos_half, cos_less_one, s, a: sinc_half * cos_half, b: s * sinc_half }
    }

    /// `C = (1 − A) / θ²`.
    #[inline(always)]
    fn third(&self) -> T {
        self.series_or(horner(&THIRD, self.theta2), self.theta2.lit(1.0) - self.a)
    }

    /// `series` up to the limit angle, `closed / θ²` beyond it.
    #[inline(always)]
    fn series_or(&self, series: T, closed: T) -> T {
        let x = self.theta2;
        if !x.any_above(T::SERIES) {
            return series;
        }
        let limit = x.lit(T::SERIES);
        limit.select_lt(x, closed / x.max(limit), series)
    }

    /// `κ = (½ cos(θ/2) − s) / θ²`.
    #[inline(always)]
    fn kappa(&self) -> T {
        let x = self.theta2;
        let series = horner(&D_SINC, x * x.lit(0.25)) * x.lit(-0.125);
        self.series_or(series, x.lit(0.5) * self.cos_half - self.s)
    }

    /// `B̃ = (A − 2B) / θ²`.
    #[inline(always)]
    fn second_slope(&self) -> T {
        self.series_or(-horner(&D_SECOND, self.theta2), self.a - self.b - self.b)
    }

    /// `C̃ = (B − 3C) / θ²`.
    #[inline(always)]
    fn third_slope(&self, c: T) -> T {
        self.series_or(-horner(&D_THIRD, self.theta2), self.b - self.theta2.lit(3.0) * c)
    }

    /// The unit quaternion `(w, x, y, z)`.
    #[inline(always)]
    pub(crate) fn quaternion(&self) -> [T; 4] {
        let [x, y, z] = scale(self.phi, self.s);
        [self.cos_half, x, y, z]
    }

    /// `quaternion ⊗ q`, computed as `q` plus a small change, so that rounding does not lengthen `q` step by step.
    #[inline(always)]
    pub(crate) fn rotate_quaternion(&self, q: [T; 4]) -> [T; 4] {
        let ([w, x, y, z], v) = (q, scale(self.phi, self.s));
        let [i, j, k] = add_scaled(add_scaled(cross3(v, [x, y, z]), w, v), self.cos_less_one, [x, y, z]);
        [w + (self.cos_less_one * w - dot3(v, [x, y, z])), x + i, y + j, z + k]
    }

    /// `R x`, the rotated vector.
    #[inline(always)]
    pub(crate) fn rotate(&self, x: V3<T>) -> V3<T> {
        add(x, cross3(self.phi, add_scaled(scale(x, self.a), self.b, cross3(self.phi, x))))
    }

    /// `Rᵀ x`, the inverse rotation.
    #[inline(always)]
    fn rotate_inverse(&self, x: V3<T>) -> V3<T> {
        add(x, cross3(self.phi, add_scaled(scale(x, -self.a), self.b, cross3(self.phi, x))))
    }

    /// `R x + V u − x`. `A` enters as `A − 1 = −θ² C`; the rounding error of `A` itself would bias every radius alike.
    #[inline(always)]
    pub(crate) fn displacement(&self, u: V3<T>, x: V3<T>) -> V3<T> {
        let c = self.third();
        let inner = cross3(self.phi, add_scaled(scale(x, self.b), c, u));
        let outer = add(inner, add_scaled(scale(x, -self.theta2 * c), self.b, u));
        add(add(u, cross3(self.phi, x)), cross3(self.phi, outer))
    }

    /// Gradient by `φ` from one by the quaternion:
    /// `−½ s g_w φ + s g_v + κ φ (φ·g_v)`.
    #[inline(always)]
    pub(crate) fn quaternion_backward(&self, d: [T; 4]) -> V3<T> {
        let v = [d[1], d[2], d[3]];
        let along = self.kappa() * dot3(self.phi, v) - self.theta2.lit(0.5) * self.s * d[0];
        add_scaled(scale(v, self.s), along, self.phi)
    }

    /// Cotangents `(d_x, d_u, d_φ)` of `R x + V u` from `λ` and the cotangent of the quaternion.
    ///
    /// ```text
    /// y = R x,  c₁ = φ×u,  c₂ = φ×c₁,  B̃ = (A − 2B)/θ²,  C̃ = (B − 3C)/θ²
    /// g_u = Vᵀλ      g_φ = Vᵀ(y×λ) + B u×λ + C [c₁×λ + u×(λ×φ)] + φ [B̃ λ·c₁ + C̃ λ·c₂] + quaternion_backward
    /// ```
    #[inline(always)]
    pub(crate) fn transform_backward(&self, u: V3<T>, x: V3<T>, lambda: V3<T>, d_q: [T; 4]) -> (V3<T>, V3<T>, V3<T>) {
        let (phi, c) = (self.phi, self.third());
        let c1 = cross3(phi, u);
        let c2 = cross3(phi, c1);
        let along = self.second_slope() * dot3(lambda, c1) + self.third_slope(c) * dot3(lambda, c2);
        let turned = self.left_transposed(cross3(self.rotate(x), lambda), c);
        let shifted = add_scaled(scale(cross3(u, lambda), self.b), c, cross3(c1, lambda));
        let shifted = add_scaled(shifted, c, cross3(u, cross3(lambda, phi)));
        let d_phi = add(add(turned, self.quaternion_backward(d_q)), add_scaled(shifted, along, phi));
        (self.rotate_inverse(lambda), self.left_transposed(lambda, c), d_phi)
    }

    /// `Vᵀ l` for `V` of the module header.
    #[inline(always)]
    fn left_transposed(&self, l: V3<T>, c: T) -> V3<T> {
        let once = cross3(self.phi, l);
        add_scaled(add_scaled(l, -self.b, once), c, cross3(self.phi, once))
    }
}

/// Cotangents `(d_q, d_d)` of `d ⊗ q` from `μ`.
#[inline(always)]
pub(crate) fn product_backward<T: Scalar>(d: [T; 4], q: [T; 4], mu: [T; 4]) -> ([T; 4], [T; 4]) {
    (hamilton(conjugate(d), mu), hamilton(mu, conjugate(q)))
}

#[cfg(test)]
mod tests {
    //! All functions of the angle, from 0 to past a full turn, against forty terms of their series: `f64` to 1e-13 and `f32`
    //! to 5e-7 of their value at zero. The switch to closed forms lies inside, so no jump is larger than twice that.

    use super::*;

    /// `[cos(θ/2), s, A, B, C, κ, B̃, C̃]`, the slopes as the gradients use them.
    fn functions<T: Scalar>(theta: T) -> [T; 8] {
        let zero = theta.lit(0.0);
        let r = Rotation::new([zero, theta, zero]);
        [r.cos_half, r.s, r.a, r.b, r.third(), r.kappa(), r.second_slope(), r.third_slope(r.third())]
    }

    /// `Σ (−x)ᵏ wₖ/(2k + offset)!`.
    fn sum(x: f64, offset: u32, divided: bool) -> f64 {
        let mut term = 1.0 / (1..=offset).map(f64::from).product::<f64>();
        let mut total = 0.0;
        for k in 0..40u32 {
            total += term * if divided { f64::from(2 * k + 2) } else { 1.0 };
            term *= -x / (f64::from(2 * k + offset + 1) * f64::from(2 * k + offset + 2));
        }
        total
    }

    fn truth(theta: f64) -> [f64; 8] {
        let (x, quarter) = (theta * theta, 0.25 * theta * theta);
        [
            sum(quarter, 0, false),
            0.5 * sum(quarter, 1, false),
            sum(x, 1, false),
            sum(x, 2, false),
            sum(x, 3, false),
            -0.125 * sum(quarter, 3, true),
            -sum(x, 4, true),
            -sum(x, 5, true),
        ]
    }

    #[test]
    fn functions_of_the_angle_are_right_on_both_sides_of_the_switch() {
        let edges = [0.0, 1e-12, 1e-8, 1e-3, 0.05, 1.0 - 1e-9, 1.0 + 1e-9, 3.1304, 3.1306];
        let more = (1..=66).map(|k| 0.1 * f64::from(k));
        let zero = truth(0.0);
        for theta in edges.into_iter().chain(more) {
            let (wide, narrow) = (functions(theta), functions(theta as f32));
            let (want, near) = (truth(theta), truth(f64::from(theta as f32)));
            for k in 0..8 {
                let (off, off32) = ((wide[k] - want[k]).abs(), (f64::from(narrow[k]) - near[k]).abs());
                assert!(off < 1e-13 * zero[k].abs(), "f64 {k} at {theta}: {} {}", wide[k], want[k]);
                assert!(off32 < 5e-7 * zero[k].abs(), "f32 {k} at {theta}: {} {}", narrow[k], near[k]);
            }
        }
    }

    #[test]
    fn half_and_full_turns_are_unit_quaternions() {
        use std::f64::consts::PI;
        for (theta, want) in [(PI, [0.0, 0.0, 1.0, 0.0]), (2.0 * PI, [-1.0, 0.0, 0.0, 0.0])] {
            let q = Rotation::new([0.0, theta, 0.0]).quaternion();
            assert!((0..4).all(|c| (q[c] - want[c]).abs() < 1e-15), "{q:?}");
            let q = Rotation::new([0.0, theta as f32, 0.0]).quaternion();
            assert!((0..4).all(|c| (f64::from(q[c]) - want[c]).abs() < 2e-7), "{q:?}");
        }
    }
}
