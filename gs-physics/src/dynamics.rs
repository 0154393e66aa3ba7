//! The seam between a law of motion and whoever trains it.

use crate::rollout::Rollout;
use crate::twist::Motion;
use glam::Vec3;
use gs_core::Params;

/// Where particles went, or the cotangents of that.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Moves {
    /// Positions.
    pub means: Vec<Vec3>,
    /// World-frame rotations since the start, `(w, x, y, z)`, to be multiplied from the left.
    pub turns: Vec<[f32; 4]>,
}

impl Moves {
    /// `n` rows of zeros.
    pub fn reset(&mut self, n: usize) {
        self.means.clear();
        self.means.resize(n, Vec3::ZERO);
        self.turns.clear();
        self.turns.resize(n, [0.0; 4]);
    }
}

/// Something learnt that moves particles through time: a law of twists, a velocity field.
///
/// Positions that go in are constants (no gradient reaches them), as both TRACE and NVFi train it.
pub trait Dynamics: Params + Send + Sync {
    /// Scratch of one transport.
    type Tape: Default + Send + Sync;

    /// Carries particles from `x` at time `from` to time `to`, in either direction, in sub-steps. `from = to` gives `x` and
    /// identities, bit for bit.
    fn transport(&self, x: &[Vec3], from: f64, to: f64, tape: &mut Self::Tape, out: &mut Moves);

    /// The way back of [`Dynamics::transport`] for the same `x`: adds to the gradients of the parameters.
    fn transport_backward(&mut self, x: &[Vec3], tape: &mut Self::Tape, d: &Moves);

    /// Regularisers that need no image: adds their gradients, gives their values with weights applied.
    fn regularise(&mut self, _seed: u64, _step: u32) -> Vec<(&'static str, f32)> {
        Vec::new()
    }

    /// The motion of particles at `x` from time `t` on, about [`Dynamics::origin`]; for a velocity field its local twist.
    fn motions(&self, x: &[Vec3], t: f64) -> Vec<Motion<f32>>;

    /// Whether [`Dynamics::motions`] of one moment rule all later times (a law), or the field must be read again at every
    /// step (a velocity field).
    fn rules_ahead(&self) -> bool;

    /// How [`Dynamics::motions`] of one moment are carried on, where twists are; none where motion has a closed form or is
    /// read again at every step.
    fn carried_by(&self) -> Option<Rollout> {
        None
    }

    /// The origin that twists refer to, world units.
    fn origin(&self) -> Vec3;
}
