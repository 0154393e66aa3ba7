//! Kernel profiles against stored values, the published three-segment formula, finite differences and quadrature.

use super::*;
use crate::Rng;

/// FAGS eq. 3 as published, knots clamped.
fn published(l: f64, b: f64, g: f64) -> f64 {
    let (r, d) = (0.5 + l, 0.5 + l - b);
    let k = (0.5 + l - 0.5 * b - l * b) / d;
    let (low, high) = ((d / (1.0 + 2.0 * l)).max(0.0), ((0.5 + l + b) / (1.0 + 2.0 * l)).min(1.0));
    if g < low {
        k * g
    } else if g <= high {
        r * g + 0.25 - 0.5 * l
    } else {
        k * (g - 1.0) + 1.0
    }
}

fn close(got: f64, want: f64, tolerance: f64) -> bool {
    (got - want).abs() <= tolerance * want.abs().max(1.0)
}

fn pairs(n: u64) -> impl Iterator<Item = [f64; 3]> {
    (0..n).map(|i| {
        let mut rng = Rng::new(11, "kernel", 0, i);
        std::array::from_fn(|_| f64::from(rng.range(0.0, 1.0)))
    })
}

/// `(λ, β, g) → ψ, dψ/dg, ∂ψ/∂λ, ∂ψ/∂β`.
const GOLDEN: [[f64; 7]; 7] = [
    [0.9, 0.5, 0.05, 0.038888889, 0.777777778, -0.015432099, -0.034567901],
    [0.9, 0.5, 0.40, 0.36, 1.4, -0.1, 0.0],
    [0.9, 0.5, 0.97, 0.976666667, 0.777777778, 0.009259259, 0.020740741],
    [0.2, 0.4, 0.10, 0.14, 1.4, -0.266666667, 0.233333333],
    [0.2, 0.4, 0.50, 0.5, 0.7, 0.0, 0.0],
    [0.2, 0.4, 0.90, 0.86, 1.4, 0.266666667, -0.233333333],
    [0.1, 0.55, 0.02, 0.108, 5.4, -1.98, 1.92],
];

#[test]
fn stored_values_hold() {
    for [l, b, g, psi, slope, d_l, d_b] in GOLDEN {
        let p = Profile::frequency(l, b).partials(g);
        let [got_l, got_b] = frequency_vjp(l, b, [p.outer, p.inner]);
        for (got, want) in [(p.value, psi), (p.slope, slope), (got_l, d_l), (got_b, d_b)] {
            assert!((got - want).abs() < 6e-10, "({l}, {b}, {g}): {got} {want}");
        }
    }
    let supports = [
        [1.0, 0.5, 0.5, 0.00392156863, 11.0825271],
        [0.8, 0.9, 0.5, 0.00630252101, 10.1336111],
        [0.02, 0.9, 0.5, 0.25210084, 2.7558522],
        [0.5, 0.1, 0.4, 0.00435729847, 10.8718061],
        [0.0045, 0.8, 0.5, 0.841796548, 0.3444338],
    ];
    for [o, l, b, g, q] in supports {
        let got = Profile::frequency(l, b).support(1.0 / (255.0 * o)).expect("visible");
        assert!((got - g).abs() < 2e-9 * g.max(1.0) && (-2.0 * got.ln() - q).abs() < 1e-7, "{got}");
    }
    for [l, b, m] in
        [[0.9, 0.5, 0.936727238], [1.0, 0.9, 0.820784073], [0.1, 0.5, 1.305556301], [0.3, 0.6, 1.114472179]]
    {
        assert!((Profile::frequency(l, b).mass() - m).abs() < 6e-10);
    }
}

