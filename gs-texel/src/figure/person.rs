//! The built-in person: torso, head, arms, legs and feet, 17 joints, three clips and two morphs.

use super::build::{Builder, Cell, chain, rig};
use crate::character::Character;
use crate::clip::{Channel, Clip, Interpolation, Target};
use crate::skeleton::{Skeleton, axis_angle};
use crate::template::Morph;
use glam::{DVec3, Vec3};
use std::f64::consts::TAU;

/// Side of the atlas, texels.
const ATLAS: usize = 512;
/// Half the length over which one joint takes over from another, metres.
const BLEND: f32 = 0.07;
/// Keys of each channel of a clip.
const KEYS: usize = 33;

/// Rows of joints.
const HIPS: u32 = 0;
const SPINE: u32 = 1;
const CHEST: u32 = 2;
const NECK: u32 = 3;
const HEAD: u32 = 4;
/// Left side (`+x`); rows of the right side are one higher.
const UPPER_ARM: u32 = 5;
const FORE_ARM: u32 = 7;
const HAND: u32 = 9;
const THIGH: u32 = 11;
const SHIN: u32 = 13;
const FOOT: u32 = 15;

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

/// A person of 1.75 m in a T-pose (bind and rest), about 3900 vertices, eight charts.
///
/// Clips: `walk` (1 s, on the spot), `wave` (2 s, right arm), `turn` (4 s, once about the vertical); each ends where it
/// begins. Morphs, animated by every clip: `breathe` (the chest, 2 cm at weight 1) and `swing` (the lower torso to its left,
/// 6 cm).
pub fn person() -> Character {
    let mut body = Builder::default();
    torso(&mut body);
    head(&mut body);
    for side in [0, 1] {
        arm(&mut body, side);
        leg(&mut body, side);
        foot(&mut body, side);
    }
    body.template.morphs = morphs(&body.template.vertices);
    let mut skeleton = rig(&JOINTS);
    skeleton.root = HIPS;
    skeleton.rest_morphs = vec![0.0; body.template.morphs.len()];
    let clips = vec![walk(&skeleton), wave(&skeleton), turn(&skeleton)];
    Character { clips, ..body.finish(skeleton, "person", ATLAS) }
}

/// Radius factor of a tube with rounded ends that take `cap` of its length.
fn rounded(s: f32, cap: f32) -> f32 {
    let t = (s.min(1.0 - s) / cap).min(1.0);
    (1.0 - (1.0 - t) * (1.0 - t)).max(0.0).sqrt()
}

/// `a` to `b`, smoothly, as `s` goes from 0 to 1.
fn ease(a: f32, b: f32, s: f32) -> f32 {
    let t = s.clamp(0.0, 1.0);
    a + (b - a) * t * t * (3.0 - 2.0 * t)
}

fn mirrored(side: u32) -> f32 {
    if side == 0 { 1.0 } else { -1.0 }
}

fn torso(body: &mut Builder) {
    let point = |s: f32, angle: f32| {
        let (low, high) = (0.8, 1.5);
        let y = low + (high - low) * s;
        // Hips, waist, chest, shoulders.
        let wide = if s < 0.4 { ease(0.175, 0.145, s / 0.4) } else { ease(0.145, 0.2, (s - 0.4) / 0.4) };
        let deep = if s < 0.4 { ease(0.125, 0.1, s / 0.4) } else { ease(0.1, 0.125, (s - 0.4) / 0.4) };
        let round = rounded(s, 0.22);
        Vec3::new(wide * round * angle.cos(), y, deep * round * angle.sin())
    };
    let weights = |p: Vec3| chain(&[HIPS, SPINE, CHEST, NECK], &[1.06, 1.22, 1.47], BLEND, p.y);
    body.lathe(Cell::new([0.0, 0.55], [0.0, 0.44]), [30, 32], &point, &weights);
}

fn head(body: &mut Builder) {
    let point = |s: f32, angle: f32| {
        // A neck that widens to an egg.
        let y = 1.43 + 0.32 * s;
        let egg = ((s - 0.64) / 0.36).clamp(-1.0, 1.0);
        let radius = (0.1 * (1.0 - egg * egg).max(0.0).sqrt()).max(0.055 * rounded(s, 0.1));
        Vec3::new(0.9 * radius * angle.cos(), y, 1.1 * radius * angle.sin() + 0.02 * s)
    };
    let weights = |p: Vec3| chain(&[CHEST, NECK, HEAD], &[1.45, 1.56], 0.03, p.y);
    body.lathe(Cell::new([0.55, 1.0], [0.0, 0.24]), [24, 24], &point, &weights);
}

