//! The decoder and the deformation of anchors in `f64`: one anchor at a time, plain loops, no optimisations. Tests and
//! benches measure against it.

use crate::{AnchorShape, Decoder, DecoderConfig, LocalAnchors};
use gs_core::Params;
use std::collections::BTreeMap;

mod gad;
pub use gad::{GadRef, RestRef};

/// Values of parameter blocks, or their gradients, by parameter name.
pub type Blocks = BTreeMap<String, Vec<f64>>;

/// One activated anchor, or its cotangent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AnchorRef {
    /// Position `x'`, world units.
    pub position: [f64; 3],
    /// Offsets `O'`, `[k, 3]`.
    pub offsets: Vec<f64>,
    /// Feature `f'`, `[C]`.
    pub features: Vec<f64>,
    /// Linear scales `l'`, world units.
    pub scales: [f64; 6],
}

/// One decoded Gaussian; or its cotangent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GaussianRef {
    /// `tanh` of the opacity head, `a`; if positive the Gaussian exists and this is its opacity.
    pub activation: f64,
    /// Mean `μ`, world units.
    pub mean: [f64; 3],
    /// Linear scale `s`, world units, not negative.
    pub scale: [f64; 3],
    /// Raw quaternion `r`, `(w, x, y, z)`.
    pub quat: [f64; 4],
    /// Plain colour `rgb`, 0 … 1.
    pub color: [f64; 3],
}

/// A [`Decoder`] in `f64`, one anchor at a time.
#[derive(Clone, Debug)]
pub struct DecoderRef {
    config: DecoderConfig,
    shape: AnchorShape,
    /// All parameters of the decoder by name.
    pub blocks: Blocks,
}

/// Inputs and outputs of one anchor's heads.
struct HeadActivations {
    distance: f64,
    direction: [f64; 3],
    /// Softmax weights of the bank; `None` without a bank.
    bank: Option<[f64; 3]>,
    /// Inputs of the opacity, colour and covariance heads.
    inputs: [Vec<f64>; 3],
    /// Outputs of the three heads before their activations.
    outputs: [Vec<f64>; 3],
}

const HEADS: [&str; 3] = ["heads.opacity", "heads.color", "heads.covariance"];

impl AnchorRef {
    /// Copies anchor `v` of `local`.
    pub fn new(local: &LocalAnchors, v: usize) -> Self {
        let (k3, c) = (local.offsets.len() / local.len(), local.features.len() / local.len());
        let wide = |v: &[f32]| -> Vec<f64> { v.iter().map(|&v| f64::from(v)).collect() };
        Self {
            position: local.positions[v].as_dvec3().to_array(),
            offsets: wide(&local.offsets[k3 * v..][..k3]),
            features: wide(&local.features[c * v..][..c]),
            scales: std::array::from_fn(|i| f64::from(local.scales[6 * v + i])),
        }
    }
}

impl DecoderRef {
    /// Copies the parameters of a decoder.
    pub fn new(decoder: &Decoder) -> Self {
        let mut blocks = Blocks::new();
        decoder.visit(&mut |p| {
            blocks.insert(p.name.clone(), p.value.iter().map(|&v| f64::from(v)).collect());
        });
        Self { config: decoder.config().clone(), shape: decoder.shape(), blocks }
    }

    /// All `k` Gaussians of an anchor for a camera at `eye`, those that do not exist (`a ≤ 0`) included.
    pub fn decode(&self, anchor: &AnchorRef, eye: [f64; 3]) -> Vec<GaussianRef> {
        let [z, c, q] = self.evaluate_heads(anchor, eye).outputs;
        let gaussian = |j: usize| GaussianRef {
            activation: z[j].tanh(),
            mean: std::array::from_fn(|i| anchor.position[i] + anchor.offsets[3 * j + i] * anchor.scales[i]),
            scale: std::array::from_fn(|i| anchor.scales[3 + i].abs() * sigmoid(q[7 * j + i])),
            quat: std::array::from_fn(|i| q[7 * j + 3 + i]),
            color: std::array::from_fn(|i| sigmoid(c[3 * j + i])),
        };
        (0..self.shape.offsets).map(gaussian).collect()
    }

