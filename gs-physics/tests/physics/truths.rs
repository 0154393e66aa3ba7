//! Integrators against motions with exact ends (TRACE specification, T1–T10): errors, orders and invariants, in `f64`.
//! Errors at 15, 30, 60 and 120 steps may differ from the listed ones by 1 %.

use glam::Vec3;
use gs_physics::reference::advance;
use gs_physics::truth::{self, Truth};
use gs_physics::{Integrator, Motion, Reduction, Rollout, Twist};
use std::f64::consts::PI;

const STEPS: [f64; 4] = [15.0, 30.0, 60.0, 120.0];
const UNIT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

fn roll(rule: Integrator, truth: &Truth, steps: f64) -> ([f64; 3], [f64; 4]) {
    let rollout = Rollout { rule, dt: truth.span / steps, origin: Vec3::ZERO };
    advance(&rollout, &truth.motion, [0.0, truth.span], (truth.start, UNIT))
}

fn misses(rule: Integrator, truth: &Truth) -> [f64; 4] {
    STEPS.map(|n| truth.position_error(roll(rule, truth, n).0))
}

fn rotation_errors(rule: Integrator, truth: &Truth) -> [f64; 4] {
    STEPS.map(|n| truth.rotation_error(roll(rule, truth, n).1))
}

/// Asserts listed figures, and the order between the two finest.
fn check(what: &str, got: [f64; 4], want: [f64; 4], order: f64) {
    for (g, w) in got.iter().zip(want) {
        assert!((g / w - 1.0).abs() < 0.01, "{what}: {got:?}, listed {want:?}");
    }
    let slope = (got[2] / got[3]).log2();
    assert!((slope - order).abs() < 0.15, "{what}: order {slope}");
}

fn exact(what: &str, got: [f64; 4]) {
    assert!(got.iter().all(|e| *e < 2e-14), "{what}: {got:?}");
}

#[test]
fn t1_and_t2_circles_and_screws() {
    for t in [truth::circle(), truth::screw()] {
        check("euler", misses(Integrator::Euler, &t), [2.439, 0.912, 0.388, 0.179], 1.1);
        check("rk2", misses(Integrator::Rk2, &t), [1.879e-1, 4.605e-2, 1.149e-2, 2.871e-3], 2.0);
        check("rk4", misses(Integrator::Rk4, &t), [1.61e-3, 1.01e-4, 6.30e-6, 3.94e-7], 4.0);
        for rule in [Integrator::Se3Mid, Integrator::Se3Magnus4] {
            exact(t.name, misses(rule, &t));
        }
        // A constant twist needs no sub-steps.
        assert!(t.position_error(roll(Integrator::Se3Mid, &t, 1.0).0) < 1e-14);
    }
}

#[test]
fn t3_a_fixed_axis_that_spins_up() {
    let t = truth::spin_up();
    check("rk2", misses(Integrator::Rk2, &t), [3.162e-2, 7.918e-3, 1.984e-3, 4.965e-4], 2.0);
    check("rk4", misses(Integrator::Rk4, &t), [1.066e-4, 6.69e-6, 4.185e-7, 2.62e-8], 4.0);
    exact("se3", misses(Integrator::Se3Mid, &t));
    for rule in [Integrator::MidParams, Integrator::Rk2, Integrator::Rk4, Integrator::Se3Mid] {
        exact("turn", rotation_errors(rule, &t));
    }
    // ‖R − R'‖/√2 = 2 sin(half the angle).
    let angle = rotation_errors(Integrator::Euler, &t).map(|m| 2.0 * (0.5 * m).asin());
    check("euler's turn", angle, [0.1333, 0.0667, 0.0333, 0.01667], 1.0);
}

