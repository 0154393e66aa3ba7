//! Skeleton and clips that the built-in figures of people share: 17 joints, four motions.

use super::build::{Builder, rig};
use crate::character::Character;
use crate::clip::{Channel, Clip, Interpolation, Target};
use crate::skeleton::axis_angle;
use glam::DVec3;
use std::f64::consts::TAU;

/// Side of the atlas, texels.
const ATLAS: usize = 512;
/// Keys of each channel of a clip.
const KEYS: usize = 33;

/// Rows of joints.
pub(super) const HIPS: u32 = 0;
pub(super) const SPINE: u32 = 1;
pub(super) const CHEST: u32 = 2;
pub(super) const NECK: u32 = 3;
pub(super) const HEAD: u32 = 4;
/// Left side (`+x`); rows of the right side are one higher.
pub(super) const UPPER_ARM: u32 = 5;
pub(super) const FORE_ARM: u32 = 7;
pub(super) const HAND: u32 = 9;
pub(super) const THIGH: u32 = 11;
pub(super) const SHIN: u32 = 13;
pub(super) const FOOT: u32 = 15;

const JOINTS: [(&str, Option<u32>, [f64; 3]); 17] = [
    ("hips", None, [0.0, 0.95, 0.0]),
    ("spine", Some(HIPS), [0.0, 1.08, 0.0]),
    ("chest", Some(SPINE), [0.0, 1.25, 0.0]),
    ("neck", Some(CHEST), [0.0, 1.46, 0.0]),
    ("head", Some(NECK), [0.0, 1.56, 0.0]),
    ("left upper arm", Some(CHEST), [0.19, 1.4, 0.0]),
    ("right upper arm", Some(CHEST), [-0.19, 1.4, 0.0]),
    ("left fore arm", Some(UPPER_ARM), [0.46, 1.4, 0.0]),
    ("right fore arm", Some(UPPER_ARM + 1), [-0.46, 1.4, 0.0]),
    ("left hand", Some(FORE_ARM), [0.71, 1.4, 0.0]),
    ("right hand", Some(FORE_ARM + 1), [-0.71, 1.4, 0.0]),
    ("left thigh", Some(HIPS), [0.1, 0.9, 0.0]),
    ("right thigh", Some(HIPS), [-0.1, 0.9, 0.0]),
    ("left shin", Some(THIGH), [0.1, 0.5, 0.0]),
    ("right shin", Some(THIGH + 1), [-0.1, 0.5, 0.0]),
    ("left foot", Some(SHIN), [0.1, 0.09, 0.0]),
    ("right foot", Some(SHIN + 1), [-0.1, 0.09, 0.0]),
];

/// Weights of all morphs at a phase of a clip, 0 to 2π.
pub(super) type Weights = fn(f64) -> Vec<f64>;

/// The finished character: `body` with its morphs set, on the skeleton, with the clips `walk` (1 s, on the spot), `wave` (2 s,
/// right arm), `turn` (4 s, once about the vertical) and `touch` (2 s, the left hand to the belly and back). Each ends where it
/// begins.
pub(super) fn animated(body: Builder, name: &str, weights: Weights) -> Character {
    let mut skeleton = rig(&JOINTS);
    skeleton.root = HIPS;
    skeleton.rest_morphs = vec![0.0; body.template.morphs.len()];
    let clips = [walk, wave, turn, touch].map(|clip| clip(weights)).into();
    Character { clips, ..body.finish(skeleton, name, ATLAS) }
}

pub(super) fn mirrored(side: u32) -> f32 {
    if side == 0 { 1.0 } else { -1.0 }
}

/// A clip of `seconds`, whose channels are functions of a phase from 0 to 2π.
struct Motion {
    clip: Clip,
    times: Vec<f64>,
    seconds: f64,
}

impl Motion {
    /// `weights` are those of all morphs.
    fn new(name: &str, seconds: f64, weights: Weights) -> Self {
        let times = (0..KEYS).map(|k| seconds * k as f64 / (KEYS - 1) as f64).collect();
        let mut motion = Self { clip: Clip { name: name.into(), channels: Vec::new() }, times, seconds };
        motion.keys(Target::Morphs { first: 0, count: weights(0.0).len() as u32 }, weights);
        motion
    }

