//! The velocity field in three levels: exact flows, the `f64` reference against its own differences, production against the
//! reference; then bitwise invariants.
//!
//! Tolerances, relative to 1 + |value| (worst seen times about four):
//! | quantity | bound |
//! |---|---|
//! | gradient of the reference against central differences | 1e-8 |
//! | f32 positions, rotations, twists and losses | 2e-6 |
//! | f32 accelerations | 1e-3 |
//! | f32 gradients of weights, relative to the largest of their block | 4e-6 |

use crate::support::particles::{cotangents, points, start};
use crate::support::{
    close, compare_gradients, dot, empty_span_is_identity, flat, pose, randomise_weights, reproducible,
};
use glam::Vec3;
use gs_core::Params;
use gs_core::nn::BLOCK;
use gs_physics::pinn::point;
use gs_physics::reference::velocity::VelocityRef;
use gs_physics::{Dynamics, ParticleState, VelocityConfig, VelocityField, VelocityTape};

const BOUNDS: [Vec3; 2] = [Vec3::new(-1.0, -0.8, -1.2), Vec3::new(1.4, 1.0, 0.9)];
const STEP: f64 = 0.05;

fn config() -> VelocityConfig {
    VelocityConfig { hidden: 10, depth: 2, points: 40, ..VelocityConfig::default() }
}

fn cases() -> Vec<VelocityConfig> {
    vec![
        config(),
        VelocityConfig { coordinate_scale: 0.4, bands: 2, local_origin: false, depth: 3, ..config() },
        VelocityConfig { bands: 0, depth: 1, divergence: 0.0, ..config() },
    ]
}

fn field(config: &VelocityConfig) -> VelocityField {
    let mut field = VelocityField::new(config, BOUNDS, STEP, 3).unwrap();
    randomise_weights(&mut field, 1.2);
    field
}

/// The collocation points of a step.
fn collocation(field: &VelocityField, n: usize, seed: u64, step: u32) -> Vec<([f64; 3], f64)> {
    let wide = |(x, t): (Vec3, f32)| (x.as_dvec3().to_array(), f64::from(t));
    (0..n).map(|row| wide(point(field, seed, step, row))).collect()
}

/// The reference's spatial derivatives are differences of its velocity.
#[test]
fn angular_velocity_is_half_the_curl() {
    let reference = VelocityRef::new(&field(&config()));
    for x in points(10) {
        let (x, h) = (x.as_dvec3().to_array(), 1e-5);
        let slope = |axis: usize| -> [f64; 3] {
            let (mut hi, mut lo) = (x, x);
            hi[axis] += h;
            lo[axis] -= h;
            let (hi, lo) = (reference.flow(hi, 0.4).0, reference.flow(lo, 0.4).0);
            std::array::from_fn(|k| (hi[k] - lo[k]) / (2.0 * h))
        };
        let [a, b, c] = [slope(0), slope(1), slope(2)];
        let want = [b[2] - c[1], c[0] - a[2], a[1] - b[0]];
        for (got, want) in reference.flow(x, 0.4).1.into_iter().zip(want) {
            close(got, 0.5 * want, 1e-8, "curl");
        }
    }
}

