//! A hash grid at one third coordinate for all points: every level becomes a plane.
//!
//! With `k`, `w` the cell and smoothstep weight of the third coordinate `t`, and `index` that of [`Level`]:
//!
//! ```text
//! plane_l[x, y] = (1 − w) · table_l[index(x, y, k)] + w · table_l[index(x, y, k + 1)]
//! ```
//! The same sum in another order: equal to the grid up to rounding. Hashed levels are blended node by node, too. The way
//! back gathers what each cell's four corners get (one register per cell), sums that into the plane, and hands the plane
//! to the two layers it was blended from.

use super::config::FEATURES;
use super::level::Level;
use super::place::{BLOCK, Cells, Scratch};
use super::{Columns, HashGrid, scatter, space, split};
use fearless_simd::{Simd, SimdBase, SimdCombine, SimdFloat, dispatch, f32x4, f32x8};
use rayon::prelude::*;

/// A level is blended if its plane has fewer nodes than this many times the points.
const NODES_PER_POINT: usize = 4;

/// Scratch of a slice, reused between calls.
#[derive(Clone, Debug, Default)]
pub struct Slice {
    /// The third coordinate.
    t: f32,
    levels: Vec<Plane>,
}

/// One level of a slice.
#[derive(Clone, Debug, Default)]
struct Plane {
    /// Whether the level is blended; otherwise the points read it in three dimensions.
    blended: bool,
    /// Cell along the third axis, and weight of the layer above it.
    k: u32,
    w: f32,
    /// `[res_y, res_x, 2]`.
    values: Vec<f32>,
    /// What the corners of each cell get, `[res_y − 1, res_x − 1]` of `[y][x][2]`.
    cells: Vec<[f32; 4 * FEATURES]>,
}

impl Slice {
    /// Levels that are blended; the others are read in three dimensions.
    pub fn blended(&self) -> usize {
        self.levels.iter().filter(|p| p.blended).count()
    }
}

impl HashGrid {
    /// Prepares the grid at third coordinate `t` for about `points` points: levels whose plane has fewer than four nodes
    /// per point are blended. To be called again after every change of the tables.
    pub fn slice(&self, t: f32, points: usize, slice: &mut Slice) {
        slice.t = t;
        slice.levels.resize_with(self.levels().len(), Plane::default);
        let table = &self.table.value;
        slice.levels.par_iter_mut().zip(self.levels()).for_each(|(plane, level)| {
            let values = &table[FEATURES * level.start..][..FEATURES * level.entries];
            plane.prepare(level, t, points);
            plane.blend(level, values);
        });
    }

    /// The features of points at the third coordinate of the slice; as [`HashGrid::forward`].
    pub fn forward_slice(&self, slice: &Slice, points: &[[f32; 2]], out: &mut [f32], columns: Columns) {
        let t = slice.t;
        let rows = points.par_chunks(BLOCK).zip(out.par_chunks_mut(BLOCK * columns.stride));
        rows.for_each_init(Scratch::default, |(block, cells), (points, out)| {
            block.load(points.iter().map(|&[x, y]| [x, y, t]));
            for (l, (plane, level)) in slice.levels.iter().zip(self.levels()).enumerate() {
                let out = &mut out[columns.offset + FEATURES * l..];
                if plane.blended {
                    dispatch!(self.simd, simd => {
                        cells.plane(simd, level, block);
                        forward(simd, plane, level, cells, block.rows, out, columns.stride);
                    });
                } else {
                    self.read(l, block, cells, out, columns.stride);
                }
            }
        });
    }

    /// The way back of [`HashGrid::forward_slice`] for the same points: adds to the tables' gradient.
    pub fn backward_slice(&mut self, slice: &mut Slice, points: &[[f32; 2]], d_out: &[f32], columns: Columns) {
        let Self { levels, table, simd, .. } = self;
        let t = slice.t;
        let jobs = split(levels, &mut table.grad).into_par_iter().zip(&mut slice.levels).zip(&*levels).enumerate();
        jobs.with_max_len(1).for_each_init(Scratch::default, |(block, cells), (l, ((grad, plane), level))| {
            plane.clear_cells(level);
            for (points, d_out) in points.chunks(BLOCK).zip(d_out.chunks(BLOCK * columns.stride)) {
                block.load(points.iter().map(|&[x, y]| [x, y, t]));
                let d_out = &d_out[columns.offset + FEATURES * l..];
                if plane.blended {
                    dispatch!(*simd, simd => {
                        cells.plane(simd, level, block);
                        backward(simd, plane, level, cells, block.rows, d_out, columns.stride);
                    });
                } else {
                    scatter(*simd, level, grad, block, cells, d_out, columns.stride);
                }
            }
            plane.spread(level, grad);
        });
    }
}

