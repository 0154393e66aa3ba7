//! A [`PlaneNet`] in `f64`: one point at a time, every head separately.

use super::HexPlaneRef;
use crate::PlaneNet;
use gs_core::{Params, Time};
use std::collections::BTreeMap;

/// A [`PlaneNet`] in `f64`, one point at a time.
#[derive(Clone, Debug)]
pub struct PlaneNetRef {
    /// The planes that points are encoded by.
    pub hexplane: HexPlaneRef,
    /// Weights and biases by parameter name without the net's own name: `trunk.0.weight`, `hidden.bias`.
    pub layers: BTreeMap<String, Vec<f64>>,
    /// Head names in the order of the outputs.
    heads: Vec<String>,
}

/// Gradients of a [`PlaneNetRef`], shaped like it.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaneNetRefGrad {
    /// Gradients of [`HexPlaneRef::planes`], plane by plane.
    pub planes: Vec<Vec<f64>>,
    /// Gradients of [`PlaneNetRef::layers`], by parameter name.
    pub layers: BTreeMap<String, Vec<f64>>,
}

impl PlaneNetRef {
    /// Copies the parameters of a net with the given name and heads.
    pub fn new(name: &str, net: &PlaneNet, heads: &[&str]) -> Self {
        let mut layers = BTreeMap::new();
        let planes = format!("{name}.planes.");
        net.visit(&mut |p| {
            if !p.name.starts_with(&planes) {
                let short = p.name[name.len() + 1..].to_owned();
                layers.insert(short, p.value.iter().map(|&v| f64::from(v)).collect());
            }
        });
        let heads = heads.iter().map(|h| (*h).to_owned()).collect();
        Self { hexplane: HexPlaneRef::new(net.hexplane()), layers, heads }
    }

    /// Gradients of zero, shaped like this net.
    pub fn zero_grad(&self) -> PlaneNetRefGrad {
        PlaneNetRefGrad {
            planes: self.hexplane.planes.iter().map(|p| vec![0.0; p.len()]).collect(),
            layers: self.layers.iter().map(|(name, v)| (name.clone(), vec![0.0; v.len()])).collect(),
        }
    }

    fn dense(&self, name: &str, x: &[f64]) -> Vec<f64> {
        let (weight, bias) = (&self.layers[&format!("{name}.weight")], &self.layers[&format!("{name}.bias")]);
        let dot = |(w, b): (&[f64], &f64)| w.iter().zip(x).map(|(w, x)| w * x).sum::<f64>() + b;
        weight.chunks(x.len()).zip(bias).map(dot).collect()
    }

    /// Adds the gradients of `dense` to `grad`, returns the cotangent of `x`.
    fn dense_backward(&self, name: &str, x: &[f64], dy: &[f64], grad: &mut PlaneNetRefGrad) -> Vec<f64> {
        let (weight, bias) = (format!("{name}.weight"), format!("{name}.bias"));
        let mut dx = vec![0.0; x.len()];
        for (o, d) in dy.iter().enumerate() {
            for (i, x) in x.iter().enumerate() {
                grad.layers.entry(weight.clone()).and_modify(|g| g[o * dx.len() + i] += d * x);
                dx[i] += d * self.layers[&weight][o * dx.len() + i];
            }
            grad.layers.entry(bias.clone()).and_modify(|g| g[o] += d);
        }
        dx
    }

    /// Activations: features, then each trunk layer's, then the hidden layer of all heads, ReLUs done.
    fn activations(&self, p: [f64; 3], t: Time) -> Vec<Vec<f64>> {
        let mut all = vec![self.hexplane.features(p, t)];
        let trunk = self.layers.keys().filter(|k| k.starts_with("trunk.") && k.ends_with(".bias")).count();
        for name in (0..trunk).map(|i| format!("trunk.{i}")).chain(["hidden".to_owned()]) {
            let y = self.dense(&name, &all[all.len() - 1]);
            all.push(y.into_iter().map(|v| v.max(0.0)).collect());
        }
        all
    }

    /// The columns of the hidden layer that belong to a head.
    fn columns(&self, head: usize, hidden: usize) -> std::ops::Range<usize> {
        let width = hidden / self.heads.len();
        head * width..(head + 1) * width
    }

    /// Outputs of every head at one point (world units) and timestamp.
    pub fn outputs(&self, p: [f64; 3], t: Time) -> Vec<Vec<f64>> {
        let all = self.activations(p, t);
        let hidden = &all[all.len() - 1];
        let head = |(h, name): (usize, &String)| self.dense(name, &hidden[self.columns(h, hidden.len())]);
        self.heads.iter().enumerate().map(head).collect()
    }

    /// Backward of [`PlaneNetRef::outputs`]: adds to `grad`, returns the cotangent of `p`.
    pub fn backward(&self, p: [f64; 3], t: Time, d: &[Vec<f64>], grad: &mut PlaneNetRefGrad) -> [f64; 3] {
        let all = self.activations(p, t);
        let (hidden, below) = (&all[all.len() - 1], &all[..all.len() - 1]);
        let mut d_y = Vec::new();
        for (h, (name, d)) in self.heads.iter().zip(d).enumerate() {
            d_y.extend(self.dense_backward(name, &hidden[self.columns(h, hidden.len())], d, grad));
        }
        for (i, x) in below.iter().enumerate().rev() {
            d_y.iter_mut().zip(&all[i + 1]).for_each(|(d, y)| *d = if *y > 0.0 { *d } else { 0.0 });
            let name = if i + 1 == below.len() { "hidden".to_owned() } else { format!("trunk.{i}") };
            d_y = self.dense_backward(&name, x, &d_y, grad);
        }
        self.hexplane.backward(p, t, &d_y, &mut grad.planes)
    }
}
