//! Colours that turn with their splats: a lobe that faces outwards in the canonical cloud faces outwards wherever its splat has
//! been carried. The turn counts as a constant, as displacements do: it learns from shapes, not from colours.

use gs_core::rot::{hamilton, matrix, normalise};
use gs_core::sh::{ShTurn, coeffs};
use gs_core::{Color, Splats};
use rayon::prelude::*;

/// Splats for each task.
const TASK: usize = 64;

/// Turns the colours of splats that were drawn as `canonical` and are now turned as `splats`.
pub(super) fn turn(canonical: &Splats, splats: &mut Splats) {
    if let Color::Sh { degree, coeffs } = &mut splats.color {
        every(*degree, &canonical.quats, &splats.quats, coeffs, |turn, sh| turn.apply(sh));
    }
}

/// The way back of [`turn`] for the cotangents of colours.
pub(super) fn turn_back(canonical: &Splats, splats: &Splats, d_color: &mut [f32]) {
    if let Color::Sh { degree, .. } = &splats.color {
        every(*degree, &canonical.quats, &splats.quats, d_color, |turn, d_sh| turn.apply_backward(d_sh));
    }
}

fn every(
    degree: u8,
    from: &[[f32; 4]],
    to: &[[f32; 4]],
    sh: &mut [f32],
    act: impl Fn(&ShTurn<f32>, &mut [f32]) + Sync,
) {
    if degree == 0 {
        return;
    }
    let width = 3 * coeffs(degree);
    let rows = sh.par_chunks_mut(TASK * width).zip(from.par_chunks(TASK).zip(to.par_chunks(TASK)));
    rows.for_each(|(sh, (from, to))| {
        for (sh, (from, to)) in sh.chunks_exact_mut(width).zip(from.iter().zip(to)) {
            let [w, x, y, z] = *from;
            let turn = normalise(hamilton(normalise(*to).wxyz, normalise([w, -x, -y, -z]).wxyz)).wxyz;
            act(&ShTurn::new(&matrix(turn), degree), sh);
        }
    });
}
