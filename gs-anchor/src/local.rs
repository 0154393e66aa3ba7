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

    /// Becomes `Σ w part`, reusing memory.
    ///
    /// # Panics
    /// If the parts have different numbers of anchors.
    pub fn blend(&mut self, parts: &[(&LocalAnchors, f32)]) {
        let Some((first, rest)) = parts.split_first() else { return };
        let column = |to: &mut Vec<f32>, of: fn(&LocalAnchors) -> &Vec<f32>| {
            to.clone_from(of(first.0));
            to.par_chunks_mut(CHUNK).enumerate().for_each(|(c, to)| {
                to.iter_mut().for_each(|v| *v *= first.1);
                for (part, w) in rest {
                    let from = &of(part)[c * CHUNK..c * CHUNK + to.len()];
                    to.iter_mut().zip(from).for_each(|(v, p)| *v += w * p);
                }
            });
        };
        column(&mut self.offsets, |l| &l.offsets);
        column(&mut self.features, |l| &l.features);
        column(&mut self.scales, |l| &l.scales);
        let position = |i: usize| -> Vec3 { parts.iter().map(|(part, w)| part.positions[i] * *w).sum() };
        self.positions.clear();
        self.positions.extend((0..first.0.len()).map(position));
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

    /// Becomes `by · d`, reusing memory: the cotangent of a part of [`LocalAnchors::blend`].
    pub fn scale_from(&mut self, d: &LocalAnchorsGrad, by: f32) {
        self.positions.clear();
        self.positions.extend(d.positions.iter().map(|g| *g * by));
        for (to, from) in
            [(&mut self.offsets, &d.offsets), (&mut self.features, &d.features), (&mut self.scales, &d.scales)]
        {
            to.clear();
            to.extend(from.iter().map(|g| g * by));
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
    fn a_blend_and_its_cotangents_are_sums_by_weight() {
        let shape = AnchorShape { offsets: 2, features: 3, dynamics: 0 };
        let local = |x: f32| {
            let mut local = LocalAnchors::default();
            Anchors::new(shape, &[Vec3::splat(x), Vec3::ZERO], &[x, 0.0]).activate(&mut local);
            local
        };
        let (a, b) = (local(0.0), local(1.0));
        let mut mixed = local(7.0);
        mixed.blend(&[(&a, 0.25), (&b, 0.75)]);
        assert_eq!(mixed.positions, [Vec3::splat(0.75), Vec3::ZERO]);
        assert!((mixed.scales[0] - (0.25 + 0.75 * 1f32.exp())).abs() < 1e-6 && mixed.scales[6..] == [1.0; 6]);
        assert_eq!((mixed.offsets.len(), mixed.features.len()), (12, 6));

        let (mut d, mut part) = <(LocalAnchorsGrad, LocalAnchorsGrad)>::default();
        d.reset(&a);
        (d.positions[1], d.offsets[3], d.features[2], d.scales[11]) = (Vec3::ONE, 2.0, 3.0, 4.0);
        part.scale_from(&d, 0.5);
        assert_eq!(
            (part.positions[1], part.offsets[3], part.features[2], part.scales[11]),
            (Vec3::splat(0.5), 1.0, 1.5, 2.0)
        );
        part.scale_from(&d, 1.0);
        assert_eq!(part, d);
    }

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
