//! Derivatives of a motion: velocity, acceleration and jerk of the body's origin, rotation vectors, and the spatial twist.
//!
//! With `c` the body's origin, `w` its rotation vector and `o` a fixed point of the world, a rigid body has the velocity field
//! ```text
//! u(x) = v̄ + w × (x − o)        v̄  = c' − w × (c − o)
//!                               v̄' = c″ − w' × (c − o) − w × c'
//!                               v̄″ = c‴ − w″ × (c − o) − 2 w' × c' − w × c″
//! ```
//! (TRACE, Li, Song and Yang, ICCV 2025; the term `w × c'` of `v̄'` is missing there, which matters where the centre moves
//! across the axis). Derivatives by the clock become those by time through the chain rule.

use glam::DVec3;
use gs_physics::{Motion as TwistMotion, Twist};

use super::motion::Motion;

/// Derivatives of a body's pose at one time, per unit of normalised time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// World position of the body's origin, its velocity, acceleration and jerk.
    pub centre: [DVec3; 4],
    /// Angular velocity (right-hand rule, radians) and its first two derivatives.
    pub turn: [DVec3; 3],
}

impl Motion {
    /// The derivatives of the pose at time `t`. Where a [`super::motion::Burst`] begins or ends, accelerations and jerks are those within it.
    pub fn rates(&self, t: f64) -> Rates {
        let s = self.clock(t);
        let [s1, s2, s3] = self.burst.map_or([1.0, 0.0, 0.0], |b| b.rates(t));
        let [c1, c2, c3] = self.centre_by_clock(s);
        let (w, gain) = self.turn_by_clock(s);
        Rates {
            centre: [
                self.at(t).translation,
                c1 * s1,
                c2 * s1 * s1 + c1 * s2,
                c3 * s1.powi(3) + 3.0 * c2 * s1 * s2 + c1 * s3,
            ],
            turn: [w * s1, gain * s1 * s1 + w * s2, 3.0 * gain * s1 * s2 + w * s3],
        }
    }

    /// Rotation vector and its derivative by the clock; the second derivative is zero.
    fn turn_by_clock(&self, s: f64) -> (DVec3, DVec3) {
        let axis = self.spin_axis.normalize_or_zero();
        (axis * (self.spin_rate + self.spin_gain * s), axis * self.spin_gain)
    }

    /// First three derivatives of the body's origin by the clock.
    fn centre_by_clock(&self, s: f64) -> [DVec3; 3] {
        const TURN: f64 = std::f64::consts::TAU;
        let (w, gain) = self.turn_by_clock(s);
        let arm = self.turn(s) * -self.pivot;
        let arm1 = w.cross(arm);
        let arm2 = gain.cross(arm) + w.cross(arm1);
        let arm3 = 2.0 * gain.cross(arm1) + w.cross(arm2);
        // The k-th derivatives of sine and cosine are a quarter turn ahead, k times.
        let orbit = |k: i32| {
            let ahead = self.orbit_phase + self.orbit_rate * s + 0.25 * TURN * f64::from(k);
            DVec3::new(ahead.cos(), ahead.sin(), 0.0) * (self.orbit_radius * self.orbit_rate.powi(k))
        };
        let bob = |k: i32| {
            let rate = TURN * self.bob_rate;
            self.bob * (rate.powi(k) * (rate * s + 0.25 * TURN * f64::from(k)).sin())
        };
        [
            arm1 + self.velocity + self.gravity * s + orbit(1) + bob(1),
            arm2 + self.gravity + orbit(2) + bob(2),
            arm3 + orbit(3) + bob(3),
        ]
    }
}

impl Rates {
    /// The spatial twist about `origin`, a world point, with its first two derivatives.
    pub fn twist(&self, origin: DVec3) -> TwistMotion<f64> {
        let ([c, c1, c2, c3], [w, w1, w2]) = (self.centre, self.turn);
        let arm = c - origin;
        let twist = |v: DVec3, w: DVec3| Twist { v: v.to_array(), w: w.to_array() };
        TwistMotion {
            twist: twist(c1 - w.cross(arm), w),
            rate: twist(c2 - w1.cross(arm) - w.cross(c1), w1),
            jerk: twist(c3 - w2.cross(arm) - 2.0 * w1.cross(c1) - w.cross(c2), w2),
        }
    }

    /// Velocity of the material point at the world position `x`.
    pub fn velocity(&self, x: DVec3) -> DVec3 {
        self.centre[1] + self.turn[0].cross(x - self.centre[0])
    }

