//! The loss of one layer of features and its gradient, in `f32` for training and in `f64` as the reference of the tests. The
//! equations stand in [`crate::mrf`].
//!
//! Backward: the cotangent of column `j` goes to the one `i` where `c_ij` is largest (the first of equals), from `c` to all
//! `w` of its row, and from `d̃` also to the smallest `d` of its row. A cosine that rounding put outside [−1, 1] has no
//! gradient.
//!
//! ```
//! use gs_metrics::mrf::layer::{LayerOptions, layer_loss};
//! // Two patches of three channels. Compared with themselves every patch is found: the loss vanishes.
//! let y = [1.0, 0.0, -1.0, 0.0, 1.0, -1.0];
//! assert!(layer_loss(&y, &y, 3, &LayerOptions::default(), false).0.abs() < 1e-12);
//! // The first patch twice: the second one is found by none, half of the best c are 0.
//! let x = [1.0, 0.0, -1.0, 1.0, 0.0, -1.0];
//! assert!((layer_loss(&x, &y, 3, &LayerOptions::default(), false).0 - 2f64.ln()).abs() < 1e-12);
//! ```

use gs_core::nn::gemm::{Mat, MatMut, Write, gemm};
use gs_core::{Real, cast};
use rayon::prelude::*;

/// Added to norms before dividing.
const NORM_EPSILON: f64 = 1e-8;
/// Features whose norm is below this have no gradient.
const MIN_NORM: f64 = 1e-6;
/// Rows of one parallel task.
const ROWS: usize = 64;

/// Constants of the loss of one layer; the defaults are the published ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LayerOptions {
    /// `h`, above 0: a smaller one sharpens the choice of the nearest patch. Default ½.
    pub bandwidth: f64,
    /// Added to the smallest distance before dividing by it, above 0. Default 1e-5.
    pub epsilon: f64,
}

impl Default for LayerOptions {
    fn default() -> Self {
        Self { bandwidth: 0.5, epsilon: 1e-5 }
    }
}

/// The scalar types of [`layer_loss`]: `f32` and `f64`.
pub trait Scalar: Real + PartialOrd + Send + Sync {
    /// `e` to the power of this value.
    fn exp(self) -> Self;
    /// This value in `f64`, for sums.
    fn to_f64(self) -> f64;
    /// `a bᵀ` for `a: [rows, inner]`, `b: [columns, inner]`, into `out: [rows, columns]`.
    fn times_transposed(a: &[Self], b: &[Self], inner: usize, out: &mut [Self]);
    /// `a b` for `a: [rows, inner]`, `b: [inner, columns]`, into `out: [rows, columns]`.
    fn times(a: &[Self], b: &[Self], inner: usize, out: &mut [Self]);
}

impl Scalar for f32 {
    fn exp(self) -> Self {
        f32::exp(self)
    }
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
    fn times_transposed(a: &[f32], b: &[f32], inner: usize, out: &mut [f32]) {
        let (rows, columns) = (a.len() / inner, b.len() / inner);
        let (a, b) = (Mat::new(a, rows, inner), Mat::new(b, columns, inner).transposed());
        gemm(MatMut::new(out, rows, columns), a, b, Write::Set);
    }
    fn times(a: &[f32], b: &[f32], inner: usize, out: &mut [f32]) {
        let (rows, columns) = (a.len() / inner, b.len() / inner);
        gemm(MatMut::new(out, rows, columns), Mat::new(a, rows, inner), Mat::new(b, inner, columns), Write::Set);
    }
}

impl Scalar for f64 {
    fn exp(self) -> Self {
        f64::exp(self)
    }
    fn to_f64(self) -> f64 {
        self
    }
    fn times_transposed(a: &[f64], b: &[f64], inner: usize, out: &mut [f64]) {
        let columns = b.len() / inner;
        for (i, out) in out.iter_mut().enumerate() {
            let (a, b) = (&a[i / columns * inner..][..inner], &b[i % columns * inner..][..inner]);
            *out = a.iter().zip(b).map(|(a, b)| a * b).sum();
        }
    }
    fn times(a: &[f64], b: &[f64], inner: usize, out: &mut [f64]) {
        let columns = b.len() / inner;
        for (i, out) in out.iter_mut().enumerate() {
            let a = &a[i / columns * inner..][..inner];
            *out = a.iter().zip(b[i % columns..].iter().step_by(columns)).map(|(a, b)| a * b).sum();
        }
    }
}

