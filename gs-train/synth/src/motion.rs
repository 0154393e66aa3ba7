//! Rigid motions with a closed form: a turn about a fixed axis, a drift or throw, an orbit about the world's z, a bob.
//!
//! ```text
//! x(t) = Q(s) exp([tilt]×) x_body + c(s),   Q(s) = exp(θ(s) [axis]×),   θ(s) = rate·s + ½ gain·s²
//! c(s) = start + (I − Q(s)) pivot + velocity·s + ½ gravity·s² + radius (cos φ, sin φ, 0) + bob sin(2π·bob_rate·s)
//! φ(s) = orbit_phase + orbit_rate·s
//! ```
//! `t` is the normalised time, `s(t)` the body's own clock (`s = t` without a [`Burst`]), angles are radians. Velocities and
//! twists: [`super::rates`].

use glam::{DMat3, DQuat, DVec3};
use serde::Serialize;

/// Parameters of a rigid motion; the default is at rest at the origin.
///
/// ```
/// use gs_synth::motion::Motion;
/// use glam::DVec3;
///
/// let thrown = Motion { velocity: DVec3::X, gravity: DVec3::Z * -2.0, ..Motion::default() };
/// assert_eq!(thrown.at(0.5).apply(DVec3::ZERO), DVec3::new(0.5, 0.0, -0.25));
/// assert_eq!(thrown.rates(0.5).velocity(DVec3::ZERO), DVec3::new(1.0, 0.0, -1.0));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize)]
pub struct Motion {
    /// Position of the body's origin at time 0, without orbit and bob.
    pub start: DVec3,
    /// Constant rotation of the body before its motion: axis times angle, radians.
    #[serde(skip_serializing_if = "at_zero")]
    pub tilt: DVec3,
    /// Velocity at time 0, world units per unit of time.
    pub velocity: DVec3,
    /// Constant acceleration, world units per squared unit of time.
    #[serde(skip_serializing_if = "at_zero")]
    pub gravity: DVec3,
    /// Axis of the rotation; any length, zero for no rotation.
    pub spin_axis: DVec3,
    /// Angular velocity at time 0, radians per unit of time.
    pub spin_rate: f64,
    /// Angular acceleration about the axis, radians per squared unit of time.
    #[serde(skip_serializing_if = "is_zero")]
    pub spin_gain: f64,
    /// Fixed point of the rotation, as an offset from `start`; zero for the body's origin.
    #[serde(skip_serializing_if = "at_zero")]
    pub pivot: DVec3,
    /// Radius of an orbit about the world's z axis, world units.
    pub orbit_radius: f64,
    /// Angular velocity of the orbit, radians per unit of time.
    pub orbit_rate: f64,
    /// Angle of the orbit at time 0, radians.
    pub orbit_phase: f64,
    /// Direction and amplitude of a sinusoidal oscillation, world units.
    pub bob: DVec3,
    /// Frequency of the oscillation, cycles per unit of time.
    pub bob_rate: f64,
    /// Makes a part of the motion faster; none for an even clock.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub burst: Option<Burst>,
}

fn at_zero(v: &DVec3) -> bool {
    *v == DVec3::ZERO
}

fn is_zero(v: &f64) -> bool {
    *v == 0.0
}

/// A clock that runs evenly except for an interval in which it advances by an additional `share`:
/// `s(t) = (1 − share) t + share h((t − from)/(until − from))`, `h(x) = x²(3 − 2x)` on `[0, 1]`, constant outside.
/// `s(0) = 0`, `s(1) = 1`, and `s` is continuously differentiable.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Burst {
    /// Begin of the interval, normalised time.
    pub from: f64,
    /// End of the interval, after its begin.
    pub until: f64,
    /// Share of the whole advance that is made in the interval, 0 to 1.
    pub share: f64,
}

impl Burst {
    /// The clock at time `t`.
    fn clock(&self, t: f64) -> f64 {
        let x = ((t - self.from) / (self.until - self.from)).clamp(0.0, 1.0);
        (1.0 - self.share) * t + self.share * x * x * (3.0 - 2.0 * x)
    }

    /// First three derivatives of the clock at time `t`; where the second jumps, its value within the burst.
    pub(super) fn rates(&self, t: f64) -> [f64; 3] {
        let length = self.until - self.from;
        let x = (t - self.from) / length;
        if !(0.0..=1.0).contains(&x) {
            return [1.0 - self.share, 0.0, 0.0];
        }
        let part = self.share / length;
        let first = 1.0 - self.share + part * 6.0 * x * (1.0 - x);
        [first, part / length * (6.0 - 12.0 * x), -12.0 * part / (length * length)]
    }

    /// Largest `ds/dt`, in the middle of the burst.
    fn fastest(&self) -> f64 {
        1.0 - self.share + 1.5 * self.share / (self.until - self.from)
    }
}

/// A rigid transform from body to world: `world = rotation · body + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidPose {
    /// Rotation from body to world.
    pub rotation: DMat3,
    /// Position of the body's origin in the world.
    pub translation: DVec3,
}

impl RigidPose {
    /// World position of a point of the body's frame.
    pub fn apply(&self, body: DVec3) -> DVec3 {
        self.rotation * body + self.translation
    }

    /// Position in the body's frame of a world point.
    pub fn invert(&self, world: DVec3) -> DVec3 {
        self.rotation.transpose() * (world - self.translation)
    }
}

impl Motion {
    /// Whether the pose depends on time.
    pub fn moves(&self) -> bool {
        self.velocity != DVec3::ZERO || self.gravity != DVec3::ZERO || self.cycles() > 0.0
    }

