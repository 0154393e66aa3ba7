//! One layer's loss and its gradient, in `f32` for production and in `f64` as its reference: see [`crate::mrf`].
//!
//! Way back: each `j` gives to the one `i` where `c_ij` is largest (the first of equals); a row's `c` to all its `w`; the
//! smallest `d` of a row takes what dividing by it gives; a cosine outside of [−1, 1] by rounding gives nothing.

use gs_core::Real;
use gs_core::nn::gemm::{Mat, MatMut, Write, gemm};
use rayon::prelude::*;

/// Added to lengths before dividing.
const NORM_FLOOR: f64 = 1e-8;
/// Features shorter than this have no gradient.
const NO_LENGTH: f64 = 1e-6;
/// Rows of one parallel piece.
const ROWS: usize = 64;

/// Constants of the loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeadOptions {
    /// `h`: width of the comparison, above 0.
    pub bandwidth: f64,
    /// Added to the smallest distance before dividing by it, above 0.
    pub floor: f64,
}

impl Default for HeadOptions {
    fn default() -> Self {
        Self { bandwidth: 0.5, floor: 1e-5 }
    }
}

/// A number the loss can be computed in.
pub trait Number: Real + PartialOrd + Send + Sync {
    /// `e^self`.
    fn exp(self) -> Self;
    /// In `f64`.
    fn wide(self) -> f64;
    /// `a bᵀ` for `a: [rows, inner]`, `b: [columns, inner]`, into `out: [rows, columns]`.
    fn by_rows(a: &[Self], b: &[Self], inner: usize, out: &mut [Self]);
    /// `a b` for `a: [rows, inner]`, `b: [inner, columns]`, into `out: [rows, columns]`.
    fn by_columns(a: &[Self], b: &[Self], inner: usize, out: &mut [Self]);
}

impl Number for f32 {
    fn exp(self) -> Self {
        f32::exp(self)
    }
    fn wide(self) -> f64 {
        f64::from(self)
    }
    fn by_rows(a: &[f32], b: &[f32], inner: usize, out: &mut [f32]) {
        let (rows, columns) = (a.len() / inner, b.len() / inner);
        let (a, b) = (Mat::new(a, rows, inner), Mat::new(b, columns, inner).transposed());
        gemm(MatMut::new(out, rows, columns), a, b, Write::Set);
    }
    fn by_columns(a: &[f32], b: &[f32], inner: usize, out: &mut [f32]) {
        let (rows, columns) = (a.len() / inner, b.len() / inner);
        gemm(MatMut::new(out, rows, columns), Mat::new(a, rows, inner), Mat::new(b, inner, columns), Write::Set);
    }
}

impl Number for f64 {
    fn exp(self) -> Self {
        f64::exp(self)
    }
    fn wide(self) -> f64 {
        self
    }
    fn by_rows(a: &[f64], b: &[f64], inner: usize, out: &mut [f64]) {
        let columns = b.len() / inner;
        for (i, out) in out.iter_mut().enumerate() {
            let (a, b) = (&a[i / columns * inner..][..inner], &b[i % columns * inner..][..inner]);
            *out = a.iter().zip(b).map(|(a, b)| a * b).sum();
        }
    }
    fn by_columns(a: &[f64], b: &[f64], inner: usize, out: &mut [f64]) {
        let columns = b.len() / inner;
        for (i, out) in out.iter_mut().enumerate() {
            let a = &a[i / columns * inner..][..inner];
            *out = a.iter().zip(b[i % columns..].iter().step_by(columns)).map(|(a, b)| a * b).sum();
        }
    }
}

/// Centred rows of length 1, and their lengths before.
struct Units<T> {
    rows: Vec<T>,
    lengths: Vec<T>,
}

