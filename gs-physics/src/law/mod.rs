//! A learnt law of motion (TRACE, Li, Song and Yang, ICCV 2025): a small network predicts, from a particle's position and
//! the time, how it moves from then on.
//!
//! ```text
//! y = net(γ(s x), γ(t))          SiLU, γ: positional encoding, s: coordinate scale
//! motion = form(y)               twist and its derivatives, see `LawForm`
//! x', q = roll(motion, x, from → to)
//! ```
//! * The network is evaluated **once**, at `(x, from)`; the rest is mechanics. So it extrapolates where a field of
//!   positions would not.
//! * Positions are constants: gradients go to the weights alone.
//! * The time is the same for all particles of a call, so it is folded into the first bias.
//! * A block of particles passes the network, its motions and all its steps at once, forward and backward.
//! * Results are bitwise equal for any number of threads.

pub(crate) mod arc;
mod config;
mod form;

pub use config::{AccelMap, LawConfig, LawForm, LawInput};

use crate::blocks::PoseBlock;
use crate::dynamics::{Dynamics, ParticleState, Start};
use crate::error::PhysicsError;
use crate::lanes::LANES;
use crate::rollout::Rollout;
use crate::step::Substep;
use crate::twist::Motion;
use arc::Span;
pub(crate) use form::Form;
use form::MAX_OUTPUTS;
use glam::Vec3;
use gs_core::nn::{self, Activation, BLOCK, CHUNKS, Init, Mlp, MlpGrad, MlpTape, encoding};
use gs_core::{Param, Params, cast};
use rayon::prelude::*;

/// The rotation by no angle, `(w, x, y, z)`.
const IDENTITY: [f32; 4] = [1.0, 0.0, 0.0, 0.0];

/// A law of motion; see the [module](self).
///
/// ```
/// use glam::Vec3;
/// use gs_physics::{Dynamics, Law, LawConfig, LawTape, ParticleState, Start};
/// let law = Law::new(&LawConfig::small(), Vec3::ZERO, 1.0 / 30.0, 7)?;
/// let start = Start { x: &[Vec3::X, Vec3::Y], t: 0.5, middle: Vec3::ZERO };
/// let mut out = ParticleState::default();
/// law.integrate(start, 0.75, &mut LawTape::default(), &mut out);
/// // The same as its motions, read at 0.5 and rolled out, to the last bit.
/// let (mut means, mut quats) = (start.x.to_vec(), vec![[1.0, 0.0, 0.0, 0.0]; 2]);
/// law.rollout().advance(&law.motions(start), [0.0, 0.25], &mut means, &mut quats);
/// assert_eq!((out.means, out.rotations), (means, quats));
/// # Ok::<(), gs_physics::PhysicsError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Law {
    config: LawConfig,
    form: Form,
    rollout: Rollout,
    net: Mlp,
}

/// Activations of a [`Law`] between forward and backward; reused from call to call.
#[derive(Clone, Debug, Default)]
pub struct LawTape {
    /// Encoding of the time; empty for [`LawInput::X`].
    time: Vec<f32>,
    /// The first bias with the time folded in.
    bias: Vec<f32>,
    substeps: Vec<Substep<f64>>,
    span: Span<f64>,
    blocks: Vec<Block>,
    chunks: Vec<MlpGrad>,
}

/// What backward needs of one block of particles.
#[derive(Clone, Debug, Default)]
struct Block {
    /// Encoded positions, row by row.
    position: Vec<f32>,
    net: MlpTape,
    motions: Vec<Motion<f32>>,
    /// Poses before every step, eight particles at a time.
    poses: Vec<PoseBlock>,
    d: BlockGrad,
}

/// Cotangents of the particles of one block.
#[derive(Clone, Debug, Default)]
struct BlockGrad {
    /// Cotangents of the ends, overwritten by those of the starts.
    ends: ParticleState,
    motions: Vec<Motion<f32>>,
    /// Cotangents of the network's outputs.
    out: Vec<f32>,
}

