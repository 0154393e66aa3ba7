//! The law in three levels: bodies with exact paths, the `f64` reference against its own differences, production against
//! the reference; then bitwise invariants.
//!
//! Tolerances, relative to 1 + |value| (worst seen times about four):
//! | quantity | bound |
//! |---|---|
//! | gradient of the reference against central differences | 1e-8 |
//! | f32 positions, rotations and motions | 5e-6 |
//! | f32 gradients of weights, relative to the largest of their block | 5e-6 |

use crate::support::particles::{CENTROID, cotangents, points, start};
use crate::support::{
    close, compare_gradients, dot, empty_span_is_identity, flat, pose, randomise_weights, reproducible,
};
use glam::Vec3;
use gs_core::Params;
use gs_physics::reference::law::LawRef;
use gs_physics::{
    AccelMap, Dynamics, Integrator, Law, LawConfig, LawForm, LawInput, LawTape, ParticleState, Rollout, Start,
};

const ORIGIN: Vec3 = Vec3::new(0.3, -0.2, 0.5);
const STEP: f64 = 1.0 / 30.0;
const FORMS: [LawForm; 4] = [LawForm::Twist12, LawForm::Centre15, LawForm::Gvfi13, LawForm::Free];

/// Small, with outputs of order one so that every term counts.
fn config(form: LawForm, order: u8) -> LawConfig {
    LawConfig { form, order, hidden: 10, depth: 2, head_start: 1.0, accel_clamp: 0.0, ..LawConfig::default() }
}

fn law(config: &LawConfig) -> Law {
    let mut law = Law::new(config, ORIGIN, STEP, 3).unwrap();
    randomise_weights(&mut law, 1.6);
    law
}

/// The `f64` reference, with the same centroid.
fn reference_of(law: &Law) -> LawRef {
    let mut reference = LawRef::new(law);
    reference.centroid = CENTROID.as_dvec3().to_array();
    reference
}

/// Every form, order, map, input and switch, over one step and several, in both directions of time.
fn cases() -> Vec<(LawConfig, [f64; 2])> {
    let mut out = Vec::new();
    for order in 1..=3 {
        let span = if order == 1 { [0.3, 0.3 + STEP] } else { [0.6, 0.5] };
        let own = LawConfig { own_turn: true, spin_gain: 0.7, ..config(LawForm::Twist12, order) };
        out.push((LawConfig { integrator: Integrator::Se3Mid, gain: 1.3, ..own }, span));
    }
    for order in 2..=3 {
        out.push((LawConfig { spin_order: order - 1, own_turn: true, ..config(LawForm::Twist12, order) }, [0.6, 0.5]));
        out.push((LawConfig { spin_order: 1, ..config(LawForm::Centre15, order) }, [0.3, 0.35]));
    }
    for form in FORMS {
        for order in 1..=3 {
            for literal in [false, true] {
                let span = if order == 2 { [0.6, 0.52] } else { [0.3, 0.3 + STEP] };
                out.push((LawConfig { literal, ..config(form, order) }, span));
            }
        }
        out.push((LawConfig { integrator: Integrator::Se3Mid, gain: 1.7, ..config(form, 2) }, [0.1, 0.25]));
        let plain = LawConfig { input: LawInput::X, accel: AccelMap::Linear, ..config(form, 2) };
        out.push((LawConfig { coordinate_scale: 0.4, local_origin: false, bands: 1, ..plain }, [0.7, 0.66]));
    }
    out
}

#[test]
fn gradients_of_the_twin_are_its_differences() {
    let (x, d) = (points(2), cotangents(2));
    for (config, span) in cases() {
        let mut reference = reference_of(&law(&config));
        let mut grad = reference.net.zeros();
        let at = |i: usize| x[i].as_dvec3().to_array();
        (0..2).for_each(|i| reference.gradient(at(i), span, pose(&d, i), &mut grad));
        let h = 1e-5;
        for (block, grad) in grad.iter().enumerate() {
            for (k, &got) in grad.iter().enumerate().step_by(7) {
                let value = reference.net.params[block][k];
                let mut loss = |v: f64| -> f64 {
                    reference.net.params[block][k] = v;
                    (0..2).map(|i| dot(reference.integrate(at(i), span), pose(&d, i))).sum()
                };
                let want = (loss(value + h) - loss(value - h)) / (2.0 * h);
                loss(value);
                close(got, want, 1e-8, &format!("{config:?} {block} {k}"));
            }
        }
    }
}

