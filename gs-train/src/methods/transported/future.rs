//! What is known of the time after the last one the field is read at: field and law are read once, and whole steps on
//! the way are kept, so that a later frame costs a step or two.

use super::carry_drawn;
use glam::Vec3;
use gs_core::Splats;
use gs_physics::{Dynamics, Extrapolator, Moves, Start};

/// The scene at `T_def`, and how it goes on.
pub(super) struct Future {
    begin: Splats,
    from: f64,
    /// The middle of what moves then.
    middle: Vec3,
    /// The particles without their own rotations, where twists rule all that follows.
    particles: Option<Extrapolator>,
}

impl Future {
    /// The scene that begins as `begin` at time `from`.
    pub fn new<D: Dynamics>(begin: Splats, from: f64, middle: Vec3, dynamics: &D) -> Self {
        let start = Start { x: &begin.means, t: from, middle };
        let particles = dynamics.carried_by().and_then(|rollout| {
            let (motions, still) = (dynamics.motions(start), vec![[1.0, 0.0, 0.0, 0.0]; begin.len()]);
            Extrapolator::new(rollout, from, motions, begin.means.clone(), still).ok()
        });
        Self { begin, from, middle, particles }
    }

    /// The splats at a time after the begin.
    pub fn at<D: Dynamics>(&mut self, t: f64, dynamics: &D) -> Splats {
        let mut moves = Moves::default();
        match &mut self.particles {
            Some(particles) => {
                let (means, turns) = particles.at(t);
                (moves.means, moves.turns) = (means.to_vec(), turns.to_vec());
            }
            None => {
                let start = Start { x: &self.begin.means, t: self.from, middle: self.middle };
                dynamics.transport(start, t, &mut D::Tape::default(), &mut moves);
            }
        }
        let mut splats = self.begin.clone();
        carry_drawn(&mut splats, &mut moves);
        splats
    }
}
