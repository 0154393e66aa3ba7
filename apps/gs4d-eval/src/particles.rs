//! Splats as rigid particles with the motions of [`gs_physics`].

use glam::Vec3;
use gs_core::{Splats, cast};
use gs_physics::{Motion, Twist};
use gs_train::model::Model;

/// The particles of a model at one time and their motions from there.
#[derive(Clone, Debug, PartialEq)]
pub struct Particles {
    /// Normalised time of the particles.
    pub at: f64,
    /// The splats at that time.
    pub splats: Splats,
    /// Motion of each splat from then on, per unit of normalised time.
    pub motions: Vec<Motion<f32>>,
    /// The origin that twists refer to, world units.
    pub origin: Vec3,
    /// Whether each motion is that of its particle from then on, and not that of a flow where the particle is.
    pub lasting: bool,
}

impl Particles {
    /// The particles of a model; `None` if its method does not learn twists.
    pub fn of(model: &Model) -> Option<Self> {
        let found = model.capabilities().particles?.particles();
        let motions = found.twists.iter().map(motion).collect();
        Some(Self { at: found.at, splats: found.splats, motions, origin: found.origin, lasting: found.lasting })
    }

    /// The motions that rule the splats of the same model at another normalised time: its own there, or these as they go on.
    pub fn motions_at(&self, model: &Model, t: f64) -> Vec<Motion<f32>> {
        let own = model.capabilities().particles.and_then(|source| source.twists_at(t));
        let later = || self.motions.iter().map(|m| m.from(cast::to_f32(t - self.at))).collect();
        own.map_or_else(later, |twists| twists.iter().map(motion).collect())
    }
}

fn motion([v, w, dv, dw, ddv, ddw]: &[[f32; 3]; 6]) -> Motion<f32> {
    let twist = |v: &[f32; 3], w: &[f32; 3]| Twist { v: *v, w: *w };
    Motion { twist: twist(v, w), rate: twist(dv, dw), jerk: twist(ddv, ddw) }
}
