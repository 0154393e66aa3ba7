//! One view of a training step: anchors to splats, and backward.

use super::Anchored;
use gs_anchor::visible::{self, SUPPORT, VisibilityOptions};
use gs_anchor::{DecodeTape, GadTape, LocalAnchors, LocalAnchorsGrad, Visible};
use gs_core::{Camera, Splats, SplatsGrad, Time, cast};
use gs_deform::{Field, HexPlaneField};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// The margin of the filter over the farthest motion met so far (MoDec-GS's filter has none).
pub(super) const ROOM: f64 = 1.5;
/// Splats compared by one task.
const PIECE: usize = 4096;

/// Which anchors are decoded for a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Filter {
    /// Those whose Gaussians may touch the frame: the same image as with all.
    Clean,
    /// Those whose own Gaussian, before deformation, touches a tile, while training; all of them otherwise (public code).
    Ref,
    /// All of them, in and out of view.
    Off,
}

/// Which views of a batch are observed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Statistics {
    /// All views of the batch.
    All,
    /// The last one (public code).
    Last,
}

/// Scratch of a view, reused between steps.
#[derive(Default)]
pub(super) struct Tape {
    pub local: LocalAnchors,
    d_local: LocalAnchorsGrad,
    gad: GadTape,
    pub decoded: DecodeTape,
    /// Decoded Gaussians before LGD moves them.
    neural: Splats,
    d_neural: SplatsGrad,
    lgd: <HexPlaneField as Field>::Tape,
    /// The splats that are rendered, after LGD.
    pub splats: Splats,
    pub d_splats: SplatsGrad,
    /// Whether LGD took part.
    moved: bool,
    listed: Vec<u32>,
}

impl Anchored {
    /// Fills the tape with the splats of a view.
    pub(super) fn forward(&mut self, t: Time, camera: &Camera) {
        let dynamic = self.dynamic();
        let canonical = self.motion.canonical_time(t);
        let tape = &mut self.tape;
        match &self.motion.gad {
            Some(gad) if dynamic => gad.forward(&self.anchors, canonical, &mut tape.gad, &mut tape.local),
            _ => self.anchors.activate(&mut tape.local),
        }
        tape.moved = dynamic && self.motion.lgd.is_some();
        while !self.forward_within(t, camera) {}
    }

    /// Decodes and moves what the present margin lets through; false if something moved farther than that.
    fn forward_within(&mut self, t: Time, camera: &Camera) -> bool {
        let tape = &mut self.tape;
        let margin = ROOM * f64::from(self.reach[0]);
        let visible = match self.config.filter {
            Filter::Off => Visible::All,
            Filter::Clean => {
                let reach =
                    VisibilityOptions { margin: if tape.moved { margin } else { 0.0 }, ..VisibilityOptions::default() };
                visible::conservative(&tape.local, camera, &reach, &mut tape.listed);
                Visible::List(&tape.listed)
            }
            Filter::Ref => {
                visible::published(&self.anchors, camera, &mut tape.listed);
                Visible::List(&tape.listed)
            }
        };
        let Some(lgd) = self.motion.lgd.as_ref().filter(|_| tape.moved) else {
            self.decoder.forward(&tape.local, visible, camera.position(), &mut tape.decoded, &mut tape.splats);
            return true;
        };
        self.decoder.forward(&tape.local, visible, camera.position(), &mut tape.decoded, &mut tape.neural);
        lgd.forward(&tape.neural, t, &mut tape.lgd, &mut tape.splats);
        let farthest = farthest(&tape.neural, &tape.splats);
        let held = self.config.filter != Filter::Clean || f64::from(farthest) <= margin;
        self.reach[0] = self.reach[0].max(farthest);
        held
    }

    /// Pulls the cotangents of the tape's splats into every gradient.
    pub(super) fn backward(&mut self) {
        let tape = &mut self.tape;
        tape.d_local.reset(&tape.local);
        let d_neural = match self.motion.lgd.as_mut().filter(|_| tape.moved) {
            Some(lgd) => {
                tape.d_neural.reset(&tape.neural);
                lgd.backward(&tape.neural, &mut tape.lgd, &tape.d_splats, &mut tape.d_neural);
                &tape.d_neural
            }
            None => &tape.d_splats,
        };
        self.decoder.backward(&tape.local, &mut tape.decoded, d_neural, &mut tape.d_local);
        let dynamic = self.at.dynamic;
        match self.motion.gad.as_mut().filter(|_| dynamic) {
            Some(gad) => gad.backward(&mut self.anchors, &mut tape.gad, &tape.d_local),
            None => self.anchors.activate_backward(&tape.local, &tape.d_local),
        }
    }
}

/// `max (‖Δμ‖ + w max |Δs|)` over all splats: how much farther one reaches than before, at most.
pub(super) fn farthest(before: &Splats, after: &Splats) -> f32 {
    let piece = |p: usize| {
        let rows = p * PIECE..before.len().min((p + 1) * PIECE);
        let grown = |i: usize| (after.scales[i] - before.scales[i]).abs().max_element();
        rows.map(|i| after.means[i].distance(before.means[i]) + cast::to_f32(SUPPORT) * grown(i)).fold(0.0, f32::max)
    };
    (0..before.len().div_ceil(PIECE)).into_par_iter().map(piece).reduce(|| 0.0, f32::max)
}
