//! Fully connected layer, `y = x Wᵀ + b`, for the rows of one block.
//!
//! ```text
//! y[r,o] = Σ_i x[r,i] W[o,i] + b[o]          W: [outputs, inputs], b: [outputs]
//! dx = dy W        dW = dyᵀ x        db = Σ_r dy[r,:]
//! ```
//! The input may come in pieces (columns `a..b` of `W` each), which serves concatenated inputs without copying them, and
//! a piece that is the same for all rows can be folded into the bias: `W[:, c] v` once instead of once per row
//! ([`Dense::fold_constant`], exact up to rounding).
//!
//! ```
//! use gs_core::nn::{Dense, DenseGrad, Init};
//!
//! let mut layer = Dense::new("head", 2, 1, Init::Zero, 0);
//! layer.weight.value = vec![2.0, -1.0];
//! let (x, mut y) = ([1.0, 3.0, 0.5, 0.0], [0.0; 2]); // two rows
//! layer.forward(&x, &mut y);
//! assert_eq!(y, [-1.0, 1.0]);
//! let (mut grad, mut dx) = (DenseGrad::default(), [0.0; 4]);
//! grad.reset(&layer);
//! layer.backward(&x, &[1.0, 1.0], Some(&mut dx), &mut grad);
//! assert_eq!((dx, grad.weight, grad.bias), ([2.0, -1.0, 2.0, -1.0], vec![1.5, 3.0], vec![2.0]));
//! ```

use super::gemm::{Mat, MatMut, Write, gemm};
use crate::{Param, Params, Rng};
use fearless_simd::{Level, Simd, dispatch};
use rayon::prelude::*;
use std::ops::Range;

/// A fully connected layer, `inputs` → `outputs` values per row.
#[derive(Clone, Debug, PartialEq)]
pub struct Dense {
    /// Weight `W`, `[outputs, inputs]`, row-major.
    pub weight: Param,
    /// Bias `b`, one value per output.
    pub bias: Param,
    inputs: usize,
    outputs: usize,
}

/// Initialisation of a layer's parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Init {
    /// Weight and bias uniform in `±1/√inputs` (the default of PyTorch's `Linear`).
    FanIn,
    /// Weight uniform in `±√(6 / (inputs + outputs))` (Glorot and Bengio 2010, Eq. 16), bias as [`Init::FanIn`].
    Xavier,
    /// All zero: the layer's output is zero until it is trained.
    Zero,
}

/// Gradient of a layer's parameters, summed over the rows of one chunk.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DenseGrad {
    /// Gradient of the weight, `[outputs, inputs]`.
    pub weight: Vec<f32>,
    /// Gradient of the bias, one value per output.
    pub bias: Vec<f32>,
}

impl DenseGrad {
    /// Sets this to the zero gradient of `layer`, reusing memory.
    pub fn reset(&mut self, layer: &Dense) {
        for (v, n) in [(&mut self.weight, layer.weight.len()), (&mut self.bias, layer.bias.len())] {
            v.clear();
            v.resize(n, 0.0);
        }
    }
}

impl Dense {
    /// A layer whose parameters are `{name}.weight` and `{name}.bias`, random by streams of these names.
    pub fn new(name: &str, inputs: usize, outputs: usize, init: Init, seed: u64) -> Self {
        let fan_in = 1.0 / (inputs.max(1) as f32).sqrt();
        let (w, b) = match init {
            Init::FanIn => (fan_in, fan_in),
            Init::Xavier => ((6.0 / (inputs + outputs).max(1) as f32).sqrt(), fan_in),
            Init::Zero => (0.0, 0.0),
        };
        let init = |what: &str, n: usize, bound: f32| {
            let name = format!("{name}.{what}");
            let mut rng = Rng::new(seed, &name, 0, 0);
            let value = (0..n).map(|_| if bound > 0.0 { rng.range(-bound, bound) } else { 0.0 }).collect();
            Param::shared(name, value)
        };
        Self { weight: init("weight", inputs * outputs, w), bias: init("bias", outputs, b), inputs, outputs }
    }