    /// Highest frequency of rotation, orbit and oscillation over the times `[0, 1]`, cycles per unit of time.
    pub fn cycles(&self) -> f64 {
        const TURN: f64 = std::f64::consts::TAU;
        let when = |moves: bool, cycles: f64| if moves { cycles.abs() } else { 0.0 };
        let spin = self.spin_rate.abs().max((self.spin_rate + self.spin_gain).abs());
        let even = when(self.spin_axis != DVec3::ZERO, spin / TURN)
            .max(when(self.orbit_radius != 0.0, self.orbit_rate / TURN))
            .max(when(self.bob != DVec3::ZERO, self.bob_rate));
        even * self.burst.map_or(1.0, |b| b.fastest())
    }

    /// The body's own clock at time `t`.
    pub(super) fn clock(&self, t: f64) -> f64 {
        self.burst.map_or(t, |b| b.clock(t))
    }

    /// `Q(s)`: the turn since the clock's zero.
    pub(super) fn turn(&self, s: f64) -> DMat3 {
        match self.spin_axis.try_normalize() {
            Some(axis) => DMat3::from_axis_angle(axis, self.spin_rate * s + 0.5 * self.spin_gain * s * s),
            None => DMat3::IDENTITY,
        }
    }

    /// The pose at the normalised time `t`.
    pub fn at(&self, t: f64) -> RigidPose {
        let t = self.clock(t);
        let turn = self.turn(t);
        let rotation = turn * DMat3::from_quat(DQuat::from_scaled_axis(self.tilt));
        let angle = self.orbit_phase + self.orbit_rate * t;
        let orbit = DVec3::new(angle.cos(), angle.sin(), 0.0) * self.orbit_radius;
        let bob = self.bob * (std::f64::consts::TAU * self.bob_rate * t).sin();
        let swing = self.pivot - turn * self.pivot;
        let drift = self.velocity * t + 0.5 * self.gravity * t * t;
        RigidPose { rotation, translation: self.start + swing + drift + orbit + bob }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_closed_form_holds() {
        let m = Motion {
            start: DVec3::new(0.0, 0.0, 1.0),
            velocity: DVec3::X,
            spin_axis: DVec3::Z * 5.0,
            spin_rate: std::f64::consts::PI,
            orbit_radius: 2.0,
            orbit_rate: std::f64::consts::PI,
            ..Motion::default()
        };
        let p = m.at(0.5);
        assert!((p.apply(DVec3::X) - DVec3::new(0.5, 3.0, 1.0)).length() < 1e-12, "{}", p.apply(DVec3::X));
        assert!((p.invert(p.apply(DVec3::new(0.3, 0.1, -0.7))) - DVec3::new(0.3, 0.1, -0.7)).length() < 1e-12);
        assert_eq!(Motion::default().at(0.7).apply(DVec3::ONE), DVec3::ONE);
        let tilted = Motion { tilt: DVec3::Y * std::f64::consts::FRAC_PI_2, ..Motion::default() };
        assert!((tilted.at(0.4).apply(DVec3::X) + DVec3::Z).length() < 1e-12 && !tilted.moves() && m.moves());
    }

    #[test]
    fn throws_gains_and_pivots() {
        let thrown = Motion { velocity: DVec3::X, gravity: DVec3::Z * -2.0, ..Motion::default() };
        assert!((thrown.at(0.5).translation - DVec3::new(0.5, 0.0, -0.25)).length() < 1e-15);
        let dropped = Motion { velocity: DVec3::ZERO, ..thrown };
        assert!(dropped.moves() && dropped.cycles() == 0.0);
        // A door: hinge one unit to the left of its centre, a quarter turn after half the time.
        let (axis, rate) = (DVec3::Z * 2.0, 0.5 * std::f64::consts::PI);
        let door =
            Motion { start: DVec3::X, spin_axis: axis, spin_rate: rate, spin_gain: 2.0 * rate, ..Motion::default() };
        let door = Motion { pivot: -DVec3::X, ..door };
        let turned = |t| door.at(t).apply(DVec3::X);
        assert!((turned(0.0) - DVec3::X * 2.0).length() < 1e-15);
        assert!((turned(1.0) + DVec3::X * 2.0).length() < 1e-12, "half a turn");
        assert!(
            (turned(0.5)
                - DVec3::new((0.375 * std::f64::consts::PI).cos(), (0.375 * std::f64::consts::PI).sin(), 0.0) * 2.0)
                .length()
                < 1e-12
        );
        assert!(door.at(0.73).apply(-DVec3::X).length() < 1e-12, "the hinge stays");
        assert!((door.cycles() - 0.75).abs() < 1e-12, "three times as fast at the end");
    }

    #[test]
    fn a_burst_makes_most_of_the_way_in_little_time() {
        let burst = Burst { from: 0.5, until: 0.625, share: 0.6 };
        let m = Motion { velocity: DVec3::X, burst: Some(burst), ..Motion::default() };
        let x = |t: f64| m.at(t).translation.x;
        assert!(x(0.0).abs() < 1e-15 && (x(1.0) - 1.0).abs() < 1e-15);
        assert!((x(0.625) - x(0.5) - (0.6 + 0.4 * 0.125)).abs() < 1e-12);
        let speed = |t: f64| (x(t + 1e-6) - x(t - 1e-6)) / 2e-6;
        assert!((speed(0.2) - 0.4).abs() < 1e-6 && (speed(0.8) - 0.4).abs() < 1e-6);
        assert!((speed(0.5625) - burst.fastest()).abs() < 1e-6);
        assert!((speed(0.5) - 0.4).abs() < 1e-3, "no jump of the speed");
    }
}
