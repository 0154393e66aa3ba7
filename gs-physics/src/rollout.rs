//! Rolling particles along their motions: sub-steps, many particles at a time, and the way back.
//!
//! ```text
//! n = ⌈|τ₁ − τ₀| / Δt − 1e-6⌉        n − 1 steps of Δt, then the remainder
//! ```
//! Clocks are `f64`, twists are evaluated at the absolute time since they were read (nothing is added up), quaternions are
//! renormalised every 64 steps. Particles are carried in blocks of eight, on however many threads: the bits are the same.

use crate::blocks::{self, Posed, Run};
use crate::dynamics::Moves;
use crate::integrator::Integrator;
use crate::lanes::LANES;
use crate::step::Tick;
use crate::twist::Motion;
use fearless_simd::{Level, dispatch};
use glam::Vec3;
use rayon::prelude::*;

/// Blocks per task.
pub(crate) const TASK: usize = 64;
/// Particles per task.
pub(crate) const PARTICLES: usize = TASK * LANES;
/// No roll-out takes more steps than this: what is left is one long step.
const MAX_STEPS: f64 = 1e6;

/// How particles are rolled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rollout {
    /// How a step is made.
    pub rule: Integrator,
    /// Longest step, in the unit of time of the motions. If it is not above zero, there is one step.
    pub dt: f64,
    /// What the twists refer to, world units.
    pub origin: Vec3,
}

/// What [`Rollout::advance_taped`] leaves for [`Rollout::adjoint`]: the poses before every step.
#[derive(Clone, Debug, Default)]
pub struct RollTape {
    ticks: Vec<Tick<f64>>,
    /// Block by block, step by step.
    poses: Vec<Posed>,
}

impl Rollout {
    /// The steps over `span`, as `(begin, length)`; lengths are negative when it runs backwards.
    pub fn steps(&self, [from, to]: [f64; 2]) -> Vec<(f64, f64)> {
        let count = step_count(to - from, self.dt);
        if count == 0 {
            return Vec::new();
        }
        let full = self.dt.copysign(to - from);
        let begin = |k: usize| from + k as f64 * full;
        let last = count - 1;
        (0..count).map(|k| (begin(k), if k < last { full } else { to - begin(last) })).collect()
    }

    pub(crate) fn ticks(&self, span: [f64; 2]) -> Vec<Tick<f64>> {
        self.steps(span).into_iter().map(|(tau, h)| Tick::new(tau, h)).collect()
    }

    /// How many particles a rule that is not rigid would carry outwards visibly: those that turn by more than 0.3 rad in
    /// a step at either end of `span` (radii then grow by more than 0.1 % a step). 0 for the rules on SE(3).
    pub fn spun_out(&self, motions: &[Motion<f32>], span: [f64; 2]) -> usize {
        if matches!(self.rule, Integrator::Se3Mid | Integrator::Se3Magnus4) {
            return 0;
        }
        let longest = self.steps(span).first().map_or(0.0, |s| s.1.abs()) as f32;
        let fast = |m: &Motion<f32>, tau: f64| Vec3::from_array(m.at(tau as f32).w).length() * longest > 0.3;
        motions.iter().filter(|m| span.iter().any(|&tau| fast(m, tau))).count()
    }

    /// Rolls particles, whose motions were read at `τ = 0`, from `τ = span[0]` to `span[1]`. Positions in world units;
    /// quaternions are multiplied from the left by what the particles turned. All slices have one row per particle. An
    /// empty span changes nothing.
    pub fn advance(&self, motions: &[Motion<f32>], span: [f64; 2], means: &mut [Vec3], quats: &mut [[f32; 4]]) {
        self.roll(motions, &self.ticks(span), means, quats, None);
    }

    /// As [`Rollout::advance`], and remembers the way for [`Rollout::adjoint`]: `7 · 4` bytes per particle and step.
    pub fn advance_taped(
        &self,
        motions: &[Motion<f32>],
        span: [f64; 2],
        means: &mut [Vec3],
        quats: &mut [[f32; 4]],
        tape: &mut RollTape,
    ) {
        tape.ticks = self.ticks(span);
        let RollTape { ticks, poses } = tape;
        poses.resize(motions.len().div_ceil(LANES) * ticks.len(), Default::default());
        self.roll(motions, ticks, means, quats, Some(poses));
    }