impl Plane {
    /// Chooses whether to blend, and the layers.
    fn prepare(&mut self, level: &Level, t: f32, points: usize) {
        let nodes = level.res[0] as usize * level.res[1] as usize;
        let inside = (0.0..=1.0).contains(&t);
        self.blended = nodes < NODES_PER_POINT.saturating_mul(points);
        let p = if inside { t * level.scale[2] } else { 0.0 };
        self.k = (p as u32).min(level.res[2] - 2);
        let f = p - self.k as f32;
        self.w = f * f * (3.0 - 2.0 * f);
    }

    fn blend(&mut self, level: &Level, table: &[f32]) {
        self.values.clear();
        if !self.blended {
            return;
        }
        let entries: &[[f32; FEATURES]] = table.as_chunks().0;
        for y in 0..level.res[1] {
            for x in 0..level.res[0] {
                let (low, high) = (entries[level.index([x, y, self.k])], entries[level.index([x, y, self.k + 1])]);
                self.values.extend((0..FEATURES).map(|f| low[f] + self.w * (high[f] - low[f])));
            }
        }
    }

    fn clear_cells(&mut self, level: &Level) {
        self.cells.clear();
        if self.blended {
            let cells = (level.res[0] as usize - 1) * (level.res[1] as usize - 1);
            self.cells.resize(cells, [0.0; 4 * FEATURES]);
        }
    }

    /// Hands what the cells' corners got to the two layers the plane was blended from.
    fn spread(&mut self, level: &Level, grad: &mut [f32]) {
        let entries: &mut [[f32; FEATURES]] = grad.as_chunks_mut().0;
        let across = level.res[0] - 1;
        for (cell, d) in self.cells.iter().enumerate() {
            let (x, y) = (cell as u32 % across, cell as u32 / across);
            for (corner, d) in d.as_chunks::<FEATURES>().0.iter().enumerate() {
                let (x, y) = (x + (corner as u32 & 1), y + (corner as u32 >> 1));
                for (k, w) in [(self.k, 1.0 - self.w), (self.k + 1, self.w)] {
                    let entry = &mut entries[level.index([x, y, k])];
                    entry.iter_mut().zip(d).for_each(|(g, d)| *g += w * d);
                }
            }
        }
    }
}

#[inline(always)]
fn forward<S: Simd>(simd: S, plane: &Plane, level: &Level, cells: &Cells, rows: usize, out: &mut [f32], stride: usize) {
    for (r, out) in out.chunks_mut(stride).take(rows).enumerate() {
        let at = (cells.x[r] + cells.rows[0][r]) as usize;
        let low = space::pair(simd, &plane.values, at) * f32x4::splat(simd, cells.rest[0][r]);
        let high = space::pair(simd, &plane.values, at + level.res[0] as usize);
        space::blend_pair(high.mul_add(f32x4::splat(simd, cells.rest[1][r]), low), cells.wx[r], out);
    }
}

#[inline(always)]
fn backward<S: Simd>(
    simd: S,
    plane: &mut Plane,
    level: &Level,
    cells: &Cells,
    rows: usize,
    d_out: &[f32],
    stride: usize,
) {
    for (r, d) in d_out.chunks(stride).take(rows).enumerate() {
        let y = cells.rows[0][r] / level.res[0];
        let cell = &mut plane.cells[(cells.x[r] + y * (level.res[0] - 1)) as usize];
        let share = space::share_pair(simd, cells.wx[r], d);
        let low = share * f32x4::splat(simd, cells.rest[0][r]);
        let both: f32x8<S> = low.combine(share * f32x4::splat(simd, cells.rest[1][r]));
        (f32x8::load_array_ref(simd, cell) + both).store_array(cell);
    }
}
