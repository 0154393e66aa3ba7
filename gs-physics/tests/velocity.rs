//! The velocity field in three levels: flows that are known, the `f64` twin against its own differences, production
//! against the twin. Then what must hold to the last bit.
//!
//! Tolerances, relative to 1 + |value| (worst seen times about four):
//! | quantity | bound |
//! |---|---|
//! | gradient of the twin against central differences | 1e-6 |
//! | f32 positions, turns and losses | 3e-6 |
//! | f32 gradients of weights, relative to the largest of their block | 3e-5 |

use glam::Vec3;
use gs_core::nn::BLOCK;
use gs_core::{Params, Rng};
use gs_physics::pinn::point;
use gs_physics::reference::Pose;
use gs_physics::reference::velocity::VelocityRef;
use gs_physics::{Dynamics, Moves, VelocityConfig, VelocityField, VelocityTape};

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
    field.visit_mut(&mut |p| {
        let mut rng = Rng::new(5, &p.name, 0, 0);
        let spread = if p.name.ends_with("bias") { 0.6 } else { 1.2 };
        p.value.iter_mut().for_each(|v| *v += spread * rng.range(-0.5, 0.5));
    });
    field
}

fn points(n: usize) -> Vec<Vec3> {
    let mut rng = Rng::new(1, "points", 0, 0);
    (0..n).map(|_| Vec3::new(rng.range(-1.0, 1.0), rng.range(-1.0, 1.0), rng.range(-1.0, 1.0))).collect()
}

fn cotangents(n: usize) -> Moves {
    let mut rng = Rng::new(1, "cotangents", 0, 0);
    let means = (0..n).map(|_| Vec3::new(rng.normal(), rng.normal(), rng.normal())).collect();
    Moves { means, turns: (0..n).map(|_| std::array::from_fn(|_| rng.normal())).collect() }
}

fn pose(moves: &Moves, i: usize) -> Pose {
    (moves.means[i].as_dvec3().to_array(), moves.turns[i].map(f64::from))
}

fn flat(p: Pose) -> [f64; 7] {
    std::array::from_fn(|k| if k < 3 { p.0[k] } else { p.1[k - 3] })
}

fn close(got: f64, want: f64, tolerance: f64, what: &str) {
    assert!((got - want).abs() < tolerance * (1.0 + want.abs()), "{what}: {got} {want}");
}

/// The places and times that the loss of a step is taken at.
fn collocation(field: &VelocityField, n: usize, seed: u64, step: u32) -> Vec<([f64; 3], f64)> {
    let wide = |(x, t): (Vec3, f32)| (x.as_dvec3().to_array(), f64::from(t));
    (0..n).map(|row| wide(point(field, seed, step, row))).collect()
}

/// The twin's own derivatives of space are differences of its velocity.
#[test]
fn turning_is_half_the_curl() {
    let twin = VelocityRef::new(&field(&config()));
    for x in points(10) {
        let (x, h) = (x.as_dvec3().to_array(), 1e-5);
        let slope = |axis: usize| -> [f64; 3] {
            let (mut hi, mut lo) = (x, x);
            hi[axis] += h;
            lo[axis] -= h;
            let (hi, lo) = (twin.flow(hi, 0.4).0, twin.flow(lo, 0.4).0);
            std::array::from_fn(|k| (hi[k] - lo[k]) / (2.0 * h))
        };
        let [a, b, c] = [slope(0), slope(1), slope(2)];
        let want = [b[2] - c[1], c[0] - a[2], a[1] - b[0]];
        for (got, want) in twin.flow(x, 0.4).1.into_iter().zip(want) {
            close(got, 0.5 * want, 1e-8, "curl");
        }
    }
}

