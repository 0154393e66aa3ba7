//! The built-in person: torso, head, arms, legs and feet, 17 joints, and two morphs.

use super::build::{Builder, Cell, chain};
use super::motion::{CHEST, FOOT, FORE_ARM, HAND, HEAD, HIPS, NECK, SHIN, SPINE, THIGH, UPPER_ARM, animated, mirrored};
use crate::character::Character;
use crate::template::Morph;
use glam::Vec3;

/// Half the length over which one joint takes over from another, metres.
pub(super) const BLEND: f32 = 0.07;

/// A person of 1.75 m in a T-pose (bind and rest), about 3900 vertices, eight charts.
///
/// Clips: `walk` (1 s, on the spot), `wave` (2 s, right arm), `turn` (4 s, once about the vertical), `touch` (2 s, the left
/// hand to the belly and back); each ends where it begins. Morphs, animated by every clip: `breathe` (the chest, 2 cm at weight
/// 1) and `swing` (the lower torso to its left, 6 cm).
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
    animated(body, "person", breathing)
}

/// Radius factor of a tube with rounded ends that take `cap` of its length.
fn rounded(s: f32, cap: f32) -> f32 {
    let t = (s.min(1.0 - s) / cap).min(1.0);
    (1.0 - (1.0 - t) * (1.0 - t)).max(0.0).sqrt()
}

/// `a` to `b`, smoothly, as `s` goes from 0 to 1.
pub(super) fn ease(a: f32, b: f32, s: f32) -> f32 {
    let t = s.clamp(0.0, 1.0);
    a + (b - a) * t * t * (3.0 - 2.0 * t)
}

/// Half the width and the depth of the torso: hips, waist, chest, shoulders.
pub(super) fn girth(s: f32) -> [f32; 2] {
    let wide = if s < 0.4 { ease(0.175, 0.145, s / 0.4) } else { ease(0.145, 0.2, (s - 0.4) / 0.4) };
    let deep = if s < 0.4 { ease(0.125, 0.1, s / 0.4) } else { ease(0.1, 0.125, (s - 0.4) / 0.4) };
    [wide, deep]
}

pub(super) fn torso(body: &mut Builder) {
    let point = |s: f32, angle: f32| {
        let (low, high) = (0.8, 1.5);
        let y = low + (high - low) * s;
        let [wide, deep] = girth(s);
        let round = rounded(s, 0.22);
        Vec3::new(wide * round * angle.cos(), y, deep * round * angle.sin())
    };
    let weights = |p: Vec3| chain(&[HIPS, SPINE, CHEST, NECK], &[1.06, 1.22, 1.47], BLEND, p.y);
    body.lathe(Cell::new([0.0, 0.55], [0.0, 0.44]), [30, 32], &point, &weights);
}

/// Radius of a neck that widens to an egg.
pub(super) fn skull(s: f32) -> f32 {
    let egg = ((s - 0.64) / 0.36).clamp(-1.0, 1.0);
    (0.1 * (1.0 - egg * egg).max(0.0).sqrt()).max(0.055 * rounded(s, 0.1))
}

pub(super) fn head(body: &mut Builder) {
    let point = |s: f32, angle: f32| {
        let y = 1.43 + 0.32 * s;
        let radius = skull(s);
        Vec3::new(0.9 * radius * angle.cos(), y, 1.1 * radius * angle.sin() + 0.02 * s)
    };
    let weights = |p: Vec3| chain(&[CHEST, NECK, HEAD], &[1.45, 1.56], 0.03, p.y);
    body.lathe(Cell::new([0.55, 1.0], [0.0, 0.24]), [24, 24], &point, &weights);
}

/// Half the height and the depth of an arm: round, with a flat hand.
pub(super) fn sleeve(s: f32) -> [f32; 2] {
    let thick = if s < 0.75 { ease(0.06, 0.034, s / 0.75) } else { ease(0.034, 0.042, (s - 0.75) / 0.12) };
    let flat = ease(1.0, 0.5, (s - 0.72) / 0.15);
    let round = thick * rounded(s, 0.1);
    [flat * round, round]
}

pub(super) fn arm(body: &mut Builder, side: u32) {
    let sign = mirrored(side);
    let point = |s: f32, angle: f32| {
        let [tall, deep] = sleeve(s);
        Vec3::new(sign * (0.13 + 0.74 * s), 1.4 + tall * angle.cos(), deep * angle.sin())
    };
    let joints = [CHEST, UPPER_ARM + side, FORE_ARM + side, HAND + side];
    let weights = |p: Vec3| chain(&joints, &[0.19, 0.46, 0.71], 0.6 * BLEND, p.x.abs());
    let u = 0.54 + 0.23 * side as f32;
    body.lathe(Cell::new([u, u + 0.23], [0.44, 1.0]), [32, 16], &point, &weights);
}

/// Radius of a leg, from the hip to the ankle.
pub(super) fn shank(s: f32) -> f32 {
    if s < 0.5 { ease(0.092, 0.058, s / 0.5) } else { ease(0.058, 0.04, (s - 0.6) / 0.35) }
}

fn leg(body: &mut Builder, side: u32) {
    let sign = mirrored(side);
    let point = |s: f32, angle: f32| {
        let y = 0.95 - 0.9 * s;
        let round = shank(s) * rounded(s, 0.08);
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

/// Weights of [`morphs`].
pub(super) fn breathing(phase: f64) -> Vec<f64> {
    vec![0.5 - 0.5 * phase.cos(), (2.0 * phase).sin()]
}

/// Smooth offsets of the torso, 0 at its ends.
pub(super) fn morphs(vertices: &[Vec3]) -> Vec<Morph> {
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