    fn evaluate_heads(&self, anchor: &AnchorRef, eye: [f64; 3]) -> HeadActivations {
        let u: [f64; 3] = std::array::from_fn(|i| anchor.position[i] - eye[i]);
        let distance = (u[0] * u[0] + u[1] * u[1] + u[2] * u[2]).sqrt();
        let direction = u.map(|v| v / distance);
        let bank = self.config.feature_bank.then(|| {
            let view = [direction[0], direction[1], direction[2], distance];
            let z = self.network("heads.bank", &view).1;
            let e: Vec<f64> = z.iter().map(|z| z.exp()).collect();
            let total: f64 = e.iter().sum();
            [e[0] / total, e[1] / total, e[2] / total]
        });
        let mut features = anchor.features.clone();
        if let Some(w) = bank {
            for (i, f) in features.iter_mut().enumerate() {
                *f = (0..3).map(|m| w[m] * anchor.features[self.bank_index(m, i)]).sum();
            }
        }
        let (with_direction, with_distance) = (self.config.direction.each(), self.config.distance.each());
        let inputs: [Vec<f64>; 3] = std::array::from_fn(|h| {
            let mut x = features.clone();
            x.extend(with_direction[h].then_some(direction).into_iter().flatten());
            x.extend(with_distance[h].then_some(distance));
            if h == 1 {
                x.extend(self.blocks.get("heads.appearance").into_iter().flatten());
            }
            x
        });
        let outputs = std::array::from_fn(|h| self.network(HEADS[h], &inputs[h]).1);
        HeadActivations { distance, direction, bank, inputs, outputs }
    }

    /// The entry of the feature that copy `m` of the bank reads for entry `i`: strides 4, 2, 1.
    fn bank_index(&self, m: usize, i: usize) -> usize {
        let stride = [4, 2, 1][m];
        stride * (i % (self.shape.features / stride))
    }

    /// Hidden values and output of `Linear · ReLU · Linear`.
    fn network(&self, name: &str, x: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let dense = |layer: usize, x: &[f64]| -> Vec<f64> {
            let (w, b) =
                (&self.blocks[&format!("{name}.{layer}.weight")], &self.blocks[&format!("{name}.{layer}.bias")]);
            b.iter().zip(w.chunks(x.len())).map(|(b, w)| b + w.iter().zip(x).map(|(w, x)| w * x).sum::<f64>()).collect()
        };
        let hidden: Vec<f64> = dense(0, x).into_iter().map(|v| v.max(0.0)).collect();
        let out = dense(1, &hidden);
        (hidden, out)
    }

    /// Backward of [`DecoderRef::network`]: adds to `grads`, returns the cotangent of its input.
    fn network_backward(&self, name: &str, x: &[f64], d_out: &[f64], grads: &mut Blocks) -> Vec<f64> {
        let hidden = self.network(name, x).0;
        let mut dense = |layer: usize, x: &[f64], d: &[f64]| -> Vec<f64> {
            let mut d_x = vec![0.0; x.len()];
            let (weight, bias) = (format!("{name}.{layer}.weight"), format!("{name}.{layer}.bias"));
            for (o, d) in d.iter().enumerate() {
                add_at(grads, &bias, o, *d);
                for (i, x) in x.iter().enumerate() {
                    add_at(grads, &weight, o * d_x.len() + i, d * x);
                    d_x[i] += d * self.blocks[&weight][o * d_x.len() + i];
                }
            }
            d_x
        };
        let d_hidden = dense(1, &hidden, d_out);
        let d_hidden: Vec<f64> = d_hidden.iter().zip(&hidden).map(|(d, h)| if *h > 0.0 { *d } else { 0.0 }).collect();
        dense(0, x, &d_hidden)
    }