#[test]
fn t4_a_rolling_wheel() {
    let t = truth::wheel();
    check("rk2", misses(Integrator::Rk2, &t), [1.149e-2, 2.871e-3, 7.18e-4, 1.79e-4], 2.0);
    check("se3", misses(Integrator::Se3Mid, &t), [3.66e-3, 9.14e-4, 2.29e-4, 5.71e-5], 2.0);
    check("magnus", misses(Integrator::Se3Magnus4, &t), [2.68e-6, 1.67e-7, 1.04e-8, 6.5e-10], 4.0);
    assert_eq!(t.motion.twist.v, [0.0; 3], "the contact point rests");
    let still = Motion { rate: Twist::default(), ..t.motion };
    let miss = t.position_error(truth::follow(&still, 1.0, t.start).0);
    assert!((miss - 1.86).abs() < 0.01, "without (1): {miss}");
    assert_eq!(truth::wheel_body().motion(2, Reduction::Paper).rate.v, [0.0; 3]);
}

#[test]
fn t5_a_tumbling_axis() {
    let t = truth::tumble();
    let (x, q) = truth::follow(&t.motion, 1.0, t.start);
    assert!(
        t.position_error(x) < 1e-9 && t.rotation_error(q) < 1e-9,
        "{} {}",
        t.position_error(x),
        t.rotation_error(q)
    );
    check("rk2", misses(Integrator::Rk2, &t), [1.947e-2, 4.885e-3, 1.224e-3, 3.063e-4], 2.0);
    check("midparams", misses(Integrator::MidParams, &t), [3.51e-1, 1.64e-1, 7.93e-2, 3.89e-2], 1.0);
    check("se3", misses(Integrator::Se3Mid, &t), [1.092e-3, 2.728e-4, 6.82e-5, 1.71e-5], 2.0);
    // The end is listed to ten digits: the finest fourth-order figure keeps only its magnitude.
    let magnus = STEPS.map(|n| {
        let got = roll(Integrator::Se3Magnus4, &t, n).0;
        (0..3).map(|c| (got[c] - x[c]).powi(2)).sum::<f64>().sqrt()
    });
    check("magnus", magnus, [9.5e-7, 5.9e-8, 3.7e-9, 2.3e-10], 4.0);
    for rule in [Integrator::Rk2, Integrator::Se3Mid] {
        check("turn", rotation_errors(rule, &t), [1.01e-3, 2.52e-4, 6.30e-5, 1.58e-5], 2.0);
    }
}

#[test]
fn t6_a_throw_is_exact_for_any_step() {
    let t = truth::throw();
    for rule in [Integrator::Rk2, Integrator::Rk4, Integrator::Se3Mid, Integrator::Se3Magnus4, Integrator::MidParams] {
        for steps in [1.0, 2.0, 7.0, 120.0] {
            let (x, q) = roll(rule, &t, steps);
            assert!(t.position_error(x) < 1e-14 && q == UNIT, "{rule:?}, {steps} steps: {}", t.position_error(x));
        }
    }
}

#[test]
fn t7_a_throw_with_spin_has_the_error_of_a_constant_rate() {
    let (body, start) = truth::throw_with_spin();
    let end = body.exact_arc(0.5, start).0;
    for (got, want) in end.iter().zip([0.514_147_440_3, 0.236_998_997_3, 0.1]) {
        assert!((got - want).abs() < 1e-10, "{end:?}");
    }
    let spans = [0.0625, 0.125, 0.25, 0.5];
    let miss = |reduction| {
        spans.map(|tau| {
            let (got, want) = (truth::follow(&body.motion(2, reduction), tau, start).0, body.exact_arc(tau, start).0);
            (0..3).map(|c| (got[c] - want[c]).powi(2)).sum::<f64>().sqrt()
        })
    };
    let got = miss(Reduction::Exact);
    for (g, w) in got.iter().zip([3.7e-5, 2.9e-4, 2.3e-3, 1.8e-2]) {
        assert!((g / w - 1.0).abs() < 0.03, "{got:?}");
    }
    assert!(((got[1] / got[0]).log2() - 3.0).abs() < 0.05);
    let paper = miss(Reduction::Paper);
    assert!((paper[3] / 0.36 - 1.0).abs() < 0.03 && ((paper[1] / paper[0]).log2() - 2.0).abs() < 0.1, "{paper:?}");
    // With the jerk −w×a_c the motion is exact, for w is constant.
    let full = body.motion(3, Reduction::Exact);
    let x = truth::follow(&full, 0.5, start).0;
    assert!((0..3).all(|c| (x[c] - end[c]).abs() < 1e-11), "{x:?} {end:?}");
}

