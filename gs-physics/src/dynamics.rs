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

    /// Copies rows, reusing memory.
    pub(crate) fn set(&mut self, means: &[Vec3], turns: &[[f32; 4]]) {
        self.means.clear();
        self.means.extend_from_slice(means);
        self.turns.clear();
        self.turns.extend_from_slice(turns);
    }
}

/// Particles at the moment from which they are carried.
#[derive(Clone, Copy, Debug)]
pub struct Start<'a> {
    /// Positions, world units.
    pub x: &'a [Vec3],
    /// The moment, in the unit of time of all calls.
    pub t: f64,
    /// The middle of what moves among them, world units; [`Dynamics::origin`] where nothing is known of it.
    pub middle: Vec3,
}

/// Something learnt that moves particles through time: a law of twists, a velocity field.
///
/// Positions that go in are constants (no gradient reaches them), as both TRACE and NVFi train it.
pub trait Dynamics: Params + Send + Sync {
    /// Scratch of one transport.
    type Tape: Default + Send + Sync;

    /// Carries particles to time `to`, in either direction, in sub-steps. `to = start.t` gives `start.x` and identities, bit
    /// for bit.
    fn transport(&self, start: Start<'_>, to: f64, tape: &mut Self::Tape, out: &mut Moves);

    /// The way back of [`Dynamics::transport`] from the same start: adds to the gradients of the parameters.
    fn transport_backward(&mut self, start: Start<'_>, tape: &mut Self::Tape, d: &Moves);

    /// Regularisers that need no image: adds their gradients, gives their values with weights applied.
    fn regularise(&mut self, _seed: u64, _step: u32) -> Vec<(&'static str, f32)> {
        Vec::new()
    }

    /// The motion of particles from their start on, about [`Dynamics::origin`]; for a velocity field its local twist.
    fn motions(&self, start: Start<'_>) -> Vec<Motion<f32>>;

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
