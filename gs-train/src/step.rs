//! Where a step of training lies in its schedule, as a method sees it.

use crate::schedule::Schedule;
use glam::Vec3;
use gs_core::SplatsGrad;

/// One step, resolved from the schedule once.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct StepCtx {
    /// Number of the step, from 1; 0 before the first.
    pub step: u32,
    /// The step on the clock that learning rates and densification follow.
    pub clock: u32,
    /// Views of the step; their losses are averaged.
    pub batch: u32,
    /// Name of its stage in the schedule.
    pub stage: String,
    /// Number of steps of that stage.
    pub stage_steps: u32,
    /// Steps of the stage made before this one.
    pub stage_offset: u32,
    /// Whether the deformation field takes part.
    pub dynamic: bool,
    /// Whether only the field learns, and it alone moves splats.
    pub deform_only: bool,
    /// Highest SH degree rendered, 0 to 3.
    pub sh_degree: u8,
    /// Whether this is the last step of its stage.
    pub ends_stage: bool,
    /// Whether the next step begins a stage with a clock of its own, before which statistics are cleared.
    pub ends_clock: bool,
}

impl StepCtx {
    /// While the field alone learns, it learns no sizes: splats of a body that has moved on would sooner shrink to nothing than
    /// follow it.
    pub fn keep_sizes(&self, d_splats: &mut SplatsGrad) {
        if self.deform_only {
            d_splats.scales.fill(Vec3::ZERO);
        }
    }
}

/// The highest SH degree there is.
const MAX_SH_DEGREE: u8 = 3;

impl Schedule {
    /// Step `step` of this schedule; 0 is the state before the first one. Steps beyond the end belong to the last stage.
    pub fn at(&self, step: u32) -> StepCtx {
        let stages = self.ordered();
        let position = self.position(step);
        let before: u32 = stages.iter().take(position.stage).map(|s| s.1.steps).sum();
        let (name, stage) = stages.get(position.stage).map_or(("", None), |(n, s)| (*n, Some(*s)));
        StepCtx {
            step,
            clock: position.clock,
            batch: self.batch,
            stage: name.to_owned(),
            stage_steps: stage.map_or(0, |s| s.steps),
            stage_offset: step.saturating_sub(1 + before),
            dynamic: stage.is_some_and(|s| s.dynamic),
            deform_only: stage.is_some_and(|s| s.field_alone),
            sh_degree: self.sh_degree(step, MAX_SH_DEGREE),
            ends_stage: stage.is_some_and(|s| step == before + s.steps),
            ends_clock: self.position(step + 1).fresh,
        }
    }
}