/// A pendulum by classical steps far finer than the model: `(θ, θ')` at `tau`.
fn pendulum(start: [f64; 2], tau: f64) -> [f64; 2] {
    let f = |[a, b]: [f64; 2]| [b, -9.81 * a.sin()];
    let n = 400;
    let h = tau / f64::from(n);
    (0..n).fold(start, |y, _| {
        let to = |k: [f64; 2], s: f64| [y[0] + s * k[0], y[1] + s * k[1]];
        let k1 = f(y);
        let k2 = f(to(k1, 0.5 * h));
        let k3 = f(to(k2, 0.5 * h));
        let k4 = f(to(k3, h));
        std::array::from_fn(|i| y[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]))
    })
}

#[test]
fn t8_the_error_of_a_pendulum_has_the_order_of_the_motion() {
    let cases = [
        ([1.0, 0.0], [2.9e-7, 1.2e-3], 4.0, 4.0),
        ([0.0, 2.0], [2.6e-5, 1.3e-2], 3.0, 5.0),
        ([0.6, -1.5], [1.7e-5, 9.8e-3], 3.0, 4.0),
    ];
    for (start, listed, order, with_jerk) in cases {
        let error = |jerk: bool| {
            [0.02, 0.04, 0.08, 0.16].map(|tau| {
                let mut m = Motion::<f64>::default();
                m.twist.w[2] = start[1];
                m.rate.w[2] = -9.81 * start[0].sin();
                if jerk {
                    m.jerk.w[2] = -9.81 * start[0].cos() * start[1];
                }
                let (_, q) = truth::follow(&m, tau, [0.0; 3]);
                (2.0 * q[3].atan2(q[0]) - (pendulum(start, tau)[0] - start[0])).abs()
            })
        };
        let got = error(false);
        assert!((got[0] / listed[0] - 1.0).abs() < 0.05 && (got[3] / listed[1] - 1.0).abs() < 0.05, "{got:?}");
        assert!(((got[1] / got[0]).log2() - order).abs() < 0.1, "{got:?}");
        let third = error(true);
        assert!(((third[1] / third[0]).log2() - with_jerk).abs() < 0.15, "{third:?}");
    }
}