/// Centred rows of norm 1, `[places, channels]`, and their norms before that.
struct Units<T> {
    rows: Vec<T>,
    norms: Vec<T>,
}

/// `X − m` with `m` the mean over channels of `about` at the same place, each row divided by its norm.
fn units<T: Scalar>(x: &[T], about: &[T], channels: usize) -> Units<T> {
    let mut out = Units { rows: Vec::with_capacity(x.len()), norms: Vec::with_capacity(x.len() / channels) };
    for (row, about) in x.chunks_exact(channels).zip(about.chunks_exact(channels)) {
        let mean = about.iter().map(|v| v.to_f64()).sum::<f64>() / channels as f64;
        let square = row.iter().map(|v| (v.to_f64() - mean).powi(2)).sum::<f64>();
        let scale = 1.0 / (square.sqrt() + NORM_EPSILON);
        out.rows.extend(row.iter().map(|v| v.lit((v.to_f64() - mean) * scale)));
        out.norms.push(row[0].lit(square.sqrt()));
    }
    out
}

/// What the distances and the weights of row `i` are divided by.
#[derive(Clone, Copy)]
struct RowStats<T> {
    /// `1/(min_j d_ij + epsilon)`.
    inverse: T,
    /// The `j` of that minimum.
    nearest: usize,
    /// `1/Σ_j w_ij`.
    inverse_sum: T,
}

/// `d = (1 − s)/2` of a cosine, clamped to [0, 1].
fn distance<T: Scalar>(s: T) -> T {
    let (zero, one) = (s.lit(0.0), s.lit(1.0));
    ((one - s) * s.lit(0.5)).max(zero).min(one)
}

/// `w` of a distance; `sharpness` is `1/h`.
fn weight<T: Scalar>(d: T, inverse: T, sharpness: T) -> T {
    ((d.lit(1.0) - d * inverse) * sharpness).exp()
}

fn stats<T: Scalar>(cosines: &[T], options: &LayerOptions) -> RowStats<T> {
    let mut nearest = 0;
    for (j, s) in cosines.iter().enumerate() {
        if distance(*s) < distance(cosines[nearest]) {
            nearest = j;
        }
    }
    let one = cosines[0].lit(1.0);
    let inverse = one / (distance(cosines[nearest]) + one.lit(options.epsilon));
    let sharpness = one.lit(1.0 / options.bandwidth);
    let sum: f64 = cosines.iter().map(|s| weight(distance(*s), inverse, sharpness).to_f64()).sum();
    RowStats { inverse, nearest, inverse_sum: one.lit(1.0 / sum) }
}

/// The loss of features `x` against `y`, both `[places, channels]`, and its gradient with respect to `x`, `[places, channels]`
/// (empty without `with_grad`). 0 without places.
pub fn layer_loss<T: Scalar>(
    x: &[T],
    y: &[T],
    channels: usize,
    options: &LayerOptions,
    with_grad: bool,
) -> (f64, Vec<T>) {
    if x.is_empty() {
        return (0.0, Vec::new());
    }
    let places = y.len() / channels;
    let (from, to) = (units(x, y, channels), units(y, y, channels));
    let mut cosines = vec![x[0].lit(0.0); places * places];
    let tasks = cosines.par_chunks_mut(ROWS * places).zip(from.rows.par_chunks(ROWS * channels));
    tasks.for_each(|(out, rows)| T::times_transposed(rows, &to.rows, channels, out));
    let rows: Vec<RowStats<T>> = cosines.par_chunks(places).map(|row| stats(row, options)).collect();
    let best = largest(&cosines, &rows, options);
    let mean = best.iter().map(|(c, _)| c.to_f64()).sum::<f64>() / places as f64;
    let value = -mean.ln();
    if !with_grad {
        return (value, Vec::new());
    }
    let mut columns: Vec<Vec<u32>> = vec![Vec::new(); places];
    best.iter().enumerate().for_each(|(j, (_, i))| columns[*i as usize].push(cast::to_u32(j)));
    let d_c = x[0].lit(-1.0 / (places as f64 * mean));
    let each = cosines.par_chunks_mut(places).zip(&rows).zip(&columns);
    each.for_each(|((row, stats), columns)| row_backward(row, stats, columns, d_c, options));
    let mut grad = vec![x[0].lit(0.0); x.len()];
    let tasks = grad.par_chunks_mut(ROWS * channels).zip(cosines.par_chunks(ROWS * places));
    tasks.for_each(|(out, rows)| T::times(rows, &to.rows, places, out));
    for ((d, unit), norm) in grad.chunks_exact_mut(channels).zip(from.rows.chunks_exact(channels)).zip(&from.norms) {
        unit_backward(d, unit, *norm);
    }
    (value, grad)
}