    /// Number of parameters of a layer, `(inputs + 1) · outputs`; the largest number where that is beyond it.
    pub fn count(inputs: usize, outputs: usize) -> u64 {
        (inputs as u64).saturating_add(1).saturating_mul(outputs as u64)
    }

    /// The concatenation of layers of the same inputs, as one layer: outputs of the first part come first.
    ///
    /// # Panics
    /// If a part does not take `inputs` values.
    pub fn stacked(name: &str, inputs: usize, parts: &[Self]) -> Self {
        assert!(parts.iter().all(|p| p.inputs == inputs), "stacked layers must take the same input");
        let join = |what: &str, part: &dyn Fn(&Self) -> &Param| {
            let value = parts.iter().flat_map(|p| part(p).value.iter().copied()).collect();
            Param::shared(format!("{name}.{what}"), value)
        };
        let outputs = parts.iter().map(|p| p.outputs).sum();
        Self { weight: join("weight", &|p| &p.weight), bias: join("bias", &|p| &p.bias), inputs, outputs }
    }

    /// Number of values in an input row.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Number of values in an output row.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// `y = x Wᵀ + b` for `x: [rows, inputs]`, `y: [rows, outputs]`.
    pub fn forward(&self, x: &[f32], y: &mut [f32]) {
        self.start(&self.bias.value, y);
        self.add_product(0..self.inputs, x, y);
    }

    /// `y = max(x Wᵀ + b, 0)`: bias and ReLU in one pass over `y`.
    pub fn forward_relu(&self, x: &[f32], y: &mut [f32]) {
        let rows = y.len() / self.outputs.max(1);
        let x = Mat::new(x, rows, self.inputs);
        gemm(MatMut::new(y, rows, self.outputs), x, self.columns(0..self.inputs).transposed(), Write::Set);
        dispatch!(Level::new(), simd => add_and_clip(simd, &self.bias.value, y));
    }

    /// Sets every row of `y` to `bias`: the layer's own, or one from [`Dense::fold_constant`].
    pub fn start(&self, bias: &[f32], y: &mut [f32]) {
        y.chunks_exact_mut(self.outputs.max(1)).for_each(|row| row.copy_from_slice(bias));
    }

    /// `y += x W[:, columns]ᵀ` for `x: [rows, columns.len()]`.
    pub fn add_product(&self, columns: Range<usize>, x: &[f32], y: &mut [f32]) {
        let rows = y.len() / self.outputs.max(1);
        let x = Mat::new(x, rows, columns.len());
        gemm(MatMut::new(y, rows, self.outputs), x, self.columns(columns).transposed(), Write::Add);
    }

    /// The bias that includes inputs equal in all rows: `bias = b + W[:, columns] v`, summed in `f64`.
    pub fn fold_constant(&self, columns: Range<usize>, v: &[f32], bias: &mut Vec<f32>) {
        bias.clear();
        bias.extend(self.bias.value.iter().zip(self.weight.value.chunks_exact(self.inputs.max(1))).map(|(b, row)| {
            row[columns.clone()].iter().zip(v).fold(f64::from(*b), |s, (w, v)| s + f64::from(*w) * f64::from(*v)) as f32
        }));
    }

    /// Backward of [`Dense::fold_constant`], once per step: adds `db ⊗ v` to `dW[:, columns]` and `W[:, columns]ᵀ db`
    /// to `d_v`; `db` is what this step added to the gradient of the bias.
    pub fn fold_constant_backward(&mut self, columns: Range<usize>, v: &[f32], db: &[f32], d_v: &mut [f32]) {
        let inputs = self.inputs.max(1);
        for (o, &g) in db.iter().enumerate() {
            let at = o * inputs;
            let row = columns.start + at..columns.end + at;
            for ((dw, w), (v, d_v)) in
                self.weight.grad[row.clone()].iter_mut().zip(&self.weight.value[row]).zip(v.iter().zip(d_v.iter_mut()))
            {
                *dw += g * v;
                *d_v += g * w;
            }
        }
    }

