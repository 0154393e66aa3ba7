//! Colours that turn with their splats: a lobe that faces outwards in the canonical cloud faces outwards wherever its splat has
//! been carried. The turn counts as a constant, as displacements do: it learns from shapes, not from colours. Splats that did
//! not turn, and colours without lobes, cost nothing.

use gs_core::Color;
use gs_core::rot::{conjugate, hamilton, matrix, normalise};
use gs_core::sh::{ShRotation, coeffs};
use rayon::prelude::*;

/// Splats for each task.
const TASK: usize = 64;

/// Turns the colours of splats whose rotations were `from` and are now `to`.
pub(super) fn turn(from: &[[f32; 4]], to: &[[f32; 4]], color: &mut Color) {
    if let Color::Sh { degree, coeffs } = color {
        every(*degree, from, to, coeffs, |turn, sh| turn.apply(sh));
    }
}

/// The way back of [`turn`] for the cotangents of colours.
pub(super) fn turn_back(color: &Color, from: &[[f32; 4]], to: &[[f32; 4]], d_color: &mut [f32]) {
    if let Color::Sh { degree, .. } = color {
        every(*degree, from, to, d_color, |turn, d_sh| turn.apply_backward(d_sh));
    }
}

fn every(
    degree: u8,
    from: &[[f32; 4]],
    to: &[[f32; 4]],
    sh: &mut [f32],
    act: impl Fn(&ShRotation<f32>, &mut [f32]) + Sync,
) {
    if degree == 0 {
        return;
    }
    let width = 3 * coeffs(degree);
    let rows = sh.par_chunks_mut(TASK * width).zip(from.par_chunks(TASK).zip(to.par_chunks(TASK)));
    rows.for_each(|(sh, (from, to))| {
        for (sh, (from, to)) in sh.chunks_exact_mut(width).zip(from.iter().zip(to)) {
            if from != to {
                let turn = hamilton(normalise(*to).wxyz, conjugate(normalise(*from).wxyz));
                act(&ShRotation::new(&matrix(turn), degree), sh);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Quaternions of any length above the floor of `normalise`, and zero, say how they are turned and nothing else; what did not turn keeps its bits.
    #[test]
    fn lengths_of_quaternions_do_not_matter() {
        let unit = [0.5f32, -0.1, 0.7, 0.5];
        let sh: Vec<f32> = (0..48).map(|i| (i as f32 * 0.37).sin()).collect();
        let turned = |from: [f32; 4], to: [f32; 4]| {
            let mut color = Color::Sh { degree: 3, coeffs: sh.clone() };
            turn(&[from], &[to], &mut color);
            let Color::Sh { coeffs, .. } = color else { panic!("colours keep their kind") };
            coeffs
        };
        let off = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert_eq!(turned(unit, unit), sh);
        let want = turned([1.0, 0.0, 0.0, 0.0], unit);
        assert!(off(&want, &sh) > 0.1, "it turns");
        for length in [1e-9, 1e-3, 1e18] {
            assert!(off(&turned(unit, unit.map(|v| v * length)), &sh) < 1e-5, "{length}");
            assert!(off(&turned([length, 0.0, 0.0, 0.0], unit), &want) < 1e-5, "{length}");
        }
        assert!(off(&turned([0.0; 4], unit), &sh) < 1e-5, "zero has no direction: nothing turns");
    }
}
