//! [`Gad`] in `f64`: one anchor at a time.

use super::AnchorRef;
use crate::gad::{Activation, Dynamics, Factor};
use crate::{Anchors, Gad, GadHead};
use gs_core::Time;
use gs_deform::reference::{PlaneNetRef, PlaneNetRefGrad};

/// One anchor at rest; or its cotangent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RestRef {
    /// Position, offsets, features; `scales` hold the logarithms `λ`.
    pub anchor: AnchorRef,
    /// None, one or two.
    pub logits: Vec<f64>,
}

/// A field in `f64`: see [`Gad`] for the mathematics.
#[derive(Clone, Debug)]
pub struct GadRef {
    heads: Vec<GadHead>,
    /// What the factors follow from.
    pub dynamics: Dynamics,
    /// The net.
    pub net: PlaneNetRef,
    /// Masks are weights by `σ`, forward too: what their way back differentiates.
    pub surrogate: bool,
}

impl RestRef {
    /// Anchor `v`.
    pub fn new(anchors: &Anchors, v: usize) -> Self {
        let row = |p: &gs_core::Param| -> Vec<f64> {
            let width = p.len() / anchors.len();
            p.value[v * width..][..width].iter().map(|&v| f64::from(v)).collect()
        };
        let scales = row(&anchors.log_scales);
        let anchor = AnchorRef {
            position: anchors.position(v).as_dvec3().to_array(),
            offsets: row(&anchors.offsets),
            features: row(&anchors.features),
            scales: std::array::from_fn(|i| scales[i]),
        };
        Self { anchor, logits: anchors.logits(v).iter().map(|&d| f64::from(d)).collect() }
    }
}

impl GadRef {
    /// A copy of a field.
    pub fn new(gad: &Gad) -> Self {
        let heads = gad.config().heads.clone();
        let names: Vec<&str> = heads.iter().map(|h| h.name()).collect();
        let net = PlaneNetRef::new("gad", gad.net(), &names);
        Self { heads, dynamics: gad.config().dynamics, net, surrogate: false }
    }

    /// Global and local factor, and their slopes.
    fn factors(&self, logits: &[f64]) -> [(f64, f64); 2] {
        let of = |factor: Factor, d: f64| {
            let s = 1.0 / (1.0 + (-d).exp());
            let open = if s > f64::from(self.dynamics.threshold) { 1.0 } else { 0.0 };
            match (factor, self.dynamics.activation) {
                (Factor::Mask, _) => (if self.surrogate { s } else { open }, s * (1.0 - s)),
                (Factor::Mul, Activation::Sigmoid) => (s, s * (1.0 - s)),
                (Factor::Mul, Activation::Relu) => (d.max(0.0), if d > 0.0 { 1.0 } else { 0.0 }),
                (Factor::Mul, Activation::Tanh) => (d.tanh(), 1.0 - d.tanh().powi(2)),
            }
        };
        match logits {
            [] => [(1.0, 0.0); 2],
            [d] => [of(self.dynamics.global, *d), of(self.dynamics.local, *d)],
            [g, l, ..] => [of(self.dynamics.global, *g), of(self.dynamics.local, *l)],
        }
    }

    /// The anchor at a canonical time; its scales are linear.
    pub fn moved(&self, rest: &RestRef, t_c: Time) -> AnchorRef {
        let mut to = rest.anchor.clone();
        to.scales.iter_mut().for_each(|l| *l = l.exp());
        let factors = self.factors(&rest.logits);
        for (head, said) in self.heads.iter().zip(self.net.outputs(rest.anchor.position, t_c)) {
            let factor = factors[usize::from(*head != GadHead::Positions)].0;
            column(&mut to, *head).iter_mut().zip(said).for_each(|(v, d)| *v += factor * d);
        }
        to
    }

    /// The way back of [`GadRef::moved`]: adds to `grad`, returns the cotangent of the anchor at rest, whose place is a
    /// constant to the net.
    pub fn backward(&self, rest: &RestRef, t_c: Time, d: &AnchorRef, grad: &mut PlaneNetRefGrad) -> RestRef {
        let factors = self.factors(&rest.logits);
        let mut back = RestRef { anchor: d.clone(), logits: vec![0.0; rest.logits.len()] };
        let mut d_said = Vec::new();
        for (head, said) in self.heads.iter().zip(self.net.outputs(rest.anchor.position, t_c)) {
            let which = usize::from(*head != GadHead::Positions);
            let (value, slope) = factors[which];
            let mut d = d.clone();
            let g = column(&mut d, *head);
            let d_factor: f64 = g.iter().zip(&said).map(|(g, s)| g * s).sum();
            if let Some(last) = back.logits.len().checked_sub(1) {
                back.logits[which.min(last)] += slope * d_factor;
            }
            d_said.push(g.iter().map(|g| value * g).collect::<Vec<f64>>());
        }
        (0..6).for_each(|i| back.anchor.scales[i] *= rest.anchor.scales[i].exp());
        self.net.backward(rest.anchor.position, t_c, &d_said, grad);
        back
    }
}

/// The column of an anchor that a head changes.
fn column(anchor: &mut AnchorRef, head: GadHead) -> &mut [f64] {
    match head {
        GadHead::Positions => &mut anchor.position,
        GadHead::Features => &mut anchor.features,
        GadHead::Offsets => &mut anchor.offsets,
        GadHead::Scales => &mut anchor.scales,
    }
}