    /// Backward of [`Dense::forward`]: adds to `grad` and, where given, to `dx`.
    pub fn backward(&self, x: &[f32], dy: &[f32], dx: Option<&mut [f32]>, grad: &mut DenseGrad) {
        self.backward_bias(dy, grad);
        self.backward_weight(0..self.inputs, x, dy, grad);
        if let Some(dx) = dx {
            self.backward_input(0..self.inputs, dy, dx, Write::Add);
        }
    }

    /// Adds `Σ_r dy[r,:]` to the bias gradient.
    pub fn backward_bias(&self, dy: &[f32], grad: &mut DenseGrad) {
        dispatch!(Level::new(), simd => add_rows(simd, dy, &mut grad.bias));
    }

    /// Adds `dyᵀ x` to the given columns of the weight gradient.
    pub fn backward_weight(&self, columns: Range<usize>, x: &[f32], dy: &[f32], grad: &mut DenseGrad) {
        let rows = dy.len() / self.outputs.max(1);
        let (x, dy) = (Mat::new(x, rows, columns.len()), Mat::new(dy, rows, self.outputs));
        let dw = &mut grad.weight[columns.start..];
        gemm(MatMut::strided(dw, self.outputs, columns.len(), self.inputs), dy.transposed(), x, Write::Add);
    }

    /// `dx = dy W[:, columns]`, replacing or adding as `write` says.
    pub fn backward_input(&self, columns: Range<usize>, dy: &[f32], dx: &mut [f32], write: Write) {
        let rows = dy.len() / self.outputs.max(1);
        let dy = Mat::new(dy, rows, self.outputs);
        gemm(MatMut::new(dx, rows, columns.len()), dy, self.columns(columns), write);
    }

    /// Adds the chunks' gradients to the parameters, in the given order.
    pub fn add_grads<'a>(&mut self, chunks: impl Iterator<Item = &'a DenseGrad> + Clone + Sync + Send) {
        add_in_order(&mut self.weight.grad, chunks.clone().map(|g| g.weight.as_slice()));
        add_in_order(&mut self.bias.grad, chunks.map(|g| g.bias.as_slice()));
    }

    fn columns(&self, columns: Range<usize>) -> Mat<'_> {
        Mat::strided(&self.weight.value[columns.start..], self.outputs, columns.len(), self.inputs)
    }
}

impl Params for Dense {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        f(&self.weight);
        f(&self.bias);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        f(&mut self.weight);
        f(&mut self.bias);
    }
}

/// `total += part_0; total += part_1; …`, element by element in this order, in parallel over elements.
pub(super) fn add_in_order<'a>(total: &mut [f32], parts: impl Iterator<Item = &'a [f32]> + Clone + Sync + Send) {
    const PIECE: usize = 1 << 14;
    total.par_chunks_mut(PIECE).enumerate().for_each(|(i, piece)| {
        for part in parts.clone() {
            piece.iter_mut().zip(&part[i * PIECE..]).for_each(|(t, p)| *t += p);
        }
    });
}

/// ReLU in place, `y = max(y, 0)`.
pub fn relu(y: &mut [f32]) {
    dispatch!(Level::new(), simd => clip(simd, y));
}

/// Backward of [`relu`] in place, from its **output**: `dy = 0` where `y = 0` (the slope at 0 is 0).
pub fn relu_backward(y: &[f32], dy: &mut [f32]) {
    dispatch!(Level::new(), simd => mask(simd, y, dy));
}

/// `y ← max(y, slope · y)` in place, for slopes in 0 to 1: a unit that is never above 0 still has a gradient (Maas et al. 2013).
pub fn leaky_relu(y: &mut [f32], slope: f32) {
    dispatch!(Level::new(), simd => bend(simd, y, slope));
}

/// Backward of [`leaky_relu`] in place, from its **output** (the slope at 0 is `slope`).
pub fn leaky_relu_backward(y: &[f32], slope: f32, dy: &mut [f32]) {
    dispatch!(Level::new(), simd => lean(simd, y, slope, dy));
}

// Plain loops: each is compiled once per instruction set, at the width of its registers.

#[inline(always)]
fn clip<S: Simd>(_: S, y: &mut [f32]) {
    y.iter_mut().for_each(|v| *v = v.max(0.0));
}

