//! The inner loops in three dimensions: eight corners of one point in one level, forward and backward.
//!
//! The two neighbours along x are one register of four values. In a dense table they lie side by side. Everything is a
//! function marked `inline(always)`, never a closure: only then does the instruction set chosen at run time reach it.

use super::cells::Cells;
use super::config::FEATURES;
use fearless_simd::{Simd, SimdBase, SimdFloat, f32x4};

/// The values of the neighbours `x`, `x + 1` of a row of a dense table.
#[inline(always)]
pub(super) fn pair<S: Simd>(simd: S, table: &[f32], first: usize) -> f32x4<S> {
    f32x4::from_slice(simd, &table[FEATURES * first..][..2 * FEATURES])
}

/// Adds to the neighbours `x`, `x + 1` of a row of a dense table.
#[inline(always)]
pub(super) fn add_pair<S: Simd>(simd: S, grad: &mut [f32], first: usize, d: f32x4<S>) {
    let here = &mut grad[FEATURES * first..][..2 * FEATURES];
    (f32x4::from_slice(simd, here) + d).store_slice(here);
}

/// Entries of the two neighbours along x in a hashed table.
#[inline(always)]
fn hashed_pair(x: u32, row: u32, mask: usize) -> [usize; 2] {
    [(x ^ row) as usize & mask, ((x + 1) ^ row) as usize & mask]
}

/// Blend of a pair of neighbours along x, written to a row of features.
#[inline(always)]
pub(super) fn blend_pair<S: Simd>(sum: f32x4<S>, wx: f32, out: &mut [f32]) {
    let sum = sum.to_array();
    for (f, out) in out[..FEATURES].iter_mut().enumerate() {
        *out = sum[f] + wx * (sum[FEATURES + f] - sum[f]);
    }
}

/// Backward of [`blend_pair`]: the cotangents of the two neighbours along x.
#[inline(always)]
pub(super) fn share_pair<S: Simd>(simd: S, wx: f32, d: &[f32]) -> f32x4<S> {
    let (left, right) = (1.0 - wx, wx);
    f32x4::load_array(simd, [left * d[0], left * d[1], right * d[0], right * d[1]])
}

/// Features of a block of points in one level: row `r` goes to `out[r · stride ..][..2]`.
#[inline(always)]
pub(super) fn forward<S: Simd, const HASHED: bool>(
    simd: S,
    table: &[f32],
    cells: &Cells,
    rows: usize,
    out: &mut [f32],
    stride: usize,
) {
    let entries: &[[f32; FEATURES]] = table.as_chunks().0;
    let mask = entries.len() - 1;
    for (r, out) in out.chunks_mut(stride).take(rows).enumerate() {
        let mut sum = f32x4::splat(simd, 0.0);
        for corner in 0..4 {
            let (x, row) = (cells.x[r], cells.rows[corner][r]);
            let values = if HASHED {
                let [a, b] = hashed_pair(x, row, mask);
                let (a, b) = (entries[a], entries[b]);
                f32x4::load_array(simd, [a[0], a[1], b[0], b[1]])
            } else {
                pair(simd, table, (x + row) as usize)
            };
            sum = values.mul_add(f32x4::splat(simd, cells.rest[corner][r]), sum);
        }
        blend_pair(sum, cells.wx[r], out);
    }
}

/// Backward of [`forward`]: adds to the table's gradient, points in order.
#[inline(always)]
pub(super) fn backward<S: Simd, const HASHED: bool>(
    simd: S,
    grad: &mut [f32],
    cells: &Cells,
    rows: usize,
    d_out: &[f32],
    stride: usize,
) {
    let mask = grad.len() / FEATURES - 1;
    for (r, d) in d_out.chunks(stride).take(rows).enumerate() {
        let share = share_pair(simd, cells.wx[r], d);
        for corner in 0..4 {
            let (x, row) = (cells.x[r], cells.rows[corner][r]);
            let d = share * f32x4::splat(simd, cells.rest[corner][r]);
            if HASHED {
                let d = d.to_array();
                let entries: &mut [[f32; FEATURES]] = grad.as_chunks_mut().0;
                let [a, b] = hashed_pair(x, row, mask);
                entries[a] = [entries[a][0] + d[0], entries[a][1] + d[1]];
                entries[b] = [entries[b][0] + d[2], entries[b][1] + d[3]];
            } else {
                add_pair(simd, grad, (x + row) as usize, d);
            }
        }
    }
}
