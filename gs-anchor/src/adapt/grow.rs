//! New anchors where Gaussians have large screen gradients.
//!
//! Level i, the coarsest 0, has cells of side `s = ε · ⌊coarsest / hierarchyⁱ⌋`. A Gaussian (v, j) drawn in more than half
//! the views asked for is a candidate if its mean gradient is at least `grad · (hierarchy/2)ⁱ` and a draw of its own exceeds
//! `2^−(i+1)`. Its cell is that of its undeformed centre:
//! ```text
//! c = round_half_even((x_v + O_vj ⊙ exp λ_v[0..3]) / s)
//! new = cells of candidates without those of the anchors there are, coarser levels of this pass included
//! x = c s,  λ = ln s on all axes,  f = max over the parents' f by element,  O = 0, D = 0
//! ```
//! An anchor that is pruned in the same pass still holds its cell and still has candidates, as in the released code.

use super::{Adapt, AdaptAt, AdaptRules};
use crate::anchors::Anchors;
use crate::lattice::{Cell, cell_of, position_of};
use glam::Vec3;
use gs_core::Rng;

/// An anchor to add.
pub(super) struct NewAnchor {
    /// An anchor whose Gaussian asked for it.
    pub parent: u32,
    /// Level it was asked for on.
    pub level: usize,
    position: Vec3,
    log_scale: f32,
    feature: Vec<f32>,
}

/// A cell asked for.
struct Asked {
    cell: Cell,
    /// Largest mean gradient of those who ask.
    grad: f32,
    /// Anchors that ask, in order, possibly more than once.
    parents: Vec<u32>,
}

/// The anchors to add, at most `room`; `interval` is the number of views that counts as often.
pub(super) fn new_anchors(
    statistics: &Adapt,
    rules: &AdaptRules,
    at: &AdaptAt,
    anchors: &Anchors,
    interval: f32,
    room: usize,
) -> Vec<NewAnchor> {
    let ready = |row: usize| statistics.drawn[row] > 0.5 * interval;
    let draws = |row: usize| Rng::new(at.seed, "grow", at.step, row as u64);
    let rows: Vec<usize> = (0..statistics.drawn.len())
        .filter(|&row| ready(row) && statistics.mean_grad(row) >= rules.threshold(0))
        .collect();
    let mut streams: Vec<Rng> = rows.iter().map(|&row| draws(row)).collect();
    let mut new: Vec<NewAnchor> = Vec::new();
    for level in 0..rules.levels {
        // Every level draws from every stream, so that what one level does changes no draw of another.
        let lucky: Vec<bool> = streams.iter_mut().map(|s| s.uniform() > 0.5f32.powi(level as i32 + 1)).collect();
        if level > 0 && rules.only_after_coarser && new.is_empty() {
            continue;
        }
        let side = at.voxel * rules.cells(level) as f32;
        let candidates = rows
            .iter()
            .zip(lucky)
            .filter(|&(&row, lucky)| lucky && statistics.mean_grad(row) >= rules.threshold(level));
        let asked = asked_cells(statistics, anchors, side, candidates.map(|(&row, _)| row));
        let free = free_cells(asked, anchors, &new, side, room - new.len());
        new.extend(free.into_iter().map(|asked| found(anchors, asked, side, level as usize)));
    }
    new
}

/// The cells candidates ask for, in the order of cells.
fn asked_cells(
    statistics: &Adapt,
    anchors: &Anchors,
    side: f32,
    candidates: impl Iterator<Item = usize>,
) -> Vec<Asked> {
    let k = statistics.offsets();
    let mut wishes: Vec<(Cell, usize)> =
        candidates.filter_map(|row| Some((cell_of(centre(anchors, row, k), side)?, row))).collect();
    wishes.sort_unstable();
    let asked = |group: &[(Cell, usize)]| Asked {
        cell: group[0].0,
        grad: group.iter().map(|w| statistics.mean_grad(w.1)).fold(0.0, f32::max),
        parents: group.iter().map(|w| (w.1 / k) as u32).collect(),
    };
    wishes.chunk_by(|a, b| a.0 == b.0).map(asked).collect()
}

/// Centre of a Gaussian of an undeformed anchor, world units.
fn centre(anchors: &Anchors, row: usize, offsets: usize) -> Vec3 {
    let v = row / offsets;
    let scale = Vec3::from_slice(&anchors.log_scales.value[6 * v..]).exp();
    anchors.position(v) + Vec3::from_slice(&anchors.offsets.value[3 * row..]) * scale
}

/// Those cells no anchor stands in, at most `room` of them: the largest gradients, in the order of cells.
fn free_cells(mut asked: Vec<Asked>, anchors: &Anchors, new: &[NewAnchor], side: f32, room: usize) -> Vec<Asked> {
    let old = (0..anchors.len()).map(|v| anchors.position(v));
    let mut taken: Vec<Cell> = old.chain(new.iter().map(|n| n.position)).filter_map(|p| cell_of(p, side)).collect();
    taken.sort_unstable();
    asked.retain(|a| taken.binary_search(&a.cell).is_err());
    if asked.len() > room {
        asked.sort_by(|a, b| b.grad.total_cmp(&a.grad).then(a.cell.cmp(&b.cell)));
        asked.truncate(room);
        asked.sort_by_key(|a| a.cell);
    }
    asked
}

fn found(anchors: &Anchors, asked: Asked, side: f32, level: usize) -> NewAnchor {
    let width = anchors.shape().features;
    let feature_of = |v: u32| &anchors.features.value[v as usize * width..][..width];
    let mut feature = feature_of(asked.parents[0]).to_vec();
    for &v in &asked.parents[1..] {
        feature.iter_mut().zip(feature_of(v)).for_each(|(a, b)| *a = a.max(*b));
    }
    let position = position_of(asked.cell, side);
    NewAnchor { parent: asked.parents[0], level, position, log_scale: side.ln(), feature }
}

/// Writes the new anchors over the copies of their parents that stand from row `first` on.
pub(super) fn place(anchors: &mut Anchors, first: usize, new: &[NewAnchor]) {
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
