//! The three networks of the decoder, `Linear(in → C) · ReLU · Linear(C → out)`, over one shared input.
//!
//! | head | input | outputs |
//! |---|---|---|
//! | opacity | `[f, (d), (δ)]` | `k` |
//! | color | `[f, (d), (δ), e]` | `3k` |
//! | covariance | `[f, (d), (δ)]` | `7k` |
//!
//! All rows of a call share `e`, so it goes into a bias; what is left of the inputs is common to the three, and their
//! first layers are one product with the rows of the three weights below each other (a head without `d` or `δ` has columns of
//! zeros there). [`Fused`] is that layer, made once per call.

use super::DecoderConfig;
use crate::AnchorShape;
use gs_core::nn::dense::relu_backward;
use gs_core::nn::gemm::{Mat, MatMut, Write, gemm};
use gs_core::nn::{Dense, DenseGrad, Init, Mlp};
use gs_core::{Param, Params, Rng};
use std::ops::Range;

const NAMES: [&str; 3] = ["opacity", "color", "covariance"];
/// Outputs of each head per Gaussian.
const WIDTHS: [usize; 3] = [1, 3, 7];
const COLOR: usize = 1;

/// The three networks and the appearance vector.
#[derive(Clone, Debug)]
pub(super) struct Heads {
    first: [Dense; 3],
    second: [Dense; 3],
    /// Appearance vector `e`, shared by all views.
    appearance: Option<Param>,
    /// Width `C` of the feature and of each hidden layer.
    width: usize,
    /// Whether each head takes the direction, and the distance, as inputs.
    direction: [bool; 3],
    distance: [bool; 3],
}

/// The three first layers as one, the appearance folded into its bias.
#[derive(Clone, Debug, Default)]
pub(super) struct Fused {
    layer: Option<Dense>,
    bias: Vec<f32>,
}

/// Activations of one block.
#[derive(Clone, Debug, Default)]
pub(super) struct HeadsTape {
    /// `[rows, input_width]`, written by the caller.
    pub(super) input: Vec<f32>,
    /// Activations of the fused first layer, `[rows, 3 C]`.
    hidden: Vec<f32>,
}

/// Parameter gradients of one chunk of blocks, and scratch.
#[derive(Clone, Debug, Default)]
pub(super) struct HeadsGrad {
    fused: DenseGrad,
    second: [DenseGrad; 3],
    /// Cotangents of the heads' outputs, written by the caller.
    pub(super) d_out: [Vec<f32>; 3],
    d_hidden: Vec<f32>,
    /// Cotangents of the input, `[rows, input_width]`.
    pub(super) d_input: Vec<f32>,
}

/// Widths of the two layers of head `h`: inputs, hidden, outputs.
fn widths(config: &DecoderConfig, shape: AnchorShape, h: usize) -> [usize; 3] {
    let appearance = if h == COLOR { config.appearance } else { 0 };
    [
        config.inputs(shape.features, h).saturating_add(appearance),
        shape.features,
        WIDTHS[h].saturating_mul(shape.offsets),
    ]
}

impl Heads {
    /// Number of parameters of the heads of such anchors.
    pub(super) fn count(config: &DecoderConfig, shape: AnchorShape) -> u64 {
        let heads = (0..3).map(|h| Mlp::count(&widths(config, shape, h)));
        heads.fold(config.appearance as u64, u64::saturating_add)
    }

    pub(super) fn new(config: &DecoderConfig, shape: AnchorShape, seed: u64) -> Self {
        let widths: [_; 3] = std::array::from_fn(|h| widths(config, shape, h));
        let dense = |h: usize, layer: usize| {
            let [i, o]: [usize; 2] = [0, 1].map(|at| widths[h][layer + at]);
            Dense::new(&format!("heads.{}.{layer}", NAMES[h]), i, o, Init::FanIn, seed)
        };
        let mut rng = Rng::new(seed, "heads.appearance", 0, 0);
        let appearance = (0..config.appearance).map(|_| rng.normal()).collect();
        Self {
            first: std::array::from_fn(|h| dense(h, 0)),
            second: std::array::from_fn(|h| dense(h, 1)),
            appearance: (config.appearance > 0).then(|| Param::shared("heads.appearance", appearance)),
            width: shape.features,
            direction: config.direction.each(),
            distance: config.distance.each(),
        }
    }

