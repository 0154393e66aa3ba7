//! A multi-layer perceptron: dense layers with ReLU (or SiLU) between them, for the rows of one block.
//!
//! Inputs that all rows share may be folded into the first bias, once per step instead of once per row: the last
//! `v.len()` inputs by [`Mlp::fold`], the others by [`Mlp::forward_folded`].
//!
//! ```
//! use gs_core::Params;
//! use gs_core::nn::{Init, Mlp, MlpGrad, MlpTape};
//!
//! // A deformation head: the zero last layer makes its output zero at the start, but not its gradient.
//! let mut net = Mlp::new("head", &[3, 16, 4], Init::Xavier, Init::Zero, 7);
//! let (x, mut tape, mut grad) = ([0.1, 0.2, 0.3], MlpTape::default(), MlpGrad::default());
//! net.forward(&x, &mut tape);
//! assert_eq!(tape.output(), [0.0; 4]);
//! grad.reset(&net);
//! net.backward(&x, &mut tape, &[1.0; 4], None, &mut grad);
//! net.add_grads(std::iter::once(&grad));
//! assert_eq!(net.layers()[1].bias.grad, [1.0; 4]);
//! assert_eq!(net.param_count(), 3 * 16 + 16 + 16 * 4 + 4);
//! ```

use super::activation::{Activation, scale};
use super::dense::{Dense, DenseGrad, Init, relu, relu_backward};
use super::gemm::Write;
use crate::{Param, Params};

/// `x → φ(W₀x + b₀) → … → W_L x + b_L`, optionally with `φ` after the last layer too.
#[derive(Clone, Debug, PartialEq)]
pub struct Mlp {
    /// The layers, first to last; at least one.
    layers: Vec<Dense>,
    activation: Activation,
    activate_last: bool,
}

/// Activations of one block, reused between steps.
#[derive(Clone, Debug, Default)]
pub struct MlpTape {
    /// Output of each layer (after its activation), `[rows, outputs]`.
    outputs: Vec<Vec<f32>>,
    /// Slopes of the activations, `[rows, outputs]`; empty for ReLU, whose output determines them.
    slopes: Vec<Vec<f32>>,
    /// Scratch of the backward pass: cotangents of the current layer's output and input.
    d: [Vec<f32>; 2],
}

/// Gradient of all layers, summed over the rows of one chunk.
#[derive(Clone, Debug, Default)]
pub struct MlpGrad(pub(super) Vec<DenseGrad>);

impl Mlp {
    /// Layers of the given widths (`[inputs, hidden…, outputs]`), named `{name}.0`, `{name}.1`, …; the last one is
    /// initialised by `last`, the others by `init`.
    ///
    /// # Panics
    /// With fewer than two widths.
    pub fn new(name: &str, widths: &[usize], init: Init, last: Init, seed: u64) -> Self {
        assert!(widths.len() >= 2, "a network needs an input and an output width");
        let final_layer = widths.len() - 2;
        let layer = |(i, w): (usize, &[usize])| {
            Dense::new(&format!("{name}.{i}"), w[0], w[1], if i == final_layer { last } else { init }, seed)
        };
        let layers = widths.windows(2).enumerate().map(layer).collect();
        Self { layers, activation: Activation::Relu, activate_last: false }
    }

    /// Number of parameters of layers of the given widths; the largest number where that is beyond it.
    pub fn count(widths: &[usize]) -> u64 {
        widths.windows(2).fold(0, |sum, w| sum.saturating_add(Dense::count(w[0], w[1])))
    }

    /// The same of `inputs`, then `hidden` layers of one width, then `outputs`: whatever these numbers are.
    ///
    /// ```
    /// use gs_core::nn::Mlp;
    /// assert_eq!(Mlp::count_deep(3, 2, 16, 4), Mlp::count(&[3, 16, 16, 4]));
    /// assert_eq!(Mlp::count_deep(3, 0, 16, 4), Mlp::count(&[3, 4]));
    /// assert_eq!(Mlp::count_deep(3, usize::MAX, 16, 4), u64::MAX);
    /// ```
    pub fn count_deep(inputs: usize, hidden: usize, width: usize, outputs: usize) -> u64 {
        let Some(between) = hidden.checked_sub(1) else { return Dense::count(inputs, outputs) };
        let deep = Dense::count(width, width).saturating_mul(between as u64);
        Dense::count(inputs, width).saturating_add(deep).saturating_add(Dense::count(width, outputs))
    }

    /// The same network with another activation than ReLU.
    pub fn with_activation(mut self, activation: Activation) -> Self {
        self.activation = activation;
        self
    }

