//! Adjoints of roll-outs.
//!
//! | level | compared | tolerance |
//! |---|---|---|
//! | truth | a pure translation: `d x / d (v̄, ā, j) = (τ, ½τ², τ³/6)` | 1e-15 |
//! | reference | `f64` adjoints of every rule against central differences of fourth order | 1e-8 relative to the largest |
//! | production | `f32` positions, quaternions and adjoints against `f64`, 12 steps, `‖w‖` up to 6 | 2e-6, 2e-6, 1e-5 of the largest |

use glam::Vec3;
use gs_core::Rng;
use gs_physics::reference::{self, Pose};
use gs_physics::{Integrator, Motion, ParticleState, RollTape, Rollout, Twist};
use std::f64::consts::PI;

fn random<const N: usize>(rng: &mut Rng) -> [f64; N] {
    std::array::from_fn(|_| f64::from(rng.normal()))
}

fn unit(q: [f64; 4]) -> [f64; 4] {
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    q.map(|v| v / norm)
}

/// `(motion, position, quaternion)` as one row.
fn row(m: &Motion<f64>, (x, q): Pose) -> Vec<f64> {
    [&m.to_array()[..], &x, &q].concat()
}

fn unrow(row: &[f64]) -> (Motion<f64>, Pose) {
    let at = |range: std::ops::Range<usize>| &row[range];
    let m = Motion::from_array(at(0..18).try_into().unwrap());
    (m, (at(18..21).try_into().unwrap(), at(21..25).try_into().unwrap()))
}

/// Fourth-order central differences of `weight · pose` by every value of `row`.
fn differences(rollout: &Rollout, span: [f64; 2], values: &[f64], (wx, wq): Pose) -> Vec<f64> {
    let loss = |values: &[f64]| {
        let (m, pose) = unrow(values);
        let (x, q) = reference::advance(rollout, &m, span, pose);
        (0..3).map(|c| wx[c] * x[c]).sum::<f64>() + (0..4).map(|c| wq[c] * q[c]).sum::<f64>()
    };
    let h = 5e-4;
    let moved = |i: usize, s: f64| {
        let mut v = values.to_vec();
        v[i] += s * h;
        loss(&v)
    };
    let slope = |i| (8.0 * (moved(i, 1.0) - moved(i, -1.0)) - (moved(i, 2.0) - moved(i, -2.0))) / (12.0 * h);
    (0..values.len()).map(slope).collect()
}

fn check(rollout: &Rollout, span: [f64; 2], m: &Motion<f64>, pose: Pose, rng: &mut Rng) {
    let weight = (random(rng), random(rng));
    let (d_m, d_pose) = reference::adjoint(rollout, m, span, pose, weight);
    let (got, want) = (row(&d_m, d_pose), differences(rollout, span, &row(m, pose), weight));
    let largest = want.iter().fold(1.0f64, |a, v| a.max(v.abs()));
    for (i, (g, w)) in got.iter().zip(&want).enumerate() {
        assert!((g - w).abs() <= 1e-8 * largest, "{:?}, {span:?}, value {i}: {g} {w}", rollout.rule);
    }
}

#[test]
fn a_translation_is_the_polynomial() {
    let m = Motion { twist: Twist { v: [1.0, 2.0, 3.0], w: [0.0; 3] }, ..Motion::default() };
    for rule in [Integrator::Se3Magnus4, Integrator::Rk4] {
        let rollout = Rollout { rule, dt: 10.0, origin: Vec3::ZERO };
        let pose = ([0.0; 3], [1.0, 0.0, 0.0, 0.0]);
        let (d, _) = reference::adjoint(&rollout, &m, [0.0, 0.5], pose, ([1.0, 0.0, 0.0], [0.0; 4]));
        for (got, want) in [(d.twist.v[0], 0.5), (d.rate.v[0], 0.125), (d.jerk.v[0], 0.125 / 6.0)] {
            assert!((got - want).abs() < 1e-15, "{rule:?}: {got} {want}");
        }
    }
}

