//! The network of Deformable 3D Gaussians, block by block; for the equations see [`defgs`](super::defgs).

use super::defgs::DefGsConfig;
use crate::apply::OffsetColumns;
use glam::Vec3;
use gs_core::nn::dense::{leaky_relu, leaky_relu_backward};
use gs_core::nn::gemm::Write;
use gs_core::nn::{Dense, DenseGrad, Init, Mlp, MlpGrad, MlpTape, encoding};
use gs_core::{Param, Params, Time};
use rayon::prelude::*;
use std::ops::Range;

/// Time network, trunk with a skip, three heads.
#[derive(Clone, Debug)]
pub(super) struct DefNet {
    config: DefGsConfig,
    time_net: Option<Mlp>,
    layers: Vec<Dense>,
    /// Heads of means, quats, scales.
    heads: [Dense; 3],
    /// Widths of the encoded position and of the time features.
    inputs: (usize, usize),
}

/// Values shared by all blocks of a call.
#[derive(Clone, Debug, Default)]
pub(super) struct DefNetTape {
    /// The positionally encoded time.
    time: Vec<f32>,
    time_net: MlpTape,
    /// Biases of all layers, with the time folded in where it is an input.
    biases: Vec<Vec<f32>>,
    d_time: Vec<f32>,
    d_bias: Vec<f32>,
    time_grad: MlpGrad,
}

/// Activations of one block of splats.
#[derive(Clone, Debug, Default)]
pub(super) struct Block {
    position: Vec<f32>,
    hidden: Vec<Vec<f32>>,
    /// Outputs of the three heads.
    pub offsets: OffsetColumns,
    /// Cotangents of `offsets`, filled in by the caller before [`DefNet::backward_block`].
    pub d_offsets: OffsetColumns,
    /// Cotangents of the current layer's output and of its hidden input.
    d: [Vec<f32>; 2],
}

/// The columns that move, and their widths.
const HEADS: [(&str, usize); 3] = [("means", 3), ("quats", 4), ("scales", 3)];

/// Parameter gradients of one chunk of blocks.
#[derive(Clone, Debug, Default)]
pub(super) struct ChunkGrad {
    layers: Vec<DenseGrad>,
    heads: [DenseGrad; 3],
}

impl DefGsConfig {
    /// Widths of the time network, if there is one.
    fn time_net(&self) -> Option<[usize; 3]> {
        let encoded = encoding::width(1, self.bands_time);
        (self.time_hidden > 0).then_some([encoded, self.time_hidden, self.time_features])
    }

    /// Widths of the encoded position and of the time features.
    fn inputs(&self) -> (usize, usize) {
        let time = self.time_net().map_or(encoding::width(1, self.bands_time), |widths| widths[2]);
        (encoding::width(3, self.bands_position), time)
    }

    /// Inputs of each hidden layer.
    fn layer_inputs(&self) -> impl Iterator<Item = usize> {
        let (position, time) = self.inputs();
        (0..self.depth).map(move |i| {
            let hidden = if i == 0 { 0 } else { self.width };
            let input = if takes_input(self, i) { position + time } else { 0 };
            input + hidden
        })
    }

    /// Number of parameters of the field; the largest number where that is beyond it.
    pub fn param_count(&self) -> u64 {
        let (position, time) = self.inputs();
        let inputs = position.saturating_add(time);
        let trunk = Mlp::count_deep(inputs, self.depth.max(1) - 1, self.width, self.width);
        // The layer that takes the inputs again.
        let again = self.skip.saturating_add(1) < self.depth;
        let skip = if again { (inputs as u64).saturating_mul(self.width as u64) } else { 0 };
        let net = self.time_net().map_or(0, |widths| Mlp::count(&widths));
        let heads = HEADS.map(|(_, outputs)| Dense::count(self.width, outputs));
        [trunk, skip, net].into_iter().chain(heads).fold(0, u64::saturating_add)
    }
}

impl DefNet {
    pub(super) fn new(config: &DefGsConfig, seed: u64) -> Self {
        let time_net = config.time_net().map(|w| Mlp::new("field.time", &w, Init::FanIn, Init::FanIn, seed));
        let layer = |(i, inputs)| Dense::new(&format!("field.layer.{i}"), inputs, config.width, Init::FanIn, seed);
        let last = if config.zero_init { Init::Zero } else { Init::FanIn };
        let head =
            |(name, outputs): (&str, usize)| Dense::new(&format!("field.{name}"), config.width, outputs, last, seed);
        Self {
            config: config.clone(),
            time_net,
            layers: config.layer_inputs().enumerate().map(layer).collect(),
            heads: HEADS.map(head),
            inputs: config.inputs(),
        }
    }

    /// Columns of the encoded position, of the time features and of the hidden input in a layer's weight.
    fn columns(&self, layer: usize) -> [Range<usize>; 3] {
        let (position, time) = if takes_input(&self.config, layer) { self.inputs } else { (0, 0) };
        [0..position, position..position + time, position + time..self.layers[layer].inputs()]
    }

    /// Encodes the time and folds it into the biases of the layers that take it as input.
    pub(super) fn fold_time(&self, t: Time, tape: &mut DefNetTape) {
        tape.time.resize(encoding::width(1, self.config.bands_time), 0.0);
        encoding::encode(&[t.normalised], 1, self.config.bands_time, &mut tape.time);
        if let Some(net) = &self.time_net {
            net.forward(&tape.time, &mut tape.time_net);
        }
        let features = if self.time_net.is_some() { tape.time_net.output() } else { &tape.time };
        tape.biases.resize_with(self.layers.len(), Vec::new);
        for (i, (layer, bias)) in self.layers.iter().zip(&mut tape.biases).enumerate() {
            let [_, time, _] = self.columns(i);
            layer.fold_constant(time.clone(), &features[..time.len()], bias);
        }
    }

