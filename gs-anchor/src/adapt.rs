//! Densification of anchors: growing and pruning (Scaffold-GS, Lu et al. 2024, section 3.3; constants of the released
//! MoDec-GS).
//!
//! Statistics of every observed view (`statistics`): per anchor the sum of its Gaussians' opacities and the number of
//! views in which it was visible, per Gaussian the screen gradient and the number of views in which it was rendered.
//! Every `every` steps:
//! ```text
//! grow   a Gaussian whose mean gradient reaches the threshold of a level adds an anchor in its cell   (`grow`)
//! prune  an anchor that was visible often with a low mean opacity is removed                         (`prune`)
//! cap    λ[3..6] ≤ extent_cap_log,  λ[0..3] ≤ ln(diagonal of the scene's box)
//! ```
//! Parameters, their optimizer moments and the statistics are edited by one [`RowEdit`]; new anchors have moments and
//! statistics of zero.
//!
//! ```
//! use gs_anchor::{AnchorDensify, AnchorDensifyStep, AnchorDensifyRules, AnchorShape, Anchors};
//! use glam::Vec3;
//!
//! let shape = AnchorShape { offsets: 2, features: 4, dynamics: 0 };
//! let mut anchors = Anchors::new(shape, &[Vec3::ZERO, Vec3::X], &[-3.0; 2]);
//! let mut statistics = AnchorDensify::new(&anchors);
//! (statistics.opacity, statistics.visits) = (vec![0.1, 50.0], vec![100.0; 2]);
//! let at = AnchorDensifyStep { step: 1600, clock: 1600, seed: 1, voxel: 0.01, diagonal: 10.0, views_per_step: 1 };
//! let pass = statistics.adapt(&AnchorDensifyRules::default(), &at, &mut anchors)?;
//! assert_eq!((pass.pruned, anchors.position(0)), (1, Vec3::X), "a mean opacity of 0.001 is below 0.01");
//! # Ok::<(), gs_core::param::RowEditError>(())
//! ```

mod grow;
mod prune;
mod rules;
mod statistics;

pub use rules::AnchorDensifyRules;
pub use statistics::{AnchorColumn, AnchorDensify, AnchorView};

use crate::anchors::Anchors;
use gs_core::cast;
use gs_core::{RowEdit, param::RowEditError};
use serde::{Deserialize, Serialize};

/// Inputs of a pass beside the rules.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnchorDensifyStep {
    /// Training step of the run: key of the random numbers.
    pub step: u32,
    /// Step within the stage's schedule: decides whether a pass is due.
    pub clock: u32,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Side ε of the initial anchors' cells, world units.
    pub voxel: f32,
    /// Diagonal of the scene's box, world units: the upper limit of the offsets' scales.
    pub diagonal: f32,
    /// Observed views per step; the published thresholds on counts are for 1, the last of the batch.
    pub views_per_step: u32,
}

/// Number of anchors that a pass added and removed.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct AnchorDensifyReport {
    /// Number of anchors added, over all levels.
    pub added: u32,
    /// Number of anchors removed, over all levels.
    pub pruned: u32,
    /// Number of anchors added on each level, the coarsest first; empty between passes.
    pub per_level: Vec<u32>,
}

impl AnchorDensify {
    /// Grows and prunes `anchors` if a pass is due at `at.clock`; returns zeros otherwise.
    ///
    /// # Errors
    /// If the statistics do not have the anchors' number of rows; nothing is changed then.
    pub fn adapt(
        &mut self,
        rules: &AnchorDensifyRules,
        at: &AnchorDensifyStep,
        anchors: &mut Anchors,
    ) -> Result<AnchorDensifyReport, RowEditError> {
        if !rules.grows_at(at.clock) {
            return Ok(AnchorDensifyReport::default());
        }
        self.check_rows(anchors)?;
        let interval = rules.every as f32 * at.views_per_step.max(1) as f32 * rules.success;
        let decision = prune::decide(self, rules, interval);
        let capacity = (rules.max_anchors as usize).saturating_sub(decision.keep.len());
        let new = grow::new_anchors(self, rules, at, anchors, interval, capacity);
        let append_from = new.iter().map(|n| n.parent).collect();
        let edit = RowEdit { keep: decision.keep, append_from };
        let (before, kept) = (anchors.len(), edit.keep.len());
        anchors.edit(&edit)?;
        grow::write(anchors, kept, &new);
        prune::cap_scales(anchors, rules, at.diagonal);
        self.reset_judged(&decision.judged, 0.5 * interval);
        self.edit(&edit);
        let mut per_level = vec![0; rules.levels as usize];
        new.iter().for_each(|n| per_level[n.level] += 1);
        Ok(AnchorDensifyReport { added: cast::to_u32(new.len()), pruned: cast::to_u32(before - kept), per_level })
    }
}

#[cfg(test)]
mod tests;
