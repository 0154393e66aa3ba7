//! A learnt law of motion (TRACE, Li, Song and Yang, ICCV 2025): a small network reads a particle's place and the time and
//! says how it moves from then on.
//!
//! ```text
//! y = net(γ(s x), γ(t))          SiLU, γ: positional encoding, s: coordinate scale
//! motion = form(y)               twist and its derivatives, see form
//! x', q = roll(motion, x, from → to)
//! ```
//! * The law is read **once**, at `(x, from)`: what follows is mechanics. So it extrapolates where a field of positions
//!   would not.
//! * Positions are constants: gradients go to the weights alone.
//! * The time is the same for all particles of a call, so it is folded into the first bias.
//! * Results are bitwise equal for any number of threads.

pub(crate) mod arc;
mod config;
mod form;

pub use config::{AccelMap, LawConfig, LawForm, LawInput};

use crate::dynamics::{Dynamics, Moves, Start};
use crate::error::PhysicsError;
use crate::rollout::{RollTape, Rollout};
use crate::twist::Motion;
use arc::Span;
pub(crate) use form::Form;
use form::MAX_OUTPUTS;
use glam::Vec3;
use gs_core::nn::{self, Activation, BLOCK, CHUNKS, Init, Mlp, MlpGrad, MlpTape, encoding};
use gs_core::{Param, Params};
use rayon::prelude::*;

/// Identity rotation.
const STILL: [f32; 4] = [1.0, 0.0, 0.0, 0.0];

/// The law; see the [module](self).
#[derive(Clone, Debug)]
pub struct Law {
    config: LawConfig,
    form: Form,
    rollout: Rollout,
    net: Mlp,
}

/// Scratch of a [`Law`].
#[derive(Clone, Debug, Default)]
pub struct LawTape {
    /// The encoded time.
    time: Vec<f32>,
    /// The first bias with the time folded in.
    bias: Vec<f32>,
    blocks: Vec<Block>,
    motions: Vec<Motion<f32>>,
    d_motions: Vec<Motion<f32>>,
    roll: RollTape,
    span: Span<f64>,
    chunks: Vec<MlpGrad>,
}

/// Activations of one block of particles.
#[derive(Clone, Debug, Default)]
struct Block {
    /// Encoded positions.
    position: Vec<f32>,
    net: MlpTape,
    /// Cotangents of the network's outputs.
    d_out: Vec<f32>,
}

impl Law {
    /// A law whose twists refer to `origin` (world units; the world's own if `local_origin` is off), carried in steps of
    /// at most `step` (the unit of time of all calls). Parameters are named `physics.layer.…`.
    ///
    /// # Errors
    /// If a setting cannot be built; the message names it.
    pub fn new(config: &LawConfig, origin: Vec3, step: f64, seed: u64) -> Result<Self, PhysicsError> {
        config.check()?;
        let form = Form::new(config);
        let (outputs, first) = form.outputs();
        let time = if config.input == LawInput::Xt { encoding::width(1, config.bands) } else { 0 };
        let mut widths = vec![config.hidden; config.depth + 2];
        widths[0] = encoding::width(3, config.bands) + time;
        widths[config.depth + 1] = outputs;
        let mut net =
            Mlp::new("physics.layer", &widths, Init::FanIn, Init::FanIn, seed).with_activation(Activation::Silu);
        soften(&mut net, first, config.head_start);
        let origin = if config.local_origin { origin } else { Vec3::ZERO };
        Ok(Self { config: config.clone(), form, rollout: Rollout { rule: config.integrator, dt: step, origin }, net })
    }

    /// The settings it was built from.
    pub fn config(&self) -> &LawConfig {
        &self.config
    }

    /// How particles are carried.
    pub fn rollout(&self) -> Rollout {
        self.rollout
    }

    pub(crate) fn net(&self) -> &Mlp {
        &self.net
    }

    fn columns(&self) -> usize {
        encoding::width(3, self.config.bands)
    }

