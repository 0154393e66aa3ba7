//! The physics-informed loss of a velocity field (NVFi): the field is divergence-free, and the velocity of the fluid changes
//! along its path only by an acceleration `a` that a second network predicts (conservation of mass and momentum).
//!
//! ```text
//! L = λ_d mean (∇ · u)²  +  λ_t mean ‖∂_t u + (∇u) u − a‖²          over random x in the scene's box, t in [0, 1]
//! a = Σ α_i a_i,  α = net_a(γ(s x), γ(t)) with ReLU,  a_i: e_x, e_y, e_z, (0, −y, −z), (−x, 0, −z), (−x, −y, 0)
//! ```

use crate::vec3::scale;
use crate::velocity::VelocityField;
use crate::velocity::evaluate::{self, Derivatives, Evaluation};
use crate::velocity::flow::{BASIS, acceleration, acceleration_backward};
use glam::Vec3;
use gs_core::nn::{self, BLOCK, CHUNKS, MlpGrad, MlpTape};
use gs_core::real::dot3;
use gs_core::{Rng, cast};
use rayon::prelude::*;

/// Scratch, gradients and sums of consecutive blocks of points.
#[derive(Default)]
struct Chunk {
    evaluation: Evaluation,
    acceleration: MlpTape,
    input: Vec<f32>,
    d_alpha: Vec<f32>,
    grads: [MlpGrad; 2],
    /// Sums of squares of divergence and of the residual of momentum.
    sums: [f64; 2],
}

/// Collocation point `row` of a training step: a uniform position in the field's bounds and a time in `[0, 1)`.
pub fn point(field: &VelocityField, seed: u64, step: u32, row: usize) -> (Vec3, f32) {
    let mut rng = Rng::new(seed, "collocation", step, row as u64);
    let [lo, hi] = field.bounds;
    let x = Vec3::new(rng.range(lo.x, hi.x), rng.range(lo.y, hi.y), rng.range(lo.z, hi.z));
    (x, rng.uniform())
}

/// Adds the gradient of the loss to both networks, gives its two terms, weights applied. `seed` and `step` determine the
/// collocation points.
pub(crate) fn regularise(field: &mut VelocityField, seed: u64, step: u32) -> Vec<(&'static str, f32)> {
    let (n, weights) = (field.config.points, [field.config.divergence, field.config.transport]);
    if n == 0 || weights == [0.0; 2] {
        return Vec::new();
    }
    let blocks = n.div_ceil(BLOCK);
    let per_chunk = nn::blocks_per_chunk(blocks);
    let mut chunks: Vec<Chunk> = (0..CHUNKS.min(blocks.div_ceil(per_chunk))).map(|_| Chunk::default()).collect();
    chunks.par_iter_mut().enumerate().for_each(|(c, chunk)| {
        chunk.grads[0].reset(&field.net);
        chunk.grads[1].reset(&field.acceleration);
        for block in c * per_chunk..((c + 1) * per_chunk).min(blocks) {
            let rows = block * BLOCK..((block + 1) * BLOCK).min(n);
            let (x, t): (Vec<Vec3>, Vec<f32>) = rows.map(|row| point(field, seed, step, row)).unzip();
            chunk.block(field, &x, &t);
        }
    });
    field.net.add_grads(chunks.iter().map(|c| &c.grads[0]));
    field.acceleration.add_grads(chunks.iter().map(|c| &c.grads[1]));
    let term = |k: usize| {
        let sum: f64 = chunks.iter().map(|c| c.sums[k]).sum();
        cast::to_f32(f64::from(weights[k]) * sum / n as f64)
    };
    vec![("divergence", term(0)), ("transport", term(1))]
}

impl Chunk {
    /// Losses and gradients of one block.
    fn block(&mut self, field: &VelocityField, x: &[Vec3], t: &[f32]) {
        let Self { evaluation, acceleration: tape, input, d_alpha, grads, sums } = self;
        let config = &field.config;
        evaluation.forward(&field.net, config, x, t, Derivatives::SpaceTime);
        input.resize(x.len() * evaluate::inputs(config.bands), 0.0);
        evaluate::encode(config, x, t, input);
        field.acceleration.forward(input, tape);
        d_alpha.resize(x.len() * BASIS, 0.0);
        let share = 2.0 / config.points as f32;
        let alphas = tape.output().chunks_exact(BASIS).zip(d_alpha.chunks_exact_mut(BASIS));
        for (i, (x, (alpha, d_alpha))) in x.iter().zip(alphas).enumerate() {
            let r = field.relative(*x);
            let flow = evaluation.flow(i, r);
            let divergence = flow.divergence();
            let residual = flow.residual(acceleration(alpha, r));
            sums[0] += f64::from(divergence * divergence);
            sums[1] += f64::from(dot3(residual, residual));
            let d_residual = scale(residual, share * config.transport);
            let d = flow.losses_backward(share * config.divergence * divergence, d_residual);
            evaluation.set_cotangent(i, r, &d);
            acceleration_backward(r, scale(d_residual, -1.0), d_alpha);
        }
        evaluation.backward(&field.net, config, None, &mut grads[0]);
        field.acceleration.backward(input, tape, d_alpha, None, &mut grads[1]);
    }
}
