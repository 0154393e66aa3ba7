//! HexPlane: a four-dimensional grid factored into six feature planes (Cao and Johnson 2023; Fridovich-Keil et al.
//! 2023, K-planes), at several resolutions, as 4D Gaussian Splatting uses it (Wu et al. 2024, Eqs. 3 to 5).
//!
//! ```text
//! h^m(x, y, z, t) = xy·xz·xt·yz·yt·zt     each a bilinear sample of a plane of level m, product per channel
//! h = (h^1, …, h^L)
//! ```
//! * **Levels** multiply the spatial resolution only. Planes with time start at 1, the others at U(0.1, 0.5).
//! * **Space**: the box [`Aabb`] spans nodes `0 … R−1` of each axis; a point outside is clamped to the nearest face and
//!   has no gradient across it (on the face itself neither).
//! * **Time**: normalised time 0 … 1 falls on rows `(R−1)/2 … R−1` of the time axis, as in the reference, which feeds
//!   raw time into an axis made for [−1, 1]. Rows below `⌊(R−1)/2⌋` are never read there and are not stored here;
//!   values and the weights of the regularisers are the same. Times above 1 are
//!   clamped to it; times below 0 to the first stored row, which lies at 0 where R is odd and half a row before it where R is even.
//! * **Layout**: `[channels / 16][nodes_b][nodes_a][16]`: sixteen channels of a node are one register and one load.
//! * **One time per call**: the two rows of a time plane around the timestamp are blended into a line once, so a point
//!   reads 18 texels instead of 24 (exact up to rounding).
//! * **Static points**: [`HexPlane::place`] finds their cells once, for any number of calls at any times while the
//!   planes are trained ([`HexPlane::forward_located`]; the same arithmetic, hence the same bits).
//! * **Backward**: channels are independent, so each group of sixteen channels of a level is one task that owns its
//!   slices of all six gradients and visits the points in order: no private copies, no atomics, the same sums for any
//!   number of threads. At most `levels · channels / 16` tasks run at once.
//!
//! ```
//! use gs_core::{Params, Time};
//! use gs_deform::{Aabb, encode::{HexPlane, HexPlaneConfig, HexTape}};
//!
//! let config = HexPlaneConfig { resolution: [4, 4, 4, 3], levels: vec![1, 2], channels: 16, ..Default::default() };
//! let mut encoder = HexPlane::new("hex", &config, Aabb::cube(1.0), 1)?;
//! encoder.visit_mut(&mut |plane| plane.value.fill(0.5));
//! let mut tape = HexTape::default();
//! encoder.forward(&[glam::Vec3::splat(0.3)], Time::new(0.7)?, &mut tape);
//! assert_eq!(tape.blocks[0].features, [0.5f32.powi(6); 32], "two levels of 16 channels, each a product of six planes");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use super::backward::TaskScratch;
use super::config::HexPlaneConfig;
use super::sample::{self, Cell, Group, LANES, Texel};
use super::smooth;
use crate::{Aabb, DeformError};
use fearless_simd::{Level as SimdLevel, Simd, dispatch};
use glam::Vec3;
use gs_core::nn::BLOCK;
use gs_core::{Param, Params, Rng, Time};
use rayon::prelude::*;
use std::sync::Arc;

/// Pairs of axes (x y z t = 0 1 2 3) in storage order, fast axis first.
pub(crate) const PAIRS: [(usize, usize); 6] = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];
/// Names of [`PAIRS`] in parameter names.
const PAIR_NAMES: [&str; 6] = ["xy", "xz", "xt", "yz", "yt", "zt"];
/// The spatial planes and the time planes among [`PAIRS`].
const SPACE: [usize; 3] = [0, 1, 3];
const TIME: [usize; 3] = [2, 4, 5];

/// The six planes of one resolution.
#[derive(Clone, Debug)]
pub(super) struct Level {
    /// Nodes along x, y, z, and stored rows of t.
    pub nodes: [usize; 4],
    pub planes: [Param; 6],
}

/// A HexPlane encoder, `(point, t) → [levels · channels]`; see the [module](self).
#[derive(Clone, Debug)]
pub struct HexPlane {
    config: HexPlaneConfig,
    aabb: Aabb,
    pub(super) levels: Vec<Level>,
    pub(super) simd: SimdLevel,
}

/// Activations of a [`HexPlane`] between forward and backward, reused between calls.
#[derive(Clone, Debug, Default)]
pub struct HexTape {
    pub(super) time: Cell,
    pub(super) lines: Vec<Texel>,
    pub(super) places: GridCells,
    /// The points in blocks of [`BLOCK`] rows; the last may be shorter.
    pub blocks: Vec<HexBlock>,
    pub(super) tasks: Vec<TaskScratch>,
}