impl LawConfig {
    /// Number of parameters of the law; the largest number where that is beyond it.
    pub fn param_count(&self) -> u64 {
        Mlp::count_deep(inputs(self), self.depth, self.hidden, Form::new(self).outputs().0)
    }
}

/// Inputs of the network.
fn inputs(config: &LawConfig) -> usize {
    let time = if config.input == LawInput::Xt { encoding::width(1, config.bands) } else { 0 };
    encoding::width(3, config.bands).saturating_add(time)
}

/// Widths of the network's layers.
fn widths(config: &LawConfig) -> Vec<usize> {
    let mut widths = vec![config.hidden; config.depth + 2];
    widths[0] = inputs(config);
    widths[config.depth + 1] = Form::new(config).outputs().0;
    widths
}

impl Law {
    /// A law whose twists refer to `origin` (world units; the world's own if `local_origin` is off), integrated in steps of
    /// at most `step` (the unit of time of all calls). Parameters are named `physics.layer.…`.
    ///
    /// # Errors
    /// If a setting cannot be built; the message names it.
    pub fn new(config: &LawConfig, origin: Vec3, step: f64, seed: u64) -> Result<Self, PhysicsError> {
        config.check()?;
        let form = Form::new(config);
        let (_, first) = form.outputs();
        let mut net = Mlp::new("physics.layer", &widths(config), Init::FanIn, Init::FanIn, seed)
            .with_activation(Activation::Silu);
        scale_head(&mut net, first, config.head_start);
        let origin = if config.local_origin { origin } else { Vec3::ZERO };
        Ok(Self { config: config.clone(), form, rollout: Rollout { rule: config.integrator, dt: step, origin }, net })
    }

    /// The settings it was built from.
    pub fn config(&self) -> &LawConfig {
        &self.config
    }

    /// The roll-out that integrates the law's motions; not used by forms with a closed form.
    pub fn rollout(&self) -> Rollout {
        self.rollout
    }

    pub(crate) fn net(&self) -> &Mlp {
        &self.net
    }

    /// Width of an encoded position.
    fn columns(&self) -> usize {
        encoding::width(3, self.config.bands)
    }

    /// Position relative to the origin.
    fn relative(&self, x: Vec3) -> [f32; 3] {
        (x - self.rollout.origin).to_array()
    }

    /// Folds the time, which all particles share, into the first bias.
    fn fold_time(&self, t: f64, time: &mut Vec<f32>, bias: &mut Vec<f32>) {
        time.clear();
        time.resize(self.net.inputs() - self.columns(), 0.0);
        if !time.is_empty() {
            encoding::encode(&[cast::to_f32(t)], 1, self.config.bands, time);
        }
        self.net.fold(time, bias);
    }

    /// Evaluates the network at the positions of a block.
    fn evaluate(&self, x: &[Vec3], bias: &[f32], block: &mut Block) {
        let columns = self.columns();
        block.position.resize(x.len() * columns, 0.0);
        for (x, row) in x.iter().zip(block.position.chunks_exact_mut(columns)) {
            let x = *x * self.config.coordinate_scale;
            encoding::encode(&x.to_array(), 3, self.config.bands, row);
        }
        self.net.forward_folded(&block.position, columns, bias, &mut block.net);
    }

    /// Motions of the particles of a block from the network's outputs; the centroid is relative to the origin.
    fn form_motions(&self, x: &[Vec3], centroid: [f32; 3], block: &mut Block) {
        block.motions.clear();
        let rows = block.net.output().chunks_exact(self.net.outputs()).zip(x);
        block.motions.extend(rows.map(|(y, x)| self.form.motion(y, self.relative(*x), centroid)));
    }

    /// Advances the rows of a block from their start by steps of the integrator.
    fn advance_stepped(&self, substeps: &[Substep<f64>], block: &mut Block, rows: (&mut [Vec3], &mut [[f32; 4]])) {
        block.poses.resize(block.motions.len().div_ceil(LANES) * substeps.len(), PoseBlock::default());
        self.rollout.roll_rows(&block.motions, substeps, rows, Some(&mut block.poses));
    }

