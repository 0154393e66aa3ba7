//! Anchors that were seen often and stayed transparent go.
//!
//! ```text
//! judged = visits > views · success          drop = judged and opacity < min_opacity · visits
//! ```
//! Both comparisons are strict. The last anchor stays.

use super::{Adapt, AdaptRules};
use crate::anchors::Anchors;

/// What becomes of the anchors there are.
pub(super) struct Fate {
    /// Those that stay.
    pub keep: Vec<u32>,
    /// Those seen often enough to be judged.
    pub judged: Vec<u32>,
}

/// Judges anchors visible in more than `views` views.
pub(super) fn fate(statistics: &Adapt, rules: &AdaptRules, views: f32) -> Fate {
    let (opacity, visits) = (&statistics.opacity, &statistics.visits);
    let judged: Vec<u32> = (0..visits.len()).filter(|&v| visits[v] > views).map(|v| v as u32).collect();
    let mut stays = vec![true; visits.len()];
    for &v in &judged {
        stays[v as usize] = opacity[v as usize] >= rules.min_opacity * visits[v as usize];
    }
    if !stays.contains(&true) {
        let strength = |v: usize| opacity[v] / visits[v];
        let strongest = (0..stays.len()).max_by(|&a, &b| strength(a).total_cmp(&strength(b)).then(b.cmp(&a)));
        strongest.into_iter().for_each(|v| stays[v] = true);
    }
    Fate { keep: (0..stays.len()).filter(|&v| stays[v]).map(|v| v as u32).collect(), judged }
}

/// Bounds the scales: those of the extents by the rule, those of the offsets by the diagonal of the scene's box.
pub(super) fn cap_scales(anchors: &mut Anchors, rules: &AdaptRules, diagonal: f32) {
    let offset_cap = if diagonal > 0.0 && diagonal.is_finite() { diagonal.ln() } else { f32::INFINITY };
    for row in anchors.log_scales.value.chunks_exact_mut(6) {
        let (offsets, extents) = row.split_at_mut(3);
        offsets.iter_mut().for_each(|l| *l = l.min(offset_cap));
        extents.iter_mut().for_each(|l| *l = l.min(rules.extent_cap_log));
    }
}