/// The grid cells of some points at every level of a [`HexPlane`]: the part of its work that depends on points and
/// resolutions only. Made by [`HexPlane::place`]; cheap to clone.
#[derive(Clone, Debug, Default)]
pub struct GridCells(pub(super) Arc<Vec<BlockCells>>);

/// The cells of one block of points.
#[derive(Clone, Debug, Default)]
pub(super) struct BlockCells {
    pub rows: usize,
    /// `[levels, rows]`: the cells along x, y, z.
    pub cells: Vec<[Cell; 3]>,
}

/// Features and their cotangents for one block of points.
#[derive(Clone, Debug, Default)]
pub struct HexBlock {
    /// `[rows, width]`, level by level; written by [`HexPlane::forward`].
    pub features: Vec<f32>,
    /// Cotangents of `features`, same shape: the caller fills them in before [`HexPlane::backward`].
    pub d_features: Vec<f32>,
}

impl GridCells {
    /// Number of points, over all blocks.
    pub fn len(&self) -> usize {
        self.0.iter().map(|b| b.rows).sum()
    }

    /// Whether [`GridCells::len`] is 0.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl HexPlane {
    /// An encoder over the box `aabb`, its planes named `{name}.{pair}.{level}`: planes with time are 1, the others
    /// uniform in 0.1 … 0.5.
    ///
    /// # Errors
    /// If a setting is out of its domain; the message names it.
    pub fn new(name: &str, config: &HexPlaneConfig, aabb: Aabb, seed: u64) -> Result<Self, DeformError> {
        config.check()?;
        let level = |(index, &factor): (usize, &usize)| {
            let nodes = config.nodes(factor);
            let planes = std::array::from_fn(|p| {
                let (a, b) = PAIRS[p];
                let name = format!("{name}.{}.{index}", PAIR_NAMES[p]);
                let mut rng = Rng::new(seed, &name, 0, 0);
                let start = || if b == 3 { 1.0 } else { rng.range(0.1, 0.5) };
                let n = nodes[a] * nodes[b] * config.channels;
                Param::shared(name, std::iter::repeat_with(start).take(n).collect())
            });
            Level { nodes, planes }
        };
        let levels = config.levels.iter().enumerate().map(level).collect();
        Ok(Self { config: config.clone(), aabb, levels, simd: SimdLevel::new() })
    }

    /// The same encoder on another instruction set, for comparison.
    pub fn with_simd(mut self, simd: SimdLevel) -> Self {
        self.simd = simd;
        self
    }

    /// Features per point: channels times levels.
    pub fn width(&self) -> usize {
        self.config.channels * self.levels.len()
    }

    /// The configuration this encoder was built from.
    pub fn config(&self) -> &HexPlaneConfig {
        &self.config
    }

    /// The box that the planes span, world units.
    pub fn aabb(&self) -> Aabb {
        self.aabb
    }

    /// The plane of pair `pair` (xy xz xt yz yt zt = 0 … 5) at level `level`.
    pub fn plane(&self, level: usize, pair: usize) -> &Param {
        &self.levels[level].planes[pair]
    }

    /// Groups of sixteen channels per level.
    pub(super) fn groups(&self) -> usize {
        self.config.channels / LANES
    }

    /// Encodes points (`means`, world units) at one timestamp; the features are in `tape.blocks`.
    pub fn forward(&self, means: &[Vec3], t: Time, tape: &mut HexTape) {
        match Arc::get_mut(&mut tape.places.0) {
            Some(own) => self.locate(means, own),
            None => tape.places = self.place(means),
        }
        self.encode(t, tape);
    }

    /// Finds the cells of points that will be encoded many times. They are valid for every encoder of the same box,
    /// resolution and levels, whatever its planes hold.
    pub fn place(&self, means: &[Vec3]) -> GridCells {
        let mut blocks = Vec::new();
        self.locate(means, &mut blocks);
        GridCells(Arc::new(blocks))
    }

    /// [`HexPlane::forward`] for points whose cells are known: the same bits.
    pub fn forward_located(&self, places: &GridCells, t: Time, tape: &mut HexTape) {
        tape.places = places.clone();
        self.encode(t, tape);
    }

    fn encode(&self, t: Time, tape: &mut HexTape) {
        self.blend_time(t, tape);
        let HexTape { lines, places, blocks, .. } = tape;
        blocks.resize_with(places.0.len(), HexBlock::default);
        blocks.par_iter_mut().zip(&*places.0).for_each(|(block, places)| {
            block.features.resize(places.rows * self.width(), 0.0);
            dispatch!(self.simd, simd => self.sample(simd, lines, places, &mut block.features));
        });
    }