#[test]
fn gradients_of_the_twin_are_its_differences() {
    let (x, d, span) = (points(2), cotangents(2), [0.6, 0.48]);
    let at = |i: usize| x[i].as_dvec3().to_array();
    for config in cases() {
        let mut twin = VelocityRef::new(&field(&config));
        let mut grad = twin.net.zeros();
        (0..2).for_each(|i| twin.gradient(at(i), span, pose(&d, i), &mut grad));
        let places = collocation(&field(&config), 5, 1, 2);
        let (mut grad_l, mut grad_a) = (twin.net.zeros(), twin.acceleration.zeros());
        twin.losses(&places, [&mut grad_l, &mut grad_a]);
        let h = 1e-5;
        let transported = |twin: &VelocityRef| -> f64 {
            let dot = |a: Pose, b: Pose| flat(a).iter().zip(flat(b)).map(|(a, b)| a * b).sum::<f64>();
            (0..2).map(|i| dot(twin.transport(at(i), span), pose(&d, i))).sum()
        };
        let lost = |twin: &VelocityRef| {
            let (mut a, mut b) = (twin.net.zeros(), twin.acceleration.zeros());
            twin.losses(&places, [&mut a, &mut b]).iter().sum::<f64>()
        };
        for block in 0..grad.len() {
            for k in (0..grad[block].len()).step_by(3) {
                let value = twin.net.params[block][k];
                let mut at = |v: f64| {
                    twin.net.params[block][k] = v;
                    [transported(&twin), lost(&twin)]
                };
                let (hi, lo) = (at(value + h), at(value - h));
                at(value);
                close(grad[block][k], (hi[0] - lo[0]) / (2.0 * h), 1e-6, "transport");
                close(grad_l[block][k], (hi[1] - lo[1]) / (2.0 * h), 1e-6, "losses");
            }
            for k in (0..grad_a[block].len()).step_by(3) {
                let value = twin.acceleration.params[block][k];
                let mut at = |v: f64| {
                    twin.acceleration.params[block][k] = v;
                    lost(&twin)
                };
                let (hi, lo) = (at(value + h), at(value - h));
                at(value);
                close(grad_a[block][k], (hi - lo) / (2.0 * h), 1e-6, "acceleration");
            }
        }
    }
}

/// Gradients of the blocks whose names start with `prefix` against the twin's.
fn compare(field: &VelocityField, prefix: &str, want: &[Vec<f64>]) {
    let mut want = want.iter();
    field.visit(&mut |p| {
        if p.name.starts_with(prefix) {
            let want = want.next().unwrap();
            let largest = want.iter().fold(1e-9f64, |m, g| m.max(g.abs()));
            for (g, w) in p.grad.iter().zip(want) {
                assert!((f64::from(*g) - w).abs() < 3e-5 * largest, "{}: {g} {w} of {largest}", p.name);
            }
        }
    });
    assert!(want.next().is_none());
}

#[test]
fn production_agrees_with_the_twin() {
    let n = 21;
    let (x, d) = (points(n), cotangents(n));
    for config in cases() {
        let mut field = field(&config);
        let twin = VelocityRef::new(&field);
        for [from, to] in [[0.6, 0.48], [0.3, 0.35]] {
            let (mut tape, mut out, mut grad) = (VelocityTape::default(), Moves::default(), twin.net.zeros());
            field.clear_grads();
            field.transport(&x, from, to, &mut tape, &mut out);
            field.transport_backward(&x, &mut tape, &d);
            let motions = field.motions(&x, from);
            for i in 0..n {
                let at = x[i].as_dvec3().to_array();
                for (got, want) in flat(pose(&out, i)).iter().zip(flat(twin.transport(at, [from, to]))) {
                    close(*got, want, 3e-6, "pose");
                }
                twin.gradient(at, [from, to], pose(&d, i), &mut grad);
                let (u, w) = twin.flow(at, from);
                let twist = motions[i].twist;
                let moved = twist.velocity((x[i] - field.origin()).to_array());
                for (got, want) in moved.iter().chain(&twist.w).zip(u.iter().chain(&w)) {
                    close(f64::from(*got), *want, 3e-6, "motion");
                }
            }
            compare(&field, "velocity", &grad);
        }
        field.clear_grads();
        let terms = field.regularise(9, 4);
        let (mut grad, mut grad_a) = (twin.net.zeros(), twin.acceleration.zeros());
        let want = twin.losses(&collocation(&field, config.points, 9, 4), [&mut grad, &mut grad_a]);
        assert_eq!(terms.iter().map(|t| t.0).collect::<Vec<_>>(), ["divergence", "transport"]);
        terms.iter().zip(want).for_each(|(got, want)| close(got.1.into(), want, 3e-6, got.0));
        compare(&field, "velocity", &grad);
        compare(&field, "acceleration", &grad_a);
    }
}

/// A field that says the same everywhere.
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

