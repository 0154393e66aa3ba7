//! One view of a training step: anchors to splats, and backward.

use super::Anchored;
use super::key_frames::KeyFrames;
use super::motion::Query;
use glam::Vec3;
use gs_anchor::visible::{self, SUPPORT, VisibilityOptions};
use gs_anchor::{DecodeTape, LgdTape, LocalAnchors, LocalAnchorsGrad, Visible};
use gs_core::{Camera, Geometry, GeometryRef, Splats, SplatsGrad, SplatsRef, Time, cast};
use gs_train::method::LossValue;
use gs_train::step::StepCtx;
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
    keys: KeyFrames,
    pub decoded: DecodeTape,
    /// Decoded Gaussians, before LGD.
    splats: Splats,
    /// Cotangents of what is rendered.
    pub d_splats: SplatsGrad,
    /// The anchors at rest and their cotangents, if LGD is asked there.
    rest: LocalAnchors,
    d_rest: LocalAnchorsGrad,
    /// Where LGD is asked about each decoded Gaussian, and cotangents of these places.
    places: Vec<Vec3>,
    d_places: Vec<Vec3>,
    lgd: LgdTape,
    /// Where LGD moved them, if it took part.
    moved: Geometry,
    d_decoded: Geometry,
    moves: bool,
    listed: Vec<u32>,
}

impl Tape {
    /// What is rendered, and the place for its cotangents.
    pub(super) fn rendered(&mut self) -> (SplatsRef<'_>, &mut SplatsGrad) {
        let geometry = if self.moves { self.moved.view() } else { self.splats.geometry() };
        (self.splats.with_geometry(geometry), &mut self.d_splats)
    }
}

impl Anchored {
    /// Fills the tape with the splats of a view.
    pub(super) fn forward(&mut self, t: Time, camera: &Camera) {
        let dynamic = self.dynamic();
        let keys = self.motion.keys(t);
        let tape = &mut self.tape;
        match &self.motion.gad {
            Some(gad) if dynamic => tape.keys.forward(gad, &self.anchors, &keys, &mut tape.local),
            _ => self.anchors.activate(&mut tape.local),
        }
        tape.moves = dynamic && self.motion.lgd.is_some();
        if tape.moves && self.motion.query == Query::Rest {
            self.anchors.activate(&mut tape.rest);
        }
        while !self.forward_within(t, camera) {}
    }

    /// Decodes and moves what the present margin lets through; false if something moved farther than that.
    fn forward_within(&mut self, t: Time, camera: &Camera) -> bool {
        let eye = camera.position();
        let tape = &mut self.tape;
        let margin = ROOM * f64::from(self.reach[0]);
        let visible = match self.config.filter {
            Filter::Off => Visible::All,
            Filter::Clean => {
                let margin = if tape.moves { margin } else { 0.0 };
                let reach = VisibilityOptions { margin, dilation: self.dilation };
                visible::conservative(&tape.local, camera, &reach, &mut tape.listed);
                Visible::List(&tape.listed)
            }
            Filter::Ref => {
                visible::published(&self.anchors, camera, &mut tape.listed);
                Visible::List(&tape.listed)
            }
        };
        self.decoder.forward(&tape.local, visible, eye, &mut tape.decoded, &mut tape.splats);
        let Some(lgd) = self.motion.lgd.as_ref().filter(|_| tape.moves) else { return true };
        match self.motion.query {
            Query::Moved => {
                lgd.forward_at(&tape.splats.means, tape.splats.geometry(), t, &mut tape.lgd, &mut tape.moved);
            }
            Query::Rest => {
                centers(&tape.rest, &tape.decoded.rows, self.config.offsets, &mut tape.places);
                lgd.forward_at(&tape.places, tape.splats.geometry(), t, &mut tape.lgd, &mut tape.moved);
            }
        }
        let farthest = farthest(tape.splats.geometry(), tape.moved.view());
        // What is not finite is met after the pass, where gradients are checked; no margin holds it.
        let held = self.config.filter != Filter::Clean || f64::from(farthest) <= margin || !farthest.is_finite();
        if farthest.is_finite() {
            self.reach[0] = self.reach[0].max(farthest);
        }
        held
    }

