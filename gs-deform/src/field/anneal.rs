//! Annealed smooth training (Yang et al. 2024, Eq. 5): timestamps of real captures are inexact, so early steps add
//! noise to them, one sample per step for all splats.
//!
//! ```text
//! t' = t + N(0, 1) · β(step) · Δt      β falls linearly from 0.1 to 0 over 20 000 steps
//! ```
//! ```
//! use gs_core::Time;
//! use gs_deform::field::anneal::{Anneal, smooth_time};
//!
//! let (anneal, t) = (Anneal::default(), Time::new(0.5)?);
//! assert_ne!(smooth_time(t, 0.01, &anneal, 1, 100), t);
//! assert_eq!(smooth_time(t, 0.01, &anneal, 1, 20_000), t, "the noise has ended");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use gs_core::{Rng, Time};
use serde::{Deserialize, Serialize};

/// Strength and length of the noise on timestamps; a `strength` of 0 turns it off.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Anneal {
    /// β at step 0, in units of the spacing of training times.
    pub strength: f32,
    /// Training step at which β reaches 0.
    pub steps: u32,
}

impl Default for Anneal {
    fn default() -> Self {
        Self { strength: 0.1, steps: 20_000 }
    }
}

/// The timestamp that training step `step` uses instead of `t`. `interval` is the spacing Δt of the training times,
/// normalised (the reference takes 1 / number of images). Only the normalised time changes; fields read nothing else.
pub fn smooth_time(t: Time, interval: f32, anneal: &Anneal, seed: u64, step: u32) -> Time {
    if step >= anneal.steps || anneal.strength == 0.0 {
        return t;
    }
    let beta = anneal.strength * (1.0 - step as f32 / anneal.steps as f32);
    let shift = Rng::new(seed, "deform.anneal", step, 0).normal() * beta * interval;
    Time { normalised: t.normalised + shift, ..t }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_noise_falls_to_zero_and_is_reproducible() {
        let (anneal, t) = (Anneal::default(), Time::default());
        let spread = |first: u32| -> f32 {
            let shifts = (first..first + 1000).map(|step| smooth_time(t, 0.5, &anneal, 1, step).normalised.powi(2));
            (shifts.sum::<f32>() / 1000.0).sqrt()
        };
        assert!((spread(0) - 0.049).abs() < 0.004, "{}", spread(0));
        assert!((spread(15_000) - 0.012).abs() < 0.002, "{}", spread(15_000));
        assert_eq!(smooth_time(t, 0.5, &anneal, 1, 20_000), t);
        assert_eq!(smooth_time(t, 0.5, &Anneal { strength: 0.0, ..anneal }, 1, 0), t);
        assert_eq!(smooth_time(t, 0.5, &anneal, 1, 7), smooth_time(t, 0.5, &anneal, 1, 7));
        assert_ne!(smooth_time(t, 0.5, &anneal, 1, 7), smooth_time(t, 0.5, &anneal, 2, 7));
    }
}