#[test]
fn t9_radii_and_energies_under_rk2_and_on_se3() {
    let t = truth::circle();
    let radius = |x: [f64; 3]| ((x[0] - 0.5).powi(2) + x[1].powi(2)).sqrt();
    for (steps, want) in [(30.0, 1.007_24), (60.0, 1.000_90)] {
        let got = radius(roll(Integrator::Rk2, &t, steps).0);
        assert!((got - want).abs() < 1e-5, "{got}");
        let z: f64 = 2.0 * PI / steps;
        assert!((got - (1.0 + z.powi(4) / 4.0).powf(0.5 * steps)).abs() < 1e-12);
        assert!((radius(roll(Integrator::Se3Mid, &t, steps).0) - 1.0).abs() < 1e-14);
    }
    // Under Rk2 distances within a body grow as its radii do, and its kinetic energy with their square.
    let far = Truth { start: [-0.2, 1.1, 0.0], ..t };
    let (a, b) = (roll(Integrator::Rk2, &t, 30.0).0, roll(Integrator::Rk2, &far, 30.0).0);
    let length = |a: [f64; 3], b: [f64; 3]| (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f64>().sqrt();
    assert!((length(a, b) / length(t.start, far.start) / radius(a) - 1.0).abs() < 1e-13);
    let speed = |x| t.motion.twist.velocity(x).iter().map(|v| v * v).sum::<f64>();
    assert!((speed(a) / speed(t.start) / radius(a).powi(2) - 1.0).abs() < 1e-13);
    // A cloud keeps its distances on SE(3), for any motion.
    let m = truth::tumble().motion;
    let cloud = [[0.1, 0.2, 0.3], [-0.7, 0.4, 0.2], [0.5, -0.9, 0.8]];
    for rule in [Integrator::Se3Mid, Integrator::Se3Magnus4] {
        let rollout = Rollout { rule, dt: 1.0 / 30.0, origin: Vec3::ZERO };
        let moved = cloud.map(|x| advance(&rollout, &m, [0.0, 1.0], (x, UNIT)).0);
        for (i, j) in [(0, 1), (1, 2), (0, 2)] {
            assert!((length(moved[i], moved[j]) / length(cloud[i], cloud[j]) - 1.0).abs() < 1e-13);
        }
    }
}

#[test]
fn t10_there_and_back() {
    let t = truth::tumble();
    let back = |rule: Integrator| {
        STEPS.map(|n| {
            let rollout = Rollout { rule, dt: 1.0 / n, origin: Vec3::ZERO };
            let there = advance(&rollout, &t.motion, [0.0, 1.0], (t.start, UNIT));
            let (x, q) = advance(&rollout, &t.motion, [1.0, 0.0], there);
            assert!(q[0].abs() > 1.0 - 1e-13, "{rule:?}: {q:?}");
            (0..3).map(|c| (x[c] - t.start[c]).powi(2)).sum::<f64>().sqrt()
        })
    };
    check("rk2", back(Integrator::Rk2), [6.06e-3, 7.57e-4, 9.46e-5, 1.18e-5], 3.0);
    for rule in [Integrator::Se3Mid, Integrator::Se3Magnus4] {
        assert!(back(rule).iter().all(|e| *e < 1e-14), "{rule:?}: {:?}", back(rule));
    }
}

#[test]
fn every_rule_is_its_affine_map() {
    let t = truth::tumble();
    for rule in Integrator::ALL {
        for (tau, h) in [(0.0, 0.1), (0.7, -0.3), (0.2, 0.0)] {
            let (map, q) = gs_physics::step_map(&t.motion, tau, h, rule);
            let rollout = Rollout { rule, dt: 1.0, origin: Vec3::ZERO };
            let (x, turn) = advance(&rollout, &t.motion, [tau, tau + h], (t.start, UNIT));
            let got = map.apply(t.start);
            assert!((0..3).all(|c| (got[c] - x[c]).abs() < 1e-14), "{rule:?}: {got:?} {x:?}");
            assert!((0..4).all(|c| (q[c] - turn[c]).abs() < 1e-14));
        }
    }
}

/// With a jerk, the fourth-order rule stays of fourth order.
#[test]
fn magnus_keeps_its_order_with_a_jerk() {
    let mut m = truth::tumble().motion;
    m.jerk = Twist { v: [0.7, -0.9, 0.4], w: [1.1, 0.3, -1.7] };
    let truth = |n: f64, rule| {
        let rollout = Rollout { rule, dt: 1.0 / n, origin: Vec3::ZERO };
        advance(&rollout, &m, [0.0, 1.0], (truth::tumble().start, UNIT)).0
    };
    let want = truth(4000.0, Integrator::Rk4);
    for (rule, order) in [(Integrator::Se3Magnus4, 4.0), (Integrator::Rk4, 4.0), (Integrator::Se3Mid, 2.0)] {
        let miss = |n| (0..3).map(|c| (truth(n, rule)[c] - want[c]).powi(2)).sum::<f64>().sqrt();
        let slope = (miss(30.0) / miss(60.0)).log2();
        assert!((slope - order).abs() < 0.15, "{rule:?}: {slope}");
    }
}
