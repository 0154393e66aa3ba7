//! The penalty on changes of features, offsets and scales.
//!
//! An interval is seen in few views, and what is its own is learnt from these alone. The penalty keeps such changes small
//! unless the images ask for more:
//!
//! ```text
//! P = w Σ_h 1/(V n_h) Σ_v ‖m_v Δ_hv / u_h‖²     h: features, offsets, scales, n_h values each, of V anchors
//! u_h = exp(mean λ) for scales, 1 otherwise      g_(mΔ) += 2 w/(V n_h u_h²) m Δ
//! ```
//! `w` is [`GadConfig::change_l2`](super::GadConfig::change_l2), times the share of the caller. `Δl` is in world units; in
//! units of the geometric mean of all scales it is, to first order, the change of the log-scale of an anchor of typical
//! size. (In units of its own scale an anchor of hardly any size would outweigh all others.) The unit counts as a constant.
//! Positions are not penalised.

use super::{Gad, GadHead, Weight};
use crate::Anchors;
use gs_core::cast;

impl Gad {
    /// `w/(V n u²)` of each head, in the order of the heads; 0: not penalised.
    pub(super) fn change_factors(&self, anchors: &Anchors, share: f32) -> [f32; GadHead::ALL.len()] {
        let weight = f64::from(self.config.change_l2) * f64::from(share);
        let mut factors = [0.0; GadHead::ALL.len()];
        if weight == 0.0 {
            return factors;
        }
        for (factor, head) in factors.iter_mut().zip(&self.config.heads) {
            let unit = match head {
                GadHead::Positions => continue,
                GadHead::Features | GadHead::Offsets => 1.0,
                GadHead::Scales => typical_scale(anchors),
            };
            let count = (anchors.len() * head.width(anchors.shape())).max(1) as f64;
            *factor = cast::to_f32(weight / (count * unit * unit));
        }
        factors
    }
}

/// Geometric mean of all scales, world units; 1 without anchors.
fn typical_scale(anchors: &Anchors) -> f64 {
    let logs = &anchors.log_scales.value;
    (logs.iter().map(|l| f64::from(*l)).sum::<f64>() / logs.len().max(1) as f64).exp()
}

/// Adds `2 factor m Δ` to the cotangents `d` of a column, `[rows, width]`; returns `factor Σ (m Δ)²`.
pub(super) fn penalise(factor: f32, width: usize, deltas: &[f32], weights: &[[Weight; 2]], d: &mut [f32]) -> f64 {
    let mut sum = 0.0;
    for ((row, d), [_, local]) in deltas.chunks_exact(width).zip(d.chunks_exact_mut(width)).zip(weights) {
        for (delta, d) in row.iter().zip(d) {
            let change = local.value * delta;
            sum += f64::from(change) * f64::from(change);
            *d += 2.0 * factor * change;
        }
    }
    f64::from(factor) * sum
}
