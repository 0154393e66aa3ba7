//! A velocity field (NVFi, Li et al., NeurIPS 2023, as in TRACE's baseline DefGS_nvfi): particles are advected by it, and
//! the network is evaluated at every step.
//!
//! ```text
//! u(x, t) = Σ_i c_i(x, t) b_i(x) = v + w × (x − o)         (v, w) = net(γ(s x), γ(t)), five layers with SiLU
//! x_m = x + ½h u(x, t)         x ← x + h u(x_m, t + ½h)    q ← q(h ω) ⊗ q,  ω = ½ ∇ × u at (x_m, t + ½h)
//! ```
//! * NVFi's rotational basis vectors are `−e_i × x`: the same span.
//! * `I + h ∇u` rotates a particle by `exp(h ω)` to first order in `h`. Only the antisymmetric part of the gradient is used,
//!   through the exponential, so the result is a rotation for any step, and exact for a rigid flow.
//! * Positions at the start are constants, those of later steps depend on the weights: backward goes through `∇u` and, for
//!   rotations, through second derivatives of the network.
//! * Activations are not stored: backward evaluates the network again, block by block.
//! * [`regularise`](Dynamics::regularise) is NVFi's physics-informed loss, see [`pinn`](crate::pinn).

mod config;
pub(crate) mod evaluate;
pub(crate) mod flow;
mod step;

pub use config::VelocityConfig;

use crate::dynamics::{Dynamics, ParticleState, Start};
use crate::error::PhysicsError;
use crate::integrator::Integrator;
use crate::rollout::Rollout;
use crate::twist::{Motion, Twist};
use crate::vec3::sub;
use evaluate::{Derivatives, Evaluation};
use flow::BASIS;
use glam::Vec3;
use gs_core::nn::{self, Activation, BLOCK, CHUNKS, Init, Mlp, MlpGrad};
use gs_core::real::cross3;
use gs_core::{Param, Params, cast};
use rayon::prelude::*;
use step::Step;

/// A velocity field with its acceleration; see the [module](self).
///
/// ```
/// use glam::Vec3;
/// use gs_core::Params;
/// use gs_physics::{Dynamics, ParticleState, Start, VelocityConfig, VelocityField, VelocityTape};
/// let config = VelocityConfig { hidden: 8, depth: 2, ..VelocityConfig::small() };
/// let mut field = VelocityField::new(&config, [Vec3::NEG_ONE, Vec3::ONE], 0.25, 0)?;
/// // The last bias alone gives the same twist everywhere: here a velocity of 2 along x.
/// field.visit_mut(&mut |p| {
///     p.value.fill(0.0);
///     if p.name == "velocity.layer.2.bias" {
///         p.value[0] = 2.0;
///     }
/// });
/// let (start, mut out) = (Start { x: &[Vec3::ZERO], t: 0.0, middle: Vec3::ZERO }, ParticleState::default());
/// field.integrate(start, 0.5, &mut VelocityTape::default(), &mut out);
/// assert_eq!((out.means[0], out.rotations[0]), (Vec3::X, [1.0, 0.0, 0.0, 0.0]));
/// # Ok::<(), gs_physics::PhysicsError>(())
/// ```
#[derive(Clone, Debug)]
pub struct VelocityField {
    pub(crate) config: VelocityConfig,
    pub(crate) bounds: [Vec3; 2],
    rollout: Rollout,
    pub(crate) net: Mlp,
    pub(crate) acceleration: Mlp,
}

/// States of a [`VelocityField`] between forward and backward; reused from call to call.
#[derive(Clone, Debug, Default)]
pub struct VelocityTape {
    /// `(time, length)` of each step.
    steps: Vec<(f64, f64)>,
    chunks: Vec<Chunk>,
}

/// Scratch and gradients of consecutive blocks of particles.
#[derive(Clone, Debug, Default)]
struct Chunk {
    /// The states of each block before each step.
    states: Vec<Vec<ParticleState>>,
    step: Step,
    grad: MlpGrad,
}

impl VelocityConfig {
    /// Number of parameters of both networks; the largest number where that is beyond it.
    pub fn param_count(&self) -> u64 {
        Mlp::count_deep(evaluate::inputs(self.bands), self.depth, self.hidden, BASIS).saturating_mul(2)
    }
}

/// Widths of the layers of each network.
fn widths(config: &VelocityConfig) -> Vec<usize> {
    let mut widths = vec![config.hidden; config.depth + 2];
    widths[0] = evaluate::inputs(config.bands);
    widths[config.depth + 1] = BASIS;
    widths
}

impl VelocityField {
    /// A field for a scene within `bounds` (lowest and highest corner, world units), integrated in steps of at most `step`
    /// (the unit of time of all calls). Parameters are named `velocity.layer.…` and `acceleration.layer.…`.
    ///
    /// # Errors
    /// If a setting or the box cannot be used; the message names it.
    pub fn new(config: &VelocityConfig, bounds: [Vec3; 2], step: f64, seed: u64) -> Result<Self, PhysicsError> {
        config.check(bounds)?;
        let widths = widths(config);
        let net = |name: &str, activation| {
            Mlp::new(name, &widths, Init::FanIn, Init::FanIn, seed).with_activation(activation)
        };
        let origin = if config.local_origin { 0.5 * (bounds[0] + bounds[1]) } else { Vec3::ZERO };
        Ok(Self {
            config: config.clone(),
            bounds,
            rollout: Rollout { rule: Integrator::Rk2, dt: step, origin },
            net: net("velocity.layer", Activation::Silu),
            acceleration: net("acceleration.layer", Activation::Relu),
        })
    }