#[test]
fn gradients_of_the_twin_are_its_differences() {
    let (x, d, span) = (points(2), cotangents(2), [0.6, 0.48]);
    let at = |i: usize| x[i].as_dvec3().to_array();
    for config in cases() {
        let mut reference = VelocityRef::new(&field(&config));
        let mut grad = reference.net.zeros();
        (0..2).for_each(|i| reference.gradient(at(i), span, pose(&d, i), &mut grad));
        let points = collocation(&field(&config), 5, 1, 2);
        let (mut grad_l, mut grad_a) = (reference.net.zeros(), reference.acceleration.zeros());
        reference.losses(&points, [&mut grad_l, &mut grad_a]);
        let h = 1e-5;
        let transported = |reference: &VelocityRef| -> f64 {
            (0..2).map(|i| dot(reference.integrate(at(i), span), pose(&d, i))).sum()
        };
        let lost = |reference: &VelocityRef| {
            let (mut a, mut b) = (reference.net.zeros(), reference.acceleration.zeros());
            reference.losses(&points, [&mut a, &mut b]).iter().sum::<f64>()
        };
        for block in 0..grad.len() {
            for k in (0..grad[block].len()).step_by(3) {
                let value = reference.net.params[block][k];
                let mut at = |v: f64| {
                    reference.net.params[block][k] = v;
                    [transported(&reference), lost(&reference)]
                };
                let (hi, lo) = (at(value + h), at(value - h));
                at(value);
                close(grad[block][k], (hi[0] - lo[0]) / (2.0 * h), 1e-8, "transport");
                close(grad_l[block][k], (hi[1] - lo[1]) / (2.0 * h), 1e-8, "losses");
            }
            for k in (0..grad_a[block].len()).step_by(3) {
                let value = reference.acceleration.params[block][k];
                let mut at = |v: f64| {
                    reference.acceleration.params[block][k] = v;
                    lost(&reference)
                };
                let (hi, lo) = (at(value + h), at(value - h));
                at(value);
                close(grad_a[block][k], (hi - lo) / (2.0 * h), 1e-8, "acceleration");
            }
        }
    }
}

#[test]
fn production_agrees_with_the_reference() {
    let n = 21;
    let (x, d) = (points(n), cotangents(n));
    for config in cases() {
        let mut field = field(&config);
        let reference = VelocityRef::new(&field);
        for [from, to] in [[0.6, 0.48], [0.3, 0.35]] {
            let (mut tape, mut out, mut grad) =
                (VelocityTape::default(), ParticleState::default(), reference.net.zeros());
            field.clear_grads();
            field.integrate(start(&x, from), to, &mut tape, &mut out);
            field.integrate_backward(start(&x, from), &mut tape, &d);
            let motions = field.motions(start(&x, from));
            for i in 0..n {
                let at = x[i].as_dvec3().to_array();
                for (got, want) in flat(pose(&out, i)).iter().zip(flat(reference.integrate(at, [from, to]))) {
                    close(*got, want, 2e-6, "pose");
                }
                reference.gradient(at, [from, to], pose(&d, i), &mut grad);
                let (u, w) = reference.flow(at, from);
                let twist = motions[i].twist;
                let moved = twist.velocity((x[i] - field.origin()).to_array());
                for (got, want) in moved.iter().chain(&twist.w).zip(u.iter().chain(&w)) {
                    close(f64::from(*got), *want, 2e-6, "motion");
                }
            }
            compare_gradients(&field, "velocity", &grad, 4e-6);
        }
        field.clear_grads();
        let terms = field.regularise(9, 4);
        let (mut grad, mut grad_a) = (reference.net.zeros(), reference.acceleration.zeros());
        let want = reference.losses(&collocation(&field, config.points, 9, 4), [&mut grad, &mut grad_a]);
        assert_eq!(terms.iter().map(|t| t.0).collect::<Vec<_>>(), ["divergence", "transport"]);
        terms.iter().zip(want).for_each(|(got, want)| close(got.1.into(), want, 2e-6, got.0));
        compare_gradients(&field, "velocity", &grad, 4e-6);
        compare_gradients(&field, "acceleration", &grad_a, 4e-6);
    }
}

/// A field with the same outputs everywhere.
fn constant(velocity: [f32; 6], acceleration: [f32; 6]) -> VelocityField {
    let mut field = VelocityField::new(&config(), BOUNDS, STEP, 0).unwrap();
    field.visit_mut(&mut |p| {
        p.value.fill(0.0);
        match p.name.as_str() {
            "velocity.layer.2.bias" => p.value.copy_from_slice(&velocity),
            "acceleration.layer.2.bias" => p.value.copy_from_slice(&acceleration),
            _ => {}
        }
    });
    field
}