/// `X − m` with `m` the mean over channels of `about` at the same place, each row divided by its length.
fn units<T: Number>(x: &[T], about: &[T], channels: usize) -> Units<T> {
    let mut out = Units { rows: Vec::with_capacity(x.len()), lengths: Vec::with_capacity(x.len() / channels) };
    for (row, about) in x.chunks_exact(channels).zip(about.chunks_exact(channels)) {
        let mean = about.iter().map(|v| v.wide()).sum::<f64>() / channels as f64;
        let square = row.iter().map(|v| (v.wide() - mean).powi(2)).sum::<f64>();
        let scale = 1.0 / (square.sqrt() + NORM_FLOOR);
        out.rows.extend(row.iter().map(|v| v.lit((v.wide() - mean) * scale)));
        out.lengths.push(row[0].lit(square.sqrt()));
    }
    out
}

/// What a row `i` is divided by.
#[derive(Clone, Copy)]
struct RowStats<T> {
    /// `1/(min_j d_ij + floor)`.
    inverse: T,
    /// Where the minimum is.
    nearest: usize,
    /// `1/Σ_j w_ij`.
    share: T,
}

/// `(1 − s)/2`, within [0, 1].
fn distance<T: Number>(s: T) -> T {
    let (zero, one) = (s.lit(0.0), s.lit(1.0));
    ((one - s) * s.lit(0.5)).max(zero).min(one)
}

/// `w` of a distance.
fn weight<T: Number>(d: T, inverse: T, sharpness: T) -> T {
    ((d.lit(1.0) - d * inverse) * sharpness).exp()
}

fn stats<T: Number>(cosines: &[T], options: &HeadOptions) -> RowStats<T> {
    let mut nearest = 0;
    for (j, s) in cosines.iter().enumerate() {
        if distance(*s) < distance(cosines[nearest]) {
            nearest = j;
        }
    }
    let one = cosines[0].lit(1.0);
    let inverse = one / (distance(cosines[nearest]) + one.lit(options.floor));
    let sharpness = one.lit(1.0 / options.bandwidth);
    let sum: f64 = cosines.iter().map(|s| weight(distance(*s), inverse, sharpness).wide()).sum();
    RowStats { inverse, nearest, share: one.lit(1.0 / sum) }
}

/// The loss of features `x` against `y`, both `[places, channels]`, and its gradient with respect to `x` (empty unless asked
/// for). 0 for no places.
pub fn layer<T: Number>(x: &[T], y: &[T], channels: usize, options: &HeadOptions, with_grad: bool) -> (f64, Vec<T>) {
    if x.is_empty() {
        return (0.0, Vec::new());
    }
    let places = y.len() / channels;
    let (from, to) = (units(x, y, channels), units(y, y, channels));
    let mut cosines = vec![x[0].lit(0.0); places * places];
    let pieces = cosines.par_chunks_mut(ROWS * places).zip(from.rows.par_chunks(ROWS * channels));
    pieces.for_each(|(out, rows)| T::by_rows(rows, &to.rows, channels, out));
    let rows: Vec<RowStats<T>> = cosines.par_chunks(places).map(|row| stats(row, options)).collect();
    let best = largest(&cosines, &rows, options);
    let mean = best.iter().map(|(c, _)| c.wide()).sum::<f64>() / places as f64;
    let value = -mean.ln();
    if !with_grad {
        return (value, Vec::new());
    }
    let mut chosen: Vec<Vec<u32>> = vec![Vec::new(); places];
    best.iter().enumerate().for_each(|(j, (_, i))| chosen[*i as usize].push(j as u32));
    let d_c = x[0].lit(-1.0 / (places as f64 * mean));
    let each = cosines.par_chunks_mut(places).zip(&rows).zip(&chosen);
    each.for_each(|((row, stats), chosen)| row_backward(row, stats, chosen, d_c, options));
    let mut grad = vec![x[0].lit(0.0); x.len()];
    let pieces = grad.par_chunks_mut(ROWS * channels).zip(cosines.par_chunks(ROWS * places));
    pieces.for_each(|(out, rows)| T::by_columns(rows, &to.rows, places, out));
    for ((d, unit), length) in grad.chunks_exact_mut(channels).zip(from.rows.chunks_exact(channels)).zip(&from.lengths)
    {
        unit_backward(d, unit, *length);
    }
    (value, grad)
}