    fn roll(
        &self,
        motions: &[Motion<f32>],
        ticks: &[Tick<f64>],
        means: &mut [Vec3],
        quats: &mut [[f32; 4]],
        tape: Option<&mut [Posed]>,
    ) {
        let steps = ticks.len();
        if steps == 0 {
            return;
        }
        let tasks = motions.len().div_ceil(PARTICLES);
        let tapes: Vec<Option<&mut [Posed]>> = match tape {
            Some(tape) => tape.chunks_mut(TASK * steps).map(Some).collect(),
            None => (0..tasks).map(|_| None).collect(),
        };
        let rows = means.par_chunks_mut(PARTICLES).zip(quats.par_chunks_mut(PARTICLES));
        motions.par_chunks(PARTICLES).zip(rows).zip(tapes).for_each(|((motions, (means, quats)), tape)| {
            self.roll_rows(motions, ticks, (means, quats), tape);
        });
    }

    /// Rolls the rows of one task in place; `tape` takes the poses before every step, block by block.
    pub(crate) fn roll_rows(
        &self,
        motions: &[Motion<f32>],
        ticks: &[Tick<f64>],
        (means, quats): (&mut [Vec3], &mut [[f32; 4]]),
        mut tape: Option<&mut [Posed]>,
    ) {
        let (run, steps) = (Run { rule: self.rule, ticks, done: 0 }, ticks.len());
        let rows = means.chunks_mut(LANES).zip(quats.chunks_mut(LANES));
        for (b, (motions, (means, quats))) in motions.chunks(LANES).zip(rows).enumerate() {
            let packed = blocks::pack_motions(motions);
            let start = blocks::pack_states(means, quats, self.origin);
            let mut state = start;
            let tape = tape.as_mut().map(|t| &mut t[b * steps..][..steps]);
            dispatch!(Level::new(), simd => blocks::roll(simd, run, &packed, &mut state, tape));
            blocks::unpack_states(&start, &state, means, quats);
        }
    }

    /// The way back of [`Rollout::advance_taped`] with the same rule and motions: `d` are cotangents of positions and
    /// quaternions at the end. Adds to `d_motions`, one row per particle, and gives the cotangents of positions and
    /// quaternions at the start (which training against constants discards).
    pub fn adjoint(&self, motions: &[Motion<f32>], tape: &RollTape, d: &Moves, d_motions: &mut [Motion<f32>]) -> Moves {
        let mut start = d.clone();
        let RollTape { ticks, poses } = tape;
        if ticks.is_empty() {
            return start;
        }
        let rows = start.means.par_chunks_mut(PARTICLES).zip(start.turns.par_chunks_mut(PARTICLES));
        let given = motions.par_chunks(PARTICLES).zip(poses.par_chunks(TASK * ticks.len()));
        given.zip(d_motions.par_chunks_mut(PARTICLES)).zip(rows).for_each(|(((m, poses), d_m), rows)| {
            self.roll_rows_back(m, (ticks, poses), rows, d_m);
        });
        start
    }

    /// The way back of [`Rollout::roll_rows`] over one step or more: cotangents go from the end to the start in place, those
    /// of the motions are added to `d_motions`.
    pub(crate) fn roll_rows_back(
        &self,
        motions: &[Motion<f32>],
        (ticks, poses): (&[Tick<f64>], &[Posed]),
        (means, turns): (&mut [Vec3], &mut [[f32; 4]]),
        d_motions: &mut [Motion<f32>],
    ) {
        let run = Run { rule: self.rule, ticks, done: 0 };
        let rows = means.chunks_mut(LANES).zip(turns.chunks_mut(LANES));
        let given = motions.chunks(LANES).zip(poses.chunks(ticks.len()));
        for (((m, poses), d_m), (means, turns)) in given.zip(d_motions.chunks_mut(LANES)).zip(rows) {
            let packed = blocks::pack_motions(m);
            let mut d = blocks::pack_poses(means, turns, Vec3::ZERO);
            let grad = dispatch!(Level::new(), simd => blocks::roll_back(simd, run, &packed, poses, &mut d));
            blocks::add_motions(&grad, d_m);
            blocks::set_poses(&d, means, turns);
        }
    }
}

/// `⌈|span| / dt − 1e-6⌉`, at least one step for a span that is not empty.
fn step_count(span: f64, dt: f64) -> usize {
    if span == 0.0 || span.is_nan() {
        return 0;
    }
    let count = if dt > 0.0 { (span.abs() / dt - 1e-6).ceil() } else { 1.0 };
    count.clamp(1.0, MAX_STEPS) as usize
}
