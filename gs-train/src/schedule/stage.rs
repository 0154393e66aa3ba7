//! A stretch of a run, and how its views are let in by time.

use serde::{Deserialize, Serialize};

/// A stretch of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// Stages follow each other by this number.
    pub order: u32,
    /// Number of steps; 0 leaves the stage out.
    pub steps: u32,
    /// Whether the deformation field takes part.
    pub dynamic: bool,
    /// Training images are reduced by this factor (1: full size).
    pub image_scale: f64,
    /// Learning rates and density control count steps from the start of this stage, and the optimiser forgets its
    /// moments there (4DGaussians). Otherwise they count from the start of the run (Deformable 3DGS).
    pub own_clock: bool,
    /// Only views of the first timestamp are learnt from (TRACE's warm-up), where several cameras saw it.
    #[serde(default)]
    pub first_moment: bool,
    /// Views are let in by time: at first a part of the span, then one part more at equal intervals (TRACE: 8 parts); at most as many
    /// parts as there are moments. 0: all views from the start.
    #[serde(default)]
    pub window_parts: u32,
    /// Share of the stage's steps after which all views are drawn alike, at most [`LATEST_WINDOW`] (TRACE: 7000 of 37000 steps).
    #[serde(default)]
    pub window_until: f64,
    /// Share of the draws that are of the part let in last, until the next one is, at most ½ (ours: one after the other, so that a
    /// field follows what moves). 0: all views alike.
    #[serde(default)]
    pub window_newest: f64,
    /// Only the field learns, and it alone moves splats: the canonical cloud rests, so a body that moves far between frames
    /// cannot fade where it was, and dynamics take no part (ours).
    #[serde(default)]
    pub field_alone: bool,
}

/// The last 30 % of a stage learn from all of its views.
pub const LATEST_WINDOW: f64 = 0.7;

impl Stage {
    /// The stage for training views of so many moments.
    #[must_use]
    pub fn in_moments(&self, moments: u32) -> Self {
        Self { window_parts: self.window_parts.min(moments), ..self.clone() }
    }

    /// How much of the span of times is let in at a step of the stage, counted from 0, and the step at which the next part
    /// is; `None` once all is and views are drawn alike.
    pub fn window(&self, offset: u32) -> Option<(f64, u32)> {
        let every = self.every();
        let open = 1.0 + ((f64::from(offset) + 0.5) / every).floor();
        (open <= self.windows()).then(|| (open / f64::from(self.window_parts), (open * every - 0.5).ceil() as u32))
    }

    /// The step of the stage, counted from 0, from which all views are drawn alike. It is the same for any number of moments above one.
    pub fn alike_from(&self) -> u32 {
        let windows = self.windows();
        if windows > 0.0 { (windows * self.every() - 0.5).ceil() as u32 } else { 0 }
    }

    /// Windows that are not all views alike: where the newest part counts more, the last is one.
    fn windows(&self) -> f64 {
        let growths = self.window_parts.saturating_sub(1);
        f64::from(growths + u32::from(growths > 0 && self.window_newest > 0.0))
    }

    /// Steps of a window.
    fn every(&self) -> f64 {
        self.window_until * f64::from(self.steps) / self.windows()
    }
}
