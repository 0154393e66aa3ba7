//! New anchors where Gaussians have large screen gradients.
//!
//! Level i, the coarsest 0, has cells of side `s = ε · ⌊coarsest / hierarchyⁱ⌋`. A Gaussian (v, j) that was rendered in
//! more than half the required number of views is a candidate if its mean gradient is at least `grad · (hierarchy/2)ⁱ`
//! and a uniform random number of its own exceeds `2^−(i+1)`. Its cell is that of its canonical mean:
//! ```text
//! c = round_half_even((x_v + O_vj ⊙ exp λ_v[0..3]) / s)
//! new = cells of candidates without those of existing anchors, coarser levels of this pass included
//! x = c s,  λ = ln s on all axes,  f = max over the parents' f by element,  O = 0, D = 0
//! ```
//! An anchor that is pruned in the same pass still occupies its cell and still has candidates, as in the released code.

use super::{AnchorDensify, AnchorDensifyRules, AnchorDensifyStep};
use crate::anchors::Anchors;
use crate::lattice::{Cell, cell_of, position_of};
use glam::Vec3;
use gs_core::{Rng, cast};

/// Values of an anchor to add.
pub(super) struct NewAnchor {
    /// An anchor whose Gaussian is a candidate in this cell.
    pub(super) parent: u32,
    /// Level of the candidate.
    pub(super) level: usize,
    position: Vec3,
    log_scale: f32,
    feature: Vec<f32>,
}

/// A cell with candidates.
struct CandidateCell {
    cell: Cell,
    /// Largest mean gradient of the candidates.
    grad: f32,
    /// Anchors of the candidates, in order, with repetitions.
    parents: Vec<u32>,
}

/// The anchors to add, at most `capacity`; a Gaussian must have been rendered in more than half of `interval` views.
pub(super) fn new_anchors(
    statistics: &AnchorDensify,
    rules: &AnchorDensifyRules,
    at: &AnchorDensifyStep,
    anchors: &Anchors,
    interval: f32,
    capacity: usize,
) -> Vec<NewAnchor> {
    let rendered_often = |row: usize| statistics.rendered[row] > 0.5 * interval;
    let stream = |row: usize| Rng::new(at.seed, "grow", at.step, row as u64);
    let least = (0..rules.levels).map(|level| rules.threshold(level)).fold(f32::INFINITY, f32::min);
    let rows: Vec<usize> = (0..statistics.rendered.len())
        .filter(|&row| rendered_often(row) && statistics.mean_grad(row) >= least)
        .collect();
    let mut streams: Vec<Rng> = rows.iter().map(|&row| stream(row)).collect();
    let mut new: Vec<NewAnchor> = Vec::new();
    for level in 0..rules.levels {
        // Every level takes one number of every stream, so that no level changes the random numbers of another.
        let sampled: Vec<bool> = streams.iter_mut().map(|s| s.uniform() > 0.5f32.powi(level as i32 + 1)).collect();
        if level > 0 && rules.only_after_coarser && new.is_empty() {
            continue;
        }
        // Positions are whole multiples of the first cells' side, whatever the level.
        let exact_side = f64::from(at.voxel) * f64::from(rules.cells(level));
        let side = cast::to_f32(exact_side);
        let candidates = rows
            .iter()
            .zip(sampled)
            .filter(|&(&row, sampled)| sampled && statistics.mean_grad(row) >= rules.threshold(level));
        let cells = candidate_cells(statistics, anchors, side, candidates.map(|(&row, _)| row));
        let free = free_cells(cells, anchors, &new, side, capacity - new.len());
        new.extend(free.into_iter().map(|cell| new_anchor(anchors, cell, exact_side, level as usize)));
    }
    new
}

/// The cells of the candidates, in the order of cells.
fn candidate_cells(
    statistics: &AnchorDensify,
    anchors: &Anchors,
    side: f32,
    rows: impl Iterator<Item = usize>,
) -> Vec<CandidateCell> {
    let k = statistics.offsets();
    let mut candidates: Vec<(Cell, usize)> =
        rows.filter_map(|row| Some((cell_of(canonical_mean(anchors, row, k), side)?, row))).collect();
    candidates.sort_unstable();
    let cell = |group: &[(Cell, usize)]| CandidateCell {
        cell: group[0].0,
        grad: group.iter().map(|w| statistics.mean_grad(w.1)).fold(0.0, f32::max),
        parents: group.iter().map(|w| cast::to_u32(w.1 / k)).collect(),
    };
    candidates.chunk_by(|a, b| a.0 == b.0).map(cell).collect()
}

/// Mean of a Gaussian of a canonical anchor, world units.
fn canonical_mean(anchors: &Anchors, row: usize, offsets: usize) -> Vec3 {
    let v = row / offsets;
    let scale = Vec3::from_slice(&anchors.log_scales.value[6 * v..]).exp();
    anchors.position(v) + Vec3::from_slice(&anchors.offsets.value[3 * row..]) * scale
}

/// The cells without an anchor, in the order of cells; of more than `capacity` those with the largest gradients.
fn free_cells(
    mut cells: Vec<CandidateCell>,
    anchors: &Anchors,
    new: &[NewAnchor],
    side: f32,
    capacity: usize,
) -> Vec<CandidateCell> {
    let old = (0..anchors.len()).map(|v| anchors.position(v));
    let mut taken: Vec<Cell> = old.chain(new.iter().map(|n| n.position)).filter_map(|p| cell_of(p, side)).collect();
    taken.sort_unstable();
    cells.retain(|a| taken.binary_search(&a.cell).is_err());
    if cells.len() > capacity {
        cells.sort_by(|a, b| b.grad.total_cmp(&a.grad).then(a.cell.cmp(&b.cell)));
        cells.truncate(capacity);
        cells.sort_by_key(|a| a.cell);
    }
    cells
}

fn new_anchor(anchors: &Anchors, candidate: CandidateCell, exact_side: f64, level: usize) -> NewAnchor {
    let width = anchors.shape().features;
    let feature_of = |v: u32| &anchors.features.value[v as usize * width..][..width];
    let mut feature = feature_of(candidate.parents[0]).to_vec();
    for &v in &candidate.parents[1..] {
        feature.iter_mut().zip(feature_of(v)).for_each(|(a, b)| *a = a.max(*b));
    }
    let position = position_of(candidate.cell, exact_side);
    NewAnchor { parent: candidate.parents[0], level, position, log_scale: cast::to_f32(exact_side).ln(), feature }
}

/// Writes the new anchors over the copies of their parents, from row `first` on.
pub(super) fn write(anchors: &mut Anchors, first: usize, new: &[NewAnchor]) {
    let shape = anchors.shape();
    let (k, c, d) = (3 * shape.offsets, shape.features, shape.dynamics);
    for (v, n) in (first..).zip(new) {
        anchors.positions.value[3 * v..][..3].copy_from_slice(&n.position.to_array());
        anchors.offsets.value[k * v..][..k].fill(0.0);
        anchors.features.value[c * v..][..c].copy_from_slice(&n.feature);
        anchors.log_scales.value[6 * v..][..6].fill(n.log_scale);
        if let Some(dynamics) = &mut anchors.dynamics {
            dynamics.value[d * v..][..d].fill(0.0);
        }
    }
}