    /// The same network with the activation after the last layer too.
    pub fn with_last_activation(mut self) -> Self {
        self.activate_last = true;
        self
    }

    /// The activation function between the layers.
    pub fn activation(&self) -> Activation {
        self.activation
    }

    /// The layers in order, first to last.
    pub fn layers(&self) -> &[Dense] {
        &self.layers
    }

    /// Number of values in an input row.
    pub fn inputs(&self) -> usize {
        self.layers[0].inputs()
    }

    /// Number of values in an output row.
    pub fn outputs(&self) -> usize {
        self.layers[self.layers.len() - 1].outputs()
    }

    /// Whether the activation follows a layer.
    pub(super) fn is_active(&self, layer: usize) -> bool {
        self.activate_last || layer + 1 < self.layers.len()
    }

    /// Forward of the block `x: [rows, inputs]`; the result is [`MlpTape::output`].
    pub fn forward(&self, x: &[f32], tape: &mut MlpTape) {
        self.run(x, self.inputs(), None, tape);
    }

    /// The first layer's bias with its last `v.len()` inputs, which all rows share, included.
    pub fn fold(&self, v: &[f32], bias: &mut Vec<f32>) {
        self.layers[0].fold_constant(self.inputs() - v.len()..self.inputs(), v, bias);
    }

    /// [`Mlp::forward`] for `x: [rows, columns]`, the first inputs, with the others in `bias` ([`Mlp::fold`]).
    pub fn forward_folded(&self, x: &[f32], columns: usize, bias: &[f32], tape: &mut MlpTape) {
        self.run(x, columns, Some(bias), tape);
    }

    fn run(&self, x: &[f32], columns: usize, bias: Option<&[f32]>, tape: &mut MlpTape) {
        let rows = x.len() / columns.max(1);
        tape.outputs.resize_with(self.layers.len(), Vec::new);
        tape.slopes.resize_with(self.layers.len(), Vec::new);
        for (i, layer) in self.layers.iter().enumerate() {
            let (before, rest) = tape.outputs.split_at_mut(i);
            let (y, slope) = (&mut rest[0], &mut tape.slopes[i]);
            y.resize(rows * layer.outputs(), 0.0);
            let x = before.last().map_or(x, Vec::as_slice);
            let has_relu = self.is_active(i) && self.activation == Activation::Relu;
            match bias.filter(|_| i == 0) {
                Some(bias) => {
                    layer.start(bias, y);
                    layer.add_product(0..columns, x, y);
                    if has_relu {
                        relu(y);
                    }
                }
                None if has_relu => layer.forward_relu(x, y),
                None => layer.forward(x, y),
            }
            if self.is_active(i) && !has_relu {
                slope.resize(y.len(), 0.0);
                self.activation.apply(y, slope);
            }
        }
    }

    /// Backward of [`Mlp::forward`] for the same `x`: adds to `grad` and, where given, to `dx`.
    pub fn backward(&self, x: &[f32], tape: &mut MlpTape, dy: &[f32], dx: Option<&mut [f32]>, grad: &mut MlpGrad) {
        self.run_backward(x, self.inputs(), tape, dy, dx, grad);
    }

    /// Backward of [`Mlp::forward_folded`]: adds to `grad`, whose folded columns [`Mlp::add_grads_folded`] fills.
    pub fn backward_folded(&self, x: &[f32], columns: usize, tape: &mut MlpTape, dy: &[f32], grad: &mut MlpGrad) {
        self.run_backward(x, columns, tape, dy, None, grad);
    }

    fn run_backward(
        &self,
        x: &[f32],
        columns: usize,
        tape: &mut MlpTape,
        dy: &[f32],
        dx: Option<&mut [f32]>,
        grad: &mut MlpGrad,
    ) {
        let rows = x.len() / columns.max(1);
        let MlpTape { outputs, slopes, d: [d_out, d_in] } = tape;
        d_out.clear();
        d_out.extend_from_slice(dy);
        for (i, layer) in self.layers.iter().enumerate().rev() {
            match self.activation {
                _ if !self.is_active(i) => {}
                Activation::Relu => relu_backward(&outputs[i], d_out),
                Activation::Silu => scale(&slopes[i], d_out),
            }
            if i > 0 {
                d_in.resize(rows * layer.inputs(), 0.0);
                layer.backward(&outputs[i - 1], d_out, None, &mut grad.0[i]);
                layer.backward_input(0..layer.inputs(), d_out, d_in, Write::Set);
                std::mem::swap(d_out, d_in);
            }
        }
        let (first, grad) = (&self.layers[0], &mut grad.0[0]);
        first.backward_bias(d_out, grad);
        first.backward_weight(0..columns, x, d_out, grad);
        if let Some(dx) = dx {
            first.backward_input(0..columns, d_out, dx, Write::Add);
        }
    }

