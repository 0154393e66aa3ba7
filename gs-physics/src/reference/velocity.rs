//! A [`VelocityField`] in `f64`, one particle or point at a time, with its physics-informed loss.

use super::Pose;
use super::net::{Jet, NetRef, encode};
use crate::rollout::Rollout;
use crate::so3::{Rotation, product_backward};
use crate::vec3::{V3, add, add_scaled, scale, sub};
use crate::velocity::flow::{BASIS, Coefficients, Flow, acceleration, acceleration_backward};
use crate::velocity::{VelocityConfig, VelocityField};
use gs_core::real::dot3;
use gs_core::rot::hamilton;

/// Reference of a [`VelocityField`]: the same networks in `f64`.
#[derive(Clone, Debug)]
pub struct VelocityRef {
    /// The network of the velocity, whose weights may be changed.
    pub net: NetRef,
    /// The network of the acceleration.
    pub acceleration: NetRef,
    config: VelocityConfig,
    rollout: Rollout,
}

/// The network evaluated at one point.
struct Evaluated {
    input: Jet,
    /// First derivatives of the encoded position, entry by entry.
    slopes: Vec<f64>,
    /// Second derivatives of the same entries.
    curvatures: Vec<f64>,
    c: Coefficients<f64>,
    r: V3<f64>,
}

impl VelocityRef {
    /// The reference of `field`, with a copy of its weights.
    pub fn new(field: &VelocityField) -> Self {
        Self {
            net: NetRef::new(&field.net),
            acceleration: NetRef::new(&field.acceleration),
            config: field.config().clone(),
            rollout: field.rollout(),
        }
    }

    /// Evaluates the network with derivatives by the first `axes` of x, y, z, t.
    fn evaluate(&self, x: V3<f64>, t: f64, axes: usize) -> Evaluated {
        let [position, slopes, curvatures] = encode(&x, self.config.coordinate_scale.into(), self.config.bands);
        let [time, time_slopes, _] = encode(&[t], 1.0, self.config.bands);
        let mut input = vec![[position, time].concat()];
        for axis in 0..axes {
            let own = |(e, s): (usize, &f64)| if e % 3 == axis { *s } else { 0.0 };
            let row = match axis {
                3 => [vec![0.0; slopes.len()], time_slopes.clone()].concat(),
                _ => [slopes.iter().enumerate().map(own).collect(), vec![0.0; time_slopes.len()]].concat(),
            };
            input.push(row);
        }
        let mut c = [[0.0; BASIS]; 5];
        for (c, y) in c.iter_mut().zip(self.net.forward(&input)) {
            c.copy_from_slice(&y);
        }
        Evaluated { input, slopes, curvatures, c, r: sub(x, self.rollout.origin.as_dvec3().to_array()) }
    }

    /// From the cotangent of the flow to those of the weights (added) and of the position.
    fn backward(&self, read: &Evaluated, d: &Flow<f64>, grad: &mut [Vec<f64>]) -> V3<f64> {
        let (d_c, mut d_x) = d.backward(&read.c, read.r);
        let rows: Jet = d_c.iter().take(read.input.len()).map(|d| d.to_vec()).collect();
        let d_input = self.net.backward(&read.input, &rows, grad);
        for (e, slope) in read.slopes.iter().enumerate() {
            let axis = e % 3;
            d_x[axis] += d_input[0][e] * slope;
            if let Some(d) = d_input.get(1 + axis) {
                d_x[axis] += d[e] * read.curvatures[e];
            }
        }
        d_x
    }

    /// Velocity (world units per unit of time) and half its curl (radians per unit of time) at a position and time.
    pub fn flow(&self, x: [f64; 3], t: f64) -> ([f64; 3], [f64; 3]) {
        let read = self.evaluate(x, t, 3);
        let flow = Flow::new(&read.c, read.r);
        (flow.u, flow.angular_velocity())
    }

    fn midpoint(&self, x: V3<f64>, (t, h): (f64, f64)) -> V3<f64> {
        let begin = self.evaluate(x, t, 0);
        add_scaled(x, 0.5 * h, Flow::new(&begin.c, begin.r).u)
    }

    fn step(&self, (x, q): Pose, (t, h): (f64, f64)) -> Pose {
        let (u, w) = self.flow(self.midpoint(x, (t, h)), t + 0.5 * h);
        (add_scaled(x, h, u), hamilton(Rotation::new(scale(w, h)).quaternion(), q))
    }

    /// As [`transport`](crate::Dynamics::integrate) over `[from, to]`.
    pub fn integrate(&self, x: [f64; 3], span: [f64; 2]) -> Pose {
        let start = (x, [1.0, 0.0, 0.0, 0.0]);
        self.rollout.steps(span).into_iter().fold(start, |pose, step| self.step(pose, step))
    }

    /// Adds the gradient of the velocity's weights for cotangents `d` of [`VelocityRef::integrate`].
    pub fn gradient(&self, x: [f64; 3], span: [f64; 2], d: Pose, grad: &mut [Vec<f64>]) {
        let mut tape = vec![(x, [1.0, 0.0, 0.0, 0.0])];
        let steps = self.rollout.steps(span);
        for step in &steps {
            tape.push(self.step(tape[tape.len() - 1], *step));
        }
        let (mut lambda, mut mu) = d;
        for (&(t, h), (x, q)) in steps.iter().zip(tape).rev() {
            let middle = self.evaluate(self.midpoint(x, (t, h)), t + 0.5 * h, 3);
            let rotation = Rotation::new(scale(Flow::new(&middle.c, middle.r).angular_velocity(), h));
            let (before, d_turn) = product_backward(rotation.quaternion(), q, mu);
            let mut d_flow = Flow { u: scale(lambda, h), ..Flow::zero(0.0) };
            d_flow.add_angular_velocity(scale(rotation.quaternion_backward(d_turn), h));
            let d_middle = self.backward(&middle, &d_flow, grad);
            let d_begin = Flow { u: scale(d_middle, 0.5 * h), ..Flow::zero(0.0) };
            lambda = add(add(lambda, d_middle), self.backward(&self.evaluate(x, t, 0), &d_begin, grad));
            mu = before;
        }
    }

    /// Both terms of the physics-informed loss, divergence and transport, at `(position, time)` points, weights applied;
    /// adds the gradients of both networks.
    pub fn losses(&self, points: &[([f64; 3], f64)], grads: [&mut [Vec<f64>]; 2]) -> [f64; 2] {
        let [grad, grad_a] = grads;
        let weights = [self.config.divergence, self.config.transport].map(|w| f64::from(w) / points.len() as f64);
        let mut sums = [0.0; 2];
        for &(x, t) in points {
            let read = self.evaluate(x, t, 4);
            let flow = Flow::new(&read.c, read.r);
            let input = vec![read.input[0].clone()];
            let residual = flow.residual(acceleration(&self.acceleration.forward(&input)[0], read.r));
            sums[0] += weights[0] * flow.divergence() * flow.divergence();
            sums[1] += weights[1] * dot3(residual, residual);
            let d_residual = scale(residual, 2.0 * weights[1]);
            self.backward(&read, &flow.losses_backward(2.0 * weights[0] * flow.divergence(), d_residual), grad);
            let mut d_alpha = vec![0.0; BASIS];
            acceleration_backward(read.r, scale(d_residual, -1.0), &mut d_alpha);
            self.acceleration.backward(&input, &vec![d_alpha], grad_a);
        }
        sums
    }
}
