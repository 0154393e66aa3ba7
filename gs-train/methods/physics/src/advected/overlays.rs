//! What of the learnt physics can be looked at: speed, spin, acceleration, direction and axis of every splat.

use super::Advected;
use glam::Vec3;
use gs_core::{Splats, cast};
use gs_deform::Field;
use gs_physics::{Dynamics, Motion};
use gs_train::capabilities::{Overlay, Quantity};
use gs_train::palette::DIRECTIONS;

/// A vector as a colour: grey for none, one channel per axis, the longest of all at the border of the range.
fn colors(vectors: &[Vec3]) -> Vec<[f32; 3]> {
    let largest = vectors.iter().map(|v| v.abs().max_element()).fold(f32::MIN_POSITIVE, f32::max);
    vectors.iter().map(|v| (0.5 + 0.5 * *v / largest).to_array()).collect()
}

impl<F: Field, D: Dynamics> Advected<F, D> {
    /// Where the splats rendered at a time are, and the motions that rule them there.
    fn moving(&self, t: f64) -> (Vec<Vec3>, Vec<Motion<f32>>) {
        let splats = self.transported(self.render_span(t));
        let motions = self.motions_at(&splats, t);
        (splats.means, motions)
    }

    /// The motions that rule splats rendered at a time. A law is read once, at `T_def`, for all later times.
    fn motions_at(&self, splats: &Splats, t: f64) -> Vec<Motion<f32>> {
        let first = self.first_ahead();
        let canonical = self.canonical.activated();
        if t <= first || !self.dynamics.motions_extrapolate() {
            return self.dynamics.motions(self.start(&canonical, &splats.means, t));
        }
        let tau = cast::to_f32(t - first);
        self.with_future(|future| future.particles(&self.dynamics)).1.iter().map(|m| m.from(tau)).collect()
    }

    /// `speed`, `spin` and `acceleration` of every splat, per unit of normalised time; of splats that follow a refitted path
    /// `deviation`, the standard deviation of their place.
    pub(super) fn physical_quantities(&self, t: f64) -> Vec<Quantity> {
        if !self.canonical.at.dynamic {
            return Vec::new();
        }
        let (places, motions) = self.moving(t);
        let o = self.dynamics.origin();
        let of = |f: fn(&Motion<f32>, [f32; 3]) -> [f32; 3]| {
            let length = |(m, x): (&Motion<f32>, &Vec3)| Vec3::from_array(f(m, (*x - o).to_array())).length();
            motions.iter().zip(&places).map(length).collect::<Vec<f32>>()
        };
        let (speed, acceleration) = (of(|m, x| m.twist.velocity(x)), of(Motion::acceleration));
        let spin = motions.iter().map(|m| Vec3::from_array(m.twist.w).length()).collect();
        let quantity = |name, unit, values| Quantity { name, unit, range: None, values };
        let mut all = vec![
            quantity("speed", "units/span", speed),
            quantity("spin", "rad/span", spin),
            quantity("acceleration", "units/span²", acceleration),
        ];
        if t > self.first_ahead() {
            let deviations = self.with_future(|future| future.deviations(t));
            all.extend(deviations.map(|values| quantity("deviation", "units", values)));
        }
        all
    }

    /// `velocity` and `axis`: vectors as colours, grey for none.
    pub(super) fn directions(&self, t: f64) -> Vec<Overlay> {
        if !self.canonical.at.dynamic {
            return Vec::new();
        }
        let (places, motions) = self.moving(t);
        let o = self.dynamics.origin();
        let along = |(m, x): (&Motion<f32>, &Vec3)| Vec3::from_array(m.twist.velocity((*x - o).to_array()));
        let velocities: Vec<Vec3> = motions.iter().zip(&places).map(along).collect();
        let axes: Vec<Vec3> = motions.iter().map(|m| Vec3::from_array(m.twist.w)).collect();
        [("velocity", &velocities), ("axis", &axes)]
            .map(|(name, v)| Overlay { name, colors: colors(v), meaning: DIRECTIONS })
            .into()
    }
}
