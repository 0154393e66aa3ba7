//! Bodies with closed forms.

use super::build::{Builder, Cell, rig};
use crate::character::Character;
use crate::clip::{Channel, Clip, Interpolation, Target};
use crate::skeleton::axis_angle;
use glam::{DVec3, Vec2, Vec3};
use std::f32::consts::TAU;

/// Side of the atlas, texels.
const ATLAS: usize = 256;

/// A sphere about the origin on one joint: `rings` bands of `segments` quads from pole to pole, one chart.
///
/// # Panics
/// In debug builds if there are fewer than 2 rings or 3 segments.
pub fn sphere(radius: f32, rings: usize, segments: usize) -> Character {
    debug_assert!(rings >= 2 && segments >= 3, "a sphere needs two rings of three segments");
    let mut body = Builder::default();
    let point = |s: f32, angle: f32| {
        let y = 1.0 - 2.0 * s;
        let ring = (1.0 - y * y).max(0.0).sqrt();
        radius * Vec3::new(ring * angle.cos(), y, ring * angle.sin())
    };
    body.lathe(Cell::new([0.0, 1.0], [0.0, 1.0]), [rings, segments], &point, &|_| vec![(0, 1.0)]);
    body.finish(rig(&[("body", None, [0.0; 3])]), "sphere", ATLAS)
}

/// A flat square of side `size` in the plane `z = 0`, facing `+z`: `cells × cells` quads, one joint, one chart.
pub fn plate(size: f32, cells: usize) -> Character {
    let mut body = Builder::default();
    let cell = Cell::new([0.0, 1.0], [0.0, 1.0]);
    body.chart(cell);
    let side = cells as u32 + 1;
    for j in 0..side {
        for i in 0..side {
            let at = Vec2::new(i as f32, j as f32) / cells as f32;
            body.vertex((size * Vec2::new(at.x - 0.5, 0.5 - at.y)).extend(0.0), vec![(0, 1.0)]);
            body.uv(cell.place(at));
        }
    }
    for j in 0..side - 1 {
        for i in 0..side - 1 {
            let a = j * side + i;
            let [b, c, d] = [a + 1, a + side, a + side + 1];
            body.face([a, c, d], [a, c, d]);
            body.face([a, d, b], [a, d, b]);
        }
    }
    body.finish(rig(&[("body", None, [0.0; 3])]), "plate", ATLAS)
}

/// Shape of a [`cylinder`] with two bones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cylinder {
    /// Radius, metres. Default: 0.2.
    pub radius: f32,
    /// Extent along `y`, from 0, metres. Default: 1.
    pub height: f32,
    /// Length around the middle over which the upper bone's weight grows linearly from 0 to 1, metres. Default: 0.4.
    pub ramp: f32,
    /// Number of bands along `y` and of quads around. Default: 24 and 32.
    pub bands: [usize; 2],
}

impl Default for Cylinder {
    fn default() -> Self {
        Self { radius: 0.2, height: 1.0, ramp: 0.4, bands: [24, 32] }
    }
}

/// A cylinder with three charts: its side unrolled, its two caps as disks. Clips, 1 s each from 0 to a right angle:
/// `bend` (about `x`) and `twist` (about `y`) of the upper half.
pub fn cylinder(shape: &Cylinder) -> Character {
    let Cylinder { radius, height, ramp, bands: [along, around] } = *shape;
    let mut body = Builder::default();
    let side = Cell::new([0.0, 1.0], [0.0, 0.5]);
    let weights = |y: f32| {
        let upper = ((y - 0.5 * height) / ramp.max(f32::MIN_POSITIVE) + 0.5).clamp(0.0, 1.0);
        vec![(0, 1.0 - upper), (1, upper)]
    };
    let ring = |i: usize| Vec2::from_angle(TAU * i as f32 / around as f32);
    body.chart(side);
    for k in 0..=along {
        let y = height * k as f32 / along as f32;
        for i in 0..around {
            let p = radius * ring(i);
            body.vertex(Vec3::new(p.x, y, p.y), weights(y));
        }
        for i in 0..=around {
            body.uv(side.place(Vec2::new(i as f32 / around as f32, k as f32 / along as f32)));
        }
    }
    for k in 0..along {
        for i in 0..around {
            let v = |k: usize, i: usize| (k * around + i % around) as u32;
            let t = |k: usize, i: usize| (k * (around + 1) + i) as u32;
            body.face([v(k, i), v(k + 1, i), v(k + 1, i + 1)], [t(k, i), t(k + 1, i), t(k + 1, i + 1)]);
            body.face([v(k, i), v(k + 1, i + 1), v(k, i + 1)], [t(k, i), t(k + 1, i + 1), t(k, i + 1)]);
        }
    }
    for (cap, k) in [(0, 0), (1, along)] {
        let cell = Cell::new([0.5 * cap as f32, 0.5 + 0.5 * cap as f32], [0.5, 1.0]);
        let y = height * cap as f32;
        let centre = body.vertex(Vec3::Y * y, weights(y));
        body.chart(cell);
        let middle = body.uv(cell.place(Vec2::splat(0.5)));
        let rim: Vec<u32> = (0..around).map(|i| body.uv(cell.place(0.5 + 0.5 * ring(i)))).collect();
        for i in 0..around {
            let j = (i + 1) % around;
            let (a, b) = ((k * around + i) as u32, (k * around + j) as u32);
            if cap == 0 {
                body.face([centre, a, b], [middle, rim[i], rim[j]]);
            } else {
                body.face([centre, b, a], [middle, rim[j], rim[i]]);
            }
        }
    }
    body.orient_outwards(0);
    let half = f64::from(height) * 0.5;
    let skeleton = rig(&[("lower", None, [0.0; 3]), ("upper", Some(0), [0.0, half, 0.0])]);
    let clips = vec![quarter("bend", DVec3::X), quarter("twist", DVec3::Y)];
    Character { clips, ..body.finish(skeleton, "cylinder", ATLAS) }
}

fn quarter(name: &str, axis: DVec3) -> Clip {
    let values = [axis_angle(axis, 0.0), axis_angle(axis, std::f64::consts::FRAC_PI_2)].concat();
    let (target, interpolation) = (Target::Rotation(1), Interpolation::Linear);
    Clip { name: name.into(), channels: vec![Channel { target, interpolation, times: vec![0.0, 1.0], values }] }
}
