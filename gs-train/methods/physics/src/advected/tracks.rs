//! Where splats were at the frames that were seen, which paths of rigid bodies are refitted to.

use super::Advected;
use super::spans::{ROUNDING, Times};
use gs_core::{Splats, cast};
use gs_deform::Field;
use gs_physics::Dynamics;
use gs_physics::refit::Tracks;

/// Most frames before `T_def` that paths of bodies are refitted to.
const TRACKED: usize = 40;

impl<F: Field, D: Dynamics> Advected<F, D> {
    /// Where splats are at seen frames, and how they move there.
    pub(super) fn tracks(&self, canonical: &Splats) -> Tracks {
        if self.config.settle > 0.0 { self.carried_tracks(canonical) } else { self.field_tracks(canonical) }
    }

    /// Offsets from `T_def` of the frames that lie within `before` it and `after` it, latest first.
    fn frames(&self, before: f64, after: f64) -> Vec<f64> {
        let frame = self.frame();
        let [before, after] = [before, after].map(|span| cast::to_usize(span / frame + ROUNDING).min(TRACKED));
        (0..=before + after).map(|k| (after as f64 - k as f64) * frame).collect()
    }

    /// By the field and what the dynamics say at each frame, up to `T_def`.
    fn field_tracks(&self, canonical: &Splats) -> Tracks {
        let Times { last_field, start, .. } = self.times;
        let taus = self.frames(last_field - start, 0.0);
        let at = |tau: &f64| {
            let means = self.deformed(canonical.geometry(), last_field + tau).means;
            let motions = self.dynamics.motions(self.start(canonical, &means, last_field + tau));
            (means, motions)
        };
        let (means, motions) = taus.iter().map(at).unzip();
        Tracks { taus, means, motions, origin: self.dynamics.origin(), carried: false }
    }

    /// By what the dynamics say at `T_def` alone, at the frames that they have settled on.
    fn carried_tracks(&self, canonical: &Splats) -> Tracks {
        let Times { last_field, last, start, .. } = self.times;
        let settled = f64::from(self.config.settle_frames) * self.frame();
        let before = if settled > 0.0 { settled.min(last_field - start) } else { last_field - start };
        let taus = self.frames(before, last - last_field);
        let now = self.deformed(canonical.geometry(), last_field).means;
        let begin = self.start(canonical, &now, last_field);
        let motions = self.dynamics.motions(begin);
        let at = |tau: &f64| {
            let (mut tape, mut moves) = Default::default();
            self.dynamics.integrate(begin, last_field + tau, &mut tape, &mut moves);
            (moves.means, motions.iter().map(|m| m.from(cast::to_f32(*tau))).collect())
        };
        let (means, motions) = taus.iter().map(at).unzip();
        Tracks { taus, means, motions, origin: self.dynamics.origin(), carried: true }
    }
}
