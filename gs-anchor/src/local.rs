//! Activated anchors, canonical or deformed for an interval, and their cotangents: the decoder's input.
//!
//! ```text
//! x' = x     O' = O     f' = f     l' = exp λ          canonical; gad changes all four
//! d_x += d_x'     d_O += d_O'     d_f += d_f'     d_λ += d_l' ⊙ l'
//! ```
//! ```
//! use gs_anchor::{AnchorShape, Anchors, LocalAnchors, LocalAnchorsGrad};
//!
//! let shape = AnchorShape { offsets: 2, features: 4, dynamics: 0 };
//! let mut anchors = Anchors::new(shape, &[glam::Vec3::X], &[2f32.ln()]);
//! let (mut local, mut d) = (LocalAnchors::default(), LocalAnchorsGrad::default());
//! anchors.activate(&mut local);
//! assert_eq!(local.scales, [2.0; 6]);
//! d.reset(&local);
//! d.scales.fill(0.5);
//! anchors.activate_backward(&local, &d);
//! assert_eq!(anchors.log_scales.grad, [1.0; 6], "d_l exp λ");
//! ```

use crate::Anchors;
use glam::Vec3;
use rayon::prelude::*;

/// Activated anchors, `V` rows. A clone is a cache: decoding it gives the same bits.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LocalAnchors {
    /// Positions `x'`, `[V]`, world units.
    pub positions: Vec<Vec3>,
    /// Offsets `O'`, `[V, k, 3]`, in units of the first three scales.
    pub offsets: Vec<f32>,
    /// Features `f'`, `[V, C]`, inputs of the decoder's heads.
    pub features: Vec<f32>,
    /// Scales `l'`, `[V, 6]`, world units, linear: three multiply the offsets, three the extents. May be negative.
    pub scales: Vec<f32>,
}

/// Cotangents of a [`LocalAnchors`]: the same columns, `dL/d…` each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LocalAnchorsGrad {
    /// `dL/d positions`, `[V]`.
    pub positions: Vec<Vec3>,
    /// `dL/d offsets`, `[V, k, 3]`.
    pub offsets: Vec<f32>,
    /// `dL/d features`, `[V, C]`.
    pub features: Vec<f32>,
    /// `dL/d scales`, `[V, 6]`, with respect to the linear scales.
    pub scales: Vec<f32>,
}

/// Values per parallel task.
const CHUNK: usize = 1 << 14;

impl LocalAnchors {
    /// Number of anchors, `V`.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether [`LocalAnchors::len`] is 0.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }
}

impl LocalAnchorsGrad {
    /// Resizes all columns to `local` and fills them with zeros, reusing memory.
    pub fn reset(&mut self, local: &LocalAnchors) {
        self.positions.clear();
        self.positions.resize(local.len(), Vec3::ZERO);
        for (d, n) in [
            (&mut self.offsets, local.offsets.len()),
            (&mut self.features, local.features.len()),
            (&mut self.scales, local.scales.len()),
        ] {
            d.clear();
            d.resize(n, 0.0);
        }
    }
}

impl Anchors {
    /// Writes the canonical anchors to `out`, reusing memory.
    pub fn activate(&self, out: &mut LocalAnchors) {
        out.positions.clear();
        out.positions.extend(self.positions.value.as_chunks().0.iter().map(|p| Vec3::from_array(*p)));
        out.offsets.clone_from(&self.offsets.value);
        out.features.clone_from(&self.features.value);
        out.scales.resize(self.log_scales.len(), 0.0);
        out.scales.par_chunks_mut(CHUNK).zip(self.log_scales.value.par_chunks(CHUNK)).for_each(|(to, from)| {
            to.iter_mut().zip(from).for_each(|(l, log)| *l = log.exp());
        });
    }

    /// Backward of [`Anchors::activate`]: adds to the gradients. `local` is the output of the forward.
    pub fn activate_backward(&mut self, local: &LocalAnchors, d: &LocalAnchorsGrad) {
        self.add_grads(&local.scales, d);
    }

    /// [`Anchors::activate_backward`] with `scales` = `exp λ`.
    pub(crate) fn add_grads(&mut self, scales: &[f32], d: &LocalAnchorsGrad) {
        add(&mut self.positions.grad, d.positions.iter().flat_map(|p| p.to_array()));
        add(&mut self.offsets.grad, d.offsets.iter().copied());
        add(&mut self.features.grad, d.features.iter().copied());
        add(&mut self.log_scales.grad, d.scales.iter().zip(scales).map(|(d, l)| d * l));
    }
}

fn add(grad: &mut [f32], d: impl Iterator<Item = f32>) {
    grad.iter_mut().zip(d).for_each(|(g, d)| *g += d);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AnchorShape;
    use gs_core::Rng;

    #[test]
    fn activation_and_its_gradient() {
        let shape = AnchorShape { offsets: 2, features: 3, dynamics: 0 };
        let mut anchors = Anchors::new(shape, &[Vec3::ONE, Vec3::NEG_X], &[0.0, 2f32.ln()]);
        let mut rng = Rng::new(1, "local", 0, 0);
        for p in [&mut anchors.offsets, &mut anchors.features] {
            p.value.iter_mut().for_each(|v| *v = rng.normal());
        }
        let mut local = LocalAnchors { scales: vec![9.0; 40], ..LocalAnchors::default() };
        anchors.activate(&mut local);
        assert_eq!((&local.positions[..], local.len()), (&[Vec3::ONE, Vec3::NEG_X][..], 2));
        assert_eq!((&local.offsets, &local.features), (&anchors.offsets.value, &anchors.features.value));
        assert_eq!((local.scales.len(), local.scales[0], local.scales[11]), (12, 1.0, 2.0));

        let mut d = LocalAnchorsGrad::default();
        d.reset(&local);
        d.positions[1] = Vec3::new(1.0, 2.0, 3.0);
        d.offsets[5] = 4.0;
        d.features[2] = 5.0;
        d.scales[7] = 6.0;
        for times in 1..=2 {
            anchors.activate_backward(&local, &d);
            let n = times as f32;
            assert_eq!(anchors.positions.grad[3..], [n, 2.0 * n, 3.0 * n]);
            assert_eq!((anchors.offsets.grad[5], anchors.features.grad[2]), (4.0 * n, 5.0 * n));
            assert_eq!(anchors.log_scales.grad[7], 6.0 * 2.0 * n, "times exp λ");
        }
    }
}
