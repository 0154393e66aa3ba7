//! The person as one watertight surface.
//!
//! The trunk reaches from the hips to the top of the head. It ends below with an open ring, and a block of its quads is left
//! out at each shoulder. Every limb is a tube that begins with the vertices of such a border: for a leg half of the lowest
//! ring, closed by a seam between the legs. So all parts share whole edges.

use super::build::{Builder, Cell, chain};
use super::motion::{CHEST, FOOT, FORE_ARM, HAND, HEAD, HIPS, NECK, SHIN, SPINE, THIGH, UPPER_ARM, animated, mirrored};
use super::person::{BLEND, breathing, ease, girth, morphs, shank, skull, sleeve};
use crate::character::Character;
use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// Quads around the trunk and bands from its lowest ring, at this height, to the top of the head.
const AROUND: usize = 32;
const BANDS: usize = 44;
const LOWEST: f32 = 0.88;
/// The quads left out at a shoulder: bands, and quads on either side of the middle.
const SHOULDER: (std::ops::Range<usize>, usize) = (15..20, 2);
/// Shares of a leg's bands above its ankle, and above the fore foot.
const ANKLE: f32 = 0.7;
const HEEL: f32 = 0.82;

/// The [person](super::person()) as one watertight surface of one component: about its shape, its joints, clips and morphs,
/// five charts. It is not the same subject: figures measured on one do not hold of the other.
pub fn body() -> Character {
    let mut body = Builder::default();
    let rows = trunk(&mut body);
    let seam = seam(&mut body, &rows[0]);
    for side in [0, 1] {
        arm(&mut body, side, shoulder(&rows, side));
        leg(&mut body, side, hip(&rows[0], &seam, side));
    }
    body.orient_outwards(0);
    body.template.morphs = morphs(&body.template.vertices);
    animated(body, "body", breathing)
}

/// The middle column of the left or the right side.
fn column(side: u32) -> usize {
    if side == 0 { 0 } else { AROUND / 2 }
}

fn trunk(body: &mut Builder) -> Vec<Vec<u32>> {
    let point = |s: f32, i: usize| {
        let (angle, y) = (TAU * i as f32 / AROUND as f32, LOWEST + (1.75 - LOWEST) * (FRAC_PI_2 * s).sin());
        let (torso, head) = ((y - 0.8) / 0.7, (y - 1.43) / 0.32);
        let [wide, deep] = girth(torso);
        let t = ((1.0 - torso) / 0.22).min(1.0);
        let (round, radius) = ((1.0 - (1.0 - t) * (1.0 - t)).max(0.0).sqrt(), skull(head));
        let (x, z) = ((wide * round).max(0.9 * radius), (deep * round).max(1.1 * radius));
        Vec3::new(x * angle.cos(), y, z * angle.sin() + 0.02 * head.max(0.0))
    };
    let weights = |p: Vec3| match p.y < 1.0 {
        // The legs share what lies between them.
        true => of_leg(p, ease(0.0, 1.0, p.x / 0.08 + 0.5)),
        false => chain(&[HIPS, SPINE, CHEST, NECK, HEAD], &[1.06, 1.22, 1.48, 1.57], 0.05, p.y),
    };
    let lowest = (0..AROUND).map(|i| body.vertex(point(0.0, i), weights(point(0.0, i)))).collect();
    let (bands, half) = SHOULDER;
    let hole = |band: usize, i: usize| {
        let at_side = |side: u32| (i + AROUND + half - column(side)) % AROUND < 2 * half;
        bands.contains(&band) && (at_side(0) || at_side(1))
    };
    body.tube(Cell::new([0.0, 0.5], [0.0, 1.0]), lowest, BANDS, &point, &weights, &hole)
}

/// Weights of a point of a leg; `left` is the share of the left one.
fn of_leg(p: Vec3, left: f32) -> Vec<(u32, f32)> {
    let along = chain(&[HIPS, THIGH, SHIN, FOOT], &[-0.9, -0.5, -0.09], BLEND, -p.y);
    let split = |(joint, w): (u32, f32)| match joint {
        HIPS => [(HIPS, w), (HIPS, 0.0)],
        _ => [(joint, w * left), (joint + 1, w * (1.0 - left))],
    };
    along.into_iter().flat_map(split).collect()
}

