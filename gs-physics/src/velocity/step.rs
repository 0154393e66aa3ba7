//! One midpoint step of a block of particles along the velocity, forward and backward.

use super::VelocityField;
use super::evaluate::{Derivatives, Evaluation};
use super::flow::Flow;

use crate::dynamics::ParticleState;
use crate::so3::{Rotation, product_backward};
use crate::vec3::scale;
use glam::Vec3;
use gs_core::cast;
use gs_core::nn::MlpGrad;
use gs_core::rot::hamilton;

/// Scratch of a step: the evaluations at its start and midpoint.
#[derive(Clone, Debug, Default)]
pub(super) struct Step {
    begin: Evaluation,
    middle: Evaluation,
    midpoints: Vec<Vec3>,
    d_midpoints: Vec<Vec3>,
    times: Vec<f32>,
}

impl Step {
    fn evaluate(&mut self, field: &VelocityField, x: &[Vec3], (t, h): (f64, f64)) {
        let Self { begin, middle, midpoints, times, .. } = self;
        times.clear();
        times.resize(x.len(), cast::to_f32(t));
        begin.forward(&field.net, &field.config, x, times, Derivatives::None);
        let half = cast::to_f32(0.5 * h);
        let midpoint = |(i, x): (usize, &Vec3)| *x + half * Vec3::from_array(begin.flow(i, field.relative(*x)).u);
        midpoints.clear();
        midpoints.extend(x.iter().enumerate().map(midpoint));
        times.fill(cast::to_f32(t + 0.5 * h));
        middle.forward(&field.net, &field.config, midpoints, times, Derivatives::Space);
    }

    /// Advances particles by the step `(time, length)`.
    pub(super) fn forward(
        &mut self,
        field: &VelocityField,
        step: (f64, f64),
        means: &mut [Vec3],
        rotations: &mut [[f32; 4]],
    ) {
        self.evaluate(field, means, step);
        let h = cast::to_f32(step.1);
        for (i, (x, q)) in means.iter_mut().zip(rotations).enumerate() {
            let flow = self.middle.flow(i, field.relative(self.midpoints[i]));
            *x += h * Vec3::from_array(flow.u);
            *q = hamilton(Rotation::new(scale(flow.angular_velocity(), h)).quaternion(), *q);
        }
    }

    /// From cotangents `d` of the state after the step to those of the `state` before it, in place, and to the weights.
    pub(super) fn backward(
        &mut self,
        field: &VelocityField,
        step: (f64, f64),
        state: &ParticleState,
        d: &mut ParticleState,
        grad: &mut MlpGrad,
    ) {
        self.evaluate(field, &state.means, step);
        let Self { begin, middle, midpoints, d_midpoints, .. } = self;
        let h = cast::to_f32(step.1);
        d_midpoints.clear();
        for (i, (x, mu)) in midpoints.iter().zip(&mut d.rotations).enumerate() {
            let r = field.relative(*x);
            let rotation = Rotation::new(scale(middle.flow(i, r).angular_velocity(), h));
            let (before, d_turn) = product_backward(rotation.quaternion(), state.rotations[i], *mu);
            let mut d_flow = Flow { u: (h * d.means[i]).to_array(), ..Flow::zero(0.0) };
            d_flow.add_angular_velocity(scale(rotation.quaternion_backward(d_turn), h));
            d_midpoints.push(Vec3::from_array(middle.set_cotangent(i, r, &d_flow)));
            *mu = before;
        }
        middle.backward(&field.net, &field.config, Some(d_midpoints), grad);
        for (i, (x, d_x)) in state.means.iter().zip(&mut d.means).enumerate() {
            let d_flow = Flow { u: (0.5 * h * d_midpoints[i]).to_array(), ..Flow::zero(0.0) };
            let own = begin.set_cotangent(i, field.relative(*x), &d_flow);
            *d_x += d_midpoints[i] + Vec3::from_array(own);
        }
        begin.backward(&field.net, &field.config, Some(&mut d.means), grad);
    }
}
