//! Hash grid: from a point in the unit cube to features at several resolutions (Müller et al. 2022, Instant NGP), with
//! a growth factor per axis as in Grid4D (Xu et al. 2024).
//!
//! ```text
//! p_d = x̂_d scale_{l,d}      i = ⌊p⌋      f = p − i      w = f² (3 − 2f)
//! feature_l = Σ over the eight corners c of the cell:  Π_d (c_d = i_d + 1 ? w_d : 1 − w_d) · table_l[index(c)]
//! ```
//! [`level`] defines `scale` and `index`. Features are ordered level by level, two values each. Smoothstep weights make
//! the features once differentiable in the point; the point itself gets no gradient here.
//! * **Outside**: a point with any coordinate outside `[0, 1]` (or NaN) has features of zero and adds no gradient.
//! * **One third coordinate for all points** (a timestamp): [`HashGrid::slice`] blends the tables along it once, and a
//!   point reads four corners instead of eight; see [`mod@slice`].
//! * **Backward**: every task owns the tables of a few neighbouring levels and visits the points in order: no private
//!   copies, no atomics, the same sums for any number of threads.
//!
//! ```
//! use gs_core::Params;
//! use gs_deform::encode::{Columns, HashGrid, HashGridConfig};
//!
//! let config = HashGridConfig { base: [4.0; 3], end: [64.0; 3], levels: 5, log2_table: 10 };
//! let mut grid = HashGrid::new("grid", &config, 1)?;
//! assert_eq!((grid.width(), grid.levels()[0].hashed, grid.levels()[4].hashed), (10, false, true));
//! grid.visit_mut(&mut |table| table.value.fill(0.75));
//! let mut features = vec![0.0; 2 * 10];
//! grid.forward(&[[0.0, 0.0, 0.0], [0.5, 0.5, 1.5]], &mut features, Columns { stride: 10, offset: 0 });
//! assert_eq!(features[..10], [0.75; 10], "a constant table is a constant feature");
//! assert_eq!(features[10..], [0.0; 10], "outside the cube there is none");
//! # Ok::<(), gs_deform::DeformError>(())
//! ```
//!
//! # What it leaves out
//! Levels share no cells, even at equal `res`: their `scale` differs. No tables in half precision: without a conversion
//! instruction on every machine they are read more slowly than `f32` at every size (bench `hash`). Points are not
//! sorted: measured along a Morton curve, splats on a surface lie too far apart to gain.

mod cells;
pub mod config;
pub mod level;
pub mod slice;
mod space;

use crate::DeformError;
use cells::{BLOCK, Cells, Points, Scratch};
use config::{FEATURES, HashGridConfig};
use fearless_simd::{Level as SimdLevel, dispatch};
use gs_core::{Param, Params, Rng};
use level::Level;
use rayon::prelude::*;
use std::ops::Range;

/// Points of one forward task.
const CHUNK: usize = 1024;

/// Largest number of levels in a group. Together they read whole cache lines of cotangents; a group is one backward
/// task.
const GROUP: usize = 4;

/// Largest number of entries in a group of several levels: half a megabyte stays in the second-level cache.
const GROUP_ENTRIES: usize = 1 << 16;

/// Tables start uniform in ±this.
const INIT: f32 = 1e-4;

/// Where a grid's features lie in a wider matrix `[points, stride]`: row `r` starts at `r · stride + offset`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Columns {
    /// Values from one row to the next.
    pub stride: usize,
    /// First column of this grid.
    pub offset: usize,
}

/// A multi-resolution hash-grid encoder, `[0, 1]³ → [2 · levels]`; see the [module](self).
#[derive(Clone, Debug)]
pub struct HashGrid {
    config: HashGridConfig,
    levels: Vec<Level>,
    groups: Vec<Range<usize>>,
    table: Param,
    simd: SimdLevel,
}

