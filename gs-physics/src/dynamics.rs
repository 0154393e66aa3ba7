//! The interface between a law of motion and the trainer.

use crate::rollout::Rollout;
use crate::twist::Motion;
use glam::Vec3;
use gs_core::Params;

/// Particles after [`Dynamics::integrate`], or the cotangents of that; one row per particle in both columns.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct ParticleState {
    /// Positions, world units, one per particle.
    pub means: Vec<Vec3>,
    /// World-frame rotations since the start, `(w, x, y, z)`, to be multiplied from the left.
    pub rotations: Vec<[f32; 4]>,
}

impl ParticleState {
    /// Overwrites all rows, reusing memory.
    pub(crate) fn set(&mut self, means: &[Vec3], rotations: &[[f32; 4]]) {
        self.means.clear();
        self.means.extend_from_slice(means);
        self.rotations.clear();
        self.rotations.extend_from_slice(rotations);
    }
}

/// Particles at the time from which they are integrated.
#[derive(Clone, Copy, Debug)]
pub struct Start<'a> {
    /// Positions, world units, one per particle.
    pub x: &'a [Vec3],
    /// Their time, in the unit of time of all calls.
    pub t: f64,
    /// Centroid of the moving particles among them, world units; [`Dynamics::origin`] where it is unknown.
    pub middle: Vec3,
}

/// A learnt model that moves particles through time: a law of twists, a velocity field.
///
/// Positions that go in are constants (no gradient reaches them), as both TRACE and NVFi train it.
pub trait Dynamics: Params + Send + Sync {
    /// Activations of one [`Dynamics::integrate`] for its backward pass; may be reused.
    type Tape: Default + Send + Sync;

    /// Integrates particles to time `to`, in either direction, in sub-steps. `to = start.t` gives `start.x` and identity
    /// rotations, bit for bit.
    fn integrate(&self, start: Start<'_>, to: f64, tape: &mut Self::Tape, out: &mut ParticleState);

    /// Backward of [`Dynamics::integrate`] from the same start: adds to the gradients of the parameters.
    fn integrate_backward(&mut self, start: Start<'_>, tape: &mut Self::Tape, d: &ParticleState);

    /// Loss terms that need no image: adds their gradients, gives `(name, value)` with weights applied.
    fn regularise(&mut self, _seed: u64, _step: u32) -> Vec<(&'static str, f32)> {
        Vec::new()
    }

    /// The motion of each particle from its start on, about [`Dynamics::origin`]; for a velocity field the local twist, and the
    /// acceleration of the particle there. How the rotation vector of a velocity field changes is not evaluated: its rate is 0.
    fn motions(&self, start: Start<'_>) -> Vec<Motion<f32>>;

    /// Whether [`Dynamics::motions`] read at one time hold for all later times (a law), or the network must be evaluated
    /// again at every step (a velocity field).
    fn motions_extrapolate(&self) -> bool;

    /// The roll-out that integrates [`Dynamics::motions`]; none where motion has a closed form or the network is evaluated
    /// at every step.
    fn motion_rollout(&self) -> Option<Rollout> {
        None
    }

    /// The origin that twists refer to, world units.
    fn origin(&self) -> Vec3;
}