fn arm(body: &mut Builder, side: u32) {
    let sign = mirrored(side);
    let point = |s: f32, angle: f32| {
        let x = 0.13 + 0.74 * s;
        let thick = if s < 0.75 { ease(0.06, 0.034, s / 0.75) } else { ease(0.034, 0.042, (s - 0.75) / 0.12) };
        let flat = ease(1.0, 0.5, (s - 0.72) / 0.15);
        let round = thick * rounded(s, 0.1);
        Vec3::new(sign * x, 1.4 + flat * round * angle.cos(), round * angle.sin())
    };
    let joints = [CHEST, UPPER_ARM + side, FORE_ARM + side, HAND + side];
    let weights = |p: Vec3| chain(&joints, &[0.19, 0.46, 0.71], 0.6 * BLEND, p.x.abs());
    let u = 0.54 + 0.23 * side as f32;
    body.lathe(Cell::new([u, u + 0.23], [0.44, 1.0]), [32, 16], &point, &weights);
}

fn leg(body: &mut Builder, side: u32) {
    let sign = mirrored(side);
    let point = |s: f32, angle: f32| {
        let y = 0.95 - 0.9 * s;
        let thick = if s < 0.5 { ease(0.092, 0.058, s / 0.5) } else { ease(0.058, 0.04, (s - 0.6) / 0.35) };
        let round = thick * rounded(s, 0.08);
        Vec3::new(sign * 0.1 + round * angle.cos(), y, round * angle.sin())
    };
    let joints = [HIPS, THIGH + side, SHIN + side, FOOT + side];
    let weights = |p: Vec3| chain(&joints, &[-0.9, -0.5, -0.09], BLEND, -p.y);
    let u = 0.27 * side as f32;
    body.lathe(Cell::new([u, u + 0.27], [0.44, 1.0]), [28, 20], &point, &weights);
}

fn foot(body: &mut Builder, side: u32) {
    let sign = mirrored(side);
    let point = |s: f32, angle: f32| {
        let round = rounded(s, 0.4);
        let (wide, tall) = (0.045 * round, ease(0.055, 0.03, s) * round);
        Vec3::new(sign * 0.1 + wide * angle.cos(), 0.055 + tall * angle.sin(), -0.07 + 0.25 * s)
    };
    let u = 0.55 + 0.225 * side as f32;
    body.lathe(Cell::new([u, u + 0.225], [0.24, 0.44]), [12, 14], &point, &|_| vec![(FOOT + side, 1.0)]);
}

/// Smooth offsets of the torso, 0 at its ends.
fn morphs(vertices: &[Vec3]) -> Vec<Morph> {
    let bump = |x: f32, centre: f32, half: f32| {
        let t = (1.0 - ((x - centre) / half).powi(2)).max(0.0);
        t * t
    };
    let trunk = |v: Vec3| if v.x.abs() < 0.21 { bump(v.x, 0.0, 0.26) } else { 0.0 };
    let breathe = |&v: &Vec3| 0.02 * trunk(v) * bump(v.y, 1.3, 0.16) * Vec3::new(v.x, 0.0, v.z).normalize_or_zero();
    let swing = |&v: &Vec3| 0.06 * trunk(v) * bump(v.y, 0.9, 0.2) * Vec3::new(1.0, 0.0, 0.3);
    let morph = |name: &str, offsets: Vec<Vec3>| Morph { name: name.into(), offsets };
    vec![morph("breathe", vertices.iter().map(breathe).collect()), morph("swing", vertices.iter().map(swing).collect())]
}

/// A clip of `seconds`, whose channels are functions of a phase from 0 to 2π.
struct Motion {
    clip: Clip,
    times: Vec<f64>,
    seconds: f64,
}

impl Motion {
    fn new(name: &str, seconds: f64) -> Self {
        let times = (0..KEYS).map(|k| seconds * k as f64 / (KEYS - 1) as f64).collect();
        let mut motion = Self { clip: Clip { name: name.into(), channels: Vec::new() }, times, seconds };
        motion.keys(Target::Morphs { first: 0, count: 2 }, |p| vec![0.5 - 0.5 * p.cos(), (2.0 * p).sin()]);
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

fn walk(skeleton: &Skeleton) -> Clip {
    let mut m = Motion::new("walk", 1.0);
    let hips = skeleton.nodes[HIPS as usize].rest.translation;
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

fn wave(_: &Skeleton) -> Clip {
    let mut m = Motion::new("wave", 2.0);
    m.arms_down(0.05, &[0]);
    m.turn(UPPER_ARM + 1, DVec3::Z, |p| -0.35 - 0.1 * p.sin());
    m.turn(FORE_ARM + 1, DVec3::Z, |p| -1.2 - 0.5 * (2.0 * p).sin());
    m.turn(HAND + 1, DVec3::Z, |p| -0.3 * (2.0 * p).cos());
    m.turn(HEAD, DVec3::Z, |p| 0.1 * p.sin());
    m.clip
}

fn turn(_: &Skeleton) -> Clip {
    let mut m = Motion::new("turn", 4.0);
    m.turn(HIPS, DVec3::Y, |p| p);
    m.arms_down(0.1, &[0, 1]);
    m.clip
}