    /// Pulls the cotangents of the tape's splats into every gradient, with those of the penalty on what GAD changes. Returns
    /// that penalty, where there is one.
    pub(super) fn backward(&mut self) -> Option<LossValue> {
        let tape = &mut self.tape;
        tape.d_local.reset(&tape.local);
        if let Some(lgd) = self.motion.lgd.as_mut().filter(|_| tape.moves) {
            tape.d_decoded.reset(tape.splats.len());
            let (splats, d_splats) = (tape.splats.geometry(), tape.d_splats.geometry());
            match self.motion.query {
                Query::Moved => lgd.backward(splats, &mut tape.lgd, d_splats, &mut tape.d_decoded, None),
                Query::Rest => {
                    tape.d_places.clear();
                    tape.d_places.resize(splats.len(), Vec3::ZERO);
                    let d_places = Some(&mut tape.d_places[..]);
                    lgd.backward(splats, &mut tape.lgd, d_splats, &mut tape.d_decoded, d_places);
                    tape.d_rest.reset(&tape.rest);
                    let rows = &tape.decoded.rows;
                    centers_backward(&tape.rest, rows, self.config.offsets, &tape.d_places, &mut tape.d_rest);
                    self.anchors.activate_backward(&tape.rest, &tape.d_rest);
                }
            }
            tape.d_splats.swap_geometry(&mut tape.d_decoded);
        }
        self.decoder.backward(&tape.local, &mut tape.decoded, &tape.d_splats, &mut tape.d_local);
        let StepCtx { dynamic, batch, .. } = self.at;
        let Some(gad) = self.motion.gad.as_mut().filter(|_| dynamic) else {
            self.anchors.activate_backward(&tape.local, &tape.d_local);
            return None;
        };
        let penalty = tape.keys.backward(gad, &mut self.anchors, &tape.d_local, 1.0 / batch.max(1) as f32);
        (gad.config().change_l2 > 0.0).then_some(("global_change", penalty))
    }
}

/// Centre `x + O ⊙ l` of the Gaussian of a row (`anchor · offsets + j`).
pub(super) fn center(local: &LocalAnchors, row: u32, offsets: usize) -> Vec3 {
    let (row, anchor) = (row as usize, row as usize / offsets);
    local.positions[anchor]
        + Vec3::from_slice(&local.offsets[3 * row..]) * Vec3::from_slice(&local.scales[6 * anchor..])
}

/// The centres of the Gaussians of `rows`.
pub(super) fn centers(local: &LocalAnchors, rows: &[u32], offsets: usize, out: &mut Vec<Vec3>) {
    rows.par_iter().map(|row| center(local, *row, offsets)).collect_into_vec(out);
}

/// Backward of [`centers`]: adds to the cotangents of the anchors.
fn centers_backward(local: &LocalAnchors, rows: &[u32], offsets: usize, d: &[Vec3], out: &mut LocalAnchorsGrad) {
    for (row, d) in rows.iter().map(|r| *r as usize).zip(d) {
        let anchor = row / offsets;
        let (offset, scale) =
            (Vec3::from_slice(&local.offsets[3 * row..]), Vec3::from_slice(&local.scales[6 * anchor..]));
        out.positions[anchor] += *d;
        out.offsets[3 * row..][..3].iter_mut().zip((*d * scale).to_array()).for_each(|(to, v)| *to += v);
        out.scales[6 * anchor..][..3].iter_mut().zip((*d * offset).to_array()).for_each(|(to, v)| *to += v);
    }
}

/// `max (‖Δμ‖ + w max |Δs|)` over all splats: how much farther one reaches than before, at most.
pub(super) fn farthest(before: GeometryRef<'_>, after: GeometryRef<'_>) -> f32 {
    let piece = |p: usize| {
        let rows = p * PIECE..before.len().min((p + 1) * PIECE);
        let grown = |i: usize| (after.scales[i] - before.scales[i]).abs().max_element();
        rows.map(|i| after.means[i].distance(before.means[i]) + cast::to_f32(SUPPORT) * grown(i)).fold(0.0, f32::max)
    };
    (0..before.len().div_ceil(PIECE)).into_par_iter().map(piece).reduce(|| 0.0, f32::max)
}