/// T13: random motions with rate and jerk, several steps either way, about an origin off the particle.
#[test]
fn adjoints_match_differences() {
    let mut rng = Rng::new(1, "adjoint", 0, 0);
    for rule in Integrator::ALL {
        for case in 0..12 {
            let m = Motion::from_array(random(&mut rng));
            let pose = (random(&mut rng), unit(random(&mut rng)));
            let from = 0.3 * f64::from(rng.normal());
            let length = 0.5 * f64::from(rng.normal());
            let rollout = Rollout { rule, dt: 0.13, origin: Vec3::new(0.5, -1.0, 0.25) };
            let span = if case % 2 == 0 { [from, from + length] } else { [from, from - length] };
            check(&rollout, span, &m, pose, &mut rng);
        }
    }
}

/// T13: one step of each hard angle, also with tiny angular velocities.
#[test]
fn adjoints_hold_at_hard_angles() {
    let mut rng = Rng::new(2, "adjoint", 0, 0);
    let angles = [0.0, 1e-12, 1e-7, 1e-6, 1e-3, 1e-2, 0.999, 1.001, 2.0, PI - 1e-3, PI, 2.0 * PI, 2.0 * PI + 1e-6];
    for rule in Integrator::ALL {
        for angle in angles {
            for h in [0.4, -0.4] {
                let axis = unit([0.0, 0.3, -0.5, 0.8]);
                let mut m = Motion::from_array(random(&mut rng).map(|v: f64| 0.3 * v));
                // The middle of the step rotations by exactly the angle.
                m.jerk = Twist::default();
                m.twist.w = std::array::from_fn(|c| axis[c + 1] * angle / h - 0.5 * h * m.rate.w[c]);
                let pose = (random(&mut rng), unit(random(&mut rng)));
                let rollout = Rollout { rule, dt: 1.0, origin: Vec3::ZERO };
                check(&rollout, [0.0, h], &m, pose, &mut rng);
            }
        }
    }
}

struct Scene {
    motions: Vec<Motion<f32>>,
    means: Vec<Vec3>,
    quats: Vec<[f32; 4]>,
    d: ParticleState,
}

/// Particles with up to several radians per unit of time; the first three rest.
fn scene(n: usize) -> Scene {
    let mut rng = Rng::new(3, "adjoint", 0, 0);
    let mut vec = |s: f64| random::<3>(&mut rng).map(|v| s * v);
    let motion = |i: usize, vec: &mut dyn FnMut(f64) -> [f64; 3]| match i {
        0..3 => Motion::default(),
        _ => Motion {
            twist: Twist { v: vec(1.0), w: vec(2.0) },
            rate: Twist { v: vec(1.0), w: vec(1.0) },
            jerk: Twist { v: vec(0.5), w: vec(0.5) },
        },
    };
    let motions = (0..n).map(|i| motion(i, &mut vec).to_f32()).collect();
    let wide = |v: [f64; 3]| Vec3::from_array(v.map(|v| v as f32));
    let means = (0..n).map(|_| wide(vec(1.0))).collect();
    let mut quat = |normal: bool| {
        let q = random::<4>(&mut rng);
        if normal { unit(q) } else { q }.map(|v| v as f32)
    };
    let quats = (0..n).map(|_| quat(true)).collect();
    let rotations = (0..n).map(|_| quat(false)).collect();
    let means_d = (0..n).map(|_| Vec3::from_slice(&quat(false))).collect();
    Scene { motions, means, quats, d: ParticleState { means: means_d, rotations } }
}

fn rollout(rule: Integrator) -> Rollout {
    Rollout { rule, dt: 1.0 / 24.0, origin: Vec3::new(0.2, -0.1, 0.4) }
}

/// All results of the production code.
#[derive(PartialEq)]
struct Produced {
    means: Vec<Vec3>,
    quats: Vec<[f32; 4]>,
    grads: Vec<Motion<f32>>,
    /// Cotangents at the start.
    start: ParticleState,
}

fn produce(rollout: &Rollout, scene: &Scene, span: [f64; 2]) -> Produced {
    let (mut means, mut quats) = (scene.means.clone(), scene.quats.clone());
    let mut tape = RollTape::default();
    rollout.advance_taped(&scene.motions, span, &mut means, &mut quats, &mut tape);
    let mut grads = vec![Motion::default(); means.len()];
    let start = rollout.adjoint(&scene.motions, &tape, &scene.d, &mut grads);
    Produced { means, quats, grads, start }
}

