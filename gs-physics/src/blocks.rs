//! Blocks of eight particles in SIMD lanes: memory layout of states and motions, and the loops over steps.
//!
//! A state is `(x − o, q, r)`, a motion its eighteen values; each value is a row of eight lanes. `r` is the rounding error
//! of `x − o` so far (Kahan), so that hundreds of steps round like a few. Particles do not interact, so results do not
//! depend on which of them share a block.

use crate::integrator::Integrator;
use crate::lanes::{LANES, Lanes};
use crate::step::{Substep, increment, step_backward};
use crate::twist::{MOTION, Motion};
use crate::vec3::{add, dot4, scale4, sub};
use fearless_simd::{Simd, SimdBase, f32x8};
use glam::Vec3;
use gs_core::Real;

/// Number of values in a state `(x − o, q, r)`.
const STATE: usize = 10;
/// Number of values in a pose `(x − o, q)`.
const POSE: usize = 7;
/// Steps after which quaternions are normalised to unit length.
const NORMALISE_INTERVAL: usize = 64;

/// `(x − o, q, r)` of eight particles.
pub(crate) type StateBlock = [[f32; LANES]; STATE];
/// `(x − o, q)` of eight particles, or their cotangents.
pub(crate) type PoseBlock = [[f32; LANES]; POSE];
/// The motions of eight particles.
pub(crate) type MotionBlock = [[f32; LANES]; MOTION];

/// Consecutive steps of one rule.
#[derive(Clone, Copy)]
pub(crate) struct Run<'a> {
    pub rule: Integrator,
    pub substeps: &'a [Substep<f64>],
    /// Steps since the start before these; they count towards [`NORMALISE_INTERVAL`].
    pub steps_before: usize,
}

/// Packs up to eight particles; unused lanes rest at the origin.
pub(crate) fn pack_states(means: &[Vec3], quats: &[[f32; 4]], origin: Vec3) -> StateBlock {
    let mut out = [[0.0; LANES]; STATE];
    out[..POSE].copy_from_slice(&pack_poses(means, quats, origin));
    out
}

/// As [`pack_states`], without the rounding errors.
pub(crate) fn pack_poses(means: &[Vec3], quats: &[[f32; 4]], origin: Vec3) -> PoseBlock {
    let mut out = [[0.0; LANES]; POSE];
    out[3] = [1.0; LANES];
    for (lane, (x, q)) in means.iter().zip(quats).enumerate() {
        let y = *x - origin;
        for (row, v) in out.iter_mut().zip([y.x, y.y, y.z, q[0], q[1], q[2], q[3]]) {
            row[lane] = v;
        }
    }
    out
}

/// Packs up to eight motions; unused lanes rest.
pub(crate) fn pack_motions(motions: &[Motion<f32>]) -> MotionBlock {
    let mut out = [[0.0; LANES]; MOTION];
    for (lane, m) in motions.iter().enumerate() {
        for (row, v) in out.iter_mut().zip(m.to_array()) {
            row[lane] = v;
        }
    }
    out
}

/// Adds a block of motions (cotangents) to up to eight rows.
pub(crate) fn add_motions(block: &MotionBlock, rows: &mut [Motion<f32>]) {
    for (lane, m) in rows.iter_mut().enumerate() {
        let mut values = m.to_array();
        for (v, row) in values.iter_mut().zip(block) {
            *v += row[lane];
        }
        *m = Motion::from_array(values);
    }
}

/// Displaces particles by the change of their relative positions, so one that rests keeps its bits.
pub(crate) fn unpack_states(start: &StateBlock, end: &StateBlock, means: &mut [Vec3], quats: &mut [[f32; 4]]) {
    for (lane, (x, q)) in means.iter_mut().zip(quats).enumerate() {
        unpack_lane(start, end, lane, *x, (x, q));
    }
}

/// As [`unpack_states`], for one lane, whose particle started at `from`.
pub(crate) fn unpack_lane(
    start: &StateBlock,
    end: &StateBlock,
    lane: usize,
    from: Vec3,
    (x, q): (&mut Vec3, &mut [f32; 4]),
) {
    *x = from + Vec3::from_array(std::array::from_fn(|c| (end[c][lane] - start[c][lane]) + end[POSE + c][lane]));
    *q = std::array::from_fn(|c| end[3 + c][lane]);
}

/// Writes a block's rows over up to eight rows.
pub(crate) fn set_poses(block: &PoseBlock, means: &mut [Vec3], quats: &mut [[f32; 4]]) {
    for (lane, (x, q)) in means.iter_mut().zip(quats).enumerate() {
        *x = Vec3::from_array(std::array::from_fn(|c| block[c][lane]));
        *q = std::array::from_fn(|c| block[3 + c][lane]);
    }
}