/// `max_i c_ij` and the first `i` that has it, for every `j`.
fn largest<T: Number>(cosines: &[T], rows: &[RowStats<T>], options: &HeadOptions) -> Vec<(T, u32)> {
    let places = rows.len();
    let nothing = cosines[0].lit(-1.0);
    let of_piece = |(piece, (cosines, rows)): (usize, (&[T], &[RowStats<T>]))| {
        let mut best = vec![(nothing, 0u32); places];
        for (k, (row, stats)) in cosines.chunks_exact(places).zip(rows).enumerate() {
            let sharpness = stats.inverse.lit(1.0 / options.bandwidth);
            for (best, s) in best.iter_mut().zip(row) {
                let c = weight(distance(*s), stats.inverse, sharpness) * stats.share;
                if c > best.0 {
                    *best = (c, (piece * ROWS + k) as u32);
                }
            }
        }
        best
    };
    let pieces = cosines.par_chunks(ROWS * places).zip(rows.par_chunks(ROWS)).enumerate();
    let mut pieces = pieces.map(of_piece).collect::<Vec<_>>().into_iter();
    let mut best = pieces.next().unwrap_or_default();
    for piece in pieces {
        best.iter_mut().zip(piece).filter(|(a, b)| b.0 > a.0).for_each(|(a, b)| *a = b);
    }
    best
}

/// Overwrites a row of cosines with their cotangents.
fn row_backward<T: Number>(row: &mut [T], stats: &RowStats<T>, chosen: &[u32], d_c: T, options: &HeadOptions) {
    let (zero, half, one) = (d_c.lit(0.0), d_c.lit(0.5), d_c.lit(1.0));
    if chosen.is_empty() {
        row.fill(zero);
        return;
    }
    let sharpness = d_c.lit(1.0 / options.bandwidth);
    let c = |s: T| weight(distance(s), stats.inverse, sharpness) * stats.share;
    let taken: f64 = chosen.iter().map(|j| c(row[*j as usize]).wide()).sum();
    let common = d_c * d_c.lit(taken);
    let mut d_least = 0.0f64;
    let mut chosen = chosen.iter().peekable();
    let mut d_nearest = zero;
    for (j, slot) in row.iter_mut().enumerate() {
        let s = *slot;
        let own = if chosen.next_if(|k| **k as usize == j).is_some() { d_c } else { zero };
        // dL/d d̃ = −(w/h) dL/dw, and c = w/Σw.
        let d_scaled = -(c(s) * sharpness) * (own - common);
        d_least -= (d_scaled * distance(s) * stats.inverse * stats.inverse).wide();
        let free = s >= -one && s <= one;
        let d_s = if free { -(half * d_scaled * stats.inverse) } else { zero };
        *slot = d_s;
        if j == stats.nearest && free {
            d_nearest = half;
        }
    }
    row[stats.nearest] = row[stats.nearest] - d_nearest * d_c.lit(d_least);
}

/// Pulls the cotangent of `v/(|v| + floor)` back to `v`, in place.
fn unit_backward<T: Number>(d: &mut [T], unit: &[T], length: T) {
    if length.wide() < NO_LENGTH {
        d.iter_mut().for_each(|v| *v = v.lit(0.0));
        return;
    }
    let whole = length.wide() + NORM_FLOOR;
    let along: f64 = d.iter().zip(unit).map(|(d, u)| d.wide() * u.wide()).sum();
    // unit = v/whole, so v̂ = unit · whole/length.
    let along = along * whole / length.wide();
    d.iter_mut().zip(unit).for_each(|(d, u)| *d = d.lit((d.wide() - u.wide() * along) / whole));
}