/// Three vertices between the legs, from the front to the back.
fn seam(body: &mut Builder, lowest: &[u32]) -> Vec<u32> {
    let front = body.template.vertices[lowest[AROUND / 4] as usize];
    let vertex = |j: u8| {
        let angle = 0.25 * PI * f32::from(j);
        let p = Vec3::new(0.0, front.y - 0.07 * angle.sin(), front.z * angle.cos());
        body.vertex(p, of_leg(p, 0.5))
    };
    (1..4).map(vertex).collect()
}

/// The border of the quads left out at a shoulder: along the lower edge, up, back along the upper one, down.
fn shoulder(rows: &[Vec<u32>], side: u32) -> Vec<u32> {
    let (bands, half) = SHOULDER;
    let at = |k: usize, i: usize| rows[k][(column(side) + AROUND - half + i) % AROUND];
    let (low, high, last) = (bands.start, bands.end, 2 * half);
    let along = (0..last).map(|i| at(low, i)).chain((low..high).map(|k| at(k, last)));
    along.chain((1..=last).rev().map(|i| at(high, i))).chain((low + 1..=high).rev().map(|k| at(k, 0))).collect()
}

/// Half of the lowest ring, against its order, and the seam.
fn hip(lowest: &[u32], seam: &[u32], side: u32) -> Vec<u32> {
    let quarter = AROUND / 4;
    let half = (0..=2 * quarter).map(|i| lowest[(column(side) + quarter + AROUND - i) % AROUND]);
    let mut seam = seam.to_vec();
    if side == 0 {
        seam.reverse();
    }
    half.chain(seam).collect()
}

fn arm(body: &mut Builder, side: u32, border: Vec<u32>) {
    let (sign, starts) = (mirrored(side), places(body, &border));
    let point = |s: f32, i: usize| {
        let from = starts[i];
        let x = from.x.abs() + (0.87 - from.x.abs()) * (FRAC_PI_2 * s).sin();
        let ([tall, deep], angle) = (sleeve((x - 0.13) / 0.74), from.z.atan2(from.y - 1.4));
        Vec3::new(sign * x, 1.4 + tall * angle.cos(), deep * angle.sin())
    };
    let joints = [CHEST, UPPER_ARM + side, FORE_ARM + side, HAND + side];
    // Beyond the widest of the chest, which no arm carries.
    let weights = |p: Vec3| chain(&joints, &[0.26, 0.46, 0.71], BLEND, p.x.abs());
    let u = 0.5 + 0.25 * side as f32;
    body.tube(Cell::new([u, u + 0.25], [0.62, 1.0]), border, 32, &point, &weights, &|_, _| false);
}

/// A leg down to the ankle; rings that turn about the instep, which make the heel; the fore foot.
fn leg(body: &mut Builder, side: u32, border: Vec<u32>) {
    let (middle, starts) = (0.1 * mirrored(side), places(body, &border));
    let (ankle, instep) = (0.095, 0.045);
    let point = |s: f32, i: usize| {
        let from = starts[i];
        let y = from.y + (ankle - from.y) * (s / ANKLE).min(1.0);
        let (sine, cosine) = from.z.atan2(from.x - middle).sin_cos();
        if s < HEEL {
            let (radius, turn) = (shank((0.95 - y) / 0.9), FRAC_PI_2 * ((s - ANKLE) / (HEEL - ANKLE)).max(0.0));
            let behind = radius * sine - instep;
            let turned =
                if turn > 0.0 { [y + behind * turn.sin(), instep + behind * turn.cos()] } else { [y, radius * sine] };
            return Vec3::new(middle + radius * cosine, turned[0], turned[1]);
        }
        let t = (FRAC_PI_2 * (s - HEEL) / (1.0 - HEEL)).sin();
        let (round, tall) = ((1.0 - t.powi(4)).max(0.0).sqrt(), ease(0.04, 0.022, t));
        Vec3::new(middle + 0.04 * round * cosine, 0.01 + tall * (1.0 + round * sine), instep + 0.135 * t)
    };
    let left = if side == 0 { 1.0 } else { 0.0 };
    let u = 0.5 + 0.25 * side as f32;
    let cell = Cell::new([u, u + 0.25], [0.0, 0.62]);
    body.tube(cell, border, 34, &point, &|p| of_leg(p, left), &|_, _| false);
}

fn places(body: &Builder, rows: &[u32]) -> Vec<Vec3> {
    rows.iter().map(|&v| body.template.vertices[v as usize]).collect()
}
