//! Splats as rigid particles with the motions of [`gs_physics`].

use glam::Vec3;
use gs_core::Splats;
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
        let motion = |[v, w, dv, dw, ddv, ddw]: &[[f32; 3]; 6]| Motion {
            twist: Twist { v: *v, w: *w },
            rate: Twist { v: *dv, w: *dw },
            jerk: Twist { v: *ddv, w: *ddw },
        };
        let motions = found.twists.iter().map(motion).collect();
        Some(Self { at: found.at, splats: found.splats, motions, origin: found.origin, lasting: found.lasting })
    }
}
