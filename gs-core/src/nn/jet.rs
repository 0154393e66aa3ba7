//! A network together with its directional derivatives (forward mode), and the backward of both.
//!
//! ```text
//! z = W x + b,  y = φ(z)                    ż_k = W ẋ_k,  ẏ_k = φ'(z) ż_k               forward, k = 1 … K
//! dz = φ'(z) dy + φ''(z) Σ_k ż_k dẏ_k       dż_k = φ'(z) dẏ_k                           backward
//! ```
//! Losses on derivatives of a field by its inputs need this: forward mode for the derivatives, reverse mode over that.
//! The rows of a block and their derivatives along each direction are stacked, `[(1 + K) · rows, values]`, so every layer
//! is one product.
//!
//! ```
//! use gs_core::nn::{Init, JetTape, Mlp};
//!
//! let net = Mlp::new("net", &[2, 1], Init::FanIn, Init::FanIn, 1); // one linear layer
//! let mut tape = JetTape::default();
//! net.forward_jet(1, &[0.3, -0.2, 1.0, 0.0], &mut tape); // one row, and its derivative along the first input
//! assert_eq!(tape.output()[1], net.layers()[0].weight.value[0]);
//! ```

use super::activation::scale;
use super::gemm::Write;
use super::mlp::{Mlp, MlpGrad};
use fearless_simd::{Level, Simd, dispatch};

/// Intermediate values of one block, reused between steps.
#[derive(Clone, Debug, Default)]
pub struct JetTape {
    layers: Vec<Layer>,
    /// Scratch of the backward pass: cotangents of the current layer's output and input.
    d: [Vec<f32>; 2],
}

#[derive(Clone, Debug, Default)]
struct Layer {
    /// Outputs, `[(1 + K) · rows, outputs]`.
    y: Vec<f32>,
    /// `ż`, `[K · rows, outputs]`.
    rates: Vec<f32>,
    /// `φ'` and `φ''`, `[rows, outputs]`.
    slope: Vec<f32>,
    curvature: Vec<f32>,
}

impl JetTape {
    /// Output of the last forward pass, `[(1 + K) · rows, outputs]`.
    pub fn output(&self) -> &[f32] {
        self.layers.last().map_or(&[], |l| &l.y)
    }
}

impl Mlp {
    /// Forward of `x: [(1 + K) · rows, inputs]`: the inputs of `rows` rows, then their derivatives along each of `K`
    /// directions. The result is [`JetTape::output`].
    pub fn forward_jet(&self, rows: usize, x: &[f32], tape: &mut JetTape) {
        tape.layers.resize_with(self.layers().len(), Layer::default);
        let stacked = x.len() / self.inputs().max(1);
        for (i, layer) in self.layers().iter().enumerate() {
            let (before, rest) = tape.layers.split_at_mut(i);
            let Layer { y, rates, slope, curvature } = &mut rest[0];
            let values = rows * layer.outputs();
            y.clear();
            y.resize(stacked * layer.outputs(), 0.0);
            layer.start(&layer.bias.value, &mut y[..values]);
            layer.add_product(0..layer.inputs(), before.last().map_or(x, |l| &l.y), y);
            if self.is_active(i) {
                slope.resize(values, 0.0);
                curvature.resize(values, 0.0);
                let (value, tangents) = y.split_at_mut(values);
                rates.clear();
                rates.extend_from_slice(tangents);
                self.activation().apply_twice(value, slope, curvature);
                tangents.chunks_exact_mut(values.max(1)).for_each(|t| scale(slope, t));
            }
        }
    }

    /// Backward of [`Mlp::forward_jet`] for the same `x`, from cotangents `dy` of its whole output: adds to `grad` and
    /// overwrites `dx`, the cotangents of `x`, where given.
    pub fn backward_jet(
        &self,
        rows: usize,
        x: &[f32],
        tape: &mut JetTape,
        dy: &[f32],
        dx: Option<&mut [f32]>,
        grad: &mut MlpGrad,
    ) {
        let JetTape { layers, d: [d_out, d_in] } = tape;
        d_out.clear();
        d_out.extend_from_slice(dy);
        for (i, layer) in self.layers().iter().enumerate().rev() {
            let values = rows * layer.outputs();
            if self.is_active(i) {
                let Layer { rates, slope, curvature, .. } = &layers[i];
                dispatch!(Level::new(), simd => activation_backward(simd, [slope, curvature], rates, d_out));
            }
            let input = if i > 0 { &layers[i - 1].y } else { x };
            layer.backward_bias(&d_out[..values], &mut grad.0[i]);
            layer.backward_weight(0..layer.inputs(), input, d_out, &mut grad.0[i]);
            if i > 0 {
                d_in.resize(input.len(), 0.0);
                layer.backward_input(0..layer.inputs(), d_out, d_in, Write::Set);
                std::mem::swap(d_out, d_in);
            }
        }
        if let Some(dx) = dx {
            self.layers()[0].backward_input(0..self.inputs(), d_out, dx, Write::Set);
        }
    }
}

