//! Annealed smooth training (Yang et al. 2024, Eq. 5): times of real captures are off by a little, so early steps see
//! them blurred, all splats of a step by the same draw.
//!
//! ```text
//! t' = t + N(0, 1) · β(step) · Δt      β falls linearly from 0.1 to 0 over 20 000 steps
//! ```

use gs_core::{Rng, Time};
use serde::{Deserialize, Serialize};

/// Strength and length of the blur; off (no blur) where `strength` is 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Anneal {
    /// β at step 0.
    pub strength: f32,
    /// Step at which β reaches 0.
    pub steps: u32,
}

impl Default for Anneal {
    fn default() -> Self {
        Self { strength: 0.1, steps: 20_000 }
    }
}

/// The time to train step `step` with instead of `t`; `interval` is the spacing of training times (the reference takes
/// 1 / number of images). Only the normalised reading moves, which is all that fields see.
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
    fn the_blur_shrinks_to_nothing_and_is_reproducible() {
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