    /// Blends the two rows of each time plane around `t` into lines `[level][group][x, y, z][nodes]`.
    fn blend_time(&self, t: Time, tape: &mut HexTape) {
        let rows = self.config.resolution[3];
        let position = 0.5 * (t.normalised + 1.0) * (rows - 1) as f32 - self.config.first_time_row() as f32;
        tape.time = Cell::new(position, 1.0, self.config.time_rows());
        tape.lines.resize(self.levels.iter().map(|l| l.line_length() * self.groups()).sum(), [0.0; LANES]);
        let mut rest = tape.lines.as_mut_slice();
        for level in &self.levels {
            for group in 0..self.groups() {
                for (axis, pair) in TIME.into_iter().enumerate() {
                    let (line, after) = std::mem::take(&mut rest).split_at_mut(level.nodes[axis]);
                    rest = after;
                    let plane = level.texels(pair, group, self.groups());
                    sample::blend_rows(plane, level.nodes[axis], tape.time, line);
                }
            }
        }
    }

    fn locate(&self, means: &[Vec3], blocks: &mut Vec<BlockCells>) {
        let inverse = self.aabb.inverse_size();
        blocks.resize_with(means.len().div_ceil(BLOCK), BlockCells::default);
        blocks.par_iter_mut().zip(means.par_chunks(BLOCK)).for_each(|(block, means)| {
            block.rows = means.len();
            block.cells.clear();
            for level in &self.levels {
                let per_unit: [f32; 3] = std::array::from_fn(|k| inverse[k] * (level.nodes[k] - 1) as f32);
                block.cells.extend(means.iter().map(|&p| {
                    let offset = p - self.aabb.min;
                    std::array::from_fn(|k| Cell::new(offset[k], per_unit[k], level.nodes[k]))
                }));
            }
        });
    }

    #[inline(always)]
    fn sample<S: Simd>(&self, simd: S, mut lines: &[Texel], places: &BlockCells, features: &mut [f32]) {
        let (width, groups) = (self.width(), self.groups());
        for (l, level) in self.levels.iter().enumerate() {
            let cells = &places.cells[l * places.rows..][..places.rows];
            for g in 0..groups {
                let (line, rest) = lines.split_at(level.line_length());
                lines = rest;
                let nodes = [level.nodes[0], level.nodes[1], level.nodes[2]];
                let group = Group::new(nodes, SPACE.map(|pair| level.texels(pair, g, groups)), line);
                sample::forward(simd, &group, cells, features, width, (l * groups + g) * LANES);
            }
        }
    }

    /// Adds the weighted gradients of the regularisers to the planes; returns their weighted values by the names of
    /// their weights in [`HexPlaneConfig`].
    pub fn regularise(&mut self) -> [(&'static str, f32); 3] {
        let HexPlaneConfig { channels, plane_tv, time_smoothness, time_l1, resolution, .. } = self.config;
        let groups = self.groups();
        let mut jobs = Vec::with_capacity(self.levels.len() * 6 * groups);
        for level in &mut self.levels {
            for (pair, param) in level.planes.iter_mut().enumerate() {
                let (a, b) = PAIRS[pair];
                // Time rows that are never read count in the mean, as they do in the reference.
                let height = if b == 3 { resolution[3] } else { level.nodes[b] };
                let (values, grads) = (param.value.as_chunks().0, param.grad.as_chunks_mut().0);
                let size = values.len() / groups;
                let shares = values.chunks(size).zip(grads.chunks_mut(size));
                jobs.extend(shares.map(|(v, g)| (b == 3, level.nodes[a], height, v, g)));
            }
        }
        let simd = self.simd;
        let values: Vec<[f64; 3]> = jobs
            .into_par_iter()
            .map(|(timed, width, height, value, grad)| {
                let second_differences = channels * (height - 2) * width;
                let texels = channels * height * width;
                dispatch!(simd, simd => if timed {
                    let smooth = smooth::second_difference(simd, value, grad, width, second_differences, time_smoothness);
                    [0.0, smooth, smooth::distance_to_one(simd, value, grad, width, texels, time_l1)]
                } else {
                    [smooth::second_difference(simd, value, grad, width, second_differences, plane_tv), 0.0, 0.0]
                })
            })
            .collect();
        let total = |k: usize, weight: f32| (f64::from(weight) * values.iter().map(|v| v[k]).sum::<f64>()) as f32;
        [
            ("plane_tv", total(0, plane_tv)),
            ("time_smoothness", total(1, time_smoothness)),
            ("time_l1", total(2, time_l1)),
        ]
    }
}

impl Level {
    /// Texels in the lines of one group.
    pub(super) fn line_length(&self) -> usize {
        self.nodes[..3].iter().sum()
    }

    /// The texels of one group of a plane.
    fn texels(&self, pair: usize, group: usize, groups: usize) -> &[Texel] {
        let texels = self.planes[pair].value.as_chunks().0;
        let size = texels.len() / groups;
        &texels[group * size..][..size]
    }
}

impl Params for HexPlane {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.levels.iter().flat_map(|l| &l.planes).for_each(f);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.levels.iter_mut().flat_map(|l| &mut l.planes).for_each(f);
    }
}
