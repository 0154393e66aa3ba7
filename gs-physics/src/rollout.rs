//! Roll-out of particles along their motions in sub-steps, many particles at a time, forward and backward.
//!
//! ```text
//! n = ⌈|τ₁ − τ₀| / Δt − 1e-6⌉        n − 1 steps of Δt, then the remainder
//! ```
//! `1e-6` is a share of a step: by so much the last one may be longer than `Δt`. A remainder above it, such as times rounded to `f32`
//! leave where they are many steps apart, takes a short step of its own.
//! Times are `f64`, twists are evaluated at the absolute time since they were read (nothing is accumulated), quaternions
//! are normalised every 64 steps. Particles are advanced in blocks of eight; results are bitwise equal for any number of
//! threads.

use crate::blocks::{self, PoseBlock, Run};
use crate::dynamics::ParticleState;
use crate::integrator::Integrator;
use crate::lanes::LANES;
use crate::step::Substep;
use crate::twist::Motion;
use fearless_simd::{Level, dispatch};
use glam::Vec3;
use gs_core::cast;
use rayon::prelude::*;

/// Blocks of eight particles per rayon task.
pub(crate) const TASK: usize = 64;
/// Particles per rayon task.
pub(crate) const PARTICLES: usize = TASK * LANES;
/// Largest number of steps of a roll-out; the last one covers the remainder.
const MAX_STEPS: f64 = 1e6;
/// How much longer than the others the last step may be, in steps.
const LONGER: f64 = 1e-6;

/// How particles are integrated along their motions.
///
/// A throw is exact for any step; so is its gradient by the acceleration, `½ τ²`:
/// ```
/// use glam::Vec3;
/// use gs_physics::{Integrator, Motion, ParticleState, RollTape, Rollout, Twist};
/// let translation = |v| Twist { v, w: [0.0; 3] };
/// let rate = translation([0.0, 0.0, -2.0]);
/// let throw = [Motion { twist: translation([1.0, 0.0, 4.0]), rate, jerk: Twist::default() }];
/// let (mut means, mut quats) = ([Vec3::ZERO], [[1.0, 0.0, 0.0, 0.0]]);
/// let (rollout, mut tape) = (Rollout { rule: Integrator::Rk2, dt: 0.25, origin: Vec3::ZERO }, RollTape::default());
/// rollout.advance_taped(&throw, [0.0, 2.0], &mut means, &mut quats, &mut tape);
/// assert_eq!(means[0], Vec3::new(2.0, 0.0, 4.0));
/// let (d, mut d_motions) = (ParticleState { means: vec![Vec3::Z], rotations: vec![[0.0; 4]] }, [Motion::default()]);
/// rollout.adjoint(&throw, &tape, &d, &mut d_motions);
/// assert_eq!(d_motions[0].rate.v, [0.0, 0.0, 2.0]);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rollout {
    /// Integration rule of every step.
    pub rule: Integrator,
    /// Longest step, in the unit of time of the motions. If it is not above zero, there is one step.
    pub dt: f64,
    /// The origin that twists refer to, world units.
    pub origin: Vec3,
}

/// Poses before every step, from [`Rollout::advance_taped`] to [`Rollout::adjoint`].
#[derive(Clone, Debug, Default)]
pub struct RollTape {
    substeps: Vec<Substep<f64>>,
    /// Poses before every step, block by block, step by step.
    poses: Vec<PoseBlock>,
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

    pub(crate) fn substeps(&self, span: [f64; 2]) -> Vec<Substep<f64>> {
        self.steps(span).into_iter().map(|(tau, h)| Substep::new(tau, h)).collect()
    }

    /// Advances particles, whose motions were read at `τ = 0`, from `τ = span[0]` to `span[1]`. Positions in world units;
    /// quaternions `(w, x, y, z)` are multiplied from the left by the rotation of the particle. All slices have one row per
    /// particle. An empty span changes nothing.
    pub fn advance(&self, motions: &[Motion<f32>], span: [f64; 2], means: &mut [Vec3], quats: &mut [[f32; 4]]) {
        self.roll(motions, &self.substeps(span), means, quats, None);
    }

    /// As [`Rollout::advance`], and stores the poses for [`Rollout::adjoint`]: `7 · 4` bytes per particle and step.
    pub fn advance_taped(
        &self,
        motions: &[Motion<f32>],
        span: [f64; 2],
        means: &mut [Vec3],
        quats: &mut [[f32; 4]],
        tape: &mut RollTape,
    ) {
        tape.substeps = self.substeps(span);
        let RollTape { substeps, poses } = tape;
        poses.resize(motions.len().div_ceil(LANES) * substeps.len(), Default::default());
        self.roll(motions, substeps, means, quats, Some(poses));
    }

