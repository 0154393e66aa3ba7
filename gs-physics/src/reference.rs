//! References in `f64`, one particle at a time, that the production code is measured against.

pub mod law;
pub mod net;
pub mod velocity;

use crate::rollout::Rollout;
use crate::step::{Substep, step, step_backward};
use crate::twist::Motion;
use crate::vec3::{add, sub};

/// Position (world units) and orientation `(w, x, y, z)` of one particle, or the cotangents of both.
pub type Pose = ([f64; 3], [f64; 4]);

fn origin(rollout: &Rollout) -> [f64; 3] {
    rollout.origin.as_dvec3().to_array()
}

/// As [`Rollout::advance`] for one particle; quaternions are not normalised.
pub fn advance(rollout: &Rollout, motion: &Motion<f64>, span: [f64; 2], (x, q): Pose) -> Pose {
    let o = origin(rollout);
    let roll = |(x, q), (tau, h)| step(rollout.rule, motion, &Substep::new(tau, h), x, q);
    let (x, q) = rollout.steps(span).into_iter().fold((sub(x, o), q), roll);
    (add(x, o), q)
}

/// As [`Rollout::adjoint`] for cotangents `d` at the end: those of the motion, and of the pose at the start.
pub fn adjoint(rollout: &Rollout, motion: &Motion<f64>, span: [f64; 2], (x, q): Pose, d: Pose) -> (Motion<f64>, Pose) {
    let mut at = (sub(x, origin(rollout)), q);
    let mut tape = Vec::new();
    for (tau, h) in rollout.steps(span) {
        let substep = Substep::new(tau, h);
        tape.push((substep, at));
        at = step(rollout.rule, motion, &substep, at.0, at.1);
    }
    let mut grad = Motion::default();
    let mut d = d;
    for (substep, before) in tape.into_iter().rev() {
        d = step_backward(rollout.rule, motion, &substep, before, d, &mut grad);
    }
    (grad, d)
}
