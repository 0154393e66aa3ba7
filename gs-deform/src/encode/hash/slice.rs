//! A hash grid at one third coordinate for all points: every level becomes a plane.
//!
//! With `k`, `w` the cell and smoothstep weight of the third coordinate `t`, and `index` that of [`Level`]:
//!
//! ```text
//! plane_l[x, y] = (1 − w) · table_l[index(x, y, k)] + w · table_l[index(x, y, k + 1)]
//! ```
//! The same sum in another order: equal to the grid up to rounding. Hashed levels are blended node by node, too.
//! Backward sums the cotangents of each cell's four corners into the plane and adds the plane's gradient to the two
//! layers it was blended from.
//!
//! ```
//! use gs_deform::encode::{Columns, HashGrid, HashGridConfig, Slice};
//!
//! let config = HashGridConfig { base: [4.0; 3], end: [8.0; 3], levels: 2, log2_table: 10 };
//! let (grid, columns) = (HashGrid::new("grid", &config, 1)?, Columns { stride: 4, offset: 0 });
//! let (mut space, mut sliced, mut slice) = ([0.0; 4], [0.0; 4], Slice::default());
//! grid.forward(&[[0.2, 0.7, 0.4]], &mut space, columns);
//! grid.slice(0.4, 1000, &mut slice);
//! grid.forward_slice(&slice, &[[0.2, 0.7]], &mut sliced, columns);
//! assert!(space.iter().zip(sliced).all(|(a, b)| (a - b).abs() < 1e-10), "values are at most 1e-4");
//! # Ok::<(), gs_deform::DeformError>(())
//! ```

use super::cells::{BLOCK, Cells, Scratch};
use super::config::FEATURES;
use super::level::Level;
use super::{CHUNK, Columns, HashGrid, scatter, space, split, take_groups};
use fearless_simd::{Simd, SimdBase, SimdFloat, dispatch, f32x4};
use rayon::prelude::*;

/// A level is blended if its plane has fewer nodes than this many times the points.
const NODES_PER_POINT: usize = 4;

/// A [`HashGrid`] at one third coordinate, made by [`HashGrid::slice`]; memory is reused between calls.
#[derive(Clone, Debug, Default)]
pub struct Slice {
    /// The third coordinate of all points.
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
    /// The blended plane, `[res_y, res_x, 2]`.
    values: Vec<f32>,
    /// Gradient of `values`, same shape.
    d_values: Vec<f32>,
}

impl Slice {
    /// Number of levels that are blended into planes; the others are read in three dimensions.
    pub fn blended(&self) -> usize {
        self.levels.iter().filter(|p| p.blended).count()
    }
}

impl HashGrid {
    /// Prepares the grid at third coordinate `t` for about `points` points: levels whose plane has fewer than four
    /// nodes per point are blended. Call it again after every change of the tables.
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

    /// [`HashGrid::forward`] of the points `(x, y, t)`, with `t` the third coordinate of the slice.
    pub fn forward_slice(&self, slice: &Slice, points: &[[f32; 2]], out: &mut [f32], columns: Columns) {
        let (t, Columns { stride, offset }) = (slice.t, columns);
        let chunks = points.par_chunks(CHUNK).zip(out.par_chunks_mut(CHUNK * stride));
        chunks.for_each_init(Scratch::default, |(block, cells), (points, out)| {
            for group in &self.groups {
                for (points, out) in points.chunks(BLOCK).zip(out.chunks_mut(BLOCK * stride)) {
                    block.load(points.iter().map(|&[x, y]| [x, y, t]));
                    for l in group.clone() {
                        let (plane, level) = (&slice.levels[l], &self.levels[l]);
                        let out = &mut out[offset + FEATURES * l..];
                        if plane.blended {
                            dispatch!(self.simd, simd => {
                                cells.plane(simd, level, block);
                                forward(simd, plane, level, cells, block.rows, out, stride);
                            });
                        } else {
                            self.read(l, block, cells, out, stride);
                        }
                    }
                }
            }
        });
    }

    /// Backward of [`HashGrid::forward_slice`] for the same points: adds to the tables' gradient.
    pub fn backward_slice(&mut self, slice: &mut Slice, points: &[[f32; 2]], d_out: &[f32], columns: Columns) {
        let Self { levels, groups, table, simd, .. } = self;
        let (t, Columns { stride, offset }) = (slice.t, columns);
        let tables = split(levels, &mut table.grad);
        let mut tables: Vec<_> = tables.into_iter().zip(&mut slice.levels).collect();
        let jobs = take_groups(groups, &mut tables);
        jobs.into_par_iter().with_max_len(1).for_each_init(Scratch::default, |(block, cells), (group, tables)| {
            for (_, plane) in tables.iter_mut() {
                plane.clear_grad();
            }
            for (points, d_out) in points.chunks(BLOCK).zip(d_out.chunks(BLOCK * stride)) {
                block.load(points.iter().map(|&[x, y]| [x, y, t]));
                for (l, (grad, plane)) in group.clone().zip(tables.iter_mut()) {
                    let (level, d_out) = (&levels[l], &d_out[offset + FEATURES * l..]);
                    if plane.blended {
                        dispatch!(*simd, simd => {
                            cells.plane(simd, level, block);
                            backward(simd, plane, level, cells, block.rows, d_out, stride);
                        });
                    } else {
                        scatter(*simd, level, grad, block, cells, d_out, stride);
                    }
                }
            }
            for (l, (grad, plane)) in group.zip(tables) {
                plane.scatter_layers(&levels[l], grad);
            }
        });
    }
}

impl Plane {
    /// Chooses whether to blend, and the two layers around `t`.
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

    fn clear_grad(&mut self) {
        self.d_values.clear();
        self.d_values.resize(self.values.len(), 0.0);
    }

    /// Adds the plane's gradient to the two layers it was blended from.
    fn scatter_layers(&self, level: &Level, grad: &mut [f32]) {
        let width = level.res[0] as usize;
        let entries: &mut [[f32; FEATURES]] = grad.as_chunks_mut().0;
        for (y, row) in self.d_values.chunks_exact(FEATURES * width).enumerate() {
            for (k, w) in [(self.k, 1.0 - self.w), (self.k + 1, self.w)] {
                if level.hashed {
                    for (x, d) in row.as_chunks::<FEATURES>().0.iter().enumerate() {
                        let entry = &mut entries[level.index([x as u32, y as u32, k])];
                        *entry = [entry[0] + w * d[0], entry[1] + w * d[1]];
                    }
                } else {
                    let layer = &mut entries[level.index([0, y as u32, k])..][..width];
                    layer.as_flattened_mut().iter_mut().zip(row).for_each(|(g, d)| *g += w * d);
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
        let at = (cells.x[r] + cells.rows[0][r]) as usize;
        let share = space::share_pair(simd, cells.wx[r], d);
        space::add_pair(simd, &mut plane.d_values, at, share * f32x4::splat(simd, cells.rest[0][r]));
        let above = at + level.res[0] as usize;
        space::add_pair(simd, &mut plane.d_values, above, share * f32x4::splat(simd, cells.rest[1][r]));
    }
}
