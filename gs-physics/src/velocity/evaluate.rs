//! Evaluation of the velocity's network at a block of points, with derivatives by position and time, forward and backward.

use super::VelocityConfig;
use super::flow::{BASIS, Coefficients, Flow};
use crate::vec3::V3;
use glam::Vec3;
use gs_core::nn::{JetTape, Mlp, MlpGrad, encoding};

/// The coordinates that derivatives are taken by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Derivatives {
    None = 0,
    /// By x, y and z.
    Space = 3,
    /// By x, y, z and t.
    SpaceTime = 4,
}

/// Activations and cotangents of a block of points, reused between calls.
#[derive(Clone, Debug, Default)]
pub(crate) struct Evaluation {
    rows: usize,
    /// Encoded positions and times, then their `K` derivatives, `[(1 + K) · rows, inputs]`.
    input: Vec<f32>,
    jet: JetTape,
    /// Cotangents of the network's outputs and inputs.
    d_out: Vec<f32>,
    d_input: Vec<f32>,
}

/// Width of an encoded position and time.
pub(crate) fn inputs(bands: usize) -> usize {
    encoding::width(3, bands).saturating_add(encoding::width(1, bands))
}

/// Writes `(γ(s x), γ(t))` of each row.
pub(crate) fn encode(config: &VelocityConfig, x: &[Vec3], t: &[f32], out: &mut [f32]) {
    let position = encoding::width(3, config.bands);
    for ((x, t), row) in x.iter().zip(t).zip(out.chunks_exact_mut(inputs(config.bands))) {
        let (position, time) = row.split_at_mut(position);
        encoding::encode(&(*x * config.coordinate_scale).to_array(), 3, config.bands, position);
        encoding::encode(&[*t], 1, config.bands, time);
    }
}

impl Evaluation {
    /// Evaluates `net` at positions and times (one of each per row).
    pub(crate) fn forward(&mut self, net: &Mlp, config: &VelocityConfig, x: &[Vec3], t: &[f32], by: Derivatives) {
        let (rows, width, position) = (x.len(), inputs(config.bands), encoding::width(3, config.bands));
        self.rows = rows;
        self.input.clear();
        self.input.resize((1 + by as usize) * rows * width, 0.0);
        let (values, tangents) = self.input.split_at_mut(rows * width);
        encode(config, x, t, values);
        for (k, tangents) in tangents.chunks_exact_mut((rows * width).max(1)).enumerate() {
            for (value, out) in values.chunks_exact(width).zip(tangents.chunks_exact_mut(width)) {
                if k < 3 {
                    encoding::tangent(&value[..position], 3, k, &mut out[..position]);
                    out[..position].iter_mut().for_each(|v| *v *= config.coordinate_scale);
                } else {
                    encoding::tangent(&value[position..], 1, 0, &mut out[position..]);
                }
            }
        }
        net.forward_jet(rows, &self.input, &mut self.jet);
    }

    fn coefficients(&self, i: usize) -> Coefficients<f32> {
        let mut out = [[0.0; BASIS]; 5];
        for (out, stacked) in out.iter_mut().zip(self.jet.output().chunks_exact(self.rows * BASIS)) {
            out.copy_from_slice(&stacked[i * BASIS..][..BASIS]);
        }
        out
    }

    /// The flow of row `i`, which lies at `r` relative to the origin.
    pub(crate) fn flow(&self, i: usize, r: V3<f32>) -> Flow<f32> {
        Flow::new(&self.coefficients(i), r)
    }

    /// Sets the cotangent of [`Evaluation::flow`]; gives that of `r`.
    pub(crate) fn set_cotangent(&mut self, i: usize, r: V3<f32>, d: &Flow<f32>) -> V3<f32> {
        let (d_c, d_r) = d.backward(&self.coefficients(i), r);
        self.d_out.resize(self.jet.output().len(), 0.0);
        for (d, out) in d_c.iter().zip(self.d_out.chunks_exact_mut(self.rows * BASIS)) {
            out[i * BASIS..][..BASIS].copy_from_slice(d);
        }
        d_r
    }

    /// From the cotangents, set for every row, to the weights; those of the positions are added to `d_x`, where given.
    pub(crate) fn backward(
        &mut self,
        net: &Mlp,
        config: &VelocityConfig,
        d_x: Option<&mut [Vec3]>,
        grad: &mut MlpGrad,
    ) {
        let rows = self.rows;
        let Self { input, jet, d_out, d_input, .. } = self;
        let Some(d_x) = d_x else {
            return net.backward_jet(rows, input, jet, d_out, None, grad);
        };
        d_input.resize(input.len(), 0.0);
        net.backward_jet(rows, input, jet, d_out, Some(d_input), grad);
        let (width, position) = (inputs(config.bands), encoding::width(3, config.bands));
        let row = |k: usize, i: usize| (k * rows + i) * width..(k * rows + i) * width + position;
        for (i, d_x) in d_x.iter_mut().enumerate() {
            let (value, mut d) = (&input[row(0, i)], [0.0; 3]);
            encoding::encode_backward(value, &d_input[row(0, i)], 3, config.bands, &mut d);
            let directions = input.len() / (rows * width) - 1;
            for k in 1..=directions.min(3) {
                let second = encoding::tangent_backward(value, &d_input[row(k, i)], 3, k - 1);
                d[k - 1] += config.coordinate_scale * second;
            }
            *d_x += Vec3::from_array(d) * config.coordinate_scale;
        }
    }
}
