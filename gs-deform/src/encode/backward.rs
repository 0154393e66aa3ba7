//! Backward of a HexPlane: one task per group of sixteen channels of a level, which owns its slices of all gradients
//! and visits all points in order.

use super::hexplane::{BlockCells, HexBlock, HexPlane, HexTape, Level};
use super::sample::{self, Cell, Group, GroupGrad, LANES, Texel};
use fearless_simd::{Simd, dispatch};
use glam::Vec3;
use gs_core::Param;
use gs_core::nn::BLOCK;
use rayon::prelude::*;

/// Sums of one task, reused between calls.
#[derive(Clone, Debug, Default)]
pub(super) struct TaskScratch {
    /// Gradients of the lines of xt, yt, zt, one after the other.
    d_lines: Vec<Texel>,
    /// This group's share of the cotangent of every point.
    d_means: Vec<Vec3>,
}

/// One task: a group of channels of a level.
struct Job<'a> {
    level: usize,
    /// First channel in a row of features.
    at: usize,
    group: Group<'a>,
    /// Gradients of the planes xy, xz, yz.
    d_planes: [&'a mut [Texel]; 3],
    /// Gradients of the planes xt, yt, zt.
    d_time_planes: [&'a mut [Texel]; 3],
    scratch: &'a mut TaskScratch,
}

impl HexPlane {
    /// Backward of [`HexPlane::forward`] for the same points: takes `d_features` of every block, adds to the planes'
    /// gradients and, if given, to `d_means` (`[points]`, world units). Without `d_means` the points count as
    /// constants.
    pub fn backward(&mut self, tape: &mut HexTape, d_means: Option<&mut [Vec3]>) {
        let (groups, width, simd) = (self.groups(), self.width(), self.simd);
        let HexTape { time, lines, places, blocks, tasks } = tape;
        let points = if d_means.is_some() { places.len() } else { 0 };
        tasks.resize_with(groups * self.levels.len(), TaskScratch::default);
        let mut jobs = Vec::with_capacity(tasks.len());
        let mut lines = lines.as_slice();
        for ((l, level), scratch) in self.levels.iter_mut().enumerate().zip(tasks.chunks_mut(groups)) {
            let (here, rest) = lines.split_at(groups * level.line_length());
            lines = rest;
            push_jobs(l, level, here, scratch, &mut jobs);
        }
        jobs.par_iter_mut().with_max_len(1).for_each(|job| {
            job.scratch.reset(job.group.nodes.iter().sum(), points);
            dispatch!(simd, simd => job.run(simd, &places.0, blocks, width));
            job.scatter_lines(*time);
        });
        drop(jobs);
        if let Some(d_means) = d_means {
            d_means.par_chunks_mut(BLOCK).enumerate().for_each(|(block, rows)| {
                for task in tasks.iter() {
                    rows.iter_mut().zip(&task.d_means[block * BLOCK..]).for_each(|(d, part)| *d += *part);
                }
            });
        }
    }
}

/// The tasks of one level.
fn push_jobs<'a>(
    index: usize,
    level: &'a mut Level,
    lines: &'a [Texel],
    scratch: &'a mut [TaskScratch],
    jobs: &mut Vec<Job<'a>>,
) {
    let groups = scratch.len();
    let nodes = [level.nodes[0], level.nodes[1], level.nodes[2]];
    let mut shares = level.planes.each_mut().map(|Param { value, grad, .. }| {
        let (values, grads) = (value.as_chunks().0, grad.as_chunks_mut().0);
        let size = values.len() / groups;
        values.chunks_exact(size).zip(grads.chunks_exact_mut(size))
    });
    let lines = lines.chunks_exact(nodes.iter().sum());
    for (g, (line, scratch)) in lines.zip(scratch).enumerate() {
        let [xy, xz, xt, yz, yt, zt] = shares.each_mut().map(|s| s.next().unwrap_or_default());
        jobs.push(Job {
            level: index,
            at: (index * groups + g) * LANES,
            group: Group::new(nodes, [xy.0, xz.0, yz.0], line),
            d_planes: [xy.1, xz.1, yz.1],
            d_time_planes: [xt.1, yt.1, zt.1],
            scratch,
        });
    }
}

impl TaskScratch {
    fn reset(&mut self, line_length: usize, points: usize) {
        self.d_lines.clear();
        self.d_lines.resize(line_length, [0.0; LANES]);
        self.d_means.clear();
        self.d_means.resize(points, Vec3::ZERO);
    }
}

impl Job<'_> {
    #[inline(always)]
    fn run<S: Simd>(&mut self, simd: S, places: &[BlockCells], blocks: &[HexBlock], width: usize) {
        let Self { group, scratch: TaskScratch { d_lines, d_means }, .. } = self;
        let [xy, xz, yz] = &mut self.d_planes;
        let mut grad = GroupGrad { planes: [xy, xz, yz], lines: split_lines(group.nodes, d_lines) };
        let mut d_means = if d_means.is_empty() { None } else { Some(d_means.as_mut_slice()) };
        for (BlockCells { rows, cells }, block) in places.iter().zip(blocks) {
            let cells = &cells[self.level * rows..][..*rows];
            let here = match d_means.take() {
                Some(all) => {
                    let (here, rest) = all.split_at_mut(*rows);
                    d_means = Some(rest);
                    Some(here)
                }
                None => None,
            };
            sample::backward(simd, group, cells, &block.d_features, (width, self.at), &mut grad, here);
        }
    }

    /// Adds the lines' gradients to the two rows of each time plane they were blended from.
    fn scatter_lines(&mut self, time: Cell) {
        let d_lines = split_lines(self.group.nodes, &mut self.scratch.d_lines);
        for ((d_line, d_plane), width) in d_lines.into_iter().zip(&mut self.d_time_planes).zip(self.group.nodes) {
            sample::blend_rows_backward(d_line, width, time, d_plane);
        }
    }
}

fn split_lines([x, y, _]: [usize; 3], lines: &mut [Texel]) -> [&mut [Texel]; 3] {
    let (line_x, rest) = lines.split_at_mut(x);
    let (line_y, line_z) = rest.split_at_mut(y);
    [line_x, line_y, line_z]
}