/// A turntable about the origin: the midpoint rule's spiral in position, exact turns; it does not diverge, and what its
/// motion lacks is the pull to the axis, which the third of NVFi's pulls gives.
#[test]
fn a_turntable() {
    let w = 2.0f32;
    let mut field = constant([0.0, 0.0, 0.0, 0.0, 0.0, w], [0.0; 6]);
    let r = Vec3::new(0.5, 0.1, 0.3);
    let (x, mut out) = ([field.origin() + r], Moves::default());
    field.transport(&x, 0.0, 0.5, &mut VelocityTape::default(), &mut out);
    let angle = 2.0 * out.turns[0][3].atan2(out.turns[0][0]);
    assert!((angle - 1.0).abs() < 1e-6, "{angle}");
    // Ten steps of z = w h: radius √(1 + z⁴/4), angle atan(z / (1 − z²/2)) each.
    let z = w * STEP as f32;
    let (grown, turned) = ((1.0 + z.powi(4) / 4.0).powi(5), 10.0 * z.atan2(1.0 - z * z / 2.0));
    let want = glam::Quat::from_rotation_z(turned) * Vec3::new(r.x, r.y, 0.0) * grown + Vec3::new(0.0, 0.0, r.z);
    assert!((out.means[0] - field.origin() - want).length() < 1e-5);
    let motion = field.motions(&x, 0.2)[0];
    assert!((motion.twist.w[2] - w).abs() < 1e-6 && motion.twist.v.iter().all(|v| v.abs() < 1e-6));

    let terms = field.regularise(1, 1);
    assert!(terms[0].1 < 1e-10 && terms[1].1 > 0.1, "{terms:?}");
    let pulled = constant([0.0, 0.0, 0.0, 0.0, 0.0, w], [0.0, 0.0, 0.0, 0.0, 0.0, w * w]).regularise(1, 1);
    assert!(pulled[1].1 < 1e-10, "{pulled:?}");
}

#[test]
fn no_time_no_move_and_no_points_no_loss() {
    let mut field = field(&VelocityConfig { points: 0, ..config() });
    let (x, mut tape, mut out) = (points(BLOCK + 3), VelocityTape::default(), Moves::default());
    field.transport(&x, 0.2, 0.5, &mut tape, &mut out);
    field.transport(&x, 0.4, 0.4, &mut tape, &mut out);
    assert_eq!(out.means, x);
    assert!(out.turns.iter().all(|q| *q == [1.0, 0.0, 0.0, 0.0]));
    field.transport_backward(&x, &mut tape, &cotangents(x.len()));
    assert!(field.regularise(1, 1).is_empty());
    field.visit(&mut |p| assert!(p.grad.iter().all(|g| *g == 0.0)));
}

/// Everything a step produces, as bits.
fn step(field: &mut VelocityField, tape: &mut VelocityTape, n: usize) -> Vec<u32> {
    let (x, mut out) = (points(n), Moves::default());
    field.clear_grads();
    field.transport(&x, 0.3, 0.38, tape, &mut out);
    field.transport_backward(&x, tape, &cotangents(n));
    let mut bits: Vec<u32> = out.means.iter().flat_map(|v| v.to_array()).map(f32::to_bits).collect();
    bits.extend(out.turns.iter().flatten().map(|v| v.to_bits()));
    bits.extend(field.regularise(3, 7).iter().map(|v| v.1.to_bits()));
    field.visit(&mut |p| bits.extend(p.grad.iter().map(|v| v.to_bits())));
    bits
}

#[test]
fn threads_and_warm_tapes_change_nothing() {
    // More blocks than chunks, and a ragged end.
    let (n, make) = (11 * BLOCK + 17, || field(&VelocityConfig { points: 9 * BLOCK + 5, ..config() }));
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| step(&mut make(), &mut VelocityTape::default(), n))
    };
    let one = on(1);
    assert!(one == on(2) && one == on(4), "results depend on the number of threads");
    let (mut field, mut tape) = (make(), VelocityTape::default());
    for n in [n + 300, 0, 1, BLOCK, BLOCK + 1] {
        assert_eq!(step(&mut field, &mut tape, n), step(&mut make(), &mut VelocityTape::default(), n), "n = {n}");
    }
    assert!(step(&mut field, &mut tape, n) == one, "a warm tape changes the result");
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
