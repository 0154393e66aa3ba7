//! One particle at a time in `f64`: what the production roll-out is measured against.

pub mod law;
pub mod net;
pub mod velocity;

use crate::rollout::Rollout;
use crate::step::{Tick, step, step_back};
use crate::twist::Motion;
use crate::vec3::{add, sub};

/// Position (world units) and orientation `(w, x, y, z)`.
pub type Pose = ([f64; 3], [f64; 4]);

fn origin(rollout: &Rollout) -> [f64; 3] {
    rollout.origin.as_dvec3().to_array()
}

/// As [`Rollout::advance`]; quaternions are not renormalised.
pub fn advance(rollout: &Rollout, motion: &Motion<f64>, span: [f64; 2], (x, q): Pose) -> Pose {
    let o = origin(rollout);
    let roll = |(x, q), (tau, h)| step(rollout.rule, motion, &Tick::new(tau, h), x, q);
    let (x, q) = rollout.steps(span).into_iter().fold((sub(x, o), q), roll);
    (add(x, o), q)
}

/// As [`Rollout::adjoint`] for cotangents `d` at the end: those of the motion, and of the pose at the start.
pub fn adjoint(rollout: &Rollout, motion: &Motion<f64>, span: [f64; 2], (x, q): Pose, d: Pose) -> (Motion<f64>, Pose) {
    let mut at = (sub(x, origin(rollout)), q);
    let mut tape = Vec::new();
    for (tau, h) in rollout.steps(span) {
        let tick = Tick::new(tau, h);
        tape.push((tick, at));
        at = step(rollout.rule, motion, &tick, at.0, at.1);
    }
    let mut grad = Motion::default();
    let mut d = d;
    for (tick, before) in tape.into_iter().rev() {
        d = step_back(rollout.rule, motion, &tick, before, d, &mut grad);
    }
    (grad, d)
}
