//! Growing and pruning of anchors (Scaffold-GS, Lu et al. 2024, section 3.3; MoDec-GS's release for the constants).
//!
//! Statistics, for every view observed (`statistics`): of an anchor the opacity its Gaussians had and how often it was
//! visible, of each of its Gaussians the screen gradient and how often it was drawn. Every `every` steps:
//! ```text
//! grow   a Gaussian whose mean gradient reaches the threshold of a level asks for an anchor in its cell   (`grow`)
//! prune  an anchor seen often whose opacity stayed low goes                                              (`prune`)
//! cap    λ[3..6] ≤ extent_cap_log,  λ[0..3] ≤ ln(diagonal of the scene's box)
//! ```
//! Parameters, their moments and the statistics are edited by one [`RowEdit`]; new anchors have moments and statistics of
//! zero.

mod grow;
mod prune;
mod rules;
mod statistics;

pub use rules::AdaptRules;
pub use statistics::{Adapt, AnchorColumn, AnchorView};

use crate::anchors::Anchors;
use gs_core::{RowEdit, param::RowEditError};
use serde::{Deserialize, Serialize};

/// What a pass must know beside the rules.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdaptAt {
    /// Step of the run, for random numbers.
    pub step: u32,
    /// Step on the schedule's clock, for the rules.
    pub clock: u32,
    /// Seed of the run.
    pub seed: u64,
    /// Side of the cells the first anchors stand on, ε, world units.
    pub voxel: f32,
    /// Diagonal of the scene's box, world units: no offset is scaled beyond it.
    pub diagonal: f32,
    /// Views observed per step. The published thresholds on counts are for 1, the last of the batch.
    pub views_per_step: u32,
}

/// What a pass did.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Grown {
    /// Anchors added.
    pub added: u32,
    /// Anchors removed.
    pub pruned: u32,
    /// Anchors added on each level, the coarsest first.
    pub per_level: Vec<u32>,
}

impl Adapt {
    /// Grows and prunes if the rules ask for it at this step; all zero otherwise.
    ///
    /// # Errors
    /// If the statistics are not of these anchors; nothing is changed then.
    pub fn adapt(&mut self, rules: &AdaptRules, at: &AdaptAt, anchors: &mut Anchors) -> Result<Grown, RowEditError> {
        if !rules.grows_at(at.clock) {
            return Ok(Grown::default());
        }
        self.check_rows(anchors)?;
        let interval = rules.every as f32 * at.views_per_step.max(1) as f32 * rules.success;
        let fate = prune::fate(self, rules, interval);
        let room = (rules.max_anchors as usize).saturating_sub(fate.keep.len());
        let new = grow::new_anchors(self, rules, at, anchors, interval, room);
        let append_from = new.iter().map(|n| n.parent).collect();
        let edit = RowEdit { keep: fate.keep, append_from };
        let (before, kept) = (anchors.len(), edit.keep.len());
        anchors.edit(&edit)?;
        grow::place(anchors, kept, &new);
        prune::cap_scales(anchors, rules, at.diagonal);
        self.forget(&fate.judged, 0.5 * interval);
        self.edit(&edit);
        let mut per_level = vec![0; rules.levels as usize];
        new.iter().for_each(|n| per_level[n.level] += 1);
        Ok(Grown { added: new.len() as u32, pruned: (before - kept) as u32, per_level })
    }
}

#[cfg(test)]
mod tests;