    /// Acceleration of the material point at the world position `x`.
    pub fn acceleration(&self, x: DVec3) -> DVec3 {
        let arm = x - self.centre[0];
        self.centre[2] + self.turn[1].cross(arm) + self.turn[0].cross(self.turn[0].cross(arm))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Burst;

    /// Everything at once.
    fn busy() -> Motion {
        Motion {
            start: DVec3::new(0.2, -0.4, 0.3),
            tilt: DVec3::new(0.3, 0.8, -0.2),
            velocity: DVec3::new(0.5, -0.7, 1.1),
            gravity: DVec3::new(0.2, 0.4, -2.0),
            spin_axis: DVec3::new(0.4, -1.0, 2.0),
            spin_rate: 2.5,
            spin_gain: -1.7,
            pivot: DVec3::new(-0.6, 0.2, 0.5),
            orbit_radius: 0.4,
            orbit_rate: 3.0,
            orbit_phase: 0.4,
            bob: DVec3::new(0.1, 0.2, 0.3),
            bob_rate: 1.3,
            burst: None,
        }
    }

    /// `f'(t)` by central differences of fourth order.
    fn slope(f: impl Fn(f64) -> DVec3, t: f64) -> DVec3 {
        let h = 2e-4;
        (8.0 * (f(t + h) - f(t - h)) - (f(t + 2.0 * h) - f(t - 2.0 * h))) / (12.0 * h)
    }

    fn check(m: &Motion, t: f64) {
        let near = |a: DVec3, b: DVec3, what: &str| {
            assert!((a - b).length() < 1e-8 * (1.0 + b.length()), "{what} at {t}: {a} instead of {b}");
        };
        let body = DVec3::new(0.3, -0.2, 0.5);
        let at = |t: f64| m.at(t).apply(body);
        let r = m.rates(t);
        near(r.velocity(at(t)), slope(at, t), "velocity of a point");
        near(r.acceleration(at(t)), slope(|t| m.rates(t).velocity(at(t)), t), "its acceleration");
        for k in 0..3 {
            near(r.centre[k + 1], slope(|t| m.rates(t).centre[k], t), "derivatives of the centre");
        }
        for k in 0..2 {
            near(r.turn[k + 1], slope(|t| m.rates(t).turn[k], t), "derivatives of the turn");
        }
        let origin = DVec3::new(-0.4, 0.9, 0.2);
        let v = |t: f64| DVec3::from(m.rates(t).twist(origin).twist.v);
        let rate = |t: f64| DVec3::from(m.rates(t).twist(origin).rate.v);
        let twist = r.twist(origin);
        near(v(t) + r.turn[0].cross(at(t) - origin), slope(at, t), "velocity field of the twist");
        near(twist.rate.v.into(), slope(v, t), "rate of the twist, equation (1)");
        near(twist.jerk.v.into(), slope(rate, t), "jerk of the twist");
        assert_eq!([twist.twist.w, twist.rate.w, twist.jerk.w], r.turn.map(|w| w.to_array()));
    }

    #[test]
    fn rates_are_the_slopes_of_poses() {
        let hurried = Motion { burst: Some(Burst { from: 0.5, until: 0.75, share: 0.6 }), ..busy() };
        for t in [-0.2, 0.0, 0.3, 0.6, 0.7, 0.9, 1.3] {
            check(&busy(), t);
            check(&hurried, t);
        }
        assert_eq!(Motion::default().rates(0.4).twist(DVec3::ONE), TwistMotion::default());
    }

    /// A rolling wheel: the point of contact rests, and the twist changes although neither hub nor spin accelerates.
    #[test]
    fn a_rolling_wheel_needs_the_moving_centre() {
        let pi = std::f64::consts::PI;
        let hub = Motion { start: DVec3::Z * 0.5, velocity: DVec3::X * (0.5 * pi), ..Motion::default() };
        let m = Motion { spin_axis: DVec3::Y, spin_rate: pi, ..hub };
        let twist = m.rates(0.0).twist(DVec3::ZERO);
        assert!(DVec3::from(twist.twist.v).length() < 1e-15 && m.rates(0.0).velocity(DVec3::ZERO).length() < 1e-15);
        assert!((DVec3::from(twist.rate.v) - DVec3::Z * (0.5 * pi * pi)).length() < 1e-12);
        assert_eq!((twist.rate.w, twist.jerk), ([0.0; 3], Twist::default()));
    }
}