    /// A place about the origin.
    fn relative(&self, x: Vec3) -> [f32; 3] {
        (x - self.rollout.origin).to_array()
    }

    /// Runs the network at `(x, t)`.
    fn read(&self, x: &[Vec3], t: f64, tape: &mut LawTape) {
        let columns = self.columns();
        tape.time.clear();
        tape.time.resize(self.net.inputs() - columns, 0.0);
        if !tape.time.is_empty() {
            encoding::encode(&[t as f32], 1, self.config.bands, &mut tape.time);
        }
        self.net.fold(&tape.time, &mut tape.bias);
        tape.blocks.resize_with(x.len().div_ceil(BLOCK), Block::default);
        tape.blocks.par_iter_mut().zip(x.par_chunks(BLOCK)).for_each(|(block, x)| {
            block.position.resize(x.len() * columns, 0.0);
            for (x, row) in x.iter().zip(block.position.chunks_exact_mut(columns)) {
                let x = *x * self.config.coordinate_scale;
                encoding::encode(&x.to_array(), 3, self.config.bands, row);
            }
            self.net.forward_folded(&block.position, columns, &tape.bias, &mut block.net);
        });
    }

    /// Motions from the outputs in the tape.
    fn form_motions(&self, start: Start<'_>, blocks: &[Block], motions: &mut Vec<Motion<f32>>) {
        let Start { x, middle, .. } = start;
        let middle = self.relative(middle);
        motions.resize(x.len(), Motion::default());
        let rows = x.par_chunks(BLOCK).zip(motions.par_chunks_mut(BLOCK));
        blocks.par_iter().zip(rows).for_each(|(block, (x, motions))| {
            for ((y, x), m) in block.net.output().chunks_exact(self.net.outputs()).zip(x).zip(motions) {
                *m = self.form.motion(y, self.relative(*x), middle);
            }
        });
    }

    /// Carries all rows of `out`, which are at their start, along closed forms.
    fn carry(&self, tape: &LawTape, out: &mut Moves) {
        let span = tape.span.narrowed();
        let rows = out.means.par_chunks_mut(BLOCK).zip(out.turns.par_chunks_mut(BLOCK));
        tape.blocks.par_iter().zip(rows).for_each(|(block, (means, turns))| {
            for ((y, x), q) in block.net.output().chunks_exact(self.net.outputs()).zip(means).zip(turns) {
                let (end, turn) = arc::carry(&self.form, y, self.relative(*x), span);
                *x = self.rollout.origin + Vec3::from_array(end);
                *q = turn;
            }
        });
    }

    /// Cotangents of the network's outputs, from those of motions or of closed forms.
    fn fill_cotangents(&self, start: Start<'_>, tape: &mut LawTape, d: &Moves) {
        let (x, middle) = (start.x, self.relative(start.middle));
        let LawTape { blocks, d_motions, span, .. } = tape;
        let (outputs, span) = (self.net.outputs(), span.narrowed());
        blocks.par_iter_mut().enumerate().for_each(|(b, block)| {
            let y = block.net.output();
            block.d_out.resize(y.len(), 0.0);
            let rows = y.chunks_exact(outputs).zip(block.d_out.chunks_exact_mut(outputs));
            for (i, (y, d_y)) in (b * BLOCK..).zip(rows) {
                if self.form.is_closed() {
                    let ends = (d.means[i].to_array(), d.turns[i]);
                    arc::carry_back(&self.form, y, self.relative(x[i]), span, ends, d_y);
                } else {
                    self.form.motion_back(y, middle, &d_motions[i], d_y);
                }
                shorten(&mut d_y[self.form.rates()], self.config.accel_clamp);
            }
        });
    }

    /// Adds the gradient of the penalty on changes of turning.
    fn shrink_spin_up(&self, tape: &mut LawTape) {
        let weight = self.config.spin_up_weight / tape.motions.len().max(1) as f32;
        if weight > 0.0 {
            let rows = tape.d_motions.iter_mut().zip(&tape.motions);
            rows.for_each(|(d, m)| (0..3).for_each(|k| d.rate.w[k] += weight * m.rate.w[k]));
        }
    }