#[test]
fn production_agrees_with_the_reference() {
    let n = 21;
    let (x, d) = (points(n), cotangents(n));
    for (config, [from, to]) in cases() {
        let mut law = law(&config);
        let reference = reference_of(&law);
        let (mut tape, mut out, mut grad) = (LawTape::default(), ParticleState::default(), reference.net.zeros());
        law.integrate(start(&x, from), to, &mut tape, &mut out);
        law.integrate_backward(start(&x, from), &mut tape, &d);
        for i in 0..n {
            let at = x[i].as_dvec3().to_array();
            for (got, want) in flat(pose(&out, i)).iter().zip(flat(reference.integrate(at, [from, to]))) {
                close(*got, want, 5e-6, &format!("{config:?} {i}"));
            }
            reference.gradient(at, [from, to], pose(&d, i), &mut grad);
            let (got, want) =
                (law.motions(start(&x, from))[i].to_f64().to_array(), reference.motion(at, from).to_array());
            // Each is a sum of products of the others: rounding is that of the largest.
            let scale = want.iter().fold(1.0f64, |m, v| m.max(v.abs()));
            got.iter()
                .zip(want)
                .for_each(|(got, want)| close(got / scale, want / scale, 2e-6, &format!("{config:?} {i}")));
        }
        compare_gradients(&law, "physics", &grad, 5e-6);
    }
}

/// A law with the same outputs everywhere: its last bias.
fn constant(config: &LawConfig, outputs: &[f32]) -> Law {
    let mut law = Law::new(config, ORIGIN, STEP, 0).unwrap();
    let last = format!("physics.layer.{}.bias", config.depth);
    law.visit_mut(&mut |p| {
        p.value.fill(0.0);
        if p.name == last {
            p.value.copy_from_slice(outputs);
        }
    });
    law
}

/// A wheel that rolls half a turn, as a twist and by its hub: where the rim ends, and that `−w × v_c` is needed.
#[test]
fn a_wheel_rolls() {
    use std::f32::consts::PI;
    let rim = [Vec3::new(0.0, 0.0, 1.0)];
    let (hub, v, w) = (Vec3::new(0.0, 0.0, 0.5) - ORIGIN, Vec3::new(PI / 2.0, 0.0, 0.0), Vec3::new(0.0, PI, 0.0));
    let end = Vec3::new(PI / 2.0, 0.0, 0.0);
    let linear = |form| LawConfig { accel: AccelMap::Linear, integrator: Integrator::Se3Mid, ..config(form, 2) };
    let miss = |config: &LawConfig, parts: &[Vec3], n: usize| {
        let outputs: Vec<f32> = parts.iter().flat_map(|v| v.to_array()).take(n).collect();
        let (law, mut out) = (constant(config, &outputs), ParticleState::default());
        law.integrate(start(&rim, 0.0), 1.0, &mut LawTape::default(), &mut out);
        (out.means[0] - end).length()
    };
    let twist = [v - w.cross(hub), w, -w.cross(v), Vec3::ZERO];
    let centre = [hub, v, w, Vec3::ZERO, Vec3::ZERO];
    // The same motion; 9.1e-4 is what 30 steps of this rule miss (2.3e-4 at 60).
    assert!((miss(&linear(LawForm::Twist12), &twist, 12) - 9.1e-4).abs() < 3e-5);
    assert!((miss(&linear(LawForm::Centre15), &centre, 15) - 9.1e-4).abs() < 3e-5);
    assert!(miss(&LawConfig { literal: true, ..linear(LawForm::Centre15) }, &centre, 15) > 1.0);
    assert!(miss(&linear(LawForm::Gvfi13), &centre, 13) < 2e-6);
}

