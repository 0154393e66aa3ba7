//! Pruning of anchors that were visible often with low opacity.
//!
//! ```text
//! judged = visits > views · success          drop = judged and opacity < min_opacity · visits
//! ```
//! Both comparisons are strict. If all would be dropped, the one of the highest mean opacity is kept.

use super::{AnchorDensify, AnchorDensifyRules};
use crate::anchors::Anchors;
use gs_core::cast;

/// Which anchors are kept, and which were visible often enough to be judged.
pub(super) struct PruneDecision {
    /// Indices of the anchors to keep, increasing.
    pub(super) keep: Vec<u32>,
    /// Indices of the judged anchors, kept or not; their statistics restart.
    pub(super) judged: Vec<u32>,
}

/// Decides about the anchors that were visible in more than `views` views; all others are kept.
pub(super) fn decide(statistics: &AnchorDensify, rules: &AnchorDensifyRules, views: f32) -> PruneDecision {
    let (opacity, visits) = (&statistics.opacity, &statistics.visits);
    let judged: Vec<u32> = (0..visits.len()).filter(|&v| visits[v] > views).map(cast::to_u32).collect();
    let mut keep = vec![true; visits.len()];
    for &v in &judged {
        keep[v as usize] = opacity[v as usize] >= rules.min_opacity * visits[v as usize];
    }
    if !keep.contains(&true) {
        let strength = |v: usize| opacity[v] / visits[v];
        let strongest = (0..keep.len()).max_by(|&a, &b| strength(a).total_cmp(&strength(b)).then(b.cmp(&a)));
        strongest.into_iter().for_each(|v| keep[v] = true);
    }
    PruneDecision { keep: (0..keep.len()).filter(|&v| keep[v]).map(cast::to_u32).collect(), judged }
}

/// Limits the scales of the extents by `extent_cap_log`, those of the offsets by the diagonal of the scene's box.
pub(super) fn cap_scales(anchors: &mut Anchors, rules: &AnchorDensifyRules, diagonal: f32) {
    let offset_cap = if diagonal > 0.0 && diagonal.is_finite() { diagonal.ln() } else { f32::INFINITY };
    for row in anchors.log_scales.value.chunks_exact_mut(6) {
        let (offsets, extents) = row.split_at_mut(3);
        offsets.iter_mut().for_each(|l| *l = l.min(offset_cap));
        extents.iter_mut().for_each(|l| *l = l.min(rules.extent_cap_log));
    }
}
