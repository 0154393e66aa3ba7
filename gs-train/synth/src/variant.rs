//! Variants of a scene: the same kinds of motion, seen from another side, at another pace, in other colours.
//!
//! All bodies share one turn about the world's z axis and one pace, so bodies that touch, roll or hang together still do. What
//! was chosen on the scenes as designed can be judged on scenes that nobody looked at.

use glam::{DMat3, DQuat};
use gs_core::rng::Rng;

use super::body::{Body, Shape};
use super::motion::Motion;

/// Range of the pace: 1 is the designed speed. Not much faster, since bodies would leave the cube that holds every scene.
const PACE: [f32; 2] = [0.75, FASTEST];
/// Largest pace of a scene whose bodies stay apart at it.
pub(super) const FASTEST: f32 = 1.1;
/// Range of the factor on each pattern's spatial frequency. Coarser, a face could have one colour.
const FINER: [f32; 2] = [0.9, 1.3];

/// Replaces the bodies of a scene by those of its variant; 0 leaves them as designed. A pace above `fastest` becomes one as far below it.
pub(super) fn vary(bodies: &mut [Body], variant: u64, fastest: f32) {
    if variant == 0 {
        return;
    }
    let mut rng = Rng::new(variant, "synth.variant", 0, 0);
    let angle = f64::from(rng.range(0.0, std::f32::consts::TAU));
    let drawn = rng.range(PACE[0], PACE[1]);
    let pace = f64::from(drawn.min(2.0 * fastest - drawn));
    for body in bodies {
        body.motion = paced(turned(body.motion, angle), pace);
        if let Shape::Sheet { pace: own, .. } = &mut body.shape {
            *own *= pace;
        }
        body.pattern *= f64::from(rng.range(FINER[0], FINER[1]));
        let first = rng.below(3) as usize;
        body.colors = body.colors.map(|c| std::array::from_fn(|k| c[(first + k) % 3]));
    }
}

/// The motion of the body in a world turned by `angle` about z.
fn turned(m: Motion, angle: f64) -> Motion {
    let turn = DMat3::from_rotation_z(angle);
    let tilt = DQuat::from_rotation_z(angle) * DQuat::from_scaled_axis(m.tilt);
    Motion {
        start: turn * m.start,
        tilt: tilt.to_scaled_axis(),
        velocity: turn * m.velocity,
        gravity: turn * m.gravity,
        spin_axis: turn * m.spin_axis,
        pivot: turn * m.pivot,
        orbit_phase: m.orbit_phase + angle,
        bob: turn * m.bob,
        ..m
    }
}

/// The motion along the same path, `pace` times as fast.
fn paced(m: Motion, pace: f64) -> Motion {
    Motion {
        velocity: m.velocity * pace,
        gravity: m.gravity * (pace * pace),
        spin_rate: m.spin_rate * pace,
        spin_gain: m.spin_gain * (pace * pace),
        orbit_rate: m.orbit_rate * pace,
        bob_rate: m.bob_rate * pace,
        ..m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{HALF_SIDE, SCENES, SynthOptions, truth};
    use glam::DVec3;

    /// A point of a variant is the designed point at the paced time, turned about z.
    #[test]
    fn a_variant_is_the_scene_turned_and_paced() {
        for scene in SCENES {
            let (designed, mut varied) = ((scene.bodies)(), (scene.bodies)());
            vary(&mut varied, 7, scene.fastest);
            let mut rng = Rng::new(7, "synth.variant", 0, 0);
            let turn = DMat3::from_rotation_z(f64::from(rng.range(0.0, std::f32::consts::TAU)));
            let pace = f64::from(rng.range(PACE[0], PACE[1]));
            for (b, v) in designed.iter().zip(&varied).filter(|(b, _)| b.motion.burst.is_none()) {
                for t in [0.0, 0.3, 1.0] {
                    let p = DVec3::new(0.11, -0.07, 0.05);
                    let (want, have) = (turn * b.position_of(p, pace * t), v.position_of(p, t));
                    assert!((want - have).length() < 1e-12, "{} of {}: {have} instead of {want}", b.name, scene.name);
                }
            }
        }
    }

    /// What was measured on variants whose bodies stay apart holds for the same bits.
    #[test]
    fn only_variants_that_were_too_fast_are_slower() {
        for scene in SCENES {
            let of = |variant: u64, fastest: f32| {
                let mut bodies = (scene.bodies)();
                vary(&mut bodies, variant, fastest);
                bodies
            };
            let slower: Vec<u64> = (1..=100).filter(|&v| of(v, scene.fastest) != of(v, FASTEST)).collect();
            let expected: &[u64] = match scene.name {
                "trio" => &[9, 13, 16, 21, 28, 33, 40, 47, 50, 55, 63, 80, 90, 92, 98],
                _ => &[],
            };
            assert_eq!(slower, expected, "{}", scene.name);
        }
    }

    #[test]
    fn variants_differ_and_none_leaves_the_cube() {
        for scene in SCENES {
            for variant in 0..20 {
                let truth = truth(scene.name, &SynthOptions { variant, ..Default::default() }).unwrap();
                for body in truth.bodies() {
                    for step in 0..=20 {
                        let centre = body.motion.at(f64::from(step) / 20.0).translation.abs().max_element();
                        assert!(centre < f64::from(HALF_SIDE), "{} of {} {variant}: {centre}", body.name, scene.name);
                    }
                }
            }
            let of = |variant| truth(scene.name, &SynthOptions { variant, ..Default::default() }).unwrap();
            assert_eq!(of(0).bodies(), (scene.bodies)(), "0 is the scene as designed");
            assert_ne!(of(1).bodies(), of(2).bodies());
        }
    }
}