#[inline(always)]
fn load<S: Simd, const N: usize>(simd: S, rows: &[[f32; LANES]; N]) -> [Lanes<S>; N] {
    let mut out = [Lanes(f32x8::splat(simd, 0.0)); N];
    for (o, row) in out.iter_mut().zip(rows) {
        *o = Lanes(f32x8::load_array_ref(simd, row));
    }
    out
}

#[inline(always)]
fn store<S: Simd, const N: usize>(values: [Lanes<S>; N], rows: &mut [[f32; LANES]; N]) {
    for (v, row) in values.into_iter().zip(rows) {
        v.0.store_array(row);
    }
}

/// `q / |q|`; zero stays zero.
#[inline(always)]
fn unit<T: Real>(q: [T; 4]) -> [T; 4] {
    scale4(q, q[0].lit(1.0) / dot4(q, q).sqrt().max(q[0].lit(1e-18)))
}

/// Gradient of [`unit`] at `q`.
#[inline(always)]
fn unit_backward<T: Real>(q: [T; 4], d: [T; 4]) -> [T; 4] {
    let inverse = q[0].lit(1.0) / dot4(q, q).sqrt().max(q[0].lit(1e-18));
    let u = scale4(q, inverse);
    let along = dot4(u, d);
    let free = [d[0] - u[0] * along, d[1] - u[1] * along, d[2] - u[2] * along, d[3] - u[3] * along];
    scale4(free, inverse)
}

/// Whether quaternions are normalised after step `k`.
#[inline(always)]
fn normalises_after(k: usize) -> bool {
    (k + 1).is_multiple_of(NORMALISE_INTERVAL)
}

/// Rolls a block through all steps; `tape` receives the pose before every step.
#[inline(always)]
pub(crate) fn roll<S: Simd>(
    simd: S,
    run: Run<'_>,
    motions: &MotionBlock,
    state: &mut StateBlock,
    mut tape: Option<&mut [PoseBlock]>,
) {
    let m = Motion::from_array(load(simd, motions));
    let [x0, x1, x2, q0, q1, q2, q3, r0, r1, r2] = load(simd, state);
    let (mut x, mut q, mut compensation) = ([x0, x1, x2], [q0, q1, q2, q3], [r0, r1, r2]);
    for (k, substep) in run.substeps.iter().enumerate() {
        if let Some(tape) = &mut tape {
            store([x[0], x[1], x[2], q[0], q[1], q[2], q[3]], &mut tape[k]);
        }
        let (moved, rotated) = increment(run.rule, &m, &substep.of(x[0]), x, q);
        let moved = add(moved, compensation);
        let next = add(x, moved);
        compensation = sub(moved, sub(next, x));
        (x, q) = (next, rotated);
        if normalises_after(run.steps_before + k) {
            q = unit(q);
        }
    }
    store([x[0], x[1], x[2], q[0], q[1], q[2], q[3], compensation[0], compensation[1], compensation[2]], state);
}

/// Backward of [`roll`] along its tape: `cotangent` goes from the end to the start. Gives the cotangents of the motions.
#[inline(always)]
pub(crate) fn roll_backward<S: Simd>(
    simd: S,
    run: Run<'_>,
    motions: &MotionBlock,
    tape: &[PoseBlock],
    cotangent: &mut PoseBlock,
) -> MotionBlock {
    let m = Motion::from_array(load(simd, motions));
    let mut grad = Motion::from_array([Lanes(f32x8::splat(simd, 0.0)); MOTION]);
    let [x0, x1, x2, q0, q1, q2, q3] = load(simd, cotangent);
    let (mut lambda, mut mu) = ([x0, x1, x2], [q0, q1, q2, q3]);
    for (k, (substep, before)) in run.substeps.iter().zip(tape).enumerate().rev() {
        let [x0, x1, x2, q0, q1, q2, q3] = load(simd, before);
        let (x, q) = ([x0, x1, x2], [q0, q1, q2, q3]);
        let substep = substep.of(x0);
        if normalises_after(run.steps_before + k) {
            mu = unit_backward(increment(run.rule, &m, &substep, x, q).1, mu);
        }
        (lambda, mu) = step_backward(run.rule, &m, &substep, (x, q), (lambda, mu), &mut grad);
    }
    store([lambda[0], lambda[1], lambda[2], mu[0], mu[1], mu[2], mu[3]], cotangent);
    let mut out = [[0.0; LANES]; MOTION];
    store(grad.to_array(), &mut out);
    out
}
