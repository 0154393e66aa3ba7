//! Hard cases of the production roll-out (TRACE specification, 11.1): many rotations, half and full rotations, backward in time, long
//! horizons, distant bodies, twists with tiny and large angles in one block.

use glam::Vec3;
use gs_physics::reference;
use gs_physics::truth::{self, Truth};
use gs_physics::{BodyState, Extrapolator, Integrator, Motion, ParticleState, Reduction, RollTape, Rollout, Twist};
use std::f64::consts::PI;

const UNIT: [f32; 4] = [1.0, 0.0, 0.0, 0.0];

fn rollout(rule: Integrator, dt: f64) -> Rollout {
    Rollout { rule, dt, origin: Vec3::ZERO }
}

fn narrow(x: [f64; 3]) -> Vec3 {
    Vec3::from_array(x.map(|v| v as f32))
}

fn roll(rollout: &Rollout, truth: &Truth) -> (Vec3, [f32; 4]) {
    let (mut x, mut q) = ([narrow(truth.start)], [UNIT]);
    rollout.advance(&[truth.motion.to_f32()], [0.0, truth.span], &mut x, &mut q);
    (x[0], q[0])
}

/// Ten rotations at 30 steps each keep radii and quaternions to 1e-6; midpoint steps gain 7.5 % on the way.
#[test]
fn ten_turns_are_rigid() {
    let spin = BodyState { w: [0.0, 0.0, 2.0 * PI], ..BodyState::default() }.motion(2, Reduction::Exact).to_f32();
    let start: Vec<Vec3> = (0..1000).map(|i| Vec3::new(0.3 + i as f32 * 1e-3, 0.01 * (i % 7) as f32, -0.4)).collect();
    let after = |rule| {
        let (mut means, mut quats) = (start.clone(), vec![UNIT; start.len()]);
        rollout(rule, 1.0 / 30.0).advance(&vec![spin; start.len()], [0.0, 10.0], &mut means, &mut quats);
        (means, quats)
    };
    let radius = |x: &Vec3| x.truncate().length();
    for rule in [Integrator::Se3Mid, Integrator::Se3Magnus4] {
        let (means, quats) = after(rule);
        for ((x, x0), q) in means.iter().zip(&start).zip(&quats) {
            assert!((radius(x) / radius(x0) - 1.0).abs() < 1e-6, "{rule:?}: {}", radius(x) / radius(x0) - 1.0);
            assert!((q.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-6, "{q:?}");
            assert!(x.z == x0.z && q[0].abs() > 1.0 - 1e-6, "{q:?}");
        }
    }
    let (means, _) = after(Integrator::Rk2);
    assert!((radius(&means[500]) / radius(&start[500]) - 1.00724f32.powi(10)).abs() < 1e-3);
}

/// A body passes half a turn and a full one inside a roll-out; its orientation is right throughout, up to sign.
#[test]
fn half_and_full_turns_are_passed() {
    for angle in [PI - 1e-4, PI, PI + 1e-4, 2.0 * PI, 2.5 * PI] {
        let body = BodyState { position: [0.5, 0.0, 0.0], w: [0.0, angle, 0.0], ..BodyState::default() };
        let (x, q) = body.exact_arc(1.0, [1.5, 0.2, 0.0]);
        let truth = Truth {
            name: "turn",
            motion: body.motion(2, Reduction::Exact),
            start: [1.5, 0.2, 0.0],
            span: 1.0,
            end: x,
            rotation: gs_core::rot::matrix(q),
        };
        for dt in [1.0, 0.4, 1.0 / 24.0] {
            let (x, q) = roll(&rollout(Integrator::Se3Mid, dt), &truth);
            assert!(truth.position_error(x.as_dvec3().to_array()) < 1e-6, "{angle} {dt}: {x}");
            assert!(truth.rotation_error(q.map(f64::from)) < 1e-6, "{angle} {dt}: {q:?}");
        }
    }
}

/// Every exact motion, in `f32`: the error exceeds that of the same steps in `f64` by less than 2e-6.
#[test]
fn exact_motions_in_production() {
    for truth in truth::all() {
        for rule in [Integrator::Rk2, Integrator::Se3Mid, Integrator::Se3Magnus4] {
            let rollout = rollout(rule, truth.span / 30.0);
            let (x, q) = roll(&rollout, &truth);
            let span = [0.0, truth.span];
            let (x64, q64) = reference::advance(&rollout, &truth.motion, span, (truth.start, UNIT.map(f64::from)));
            let (miss, miss64) = (truth.position_error(x.as_dvec3().to_array()), truth.position_error(x64));
            assert!((miss - miss64).abs() < 2e-6, "{} {rule:?}: {miss} {miss64}", truth.name);
            assert!((truth.rotation_error(q.map(f64::from)) - truth.rotation_error(q64)).abs() < 2e-6);
        }
    }
}

/// From 0.70 to 1.5 at three rotations per unit of time, there and back.
#[test]
fn long_horizons_there_and_back() {
    let mut motion = truth::tumble().motion;
    motion.twist.w = [6.0 * PI, 0.5, -1.0];
    let rollout = rollout(Integrator::Se3Mid, 1.0 / 30.0);
    let start = Vec3::new(0.4, -0.3, 0.6);
    let mut particle = Extrapolator::new(rollout, 0.7, vec![motion.to_f32()], vec![start], vec![UNIT]).unwrap();
    let wide = motion.to_f32().to_f64();
    for t in [1.5, 0.7, -0.1] {
        let pose = (start.as_dvec3().to_array(), UNIT.map(f64::from));
        let (want, turn) = reference::advance(&rollout, &wide, [0.0, t - 0.7], pose);
        let (means, quats) = particle.at(t);
        assert!((means[0].as_dvec3() - glam::DVec3::from_array(want)).length() < 2e-6, "{t}");
        assert!((0..4).all(|c| (f64::from(quats[0][c]) - turn[c]).abs() < 2e-6), "{t}");
    }
    let (mut means, mut quats) = ([start], [UNIT]);
    rollout.advance(&[motion.to_f32()], [0.0, 0.8], &mut means, &mut quats);
    rollout.advance(&[motion.to_f32()], [0.8, 0.0], &mut means, &mut quats);
    assert!((means[0] - start).length() < 2e-6 && quats[0][0] > 1.0 - 1e-6, "{} {quats:?}", means[0]);
}

/// A spinning body a thousand units away: about a local origin only the storage of positions rounds (6e-5 there); about
/// the world's, `v̄` cancels against `w × x`, step after step.
#[test]
fn far_bodies_need_a_local_origin() {
    let body = |position: [f64; 3]| {
        let (velocity, w) = ([0.1, 0.0, 0.2], [1.0, 4.0, -2.0]);
        BodyState { position, velocity, w, ..BodyState::default() }.motion(2, Reduction::Exact)
    };
    let hub = Vec3::new(1000.0, 500.0, -800.0);
    let start = Vec3::new(1000.5, 500.25, -800.125);
    let arm = (start - hub).as_dvec3().to_array();
    let (want, _) = reference::advance(
        &rollout(Integrator::Se3Magnus4, 1.0 / 500.0),
        &body([0.0; 3]),
        [0.0, 2.0],
        (arm, UNIT.map(f64::from)),
    );
    let miss = |origin: Vec3, motion: Motion<f64>| {
        let rollout = Rollout { rule: Integrator::Se3Magnus4, dt: 1.0 / 60.0, origin };
        let (mut x, mut q) = ([start], [UNIT]);
        rollout.advance(&[motion.to_f32()], [0.0, 2.0], &mut x, &mut q);
        (x[0].as_dvec3() - hub.as_dvec3() - glam::DVec3::from_array(want)).length()
    };
    let local = miss(hub, body([0.0; 3]));
    let world = miss(Vec3::ZERO, body(hub.as_dvec3().to_array()));
    // The same motion, written about either origin.
    let moved = body(hub.as_dvec3().to_array()).shifted(hub.as_dvec3().to_array());
    assert!((0..3).all(|c| (moved.twist.v[c] - body([0.0; 3]).twist.v[c]).abs() < 1e-12));
    assert!(local < 1e-4, "{local}");
    assert!(world > 5.0 * local, "{world} against {local}");
}

/// One block of eight with angles from 0 to 40 rad: each lane as if alone, forward and backward.
#[test]
fn lanes_of_very_different_angles() {
    let angles = [0.0, 1e-12, 1e-6, 0.5, PI - 1e-3, PI, 2.0 * PI, 40.0];
    let motion = |a: &f64| Motion {
        twist: Twist { v: [0.3, -0.2, 0.1], w: [0.6 * a, 0.0, 0.8 * a] },
        rate: Twist { v: [0.1, 0.2, 0.3], w: [0.0; 3] },
        jerk: Twist::default(),
    };
    let motions: Vec<Motion<f32>> = angles.iter().map(|a| motion(a).to_f32()).collect();
    let rollout = rollout(Integrator::Se3Mid, 1.0);
    let d = ParticleState { means: vec![Vec3::new(0.2, 0.5, -0.7); 8], rotations: vec![[0.3, -0.6, 0.2, 0.4]; 8] };
    let run = |motions: &[Motion<f32>]| {
        let n = motions.len();
        let (mut means, mut quats) = (vec![Vec3::new(0.5, 0.6, 0.7); n], vec![UNIT; n]);
        let (mut tape, mut grads) = (RollTape::default(), vec![Motion::default(); n]);
        rollout.advance_taped(motions, [0.0, 1.0], &mut means, &mut quats, &mut tape);
        let d = ParticleState { means: d.means[..n].to_vec(), rotations: d.rotations[..n].to_vec() };
        rollout.adjoint(motions, &tape, &d, &mut grads);
        (means, quats, grads)
    };
    let all = run(&motions);
    for (i, m) in motions.iter().enumerate() {
        let alone = run(&[*m]);
        assert!(alone.0[0] == all.0[i] && alone.1[0] == all.1[i] && alone.2[0] == all.2[i], "{i}");
        let pose = ([0.5f32, 0.6, 0.7].map(f64::from), UNIT.map(f64::from));
        let (x, q) = reference::advance(&rollout, &m.to_f64(), [0.0, 1.0], pose);
        // An angle of 40 keeps 2e-6 rad in f32.
        assert!((all.0[i].as_dvec3() - glam::DVec3::from_array(x)).length() < 4e-6, "{i}");
        assert!((0..4).all(|c| (f64::from(all.1[i][c]) - q[c]).abs() < 4e-6), "{i}");
        let weight = (d.means[i].as_dvec3().to_array(), d.rotations[i].map(f64::from));
        let (grad, _) = reference::adjoint(&rollout, &m.to_f64(), [0.0, 1.0], pose, weight);
        for (got, want) in all.2[i].to_array().iter().zip(grad.to_array()) {
            assert!((f64::from(*got) - want).abs() < 1e-5, "{i}: {got} {want}");
        }
    }
}

#[test]
fn steps_are_counted_without_slivers() {
    let dt = 1.0 / 30.0;
    let steps = |span| rollout(Integrator::Se3Mid, dt).steps(span);
    assert_eq!(steps([0.7, 0.7]), []);
    assert_eq!(steps([0.0, 3.0 * dt + 1e-9]).len(), 3);
    assert_eq!(steps([0.0, 3.0 * dt - 1e-9]).len(), 3);
    assert_eq!(steps([0.0, 3.1 * dt]).len(), 4);
    let back = steps([0.25, 0.0]);
    assert_eq!(back.len(), 8);
    assert!(back.iter().all(|(_, h)| *h < 0.0) && (back.iter().map(|s| s.1).sum::<f64>() + 0.25).abs() < 1e-15);
    let (begin, h) = back[7];
    assert_eq!(begin + h, 0.0);
    assert_eq!(rollout(Integrator::Se3Mid, 0.0).steps([0.0, 2.0]), [(0.0, 2.0)]);
    assert_eq!(rollout(Integrator::Se3Mid, 1e-30).steps([0.0, 1.0]).len(), 1_000_000);
}