    fn roll(
        &self,
        motions: &[Motion<f32>],
        substeps: &[Substep<f64>],
        means: &mut [Vec3],
        quats: &mut [[f32; 4]],
        tape: Option<&mut [PoseBlock]>,
    ) {
        let steps = substeps.len();
        if steps == 0 {
            return;
        }
        let tasks = motions.len().div_ceil(PARTICLES);
        let tapes: Vec<Option<&mut [PoseBlock]>> = match tape {
            Some(tape) => tape.chunks_mut(TASK * steps).map(Some).collect(),
            None => (0..tasks).map(|_| None).collect(),
        };
        let rows = means.par_chunks_mut(PARTICLES).zip(quats.par_chunks_mut(PARTICLES));
        motions.par_chunks(PARTICLES).zip(rows).zip(tapes).for_each(|((motions, (means, quats)), tape)| {
            self.roll_rows(motions, substeps, (means, quats), tape);
        });
    }

    /// Advances the rows of one task in place; `tape` receives the poses before every step, block by block.
    pub(crate) fn roll_rows(
        &self,
        motions: &[Motion<f32>],
        substeps: &[Substep<f64>],
        (means, quats): (&mut [Vec3], &mut [[f32; 4]]),
        mut tape: Option<&mut [PoseBlock]>,
    ) {
        let (run, steps) = (Run { rule: self.rule, substeps, steps_before: 0 }, substeps.len());
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

    /// Backward of [`Rollout::advance_taped`] with the same rule and motions: `d` are cotangents of positions and
    /// quaternions at the end. Adds to `d_motions`, one row per particle, and gives the cotangents of positions and
    /// quaternions at the start.
    pub fn adjoint(
        &self,
        motions: &[Motion<f32>],
        tape: &RollTape,
        d: &ParticleState,
        d_motions: &mut [Motion<f32>],
    ) -> ParticleState {
        let mut start = d.clone();
        let RollTape { substeps, poses } = tape;
        if substeps.is_empty() {
            return start;
        }
        let rows = start.means.par_chunks_mut(PARTICLES).zip(start.rotations.par_chunks_mut(PARTICLES));
        let given = motions.par_chunks(PARTICLES).zip(poses.par_chunks(TASK * substeps.len()));
        given.zip(d_motions.par_chunks_mut(PARTICLES)).zip(rows).for_each(|(((m, poses), d_m), rows)| {
            self.roll_rows_backward(m, (substeps, poses), rows, d_m);
        });
        start
    }

    /// Backward of [`Rollout::roll_rows`] over one step or more: cotangents go from the end to the start in place, those of
    /// the motions are added to `d_motions`.
    pub(crate) fn roll_rows_backward(
        &self,
        motions: &[Motion<f32>],
        (substeps, poses): (&[Substep<f64>], &[PoseBlock]),
        (means, rotations): (&mut [Vec3], &mut [[f32; 4]]),
        d_motions: &mut [Motion<f32>],
    ) {
        let run = Run { rule: self.rule, substeps, steps_before: 0 };
        let rows = means.chunks_mut(LANES).zip(rotations.chunks_mut(LANES));
        let given = motions.chunks(LANES).zip(poses.chunks(substeps.len()));
        for (((m, poses), d_m), (means, rotations)) in given.zip(d_motions.chunks_mut(LANES)).zip(rows) {
            let packed = blocks::pack_motions(m);
            let mut d = blocks::pack_poses(means, rotations, Vec3::ZERO);
            let grad = dispatch!(Level::new(), simd => blocks::roll_backward(simd, run, &packed, poses, &mut d));
            blocks::add_motions(&grad, d_m);
            blocks::set_poses(&d, means, rotations);
        }
    }
}

/// `⌈|span| / dt − 1e-6⌉`, at least one step for a span that is not empty; `dt` in the unit of time of `span`.
fn step_count(span: f64, dt: f64) -> usize {
    if span == 0.0 || span.is_nan() {
        return 0;
    }
    let count = if dt > 0.0 { (span.abs() / dt - LONGER).ceil() } else { 1.0 };
    cast::to_usize(count.clamp(1.0, MAX_STEPS))
}
