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
//!   and a point reads four corners instead of eight; see [`mod@slice`].
//! * **Back**: every task owns the tables of a few neighbouring levels and walks the points in order: no private copies,
//!   no atomics, the same sums for any number of threads.
//!
//! # What it leaves out
//! Levels share no cells, even at equal `res`: their `scale` differs. Tables in half precision: without an instruction
//! for the conversion that every machine has, they are read more slowly than `f32` at every size (bench `hash`). Points
//! are not sorted: measured along a Morton curve, splats on a surface lie too far apart to gain.

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
use std::ops::Range;

/// Points of a task on the way forward.
const CHUNK: usize = 1024;

/// Most levels of a group. Together they read cotangents by the cache line; one group is one task on the way back.
const GROUP: usize = 4;

/// Most entries of a group of several levels: half a megabyte stays in the second-level cache.
const GROUP_ENTRIES: usize = 1 << 16;

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
    groups: Vec<Range<usize>>,
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
        let groups = groups(&levels);
        Ok(Self { config: *config, levels, groups, table: Param::shared(name, value), simd: SimdLevel::new() })
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

    /// The way back of [`HashGrid::forward`]: adds to the tables' gradient.
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

/// Neighbouring levels that are worked on together.
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

/// One item per group: its levels, and what stands for them in `all`.
fn take_groups<'a, T>(groups: &[Range<usize>], mut all: &'a mut [T]) -> Vec<(Range<usize>, &'a mut [T])> {
    let mut jobs = Vec::with_capacity(groups.len());
    for group in groups {
        let (here, rest) = all.split_at_mut(group.len());
        jobs.push((group.clone(), here));
        all = rest;
    }
    jobs
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
