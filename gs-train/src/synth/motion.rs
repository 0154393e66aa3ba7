//! Rigid motions with a closed form: a turn about a fixed axis, a drift, an orbit about the world's z, a bob.
//!
//! `x(t) = R(t) x_body + c(t)`, `R(t) = exp(rate·t [axis]×)`,
//! `c(t) = start + velocity·t + radius (cos φ, sin φ, 0) + bob sin(2π·bob_rate·t)`, `φ = orbit_phase + orbit_rate·t`;
//! `t` is the normalised time, angles are radians.

use glam::{DMat3, DVec3};
use serde::Serialize;

/// Parameters of a motion. The default stands still at the origin.
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize)]
pub struct Motion {
    /// Centre at time 0, without orbit and bob.
    pub start: DVec3,
    /// World units per unit of time.
    pub velocity: DVec3,
    /// Axis of the body's own turn; any length, zero for none.
    pub spin_axis: DVec3,
    /// Radians per unit of time.
    pub spin_rate: f64,
    /// Radius of the orbit.
    pub orbit_radius: f64,
    /// Radians per unit of time.
    pub orbit_rate: f64,
    /// Angle at time 0.
    pub orbit_phase: f64,
    /// Direction and amplitude of the bob.
    pub bob: DVec3,
    /// Turns per unit of time.
    pub bob_rate: f64,
}

/// A rigid transform from body to world: `world = rotation · body + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidPose {
    /// Rotation.
    pub rotation: DMat3,
    /// Where the body's origin is.
    pub translation: DVec3,
}

impl RigidPose {
    /// A body point in the world.
    pub fn apply(&self, body: DVec3) -> DVec3 {
        self.rotation * body + self.translation
    }

    /// A world point in the body's frame.
    pub fn invert(&self, world: DVec3) -> DVec3 {
        self.rotation.transpose() * (world - self.translation)
    }
}

impl Motion {
    /// Cycles per unit of time of the fastest of turn, orbit and bob.
    pub fn cycles(&self) -> f64 {
        const TURN: f64 = std::f64::consts::TAU;
        let when = |moves: bool, cycles: f64| if moves { cycles.abs() } else { 0.0 };
        when(self.spin_axis != DVec3::ZERO, self.spin_rate / TURN)
            .max(when(self.orbit_radius != 0.0, self.orbit_rate / TURN))
            .max(when(self.bob != DVec3::ZERO, self.bob_rate))
    }

    /// The pose at time `t`.
    pub fn at(&self, t: f64) -> RigidPose {
        let axis = self.spin_axis.normalize_or_zero();
        let turns = axis != DVec3::ZERO;
        let rotation = if turns { DMat3::from_axis_angle(axis, self.spin_rate * t) } else { DMat3::IDENTITY };
        let angle = self.orbit_phase + self.orbit_rate * t;
        let orbit = DVec3::new(angle.cos(), angle.sin(), 0.0) * self.orbit_radius;
        let bob = self.bob * (std::f64::consts::TAU * self.bob_rate * t).sin();
        RigidPose { rotation, translation: self.start + self.velocity * t + orbit + bob }
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
    }
}
