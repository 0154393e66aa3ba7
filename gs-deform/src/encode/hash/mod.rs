//! Hash grid: a point in the unit cube to features, at several resolutions (Müller et al. 2022, Instant NGP), with a
//! growth of its own along every axis as Grid4D has it (Xu et al. 2024).
//!
//! ```text
//! p_d = x̂_d scale_{l,d}      i = ⌊p⌋      f = p − i      w = f² (3 − 2f)
//! feature_l = Σ over the eight corners c of the cell:  Π_d (c_d = i_d + 1 ? w_d : 1 − w_d) · table_l[index(c)]
//! ```
//! [`level`] says what `scale` and `index` are. Features stand level by level, two values each. Smoothstep weights make
//! the feature once differentiable in the point; the point itself gets no gradient here.
//! * **Outside**: a point with any coordinate outside `[0, 1]` (or not a number) has features of zero and moves nothing.
//! * **One third coordinate for all points** (a moment in time): [`HashGrid::slice`] blends the tables along it once,
//!   and a point reads four corners instead of eight; see [`slice`].
//! * **Back**: every task owns the tables of a few neighbouring levels and walks the points in order: no private copies,
//!   no atomics, the same sums for any number of threads.

pub mod config;
pub mod level;
mod place;
pub mod slice;
mod space;

use crate::DeformError;
use config::{FEATURES, HashGridConfig};
use fearless_simd::{Level as SimdLevel, dispatch};
use gs_core::{Param, Params, Rng};
use level::Level;
use place::{BLOCK, Cells, Points, Scratch};
use rayon::prelude::*;

/// Half the width of the interval that fresh tables are drawn from.
const INIT: f32 = 1e-4;

/// Where the features of a grid stand in a wider matrix `[points, stride]`: row `r` at `r · stride + offset`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Columns {
    /// Values from one row to the next.
    pub stride: usize,
    /// First column of this grid.
    pub offset: usize,
}

/// The encoder; see the [module](self).
#[derive(Clone, Debug)]
pub struct HashGrid {
    config: HashGridConfig,
    levels: Vec<Level>,
    table: Param,
    simd: SimdLevel,
}

impl HashGrid {
    /// A grid of the given size. Its tables are one block `name`, level by level, `[entries, 2]`, drawn from
    /// U(−1e-4, 1e-4).
    ///
    /// # Errors
    /// If the configuration cannot be built; the message names the key and the rule.
    pub fn new(name: &str, config: &HashGridConfig, seed: u64) -> Result<Self, DeformError> {
        config.check()?;
        let levels = Level::all(config);
        let mut value = vec![0.0; FEATURES * levels.iter().map(|l| l.entries).sum::<usize>()];
        let tables = split(&levels, &mut value);
        tables.into_par_iter().enumerate().for_each(|(l, table)| {
            let mut rng = Rng::new(seed, name, 0, l as u64);
            table.iter_mut().for_each(|v| *v = rng.range(-INIT, INIT));
        });
        Ok(Self { config: *config, levels, table: Param::shared(name, value), simd: SimdLevel::new() })
    }

    /// The same grid on a given instruction set, to compare them.
    pub fn with_simd(mut self, simd: SimdLevel) -> Self {
        self.simd = simd;
        self
    }

    /// Features per point: two per level.
    pub fn width(&self) -> usize {
        FEATURES * self.levels.len()
    }

    /// The configuration it was built from.
    pub fn config(&self) -> &HashGridConfig {
        &self.config
    }

    /// The levels, coarse to fine.
    pub fn levels(&self) -> &[Level] {
        &self.levels
    }

    /// The tables.
    pub fn table(&self) -> &Param {
        &self.table
    }

    /// The features of points of the unit cube, written to the columns `columns` of `out: [points, stride]`.
    pub fn forward(&self, points: &[[f32; 3]], out: &mut [f32], columns: Columns) {
        let rows = points.par_chunks(BLOCK).zip(out.par_chunks_mut(BLOCK * columns.stride));
        rows.for_each_init(Scratch::default, |(block, cells), (points, out)| {
            block.load(points.iter().copied());
            for l in 0..self.levels.len() {
                self.read(l, block, cells, &mut out[columns.offset + FEATURES * l..], columns.stride);
            }
        });
    }

    /// The way back of [`HashGrid::forward`]: adds to the tables' gradient.
    pub fn backward(&mut self, points: &[[f32; 3]], d_out: &[f32], columns: Columns) {
        let Self { levels, table, simd, .. } = self;
        let jobs = split(levels, &mut table.grad).into_par_iter().zip(&*levels).enumerate();
        jobs.with_max_len(1).for_each_init(Scratch::default, |(block, cells), (l, (grad, level))| {
            for (points, d_out) in points.chunks(BLOCK).zip(d_out.chunks(BLOCK * columns.stride)) {
                block.load(points.iter().copied());
                let d_out = &d_out[columns.offset + FEATURES * l..];
                scatter(*simd, level, grad, block, cells, d_out, columns.stride);
            }
        });
    }

    /// Features of a block of points in level `l`, at the front of rows `stride` apart.
    fn read(&self, l: usize, block: &Points, cells: &mut Cells, out: &mut [f32], stride: usize) {
        let level = &self.levels[l];
        let table = &self.table.value[FEATURES * level.start..][..FEATURES * level.entries];
        dispatch!(self.simd, simd => {
            cells.space(simd, level, block);
            if level.hashed {
                space::forward::<_, true>(simd, table, cells, block.rows, out, stride);
            } else {
                space::forward::<_, false>(simd, table, cells, block.rows, out, stride);
            }
        });
    }
}

/// The way back of [`HashGrid::read`].
fn scatter(
    simd: SimdLevel,
    level: &Level,
    grad: &mut [f32],
    block: &Points,
    cells: &mut Cells,
    d_out: &[f32],
    stride: usize,
) {
    dispatch!(simd, simd => {
        cells.space(simd, level, block);
        if level.hashed {
            space::backward::<_, true>(simd, grad, cells, block.rows, d_out, stride);
        } else {
            space::backward::<_, false>(simd, grad, cells, block.rows, d_out, stride);
        }
    });
}

/// The table of each level.
fn split<'a>(levels: &[Level], mut values: &'a mut [f32]) -> Vec<&'a mut [f32]> {
    let mut tables = Vec::with_capacity(levels.len());
    for level in levels {
        let (table, rest) = values.split_at_mut(FEATURES * level.entries);
        tables.push(table);
        values = rest;
    }
    tables
}

impl Params for HashGrid {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        f(&self.table);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        f(&mut self.table);
    }
}