/// A turntable about the origin: the midpoint rule's spiral in position, exact rotations; its divergence is zero, and its
/// residual is the centripetal acceleration, which NVFi's attraction to the third axis provides.
#[test]
fn a_turntable() {
    let w = 2.0f32;
    let mut field = constant([0.0, 0.0, 0.0, 0.0, 0.0, w], [0.0; 6]);
    let r = Vec3::new(0.5, 0.1, 0.3);
    let (x, mut out) = ([field.origin() + r], ParticleState::default());
    field.integrate(start(&x, 0.0), 0.5, &mut VelocityTape::default(), &mut out);
    let angle = 2.0 * out.rotations[0][3].atan2(out.rotations[0][0]);
    assert!((angle - 1.0).abs() < 1e-6, "{angle}");
    // Ten steps of z = w h: radius √(1 + z⁴/4), angle atan(z / (1 − z²/2)) each.
    let z = w * STEP as f32;
    let (grown, turned) = ((1.0 + z.powi(4) / 4.0).powi(5), 10.0 * z.atan2(1.0 - z * z / 2.0));
    let want = glam::Quat::from_rotation_z(turned) * Vec3::new(r.x, r.y, 0.0) * grown + Vec3::new(0.0, 0.0, r.z);
    assert!((out.means[0] - field.origin() - want).length() < 1e-5);
    let motion = field.motions(start(&x, 0.2))[0];
    assert!((motion.twist.w[2] - w).abs() < 1e-6 && motion.twist.v.iter().all(|v| v.abs() < 1e-6));

    let terms = field.regularise(1, 1);
    assert!(terms[0].1 < 1e-10 && terms[1].1 > 0.1, "{terms:?}");
    let pulled = constant([0.0, 0.0, 0.0, 0.0, 0.0, w], [0.0, 0.0, 0.0, 0.0, 0.0, w * w]).regularise(1, 1);
    assert!(pulled[1].1 < 1e-10, "{pulled:?}");
}

/// The acceleration of a motion is the change of the reference's velocity along the flow, by time and by place.
#[test]
fn motions_accelerate_as_the_flow_does() {
    let (x, t, h) = (points(12), 0.4, 1e-5);
    for config in cases() {
        let field = field(&config);
        let reference = VelocityRef::new(&field);
        for (x, motion) in x.iter().zip(field.motions(start(&x, t))) {
            let at = x.as_dvec3().to_array();
            let u = reference.flow(at, t).0;
            let after = |h: f64| reference.flow(std::array::from_fn(|k| at[k] + h * u[k]), t + h).0;
            let (ahead, behind) = (after(h), after(-h));
            for (k, got) in motion.acceleration((*x - field.origin()).to_array()).into_iter().enumerate() {
                close(f64::from(got), (ahead[k] - behind[k]) / (2.0 * h), 1e-3, "acceleration");
            }
        }
    }
}

#[test]
fn an_empty_span_changes_nothing_and_no_points_give_no_terms() {
    let mut field = field(&VelocityConfig { points: 0, ..config() });
    assert!(field.regularise(1, 1).is_empty());
    empty_span_is_identity(field);
}

#[test]
fn threads_and_warm_tapes_change_nothing() {
    reproducible(|| field(&VelocityConfig { points: 9 * BLOCK + 5, ..config() }));
}

#[test]
fn wrong_settings_are_named() {
    let error = |config, bounds| VelocityField::new(&config, bounds, STEP, 0).unwrap_err().to_string();
    for (config, name) in [
        (VelocityConfig { depth: 0, ..config() }, "depth"),
        (VelocityConfig { divergence: -1.0, ..config() }, "divergence"),
        (VelocityConfig { transport: f32::INFINITY, ..config() }, "transport"),
        (VelocityConfig { coordinate_scale: f32::NAN, ..config() }, "coordinate_scale"),
    ] {
        assert!(error(config, BOUNDS).contains(name), "{name}");
    }
    assert!(error(config(), [BOUNDS[1], BOUNDS[0]]).contains("the box of the scene"));
    assert!(error(config(), [Vec3::NAN, BOUNDS[0]]).contains("the box of the scene"));
}
