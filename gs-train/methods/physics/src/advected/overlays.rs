//! What of the learnt physics can be looked at: speed, spin, acceleration, direction and axis of every splat, its stages, and
//! the particles of a forecast.

use super::spans::Span;
use super::{Advected, PhysicsConfig};
use glam::Vec3;
use gs_core::{Camera, Splats, cast};
use gs_deform::Field;
use gs_physics::{Dynamics, Motion};
use gs_train::capabilities::{Inspect, Overlay, ParticleSource, Particles, Quantity, RigidBody, StageView};
use gs_train::kernel::kernel_quantities;
use gs_train::method::{Method, MethodError};
use gs_train::palette::DIRECTIONS;
use gs_train::timestamp::Timestamp;

/// A vector as a colour: grey for none, one channel per axis, the longest of all at the border of the range.
fn colors(vectors: &[Vec3]) -> Vec<[f32; 3]> {
    let largest = vectors.iter().map(|v| v.abs().max_element()).fold(f32::MIN_POSITIVE, f32::max);
    vectors.iter().map(|v| (0.5 + 0.5 * *v / largest).to_array()).collect()
}

/// Rows of [`Particles::twists`].
fn twists(motions: &[Motion<f32>]) -> Vec<[[f32; 3]; 6]> {
    let row = |Motion { twist, rate, jerk }: &Motion<f32>| [twist.v, twist.w, rate.v, rate.w, jerk.v, jerk.w];
    motions.iter().map(row).collect()
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

    /// `speed`, `spin` and `acceleration` of every splat, per unit of normalised time; where paths were refitted, `deviation`, the
    /// standard deviation of a splat's place, not a number for a splat that follows none of them.
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
            let to = self.render_span(t).to;
            let deviations = self.with_future(|future| future.deviations(to));
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

impl<F: Field, D: Dynamics> Inspect for Advected<F, D>
where
    F::Tape: Sync,
{
    fn stages(&self, at: &Timestamp, camera: &Camera) -> Result<Vec<StageView>, MethodError> {
        let canonical = self.canonical.activated();
        let span = self.render_span(f64::from(at.t.normalised));
        let deformed = self.transported(Span { from: span.from, to: span.from });
        let (rest, bent) = (canonical.means.clone(), deformed.means.clone());
        Ok(vec![
            StageView { name: "canonical", splats: canonical, before: None },
            StageView { name: "field", splats: deformed, before: Some(rest) },
            StageView { name: "full", splats: self.splats(at, camera)?, before: Some(bent) },
        ])
    }

    fn warnings(&self) -> Vec<String> {
        let PhysicsConfig { refit, slack, bodies, .. } = self.config;
        let all = [("refit", refit), ("slack", slack > 0.0), ("bodies", bodies > 0)];
        let (without_effect, why) = match self.dynamics.motion_rollout() {
            None => (&all[..], "these dynamics give splats no motion of rigid bodies"),
            Some(rollout) if rollout.rule.is_rigid() => return Vec::new(),
            Some(_) => (&all[1..], "only rigid integrators leave steps out: set law.integrator to \"se3_mid\""),
        };
        let on = without_effect.iter().filter(|(_, on)| *on);
        on.map(|(name, _)| format!("physics.{name} has no effect: {why}")).collect()
    }

    fn quantities(&self, at: &Timestamp) -> Result<Vec<Quantity>, MethodError> {
        let mut all = kernel_quantities(&self.canonical.activated().kernel);
        all.extend(self.physical_quantities(f64::from(at.t.normalised)));
        Ok(all)
    }

    fn overlays(&self, at: &Timestamp) -> Result<Vec<Overlay>, MethodError> {
        let mut all = self.directions(f64::from(at.t.normalised));
        all.extend(self.quantities(at)?.iter().map(Quantity::overlay));
        Ok(all)
    }
}

impl<F: Field, D: Dynamics> ParticleSource for Advected<F, D> {
    fn particles(&self) -> Particles {
        let mut splats = self.canonical.activated();
        let (moved, motions) = self.with_future(|future| future.particles(&self.dynamics));
        splats.set_geometry(moved);
        let lasting = self.dynamics.motions_extrapolate();
        Particles { at: self.first_ahead(), splats, twists: twists(&motions), origin: self.dynamics.origin(), lasting }
    }

    /// A law goes on after `T_def`, and before it where it has settled: there alone it was trained.
    fn twists_at(&self, t: f64) -> Option<Vec<[[f32; 3]; 6]>> {
        let goes_on = self.config.settle > 0.0 || t >= self.first_ahead();
        let carried = self.dynamics.motions_extrapolate() && goes_on;
        (!carried).then(|| twists(&self.moving(t).1))
    }

    fn bodies(&self, times: &[f64]) -> Vec<RigidBody> {
        let times: Vec<f64> = times.iter().map(|t| self.render_span(*t).to).collect();
        self.with_future(|future| future.bodies(&times))
    }
}