/// `max_i c_ij` and the first `i` that has it, for every `j`.
fn largest<T: Scalar>(cosines: &[T], rows: &[RowStats<T>], options: &LayerOptions) -> Vec<(T, u32)> {
    let places = rows.len();
    let below_all = cosines[0].lit(-1.0);
    let of_task = |(task, (cosines, rows)): (usize, (&[T], &[RowStats<T>]))| {
        let mut best = vec![(below_all, 0u32); places];
        for (k, (row, stats)) in cosines.chunks_exact(places).zip(rows).enumerate() {
            let sharpness = stats.inverse.lit(1.0 / options.bandwidth);
            for (best, s) in best.iter_mut().zip(row) {
                let c = weight(distance(*s), stats.inverse, sharpness) * stats.inverse_sum;
                if c > best.0 {
                    *best = (c, cast::to_u32(task * ROWS + k));
                }
            }
        }
        best
    };
    let tasks = cosines.par_chunks(ROWS * places).zip(rows.par_chunks(ROWS)).enumerate();
    let mut tasks = tasks.map(of_task).collect::<Vec<_>>().into_iter();
    let mut best = tasks.next().unwrap_or_default();
    for task in tasks {
        best.iter_mut().zip(task).filter(|(a, b)| b.0 > a.0).for_each(|(a, b)| *a = b);
    }
    best
}

/// Overwrites a row of cosines with their cotangents; `columns` are the `j` for which this row has the largest `c`, ascending.
fn row_backward<T: Scalar>(row: &mut [T], stats: &RowStats<T>, columns: &[u32], d_c: T, options: &LayerOptions) {
    let (zero, half, one) = (d_c.lit(0.0), d_c.lit(0.5), d_c.lit(1.0));
    if columns.is_empty() {
        row.fill(zero);
        return;
    }
    let sharpness = d_c.lit(1.0 / options.bandwidth);
    let c = |s: T| weight(distance(s), stats.inverse, sharpness) * stats.inverse_sum;
    let sum: f64 = columns.iter().map(|j| c(row[*j as usize]).to_f64()).sum();
    let common = d_c * d_c.lit(sum);
    let mut d_min = 0.0f64;
    let mut columns = columns.iter().peekable();
    let mut d_nearest = zero;
    for (j, slot) in row.iter_mut().enumerate() {
        let s = *slot;
        let own = if columns.next_if(|k| **k as usize == j).is_some() { d_c } else { zero };
        // dL/d d̃ = −(w/h) dL/dw, and c = w/Σw.
        let d_scaled = -(c(s) * sharpness) * (own - common);
        d_min -= (d_scaled * distance(s) * stats.inverse * stats.inverse).to_f64();
        let inside = s >= -one && s <= one;
        let d_s = if inside { -(half * d_scaled * stats.inverse) } else { zero };
        *slot = d_s;
        if j == stats.nearest && inside {
            d_nearest = half;
        }
    }
    row[stats.nearest] = row[stats.nearest] - d_nearest * d_c.lit(d_min);
}

/// Backward of `v/(|v| + NORM_EPSILON)`, in place; `norm` is `|v|`.
fn unit_backward<T: Scalar>(d: &mut [T], unit: &[T], norm: T) {
    if norm.to_f64() < MIN_NORM {
        d.iter_mut().for_each(|v| *v = v.lit(0.0));
        return;
    }
    let divisor = norm.to_f64() + NORM_EPSILON;
    let along: f64 = d.iter().zip(unit).map(|(d, u)| d.to_f64() * u.to_f64()).sum();
    // unit = v/divisor, so v/|v| = unit · divisor/|v|.
    let along = along * divisor / norm.to_f64();
    d.iter_mut().zip(unit).for_each(|(d, u)| *d = d.lit((d.to_f64() - u.to_f64() * along) / divisor));
}
