//! How many derivatives a trajectory deserves, told from samples of it.
//!
//! Polynomials of degree 0 (rests) … 3 (with jerk) are fitted to the positions of a particle; Akaike's criterion,
//! corrected for few samples, weighs what a degree explains against what it costs:
//!
//! ```text
//! AICc = N ln(RSS/N + σ²) + 2K + 2K(K+1)/(N−K−1)        N = 3 samples,  K = 3 (degree + 1) + 1
//! ```
//! `σ` is the noise below which residuals mean nothing. Degrees are added by Gram–Schmidt on the sample times, so no
//! equations are solved.

/// Degrees tried.
const DEGREES: usize = 4;

/// What a trajectory was found to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrderChoice {
    /// 0 rests, 1 constant velocity, 2 constant acceleration, 3 with jerk.
    pub order: u8,
    /// Root mean squared residual per coordinate under every order, world units; NaN for those with too few samples.
    pub residuals: [f64; DEGREES],
}

/// The order of the trajectory with positions (or displacements) at `times`; rows beyond the shorter of the two are not
/// read. `noise` is in world units. One sample or none rests.
pub fn choose_order(times: &[f64], positions: &[[f64; 3]], noise: f64) -> OrderChoice {
    let n = times.len().min(positions.len());
    let mut choice = OrderChoice { order: 0, residuals: [f64::NAN; DEGREES] };
    let mut left = positions[..n].to_vec();
    let mut basis: Vec<Vec<f64>> = Vec::new();
    let mut best = f64::INFINITY;
    for (degree, residual) in choice.residuals.iter_mut().enumerate() {
        let (count, parameters) = (3.0 * n as f64, 3.0 * (degree + 1) as f64 + 1.0);
        let Some(next) = orthonormal(times, &basis).filter(|_| count - parameters > 1.0) else { break };
        for c in 0..3 {
            let along: f64 = left.iter().zip(&next).map(|(x, b)| x[c] * b).sum();
            left.iter_mut().zip(&next).for_each(|(x, b)| x[c] -= along * b);
        }
        basis.push(next);
        let square = left.iter().flatten().map(|r| r * r).sum::<f64>() / count;
        *residual = square.sqrt();
        let penalty = 2.0 * parameters * (1.0 + (parameters + 1.0) / (count - parameters - 1.0));
        let score = count * (square + noise * noise).max(f64::MIN_POSITIVE).ln() + penalty;
        if score < best {
            (best, choice.order) = (score, degree as u8);
        }
    }
    choice
}

/// The next polynomial on the sample times (taken to about `[−1, 1]`), orthonormal to those before; `None` if the times
/// are too few to tell it from them.
fn orthonormal(times: &[f64], before: &[Vec<f64>]) -> Option<Vec<f64>> {
    let (low, high) = times.iter().fold((f64::MAX, f64::MIN), |(l, h), t| (l.min(*t), h.max(*t)));
    let (middle, half) = (0.5 * (low + high), (0.5 * (high - low)).max(f64::MIN_POSITIVE));
    let mut p: Vec<f64> = times.iter().map(|t| ((t - middle) / half).powi(before.len() as i32)).collect();
    // Twice is enough for orthogonality to rounding.
    for b in before.iter().chain(before) {
        let along: f64 = p.iter().zip(b).map(|(p, b)| p * b).sum();
        p.iter_mut().zip(b).for_each(|(p, b)| *p -= along * b);
    }
    let norm = p.iter().map(|v| v * v).sum::<f64>().sqrt();
    (norm > 1e-9).then(|| p.iter().map(|v| v / norm).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    /// Paths of each order under noise of 1e-3 are told apart nearly always; never is a higher order missed.
    #[test]
    fn orders_are_found_under_noise() {
        let mut rng = Rng::new(1, "order", 0, 0);
        let times: Vec<f64> = (0..24).map(|k| 0.3 + f64::from(k) / 60.0).collect();
        for order in 0..4u8 {
            let mut found = [0; 4];
            for _ in 0..200 {
                let k: Vec<[f64; 3]> =
                    (0..4).map(|_| std::array::from_fn(|_| f64::from(rng.normal()).signum() * 1.5)).collect();
                let at = |t: f64, c: usize| {
                    let s = t - 0.5;
                    (0..=usize::from(order)).map(|p| k[p][c] * s.powi(p as i32)).sum::<f64>()
                };
                let sample = |t: &f64| std::array::from_fn(|c| at(*t, c) + 1e-3 * f64::from(rng.normal()));
                let samples: Vec<[f64; 3]> = times.iter().map(sample).collect();
                let choice = choose_order(&times, &samples, 0.0);
                found[usize::from(choice.order)] += 1;
                assert!(choice.residuals.is_sorted_by(|a, b| a >= b));
                assert!((choice.residuals[usize::from(order)] - 1e-3).abs() < 4e-4, "{choice:?}");
            }
            assert!(found[..usize::from(order)].iter().all(|n| *n == 0), "{order}: {found:?}");
            assert!(found[usize::from(order)] > 150, "{order}: {found:?}");
        }
    }

    #[test]
    fn noise_levels_small_residuals_and_few_samples_ask_for_little() {
        let times = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5];
        let bend = times.map(|t| [t + 1e-4 * t * t, 0.0, 0.0]);
        assert_eq!(choose_order(&times, &bend, 0.0).order, 2);
        assert_eq!(choose_order(&times, &bend, 1e-3).order, 1);
        assert_eq!(choose_order(&[], &[], 0.0).order, 0);
        let two = choose_order(&times[..2], &bend[..2], 1e-3);
        assert!(two.order == 0 && two.residuals[2].is_nan(), "{two:?}");
        let same = choose_order(&[0.5; 6], &bend, 0.0);
        assert!(same.order == 0 && same.residuals[1].is_nan(), "{same:?}");
    }
}
