//! The update of a stretch of one block: all of its values, or those that have some gradient.

use super::Factors;
use fearless_simd::{Level, Simd, dispatch};

/// Values of a sparse shared block that are looked at together.
const RUN: usize = 16;

/// A stretch of one block.
pub(super) struct Piece<'a> {
    pub(super) value: &'a mut [f32],
    pub(super) m: &'a mut [f32],
    pub(super) v: &'a mut [f32],
    pub(super) grad: &'a mut [f32],
}

impl Piece<'_> {
    /// Every value, compiled for the instruction set of this machine.
    pub(super) fn all(self, level: Level, f: &Factors) {
        dispatch!(level, simd => update_all(simd, self.value, self.m, self.v, self.grad, f));
    }

    /// Only values with some gradient.
    pub(super) fn touched(self, level: Level, f: &Factors) {
        dispatch!(level, simd => update_touched(simd, self.value, self.m, self.v, self.grad, f));
    }

    /// Only rows with some gradient.
    pub(super) fn visible(self, level: Level, f: &Factors, width: usize) {
        dispatch!(level, simd => update_visible(simd, self.value, self.m, self.v, self.grad, f, width));
    }

    /// Row by row, leaving out those with a gradient that is not finite. Gives their number and the first.
    pub(super) fn careful(self, f: &Factors, width: usize, sparse: bool) -> (u32, Option<u32>) {
        let (mut count, mut first) = (0, None);
        let width = width.min(self.grad.len());
        for (r, at) in (0..self.grad.len()).step_by(width).enumerate() {
            let row = at..(at + width).min(self.grad.len());
            let grad = &mut self.grad[row.clone()];
            if !grad.iter().all(|g| (g * g).is_finite()) {
                count += 1;
                first = first.or(Some(r as u32));
            } else if !(sparse && grad.iter().all(|&g| g == 0.0)) {
                update_row(&mut self.value[row.clone()], &mut self.m[row.clone()], &mut self.v[row], grad, f);
            }
            grad.fill(0.0);
        }
        (count, first)
    }
}

/// Whether every gradient and its square is finite.
pub(super) fn all_finite(level: Level, grad: &[f32]) -> bool {
    dispatch!(level, simd => all_finite_in(simd, grad))
}

/// `g² · 0` is NaN exactly where `g²` is not finite; the sum keeps it. A second moment would keep the square for ever.
#[inline(always)]
fn all_finite_in<S: Simd>(_simd: S, grad: &[f32]) -> bool {
    let mut lanes = [0.0f32; 16];
    let (chunks, tail) = grad.as_chunks::<16>();
    for chunk in chunks {
        for (l, g) in lanes.iter_mut().zip(chunk) {
            *l += g * g * 0.0;
        }
    }
    lanes.iter().chain(tail).all(|v| (v * v).is_finite())
}

#[inline(always)]
fn update_all<S: Simd>(_simd: S, value: &mut [f32], m: &mut [f32], v: &mut [f32], grad: &mut [f32], f: &Factors) {
    update_row(value, m, v, grad, f);
    grad.fill(0.0);
}

/// Values one by one; runs without any gradient cost one look.
#[inline(always)]
fn update_touched<S: Simd>(_simd: S, value: &mut [f32], m: &mut [f32], v: &mut [f32], grad: &mut [f32], f: &Factors) {
    let ((values, value), (ms, m)) = (value.as_chunks_mut::<RUN>(), m.as_chunks_mut::<RUN>());
    let ((vs, v), (grads, grad)) = (v.as_chunks_mut::<RUN>(), grad.as_chunks_mut::<RUN>());
    for (((value, m), v), grad) in values.iter_mut().zip(ms).zip(vs).zip(grads) {
        // Whole runs, so that the choices below become masked lanes.
        touch(value, m, v, grad, f);
    }
    touch(value, m, v, grad, f);
}

#[inline(always)]
fn touch(value: &mut [f32], m: &mut [f32], v: &mut [f32], grad: &mut [f32], f: &Factors) {
    if all_zero(grad) {
        return;
    }
    for (((p, m), v), g) in value.iter_mut().zip(m).zip(v).zip(grad) {
        let (mut p2, mut m2, mut v2) = (*p, *m, *v);
        update_value(&mut p2, &mut m2, &mut v2, *g, f);
        let rests = *g == 0.0;
        *p = if rests { *p } else { p2 };
        *m = if rests { *m } else { m2 };
        *v = if rests { *v } else { v2 };
        *g = 0.0;
    }
}

#[inline(always)]
fn update_visible<S: Simd>(
    _simd: S,
    value: &mut [f32],
    m: &mut [f32],
    v: &mut [f32],
    grad: &mut [f32],
    f: &Factors,
    width: usize,
) {
    let rows = value.chunks_exact_mut(width).zip(m.chunks_exact_mut(width));
    for ((value, m), (v, grad)) in rows.zip(v.chunks_exact_mut(width).zip(grad.chunks_exact_mut(width))) {
        if !all_zero(grad) {
            update_row(value, m, v, grad, f);
            grad.fill(0.0);
        }
    }
}

#[inline(always)]
fn update_row(value: &mut [f32], m: &mut [f32], v: &mut [f32], grad: &[f32], f: &Factors) {
    for (((p, m), v), g) in value.iter_mut().zip(m).zip(v).zip(grad) {
        update_value(p, m, v, *g, f);
    }
}

#[inline(always)]
fn update_value(p: &mut f32, m: &mut f32, v: &mut f32, g: f32, f: &Factors) {
    *m = f.beta1 * *m + (1.0 - f.beta1) * g;
    *v = f.beta2 * *v + (1.0 - f.beta2) * (g * g);
    *p = *p * f.keep - f.rate * *m / (v.sqrt() * f.root + f.eps);
}

/// All bits but the sign are zero.
#[inline(always)]
fn all_zero(grad: &[f32]) -> bool {
    grad.iter().fold(0, |bits, g| bits | (g.to_bits() << 1)) == 0
}
