//! Cells and interpolation weights of a block of points in a level, one array per quantity, computed sixteen at a time.
//!
//! ```text
//! p = x̂ · scale      i = min(⌊p⌋, res − 2)      f = p − i      w = f² (3 − 2f)
//! ```
//! A point with a coordinate outside `[0, 1]` (or NaN) counts as the origin with weights of zero.

use super::level::Level;
use fearless_simd::{Simd, SimdBase, SimdCvtTruncate, SimdFloat, f32x16, u32x16};

/// Points per block.
pub(super) const BLOCK: usize = 256;

const LANES: usize = 16;

/// Coordinates of a block of points.
pub(super) struct Points {
    /// Points in the block, at most [`BLOCK`].
    pub rows: usize,
    at: [[f32; BLOCK]; 3],
    /// 1 inside the cube, 0 outside.
    inside: [f32; BLOCK],
}

/// Cells of a block of points in one level.
pub(super) struct Cells {
    /// First coordinate of the cell.
    pub x: [u32; BLOCK],
    /// [`Level::row`] of the four (y, z) corners, y first; in a plane `res_x · y` in the first row only.
    pub rows: [[u32; BLOCK]; 4],
    /// Weight of the right neighbour along x.
    pub wx: [f32; BLOCK],
    /// Weights of the four (y, z) corners; in a plane of the two y neighbours.
    pub rest: [[f32; BLOCK]; 4],
}

/// Scratch of one task.
pub(super) type Scratch = (Points, Cells);

impl Default for Points {
    fn default() -> Self {
        Self { rows: 0, at: [[0.0; BLOCK]; 3], inside: [0.0; BLOCK] }
    }
}

impl Default for Cells {
    fn default() -> Self {
        Self { x: [0; BLOCK], rows: [[0; BLOCK]; 4], wx: [0.0; BLOCK], rest: [[0.0; BLOCK]; 4] }
    }
}

impl Points {
    /// Loads the coordinates of at most [`BLOCK`] points.
    #[inline(always)]
    pub(super) fn load(&mut self, points: impl ExactSizeIterator<Item = [f32; 3]>) {
        self.rows = points.len();
        for (r, p) in points.enumerate() {
            let inside = p.iter().all(|c| (0.0..=1.0).contains(c));
            self.inside[r] = if inside { 1.0 } else { 0.0 };
            for (column, c) in self.at.iter_mut().zip(p) {
                column[r] = if inside { c } else { 0.0 };
            }
        }
    }

    /// Rows rounded up to whole registers.
    #[inline(always)]
    fn lanes(&self) -> usize {
        self.rows.next_multiple_of(LANES)
    }

    /// Index and weight along axis `d` of the sixteen points from `at` on.
    #[inline(always)]
    fn along<S: Simd>(&self, simd: S, d: usize, at: usize, level: &Level) -> (u32x16<S>, f32x16<S>) {
        let p = f32x16::from_slice(simd, &self.at[d][at..at + LANES]) * f32x16::splat(simd, level.scale[d]);
        let i = u32x16::truncate_from(p).min(u32x16::splat(simd, level.res[d] - 2));
        let f = p - simd.cvt_f32_u32x16(i);
        (i, f * f * f32x16::splat(simd, -2.0).mul_add(f, f32x16::splat(simd, 3.0)))
    }
}

impl Cells {
    /// Cells in all three axes.
    #[inline(always)]
    pub(super) fn space<S: Simd>(&mut self, simd: S, level: &Level, points: &Points) {
        let one = f32x16::splat(simd, 1.0);
        for at in (0..points.lanes()).step_by(LANES) {
            let here = at..at + LANES;
            let (x, wx) = points.along(simd, 0, at, level);
            let (y, wy) = points.along(simd, 1, at, level);
            let (z, wz) = points.along(simd, 2, at, level);
            x.store_slice(&mut self.x[here.clone()]);
            wx.store_slice(&mut self.wx[here.clone()]);
            let inside = f32x16::from_slice(simd, &points.inside[here.clone()]);
            let (z0, z1) = ((one - wz) * inside, wz * inside);
            for (corner, w) in [(one - wy) * z0, wy * z0, (one - wy) * z1, wy * z1].into_iter().enumerate() {
                w.store_slice(&mut self.rest[corner][here.clone()]);
            }
            for (lane, r) in here.enumerate() {
                for corner in 0..4 {
                    self.rows[corner][r] = level.row(y[lane] + (corner as u32 & 1), z[lane] + (corner as u32 >> 1));
                }
            }
        }
    }

    /// Cells in the first two axes.
    #[inline(always)]
    pub(super) fn plane<S: Simd>(&mut self, simd: S, level: &Level, points: &Points) {
        let one = f32x16::splat(simd, 1.0);
        for at in (0..points.lanes()).step_by(LANES) {
            let here = at..at + LANES;
            let (x, wx) = points.along(simd, 0, at, level);
            let (y, wy) = points.along(simd, 1, at, level);
            x.store_slice(&mut self.x[here.clone()]);
            wx.store_slice(&mut self.wx[here.clone()]);
            let inside = f32x16::from_slice(simd, &points.inside[here.clone()]);
            ((one - wy) * inside).store_slice(&mut self.rest[0][here.clone()]);
            (wy * inside).store_slice(&mut self.rest[1][here.clone()]);
            (y * u32x16::splat(simd, level.res[0])).store_slice(&mut self.rows[0][here]);
        }
    }
}
