//! Settings of growing and pruning.

use crate::setting::{SettingError, require};
use serde::{Deserialize, Serialize};

/// Settings of growing and pruning. Steps count within the stage's schedule.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnchorDensifyRules {
    /// Views are observed after this step and before `until`.
    pub observe_from: u32,
    /// Passes take place after this step.
    pub from: u32,
    /// Passes and observation end before this step; 0: there are none.
    pub until: u32,
    /// Steps between two passes, at least 1.
    pub every: u32,
    /// Share of the views between two passes in which an anchor must have been visible to be pruned, 0 … 1; half of it
    /// is the share in which a Gaussian must have been rendered to grow.
    pub success: f32,
    /// Mean screen gradient (half-image units) from which a Gaussian grows an anchor on the coarsest level.
    pub grad: f32,
    /// Number of levels, 1 to 8.
    pub levels: u32,
    /// Side of a cell of the coarsest level, in cells of the initial anchors.
    pub coarsest: u32,
    /// Each level's cells are smaller by this factor (whole-number division), and its threshold larger by half of it.
    pub hierarchy: u32,
    /// Finer levels take part only if a coarser one of the same pass added an anchor, as in the released code. Off:
    /// each level by itself.
    pub only_after_coarser: bool,
    /// Mean over views of the sum of an anchor's opacities below which it is pruned.
    pub min_opacity: f32,
    /// Upper bound of the logarithms of the extents, ln of world units.
    pub extent_cap_log: f32,
    /// Largest number of anchors after growth; on each level the largest gradients take precedence.
    pub max_anchors: u32,
}

impl Default for AnchorDensifyRules {
    /// The published values (MoDec-GS), with independent levels and at most one million anchors.
    fn default() -> Self {
        Self {
            observe_from: 500,
            from: 1500,
            until: 15_000,
            every: 100,
            success: 0.8,
            grad: 2e-4,
            levels: 3,
            coarsest: 16,
            hierarchy: 4,
            only_after_coarser: false,
            min_opacity: 0.01,
            extent_cap_log: 0.05,
            max_anchors: 1_000_000,
        }
    }
}

impl AnchorDensifyRules {
    /// Whether views are observed at step `clock`.
    pub fn observes_at(&self, clock: u32) -> bool {
        clock > self.observe_from && clock < self.until
    }

    /// Whether a pass is due at step `clock`.
    pub fn grows_at(&self, clock: u32) -> bool {
        clock > self.from && clock < self.until && clock.is_multiple_of(self.every)
    }

    /// Mean screen gradient from which a Gaussian grows an anchor on a level.
    pub(super) fn threshold(&self, level: u32) -> f32 {
        self.grad * (0.5 * self.hierarchy as f32).powi(level as i32)
    }

    /// Side of a level's cells, in cells of the initial anchors.
    pub(super) fn cells(&self, level: u32) -> u32 {
        self.coarsest / self.hierarchy.saturating_pow(level).max(1)
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting out of its domain.
    pub fn check(&self) -> Result<(), SettingError> {
        require(self.every > 0, "adapt.every", 0, "at least 1 step")?;
        require((0.0..=1.0).contains(&self.success), "adapt.success", self.success, "a share, 0 to 1")?;
        require(self.grad >= 0.0 && self.grad.is_finite(), "adapt.grad", self.grad, "finite, not negative")?;
        require((1..=8).contains(&self.levels), "adapt.levels", self.levels, "1 to 8")?;
        require((1..=1 << 20).contains(&self.coarsest), "adapt.coarsest", self.coarsest, "1 to 2^20 cells")?;
        require((1..=1 << 10).contains(&self.hierarchy), "adapt.hierarchy", self.hierarchy, "1 to 1024")?;
        let finest = self.cells(self.levels - 1);
        require(
            finest > 0,
            "adapt.coarsest",
            self.coarsest,
            "at least hierarchy^(levels - 1): the finest cells have a side",
        )?;
        let opacity = self.min_opacity;
        require(opacity >= 0.0 && opacity.is_finite(), "adapt.min_opacity", opacity, "finite, not negative")?;
        require(self.extent_cap_log.is_finite(), "adapt.extent_cap_log", self.extent_cap_log, "finite")?;
        require(self.max_anchors > 0, "adapt.max_anchors", 0, "at least 1 anchor")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_levels() {
        let rules = AnchorDensifyRules::default();
        assert_eq!(rules.check(), Ok(()));
        assert_eq!([0, 1, 2].map(|l| rules.cells(l)), [16, 4, 1]);
        assert_eq!([0, 1, 2].map(|l| rules.threshold(l)), [2e-4, 4e-4, 8e-4]);
        assert!(rules.observes_at(501) && !rules.observes_at(500) && !rules.observes_at(15_000));
        assert!(rules.grows_at(1600) && !rules.grows_at(1500) && !rules.grows_at(1650) && !rules.grows_at(15_000));
    }

    #[test]
    fn what_cannot_be_done_is_refused_by_name() {
        let field = |change: fn(&mut AnchorDensifyRules)| {
            let mut rules = AnchorDensifyRules::default();
            change(&mut rules);
            rules.check().unwrap_err().field
        };
        assert_eq!(field(|r| r.every = 0), "adapt.every");
        assert_eq!(field(|r| r.success = f32::NAN), "adapt.success");
        assert_eq!(field(|r| r.grad = -1.0), "adapt.grad");
        assert_eq!(field(|r| r.levels = 0), "adapt.levels");
        assert_eq!(field(|r| r.levels = 4), "adapt.coarsest");
        assert_eq!(field(|r| r.hierarchy = 0), "adapt.hierarchy");
        assert_eq!(field(|r| r.min_opacity = f32::NAN), "adapt.min_opacity");
        assert_eq!(field(|r| r.extent_cap_log = f32::INFINITY), "adapt.extent_cap_log");
        assert_eq!(field(|r| r.max_anchors = 0), "adapt.max_anchors");
    }
}
