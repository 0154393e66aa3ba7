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
//! * A block of particles goes through the network, its motion and its steps at once, and back the same way.
//! * Results are bitwise equal for any number of threads.

pub(crate) mod arc;
mod config;
mod form;

pub use config::{AccelMap, LawConfig, LawForm, LawInput};

use crate::blocks::Posed;
use crate::dynamics::{Dynamics, Moves, Start};
use crate::error::PhysicsError;
use crate::lanes::LANES;
use crate::rollout::Rollout;
use crate::step::Tick;
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
    ticks: Vec<Tick<f64>>,
    span: Span<f64>,
    blocks: Vec<Block>,
    chunks: Vec<MlpGrad>,
}

/// What one block of particles leaves for the way back.
#[derive(Clone, Debug, Default)]
struct Block {
    /// Encoded positions.
    position: Vec<f32>,
    net: MlpTape,
    motions: Vec<Motion<f32>>,
    /// Poses before every step.
    poses: Vec<Posed>,
    d: BlockGrad,
}

/// Cotangents of one block.
#[derive(Clone, Debug, Default)]
struct BlockGrad {
    /// Of the ends, then of the starts.
    moves: Moves,
    motions: Vec<Motion<f32>>,
    /// Of the network's outputs.
    out: Vec<f32>,
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

    /// What all particles share: the time, folded into the first bias.
    fn fold_time(&self, t: f64, time: &mut Vec<f32>, bias: &mut Vec<f32>) {
        time.clear();
        time.resize(self.net.inputs() - self.columns(), 0.0);
        if !time.is_empty() {
            encoding::encode(&[t as f32], 1, self.config.bands, time);
        }
        self.net.fold(time, bias);
    }

    /// Runs the network at the places of a block.
    fn read(&self, x: &[Vec3], bias: &[f32], block: &mut Block) {
        let columns = self.columns();
        block.position.resize(x.len() * columns, 0.0);
        for (x, row) in x.iter().zip(block.position.chunks_exact_mut(columns)) {
            let x = *x * self.config.coordinate_scale;
            encoding::encode(&x.to_array(), 3, self.config.bands, row);
        }
        self.net.forward_folded(&block.position, columns, bias, &mut block.net);
    }

    /// Motions of the particles of a block from what the network said; the middle is about the origin.
    fn form_motions(&self, x: &[Vec3], middle: [f32; 3], block: &mut Block) {
        block.motions.clear();
        let rows = block.net.output().chunks_exact(self.net.outputs()).zip(x);
        block.motions.extend(rows.map(|(y, x)| self.form.motion(y, self.relative(*x), middle)));
    }

    /// Carries the rows of a block, which are at their start, by steps.
    fn roll(&self, ticks: &[Tick<f64>], block: &mut Block, rows: (&mut [Vec3], &mut [[f32; 4]])) {
        block.poses.resize(block.motions.len().div_ceil(LANES) * ticks.len(), Posed::default());
        self.rollout.roll_rows(&block.motions, ticks, rows, Some(&mut block.poses));
    }

    /// Carries the rows of a block, which are at their start, along closed forms.
    fn carry(&self, span: Span<f32>, block: &Block, (means, turns): (&mut [Vec3], &mut [[f32; 4]])) {
        for ((y, x), q) in block.net.output().chunks_exact(self.net.outputs()).zip(means).zip(turns) {
            let (end, turn) = arc::carry(&self.form, y, self.relative(*x), span);
            *x = self.rollout.origin + Vec3::from_array(end);
            *q = turn;
        }
    }

    /// Cotangents of the network's outputs from those of the ends, `block.d.moves`, through motions and steps. `spin_up` is
    /// the weight of the penalty on changes of turning for one particle.
    fn roll_back(&self, ticks: &[Tick<f64>], middle: [f32; 3], spin_up: f32, block: &mut Block) {
        let Block { net, motions, poses, d, .. } = block;
        d.motions.clear();
        d.motions.resize(motions.len(), Motion::default());
        let ends = (d.moves.means.as_mut_slice(), d.moves.turns.as_mut_slice());
        self.rollout.roll_rows_back(motions, (ticks, poses), ends, &mut d.motions);
        for (d, m) in d.motions.iter_mut().zip(motions) {
            (0..3).for_each(|k| d.rate.w[k] += spin_up * m.rate.w[k]);
        }
        let outputs = self.net.outputs();
        d.out.resize(net.output().len(), 0.0);
        let rows = net.output().chunks_exact(outputs).zip(d.out.chunks_exact_mut(outputs));
        for ((y, d_y), d_motion) in rows.zip(&d.motions) {
            self.form.motion_back(y, middle, d_motion, d_y);
        }
    }