/// A ball that flies and spins about its centroid: by its own turn, with the velocity and acceleration of the centroid.
#[test]
fn an_own_turn_leaves_the_centroid_alone() {
    let (spin, velocity, fall) = (Vec3::new(0.4, -2.0, 1.0), Vec3::new(1.4, 0.5, -0.6), Vec3::new(0.0, 0.0, -4.9));
    let own = LawConfig { accel: AccelMap::Linear, own_turn: true, ..config(LawForm::Twist12, 2) };
    let plain = LawConfig { integrator: Integrator::Se3Magnus4, ..own };
    // The turn passes a |a| / 10.
    let root = spin.to_array().map(|v: f32| v.signum() * (10.0 * v.abs()).sqrt());
    let parts = [velocity, Vec3::ZERO, fall, Vec3::ZERO, Vec3::from_array(root)];
    let law = constant(&plain, &parts.iter().flat_map(|v| v.to_array()).collect::<Vec<_>>());
    let x = [CENTROID, CENTROID + Vec3::new(0.1, 0.0, 0.05)];
    let (h, mut out) = (0.1, ParticleState::default());
    law.integrate(start(&x, 0.5), 0.5 + f64::from(h), &mut LawTape::default(), &mut out);
    let centroid = CENTROID + h * velocity + 0.5 * h * h * fall;
    // The error is of third order: w × a h³ / 6.
    assert!((out.means[0] - centroid).length() < 1.1 * spin.cross(fall).length() * h * h * h / 6.0, "{}", out.means[0]);
    let arm = glam::Quat::from_scaled_axis(h * spin) * (x[1] - x[0]);
    assert!((out.means[1] - out.means[0] - arm).length() < 1e-5);
}

/// Angular accelerations are left out, those of velocity stay.
#[test]
fn rotations_may_have_a_lower_order_than_velocities() {
    let parts: Vec<f32> = (1..=18).map(|i| i as f32).collect();
    let motion = |spin_order| {
        let config = LawConfig { accel: AccelMap::Linear, spin_order, ..config(LawForm::Twist12, 3) };
        constant(&config, &parts).motions(start(&[CENTROID], 0.0))[0]
    };
    let all = motion(0);
    assert_eq!((all.rate.w, all.jerk.w), ([10.0, 11.0, 12.0], [16.0, 17.0, 18.0]));
    let mut want = all;
    want.jerk.w = [0.0; 3];
    assert_eq!(motion(2), want);
    want.rate.w = [0.0; 3];
    assert_eq!(motion(1), want);
}

/// θ = τ + 2 τ² about a fixed axis: the exact arc, and the printed one, which lags by 2 τ dt.
#[test]
fn angles_of_gvfi() {
    let x = [ORIGIN + Vec3::new(1.0, 0.0, 0.0)];
    for (literal, lag) in [(false, 0.0), (true, 2.0 * 0.5 * STEP)] {
        let config = LawConfig { accel: AccelMap::Linear, literal, ..config(LawForm::Gvfi13, 2) };
        let mut outputs = [0.0; 13];
        (outputs[8], outputs[12]) = (1.0, 4.0);
        let (law, mut out) = (constant(&config, &outputs), ParticleState::default());
        law.integrate(start(&x, 0.2), 0.7, &mut LawTape::default(), &mut out);
        let angle = 2.0 * f64::from(out.rotations[0][3]).atan2(out.rotations[0][0].into());
        assert!((angle - (0.5 + 0.5 - lag)).abs() < 5e-6, "{literal}: {angle}");
        let p = out.means[0] - ORIGIN;
        assert!((f64::from(p.y).atan2(p.x.into()) - angle).abs() < 1e-6);
    }
}

/// The motion of a free particle, rolled out by mechanics, is its own straight line and turn.
#[test]
fn a_free_particle_goes_straight() {
    let law = law(&config(LawForm::Free, 2));
    let (x, mut out) = (points(30), ParticleState::default());
    law.integrate(start(&x, 0.4), 0.9, &mut LawTape::default(), &mut out);
    let motions = law.motions(start(&x, 0.4));
    let rollout = Rollout { rule: Integrator::Se3Magnus4, dt: 0.01, origin: law.origin() };
    let (mut means, mut quats) = (x.clone(), vec![[1.0, 0.0, 0.0, 0.0]; 30]);
    rollout.advance(&motions, [0.0, 0.5], &mut means, &mut quats);
    for i in 0..30 {
        assert!((means[i] - out.means[i]).length() < 1e-5, "{} {}", means[i], out.means[i]);
        assert!(quats[i].iter().zip(out.rotations[i]).all(|(a, b)| (a - b).abs() < 1e-5));
    }
}

