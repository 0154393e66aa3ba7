//! The Gaussian nearest to a kernel profile, for formats and viewers without other kernels.
//!
//! A projected splat has alpha `opacity · ψ(exp(−r²/2))` at `r` standard deviations. The least-squares fit over the plane
//! is the `a exp(−k r²/2)` that minimises `∫ (ψ − a gᵏ)² r dr`; with `r dr = −dg/g` all integrals are over `g` in 0..1 and `ψ` is
//! linear in pieces:
//! ```text
//! I(k) = ∫ ψ gᵏ⁻¹ dg     a(k) = 2k I(k)     k maximises 2k I(k)²
//! ```
//! Standard deviations are multiplied by `k^−½`, opacities by `a`.

use super::{Kernel, Profile};
use crate::Splats;

/// Half the interval of `ln k` that is searched.
const LOG_K_RANGE: f64 = 4.0;
/// Golden-section steps: they leave an interval of `2 LOG_K_RANGE · 0.618⁵⁰`.
const SEARCH_STEPS: usize = 50;

impl Profile<f64> {
    /// Factors of standard deviation and opacity of the nearest Gaussian.
    pub(crate) fn nearest_gaussian(&self) -> (f64, f64) {
        let (mut low, mut high) = (-LOG_K_RANGE, LOG_K_RANGE);
        let fit = |log_k: f64| (2.0 * log_k.exp()).sqrt() * self.overlap(log_k.exp());
        let golden = 0.5 * (5f64.sqrt() - 1.0);
        for _ in 0..SEARCH_STEPS {
            let (a, b) = (high - golden * (high - low), low + golden * (high - low));
            if fit(a) < fit(b) {
                low = a;
            } else {
                high = b;
            }
        }
        let k = (0.5 * (low + high)).exp();
        (k.powf(-0.5), 2.0 * k * self.overlap(k))
    }

    /// The integral `I(k)` of the module page.
    fn overlap(&self, k: f64) -> f64 {
        let p = if self.is_clamped() { 0.0 } else { 0.5 / (1.0 + self.kappa) };
        let knots = [0.0, p, 1.0 - p, 1.0];
        let piece = |ends: &[f64]| {
            let (a, b) = (ends[0], ends[1]);
            if b - a < 1e-12 {
                return 0.0;
            }
            // The line through two points inside the segment, away from its knots.
            let (g, h) = (a + 0.25 * (b - a), a + 0.75 * (b - a));
            let slope = (self.psi(h) - self.psi(g)) / (h - g);
            let start = self.psi(g) - slope * g;
            start * (b.powf(k) - a.powf(k)) / k + slope * (b.powf(k + 1.0) - a.powf(k + 1.0)) / (k + 1.0)
        };
        knots.windows(2).map(piece).sum()
    }
}

impl Splats {
    /// The same scene as Gaussians: each kernel profile becomes the Gaussian nearest to it, opacities at most 1.
    ///
    /// The fit minimises `∫ (ψ − a gᵏ)² r dr`; standard deviations are multiplied by `k^−½`, opacities by `a`.
    pub fn with_plain_kernel(mut self) -> Self {
        for row in 0..self.len() {
            let Some(bend) = self.kernel.bend(row) else { break };
            let (spread, strength) = bend.nearest_gaussian();
            self.scales[row] *= spread as f32;
            self.opacities[row] = (self.opacities[row] * strength as f32).min(1.0);
        }
        self.kernel = Kernel::Gaussian;
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `∫ (ψ − a gᵏ)² r dr` by the midpoint rule.
    fn distance(bend: &Profile<f64>, spread: f64, strength: f64) -> f64 {
        let dr = 1e-3;
        let at = |i: usize| {
            let r = (i as f64 + 0.5) * dr;
            let gauss = |s: f64| (-0.5 * (r / s).powi(2)).exp();
            (bend.psi(gauss(1.0)) - strength * gauss(spread)).powi(2) * r * dr
        };
        (0..8000).map(at).sum()
    }

    #[test]
    fn a_gaussian_is_its_own_nearest() {
        for bend in [Profile::frequency(0.5, 0.7), Profile::frequency(0.9, 0.0), Profile::acutance(0.0)] {
            let (spread, strength) = bend.nearest_gaussian();
            assert!((spread - 1.0).abs() < 1e-6 && (strength - 1.0).abs() < 1e-6, "{bend:?}: {spread} {strength}");
        }
    }

    #[test]
    fn nothing_nearby_is_nearer() {
        for bend in [
            Profile::frequency(0.9, 0.6),
            Profile::frequency(0.1, 0.4),
            Profile::acutance(0.6),
            Profile::acutance(-0.5),
        ] {
            let (spread, strength) = bend.nearest_gaussian();
            let best = distance(&bend, spread, strength);
            assert!(best < distance(&bend, 1.0, 1.0), "{bend:?}");
            for (s, a) in [(1.02, 1.0), (0.98, 1.0), (1.0, 1.02), (1.0, 0.98), (1.02, 0.98), (0.98, 1.02)] {
                assert!(best < distance(&bend, s * spread, a * strength), "{bend:?}: {s} {a}");
            }
        }
    }

    #[test]
    fn scenes_lose_their_kernel_and_stay_valid() {
        let mut splats = Splats {
            means: vec![glam::Vec3::ZERO; 2],
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 2],
            scales: vec![glam::Vec3::ONE; 2],
            opacities: vec![0.99, 0.5],
            color: crate::Color::Rgb(vec![[0.5; 3]; 2]),
            kernel: Kernel::Acutance { acutances: vec![0.8, -0.8] },
        };
        splats = splats.with_plain_kernel();
        splats.check().unwrap();
        assert_eq!(splats.kernel, Kernel::Gaussian);
        assert!(splats.scales[0] != splats.scales[1]);
    }
}