fn worst(got: &[f32], want: &[f64]) -> f64 {
    let largest = want.iter().fold(1e-30f64, |a, v| a.max(v.abs()));
    got.iter().zip(want).fold(0.0f64, |a, (g, w)| a.max((f64::from(*g) - w).abs())) / largest
}

#[test]
fn production_follows_the_reference() {
    let scene = scene(533);
    let wide = |q: &[f32]| -> Vec<f64> { q.iter().map(|&v| f64::from(v)).collect() };
    for rule in Integrator::ALL {
        for span in [[0.1, 0.6], [0.3, -0.2]] {
            let rollout = rollout(rule);
            let Produced { means, quats, grads, start } = produce(&rollout, &scene, span);
            let mut errors = [0.0f64; 4];
            for i in 0..means.len() {
                let m = scene.motions[i].to_f64();
                let pose = |x: Vec3, q: [f32; 4]| (x.as_dvec3().to_array(), q.map(f64::from));
                let at = pose(scene.means[i], scene.quats[i]);
                let (x, q) = reference::advance(&rollout, &m, span, at);
                let d = pose(scene.d.means[i], scene.d.rotations[i]);
                let (d_m, (d_x, d_q)) = reference::adjoint(&rollout, &m, span, at, d);
                let found = [
                    worst(&means[i].to_array(), &x),
                    worst(&quats[i], &q),
                    worst(&grads[i].to_array(), &d_m.to_array()),
                    worst(&[&start.means[i].to_array()[..], &start.rotations[i]].concat(), &[&d_x[..], &d_q].concat()),
                ];
                errors = std::array::from_fn(|k| errors[k].max(found[k]));
                assert!(i >= 3 || (means[i] == scene.means[i] && wide(&quats[i]) == wide(&scene.quats[i])));
            }
            let limits = [2e-6, 2e-6, 1e-5, 1e-5];
            assert!(errors.iter().zip(limits).all(|(e, l)| *e < l), "{rule:?} {span:?}: {errors:?}");
        }
    }
}

#[test]
fn bits_do_not_depend_on_threads_nor_on_neighbours() {
    let scene = scene(2000);
    for rule in [Integrator::Rk2, Integrator::Se3Mid] {
        let rollout = rollout(rule);
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| produce(&rollout, &scene, [0.0, 0.5]))
        };
        let all = with(1);
        assert!(all == with(3), "{rule:?}");
        let part = Scene {
            motions: scene.motions[611..640].to_vec(),
            means: scene.means[611..640].to_vec(),
            quats: scene.quats[611..640].to_vec(),
            d: ParticleState {
                means: scene.d.means[611..640].to_vec(),
                rotations: scene.d.rotations[611..640].to_vec(),
            },
        };
        let alone = produce(&rollout, &part, [0.0, 0.5]);
        let rows = 611..640;
        assert!(alone.means == all.means[rows.clone()] && alone.quats == all.quats[rows.clone()]);
        assert!(alone.grads == all.grads[rows.clone()] && alone.start.means == all.start.means[rows.clone()]);
        assert!(alone.start.rotations == all.start.rotations[rows]);
    }
}

#[test]
fn gradients_add_and_empty_spans_change_nothing() {
    let scene = scene(20);
    let rollout = rollout(Integrator::Se3Mid);
    let (mut means, mut quats) = (scene.means.clone(), scene.quats.clone());
    let mut tape = RollTape::default();
    rollout.advance_taped(&scene.motions, [0.4, 0.4], &mut means, &mut quats, &mut tape);
    assert!(means == scene.means && quats == scene.quats);
    let mut grads = vec![Motion::default(); 20];
    assert_eq!(rollout.adjoint(&scene.motions, &tape, &scene.d, &mut grads), scene.d);
    assert_eq!(grads, vec![Motion::default(); 20]);
    rollout.advance_taped(&scene.motions, [0.0, 0.3], &mut means, &mut quats, &mut tape);
    rollout.adjoint(&scene.motions, &tape, &scene.d, &mut grads);
    let once = grads.clone();
    rollout.adjoint(&scene.motions, &tape, &scene.d, &mut grads);
    assert!(once.iter().zip(&grads).all(|(a, b)| b.twist.v[0] == 2.0 * a.twist.v[0]));
}
