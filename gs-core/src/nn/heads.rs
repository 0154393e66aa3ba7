//! Several two-layer networks on one input, their first layers computed as one.
//!
//! ```text
//! g = relu(W₁ x + b₁)                 W₁: the heads' first layers stacked, [heads · width, inputs]
//! y_h = W₂ₕ g_h + b₂ₕ                 g_h: columns h·width … (h+1)·width of g
//! ```
//! One wide product instead of several narrow ones: `x` is read once and its cotangent is written once. Works on the
//! rows of one block.
//!
//! ```
//! use gs_core::nn::{Heads, HeadsTape, Init};
//!
//! let heads = Heads::new("deform", [8, 32], &[("means", 3), ("quats", 4)], Init::Zero, 1);
//! let mut tape = HeadsTape::default();
//! heads.forward(&[0.5; 2 * 8], &mut tape); // two rows
//! assert_eq!((tape.out[0].len(), tape.out[1].len()), (2 * 3, 2 * 4));
//! ```

use super::dense::{Dense, DenseGrad, Init, relu_backward};
use super::gemm::{Mat, MatMut, Write, gemm};
use super::mlp::Mlp;
use crate::{Param, Params};

/// Networks `inputs → width → outputs` that share their input.
#[derive(Clone, Debug, PartialEq)]
pub struct Heads {
    /// The heads' first layers, stacked: head `h` owns outputs `h·width … (h+1)·width`.
    first: Dense,
    /// The last layer of each head.
    last: Vec<Dense>,
    width: usize,
}

/// Intermediate values of one block, reused between steps.
#[derive(Clone, Debug, Default)]
pub struct HeadsTape {
    /// `g`, `[rows, heads · width]`.
    hidden: Vec<f32>,
    /// Output of each head, `[rows, outputs]`.
    pub out: Vec<Vec<f32>>,
    /// Cotangents of `out`, same shape: the caller fills them in before [`Heads::backward`].
    pub d_out: Vec<Vec<f32>>,
}

/// Gradient of all layers, summed over the rows of one chunk, and scratch.
#[derive(Clone, Debug, Default)]
pub struct HeadsGrad {
    first: DenseGrad,
    last: Vec<DenseGrad>,
    /// Cotangent of `g` of the current block.
    d_hidden: Vec<f32>,
}

impl Heads {
    /// Heads of the given names and numbers of outputs. First layers are initialised Xavier-uniform, each as a layer of
    /// its own, last layers by `last`. Parameters: `{name}.hidden.weight`, `{name}.hidden.bias`, then `{name}.{head}.weight`, `{name}.{head}.bias`.
    pub fn new(name: &str, [inputs, width]: [usize; 2], heads: &[(&str, usize)], last: Init, seed: u64) -> Self {
        let parts: Vec<Dense> = heads
            .iter()
            .map(|(head, _)| Dense::new(&format!("{name}.{head}.0"), inputs, width, Init::Xavier, seed))
            .collect();
        let layer =
            |(head, outputs): &(&str, usize)| Dense::new(&format!("{name}.{head}"), width, *outputs, last, seed);
        Self {
            first: Dense::stacked(&format!("{name}.hidden"), inputs, &parts),
            last: heads.iter().map(layer).collect(),
            width,
        }
    }

    /// Number of parameters of such heads; the largest number where that is beyond it.
    pub fn count([inputs, width]: [usize; 2], heads: &[(&str, usize)]) -> u64 {
        heads.iter().fold(0, |sum, &(_, outputs)| sum.saturating_add(Mlp::count(&[inputs, width, outputs])))
    }

    /// Forward of the block `x: [rows, inputs]`; results are in `tape.out`.
    pub fn forward(&self, x: &[f32], tape: &mut HeadsTape) {
        let rows = x.len() / self.first.inputs().max(1);
        let stride = self.first.outputs();
        tape.hidden.resize(rows * stride, 0.0);
        self.first.forward_relu(x, &mut tape.hidden);
        tape.out.resize_with(self.last.len(), Vec::new);
        tape.d_out.resize_with(self.last.len(), Vec::new);
        for ((h, layer), (out, d_out)) in self.last.iter().enumerate().zip(tape.out.iter_mut().zip(&mut tape.d_out)) {
            out.resize(rows * layer.outputs(), 0.0);
            d_out.resize(out.len(), 0.0);
            layer.start(&layer.bias.value, out);
            let hidden = slice(&tape.hidden, h * self.width, rows, self.width, stride);
            gemm(MatMut::new(out, rows, layer.outputs()), hidden, weight(layer).transposed(), Write::Add);
        }
    }

    /// Backward of [`Heads::forward`] for the same `x`, from `tape.d_out`: adds to `grad`, overwrites `dx`.
    pub fn backward(&self, x: &[f32], tape: &HeadsTape, dx: &mut [f32], grad: &mut HeadsGrad) {
        let rows = x.len() / self.first.inputs().max(1);
        let stride = self.first.outputs();
        let HeadsGrad { first, last, d_hidden } = grad;
        d_hidden.resize(tape.hidden.len(), 0.0);
        for (h, ((layer, grad), d_out)) in self.last.iter().zip(last).zip(&tape.d_out).enumerate() {
            let at = h * self.width;
            layer.backward_bias(d_out, grad);
            let d = Mat::new(d_out, rows, layer.outputs());
            let hidden = slice(&tape.hidden, at, rows, self.width, stride);
            gemm(MatMut::new(&mut grad.weight, layer.outputs(), self.width), d.transposed(), hidden, Write::Add);
            let end = if rows > 0 { at } else { 0 };
            gemm(MatMut::strided(&mut d_hidden[end..], rows, self.width, stride), d, weight(layer), Write::Set);
        }
        relu_backward(&tape.hidden, d_hidden);
        self.first.backward(x, d_hidden, None, first);
        self.first.backward_input(0..self.first.inputs(), d_hidden, dx, Write::Set);
    }

