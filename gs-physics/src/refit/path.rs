//! Paths of a rigid body, simple ones first, and their parameters.
//!
//! A body whose centroid is at `c` at `τ = 0` moves by one of
//!
//! ```text
//! Rest     ẋ = 0                                    Screw    ẋ = v + w × (x − c)                      a twist that lasts
//! Coast    ẋ = v                                    Twist    ẋ = v + a τ + (w + w' τ) × (x − c)       one that changes
//! Fall     ẋ = v + a τ                              Roll     turning by w about c + d + v τ
//!                                                   Throw    turning by w about c + d + v τ + ½ a τ²
//! ```
//! The last two are of a body in flight, that turns about its centre of mass, `d` from the centroid of what is seen of it. They
//! are twists as well: `v̄ = v − w × d`, `v̄' = a − w × v`, `v̄'' = −w × a`.

use super::Pose;
use crate::integrator::Integrator;
use crate::step::{Affine, step_map};
use crate::twist::{Motion, Twist};
use glam::{DQuat, DVec3};

/// Farthest that a centre of mass may be from the centroid of what is seen of a body, in radii. Turning about a point far away
/// bends a path as gravity does.
const FARTHEST: f64 = 3.0;

/// How a rigid body moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Path {
    /// At rest.
    Rest,
    /// In a straight line, evenly, without turning.
    Coast,
    /// With constant acceleration, without turning.
    Fall,
    /// By a constant twist: a turn about an axis at rest, a screw.
    Screw,
    /// Centre of mass in a straight line, constant rotation about it.
    Roll,
    /// Centre of mass with constant acceleration, constant rotation about it.
    Throw,
    /// By a twist that changes evenly.
    Twist,
}

impl Path {
    /// All paths, those of fewer parameters first.
    pub(super) const ALL: [Self; 7] =
        [Self::Rest, Self::Coast, Self::Fall, Self::Screw, Self::Roll, Self::Throw, Self::Twist];

    /// Its name: `rest`, `coast`, `fall`, `screw`, `roll`, `throw` or `twist`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rest => "rest",
            Self::Coast => "coast",
            Self::Fall => "fall",
            Self::Screw => "screw",
            Self::Roll => "roll",
            Self::Throw => "throw",
            Self::Twist => "twist",
        }
    }

    /// Which of the vectors `v, w, a, w', d` are parameters.
    fn has(self) -> [bool; 5] {
        match self {
            Self::Rest => [false; 5],
            Self::Coast => [true, false, false, false, false],
            Self::Fall => [true, false, true, false, false],
            Self::Screw => [true, true, false, false, false],
            Self::Roll => [true, true, false, false, true],
            Self::Throw => [true, true, true, false, true],
            Self::Twist => [true, true, true, true, false],
        }
    }

    /// Number of parameters.
    pub(super) fn count(self) -> usize {
        3 * self.has().iter().filter(|has| **has).count()
    }

    /// From the centroid to the centre of mass, in radii; scaled parameters.
    pub(super) fn offset(self, p: &[f64]) -> DVec3 {
        self.vectors(p)[4]
    }

    /// Whether the centre of mass lies about where the body is; scaled parameters.
    pub(super) fn plausible(self, p: &[f64]) -> bool {
        self.offset(p).length() <= FARTHEST
    }

    /// The parameters of a body that goes on with velocity `v` of its centroid and angular velocity `w`.
    pub(super) fn begin(self, v: DVec3, w: DVec3) -> Vec<f64> {
        let all = [v, w, DVec3::ZERO, DVec3::ZERO, DVec3::ZERO];
        all.iter().zip(self.has()).filter(|(_, has)| *has).flat_map(|(x, _)| x.to_array()).collect()
    }

    /// Parameters in world units, of lengths over `radius` and times over `unit`.
    pub(super) fn unscaled(self, p: &[f64], radius: f64, unit: f64) -> Vec<f64> {
        let scales = [radius / unit, 1.0 / unit, radius / (unit * unit), 1.0 / (unit * unit), radius];
        let own = scales.iter().zip(self.has()).filter(|(_, has)| *has);
        p.chunks_exact(3).zip(own).flat_map(|(p, (scale, _))| [0, 1, 2].map(|c| p[c] * scale)).collect()
    }

    /// `v, w, a, w', d` of parameters.
    fn vectors(self, p: &[f64]) -> [DVec3; 5] {
        let mut rows = p.chunks_exact(3).map(DVec3::from_slice);
        self.has().map(|has| if has { rows.next().unwrap_or_default() } else { DVec3::ZERO })
    }

    /// The motion about the centroid at `τ = 0`.
    pub(super) fn motion(self, p: &[f64]) -> Motion<f64> {
        let [v, w, a, e, d] = self.vectors(p);
        let turns = matches!(self, Self::Roll | Self::Throw);
        let (rate, jerk) = if turns { (a - w.cross(v), -w.cross(a)) } else { (a, DVec3::ZERO) };
        let twist = |v: DVec3, w: DVec3| Twist { v: v.to_array(), w: w.to_array() };
        Motion { twist: twist(v - w.cross(d), w), rate: twist(rate, e), jerk: twist(jerk, DVec3::ZERO) }
    }

    /// Poses at times `taus`, exact but for [`Path::Twist`], which goes from 0 to the first and from each to the next, forth or back, by
    /// steps of at most `step`.
    pub(super) fn poses(self, p: &[f64], taus: &[f64], step: f64) -> Vec<Pose> {
        if matches!(self, Self::Screw | Self::Twist) {
            return along(&self.motion(p), taus, if self == Self::Screw { f64::INFINITY } else { step });
        }
        let [v, w, a, _, d] = self.vectors(p);
        let at = |t: &f64| {
            let turn = DQuat::from_scaled_axis(w * *t);
            Pose { centre: d - turn * d + (v + a * (0.5 * t)) * *t, turn }
        };
        taus.iter().map(at).collect()
    }
}

fn along(motion: &Motion<f64>, taus: &[f64], step: f64) -> Vec<Pose> {
    let (mut map, mut turn, mut tau) = (Affine::IDENTITY, DQuat::IDENTITY, 0.0);
    let mut at = |to: f64| {
        let steps = ((to - tau).abs() / step - 1e-6).ceil().max(1.0);
        let h = (to - tau) / steps;
        for _ in 0..gs_core::cast::to_usize(steps) {
            let (next, [w, x, y, z]) = step_map(motion, tau, h, Integrator::Se3Magnus4);
            (map, turn, tau) = (map.then(&next), DQuat::from_xyzw(x, y, z, w) * turn, tau + h);
        }
        tau = to;
        Pose { centre: DVec3::from_array(map.b), turn }
    };
    taus.iter().map(|to| at(*to)).collect()
}

/// The rotation vector of a rotation.
pub(super) fn log(q: DQuat) -> DVec3 {
    let q = if q.w < 0.0 { -q } else { q };
    q.normalize().to_scaled_axis()
}