    /// Adds the chunks' gradients to the parameters, in the given order.
    pub fn add_grads<'a>(&mut self, chunks: impl Iterator<Item = &'a MlpGrad> + Clone + Sync + Send) {
        for (i, layer) in self.layers.iter_mut().enumerate() {
            layer.add_grads(chunks.clone().map(move |g| &g.0[i]));
        }
    }

    /// As [`Mlp::add_grads`], after [`Mlp::backward_folded`]: also adds the gradient of the weight columns of the shared
    /// inputs `v`, from that of the first bias. `v` itself gets no gradient.
    pub fn add_grads_folded<'a>(&mut self, v: &[f32], chunks: impl Iterator<Item = &'a MlpGrad> + Clone + Sync + Send) {
        let mut d_bias = vec![0.0; self.layers[0].outputs()];
        for chunk in chunks.clone() {
            d_bias.iter_mut().zip(&chunk.0[0].bias).for_each(|(d, g)| *d += g);
        }
        self.add_grads(chunks);
        let columns = self.inputs() - v.len()..self.inputs();
        self.layers[0].fold_constant_backward(columns, v, &d_bias, &mut vec![0.0; v.len()]);
    }
}

impl MlpTape {
    /// Output of the last forward pass, `[rows, outputs]`.
    pub fn output(&self) -> &[f32] {
        self.outputs.last().map_or(&[], Vec::as_slice)
    }
}

impl MlpGrad {
    /// Sets this to the zero gradient of `mlp`, reusing memory.
    pub fn reset(&mut self, mlp: &Mlp) {
        self.0.resize_with(mlp.layers.len(), DenseGrad::default);
        self.0.iter_mut().zip(&mlp.layers).for_each(|(g, l)| g.reset(l));
    }
}

impl Params for Mlp {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.layers.iter().for_each(|l| l.visit(f));
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.layers.iter_mut().for_each(|l| l.visit_mut(f));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;

    /// f32 output against the f64 loops (three layers of width ≤ 16, values of order one).
    const VALUE: f64 = 2e-6;
    /// f32 gradients against central differences of the f64 loops, relative to 1 + |gradient|.
    const GRADIENT: f64 = 2e-5;

    fn wide(mlp: &Mlp) -> Vec<Vec<f64>> {
        let mut all = Vec::new();
        mlp.visit(&mut |p| all.push(p.value.iter().map(|&v| f64::from(v)).collect()));
        all
    }

    /// `Σ weight · mlp(x)` in f64 loops; `params` alternates weight and bias.
    fn reference(
        params: &[Vec<f64>],
        (activation, last): (Activation, bool),
        inputs: usize,
        x: &[f64],
        weight: &[f64],
    ) -> f64 {
        let layers = params.len() / 2;
        let mut loss = 0.0;
        let outputs = params[params.len() - 1].len();
        for (row, weight) in x.chunks(inputs).zip(weight.chunks(outputs)) {
            let mut h = row.to_vec();
            for (i, pair) in params.chunks(2).enumerate() {
                let linear = pair[1].iter().zip(pair[0].chunks(h.len()));
                h = linear.map(|(b, w)| b + w.iter().zip(&h).map(|(w, h)| w * h).sum::<f64>()).collect();
                if last || i + 1 < layers {
                    h.iter_mut().for_each(|v| match activation {
                        Activation::Relu => *v = v.max(0.0),
                        Activation::Silu => *v /= 1.0 + (-*v).exp(),
                    });
                }
            }
            loss += h.iter().zip(weight).map(|(h, w)| h * w).sum::<f64>();
        }
        loss
    }