/// Cotangents of `z` and `ż` from those of `y` and `ẏ`, in place.
#[inline(always)]
fn activation_backward<S: Simd>(_: S, [slope, curvature]: [&[f32]; 2], rates: &[f32], d: &mut [f32]) {
    let (value, tangents) = d.split_at_mut(slope.len());
    value.iter_mut().zip(slope).for_each(|(d, s)| *d *= s);
    let width = slope.len().max(1);
    for (rates, tangent) in rates.chunks_exact(width).zip(tangents.chunks_exact_mut(width)) {
        for (((d, t), rate), (slope, curvature)) in
            value.iter_mut().zip(tangent).zip(rates).zip(slope.iter().zip(curvature))
        {
            *d += curvature * rate * *t;
            *t *= slope;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nn::{Activation, Init, MlpTape};
    use crate::{Params, Rng};

    /// f32 sums of at most 16 terms of order one, three layers, against f64.
    const TOLERANCE: f64 = 2e-5;

    fn random(n: usize, name: &str) -> Vec<f32> {
        let mut rng = Rng::new(2, name, 0, 0);
        (0..n).map(|_| rng.normal()).collect()
    }

    /// Value and derivatives along `directions` of one row, in f64.
    fn reference(params: &[Vec<f64>], x: &[f64], directions: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let mut rows: Vec<Vec<f64>> = std::iter::once(x.to_vec()).chain(directions.iter().cloned()).collect();
        for (i, pair) in params.chunks(2).enumerate() {
            let product = |row: &Vec<f64>| -> Vec<f64> {
                pair[0].chunks(row.len()).map(|w| w.iter().zip(row).map(|(w, x)| w * x).sum()).collect()
            };
            rows = rows.iter().map(product).collect();
            rows[0].iter_mut().zip(&pair[1]).for_each(|(z, b)| *z += b);
            if 2 * i + 2 < params.len() {
                let z = rows[0].clone();
                let sigmoid = |z: f64| 1.0 / (1.0 + (-z).exp());
                rows[0].iter_mut().for_each(|z| *z *= sigmoid(*z));
                for row in &mut rows[1..] {
                    row.iter_mut().zip(&z).for_each(|(v, &z)| *v *= sigmoid(z) * (1.0 + z * (1.0 - sigmoid(z))));
                }
            }
        }
        rows
    }

    fn wide(v: &[f32]) -> Vec<f64> {
        v.iter().map(|&v| f64::from(v)).collect()
    }

    /// `Σ d · (outputs and their derivatives)` over stacked rows.
    fn loss(params: &[Vec<f64>], rows: usize, x: &[f64], d: &[f64]) -> f64 {
        let (inputs, outputs) = (params[0].len() / params[1].len(), params[params.len() - 1].len());
        let stacked = x.len() / inputs;
        let row = |k: usize| x[k * inputs..][..inputs].to_vec();
        let one = |r: usize| -> f64 {
            let directions: Vec<_> = (1..stacked / rows).map(|k| row(k * rows + r)).collect();
            let out = reference(params, &row(r), &directions);
            let pairs = out.iter().enumerate().map(|(k, y)| (y, &d[(k * rows + r) * outputs..][..outputs]));
            pairs.map(|(y, d)| y.iter().zip(d).map(|(y, d)| y * d).sum::<f64>()).sum()
        };
        (0..rows).map(one).sum()
    }

    /// Values are those of the plain pass; derivatives and every gradient are differences of f64 loops.
    #[test]
    fn gradients_match_finite_differences_of_the_f64_loops() {
        for (rows, directions) in [(1, 0), (3, 1), (17, 3)] {
            let mut mlp = Mlp::new("t", &[4, 12, 7, 3], Init::FanIn, Init::FanIn, 1).with_activation(Activation::Silu);
            let (x, dy) = (random((1 + directions) * rows * 4, "x"), random((1 + directions) * rows * 3, "dy"));
            let (mut tape, mut grad, mut dx) = (JetTape::default(), MlpGrad::default(), vec![7.0; x.len()]);
            mlp.forward_jet(rows, &x, &mut tape);
            let mut plain = MlpTape::default();
            mlp.forward(&x[..rows * 4], &mut plain);
            for (a, b) in tape.output().iter().zip(plain.output()) {
                assert!((a - b).abs() <= 1e-6 * (1.0 + b.abs()), "{a} {b}");
            }
            grad.reset(&mlp);
            mlp.backward_jet(rows, &x, &mut tape, &dy, Some(&mut dx), &mut grad);
            mlp.add_grads(std::iter::once(&grad));

            let (mut params, mut grads) = (Vec::new(), Vec::new());
            mlp.visit(&mut |p| {
                params.push(wide(&p.value));
                grads.push(p.grad.clone());
            });
            let (mut x, dy, h) = (wide(&x), wide(&dy), 1e-5);
            let got: f64 = wide(tape.output()).iter().zip(&dy).map(|(y, d)| y * d).sum();
            let want = loss(&params, rows, &x, &dy);
            assert!((got - want).abs() < TOLERANCE * (1.0 + want.abs()));
            let check = |got: f32, hi: f64, lo: f64, what: &str| {
                let want = (hi - lo) / (2.0 * h);
                assert!((f64::from(got) - want).abs() < TOLERANCE * (1.0 + want.abs()), "{what}: {got} {want}");
            };
            for i in 0..x.len() {
                let at = x[i];
                let mut moved = |v: f64| {
                    x[i] = v;
                    loss(&params, rows, &x, &dy)
                };
                let (hi, lo) = (moved(at + h), moved(at - h));
                moved(at);
                check(dx[i], hi, lo, "dx");
            }
            for block in 0..params.len() {
                for i in 0..params[block].len() {
                    let at = params[block][i];
                    let mut moved = |v: f64| {
                        params[block][i] = v;
                        loss(&params, rows, &x, &dy)
                    };
                    let (hi, lo) = (moved(at + h), moved(at - h));
                    moved(at);
                    check(grads[block][i], hi, lo, "parameter");
                }
            }
        }
    }
}