/// The motion of a particle on its arc, rolled out by mechanics, is that arc: with constant velocities, while its centre falls, or
/// while its turn gets faster.
#[test]
fn an_arc_is_its_motion() {
    let (hub, v, w) = (Vec3::new(0.2, -0.4, 0.3), Vec3::new(1.0, 0.5, -0.7), Vec3::new(0.0, 0.9, 1.2));
    let (x, fall) = (points(20), Vec3::new(0.0, 0.0, -4.0));
    let cases = [(1, Vec3::ZERO, 0.0, false), (2, fall, 0.0, false), (2, fall, 0.0, true), (2, Vec3::ZERO, 2.0, false)];
    for (order, a, faster, literal) in cases {
        let config = LawConfig { accel: AccelMap::Linear, literal, ..config(LawForm::Gvfi13, order) };
        let outputs: Vec<f32> = [hub, v, w, a].iter().flat_map(|v| v.to_array()).chain([faster]).collect();
        let count = if order == 1 { 9 } else { 13 };
        let (law, mut out) = (constant(&config, &outputs[..count]), ParticleState::default());
        law.integrate(start(&x, 0.2), 0.7, &mut LawTape::default(), &mut out);
        let rollout = Rollout { rule: Integrator::Se3Magnus4, dt: 0.01, origin: law.origin() };
        let (mut means, mut quats) = (x.clone(), vec![[1.0, 0.0, 0.0, 0.0]; 20]);
        rollout.advance(&law.motions(start(&x, 0.2)), [0.0, 0.5], &mut means, &mut quats);
        for i in 0..20 {
            assert!((means[i] - out.means[i]).length() < 2e-5, "{a} {faster}: {} {}", means[i], out.means[i]);
            assert!(quats[i].iter().zip(out.rotations[i]).all(|(a, b)| (a - b).abs() < 1e-5));
        }
    }
}

#[test]
fn an_empty_span_changes_nothing() {
    FORMS.into_iter().for_each(|form| empty_span_is_identity(law(&config(form, 2))));
}

/// One step of Adam, as training takes it.
fn adam(law: &mut Law, step: u32, rate: f32) {
    let unbiased = |beta: f32| 1.0 / (1.0 - beta.powi(step as i32));
    law.visit_mut(&mut |p| {
        let moments = p.moment1.iter_mut().zip(&mut p.moment2);
        for ((v, g), (m1, m2)) in p.value.iter_mut().zip(&p.grad).zip(moments) {
            *m1 = 0.9 * *m1 + 0.1 * g;
            *m2 = 0.999 * *m2 + 0.001 * g * g;
            *v -= rate * *m1 * unbiased(0.9) / ((*m2 * unbiased(0.999)).sqrt() + 1e-15);
        }
    });
    law.clear_grads();
}

/// Trained on single steps of a turntable inside [0, 0.75], by positions and rotations, a law extrapolates by 0.3 (108°)
/// and ends within a tenth of the distance travelled.
#[test]
fn a_law_learns_and_extrapolates() {
    let truth = gs_physics::truth::circle().motion.to_f32();
    let x: Vec<Vec3> = points(100).iter().map(|x| 0.5 * *x + Vec3::new(1.5, 0.0, 0.0)).collect();
    let roll = Rollout { rule: Integrator::Se3Mid, dt: 1.0, origin: Vec3::ZERO };
    let at = |t: f64| {
        let mut moves = ParticleState { means: x.clone(), rotations: vec![[1.0, 0.0, 0.0, 0.0]; x.len()] };
        roll.advance(&vec![truth; x.len()], [0.0, t], &mut moves.means, &mut moves.rotations);
        moves
    };
    let small = LawConfig { hidden: 32, depth: 2, gain: 10.0, head_start: 0.01, ..LawConfig::default() };
    let config = LawConfig { integrator: Integrator::Se3Mid, local_origin: false, ..small };
    let mut law = Law::new(&config, Vec3::ZERO, STEP, 1).unwrap();
    let (mut tape, mut out, steps) = (LawTape::default(), ParticleState::default(), 1200);
    for step in 1..=steps {
        let mut rng = gs_core::Rng::new(1, "times", step, 0);
        let (to, side) = (0.75 * f64::from(rng.uniform()), if rng.uniform() < 0.5 { STEP } else { -STEP });
        let from = (to - side).clamp(0.0, 0.7);
        let (begin, end, turn) = (at(from).means, at(to).means, at(to - from).rotations);
        law.integrate(Start { x: &begin, t: from, middle: Vec3::ZERO }, to, &mut tape, &mut out);
        let means = out.means.iter().zip(&end).map(|(a, b)| *a - *b).collect();
        let off = |(a, b): (&[f32; 4], &[f32; 4])| std::array::from_fn(|k| 0.02 * (a[k] - b[k]));
        law.integrate_backward(
            Start { x: &begin, t: from, middle: Vec3::ZERO },
            &mut tape,
            &ParticleState { means, rotations: out.rotations.iter().zip(&turn).map(off).collect() },
        );
        adam(&mut law, step, 2e-3 * 0.01f32.powf(step as f32 / steps as f32));
    }
    let (mut last, want) = (at(0.7), at(1.0).means);
    let still = last.means.clone();
    law.rollout().advance(&law.motions(start(&still, 0.7)), [0.0, 0.3], &mut last.means, &mut last.rotations);
    let miss = |got: &[Vec3]| got.iter().zip(&want).map(|(a, b)| (*a - *b).length()).sum::<f32>() / x.len() as f32;
    let (rolled, still) = (miss(&last.means), miss(&still));
    assert!(rolled < 0.1 * still, "{rolled} of {still}");
}

