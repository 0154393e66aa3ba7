//! What is known of the time after the last one the field is read at: the law is read once, and the splats at whole steps
//! are kept, so that a later frame costs one step.

use super::carry;
use gs_core::Splats;
use gs_physics::{Dynamics, Moves};

/// The scene at `T_def`, and how it goes on.
pub(super) struct Future {
    begin: Splats,
    from: f64,
}

impl Future {
    pub fn new<D: Dynamics>(begin: Splats, from: f64, _dynamics: &D) -> Self {
        Self { begin, from }
    }

    /// The splats at a time `t ≥ from`.
    pub fn at<D: Dynamics>(&self, t: f64, dynamics: &D) -> Splats {
        let (mut tape, mut moves) = (D::Tape::default(), Moves::default());
        dynamics.transport(&self.begin.means, self.from, t, &mut tape, &mut moves);
        let mut splats = self.begin.clone();
        carry(&mut splats, &moves);
        splats
    }
}
