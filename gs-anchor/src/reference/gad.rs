//! [`Gad`] in `f64`: one anchor at a time.

use super::AnchorRef;
use crate::gad::{Activation, Dynamics, Factor};
use crate::{Anchors, Gad, GadHead};
use gs_core::Time;
use gs_deform::reference::{PlaneNetRef, PlaneNetRefGrad};

/// One canonical anchor, or its cotangent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RestRef {
    /// Position, offsets and features; `scales` holds the logarithms `λ`.
    pub anchor: AnchorRef,
    /// Logits of motion: none, one (shared) or two (global, local).
    pub logits: Vec<f64>,
}

/// A [`Gad`] in `f64`, one anchor at a time.
#[derive(Clone, Debug)]
pub struct GadRef {
    heads: Vec<GadHead>,
    /// How the logits scale the changes.
    pub dynamics: Dynamics,
    /// The network, with the heads of the field.
    pub net: PlaneNetRef,
    /// Use `σ` instead of masks in the forward, too: the function that the straight-through backward differentiates.
    pub surrogate: bool,
    /// Weight of one anchor's [`GadRef::squared_change`] in [`GadRef::backward`].
    pub change_weight: f64,
    /// The unit of changes of scales in it, world units; a constant.
    pub scale_unit: f64,
}

impl RestRef {
    /// Row `v` of the anchors, converted to `f64`.
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
    /// Copies the parameters of a field.
    pub fn new(gad: &Gad) -> Self {
        let heads = gad.config().heads.clone();
        let names: Vec<&str> = heads.iter().map(|h| h.name()).collect();
        let net = PlaneNetRef::new("gad", gad.net(), &names);
        let dynamics = gad.config().dynamics;
        Self { heads, dynamics, net, surrogate: false, change_weight: 0.0, scale_unit: 1.0 }
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

    /// The anchor deformed to canonical time `t_c`; its scales are linear.
    pub fn moved(&self, rest: &RestRef, t_c: Time) -> AnchorRef {
        let mut to = rest.anchor.clone();
        to.scales.iter_mut().for_each(|l| *l = l.exp());
        let factors = self.factors(&rest.logits);
        for (head, delta) in self.heads.iter().zip(self.net.outputs(rest.anchor.position, t_c)) {
            let factor = factors[usize::from(*head != GadHead::Positions)].0;
            column(&mut to, *head).iter_mut().zip(delta).for_each(|(v, d)| *v += factor * d);
        }
        to
    }

    /// The unit that changes of a column are penalised in, if they are.
    fn unit(&self, head: GadHead) -> Option<f64> {
        match head {
            GadHead::Positions => None,
            GadHead::Features | GadHead::Offsets => Some(1.0),
            GadHead::Scales => Some(self.scale_unit),
        }
    }

    /// Mean square changes of features, offsets and scales at canonical time `t_c`, summed.
    pub fn squared_change(&self, rest: &RestRef, t_c: Time) -> f64 {
        let (factor, _) = self.factors(&rest.logits)[1];
        let of = |(head, delta): (&GadHead, Vec<f64>)| {
            let unit = self.unit(*head)?;
            Some(delta.iter().map(|d| (factor * d / unit).powi(2)).sum::<f64>() / delta.len() as f64)
        };
        self.heads.iter().zip(self.net.outputs(rest.anchor.position, t_c)).filter_map(of).sum()
    }

    /// Backward of [`GadRef::moved`] and of the weighted [`GadRef::squared_change`]: adds to `grad`, returns the
    /// cotangent of the canonical anchor, whose position is a constant to the net.
    pub fn backward(&self, rest: &RestRef, t_c: Time, d: &AnchorRef, grad: &mut PlaneNetRefGrad) -> RestRef {
        let factors = self.factors(&rest.logits);
        let mut back = RestRef { anchor: d.clone(), logits: vec![0.0; rest.logits.len()] };
        let mut d_outputs = Vec::new();
        for (head, delta) in self.heads.iter().zip(self.net.outputs(rest.anchor.position, t_c)) {
            let which = usize::from(*head != GadHead::Positions);
            let (value, slope) = factors[which];
            let mut d = d.clone();
            let g = column(&mut d, *head);
            if let Some(unit) = self.unit(*head) {
                let by = 2.0 * self.change_weight / (delta.len() as f64 * unit * unit);
                g.iter_mut().zip(&delta).for_each(|(g, delta)| *g += by * value * delta);
            }
            let d_factor: f64 = g.iter().zip(&delta).map(|(g, delta)| g * delta).sum();
            if let Some(last) = back.logits.len().checked_sub(1) {
                back.logits[which.min(last)] += slope * d_factor;
            }
            d_outputs.push(g.iter().map(|g| value * g).collect::<Vec<f64>>());
        }
        (0..6).for_each(|i| back.anchor.scales[i] *= rest.anchor.scales[i].exp());
        self.net.backward(rest.anchor.position, t_c, &d_outputs, grad);
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