    /// Advances the rows of a block from their start along closed forms.
    fn advance_closed(&self, span: Span<f32>, block: &Block, (means, quats): (&mut [Vec3], &mut [[f32; 4]])) {
        for ((y, x), q) in block.net.output().chunks_exact(self.net.outputs()).zip(means).zip(quats) {
            let (end, rotation) = arc::advance(&self.form, y, self.relative(*x), span);
            *x = self.rollout.origin + Vec3::from_array(end);
            *q = rotation;
        }
    }

    /// Cotangents of the network's outputs from those of the ends, `block.d.ends`, through motions and steps.
    fn advance_stepped_backward(&self, shared: &Shared<'_>, block: &mut Block) {
        let Block { net, motions, poses, d, .. } = block;
        d.motions.clear();
        d.motions.resize(motions.len(), Motion::default());
        let ends = (d.ends.means.as_mut_slice(), d.ends.rotations.as_mut_slice());
        self.rollout.roll_rows_backward(motions, (shared.substeps, poses), ends, &mut d.motions);
        for (d, m) in d.motions.iter_mut().zip(motions) {
            (0..3).for_each(|k| d.rate.w[k] += shared.spin_up_weight * m.rate.w[k]);
        }
        let outputs = self.net.outputs();
        d.out.resize(net.output().len(), 0.0);
        let rows = net.output().chunks_exact(outputs).zip(d.out.chunks_exact_mut(outputs));
        for ((y, d_y), d_motion) in rows.zip(&d.motions) {
            self.form.motion_backward(y, shared.centroid, d_motion, d_y);
        }
    }

    /// As [`Law::advance_stepped_backward`], through closed forms.
    fn advance_closed_backward(&self, x: &[Vec3], span: Span<f32>, block: &mut Block) {
        let (Block { net, d, .. }, outputs) = (block, self.net.outputs());
        d.out.resize(net.output().len(), 0.0);
        let rows = net.output().chunks_exact(outputs).zip(d.out.chunks_exact_mut(outputs));
        for (i, (y, d_y)) in rows.enumerate() {
            let ends = (d.ends.means[i].to_array(), d.ends.rotations[i]);
            arc::advance_backward(&self.form, y, self.relative(x[i]), span, ends, d_y);
        }
    }

    /// From the cotangents of a block's ends to the weights.
    fn backward(&self, shared: &Shared<'_>, x: &[Vec3], block: &mut Block, grad: &mut MlpGrad) {
        if self.form.is_closed() {
            self.advance_closed_backward(x, shared.span, block);
        } else {
            self.advance_stepped_backward(shared, block);
        }
        let BlockGrad { out, .. } = &mut block.d;
        for d_y in out.chunks_exact_mut(self.net.outputs()) {
            clip_norm(&mut d_y[self.form.rates()], self.config.accel_clamp);
        }
        self.net.backward_folded(&block.position, self.columns(), &mut block.net, out, grad);
    }
}

/// Inputs of backward that all blocks share.
struct Shared<'a> {
    substeps: &'a [Substep<f64>],
    span: Span<f32>,
    centroid: [f32; 3],
    /// Weight of the penalty on angular acceleration for one particle.
    spin_up_weight: f32,
}

impl Dynamics for Law {
    type Tape = LawTape;

