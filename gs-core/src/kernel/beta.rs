//! The effective β that a splat is rendered with, from the β that is learnt.
//!
//! The outer slope of the frequency kernel grows without bound as `D = ½ + λ − β → 0⁺`, and the support is unbounded for
//! `D ≤ 0`. `β_max(λ) = (1 − 2 p) (½ + λ)` keeps the knot at or above `p = 0.01`: slope at most 50, partials at most 25.

/// Smallest position of the lower knot under [`BetaMode::Capped`] and [`BetaMode::Relative`].
const MIN_KNOT: f64 = 0.01;

/// How `β ≥ ½ + λ` is avoided, where the profile would be singular.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[cfg_attr(feature = "io", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "lowercase"))]
pub enum BetaMode {
    /// `β_eff = min(β, β_max)`: as published wherever the knot lies above 0.01.
    #[default]
    Capped,
    /// `β_eff = β`: the published formula with its clamped knots. Splats beyond
    /// `½ + λ` never decay and end at `RasterOptions::kernel_cut`.
    Literal,
    /// `β_eff = β · min(1, β_max)`: no dead zone, but β no longer compares with the published one.
    Relative,
}

fn beta_max(lambda: f64) -> f64 {
    (1.0 - 2.0 * MIN_KNOT) * (0.5 + lambda)
}

/// The β that a splat is rendered with. Domain: `λ, β ∈ [0, 1]`.
pub fn effective_beta(mode: BetaMode, lambda: f64, beta: f64) -> f64 {
    match mode {
        BetaMode::Literal => beta,
        BetaMode::Capped => beta.min(beta_max(lambda)),
        BetaMode::Relative => beta * beta_max(lambda).min(1.0),
    }
}

/// `[dL/dλ, dL/dβ]` through [`effective_beta`] from `dL/dβ_eff`; the derivative of the branch taken.
pub(crate) fn effective_beta_vjp(mode: BetaMode, lambda: f64, beta: f64, d: f64) -> [f64; 2] {
    let (max, rise) = (beta_max(lambda), 1.0 - 2.0 * MIN_KNOT);
    match mode {
        BetaMode::Capped if beta >= max => [rise * d, 0.0],
        BetaMode::Relative if max < 1.0 => [rise * beta * d, max * d],
        _ => [0.0, d],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;

    #[test]
    fn the_cap_holds_the_knot_and_leaves_smaller_betas() {
        assert_eq!(effective_beta(BetaMode::Capped, 0.5, 0.5), 0.5);
        assert!((effective_beta(BetaMode::Capped, 0.1, 0.7) - 0.588).abs() < 1e-15);
        assert_eq!(effective_beta(BetaMode::Literal, 0.1, 0.7), 0.7);
        assert!((effective_beta(BetaMode::Relative, 0.1, 0.5) - 0.294).abs() < 1e-15);
        assert_eq!(effective_beta(BetaMode::Relative, 0.9, 0.5), 0.5);
    }

    /// Central differences, on each branch but not where they join.
    #[test]
    fn vjps_match_differences() {
        let mut rng = Rng::new(3, "effective beta", 0, 0);
        let h = 1e-6;
        for mode in [BetaMode::Capped, BetaMode::Literal, BetaMode::Relative] {
            for _ in 0..2000 {
                let [l, b] = std::array::from_fn(|_| f64::from(rng.range(0.0, 1.0)));
                let join = if mode == BetaMode::Capped { b } else { 1.0 };
                if (join - beta_max(l)).abs() < 1e-5 {
                    continue;
                }
                let f = |l: f64, b: f64| effective_beta(mode, l, b);
                let want = [(f(l + h, b) - f(l - h, b)) / (2.0 * h), (f(l, b + h) - f(l, b - h)) / (2.0 * h)];
                let got = effective_beta_vjp(mode, l, b, 1.0);
                assert!((0..2).all(|i| (got[i] - want[i]).abs() < 1e-8), "{mode:?} {l} {b}: {got:?} {want:?}");
            }
        }
    }

    #[cfg(feature = "io")]
    #[test]
    fn modes_have_lower_case_names() {
        let read = |name: &str| serde_json::from_str::<BetaMode>(name).expect("a mode");
        assert_eq!((read("\"capped\""), read("\"literal\"")), (BetaMode::Capped, BetaMode::Literal));
        assert_eq!(serde_json::to_string(&BetaMode::Relative).expect("text"), "\"relative\"");
    }
}