    pub(super) fn forward_block(&self, tape: &DefNetTape, means: &[Vec3], block: &mut Block) {
        let Block { position, hidden, offsets, .. } = block;
        position.resize(means.len() * self.inputs.0, 0.0);
        for (p, row) in means.iter().zip(position.chunks_exact_mut(self.inputs.0)) {
            let p = *p * self.config.coordinate_scale;
            encoding::encode(&p.to_array(), 3, self.config.bands_position, row);
        }
        hidden.resize_with(self.layers.len(), Vec::new);
        for (i, layer) in self.layers.iter().enumerate() {
            let (before, here) = hidden.split_at_mut(i);
            let y = &mut here[0];
            y.resize(means.len() * layer.outputs(), 0.0);
            layer.start(&tape.biases[i], y);
            let [from_position, _, from_hidden] = self.columns(i);
            if !from_position.is_empty() {
                layer.add_product(from_position, position, y);
            }
            if let Some(h) = before.last() {
                layer.add_product(from_hidden, h, y);
            }
            leaky_relu(y, self.config.leak);
        }
        let last = hidden.last().map_or(&[][..], Vec::as_slice);
        for (head, out) in self.heads.iter().zip([&mut offsets.means, &mut offsets.quats, &mut offsets.scales]) {
            out.resize(means.len() * head.outputs(), 0.0);
            head.forward(last, out);
        }
    }

    /// Backward of [`DefNet::forward_block`] from `block.d_offsets`: adds to `grad`. The means get no cotangent.
    pub(super) fn backward_block(&self, block: &mut Block, grad: &mut ChunkGrad) {
        let Block { position, hidden, d_offsets, d: [d_out, d_in], .. } = block;
        let last = hidden.last().map_or(&[][..], Vec::as_slice);
        d_out.clear();
        d_out.resize(last.len(), 0.0);
        let d_heads = [&d_offsets.means, &d_offsets.quats, &d_offsets.scales];
        for ((head, d), grad) in self.heads.iter().zip(d_heads).zip(&mut grad.heads) {
            head.backward(last, d, Some(d_out), grad);
        }
        for (i, layer) in self.layers.iter().enumerate().rev() {
            leaky_relu_backward(&hidden[i], self.config.leak, d_out);
            let [from_position, _, from_hidden] = self.columns(i);
            let grad = &mut grad.layers[i];
            layer.backward_bias(d_out, grad);
            if !from_position.is_empty() {
                layer.backward_weight(from_position, position, d_out, grad);
            }
            if i > 0 {
                layer.backward_weight(from_hidden.clone(), &hidden[i - 1], d_out, grad);
                d_in.resize(hidden[i - 1].len(), 0.0);
                layer.backward_input(from_hidden, d_out, d_in, Write::Set);
                std::mem::swap(d_out, d_in);
            }
        }
    }

    /// Sets `grad` to zero, reusing memory.
    pub(super) fn reset(&self, grad: &mut ChunkGrad) {
        grad.layers.resize_with(self.layers.len(), DenseGrad::default);
        grad.layers.iter_mut().zip(&self.layers).for_each(|(g, l)| g.reset(l));
        grad.heads.iter_mut().zip(&self.heads).for_each(|(g, l)| g.reset(l));
    }

    /// Adds the chunks' gradients to the parameters, then back-propagates the bias gradients of the layers that take
    /// the time to their time columns and to the time network.
    pub(super) fn add_grads(&mut self, tape: &mut DefNetTape, chunks: &[ChunkGrad]) {
        for (k, head) in self.heads.iter_mut().enumerate() {
            head.add_grads(chunks.iter().map(move |g| &g.heads[k]));
        }
        self.layers.par_iter_mut().enumerate().for_each(|(i, layer)| {
            layer.add_grads(chunks.iter().map(move |g| &g.layers[i]));
        });
        let DefNetTape { time, time_net, d_time, d_bias, time_grad, .. } = tape;
        let features = if self.time_net.is_some() { time_net.output() } else { time.as_slice() };
        d_time.clear();
        d_time.resize(features.len(), 0.0);
        for i in (0..self.layers.len()).filter(|&i| takes_input(&self.config, i)) {
            let [_, columns, _] = self.columns(i);
            d_bias.clear();
            d_bias.resize(self.layers[i].outputs(), 0.0);
            for chunk in chunks {
                d_bias.iter_mut().zip(&chunk.layers[i].bias).for_each(|(d, g)| *d += g);
            }
            self.layers[i].fold_constant_backward(columns, features, d_bias, d_time);
        }
        if let Some(net) = &mut self.time_net {
            time_grad.reset(net);
            net.backward(time, time_net, d_time, None, time_grad);
            net.add_grads(std::iter::once(&*time_grad));
        }
    }
}

/// Whether a layer takes the encoded position and time as input.
fn takes_input(config: &DefGsConfig, layer: usize) -> bool {
    layer == 0 || layer == config.skip.saturating_add(1)
}

impl Params for DefNet {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.time_net.iter().for_each(|n| n.visit(f));
        self.layers.iter().chain(&self.heads).for_each(|l| l.visit(f));
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.time_net.iter_mut().for_each(|n| n.visit_mut(f));
        self.layers.iter_mut().chain(&mut self.heads).for_each(|l| l.visit_mut(f));
    }
}
