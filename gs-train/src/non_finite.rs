//! Gradients that are not finite: each such row is set to zero and counted, before it can reach a weight that
//! all splats share.

use glam::Vec3;
use gs_core::SplatsGrad;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Rows per parallel block.
const BLOCK: usize = 2048;

/// Gradient rows that were not finite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(crate) struct NonFinite {
    /// Number of rows that were set to zero.
    pub rows: u32,
    /// Lowest of these rows; absent if there is none.
    pub first: Option<u32>,
}

/// Sets every row with an entry that is not finite to zero, in all columns, and counts such rows.
pub(crate) fn zero_non_finite(d: &mut SplatsGrad) -> NonFinite {
    let bad = bad_rows(d);
    let width = d.color.len() / d.means.len().max(1);
    let kernel = d.kernel.len() / d.means.len().max(1);
    for &row in &bad {
        let i = row as usize;
        d.means[i] = Vec3::ZERO;
        d.quats[i] = [0.0; 4];
        d.scales[i] = Vec3::ZERO;
        d.opacities[i] = 0.0;
        d.color[i * width..(i + 1) * width].fill(0.0);
        d.kernel[i * kernel..(i + 1) * kernel].fill(0.0);
    }
    NonFinite { rows: bad.len() as u32, first: bad.first().copied() }
}

fn bad_rows(d: &SplatsGrad) -> Vec<u32> {
    let n = d.means.len();
    let blocks: Vec<Vec<u32>> = (0..n.div_ceil(BLOCK))
        .into_par_iter()
        .map(|block| {
            let rows = block * BLOCK..((block + 1) * BLOCK).min(n);
            if block_is_finite(d, rows.clone()) {
                return Vec::new();
            }
            rows.filter(|&i| !block_is_finite(d, i..i + 1)).map(|i| i as u32).collect()
        })
        .collect();
    blocks.concat()
}

/// `x · 0` is NaN exactly where `x` is not finite; a sum of them keeps it.
fn block_is_finite(d: &SplatsGrad, rows: std::ops::Range<usize>) -> bool {
    let flat = |column: &'_ Vec<f32>| {
        let width = column.len() / d.means.len().max(1);
        probe(&column[rows.start * width..rows.end * width])
    };
    let vectors = d.means[rows.clone()].iter().zip(&d.scales[rows.clone()]).map(|(a, b)| *a * 0.0 + *b * 0.0);
    let probe = vectors.sum::<Vec3>().element_sum()
        + probe(d.quats[rows.clone()].as_flattened())
        + probe(&d.opacities[rows.clone()])
        + flat(&d.color)
        + flat(&d.kernel);
    probe.is_finite()
}

fn probe(values: &[f32]) -> f32 {
    let mut lanes = [0.0f32; 16];
    let (chunks, tail) = values.as_chunks::<16>();
    for chunk in chunks {
        lanes.iter_mut().zip(chunk).for_each(|(l, v)| *l += v * 0.0);
    }
    lanes.iter().sum::<f32>() + tail.iter().map(|v| v * 0.0).sum::<f32>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::{Color, Kernel, Splats};

    #[test]
    fn bad_rows_are_zeroed_in_every_column() {
        let n = 5000;
        let splats = Splats {
            means: vec![Vec3::ZERO; n],
            quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
            scales: vec![Vec3::ONE; n],
            opacities: vec![0.5; n],
            color: Color::Sh { degree: 1, coeffs: vec![0.0; 12 * n] },
            kernel: Kernel::Frequency { lambdas: vec![0.5; n], betas: vec![0.5; n] },
        };
        let mut d = SplatsGrad::zeros_like(&splats);
        d.opacities.fill(1.0);
        assert_eq!(zero_non_finite(&mut d), NonFinite::default());
        d.means[7].y = f32::NAN;
        d.quats[2100][3] = f32::INFINITY;
        d.scales[2101].z = f32::NEG_INFINITY;
        d.opacities[4000] = f32::NAN;
        d.color[12 * 4999 + 11] = f32::NAN;
        d.kernel[2 * 4500 + 1] = f32::NAN;
        assert_eq!(zero_non_finite(&mut d), NonFinite { rows: 6, first: Some(7) });
        assert_eq!(d.first_non_finite(), None);
        assert_eq!((d.opacities[7], d.opacities[8], d.opacities[4999]), (0.0, 1.0, 0.0));
    }
}