    #[test]
    fn gradients_match_finite_differences_of_the_f64_loops() {
        for (rows, activation, last) in [
            (1, Activation::Relu, false),
            (15, Activation::Relu, true),
            (17, Activation::Relu, false),
            (17, Activation::Silu, false),
            (16, Activation::Silu, true),
        ] {
            let mut mlp = Mlp::new("t", &[5, 16, 7, 3], Init::FanIn, Init::FanIn, 1).with_activation(activation);
            if last {
                mlp = mlp.with_last_activation();
            }
            let kind = (activation, last);
            let mut rng = Rng::new(2, "mlp", 0, rows);
            let x: Vec<f32> = (0..rows * 5).map(|_| rng.normal()).collect();
            let dy: Vec<f32> = (0..rows * 3).map(|_| rng.normal()).collect();
            let (mut tape, mut grad, mut dx) = (MlpTape::default(), MlpGrad::default(), vec![0.0; x.len()]);
            mlp.forward(&x, &mut tape);
            grad.reset(&mlp);
            mlp.backward(&x, &mut tape, &dy, Some(&mut dx), &mut grad);
            mlp.add_grads(std::iter::once(&grad));

            let mut params = wide(&mlp);
            let mut x: Vec<f64> = x.iter().map(|&v| f64::from(v)).collect();
            let dy: Vec<f64> = dy.iter().map(|&v| f64::from(v)).collect();
            let loss: f64 = tape.output().iter().zip(&dy).map(|(y, d)| f64::from(*y) * d).sum();
            assert!((loss - reference(&params, kind, 5, &x, &dy)).abs() < VALUE * 20.0);

            let h = 1e-6;
            let check = |got: f32, hi: f64, lo: f64, what: &str| {
                let want = (hi - lo) / (2.0 * h);
                assert!((f64::from(got) - want).abs() < GRADIENT * (1.0 + want.abs()), "{what}: {got} {want}");
            };
            for i in 0..x.len() {
                let at = x[i];
                x[i] = at + h;
                let hi = reference(&params, kind, 5, &x, &dy);
                x[i] = at - h;
                let lo = reference(&params, kind, 5, &x, &dy);
                x[i] = at;
                check(dx[i], hi, lo, "dx");
            }
            let mut grads = Vec::new();
            mlp.visit(&mut |p| grads.push(p.grad.clone()));
            for b in 0..params.len() {
                for i in 0..params[b].len() {
                    let at = params[b][i];
                    params[b][i] = at + h;
                    let hi = reference(&params, kind, 5, &x, &dy);
                    params[b][i] = at - h;
                    let lo = reference(&params, kind, 5, &x, &dy);
                    params[b][i] = at;
                    check(grads[b][i], hi, lo, "parameter");
                }
            }
        }
    }

    /// Sums of the same terms in another order.
    #[test]
    fn shared_inputs_fold_into_the_first_bias() {
        let (rows, columns, shared) = (19, 4, [0.3, -0.7, 1.1]);
        for activation in [Activation::Relu, Activation::Silu] {
            let mut mlp = Mlp::new("t", &[7, 9, 2], Init::FanIn, Init::FanIn, 1).with_activation(activation);
            let mut rng = Rng::new(2, "fold", 0, 0);
            let x: Vec<f32> = (0..rows * columns).map(|_| rng.normal()).collect();
            let dy: Vec<f32> = (0..rows * 2).map(|_| rng.normal()).collect();
            let full: Vec<f32> = x.chunks(columns).flat_map(|row| row.iter().chain(&shared).copied()).collect();
            let (mut tape, mut grad, mut bias) = (MlpTape::default(), MlpGrad::default(), Vec::new());
            let grads = |mlp: &Mlp| {
                let mut all = Vec::new();
                mlp.visit(&mut |p| all.extend_from_slice(&p.grad));
                all
            };
            mlp.forward(&full, &mut tape);
            let y = tape.output().to_vec();
            grad.reset(&mlp);
            mlp.backward(&full, &mut tape, &dy, None, &mut grad);
            mlp.add_grads(std::iter::once(&grad));
            let want = grads(&mlp);
            mlp.clear_grads();

            mlp.fold(&shared, &mut bias);
            mlp.forward_folded(&x, columns, &bias, &mut tape);
            let close = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-5 * (1.0 + b.abs()));
            assert!(close(tape.output(), &y) && tape.output().len() == y.len());
            grad.reset(&mlp);
            mlp.backward_folded(&x, columns, &mut tape, &dy, &mut grad);
            mlp.add_grads_folded(&shared, std::iter::once(&grad));
            assert!(close(&grads(&mlp), &want));
        }
    }

    #[test]
    fn names_and_counts_follow_the_widths() {
        let mlp = Mlp::new("head", &[4, 8, 2], Init::Xavier, Init::Zero, 0);
        let mut names = Vec::new();
        mlp.visit(&mut |p| names.push(p.name.clone()));
        assert_eq!(names, ["head.0.weight", "head.0.bias", "head.1.weight", "head.1.bias"]);
        assert_eq!((mlp.param_count(), mlp.inputs(), mlp.outputs()), (4 * 8 + 8 + 8 * 2 + 2, 4, 2));
        let mut tape = MlpTape::default();
        mlp.forward(&[1.0; 12], &mut tape);
        assert_eq!(tape.output(), [0.0; 6], "a zero last layer gives zero");
    }
}
