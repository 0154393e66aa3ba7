//! A person in a gown: clothing that swings late, which no joint moves.

use super::build::{Builder, Cell};
use super::motion::{HIPS, animated};
use super::person::{arm, head, torso};
use crate::character::Character;
use crate::template::Morph;
use glam::Vec3;
use std::ops::Range;

/// Height of the waist and of the hem, metres.
const WAIST: f32 = 1.06;
const HEM: f32 = 0.08;
/// How much later the hem swings than the waist, radians of the phase of the swing.
const LATE: f32 = 1.2;
/// Amplitudes of the hem along `x`, once in a clip, and along `z`, twice, metres.
const SWINGS: [f32; 2] = [0.08, 0.05];
/// Share of the profile that closes the skirt at either end.
const CAP: f32 = 0.01;

/// Torso, head and arms of the [person](super::person()), and a skirt from the waist to the ankles in place of legs: five
/// charts. Joints and clips are those of the person.
///
/// The skirt is bound to the hips. Morphs, animated by every clip, swing it: a point at the share `h` of the way from waist to
/// hem moves by `h² (0.08 sin(p − 1.2 h), 0, 0.05 sin(2 p − 1.2 h))` metres at the phase `p` of the clip. These are two morphs
/// an axis, as `sin(p − a) = sin p cos a − cos p sin a`.
pub fn gown() -> Character {
    let mut body = Builder::default();
    torso(&mut body);
    head(&mut body);
    let first = body.template.vertices.len();
    skirt(&mut body);
    let skirt = first..body.template.vertices.len();
    (0..2).for_each(|side| arm(&mut body, side));
    body.template.morphs = swings(&body.template.vertices, &skirt);
    animated(body, "gown", |p| vec![p.sin(), -p.cos(), (2.0 * p).sin(), -(2.0 * p).cos()])
}

/// A thin shell, closed at the waist inside the torso: down outside, up inside.
fn skirt(body: &mut Builder) {
    let point = |s: f32, angle: f32| {
        let outside = s < 0.5;
        let down = if outside { s } else { 1.0 - s };
        let (share, first) = if outside { (1.0, 0.0) } else { (0.94, 0.05) };
        let share = share * (down / CAP).min(1.0);
        let h = first + (1.0 - first) * ((down - CAP) / (0.5 - CAP)).max(0.0);
        let (wide, deep) = (0.16 + 0.14 * h, 0.115 + 0.165 * h);
        Vec3::new(share * wide * angle.cos(), WAIST + (HEM - WAIST) * h, share * deep * angle.sin())
    };
    body.lathe(Cell::new([0.0, 0.54], [0.44, 1.0]), [56, 36], &point, &|_| vec![(HIPS, 1.0)]);
}

/// The morphs, of the vertices of the skirt alone.
fn swings(vertices: &[Vec3], skirt: &Range<usize>) -> Vec<Morph> {
    let morph = |name: &str, axis: Vec3, part: fn(f32) -> f32| {
        let offset = |(i, v): (usize, &Vec3)| {
            let h = (WAIST - v.y) / (WAIST - HEM);
            if skirt.contains(&i) { h * h * part(LATE * h) * axis } else { Vec3::ZERO }
        };
        Morph { name: name.into(), offsets: vertices.iter().enumerate().map(offset).collect() }
    };
    let [x, z] = [SWINGS[0] * Vec3::X, SWINGS[1] * Vec3::Z];
    vec![
        morph("sway", x, f32::cos),
        morph("sway late", x, f32::sin),
        morph("swing", z, f32::cos),
        morph("swing late", z, f32::sin),
    ]
}