/// Weights of the last layer start within their bounds, and none of them at zero.
#[test]
fn the_head_starts_small_but_not_at_zero() {
    let law = Law::new(&LawConfig::default(), ORIGIN, STEP, 0).unwrap();
    assert_eq!(law.param_count(), 104_332, "the authors' light network");
    assert_eq!(LawConfig::default().param_count(), 104_332);
    let most = usize::MAX;
    let absurd = LawConfig { hidden: most, depth: most, bands: most, ..LawConfig::default() };
    assert_eq!(absurd.param_count(), u64::MAX);
    let bound = 1.0 / 128f32.sqrt();
    law.visit(&mut |p| {
        if p.name == "physics.layer.7.weight" {
            let (twist, accel) = p.value.split_at(6 * 128);
            assert!(twist.iter().all(|v| v.abs() <= 0.1 * bound) && accel.iter().all(|v| v.abs() <= bound));
            assert!(accel.iter().fold(0.0f32, |m, v| m.max(v.abs())) > 0.9 * bound);
            assert!(p.value.iter().all(|v| *v != 0.0));
        }
    });
}

/// The gradient of one particle's accelerations is clipped at the limit.
#[test]
fn gradients_of_accelerations_are_clamped() {
    let last_bias = |accel_clamp: f32| {
        let mut law = law(&LawConfig { accel_clamp, ..config(LawForm::Twist12, 2) });
        let (x, mut tape, mut out) = (points(1), LawTape::default(), ParticleState::default());
        law.integrate(start(&x, 0.2), 0.5, &mut tape, &mut out);
        let mut d = cotangents(1);
        d.means[0] *= 1e3;
        law.integrate_backward(start(&x, 0.2), &mut tape, &d);
        let mut grad = Vec::new();
        law.visit(&mut |p| grad.clone_from(&p.grad));
        grad
    };
    let length = |g: &[f32]| g.iter().map(|v| v * v).sum::<f32>().sqrt();
    let (free, held) = (last_bias(0.0), last_bias(1.0));
    assert_eq!(free[..6], held[..6], "twists are not touched");
    assert!(length(&free[6..]) > 2.0 && (length(&held[6..]) - 1.0).abs() < 1e-5);
}

#[test]
fn threads_and_warm_tapes_change_nothing() {
    FORMS.into_iter().for_each(|form| reproducible(|| law(&config(form, 2))));
}

#[test]
fn wrong_settings_are_named() {
    let error = |config| Law::new(&config, ORIGIN, STEP, 0).unwrap_err().to_string();
    let default = LawConfig::default;
    assert_eq!(
        error(LawConfig { order: 4, ..default() }),
        "physics setting `order` = 4 cannot be built: it must be 1 to 3"
    );
    for (config, name) in [
        (LawConfig { spin_order: 3, ..default() }, "spin_order"),
        (LawConfig { depth: 0, ..default() }, "depth"),
        (LawConfig { hidden: 0, ..default() }, "hidden"),
        (LawConfig { bands: 99, ..default() }, "bands"),
        (LawConfig { head_start: 0.0, ..default() }, "head_start"),
        (LawConfig { gain: f32::INFINITY, ..default() }, "gain"),
        (LawConfig { accel_clamp: -1.0, ..default() }, "accel_clamp"),
        (LawConfig { coordinate_scale: f32::NAN, ..default() }, "coordinate_scale"),
    ] {
        assert!(error(config).contains(name), "{name}");
    }
}
