//! Scenes of rigid mechanics, for extrapolation: the motion after the last training view follows from the motion before it.
//!
//! Twists are polynomials of time of at most first degree, which a law of second order extrapolates exactly, except for
//! `projectile`, whose velocity field has the quadratic term `−½ w × gravity t²`.

use glam::DVec3;

use super::body::{Body, Shape};
use super::motion::Motion;

const RED: [[f64; 3]; 2] = [[0.86, 0.24, 0.18], [0.97, 0.88, 0.72]];
const BLUE: [[f64; 3]; 2] = [[0.14, 0.42, 0.78], [0.80, 0.92, 0.95]];
const GREEN: [[f64; 3]; 2] = [[0.20, 0.58, 0.30], [0.93, 0.85, 0.35]];
const VIOLET: [[f64; 3]; 2] = [[0.56, 0.25, 0.62], [0.95, 0.72, 0.45]];
const GREY: [[f64; 3]; 2] = [[0.42, 0.44, 0.48], [0.80, 0.80, 0.76]];

/// A body; `pattern` is so fine that no face has one colour.
fn body(name: &'static str, shape: Shape, motion: Motion, colors: [[f64; 3]; 2], pattern: f64) -> Body {
    Body { name, shape, motion, colors, pattern }
}

fn block(x: f64, y: f64, z: f64) -> Shape {
    Shape::Box { half: DVec3::new(x, y, z) }
}

/// The motion of a body at rest.
fn at_rest(start: DVec3) -> Motion {
    Motion { start, ..Motion::default() }
}

/// A slab at rest with its upper side at this height.
fn slab(top: f64) -> Body {
    body("slab", block(0.72, 0.72, 0.05), at_rest(DVec3::Z * (top - 0.05)), GREY, 9.0)
}

/// A ball thrown in an arc, without turning: `u = v + gravity t`.
pub(super) fn falling() -> Vec<Body> {
    let thrown = Motion {
        start: DVec3::new(-0.75, -0.3, -0.25),
        velocity: DVec3::new(1.45, 0.55, 2.3),
        gravity: DVec3::Z * -4.4,
        ..Motion::default()
    };
    vec![body("ball", Shape::Sphere { radius: 0.25 }, thrown, RED, 14.0), slab(-0.67)]
}

/// A block that winds around an axis and advances along it at an even pace: its twist is constant.
pub(super) fn screw() -> Vec<Body> {
    let axis = DVec3::new(0.15, -0.1, 1.0);
    let winding = Motion {
        start: DVec3::new(0.45, 0.0, -0.3),
        velocity: axis * 0.75,
        spin_axis: axis,
        spin_rate: 4.2,
        pivot: DVec3::new(-0.45, 0.0, 0.0),
        ..Motion::default()
    };
    vec![body("block", block(0.26, 0.16, 0.18), winding, BLUE, 18.0), slab(-0.67)]
}

/// A wheel that rolls: the hub goes straight ahead, the tread is at rest where it is lowest.
pub(super) fn wheel() -> Vec<Body> {
    const RADIUS: f64 = 0.4;
    const SPEED: f64 = 1.5;
    /// Distance of tread and slab, so that no point of the surface belongs to both.
    const GAP: f64 = 0.02;
    let rolling = Motion {
        start: DVec3::new(-0.75, 0.1, -0.5 + GAP + RADIUS),
        tilt: DVec3::X * std::f64::consts::FRAC_PI_2,
        velocity: DVec3::X * SPEED,
        spin_axis: DVec3::Y,
        spin_rate: SPEED / RADIUS,
        ..Motion::default()
    };
    let disc = Shape::Wheel { radius: RADIUS, half_width: 0.14 };
    vec![body("wheel", disc, rolling, VIOLET, 13.0), slab(-0.5)]
}

/// A block that is thrown and rotates in flight.
pub(super) fn projectile() -> Vec<Body> {
    let thrown = Motion {
        start: DVec3::new(0.7, -0.25, -0.2),
        velocity: DVec3::new(-1.4, 0.5, 2.3),
        gravity: DVec3::new(0.0, 0.0, -4.4),
        spin_axis: DVec3::new(0.4, 1.0, 0.3),
        spin_rate: 4.0,
        ..Motion::default()
    };
    vec![body("block", block(0.26, 0.18, 0.14), thrown, GREEN, 18.6), slab(-0.67)]
}