    /// The settings it was built from.
    pub fn config(&self) -> &VelocityConfig {
        &self.config
    }

    /// Position relative to the origin.
    pub(crate) fn relative(&self, x: Vec3) -> [f32; 3] {
        (x - self.rollout.origin).to_array()
    }

    pub(crate) fn rollout(&self) -> Rollout {
        self.rollout
    }

    /// Particles per chunk, whole blocks.
    fn rows_per_chunk(&self, n: usize) -> usize {
        nn::blocks_per_chunk(n.div_ceil(BLOCK)) * BLOCK
    }
}

impl Dynamics for VelocityField {
    type Tape = VelocityTape;

    fn integrate(&self, start: Start<'_>, to: f64, tape: &mut VelocityTape, out: &mut ParticleState) {
        let Start { x, t: from, .. } = start;
        out.means.clear();
        out.means.extend_from_slice(x);
        out.rotations.clear();
        out.rotations.resize(x.len(), [1.0, 0.0, 0.0, 0.0]);
        tape.steps = self.rollout.steps([from, to]);
        tape.chunks.resize_with(CHUNKS, Chunk::default);
        let per_chunk = self.rows_per_chunk(x.len());
        let rows = out.means.par_chunks_mut(per_chunk).zip(out.rotations.par_chunks_mut(per_chunk));
        let VelocityTape { steps, chunks } = tape;
        chunks.par_iter_mut().zip(rows).for_each(|(chunk, (means, rotations))| {
            chunk.states.resize_with(means.len().div_ceil(BLOCK), Vec::new);
            let rows = means.chunks_mut(BLOCK).zip(rotations.chunks_mut(BLOCK));
            for (states, (means, rotations)) in chunk.states.iter_mut().zip(rows) {
                states.resize_with(steps.len(), ParticleState::default);
                for (step, state) in steps.iter().zip(states) {
                    state.set(means, rotations);
                    chunk.step.forward(self, *step, means, rotations);
                }
            }
        });
    }

    fn integrate_backward(&mut self, start: Start<'_>, tape: &mut VelocityTape, d: &ParticleState) {
        let x = start.x;
        let VelocityTape { steps, chunks } = tape;
        if steps.is_empty() {
            return;
        }
        let per_chunk = self.rows_per_chunk(x.len());
        let rows = d.means.par_chunks(per_chunk).zip(d.rotations.par_chunks(per_chunk));
        let used = &mut chunks[..x.len().div_ceil(per_chunk)];
        used.par_iter_mut().zip(rows).for_each(|(chunk, (means, rotations))| {
            chunk.grad.reset(&self.net);
            let rows = means.chunks(BLOCK).zip(rotations.chunks(BLOCK));
            for (states, (means, rotations)) in chunk.states.iter().zip(rows) {
                let mut d = ParticleState { means: means.to_vec(), rotations: rotations.to_vec() };
                for (step, state) in steps.iter().zip(states).rev() {
                    chunk.step.backward(self, *step, state, &mut d, &mut chunk.grad);
                }
            }
        });
        self.net.add_grads(used.iter().map(|c| &c.grad));
    }

    fn regularise(&mut self, seed: u64, step: u32) -> Vec<(&'static str, f32)> {
        crate::pinn::regularise(self, seed, step)
    }

    /// Local twists, and rates `v̄'` by which [`Motion::acceleration`] is that of what flows, `∂_t u + (∇u) u`. Rates `w'` are 0: they
    /// would need second derivatives of the network.
    fn motions(&self, start: Start<'_>) -> Vec<Motion<f32>> {
        let Start { x, t, .. } = start;
        let mut out = vec![Motion::default(); x.len()];
        out.par_chunks_mut(BLOCK).zip(x.par_chunks(BLOCK)).for_each(|(out, x)| {
            let (mut evaluation, times) = (Evaluation::default(), vec![cast::to_f32(t); x.len()]);
            evaluation.forward(&self.net, &self.config, x, &times, Derivatives::SpaceTime);
            for (i, (m, x)) in out.iter_mut().zip(x).enumerate() {
                let r = self.relative(*x);
                let flow = evaluation.flow(i, r);
                let w = flow.angular_velocity();
                m.twist = Twist { v: sub(flow.u, cross3(w, r)), w };
                m.rate.v = sub(flow.acceleration(), cross3(w, flow.u));
            }
        });
        out
    }

    fn motions_extrapolate(&self) -> bool {
        false
    }

    fn origin(&self) -> Vec3 {
        self.rollout.origin
    }
}

impl Params for VelocityField {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.net.visit(f);
        self.acceleration.visit(f);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.net.visit_mut(f);
        self.acceleration.visit_mut(f);
    }
}