    fn keys(&mut self, target: Target, value: impl Fn(f64) -> Vec<f64>) {
        let values = self.times.iter().flat_map(|t| value(TAU * t / self.seconds)).collect();
        let times = self.times.clone();
        self.clip.channels.push(Channel { target, interpolation: Interpolation::Linear, times, values });
    }

    fn turn(&mut self, joint: u32, axis: DVec3, angle: impl Fn(f64) -> f64) {
        self.keys(Target::Rotation(joint), |p| axis_angle(axis, angle(p)).to_vec());
    }

    /// Both arms hang, swinging by `swing` radians against one another.
    fn arms_down(&mut self, swing: f64, sides: &[u32]) {
        for &side in sides {
            let sign = f64::from(mirrored(side));
            let (axis, hang) = (DVec3::new(0.0, 0.0, 1.0), -1.2 * sign);
            self.keys(Target::Rotation(UPPER_ARM + side), |p| {
                let swung = axis_angle(DVec3::X, sign * swing * p.sin());
                gs_core::rot::hamilton(swung, axis_angle(axis, hang)).to_vec()
            });
            self.turn(FORE_ARM + side, DVec3::Y, |_| -0.25 * sign);
        }
    }
}

fn walk(weights: Weights) -> Clip {
    let mut m = Motion::new("walk", 1.0, weights);
    let hips = DVec3::from_array(JOINTS[HIPS as usize].2);
    m.keys(Target::Translation(HIPS), |p| (hips + DVec3::Y * 0.02 * ((2.0 * p).cos() - 1.0)).to_array().to_vec());
    m.turn(HIPS, DVec3::Y, |p| 0.08 * p.sin());
    m.turn(CHEST, DVec3::Y, |p| -0.12 * p.sin());
    for side in [0, 1] {
        let sign = f64::from(mirrored(side));
        m.turn(THIGH + side, DVec3::X, move |p| -0.5 * sign * p.sin());
        m.turn(SHIN + side, DVec3::X, move |p| 0.45 - 0.4 * sign * p.cos());
        m.turn(FOOT + side, DVec3::X, move |p| 0.15 * sign * p.cos() - 0.1);
    }
    m.arms_down(0.5, &[0, 1]);
    m.clip
}

fn wave(weights: Weights) -> Clip {
    let mut m = Motion::new("wave", 2.0, weights);
    m.arms_down(0.05, &[0]);
    m.turn(UPPER_ARM + 1, DVec3::Z, |p| -0.35 - 0.1 * p.sin());
    m.turn(FORE_ARM + 1, DVec3::Z, |p| -1.2 - 0.5 * (2.0 * p).sin());
    m.turn(HAND + 1, DVec3::Z, |p| -0.3 * (2.0 * p).cos());
    m.turn(HEAD, DVec3::Z, |p| 0.1 * p.sin());
    m.clip
}

fn turn(weights: Weights) -> Clip {
    let mut m = Motion::new("turn", 4.0, weights);
    m.turn(HIPS, DVec3::Y, |p| p);
    m.arms_down(0.1, &[0, 1]);
    m.clip
}

/// The left hand comes to lie on the belly in the last half of the clip and leaves it.
fn touch(weights: Weights) -> Clip {
    let mut m = Motion::new("touch", 2.0, weights);
    m.arms_down(0.0, &[1]);
    // 0: the arm hangs; 1: the hand touches, and is 3 to 5 mm inside.
    let near = |p: f64| (0.5 - 0.7 * p.sin()).clamp(0.0, 1.0);
    let angle = move |p: f64, [hangs, touches]: [f64; 2]| hangs + (touches - hangs) * near(p);
    m.keys(Target::Rotation(UPPER_ARM), |p| {
        let swung = axis_angle(DVec3::X, angle(p, [0.0, 0.33]));
        let turned = [(DVec3::Z, [-1.2, -0.93]), (DVec3::X, [0.0, 0.78])];
        let turned = turned.map(|(axis, between)| axis_angle(axis, angle(p, between)));
        turned.into_iter().fold(swung, gs_core::rot::hamilton).to_vec()
    });
    m.turn(FORE_ARM, DVec3::Y, |p| angle(p, [-0.25, -2.02]));
    m.turn(HAND, DVec3::Z, |p| angle(p, [0.0, -0.37]));
    m.clip
}
