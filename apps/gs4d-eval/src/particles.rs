//! Splats as rigid particles, as the physics crate knows their motion.

use glam::Vec3;
use gs_core::Splats;
use gs_physics::{Motion, Twist};
use gs_train::model::Model;

/// The particles of a model at one time and their motions from there.
#[derive(Clone, Debug, PartialEq)]
pub struct Particles {
    /// The time, normalised.
    pub at: f64,
    /// The splats at that time.
    pub splats: Splats,
    /// Per splat its motion from then on, per unit of normalised time.
    pub motions: Vec<Motion<f32>>,
    /// The origin that twists refer to, world units.
    pub origin: Vec3,
}

impl Particles {
    /// Those of a model whose method has learnt their motion.
    pub fn of(model: &Model) -> Option<Self> {
        let found = model.capabilities().particles?.particles();
        let motion = |[v, w, dv, dw, ddv, ddw]: &[[f32; 3]; 6]| Motion {
            twist: Twist { v: *v, w: *w },
            rate: Twist { v: *dv, w: *dw },
            jerk: Twist { v: *ddv, w: *ddw },
        };
        let motions = found.twists.iter().map(motion).collect();
        Some(Self { at: found.at, splats: found.splats, motions, origin: found.origin })
    }
}