    fn integrate(&self, start: Start<'_>, to: f64, tape: &mut LawTape, out: &mut ParticleState) {
        let Start { x, t: from, .. } = start;
        out.means.clear();
        out.means.extend_from_slice(x);
        out.rotations.clear();
        out.rotations.resize(x.len(), IDENTITY);
        let span = [0.0, to - from];
        let steps = self.form.literal().then(|| self.rollout.steps(span));
        tape.span = Span::new(span[1], steps.as_deref());
        if span[1] == 0.0 {
            return;
        }
        tape.substeps = self.rollout.substeps(span);
        self.fold_time(from, &mut tape.time, &mut tape.bias);
        tape.blocks.resize_with(x.len().div_ceil(BLOCK), Block::default);
        let LawTape { bias, substeps, span, blocks, .. } = tape;
        let (bias, substeps, span) = (&*bias, &*substeps, span.to_f32());
        let centroid = self.relative(start.middle);
        let ends = out.means.par_chunks_mut(BLOCK).zip(out.rotations.par_chunks_mut(BLOCK));
        blocks.par_iter_mut().zip(x.par_chunks(BLOCK)).zip(ends).for_each(|((block, x), ends)| {
            self.evaluate(x, bias, block);
            if self.form.is_closed() {
                self.advance_closed(span, block, ends);
            } else {
                self.form_motions(x, centroid, block);
                self.advance_stepped(substeps, block, ends);
            }
        });
    }

    fn integrate_backward(&mut self, start: Start<'_>, tape: &mut LawTape, d: &ParticleState) {
        let x = start.x;
        if tape.span.tau == 0.0 {
            return;
        }
        let LawTape { time, substeps, span, blocks, chunks, .. } = tape;
        let spin_up_weight = self.config.spin_up_weight / x.len().max(1) as f32;
        let centroid = self.relative(start.middle);
        let shared = Shared { substeps, span: span.to_f32(), centroid, spin_up_weight };
        let per_chunk = nn::blocks_per_chunk(blocks.len());
        chunks.resize_with(CHUNKS, MlpGrad::default);
        let used = &mut chunks[..blocks.len().div_ceil(per_chunk)];
        let rows = x.par_chunks(per_chunk * BLOCK).zip(d.means.par_chunks(per_chunk * BLOCK));
        let rows = rows.zip(d.rotations.par_chunks(per_chunk * BLOCK));
        let runs = blocks.par_chunks_mut(per_chunk).zip(&mut *used).zip(rows);
        runs.for_each(|((blocks, grad), ((x, d_means), d_turns))| {
            grad.reset(&self.net);
            let rows = x.chunks(BLOCK).zip(d_means.chunks(BLOCK)).zip(d_turns.chunks(BLOCK));
            for (block, ((x, d_means), d_turns)) in blocks.iter_mut().zip(rows) {
                block.d.ends.set(d_means, d_turns);
                self.backward(&shared, x, block, grad);
            }
        });
        self.net.add_grads_folded(time, used.iter());
    }

    fn motions(&self, start: Start<'_>) -> Vec<Motion<f32>> {
        let (mut time, mut bias) = (Vec::new(), Vec::new());
        self.fold_time(start.t, &mut time, &mut bias);
        let centroid = self.relative(start.middle);
        let of_block = |x: &[Vec3]| {
            let mut block = Block::default();
            self.evaluate(x, &bias, &mut block);
            self.form_motions(x, centroid, &mut block);
            block.motions
        };
        start.x.par_chunks(BLOCK).flat_map_iter(of_block).collect()
    }

    fn motions_extrapolate(&self) -> bool {
        true
    }

    fn motion_rollout(&self) -> Option<Rollout> {
        (!self.form.is_closed()).then_some(self.rollout)
    }

    fn origin(&self) -> Vec3 {
        self.rollout.origin
    }
}

/// Multiplies the first `outputs` rows of the last layer by `factor`.
fn scale_head(net: &mut Mlp, outputs: usize, factor: f32) {
    let (layers, width) = (net.layers().len(), net.layers().last().map_or(0, nn::Dense::inputs));
    let mut block = 0;
    net.visit_mut(&mut |p| {
        // Each layer visits its weight, then its bias.
        if block / 2 == layers - 1 {
            let rows = if block % 2 == 0 { outputs * width } else { outputs };
            p.value[..rows].iter_mut().for_each(|v| *v *= factor);
        }
        block += 1;
    });
}

/// Scales `d` down to norm `limit`, if that is above 0.
fn clip_norm(d: &mut [f32], limit: f32) {
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
