//! How much an anchor moves: two factors from its logits `d_G` (position) and `d_L` (feature, offsets, scales).
//!
//! ```text
//! mask   M(d) = 1 if σ(d) > threshold, else 0        backward as if M were σ (straight-through)
//! mul    M(d) = act(d)                               act: σ, tanh or relu
//! ```
//! A shared logit gives both factors; anchors without logits have factors of one. A closed mask still has a gradient
//! and can open again.
//!
//! A sparsity loss keeps anchors static unless the images need motion: the mean of `σ(d)`, of `−σ ln σ`, or of
//! `σ(d_G)`.
//!
//! ```
//! use gs_anchor::gad::Dynamics;
//!
//! let [global, local] = Dynamics::default().weights(&[0.0, 0.0]);
//! assert_eq!((global.value, local.value), (1.0, 0.5), "an open mask and a weight of one half at the start");
//! assert_eq!(global.slope, 0.25, "the mask's gradient is that of the sigmoid");
//! ```

use crate::Anchors;
use gs_core::cast;
use serde::{Deserialize, Serialize};

/// How a logit scales a displacement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Factor {
    /// By 0 or 1: 1 if `σ(d)` is above [`Dynamics::threshold`].
    Mask,
    /// By [`Dynamics::activation`] of the logit.
    Mul,
}

/// The function from a logit to a factor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Activation {
    /// `1 / (1 + e⁻ᵈ)`.
    #[default]
    Sigmoid,
    /// `max(d, 0)`; a logit at or below zero has no gradient.
    Relu,
    /// `tanh d`; zero at zero.
    Tanh,
}

/// Settings of the factors; the defaults are the published ones. How many logits there are is
/// [`AnchorShape::dynamics`](crate::AnchorShape::dynamics).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Dynamics {
    /// Factor on the displacement of the position.
    pub global: Factor,
    /// Factor on the changes of feature, offsets and scales.
    pub local: Factor,
    /// A mask is open if `σ(d)` is above this; 0 … 1.
    pub threshold: f32,
    /// Function of the logit in [`Factor::Mul`].
    pub activation: Activation,
}

impl Default for Dynamics {
    fn default() -> Self {
        Self { global: Factor::Mask, local: Factor::Mul, threshold: 0.01, activation: Activation::Sigmoid }
    }
}

/// A factor and its derivative with respect to the logit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weight {
    /// The factor on the displacement.
    pub value: f32,
    /// Derivative of `value`; for a mask that of `σ`.
    pub slope: f32,
}

/// The factor without a logit.
const UNGATED: Weight = Weight { value: 1.0, slope: 0.0 };

impl Dynamics {
    /// Global and local factor of an anchor with these logits: none, one (shared) or two.
    pub fn weights(&self, logits: &[f32]) -> [Weight; 2] {
        match logits {
            [] => [UNGATED; 2],
            [d, rest @ ..] => [self.weight(self.global, *d), self.weight(self.local, *rest.first().unwrap_or(d))],
        }
    }

    fn weight(&self, factor: Factor, d: f32) -> Weight {
        let s = sigmoid(d.into());
        let (sigma, slope) = (cast::to_f32(s), cast::to_f32(s * (1.0 - s)));
        match (factor, self.activation) {
            (Factor::Mask, _) => Weight { value: if sigma > self.threshold { 1.0 } else { 0.0 }, slope },
            (Factor::Mul, Activation::Sigmoid) => Weight { value: sigma, slope },
            (Factor::Mul, Activation::Relu) => Weight { value: d.max(0.0), slope: if d > 0.0 { 1.0 } else { 0.0 } },
            (Factor::Mul, Activation::Tanh) => Weight { value: d.tanh(), slope: 1.0 - d.tanh() * d.tanh() },
        }
    }
}

/// Backward of [`Dynamics::weights`]: adds to the cotangents of the logits, of which there are none, one or two.
pub(super) fn weights_backward(weights: [Weight; 2], d: [f32; 2], d_logits: &mut [f32]) {
    for (i, (weight, d)) in weights.iter().zip(d).enumerate() {
        let last = d_logits.len().saturating_sub(1);
        if let Some(logit) = d_logits.get_mut(i.min(last)) {
            *logit += weight.slope * d;
        }
    }
}

/// The sparsity loss on motion, a mean over all anchors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sparsity {
    /// Mean of `σ(d)` over all logits.
    Mean,
    /// Mean of `−σ ln σ` over all logits.
    Entropy,
    /// Mean of `σ(d_G)` over the global logits.
    Global,
}

