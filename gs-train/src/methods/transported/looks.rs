//! What of the learnt physics can be looked at: speed, spin, acceleration, direction and axis of every splat.

use super::Transported;
use crate::methods::{Overlay, Quantity};
use glam::Vec3;
use gs_core::Splats;
use gs_deform::Field;
use gs_physics::{Dynamics, Motion, Twist};

/// A vector as a colour: grey for none, one channel per axis, the longest of all at the border of the range.
fn colors(vectors: &[Vec3]) -> Vec<[f32; 3]> {
    let largest = vectors.iter().map(|v| v.abs().max_element()).fold(f32::MIN_POSITIVE, f32::max);
    vectors.iter().map(|v| (0.5 + 0.5 * *v / largest).to_array()).collect()
}

/// A motion read a while later.
fn after(m: &Motion<f32>, tau: f32) -> Motion<f32> {
    let later = |u: [f32; 3], a: [f32; 3], j: [f32; 3]| {
        let [u, a, j] = [u, a, j].map(Vec3::from_array);
        (u + tau * (a + 0.5 * tau * j)).to_array()
    };
    let turned = |a: [f32; 3], j: [f32; 3]| (Vec3::from_array(a) + tau * Vec3::from_array(j)).to_array();
    let Motion { twist, rate, jerk } = *m;
    let twist = Twist { v: later(twist.v, rate.v, jerk.v), w: later(twist.w, rate.w, jerk.w) };
    Motion { twist, rate: Twist { v: turned(rate.v, jerk.v), w: turned(rate.w, jerk.w) }, jerk }
}

impl<F: Field, D: Dynamics> Transported<F, D> {
    /// The motions that rule splats drawn at a time. A law is read once, at `T_def`, for all later times.
    pub(super) fn motions_at(&self, splats: &Splats, t: f64) -> Vec<Motion<f32>> {
        let first = self.first_ahead();
        if t <= first || !self.dynamics.rules_ahead() {
            return self.dynamics.motions(&splats.means, t);
        }
        let begin = self.deformed(&self.canonical.activated(), first);
        let tau = (t - first) as f32;
        self.dynamics.motions(&begin.means, first).iter().map(|m| after(m, tau)).collect()
    }

    /// `speed`, `spin` and `acceleration` of every splat, per unit of normalised time.
    pub(super) fn physical_quantities(&self, t: f64) -> Vec<Quantity> {
        if !self.canonical.dynamic() {
            return Vec::new();
        }
        let (splats, motions, velocities) = self.velocities(t);
        let o = self.dynamics.origin();
        let acceleration = |((m, x), v): ((&Motion<f32>, &Vec3), &Vec3)| {
            let [w, dw] = [m.twist.w, m.rate.w].map(Vec3::from_array);
            (Vec3::from_array(m.rate.v) + dw.cross(*x - o) + w.cross(*v)).length()
        };
        let accelerations = motions.iter().zip(&splats.means).zip(&velocities).map(acceleration).collect();
        let spin = motions.iter().map(|m| Vec3::from_array(m.twist.w).length()).collect();
        let speed = velocities.iter().map(|v| v.length()).collect();
        let quantity = |name, unit, values| Quantity { name, unit, range: None, values };
        vec![
            quantity("speed", "units/span", speed),
            quantity("spin", "rad/span", spin),
            quantity("acceleration", "units/span²", accelerations),
        ]
    }

    /// `velocity` and `axis`: vectors as colours, grey for none.
    pub(super) fn directions(&self, t: f64) -> Vec<Overlay> {
        if !self.canonical.dynamic() {
            return Vec::new();
        }
        let (_, motions, velocities) = self.velocities(t);
        let axes: Vec<Vec3> = motions.iter().map(|m| Vec3::from_array(m.twist.w)).collect();
        [("velocity", &velocities), ("axis", &axes)].map(|(name, v)| Overlay { name, colors: colors(v) }).into()
    }
}
