//! A hash grid in `f64`: one point, one level, one corner at a time, indices by the published loop over strides.

use crate::encode::{HashGrid, HashGridConfig};

/// A [`HashGrid`] in `f64`, one point at a time.
#[derive(Clone, Debug)]
pub struct HashGridRef {
    /// All tables as one block, level by level, `[entries, 2]`.
    pub table: Vec<f64>,
    config: HashGridConfig,
}

impl HashGridRef {
    /// Copies the tables of a grid.
    pub fn new(grid: &HashGrid) -> Self {
        Self { table: grid.table().value.iter().map(|&v| f64::from(v)).collect(), config: *grid.config() }
    }

    /// Real resolution along an axis at a level.
    fn resolution(&self, level: usize, axis: usize) -> f64 {
        let (base, end) = (f64::from(self.config.base[axis]), f64::from(self.config.end[axis]));
        let growth = (end / base).powf(1.0 / (self.config.levels.max(2) - 1) as f64);
        base * growth.powi(level as i32)
    }

    fn nodes(&self, level: usize) -> [u64; 3] {
        std::array::from_fn(|d| (self.resolution(level, d) - 1e-4).ceil() as u64)
    }

    fn entries(&self, level: usize) -> u64 {
        self.nodes(level).iter().product::<u64>().min(1 << self.config.log2_table)
    }

    /// Entry of a node in the table of its level.
    fn index(&self, level: usize, node: [u64; 3]) -> u64 {
        let (nodes, entries) = (self.nodes(level), self.entries(level));
        let (mut stride, mut dense) = (1, 0);
        for d in 0..3 {
            if stride <= entries {
                dense += node[d] * stride;
                stride *= nodes[d];
            }
        }
        let hashed =
            node[0] as u32 ^ (node[1] as u32).wrapping_mul(2_654_435_761) ^ (node[2] as u32).wrapping_mul(805_459_861);
        if stride > entries { u64::from(hashed) % entries } else { dense % entries }
    }

    /// The eight corners of a point's cell in a level: index of the corner's two values in `table`, and weight. None
    /// outside the cube.
    pub fn corners(&self, level: usize, point: [f64; 3]) -> Vec<(usize, f64)> {
        if !point.iter().all(|c| *c >= 0.0 && *c <= 1.0) {
            return Vec::new();
        }
        let start: u64 = (0..level).map(|l| self.entries(l)).sum();
        let nodes = self.nodes(level);
        let mut corners = Vec::new();
        for corner in 0..8u64 {
            let (mut node, mut weight) = ([0; 3], 1.0);
            for d in 0..3 {
                let position = point[d] * (self.resolution(level, d) - 1.0);
                let cell = (position.floor() as u64).min(nodes[d] - 2);
                let f = position - cell as f64;
                let w = f * f * (3.0 - 2.0 * f);
                let upper = corner >> d & 1;
                node[d] = cell + upper;
                weight *= if upper == 1 { w } else { 1.0 - w };
            }
            corners.push((2 * (start + self.index(level, node)) as usize, weight));
        }
        corners
    }

    /// Features of one point in the unit cube, `[2 · levels]`.
    pub fn features(&self, point: [f64; 3]) -> Vec<f64> {
        let mut out = Vec::new();
        for level in 0..self.config.levels {
            let corners = self.corners(level, point);
            out.extend((0..2).map(|f| corners.iter().map(|(at, w)| w * self.table[at + f]).sum::<f64>()));
        }
        out
    }

    /// Backward of [`HashGridRef::features`]: adds to `d_table` (shaped as `table`).
    pub fn backward(&self, point: [f64; 3], d: &[f64], d_table: &mut [f64]) {
        for level in 0..self.config.levels {
            for (at, w) in self.corners(level, point) {
                (0..2).for_each(|f| d_table[at + f] += w * d[2 * level + f]);
            }
        }
    }
}