    /// Values per row of the shared input: `C + 3`, one more if any head takes the distance.
    pub(super) fn input_width(&self) -> usize {
        self.width + 3 + usize::from(self.distance.contains(&true))
    }

    /// The values of the shared input that head `h` takes.
    fn seen(&self, h: usize) -> impl Iterator<Item = usize> + Clone + use<> {
        let direction = self.width..self.width + if self.direction[h] { 3 } else { 0 };
        let distance = self.width + 3..self.width + 3 + usize::from(self.distance[h]);
        (0..self.width).chain(direction).chain(distance)
    }

    /// How many these are.
    fn inputs_of(&self, h: usize) -> usize {
        self.seen(h).count()
    }

    /// Columns of the appearance in the first layer of the colour head.
    fn appearance_columns(&self) -> Range<usize> {
        self.inputs_of(COLOR)..self.first[COLOR].inputs()
    }

    /// Writes the three first layers into one.
    pub(super) fn fuse(&self, fused: &mut Fused) {
        let (inputs, outputs) = (self.input_width(), 3 * self.width);
        let Fused { layer, bias: folded } = fused;
        let layer = layer.get_or_insert_with(|| Dense::new("heads.first", inputs, outputs, Init::Zero, 0));
        if (layer.inputs(), layer.outputs()) != (inputs, outputs) {
            *layer = Dense::new("heads.first", inputs, outputs, Init::Zero, 0);
        }
        for (h, first) in self.first.iter().enumerate() {
            let rows = layer.weight.value.chunks_exact_mut(inputs).skip(h * self.width);
            for (to, from) in rows.zip(first.weight.value.chunks_exact(first.inputs())) {
                to.fill(0.0);
                self.seen(h).zip(from).for_each(|(column, w)| to[column] = *w);
            }
            let bias = match &self.appearance {
                Some(e) if h == COLOR => {
                    first.fold_constant(self.appearance_columns(), &e.value, folded);
                    &*folded
                }
                _ => &first.bias.value,
            };
            layer.bias.value[h * self.width..][..self.width].copy_from_slice(bias);
        }
    }

    /// Runs a block from `tape.input`; `out` are the three outputs, `[rows, k]`, `[rows, 3k]`, `[rows, 7k]`.
    pub(super) fn forward(&self, fused: &Fused, tape: &mut HeadsTape, out: [&mut [f32]; 3]) {
        let HeadsTape { input, hidden } = tape;
        let rows = input.len() / self.input_width();
        let Some(first) = &fused.layer else { return };
        hidden.resize(rows * first.outputs(), 0.0);
        first.forward_relu(input, hidden);
        for (h, (layer, out)) in self.second.iter().zip(out).enumerate() {
            layer.start(&layer.bias.value, out);
            let weight = Mat::new(&layer.weight.value, layer.outputs(), self.width).transposed();
            gemm(MatMut::new(out, rows, layer.outputs()), self.hidden_of(h, hidden, rows), weight, Write::Add);
        }
    }