    /// Adds the chunks' gradients to the parameters, in the given order.
    pub fn add_grads<'a>(&mut self, chunks: impl Iterator<Item = &'a HeadsGrad> + Clone + Sync + Send) {
        self.first.add_grads(chunks.clone().map(|g| &g.first));
        for (h, layer) in self.last.iter_mut().enumerate() {
            layer.add_grads(chunks.clone().map(move |g| &g.last[h]));
        }
    }
}

/// Columns `at … at + cols` of a row-major matrix of the given stride.
fn slice(data: &[f32], at: usize, rows: usize, cols: usize, stride: usize) -> Mat<'_> {
    Mat::strided(&data[at.min(data.len())..], rows, cols, stride)
}

/// The whole weight, `[outputs, inputs]`.
fn weight(layer: &Dense) -> Mat<'_> {
    Mat::new(&layer.weight.value, layer.outputs(), layer.inputs())
}

impl HeadsGrad {
    /// Sets this to the zero gradient of `heads`, reusing memory.
    pub fn reset(&mut self, heads: &Heads) {
        self.first.reset(&heads.first);
        self.last.resize_with(heads.last.len(), DenseGrad::default);
        self.last.iter_mut().zip(&heads.last).for_each(|(g, l)| g.reset(l));
    }
}

impl Params for Heads {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.first.visit(f);
        self.last.iter().for_each(|l| l.visit(f));
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.first.visit_mut(f);
        self.last.iter_mut().for_each(|l| l.visit_mut(f));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;
    use crate::nn::{Mlp, MlpGrad, MlpTape};

    /// Both ways of summing the same products of order one, at most 32 terms.
    const TOLERANCE: f32 = 1e-5;

    const HEADS: [(&str, usize); 3] = [("a", 3), ("b", 1), ("c", 17)];

    fn random(n: usize, name: &str) -> Vec<f32> {
        let mut rng = Rng::new(2, name, 0, 0);
        (0..n).map(|_| rng.normal()).collect()
    }

    fn close(got: &[f32], want: &[f32], what: &str) {
        assert_eq!(got.len(), want.len(), "{what}");
        for (i, (g, w)) in got.iter().zip(want).enumerate() {
            assert!((g - w).abs() <= TOLERANCE * (1.0 + w.abs()), "{what}[{i}]: {g} against {w}");
        }
    }

    /// Each head equals a network of its own: initial first layer, output and gradients.
    #[test]
    fn heads_equal_networks_of_their_own() {
        let (inputs, width) = (5, 12);
        for rows in [0, 1, 16, 33] {
            let mut heads = Heads::new("t", [inputs, width], &HEADS, Init::FanIn, 4);
            let x = random(rows * inputs, "x");
            let (mut tape, mut grad, mut dx) = (HeadsTape::default(), HeadsGrad::default(), vec![7.0; x.len()]);
            heads.forward(&x, &mut tape);
            for (d, (name, _)) in tape.d_out.iter_mut().zip(HEADS) {
                *d = random(d.len(), name);
            }
            grad.reset(&heads);
            heads.backward(&x, &tape, &mut dx, &mut grad);
            heads.add_grads(std::iter::once(&grad));

            let mut want_dx = vec![0.0; x.len()];
            for (h, (name, outputs)) in HEADS.into_iter().enumerate() {
                let mut net = Mlp::new(&format!("t.{name}"), &[inputs, width, outputs], Init::Xavier, Init::Zero, 4);
                let mut layer = 0;
                net.visit_mut(&mut |p| {
                    match layer {
                        2 => p.value.clone_from(&heads.last[h].weight.value),
                        3 => p.value.clone_from(&heads.last[h].bias.value),
                        _ => {}
                    }
                    layer += 1;
                });
                let (mut net_tape, mut net_grad) = (MlpTape::default(), MlpGrad::default());
                net.forward(&x, &mut net_tape);
                net_grad.reset(&net);
                net.backward(&x, &mut net_tape, &tape.d_out[h], Some(&mut want_dx), &mut net_grad);
                net.add_grads(std::iter::once(&net_grad));
                close(&tape.out[h], net_tape.output(), name);
                let (first, last) = (&net.layers()[0], &net.layers()[1]);
                let share = h * width * inputs..(h + 1) * width * inputs;
                assert_eq!(
                    heads.first.weight.value[share.clone()],
                    first.weight.value,
                    "{name} is initialised as its own layer"
                );
                close(&heads.first.weight.grad[share], &first.weight.grad, "first weight");
                close(&heads.first.bias.grad[h * width..(h + 1) * width], &first.bias.grad, "first bias");
                close(&heads.last[h].weight.grad, &last.weight.grad, "last weight");
                close(&heads.last[h].bias.grad, &last.bias.grad, "last bias");
            }
            close(&dx, &want_dx, "dx");
        }
    }
}
