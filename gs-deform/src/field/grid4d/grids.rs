//! The four hash grids of a [`Grid4dField`](super::Grid4dField): one over x, y, z, three over two coordinates and time.
//!
//! ```text
//! x̂ = (x + b) / 2b        t̂ = 0.05 + 0.9 t, clamped to 0 … 1        one row: [xyt | yzt | xzt], side by side
//! ```
//! A point outside the cube has features of zero and no gradient in each grid that reads the coordinate that is
//! outside.

use super::config::Grid4dConfig;
use crate::DeformError;
use crate::encode::{Columns, HashGrid, Slice};
use glam::Vec3;
use gs_core::{Param, Params, Time};
use rayon::prelude::*;

/// Coordinates read by the three temporal grids, in the order of their features.
const PAIRS: [(usize, usize); 3] = [(0, 1), (1, 2), (0, 2)];

#[derive(Clone, Debug)]
pub(super) struct Grids {
    xyz: HashGrid,
    timed: [HashGrid; 3],
    bound: f32,
    slicing: bool,
}

/// The times of some points, normalised to the cube.
#[derive(Clone, Copy)]
pub(super) enum Times<'a> {
    /// One time for all points.
    Common(f32),
    /// One time per point.
    Each(&'a [f32]),
}

/// Inputs of the temporal grids, kept between forward and backward.
#[derive(Clone, Debug, Default)]
pub(super) struct TimedTape {
    solids: [Vec<[f32; 3]>; 3],
    planes: [Vec<[f32; 2]>; 3],
    slices: [Slice; 3],
    sliced: bool,
}

/// A timestamp normalised to the cube, `t̂`.
pub(super) fn normalised_time(t: Time) -> f32 {
    (0.05 + 0.9 * t.normalised).clamp(0.0, 1.0)
}

/// Whether a normalised point lies in the cube.
pub(super) fn inside(p: &[f32; 3]) -> bool {
    p.iter().all(|c| (0.0..=1.0).contains(c))
}

impl Grids {
    pub(super) fn new(config: &Grid4dConfig, seed: u64) -> Result<Self, DeformError> {
        let timed = |name| HashGrid::new(name, &config.temporal, seed);
        Ok(Self {
            xyz: HashGrid::new("field.grids.xyz", &config.canonical, seed)?,
            timed: [timed("field.grids.xyt")?, timed("field.grids.yzt")?, timed("field.grids.xzt")?],
            bound: config.bound,
            slicing: config.exact.time_slicing,
        })
    }

    /// Features per point of the canonical grid and of the three temporal grids together.
    pub(super) fn widths(&self) -> [usize; 2] {
        [self.xyz.width(), self.timed.iter().map(HashGrid::width).sum()]
    }

    /// All four grids: xyz, xyt, yzt, xzt.
    pub(super) fn all(&self) -> [&HashGrid; 4] {
        let [xyt, yzt, xzt] = &self.timed;
        [&self.xyz, xyt, yzt, xzt]
    }

    /// Side of the cube, world units.
    pub(super) fn side(&self) -> f32 {
        2.0 * self.bound
    }

    /// A point in world units to the unit cube.
    pub(super) fn normalise(&self, p: Vec3) -> [f32; 3] {
        ((p + self.bound) / (2.0 * self.bound)).to_array()
    }

    /// [`Grids::normalise`] of all points, in parallel.
    pub(super) fn normalise_all(&self, means: &[Vec3], points: &mut Vec<[f32; 3]>) {
        points.resize(means.len(), [0.0; 3]);
        points.par_chunks_mut(1 << 12).zip(means.par_chunks(1 << 12)).for_each(|(points, means)| {
            points.iter_mut().zip(means).for_each(|(p, m)| *p = self.normalise(*m));
        });
    }

    fn space_columns(&self) -> Columns {
        Columns { stride: self.xyz.width(), offset: 0 }
    }

    fn timed_columns(&self, grid: usize) -> Columns {
        let width = self.timed[grid].width();
        Columns { stride: 3 * width, offset: grid * width }
    }

    /// Canonical features of normalised points.
    pub(super) fn space(&self, points: &[[f32; 3]], out: &mut Vec<f32>) {
        out.resize(points.len() * self.xyz.width(), 0.0);
        self.xyz.forward(points, out, self.space_columns());
    }

    /// Backward of [`Grids::space`]: adds to the table's gradient.
    pub(super) fn space_backward(&mut self, points: &[[f32; 3]], d_out: &[f32]) {
        let columns = self.space_columns();
        self.xyz.backward(points, d_out, columns);
    }

    /// Temporal features of normalised points.
    pub(super) fn time(&self, points: &[[f32; 3]], times: Times<'_>, tape: &mut TimedTape, out: &mut Vec<f32>) {
        out.resize(points.len() * self.widths()[1], 0.0);
        let TimedTape { solids, planes, slices, sliced } = tape;
        *sliced = self.slicing && matches!(times, Times::Common(_));
        for (g, (grid, (a, b))) in self.timed.iter().zip(PAIRS).enumerate() {
            let columns = self.timed_columns(g);
            match times {
                Times::Common(t) if self.slicing => {
                    planes[g].clear();
                    planes[g].extend(points.iter().map(|p| [p[a], p[b]]));
                    grid.slice(t, points.len(), &mut slices[g]);
                    grid.forward_slice(&slices[g], &planes[g], out, columns);
                    continue;
                }
                Times::Common(t) => {
                    solids[g].clear();
                    solids[g].extend(points.iter().map(|p| [p[a], p[b], t]));
                }
                Times::Each(t) => {
                    solids[g].clear();
                    solids[g].extend(points.iter().zip(t).map(|(p, t)| [p[a], p[b], *t]));
                }
            }
            grid.forward(&solids[g], out, columns);
        }
    }

    /// Backward of [`Grids::time`]: adds to the tables' gradients.
    pub(super) fn time_backward(&mut self, tape: &mut TimedTape, d_out: &[f32]) {
        for g in 0..3 {
            let columns = self.timed_columns(g);
            if tape.sliced {
                self.timed[g].backward_slice(&mut tape.slices[g], &tape.planes[g], d_out, columns);
            } else {
                self.timed[g].backward(&tape.solids[g], d_out, columns);
            }
        }
    }
}

impl Params for Grids {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.xyz.visit(f);
        self.timed.iter().for_each(|g| g.visit(f));
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.xyz.visit_mut(f);
        self.timed.iter_mut().for_each(|g| g.visit_mut(f));
    }
}