    /// From cotangents of outputs to the weights.
    fn learn(&mut self, tape: &mut LawTape) {
        let LawTape { blocks, chunks, time, .. } = tape;
        let (per_chunk, columns) = (nn::blocks_per_chunk(blocks.len()), self.columns());
        chunks.resize_with(CHUNKS, MlpGrad::default);
        let used = &mut chunks[..blocks.len().div_ceil(per_chunk)];
        blocks.par_chunks_mut(per_chunk).zip(&mut *used).for_each(|(blocks, grad)| {
            grad.reset(&self.net);
            for Block { position, net, d_out } in blocks {
                self.net.backward_folded(position, columns, net, d_out, grad);
            }
        });
        self.net.add_grads_folded(time, used.iter());
    }
}

impl Dynamics for Law {
    type Tape = LawTape;

    fn transport(&self, start: Start<'_>, to: f64, tape: &mut LawTape, out: &mut Moves) {
        let Start { x, t: from, .. } = start;
        out.means.clear();
        out.means.extend_from_slice(x);
        out.turns.clear();
        out.turns.resize(x.len(), STILL);
        let span = [0.0, to - from];
        let steps = self.form.literal().then(|| self.rollout.steps(span));
        tape.span = Span::new(span[1], steps.as_deref());
        if span[1] == 0.0 {
            return;
        }
        self.read(x, from, tape);
        if self.form.is_closed() {
            self.carry(tape, out);
        } else {
            self.form_motions(start, &tape.blocks, &mut tape.motions);
            self.rollout.advance_taped(&tape.motions, span, &mut out.means, &mut out.turns, &mut tape.roll);
        }
    }

    fn transport_backward(&mut self, start: Start<'_>, tape: &mut LawTape, d: &Moves) {
        let x = start.x;
        if tape.span.tau == 0.0 {
            return;
        }
        if !self.form.is_closed() {
            tape.d_motions.clear();
            tape.d_motions.resize(x.len(), Motion::default());
            self.rollout.adjoint(&tape.motions, &tape.roll, d, &mut tape.d_motions);
            self.shrink_spin_up(tape);
        }
        self.fill_cotangents(start, tape, d);
        self.learn(tape);
    }

    fn motions(&self, start: Start<'_>) -> Vec<Motion<f32>> {
        let (mut tape, mut motions) = (LawTape::default(), Vec::new());
        self.read(start.x, start.t, &mut tape);
        self.form_motions(start, &tape.blocks, &mut motions);
        motions
    }

    fn rules_ahead(&self) -> bool {
        true
    }

    fn carried_by(&self) -> Option<Rollout> {
        (!self.form.is_closed()).then_some(self.rollout)
    }

    fn origin(&self) -> Vec3 {
        self.rollout.origin
    }
}

/// Multiplies the first `outputs` rows of the last layer by `factor`.
fn soften(net: &mut Mlp, outputs: usize, factor: f32) {
    let (layers, width) = (net.layers().len(), net.layers().last().map_or(0, nn::Dense::inputs));
    let mut block = 0;
    net.visit_mut(&mut |p| {
        // Each layer shows its weight, then its bias.
        if block / 2 == layers - 1 {
            let rows = if block % 2 == 0 { outputs * width } else { outputs };
            p.value[..rows].iter_mut().for_each(|v| *v *= factor);
        }
        block += 1;
    });
}

/// Shortens `d` to length `limit`, if that is above 0.
fn shorten(d: &mut [f32], limit: f32) {
    debug_assert!(d.len() <= MAX_OUTPUTS, "derivatives of one particle");
    let length = d.iter().map(|v| v * v).sum::<f32>().sqrt();
    if limit > 0.0 && length > limit {
        d.iter_mut().for_each(|v| *v *= limit / length);
    }
}

impl Params for Law {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.net.visit(f);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.net.visit_mut(f);
    }
}