    /// Backward of [`DecoderRef::decode`] from the cotangents of the Gaussians (those that do not exist have no
    /// gradient): adds to `grads` (shaped like [`DecoderRef::blocks`]), returns the cotangent of the anchor.
    pub fn backward(&self, anchor: &AnchorRef, eye: [f64; 3], d: &[GaussianRef], grads: &mut Blocks) -> AnchorRef {
        let heads = self.evaluate_heads(anchor, eye);
        let c = self.shape.features;
        let (mut back, d_outputs) = self.gaussians_backward(anchor, &heads, d);
        let (mut d_mixed, mut d_direction, mut d_distance) = (vec![0.0; c], [0.0; 3], 0.0);
        for h in 0..3 {
            let d_x = self.network_backward(HEADS[h], &heads.inputs[h], &d_outputs[h], grads);
            (0..c).for_each(|i| d_mixed[i] += d_x[i]);
            let appearance = if h == 1 { self.config.appearance } else { 0 };
            let mut view = &d_x[c..d_x.len() - appearance];
            if self.config.direction.each()[h] {
                (0..3).for_each(|i| d_direction[i] += view[i]);
                view = &view[3..];
            }
            d_distance += view.iter().sum::<f64>();
            for i in 0..appearance {
                add_at(grads, "heads.appearance", i, d_x[d_x.len() - appearance + i]);
            }
        }
        match heads.bank {
            None => back.features = d_mixed,
            Some(w) => {
                let mut d_w = [0.0; 3];
                for (m, i) in (0..3).flat_map(|m| (0..c).map(move |i| (m, i))) {
                    d_w[m] += d_mixed[i] * anchor.features[self.bank_index(m, i)];
                    back.features[self.bank_index(m, i)] += w[m] * d_mixed[i];
                }
                let mean: f64 = (0..3).map(|m| w[m] * d_w[m]).sum();
                let d_logits: [f64; 3] = std::array::from_fn(|m| w[m] * (d_w[m] - mean));
                let view = [heads.direction[0], heads.direction[1], heads.direction[2], heads.distance];
                let d_view = self.network_backward("heads.bank", &view, &d_logits, grads);
                (0..3).for_each(|i| d_direction[i] += d_view[i]);
                d_distance += d_view[3];
            }
        }
        let along: f64 = (0..3).map(|i| heads.direction[i] * d_direction[i]).sum();
        for ((to, d), g) in back.position.iter_mut().zip(heads.direction).zip(d_direction) {
            *to += (g - d * along) / heads.distance + d * d_distance;
        }
        back
    }

    /// Cotangents of the anchor's own columns and of the heads' outputs.
    fn gaussians_backward(
        &self,
        anchor: &AnchorRef,
        heads: &HeadActivations,
        d: &[GaussianRef],
    ) -> (AnchorRef, [Vec<f64>; 3]) {
        let (k, c) = (self.shape.offsets, self.shape.features);
        let mut back = AnchorRef { offsets: vec![0.0; 3 * k], features: vec![0.0; c], ..AnchorRef::default() };
        let mut d_outputs = [vec![0.0; k], vec![0.0; 3 * k], vec![0.0; 7 * k]];
        for (j, d) in d.iter().enumerate().filter(|(j, _)| heads.outputs[0][*j] > 0.0) {
            let a = heads.outputs[0][j].tanh();
            d_outputs[0][j] = d.activation * (1.0 - a * a);
            for i in 0..3 {
                let rgb = sigmoid(heads.outputs[1][3 * j + i]);
                d_outputs[1][3 * j + i] = d.color[i] * rgb * (1.0 - rgb);
                let (s, l) = (sigmoid(heads.outputs[2][7 * j + i]), anchor.scales[3 + i]);
                d_outputs[2][7 * j + i] = d.scale[i] * l.abs() * s * (1.0 - s);
                back.scales[3 + i] += d.scale[i] * s * l.signum();
                back.position[i] += d.mean[i];
                back.offsets[3 * j + i] = d.mean[i] * anchor.scales[i];
                back.scales[i] += d.mean[i] * anchor.offsets[3 * j + i];
            }
            (0..4).for_each(|i| d_outputs[2][7 * j + 3 + i] = d.quat[i]);
        }
        (back, d_outputs)
    }
}

fn add_at(grads: &mut Blocks, name: &str, at: usize, d: f64) {
    if let Some(grad) = grads.get_mut(name) {
        grad[at] += d;
    }
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}