impl HashGrid {
    /// A grid of the given size. Its tables are one parameter block `name`, level by level, `[entries, 2]`, uniform in
    /// ±1e-4.
    ///
    /// # Errors
    /// If a setting is out of its domain; the message names it.
    pub fn new(name: &str, config: &HashGridConfig, seed: u64) -> Result<Self, DeformError> {
        config.check()?;
        let levels = Level::all(config);
        let mut value = vec![0.0; FEATURES * levels.iter().map(|l| l.entries).sum::<usize>()];
        let tables = split(&levels, &mut value);
        tables.into_par_iter().enumerate().for_each(|(l, table)| {
            let mut rng = Rng::new(seed, name, 0, l as u64);
            table.iter_mut().for_each(|v| *v = rng.range(-INIT, INIT));
        });
        let groups = groups(&levels);
        Ok(Self { config: *config, levels, groups, table: Param::shared(name, value), simd: SimdLevel::new() })
    }

    /// The same grid on another instruction set, for comparison.
    pub fn with_simd(mut self, simd: SimdLevel) -> Self {
        self.simd = simd;
        self
    }

    /// Features per point: two per level.
    pub fn width(&self) -> usize {
        FEATURES * self.levels.len()
    }

    /// The configuration this grid was built from.
    pub fn config(&self) -> &HashGridConfig {
        &self.config
    }

    /// Size and layout of each level, coarse to fine.
    pub fn levels(&self) -> &[Level] {
        &self.levels
    }

    /// All tables as one block, level by level, `[entries, 2]`.
    pub fn table(&self) -> &Param {
        &self.table
    }

    /// Writes the features of points in the unit cube to the columns `columns` of `out: [points, stride]`.
    pub fn forward(&self, points: &[[f32; 3]], out: &mut [f32], columns: Columns) {
        let Columns { stride, offset } = columns;
        let chunks = points.par_chunks(CHUNK).zip(out.par_chunks_mut(CHUNK * stride));
        chunks.for_each_init(Scratch::default, |(block, cells), (points, out)| {
            for group in &self.groups {
                for (points, out) in points.chunks(BLOCK).zip(out.chunks_mut(BLOCK * stride)) {
                    block.load(points.iter().copied());
                    for l in group.clone() {
                        self.read(l, block, cells, &mut out[offset + FEATURES * l..], stride);
                    }
                }
            }
        });
    }

    /// Backward of [`HashGrid::forward`] for the same points: adds to the tables' gradient. `d_out` has the layout of
    /// `out`.
    pub fn backward(&mut self, points: &[[f32; 3]], d_out: &[f32], columns: Columns) {
        let Self { levels, groups, table, simd, .. } = self;
        let Columns { stride, offset } = columns;
        let mut tables = split(levels, &mut table.grad);
        let jobs = take_groups(groups, &mut tables);
        jobs.into_par_iter().with_max_len(1).for_each_init(Scratch::default, |(block, cells), (group, tables)| {
            for (points, d_out) in points.chunks(BLOCK).zip(d_out.chunks(BLOCK * stride)) {
                block.load(points.iter().copied());
                for (l, grad) in group.clone().zip(tables.iter_mut()) {
                    scatter(*simd, &levels[l], grad, block, cells, &d_out[offset + FEATURES * l..], stride);
                }
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

/// Backward of [`HashGrid::read`]: adds to `grad`, the gradient of the level's table.
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

/// Ranges of neighbouring levels that one task handles together.
fn groups(levels: &[Level]) -> Vec<Range<usize>> {
    let mut groups: Vec<Range<usize>> = Vec::new();
    let mut entries = 0;
    for (l, level) in levels.iter().enumerate() {
        entries += level.entries;
        match groups.last_mut() {
            Some(group) if group.len() < GROUP && entries <= GROUP_ENTRIES => group.end = l + 1,
            _ => {
                groups.push(l..l + 1);
                entries = level.entries;
            }
        }
    }
    groups
}

/// One job per group: its levels and their items of `all`.
fn take_groups<'a, T>(groups: &[Range<usize>], mut all: &'a mut [T]) -> Vec<(Range<usize>, &'a mut [T])> {
    let mut jobs = Vec::with_capacity(groups.len());
    for group in groups {
        let (here, rest) = all.split_at_mut(group.len());
        jobs.push((group.clone(), here));
        all = rest;
    }
    jobs
}

/// Splits all values into the table of each level.
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