#[inline(always)]
fn bend<S: Simd>(_: S, y: &mut [f32], slope: f32) {
    y.iter_mut().for_each(|v| *v = v.max(slope * *v));
}

#[inline(always)]
fn lean<S: Simd>(_: S, y: &[f32], slope: f32, dy: &mut [f32]) {
    dy.iter_mut().zip(y).for_each(|(d, y)| *d = if *y > 0.0 { *d } else { slope * *d });
}

#[inline(always)]
fn mask<S: Simd>(_: S, y: &[f32], dy: &mut [f32]) {
    dy.iter_mut().zip(y).for_each(|(d, y)| *d = if *y > 0.0 { *d } else { 0.0 });
}

/// `y[r,:] = max(y[r,:] + bias, 0)`.
#[inline(always)]
fn add_and_clip<S: Simd>(_: S, bias: &[f32], y: &mut [f32]) {
    for row in y.chunks_exact_mut(bias.len().max(1)) {
        row.iter_mut().zip(bias).for_each(|(v, b)| *v = (*v + b).max(0.0));
    }
}

/// Column sums: `sum += Σ_r rows[r,:]`.
#[inline(always)]
fn add_rows<S: Simd>(_: S, rows: &[f32], sum: &mut [f32]) {
    for row in rows.chunks_exact(sum.len().max(1)) {
        sum.iter_mut().zip(row).for_each(|(s, d)| *s += d);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest |f32 − f64| relative to 1 + |f64|: a dot product of ≤ 33 terms of order one.
    const TOLERANCE: f64 = 2e-6;

    fn random(n: usize, row: u64) -> Vec<f32> {
        let mut rng = Rng::new(3, "dense", 0, row);
        (0..n).map(|_| rng.normal()).collect()
    }

    /// `Σ weight_y · y` with `y = x Wᵀ + b`, in plain f64 loops.
    fn reference(x: &[f64], w: &[f64], b: &[f64], weight_y: &[f64]) -> f64 {
        let (inputs, outputs) = (w.len() / b.len(), b.len());
        let mut loss = 0.0;
        for (row, weight) in x.chunks(inputs).zip(weight_y.chunks(outputs)) {
            for o in 0..outputs {
                let y: f64 = row.iter().zip(&w[o * inputs..]).map(|(x, w)| x * w).sum::<f64>() + b[o];
                loss += weight[o] * y;
            }
        }
        loss
    }

    fn wide(v: &[f32]) -> Vec<f64> {
        v.iter().map(|&v| f64::from(v)).collect()
    }

    fn close(got: &[f32], want: &[f64], what: &str) {
        for (i, (g, w)) in got.iter().zip(want).enumerate() {
            assert!((f64::from(*g) - w).abs() <= TOLERANCE * 10.0 * (1.0 + w.abs()), "{what}[{i}]: {g} against {w}");
        }
    }

    /// The loss is linear in each argument, so a central difference of the f64 loops is exact up to rounding.
    fn difference(v: &[f64], loss: &dyn Fn(&[f64]) -> f64) -> Vec<f64> {
        let mut v = v.to_vec();
        (0..v.len())
            .map(|i| {
                let at = v[i];
                v[i] = at + 0.5;
                let hi = loss(&v);
                v[i] = at - 0.5;
                let lo = loss(&v);
                v[i] = at;
                hi - lo
            })
            .collect()
    }

    #[test]
    fn gradients_match_the_f64_loops() {
        for (case, (rows, inputs, outputs)) in
            [(0, 3, 2), (1, 1, 1), (15, 7, 3), (16, 16, 16), (17, 33, 5)].into_iter().enumerate()
        {
            let layer = Dense::new("t", inputs, outputs, Init::FanIn, case as u64);
            let (x, dy) = (random(rows * inputs, 1), random(rows * outputs, 2));
            let (mut y, mut dx, mut grad) = (vec![0.0; dy.len()], vec![0.0; x.len()], DenseGrad::default());
            layer.forward(&x, &mut y);
            grad.reset(&layer);
            layer.backward(&x, &dy, Some(&mut dx), &mut grad);
            let (x, w, b, dy) = (wide(&x), wide(&layer.weight.value), wide(&layer.bias.value), wide(&dy));
            let loss: f64 = y.iter().zip(&dy).map(|(y, d)| f64::from(*y) * d).sum();
            assert!((loss - reference(&x, &w, &b, &dy)).abs() < 1e-4);
            close(&dx, &difference(&x, &|x| reference(x, &w, &b, &dy)), "dx");
            close(&grad.weight, &difference(&w, &|w| reference(&x, w, &b, &dy)), "dW");
            close(&grad.bias, &difference(&b, &|b| reference(&x, &w, b, &dy)), "db");
        }
    }

    #[test]
    fn constant_inputs_fold_into_the_bias() {
        let (rows, varying, constant) = (9, 5, 4);
        let mut layer = Dense::new("t", varying + constant, 6, Init::FanIn, 1);
        let (x, v, dy) = (random(rows * varying, 1), random(constant, 2), random(rows * 6, 3));
        let full: Vec<f32> = x.chunks(varying).flat_map(|row| row.iter().chain(&v).copied()).collect();
        let (mut plain, mut folded, mut bias) = (vec![0.0; dy.len()], vec![0.0; dy.len()], Vec::new());
        layer.forward(&full, &mut plain);
        layer.fold_constant(varying..varying + constant, &v, &mut bias);
        layer.start(&bias, &mut folded);
        layer.add_product(0..varying, &x, &mut folded);
        close(&folded, &wide(&plain), "y");

        let (mut whole, mut parts, mut d_full) = (DenseGrad::default(), DenseGrad::default(), vec![0.0; full.len()]);
        whole.reset(&layer);
        parts.reset(&layer);
        layer.backward(&full, &dy, Some(&mut d_full), &mut whole);
        layer.backward_bias(&dy, &mut parts);
        layer.backward_weight(0..varying, &x, &dy, &mut parts);
        let mut d_v = vec![0.0; constant];
        layer.add_grads(std::iter::once(&parts));
        layer.fold_constant_backward(varying..varying + constant, &v, &parts.bias, &mut d_v);
        close(&layer.weight.grad, &wide(&whole.weight), "dW");
        close(&layer.bias.grad, &wide(&whole.bias), "db");
        let want: Vec<f64> = (0..constant)
            .map(|c| (0..rows).map(|r| f64::from(d_full[r * (varying + constant) + varying + c])).sum())
            .collect();
        close(&d_v, &want, "dv");
    }

    #[test]
    fn initial_values_are_bounded_and_reproducible() {
        let bound = |p: &Param| p.value.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        let fan = Dense::new("a", 64, 32, Init::FanIn, 7);
        assert!(bound(&fan.weight) <= 0.125 && bound(&fan.weight) > 0.12 && bound(&fan.bias) <= 0.125);
        let xavier = Dense::new("a", 64, 32, Init::Xavier, 7);
        assert!(bound(&xavier.weight) <= 0.25 && bound(&xavier.weight) > 0.24 && bound(&xavier.bias) <= 0.125);
        assert_eq!(bound(&Dense::new("a", 64, 32, Init::Zero, 7).weight), 0.0);
        assert_eq!(fan, Dense::new("a", 64, 32, Init::FanIn, 7));
        assert_ne!(fan.weight.value, Dense::new("a", 64, 32, Init::FanIn, 8).weight.value);
    }

    #[test]
    fn relu_backward_is_zero_where_the_output_is() {
        let mut y = [-1.0, 0.0, 2.0];
        relu(&mut y);
        assert_eq!(y, [0.0, 0.0, 2.0]);
        let mut dy = [3.0, 4.0, 5.0];
        relu_backward(&y, &mut dy);
        assert_eq!(dy, [0.0, 0.0, 5.0]);
    }

    #[test]
    fn leaky_relu_keeps_a_slope_below_zero() {
        let mut y = [-2.0, 0.0, 2.0];
        leaky_relu(&mut y, 0.25);
        assert_eq!(y, [-0.5, 0.0, 2.0]);
        let mut dy = [4.0, 4.0, 5.0];
        leaky_relu_backward(&y, 0.25, &mut dy);
        assert_eq!(dy, [1.0, 1.0, 5.0]);
    }
}
