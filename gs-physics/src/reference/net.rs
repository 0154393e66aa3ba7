//! A network in `f64`, one point at a time, with directional derivatives.
//!
//! ```text
//! z = W x + b,  y = φ(z)          ż = W ẋ,  ẏ = φ'(z) ż
//! ```

use gs_core::nn::{Activation, Mlp};
use gs_core::{Param, Params};

/// Row 0 is the value at a point, row `k` its derivative along direction `k`.
pub type Jet = Vec<Vec<f64>>;

/// A multilayer perceptron in `f64`.
#[derive(Clone, Debug, PartialEq)]
pub struct NetRef {
    /// Weight and bias of each layer, first to last.
    pub params: Vec<Vec<f64>>,
    activation: Activation,
}

impl NetRef {
    /// A copy of `mlp`, which must have no activation after its last layer.
    pub fn new(mlp: &Mlp) -> Self {
        let mut params = Vec::new();
        mlp.visit(&mut |p: &Param| params.push(p.value.iter().map(|&v| f64::from(v)).collect()));
        Self { params, activation: mlp.activation() }
    }

    /// Zeros of the shape of the parameters.
    pub fn zeros(&self) -> Vec<Vec<f64>> {
        self.params.iter().map(|p| vec![0.0; p.len()]).collect()
    }

    fn layers(&self) -> usize {
        self.params.len() / 2
    }

    /// `[φ(z), φ'(z), φ''(z)]` of the activation.
    fn activation(&self, z: f64) -> [f64; 3] {
        match self.activation {
            Activation::Relu if z > 0.0 => [z, 1.0, 0.0],
            Activation::Relu => [0.0; 3],
            Activation::Silu => {
                let s = 1.0 / (1.0 + (-z).exp());
                [z * s, s * (1.0 + z * (1.0 - s)), s * (1.0 - s) * (2.0 + z * (1.0 - 2.0 * s))]
            }
        }
    }

    /// Input and output before its activation of each layer.
    fn run(&self, x: &Jet) -> Vec<(Jet, Jet)> {
        let mut tape: Vec<(Jet, Jet)> = Vec::new();
        for pair in self.params.chunks(2) {
            let x = tape.last().map_or_else(|| x.clone(), |(_, z)| self.activated(z));
            let product = |(k, row): (usize, &Vec<f64>)| {
                let linear = pair[0].chunks(row.len()).map(|w| w.iter().zip(row).map(|(w, x)| w * x).sum::<f64>());
                linear.zip(&pair[1]).map(|(y, b)| if k == 0 { y + b } else { y }).collect()
            };
            let z = x.iter().enumerate().map(product).collect();
            tape.push((x, z));
        }
        tape
    }

    fn activated(&self, z: &Jet) -> Jet {
        let row = |(k, row): (usize, &Vec<f64>)| {
            let both = row.iter().zip(&z[0]);
            both.map(|(&v, &z)| if k == 0 { self.activation(z)[0] } else { self.activation(z)[1] * v }).collect()
        };
        z.iter().enumerate().map(row).collect()
    }

    /// Outputs and their derivatives along the directions of `x`.
    pub fn forward(&self, x: &Jet) -> Jet {
        self.run(x).pop().map(|(_, z)| z).unwrap_or_default()
    }

    /// Backward of [`NetRef::forward`] for cotangents `d` of all outputs: adds to `grad`, returns the cotangents of `x`.
    pub fn backward(&self, x: &Jet, d: &Jet, grad: &mut [Vec<f64>]) -> Jet {
        let mut d = d.clone();
        for (i, (x, z)) in self.run(x).iter().enumerate().rev() {
            if i + 1 < self.layers() {
                d = self.deactivated(z, &d);
            }
            let (weight, inputs) = (&self.params[2 * i], x[0].len());
            grad[2 * i + 1].iter_mut().zip(&d[0]).for_each(|(g, d)| *g += d);
            let mut d_x = vec![vec![0.0; inputs]; x.len()];
            for ((x, d), d_x) in x.iter().zip(&d).zip(&mut d_x) {
                for (o, d) in d.iter().enumerate() {
                    for c in 0..inputs {
                        grad[2 * i][o * inputs + c] += d * x[c];
                        d_x[c] += d * weight[o * inputs + c];
                    }
                }
            }
            d = d_x;
        }
        d
    }

    /// Cotangents of `z` from those of its activation.
    fn deactivated(&self, z: &Jet, d: &Jet) -> Jet {
        let mut out = d.clone();
        for (c, &at) in z[0].iter().enumerate() {
            let [_, slope, second] = self.activation(at);
            out[0][c] = slope * d[0][c] + (1..z.len()).map(|k| second * z[k][c] * d[k][c]).sum::<f64>();
            out[1..].iter_mut().zip(&d[1..]).for_each(|(o, d)| o[c] = slope * d[c]);
        }
        out
    }
}

/// `γ(s p)` of coordinates `p` as a value, and its first and second derivatives by each entry's own coordinate; the
/// layout of [`gs_core::nn::encoding`].
pub fn encode(p: &[f64], scale: f64, bands: usize) -> [Vec<f64>; 3] {
    let at = |p: &f64| p * scale;
    let mut out = [p.iter().map(at).collect(), vec![scale; p.len()], vec![0.0; p.len()]];
    for k in 0..bands {
        let f = f64::from(1u32 << k);
        let rate = f * scale;
        let waves =
            [(|a: f64| [a.sin(), a.cos(), -a.sin()]) as fn(f64) -> [f64; 3], |a: f64| [a.cos(), -a.sin(), -a.cos()]];
        for wave in waves {
            for p in p {
                let [v, first, second] = wave(f * at(p));
                out[0].push(v);
                out[1].push(rate * first);
                out[2].push(rate * rate * second);
            }
        }
    }
    out
}