/// A box at rest with a lid, a door and an arm that turn about hinges.
pub(super) fn hinge() -> Vec<Body> {
    const SIDE: f64 = 0.38;
    const GAP: f64 = 0.06;
    const THIN: f64 = 0.05;
    /// Centre of the box, such that the volume its parts sweep is around the origin and fills the images.
    const CENTRE: DVec3 = DVec3::new(-0.33, 0.1, -0.43);
    let edge = SIDE + GAP + THIN;
    let hinged = |from_centre: [f64; 3], pivot: [f64; 3], axis: DVec3, rate: f64| Motion {
        start: CENTRE + DVec3::from(from_centre),
        pivot: pivot.into(),
        spin_axis: axis,
        spin_rate: rate,
        ..Motion::default()
    };
    let lid = Motion { spin_gain: 1.2, ..hinged([0.0, 0.0, edge], [0.0, SIDE, 0.0], DVec3::NEG_X, 1.3) };
    let door = hinged([edge, 0.0, 0.0], [0.0, -SIDE, 0.0], DVec3::NEG_Z, 1.8);
    let arm = hinged([-edge, 0.19, 0.25], [0.0, -SIDE, 0.0], DVec3::X, 2.6);
    vec![
        body("lid", block(SIDE, SIDE, THIN), lid, RED, 8.7),
        body("door", block(THIN, SIDE, 0.35), door, BLUE, 8.7),
        body("arm", block(THIN, 0.53, 0.115), arm, GREEN, 8.7),
        body("base", block(SIDE, SIDE, SIDE), at_rest(CENTRE), GREY, 8.7),
    ]
}

/// A disc that turns about its own axis in front of a box: only its pattern shows the motion.
pub(super) fn spinner() -> Vec<Body> {
    const SIDE: f64 = 0.45;
    const THIN: f64 = 0.055;
    let turning = Motion {
        start: DVec3::new(0.0, -(SIDE + 0.065 + THIN), 0.0),
        tilt: DVec3::X * std::f64::consts::FRAC_PI_2,
        spin_axis: DVec3::Y,
        spin_rate: -4.5,
        ..Motion::default()
    };
    vec![
        body("disc", Shape::Wheel { radius: 0.38, half_width: THIN }, turning, VIOLET, 10.7),
        body("base", block(SIDE, SIDE, SIDE), Motion::default(), GREY, 7.3),
    ]
}

/// Two separate bodies with one rigid motion, and a third between them with another.
pub(super) fn twins() -> Vec<Body> {
    const ARM: f64 = 0.62;
    let twin = |side: f64| Motion {
        start: DVec3::new(side * ARM, 0.0, -0.3),
        velocity: DVec3::Z * 0.5,
        spin_axis: DVec3::Z,
        spin_rate: 2.2,
        pivot: DVec3::X * (-side * ARM),
        ..Motion::default()
    };
    let other = Motion {
        start: DVec3::new(0.0, 0.0, 0.35),
        velocity: DVec3::Z * -0.6,
        spin_axis: DVec3::new(0.3, 0.0, 1.0),
        spin_rate: -3.0,
        ..Motion::default()
    };
    vec![
        body("first twin", Shape::Sphere { radius: 0.24 }, twin(1.0), RED, 14.0),
        body("second twin", block(0.17, 0.17, 0.2), twin(-1.0), BLUE, 18.4),
        body("other", block(0.16, 0.14, 0.2), other, GREEN, 19.0),
        slab(-0.67),
    ]
}

/// A ball that is thrown, a wheel that rolls, and a block that rises while it turns.
pub(super) fn trio() -> Vec<Body> {
    const RADIUS: f64 = 0.3;
    /// Between tread and slab.
    const GAP: f64 = 0.02;
    let thrown = Motion {
        start: DVec3::new(-0.85, 0.45, -0.1),
        velocity: DVec3::new(1.3, 0.2, 2.0),
        gravity: DVec3::Z * -4.4,
        ..Motion::default()
    };
    let rolling = Motion {
        start: DVec3::new(-0.6, -0.5, -0.67 + GAP + RADIUS),
        tilt: DVec3::X * std::f64::consts::FRAC_PI_2,
        velocity: DVec3::X,
        spin_axis: DVec3::Y,
        spin_rate: 1.0 / RADIUS,
        ..Motion::default()
    };
    let rising = Motion {
        start: DVec3::new(0.6, 0.1, -0.35),
        velocity: DVec3::Z * 0.5,
        spin_axis: DVec3::Z,
        spin_rate: 2.5,
        ..Motion::default()
    };
    vec![
        body("ball", Shape::Sphere { radius: 0.28 }, thrown, RED, 14.0),
        body("wheel", Shape::Wheel { radius: RADIUS, half_width: 0.13 }, rolling, VIOLET, 15.0),
        body("block", block(0.2, 0.18, 0.2), rising, BLUE, 18.0),
        slab(-0.67),
    ]
}