    /// The columns of the hidden layer that belong to head `h`.
    fn hidden_of<'a>(&self, h: usize, hidden: &'a [f32], rows: usize) -> Mat<'a> {
        Mat::strided(&hidden[h * self.width..], rows, self.width, 3 * self.width)
    }

    /// Backward of [`Heads::forward`] from `grad.d_out`: adds to `grad`, sets `grad.d_input`.
    pub(super) fn backward(&self, fused: &Fused, tape: &HeadsTape, grad: &mut HeadsGrad) {
        let HeadsGrad { fused: d_fused, second, d_out, d_hidden, d_input } = grad;
        let rows = tape.input.len() / self.input_width();
        let Some(first) = &fused.layer else { return };
        d_hidden.resize(tape.hidden.len(), 0.0);
        for (h, ((layer, d), grad)) in self.second.iter().zip(d_out).zip(second).enumerate() {
            let (outputs, width) = (layer.outputs(), self.width);
            let d_out = Mat::new(d, rows, outputs);
            let d_own = MatMut::strided(&mut d_hidden[h * width..], rows, width, 3 * width);
            gemm(d_own, d_out, Mat::new(&layer.weight.value, outputs, width), Write::Set);
            let d_weight = MatMut::new(&mut grad.weight, outputs, width);
            gemm(d_weight, d_out.transposed(), self.hidden_of(h, &tape.hidden, rows), Write::Add);
            layer.backward_bias(d, grad);
        }
        relu_backward(&tape.hidden, d_hidden);
        first.backward(&tape.input, d_hidden, None, d_fused);
        d_input.resize(tape.input.len(), 0.0);
        first.backward_input(0..first.inputs(), d_hidden, d_input, Write::Set);
    }

    /// Makes `grad` zero, reusing memory.
    pub(super) fn reset(&self, fused: &Fused, grad: &mut HeadsGrad) {
        if let Some(layer) = &fused.layer {
            grad.fused.reset(layer);
        }
        grad.second.iter_mut().zip(&self.second).for_each(|(g, l)| g.reset(l));
    }

    /// Adds the chunks' gradients to the parameters, in order; those of the fused layer go to the three first layers.
    pub(super) fn add_grads<'a>(
        &mut self,
        fused: &mut Fused,
        chunks: impl Iterator<Item = &'a HeadsGrad> + Clone + Sync + Send,
    ) {
        for (h, layer) in self.second.iter_mut().enumerate() {
            layer.add_grads(chunks.clone().map(move |g| &g.second[h]));
        }
        let Some(layer) = &mut fused.layer else { return };
        layer.clear_grads();
        layer.add_grads(chunks.map(|g| &g.fused));
        for h in 0..3 {
            let (width, seen) = (self.width, self.seen(h));
            let first = &mut self.first[h];
            let inputs = first.inputs();
            let from = layer.weight.grad.chunks_exact(layer.inputs()).skip(h * width);
            for (to, from) in first.weight.grad.chunks_exact_mut(inputs).zip(from) {
                to.iter_mut().zip(seen.clone()).for_each(|(t, column)| *t += from[column]);
            }
            let d_bias = &layer.bias.grad[h * width..][..width];
            first.bias.grad.iter_mut().zip(d_bias).for_each(|(t, f)| *t += f);
        }
        let columns = self.appearance_columns();
        if let Some(e) = &mut self.appearance {
            let d_bias = &layer.bias.grad[COLOR * self.width..][..self.width];
            self.first[COLOR].fold_constant_backward(columns, &e.value, d_bias, &mut e.grad);
        }
    }

    /// The same networks without an appearance vector: it is folded into a bias.
    pub(super) fn folded(&self) -> Self {
        let mut folded = self.clone();
        let Some(e) = folded.appearance.take() else { return folded };
        let (first, seen) = (&self.first[COLOR], self.inputs_of(COLOR));
        let mut layer = Dense::new("heads.color.0", seen, self.width, Init::Zero, 0);
        let rows = layer.weight.value.chunks_exact_mut(seen);
        rows.zip(first.weight.value.chunks_exact(first.inputs()))
            .for_each(|(to, from)| to.copy_from_slice(&from[..seen]));
        first.fold_constant(self.appearance_columns(), &e.value, &mut layer.bias.value);
        folded.first[COLOR] = layer;
        folded
    }
}

impl Params for Heads {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        for (first, second) in self.first.iter().zip(&self.second) {
            first.visit(f);
            second.visit(f);
        }
        self.appearance.iter().for_each(f);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        for (first, second) in self.first.iter_mut().zip(&mut self.second) {
            first.visit_mut(f);
            second.visit_mut(f);
        }
        self.appearance.iter_mut().for_each(f);
    }
}