/// λ = ½, β = 0 and acutance 0 are the Gaussian; the first to the bit, in both precisions.
#[test]
fn the_neutral_kernels_are_the_gaussian() {
    for beta in [0.0f32, 1e-7, 0.5, 1.0 - 1e-7, 1.0] {
        for [_, _, g] in pairs(500).chain([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) {
            assert_eq!(Profile::frequency(0.5f32, beta).psi(g as f32).to_bits(), (g as f32).to_bits());
            assert_eq!(Profile::frequency(0.5, f64::from(beta)).psi(g).to_bits(), g.to_bits());
        }
    }
    for [l, _, g] in pairs(500) {
        assert!(close(Profile::frequency(l, 0.0).psi(g), g, 1e-15));
        assert_eq!(Profile::acutance(0.0).psi(g), g);
    }
}

#[test]
fn the_residual_form_is_the_published_one() {
    for [l, b, g] in pairs(100_000) {
        let want = published(l, b, g);
        assert!(
            close(Profile::frequency(l, b).psi(g), want, 4e-14 / (0.5 + l - b).abs().clamp(1e-3, 1.0)),
            "{l} {b} {g}"
        );
    }
    for gap in [1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 0.0, -0.1] {
        for [l, _, g] in pairs(300).map(|[l, b, g]| [0.4 * l, b, g]) {
            let beta = 0.5 + l - gap;
            let want = published(l, beta, g);
            assert!(close(Profile::frequency(l, beta).psi(g), want, 1e-9), "D {gap}, {l} {g}");
        }
    }
}

#[test]
fn continuous_monotone_symmetric_and_within_bounds() {
    for [l, b, g] in pairs(100_000) {
        let bend = Profile::frequency(l, b);
        let knot = (0.5 + l - b) / (1.0 + 2.0 * l);
        // Below this gap the outer segment is a step by design.
        if knot > 1e-6 {
            for p in [knot, 1.0 - knot] {
                assert!((bend.psi(p.next_up()) - bend.psi(p.next_down())).abs() < 1e-6, "{l} {b}");
            }
        }
        let value = bend.psi(g);
        assert!((0.0..=1.0).contains(&value) && close(value + bend.psi(1.0 - g), 1.0, 1e-12), "{l} {b} {g}");
        assert!(bend.psi((g + 1e-3).min(1.0)) >= value);
    }
}

/// Differences of ψ with respect to `g`, λ, β and acutance, away from the knots.
#[test]
fn partials_match_differences() {
    let h = 1e-6;
    let mut tried = 0;
    for [l, b, g] in pairs(20_000) {
        let d = 0.5 + l - b;
        let knot = d / (1.0 + 2.0 * l);
        let away = |k: f64| (g.min(1.0 - g) - k).abs() > 1e-4;
        if d.abs() > 0.05 && (d < 0.0 || away(knot)) && g.clamp(1e-4, 1.0 - 1e-4) == g && (g - 0.5).abs() > 1e-4 {
            tried += 1;
            let psi = |l: f64, b: f64, g: f64| Profile::frequency(l, b).psi(g);
            let p = Profile::frequency(l, b).partials(g);
            let [d_l, d_b] = frequency_vjp(l, b, [p.outer, p.inner]);
            let pairs = [
                (p.slope, psi(l, b, g + h) - psi(l, b, g - h)),
                (d_l, psi(l + h, b, g) - psi(l - h, b, g)),
                (d_b, psi(l, b + h, g) - psi(l, b - h, g)),
            ];
            assert!(pairs.iter().all(|(got, w)| close(*got, w / (2.0 * h), 1e-8)), "{l} {b} {g}: {pairs:?}");
        }
        let a = 1.8 * l - 0.9;
        if away(0.25 * (1.0 + a)) && g.clamp(1e-4, 1.0 - 1e-4) == g {
            let psi = |a: f64, g: f64| Profile::acutance(a).psi(g);
            let p = Profile::acutance(a).partials(g);
            let got = [p.slope, acutance_vjp(a, [p.outer, p.inner])];
            let want = [psi(a, g + h) - psi(a, g - h), psi(a + h, g) - psi(a - h, g)];
            assert!((0..2).all(|i| close(got[i], want[i] / (2.0 * h), 1e-7)), "{a} {g}: {got:?} {want:?}");
        }
    }
    assert!(tried > 10_000);
}

/// Gradients stay within their bound under the cap, and finite everywhere without it.
#[test]
fn near_singular_kernels_stay_finite() {
    for gap in [1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 0.0, -0.2] {
        for [l, _, g] in pairs(400).map(|[l, b, g]| [0.49 * l, b, g]).chain([[0.0, 0.0, 0.0], [0.2, 0.0, 1.0]]) {
            let beta = (0.5 + l - gap).clamp(0.0, 1.0);
            for (mode, bound) in [(BetaMode::Literal, f64::MAX), (BetaMode::Capped, 25.0)] {
                let b = effective_beta(mode, l, beta);
                let bend = Profile::frequency(l, b);
                let p = bend.partials(g);
                let d = frequency_vjp(l, b, [p.outer, p.inner]);
                assert!((0.0..=1.0).contains(&p.value) && p.slope.is_finite());
                assert!(d.iter().all(|v| v.abs() <= bound), "{mode:?} D {gap}: {d:?}");
                assert!(mode == BetaMode::Literal || p.slope <= 50.0);
                let narrow = Profile::frequency(l as f32, b as f32).partials(g as f32);
                assert!((0.0..=1.000_001).contains(&narrow.value) && narrow.slope.is_finite());
            }
        }
    }
}

#[test]
fn the_support_is_where_the_threshold_is_met() {
    for (i, [l, b, o]) in pairs(20_000).enumerate() {
        let threshold = 1.0 / (255.0 * o.max(0.001));
        let bend = if i % 3 == 0 { Profile::acutance(1.9 * l - 0.95) } else { Profile::frequency(l, b) };
        let Some(g) = bend.support(threshold) else {
            assert!(bend.psi(0.999_999_999) < threshold * (1.0 + 1e-6), "{bend:?}");
            continue;
        };
        if g > 0.0 {
            assert!((bend.psi(g) - threshold).abs() < 1e-9, "{bend:?} {threshold}: g* {g}, ψ {}", bend.psi(g));
        } else {
            assert!(bend.is_unbounded() && bend.psi(1e-12) >= threshold * (1.0 - 1e-9));
        }
    }
}

/// `m = ∫ ψ(g)/g dg` by the midpoint rule in `ln g`.
#[test]
fn the_mass_is_the_integral() {
    for bend in
        [Profile::frequency(0.9, 0.5), Profile::frequency(0.05, 0.5), Profile::acutance(0.6), Profile::acutance(-0.5)]
    {
        let (steps, range) = (400_000, 40.0);
        let width = range / f64::from(steps);
        let sum: f64 = (0..steps).map(|i| bend.psi((-(f64::from(i) + 0.5) * width).exp())).sum();
        assert!(close(bend.mass(), sum * width, 1e-7), "{bend:?}: {} {}", bend.mass(), sum * width);
    }
    assert_eq!(Profile::frequency(0.5, 1.0).mass(), 1.0);
    assert_eq!(Profile::frequency(0.1, 0.8).mass(), f64::INFINITY);
}

#[test]
fn rows_of_a_kernel_give_their_profile() {
    let kernel = Kernel::Frequency { lambdas: vec![0.5, 0.9], betas: vec![0.5, 0.25] };
    assert_eq!(kernel.bend(1), Some(Profile::frequency(f64::from(0.9f32), 0.25)));
    assert!(!kernel.is_neutral() && Kernel::Acutance { acutances: vec![0.0; 2] }.is_neutral());
    assert_eq!((Kernel::Gaussian.bend(0), Kernel::Gaussian.is_neutral()), (None, true));
    let mut d = [0.0; 2];
    kernel.vjp(1, [0.5, -0.25], &mut d);
    let want = frequency_vjp(f64::from(0.9f32), 0.25, [0.5, -0.25]);
    assert_eq!(d, want.map(|v| v as f32));
}
