//! GAD at the key frames that a timestamp blends, forward and backward.

use gs_anchor::{Anchors, Gad, GadTape, LocalAnchors, LocalAnchorsGrad};
use gs_core::Time;

/// Scratch of the key frames of one view, reused between steps.
#[derive(Default)]
pub(super) struct KeyFrames {
    weights: Vec<f32>,
    tapes: Vec<GadTape>,
    /// Anchors at each, where they are several.
    locals: Vec<LocalAnchors>,
    d_part: LocalAnchorsGrad,
}

impl KeyFrames {
    /// Writes the anchors at the key frames, blended, to `out`.
    pub(super) fn forward(&mut self, gad: &Gad, anchors: &Anchors, keys: &[(Time, f32)], out: &mut LocalAnchors) {
        self.weights.clear();
        self.weights.extend(keys.iter().map(|k| k.1));
        if self.tapes.len() < keys.len() {
            self.tapes.resize_with(keys.len(), GadTape::default);
        }
        if let [(t, _)] = keys {
            gad.forward(anchors, *t, &mut self.tapes[0], out);
            return;
        }
        self.locals.resize_with(keys.len(), LocalAnchors::default);
        for ((t, _), (tape, local)) in keys.iter().zip(self.tapes.iter_mut().zip(&mut self.locals)) {
            gad.forward(anchors, *t, tape, local);
        }
        let parts: Vec<_> = self.locals.iter().zip(self.weights.iter().copied()).collect();
        out.blend(&parts);
    }

    /// Pulls the cotangents of [`Self::forward`]'s result into the gradients of anchors and field. The penalty on changes
    /// counts with `share`, each key frame with the size of its blending weight; returns the penalty.
    pub(super) fn backward(&mut self, gad: &mut Gad, anchors: &mut Anchors, d: &LocalAnchorsGrad, share: f32) -> f32 {
        if let [_] = self.weights[..] {
            return gad.backward(anchors, &mut self.tapes[0], d, share);
        }
        let mut penalty = 0.0;
        for (tape, w) in self.tapes.iter_mut().zip(&self.weights) {
            self.d_part.scale_from(d, *w);
            penalty += gad.backward(anchors, tape, &self.d_part, share * w.abs());
        }
        penalty
    }
}