impl Sparsity {
    /// Adds the gradient of `weight` times the loss to the logits; returns that weighted value, zero without logits.
    pub fn penalise(self, anchors: &mut Anchors, weight: f32) -> f32 {
        let (width, n) = (anchors.shape().dynamics, anchors.len());
        let Some(dynamics) = &mut anchors.dynamics else { return 0.0 };
        let step = if self == Sparsity::Global { width } else { 1 };
        let count = (n * width / step).max(1) as f64;
        let mut total = 0.0;
        for (d, grad) in dynamics.value.iter().zip(&mut dynamics.grad).step_by(step) {
            let d = f64::from(*d);
            let s = sigmoid(d);
            // ln σ without the underflow of σ.
            let log = d.min(0.0) - (-d.abs()).exp().ln_1p();
            let (value, by_sigma) = if self == Sparsity::Entropy { (-s * log, -log - 1.0) } else { (s, 1.0) };
            total += value;
            *grad += cast::to_f32(f64::from(weight) / count * by_sigma * s * (1.0 - s));
        }
        cast::to_f32(f64::from(weight) * total / count)
    }
}

fn sigmoid(d: f64) -> f64 {
    1.0 / (1.0 + (-d).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AnchorShape;
    use glam::Vec3;

    #[test]
    fn published_factors_start_open_and_half() {
        let start = Dynamics::default().weights(&[0.0, 0.0]);
        assert_eq!(start, [Weight { value: 1.0, slope: 0.25 }, Weight { value: 0.5, slope: 0.25 }]);
        assert_eq!(Dynamics::default().weights(&[0.0]), start, "one logit serves both");
        assert_eq!(Dynamics::default().weights(&[]), [UNGATED; 2]);
        // ln(0.01 / 0.99) = −4.5951.
        let mask = |d: f32| Dynamics::default().weights(&[d, 0.0])[0];
        assert_eq!((mask(-4.595).value, mask(-4.596).value), (1.0, 0.0));
        assert!(mask(-4.596).slope > 0.0, "a closed mask still has a gradient");
    }

    /// Slopes of weights against central differences; the mask's is that of the logistic.
    #[test]
    fn slopes_are_derivatives() {
        for activation in [Activation::Sigmoid, Activation::Relu, Activation::Tanh] {
            let dynamics = Dynamics { activation, global: Factor::Mul, local: Factor::Mask, ..Dynamics::default() };
            let value = |d: f64| match activation {
                Activation::Sigmoid => sigmoid(d),
                Activation::Relu => d.max(0.0),
                Activation::Tanh => d.tanh(),
            };
            for d in [-6.0f32, -0.7, 0.3, 2.0] {
                let [mul, mask] = dynamics.weights(&[d]);
                let difference = |f: &dyn Fn(f64) -> f64| (f(f64::from(d) + 1e-5) - f(f64::from(d) - 1e-5)) / 2e-5;
                assert!((f64::from(mul.value) - value(d.into())).abs() < 1e-7);
                assert!((f64::from(mul.slope) - difference(&value)).abs() < 1e-6, "{activation:?} at {d}");
                assert!((f64::from(mask.slope) - difference(&sigmoid)).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn logits_collect_the_cotangents_of_their_factors() {
        let weights = [Weight { value: 1.0, slope: 0.5 }, Weight { value: 1.0, slope: 0.25 }];
        let (mut two, mut one, mut none) = ([1.0, 1.0], [1.0], []);
        weights_backward(weights, [2.0, 4.0], &mut two);
        weights_backward(weights, [2.0, 4.0], &mut one);
        weights_backward(weights, [2.0, 4.0], &mut none);
        assert_eq!((two, one), ([2.0, 2.0], [3.0]));
    }

    #[test]
    fn penalties_and_their_gradients() {
        let logits = [-900.0, -2.0, 0.5, 900.0, 0.0, 1.5];
        for sparsity in [Sparsity::Mean, Sparsity::Entropy, Sparsity::Global] {
            let shape = AnchorShape { offsets: 1, features: 1, dynamics: 2 };
            let mut anchors = Anchors::new(shape, &[Vec3::ZERO; 3], &[0.0; 3]);
            let step = if sparsity == Sparsity::Global { 2 } else { 1 };
            let term = |d: f64| match (sparsity, sigmoid(d)) {
                (Sparsity::Entropy, s) if s > 0.0 => -s * s.ln(),
                (_, s) => s,
            };
            let loss = |d: &[f64]| 0.3 * d.iter().step_by(step).map(|d| term(*d)).sum::<f64>() / (6 / step) as f64;
            if let Some(p) = &mut anchors.dynamics {
                p.value = logits.iter().map(|d| *d as f32).collect();
            }
            let value = sparsity.penalise(&mut anchors, 0.3);
            assert!((f64::from(value) - loss(&logits)).abs() < 1e-7, "{sparsity:?}");
            for (i, g) in anchors.dynamics.unwrap().grad.iter().enumerate() {
                let at =
                    |by: f64| loss(&std::array::from_fn::<f64, 6, _>(|k| logits[k] + if k == i { by } else { 0.0 }));
                let want = (at(1e-5) - at(-1e-5)) / 2e-5;
                assert!((f64::from(*g) - want).abs() < 1e-8, "{sparsity:?}: logit {i}: {g} {want}");
            }
        }
        let still = AnchorShape { offsets: 1, features: 1, dynamics: 0 };
        assert_eq!(Sparsity::Mean.penalise(&mut Anchors::new(still, &[Vec3::ZERO], &[0.0]), 1.0), 0.0);
    }
}
