//! When density control acts, and by which thresholds.

use crate::error::ScheduleError;
use serde::{Deserialize, Serialize};

/// What bounds the number of splats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GrowthLimits {
    /// Most splats there may be.
    pub most: usize,
    /// Densification begins after this step of the schedule's clock,
    pub from: u32,
    /// and ends before this one.
    pub until: u32,
}

/// When and what to clone, split, prune and reset. Steps are those of the schedule's clock.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DensifyRules {
    /// Growth happens after this step …
    pub from: u32,
    /// … and before this one (0: never). Resets and pruning end there too.
    pub until: u32,
    /// Steps between two passes; at least 1.
    pub every: u32,
    /// Mean screen gradient (half-image units) from which a splat is cloned or split.
    pub grad: f32,
    /// Largest scale, as a share of the extent, that is cloned rather than split.
    pub dense_share: f32,
    /// Scales of the two children are those of their parent over this.
    pub split_factor: f32,
    /// Splats below this opacity are pruned.
    pub min_opacity: f32,
    /// Splats larger than this share of the extent are pruned after the first reset; 0: never.
    pub max_world: f32,
    /// Splats whose 3σ radius exceeded this many pixels are pruned after the first reset; 0: never.
    pub max_screen: f32,
    /// Opacities are reset every so many steps; 0: never.
    pub reset_every: u32,
    /// Opacities above this are set to it.
    pub reset_opacity: f32,
    /// Also reset at step `from` when the background is white, unless `reset_every` is 0.
    pub reset_on_white: bool,
    /// Whether the last step of a stage may grow, prune and reset (TRACE's code: no, so that the next stage begins with what
    /// this one has learnt).
    #[serde(default = "yes")]
    pub at_borders: bool,
    /// Nothing is pruned where fewer would be left (TRACE's code: 1024).
    #[serde(default)]
    pub min_splats: u32,
    /// Nothing is pruned up to this many splats (4DGS's code: 200 000).
    #[serde(default)]
    pub prune_above: u32,
    /// Splats are pruned in the first pass after every so many steps (4DGS's code: 8000 or 100); 0: in every pass.
    #[serde(default)]
    pub prune_every: u32,
    /// No growth beyond this many splats; the largest gradients go first.
    pub max_splats: u32,
}

fn yes() -> bool {
    true
}

impl DensifyRules {
    /// The published values (Kerbl et al. 2023), with a cap of one million splats.
    pub fn kerbl2023() -> Self {
        Self {
            from: 500,
            until: 15_000,
            every: 100,
            grad: 2e-4,
            dense_share: 0.01,
            split_factor: 1.6,
            min_opacity: 0.005,
            max_world: 0.1,
            max_screen: 20.0,
            reset_every: 3000,
            reset_opacity: 0.01,
            reset_on_white: true,
            at_borders: true,
            min_splats: 0,
            prune_above: 0,
            prune_every: 0,
            max_splats: 1_000_000,
        }
    }

    /// How far and when a cloud grows.
    pub fn growth(&self) -> GrowthLimits {
        GrowthLimits { most: self.max_splats as usize, from: self.from, until: self.until }
    }

    /// Whether rows may be edited and opacities reset in a step, by its clock, whether only the field learns in it, and whether it is
    /// the last of its stage.
    pub(crate) fn edits_at(&self, clock: u32, field_alone: bool, ends_stage: bool) -> bool {
        clock < self.until && !field_alone && (self.at_borders || !ends_stage)
    }

    /// Whether growth and pruning happen at this step.
    pub fn grows_at(&self, clock: u32) -> bool {
        clock > self.from && clock < self.until && clock.is_multiple_of(self.every)
    }

    /// Whether opacities are reset at this step.
    pub(crate) fn resets_at(&self, clock: u32, white: bool) -> bool {
        let first = white && self.reset_on_white && clock == self.from;
        self.reset_every > 0 && (1..self.until).contains(&clock) && (clock.is_multiple_of(self.reset_every) || first)
    }

    /// Verifies every field.
    ///
    /// # Errors
    /// The first field out of its domain.
    pub fn check(&self) -> Result<(), ScheduleError> {
        let need = |good: bool, field: &str, value: f32, rule| {
            if good {
                Ok(())
            } else {
                Err(ScheduleError { field: format!("density.{field}"), value: f64::from(value), rule })
            }
        };
        need(self.every > 0, "every", 0.0, "at least 1 step")?;
        need(self.max_splats > 0, "max_splats", 0.0, "at least 1 splat")?;
        for (field, v) in [("grad", self.grad), ("dense_share", self.dense_share), ("max_world", self.max_world)] {
            need(v >= 0.0 && v.is_finite(), field, v, "finite, not negative")?;
        }
        need(self.max_screen >= 0.0, "max_screen", self.max_screen, "not negative")?;
        need(
            self.split_factor >= 1.0 && self.split_factor.is_finite(),
            "split_factor",
            self.split_factor,
            "at least 1",
        )?;
        for (field, v) in [("min_opacity", self.min_opacity), ("reset_opacity", self.reset_opacity)] {
            need((0.0..1.0).contains(&v), field, v, "0 or more, below 1")?;
        }
        need(self.reset_opacity > 0.0, "reset_opacity", self.reset_opacity, "above 0")
    }
}

#[cfg(test)]
mod tests {
    use crate::registry::section;
    use crate::schedule::{Background, Schedule};

    /// Every 3000 steps and, over white, where growth begins. TRACE's code spares step 3000, at which its warm-up ends; that of
    /// Deformable 3DGS does not.
    #[test]
    fn published_presets_reset_opacities_as_their_authors_do_and_short_ones_never() {
        let resets = |method: &'static str, preset: &str| {
            let config = gs_methods::registry().find(method).and_then(|m| m.config(preset)).unwrap();
            let schedule: Schedule = section(method, &config, "schedule").unwrap();
            let (rules, white) = (&schedule.density, schedule.background == Background::White);
            let due = |step: &u32| {
                let at = schedule.at(*step);
                rules.edits_at(at.clock, at.deform_only, at.ends_stage) && rules.resets_at(at.clock, white)
            };
            (1..=schedule.steps()).filter(due).collect::<Vec<u32>>()
        };
        for preset in ["paper", "parity"] {
            assert_eq!(resets("trace", preset), [500, 6000, 9000, 12_000], "{preset}");
        }
        assert_eq!(resets("defgs", "paper"), [3000, 6000, 9000, 12_000]);
        for (method, preset) in [("trace", "fast"), ("trace", "tiny"), ("defgs", "fast"), ("defgs", "tiny")] {
            assert!(resets(method, preset).is_empty(), "{method} {preset}");
        }
    }
}
