//! Reference implementations in `f64`: plain loops, four-dimensional sampling without lines, groups or blocks. Tests
//! and benches measure the fast code against them.
//!
//! ```
//! use gs_core::Time;
//! use gs_deform::{Aabb, encode::{HexPlane, HexPlaneConfig, HexTape}, reference::HexPlaneRef};
//!
//! let config = HexPlaneConfig { resolution: [5, 4, 3, 7], levels: vec![1], channels: 16, ..Default::default() };
//! let encoder = HexPlane::new("hex", &config, Aabb::cube(1.0), 1)?;
//! let (t, mut tape) = (Time::new(0.4)?, HexTape::default());
//! encoder.forward(&[glam::Vec3::new(0.25, -0.5, 0.75)], t, &mut tape);
//! let want = HexPlaneRef::new(&encoder).features([0.25, -0.5, 0.75], t);
//! assert!(tape.blocks[0].features.iter().zip(&want).all(|(f, w)| (f64::from(*f) - w).abs() < 1e-6));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::encode::HexPlane;
use crate::encode::hexplane::PAIRS;
use gs_core::{Params, Time};

mod grid4d;
mod hash;
mod plane_net;
pub use grid4d::Grid4dRef;
pub use hash::HashGridRef;
pub use plane_net::{PlaneNetRef, PlaneNetRefGrad};

/// A [`HexPlane`] in `f64`, one point and one channel at a time.
#[derive(Clone, Debug)]
pub struct HexPlaneRef {
    /// All planes in the order of [`Params::visit`], each in the layout of [`HexPlane`].
    pub planes: Vec<Vec<f64>>,
    /// Nodes along x, y, z, t (stored rows) of each level.
    nodes: Vec<[usize; 4]>,
    channels: usize,
    min: [f64; 3],
    size: [f64; 3],
    /// Number of time rows of the whole axis, and of those that are not stored.
    time_axis: (usize, usize),
}

/// Position between two nodes, and its derivative.
struct Cell {
    index: usize,
    weight: f64,
    slope: f64,
}

fn cell(position: f64, slope: f64, nodes: usize) -> Cell {
    let last = (nodes - 1) as f64;
    let inside = position > 0.0 && position < last;
    let position = position.clamp(0.0, last);
    let index = (position as usize).min(nodes - 2);
    Cell { index, weight: position - index as f64, slope: if inside { slope } else { 0.0 } }
}

impl HexPlaneRef {
    /// Copies the parameters of an encoder.
    pub fn new(hex: &HexPlane) -> Self {
        let mut planes = Vec::new();
        hex.visit(&mut |p| planes.push(p.value.iter().map(|&v| f64::from(v)).collect()));
        let config = hex.config();
        let rows = config.time_rows();
        let nodes = |f: &usize| {
            let [x, y, z, _] = config.resolution;
            [x * f, y * f, z * f, rows]
        };
        let (min, max) = (hex.aabb().min.to_array().map(f64::from), hex.aabb().max.to_array().map(f64::from));
        Self {
            planes,
            nodes: config.levels.iter().map(nodes).collect(),
            channels: config.channels,
            min,
            size: std::array::from_fn(|k| max[k] - min[k]),
            time_axis: (config.resolution[3], config.resolution[3] - rows),
        }
    }

    fn cells(&self, level: usize, p: [f64; 3], t: Time) -> [Cell; 4] {
        let nodes = self.nodes[level];
        std::array::from_fn(|k| {
            if k == 3 {
                let (rows, skipped) = self.time_axis;
                let u = (f64::from(t.normalised) + 1.0) / 2.0;
                cell(u * (rows - 1) as f64 - skipped as f64, 0.0, nodes[3])
            } else if self.size[k] > 0.0 {
                let per_unit = (nodes[k] - 1) as f64 / self.size[k];
                cell((p[k] - self.min[k]) * per_unit, per_unit, nodes[k])
            } else {
                cell(0.0, 0.0, nodes[k])
            }
        })
    }

    /// Index of a value of a plane.
    fn index(&self, level: usize, pair: usize, a: usize, b: usize, channel: usize) -> usize {
        let nodes = self.nodes[level];
        let (axis_a, axis_b) = PAIRS[pair];
        (((channel / 16) * nodes[axis_b] + b) * nodes[axis_a] + a) * 16 + channel % 16
    }

    /// The four corners of a sample: index, weight, and derivative of the weight along the plane's two axes.
    fn corners(&self, level: usize, pair: usize, channel: usize, at: &[Cell; 4]) -> [(usize, f64, [f64; 2]); 4] {
        let (a, b) = (&at[PAIRS[pair].0], &at[PAIRS[pair].1]);
        std::array::from_fn(|corner| {
            let (i, j) = (corner % 2, corner / 2);
            let end = |p: &Cell, k: usize| if k == 0 { (1.0 - p.weight, -p.slope) } else { (p.weight, p.slope) };
            let ((wa, da), (wb, db)) = (end(a, i), end(b, j));
            (self.index(level, pair, a.index + i, b.index + j, channel), wa * wb, [da * wb, wa * db])
        })
    }

    /// Features of one point (world units) at one timestamp, `[levels · channels]`.
    pub fn features(&self, p: [f64; 3], t: Time) -> Vec<f64> {
        let mut out = Vec::new();
        for level in 0..self.nodes.len() {
            let at = self.cells(level, p, t);
            for channel in 0..self.channels {
                let sample = |pair: usize| -> f64 {
                    self.corners(level, pair, channel, &at)
                        .iter()
                        .map(|c| c.1 * self.planes[level * 6 + pair][c.0])
                        .sum()
                };
                out.push((0..6).map(sample).product());
            }
        }
        out
    }

    /// Backward of [`HexPlaneRef::features`]: adds to `d_planes` (shaped as `planes`), returns the cotangent of `p`.
    pub fn backward(&self, p: [f64; 3], t: Time, d: &[f64], d_planes: &mut [Vec<f64>]) -> [f64; 3] {
        let mut d_p = [0.0; 3];
        for level in 0..self.nodes.len() {
            let at = self.cells(level, p, t);
            for channel in 0..self.channels {
                let corners: [_; 6] = std::array::from_fn(|pair| self.corners(level, pair, channel, &at));
                let value = |pair: usize, c: &(usize, f64, [f64; 2])| self.planes[level * 6 + pair][c.0];
                let samples: [f64; 6] =
                    std::array::from_fn(|pair| corners[pair].iter().map(|c| c.1 * value(pair, c)).sum());
                for pair in 0..6 {
                    let others: f64 = (0..6).filter(|&q| q != pair).map(|q| samples[q]).product();
                    let g = d[level * self.channels + channel] * others;
                    for c in &corners[pair] {
                        d_planes[level * 6 + pair][c.0] += g * c.1;
                        for (axis, slope) in [PAIRS[pair].0, PAIRS[pair].1].into_iter().zip(c.2) {
                            if axis < 3 {
                                d_p[axis] += g * slope * value(pair, c);
                            }
                        }
                    }
                }
            }
        }
        d_p
    }
}
