//! When and by how much anchors grow and are pruned.

use crate::rule::{RuleError, need};
use serde::{Deserialize, Serialize};

/// When and what to grow and prune. Steps are those of the schedule's clock.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdaptRules {
    /// Views are observed after this step (and before `until`).
    pub observe_from: u32,
    /// Anchors grow and are pruned after this step …
    pub from: u32,
    /// … and before this one (0: never).
    pub until: u32,
    /// Every so many steps.
    pub every: u32,
    /// Share of the views between two passes that an anchor must have been visible in to be pruned; half of it is the
    /// share in which a Gaussian must have been drawn to grow.
    pub success: f32,
    /// Mean screen gradient (half-image units) from which a Gaussian asks for an anchor on the coarsest level.
    pub grad: f32,
    /// Levels, the coarsest first.
    pub levels: u32,
    /// Side of a cell of the coarsest level, in cells of the first anchors.
    pub coarsest: u32,
    /// Each level's cells are smaller by this factor (whole-number division), and its threshold larger by half of it.
    pub hierarchy: u32,
    /// Finer levels take part only if a coarser one of the same pass added an anchor, as in the released code. Off: each
    /// level by itself.
    pub only_after_coarser: bool,
    /// Mean sum of opacities below which an anchor is pruned.
    pub min_opacity: f32,
    /// Upper bound of the logarithms of the extents, ln of world units.
    pub extent_cap_log: f32,
    /// No growth beyond this many anchors; on each level the largest gradients go first.
    pub max_anchors: u32,
}

impl Default for AdaptRules {
    /// The published values (MoDec-GS), levels each by themselves, with a cap of one million anchors.
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

impl AdaptRules {
    /// Whether views are observed at this step.
    pub fn observes_at(&self, clock: u32) -> bool {
        clock > self.observe_from && clock < self.until
    }

    /// Whether anchors grow and are pruned at this step.
    pub fn grows_at(&self, clock: u32) -> bool {
        clock > self.from && clock < self.until && clock.is_multiple_of(self.every)
    }

    /// Gradient from which a Gaussian asks for an anchor on a level.
    pub(super) fn threshold(&self, level: u32) -> f32 {
        self.grad * (0.5 * self.hierarchy as f32).powi(level as i32)
    }

    /// Side of a level's cells, in cells of the first anchors.
    pub(super) fn cells(&self, level: u32) -> u32 {
        self.coarsest / self.hierarchy.saturating_pow(level).max(1)
    }

    /// Verifies every field.
    ///
    /// # Errors
    /// The first field out of its domain.
    pub fn check(&self) -> Result<(), RuleError> {
        need(self.every > 0, "adapt.every", 0, "at least 1 step")?;
        need((0.0..=1.0).contains(&self.success), "adapt.success", self.success, "a share, 0 to 1")?;
        need(self.grad >= 0.0 && self.grad.is_finite(), "adapt.grad", self.grad, "finite, not negative")?;
        need((1..=8).contains(&self.levels), "adapt.levels", self.levels, "1 to 8")?;
        need((1..=1 << 20).contains(&self.coarsest), "adapt.coarsest", self.coarsest, "1 to 2^20 cells")?;
        need((1..=1 << 10).contains(&self.hierarchy), "adapt.hierarchy", self.hierarchy, "1 to 1024")?;
        let finest = self.cells(self.levels - 1);
        need(
            finest > 0,
            "adapt.coarsest",
            self.coarsest,
            "at least hierarchy^(levels - 1): the finest cells have a side",
        )?;
        let opacity = self.min_opacity;
        need(opacity >= 0.0 && opacity.is_finite(), "adapt.min_opacity", opacity, "finite, not negative")?;
        need(self.extent_cap_log.is_finite(), "adapt.extent_cap_log", self.extent_cap_log, "finite")?;
        need(self.max_anchors > 0, "adapt.max_anchors", 0, "at least 1 anchor")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_levels() {
        let rules = AdaptRules::default();
        assert_eq!(rules.check(), Ok(()));
        assert_eq!([0, 1, 2].map(|l| rules.cells(l)), [16, 4, 1]);
        assert_eq!([0, 1, 2].map(|l| rules.threshold(l)), [2e-4, 4e-4, 8e-4]);
        assert!(rules.observes_at(501) && !rules.observes_at(500) && !rules.observes_at(15_000));
        assert!(rules.grows_at(1600) && !rules.grows_at(1500) && !rules.grows_at(1650) && !rules.grows_at(15_000));
    }

    #[test]
    fn what_cannot_be_done_is_refused_by_name() {
        let field = |change: fn(&mut AdaptRules)| {
            let mut rules = AdaptRules::default();
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