    /// The same through closed forms.
    fn carry_back(&self, x: &[Vec3], span: Span<f32>, block: &mut Block) {
        let (Block { net, d, .. }, outputs) = (block, self.net.outputs());
        d.out.resize(net.output().len(), 0.0);
        let rows = net.output().chunks_exact(outputs).zip(d.out.chunks_exact_mut(outputs));
        for (i, (y, d_y)) in rows.enumerate() {
            let ends = (d.moves.means[i].to_array(), d.moves.turns[i]);
            arc::carry_back(&self.form, y, self.relative(x[i]), span, ends, d_y);
        }
    }

    /// From the cotangents of a block's ends to the weights.
    fn learn(&self, shared: &Shared<'_>, x: &[Vec3], block: &mut Block, grad: &mut MlpGrad) {
        if self.form.is_closed() {
            self.carry_back(x, shared.span, block);
        } else {
            self.roll_back(shared.ticks, shared.middle, shared.spin_up, block);
        }
        let BlockGrad { out, .. } = &mut block.d;
        for d_y in out.chunks_exact_mut(self.net.outputs()) {
            shorten(&mut d_y[self.form.rates()], self.config.accel_clamp);
        }
        self.net.backward_folded(&block.position, self.columns(), &mut block.net, out, grad);
    }
}

/// What all blocks share on the way back.
struct Shared<'a> {
    ticks: &'a [Tick<f64>],
    span: Span<f32>,
    middle: [f32; 3],
    spin_up: f32,
}

impl Dynamics for Law {
    type Tape = LawTape;

    fn transport(&self, start: Start<'_>, to: f64, tape: &mut LawTape, out: &mut Moves) {
        let Start { x, t: from, middle } = start;
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
        tape.ticks = self.rollout.ticks(span);
        self.fold_time(from, &mut tape.time, &mut tape.bias);
        tape.blocks.resize_with(x.len().div_ceil(BLOCK), Block::default);
        let LawTape { bias, ticks, span, blocks, .. } = tape;
        let (bias, ticks, span, middle) = (&*bias, &*ticks, span.narrowed(), self.relative(middle));
        let ends = out.means.par_chunks_mut(BLOCK).zip(out.turns.par_chunks_mut(BLOCK));
        blocks.par_iter_mut().zip(x.par_chunks(BLOCK)).zip(ends).for_each(|((block, x), ends)| {
            self.read(x, bias, block);
            if self.form.is_closed() {
                self.carry(span, block, ends);
            } else {
                self.form_motions(x, middle, block);
                self.roll(ticks, block, ends);
            }
        });
    }

    fn transport_backward(&mut self, start: Start<'_>, tape: &mut LawTape, d: &Moves) {
        let Start { x, middle, .. } = start;
        if tape.span.tau == 0.0 {
            return;
        }
        let LawTape { time, ticks, span, blocks, chunks, .. } = tape;
        let spin_up = self.config.spin_up_weight / x.len().max(1) as f32;
        let shared = Shared { ticks, span: span.narrowed(), middle: self.relative(middle), spin_up };
        let per_chunk = nn::blocks_per_chunk(blocks.len());
        chunks.resize_with(CHUNKS, MlpGrad::default);
        let used = &mut chunks[..blocks.len().div_ceil(per_chunk)];
        let rows = x.par_chunks(per_chunk * BLOCK).zip(d.means.par_chunks(per_chunk * BLOCK));
        let rows = rows.zip(d.turns.par_chunks(per_chunk * BLOCK));
        let runs = blocks.par_chunks_mut(per_chunk).zip(&mut *used).zip(rows);
        runs.for_each(|((blocks, grad), ((x, d_means), d_turns))| {
            grad.reset(&self.net);
            let rows = x.chunks(BLOCK).zip(d_means.chunks(BLOCK)).zip(d_turns.chunks(BLOCK));
            for (block, ((x, d_means), d_turns)) in blocks.iter_mut().zip(rows) {
                block.d.moves.set(d_means, d_turns);
                self.learn(&shared, x, block, grad);
            }
        });
        self.net.add_grads_folded(time, used.iter());
    }

    fn motions(&self, start: Start<'_>) -> Vec<Motion<f32>> {
        let (mut time, mut bias) = (Vec::new(), Vec::new());
        self.fold_time(start.t, &mut time, &mut bias);
        let middle = self.relative(start.middle);
        let of_block = |x: &[Vec3]| {
            let mut block = Block::default();
            self.read(x, &bias, &mut block);
            self.form_motions(x, middle, &mut block);
            block.motions
        };
        start.x.par_chunks(BLOCK).flat_map_iter(of_block).collect()
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
