//! Activation functions: ReLU, and SiLU with its first two derivatives.
//!
//! ```text
//! relu(z) = max(z, 0)
//! silu(z) = z σ(z)      silu' = σ (1 + z (1 − σ))      silu'' = σ (1 − σ) (2 + z (1 − 2σ))      σ = 1 / (1 + e⁻ᶻ)
//! ```
//! SiLU (Elfwing et al. 2018, "Sigmoid-weighted linear units") is smooth, so a network with it can be differentiated
//! twice, as losses on derivatives of a field need. Its exponential is a polynomial of plain products and sums: the same
//! bits on every instruction set.
//!
//! ```
//! use gs_core::nn::{Activation, activation::scale};
//!
//! let (mut y, mut slope, mut dy) = ([-1.0, 2.0], [0.0; 2], [3.0, 3.0]);
//! Activation::Relu.apply(&mut y, &mut slope); // forward, in place
//! scale(&slope, &mut dy); // backward
//! assert_eq!((y, dy), ([0.0, 2.0], [0.0, 3.0]));
//! ```

use fearless_simd::{Level, Simd, dispatch};
use serde::{Deserialize, Serialize};

/// The activation function of a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Activation {
    /// `max(z, 0)`; its slope at the kink is 0.
    #[default]
    Relu,
    /// `z σ(z)`, also known as swish.
    Silu,
}

impl Activation {
    /// Forward: `y = φ(y)` in place; writes the derivative `φ'` to `slope` (same length).
    pub fn apply(self, y: &mut [f32], slope: &mut [f32]) {
        dispatch!(Level::new(), simd => match self {
            Self::Relu => apply_relu(simd, y, slope),
            Self::Silu => apply_silu(simd, y, slope),
        });
    }

    /// As [`Activation::apply`]; also writes the second derivative `φ''` to `curvature`.
    pub(super) fn apply_twice(self, y: &mut [f32], slope: &mut [f32], curvature: &mut [f32]) {
        match self {
            Self::Relu => {
                self.apply(y, slope);
                curvature.fill(0.0);
            }
            Self::Silu => dispatch!(Level::new(), simd => apply_silu_twice(simd, y, slope, curvature)),
        }
    }
}

/// Backward of [`Activation::apply`], in place: `d *= slope`.
pub fn scale(slope: &[f32], d: &mut [f32]) {
    dispatch!(Level::new(), simd => multiply(simd, slope, d));
}

#[inline(always)]
fn multiply<S: Simd>(_: S, slope: &[f32], d: &mut [f32]) {
    d.iter_mut().zip(slope).for_each(|(d, s)| *d *= s);
}

#[inline(always)]
fn apply_relu<S: Simd>(_: S, y: &mut [f32], slope: &mut [f32]) {
    for (y, slope) in y.iter_mut().zip(slope) {
        *slope = if *y > 0.0 { 1.0 } else { 0.0 };
        *y = y.max(0.0);
    }
}

#[inline(always)]
fn apply_silu<S: Simd>(_: S, y: &mut [f32], slope: &mut [f32]) {
    for (y, slope) in y.iter_mut().zip(slope) {
        let (z, [s, c]) = (*y, sigmoid_pair(*y));
        *y = z * s;
        *slope = s * (1.0 + z * c);
    }
}

#[inline(always)]
fn apply_silu_twice<S: Simd>(_: S, y: &mut [f32], slope: &mut [f32], curvature: &mut [f32]) {
    for ((y, slope), curvature) in y.iter_mut().zip(slope).zip(curvature) {
        let (z, [s, c]) = (*y, sigmoid_pair(*y));
        *y = z * s;
        *slope = s * (1.0 + z * c);
        *curvature = s * c * (2.0 + z * (c - s));
    }
}

/// `σ(z)` and `1 − σ(z)` without cancellation; `z` is clamped to ±87.
#[inline(always)]
fn sigmoid_pair(z: f32) -> [f32; 2] {
    let e = exp((-z).clamp(-87.0, 87.0));
    let s = 1.0 / (1.0 + e);
    [s, e * s]
}

/// `eˣ` for `|x| ≤ 87`: `x = n ln 2 + r`, a polynomial of degree 6 in `r` (|r| ≤ ½ ln 2), `n` added to the exponent bits.
#[inline(always)]
fn exp(x: f32) -> f32 {
    /// 1.5 · 2²³: adding it rounds to an integer, held in the lowest bits.
    const ROUND: f32 = 12_582_912.0;
    /// ln 2 in two parts; products of the first with integers up to 2¹⁴ are exact.
    const LN2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
    let shifted = x * std::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = x - n * LN2[0] - n * LN2[1];
    let tail = 1.0 / 120.0 + r * (1.0 / 720.0);
    let p = 1.0 + r * (1.0 + r * (0.5 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * tail))));
    f32::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 23))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// f32 against f64, relative to 1 + |value|.
    const TOLERANCE: f64 = 3e-7;

    fn silu(z: f64) -> [f64; 3] {
        let s = 1.0 / (1.0 + (-z).exp());
        [z * s, s * (1.0 + z * (1.0 - s)), s * (1.0 - s) * (2.0 + z * (1.0 - 2.0 * s))]
    }

    #[test]
    fn derivatives_are_those_of_the_function() {
        for i in -60..=60 {
            let (z, h) = (f64::from(i) * 0.13, 1e-5);
            let [_, slope, curvature] = silu(z);
            assert!(((silu(z + h)[0] - silu(z - h)[0]) / (2.0 * h) - slope).abs() < 1e-9);
            assert!(((silu(z + h)[1] - silu(z - h)[1]) / (2.0 * h) - curvature).abs() < 1e-9);
        }
    }

    #[test]
    fn silu_agrees_with_f64_for_small_and_large_values() {
        let z: Vec<f32> = (-2000..=2000).map(|i| i as f32 * 0.05).chain([1e-20, -1e-20, 0.0, 1e4, -1e4]).collect();
        let (mut y, mut slope, mut curvature) = (z.clone(), vec![0.0; z.len()], vec![0.0; z.len()]);
        Activation::Silu.apply_twice(&mut y, &mut slope, &mut curvature);
        let (mut once, mut slope_once) = (z.clone(), vec![0.0; z.len()]);
        Activation::Silu.apply(&mut once, &mut slope_once);
        assert_eq!((&once, &slope_once), (&y, &slope), "both ways give the same bits");
        for (i, z) in z.iter().enumerate() {
            for (got, want) in [y[i], slope[i], curvature[i]].into_iter().zip(silu(f64::from(*z))) {
                assert!((f64::from(got) - want).abs() <= TOLERANCE * (1.0 + want.abs()), "z = {z}: {got} {want}");
            }
        }
    }

    #[test]
    fn relu_has_no_slope_at_its_kink() {
        let (mut y, mut slope, mut curvature) = ([-1.0, 0.0, 2.0], [7.0; 3], [7.0; 3]);
        Activation::Relu.apply_twice(&mut y, &mut slope, &mut curvature);
        assert_eq!((y, slope, curvature), ([0.0, 0.0, 2.0], [0.0, 0.0, 1.0], [0.0; 3]));
        let mut d = [3.0, 4.0, 5.0];
        scale(&slope, &mut d);
        assert_eq!(d, [0.0, 0.0, 5.0]);
    }
}
