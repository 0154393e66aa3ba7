//! Temporal intervals whose boundaries move during training (MoDec-GS, Kwak et al. 2025, section 3.4).
//!
//! ```text
//! b_0 = 0 < b_1 < … < b_{N−1} < b_N = 1,   interval(t) = last c with b_c ≤ t,   canonical time of t = b_interval(t)
//! ```
//! All frames of an interval share one deformation of the anchors, that of its canonical time, or blend those of the canonical
//! times around them ([`Blend`]). A large gradient of the screen positions shows motion that is not modelled well: such intervals
//! become shorter ([`Intervals::adjust`]).
//!
//! [`Rule::Ref`] is the rule of the released code. There the canonical time is that of the *nearest* boundary, less
//! `1/N` if that lies after `t`; once boundaries have moved this is generally no boundary at all, and such frames are
//! left out of the statistic. Gradients of interval `c` are counted in slot `c − 1` and move the boundaries around that
//! one, `b_0` among them.
//!
//! ```
//! use gs_anchor::{IntervalConfig, Intervals};
//!
//! let mut intervals = Intervals::new(&IntervalConfig::default(), 100)?;
//! assert_eq!((intervals.locate(0.3), intervals.canonical_time(0.3)), (2, 0.25));
//! for view in 0..8 {
//!     let t = (view as f32 + 0.5) / 8.0;
//!     intervals.observe(t, if view == 4 { 9.0 } else { 1.0 }, 1, 1.0);
//! }
//! let adjustment = intervals.adjust(1000, 1000).expect("a pass is due at step 1000");
//! assert_eq!((adjustment.hot, adjustment.moves.len()), (vec![4], 2));
//! assert_eq!(intervals.starts.value[4..6], [0.50125, 0.62375], "the fifth interval shrinks from both sides");
//! # Ok::<(), gs_anchor::SettingError>(())
//! ```

mod adjust;
mod blend;
mod config;

pub use adjust::{Adjustment, Move, Rejected};
pub use config::{Blend, IntervalConfig, Rule, Statistic};

use crate::setting::{SettingError, require};
use gs_core::{Param, Params};

/// Boundaries of the temporal intervals, and the gradients observed in each.
#[derive(Clone, Debug, PartialEq)]
pub struct Intervals {
    config: IntervalConfig,
    /// Time between neighbouring frames, normalised.
    frame: f32,
    /// Starts of the intervals, normalised time, `[N]`: block `intervals.starts`. Moved by rule, not trained.
    pub starts: Param,
    /// Sum of observed gradients per interval, `[N]`.
    pub grad: Vec<f32>,
    /// Views observed per interval, `[N]`.
    pub views: Vec<f32>,
}

impl Intervals {
    /// Equal intervals, or those given, for a scene of `frames` timestamps, evenly spaced over 0 … 1.
    ///
    /// # Errors
    /// If a setting is out of its domain or `frames` is 0.
    pub fn new(config: &IntervalConfig, frames: u32) -> Result<Self, SettingError> {
        config.check()?;
        require(frames > 0, "frames", frames, "at least 1")?;
        let n = config.segments as usize;
        let starts = match &config.starts[..] {
            [] => (0..n).map(|c| c as f32 / n as f32).collect(),
            given => std::iter::once(0.0).chain(given.iter().copied()).collect(),
        };
        Ok(Self {
            config: config.clone(),
            frame: 1.0 / (frames - 1).max(1) as f32,
            starts: Param::shared("intervals.starts", starts),
            grad: vec![0.0; n],
            views: vec![0.0; n],
        })
    }

    /// The settings these intervals were built from.
    pub fn config(&self) -> &IntervalConfig {
        &self.config
    }

    /// Number of intervals, `N`.
    pub fn len(&self) -> usize {
        self.starts.len()
    }

    /// Whether [`Intervals::len`] is 0, which it never is.
    pub fn is_empty(&self) -> bool {
        self.starts.is_empty()
    }

    /// The interval of a normalised time; the first before 0, the last after 1.
    pub fn locate(&self, t: f32) -> usize {
        self.starts.value.iter().rposition(|b| *b <= t).unwrap_or(0)
    }

    /// The canonical time whose deformation of the anchors frames at normalised time `t` use.
    pub fn canonical_time(&self, t: f32) -> f32 {
        match self.config.rule {
            Rule::Clean => self.starts.value[self.locate(t)],
            Rule::Ref => self.nearest_left(t),
        }
    }

    /// The released rule: the nearest boundary, or `1/N` before it if it lies after `t`.
    fn nearest_left(&self, t: f32) -> f32 {
        let starts = &self.starts.value;
        let mut nearest = starts[0];
        for &b in &starts[1..] {
            if (b - t).abs() < (nearest - t).abs() {
                nearest = b;
            }
        }
        if nearest <= t { nearest } else { nearest - 1.0 / starts.len() as f32 }
    }

    /// The slot of the statistic a view at `t` counts in, if any.
    fn slot(&self, t: f32) -> Option<usize> {
        match self.config.rule {
            Rule::Clean => Some(self.locate(t)),
            Rule::Ref => {
                let canonical = self.nearest_left(t);
                self.starts.value.iter().position(|b| *b == canonical)?.checked_sub(1)
            }
        }
    }

    /// Whether views are observed at step `clock` of the stage's schedule.
    pub fn observes_at(&self, clock: u32) -> bool {
        self.config.on && self.config.is_within(clock)
    }

    /// Adds one view at normalised time `t`: `sum` is the sum over its `visible` Gaussians of the norms of the
    /// gradients of their screen positions, half-image units; `weight` undoes a mean over the views of a batch. A sum
    /// that is not finite counts as 0.
    pub fn observe(&mut self, t: f32, sum: f32, visible: usize, weight: f32) {
        let Some(slot) = self.slot(t) else { return };
        let value = match self.config.statistic {
            Statistic::Sum => sum * weight,
            Statistic::Mean => sum * weight / visible.max(1) as f32,
        };
        self.grad[slot] += if value.is_finite() { value } else { 0.0 };
        self.views[slot] += 1.0;
    }

    /// The buffers of the statistic with their names, `[N]` each, for checkpoints.
    pub fn columns(&self) -> [(&'static str, &Vec<f32>); 2] {
        [("intervals.grad", &self.grad), ("intervals.views", &self.views)]
    }

    /// The buffers of [`Intervals::columns`], to be restored.
    pub fn columns_mut(&mut self) -> [(&'static str, &mut Vec<f32>); 2] {
        [("intervals.grad", &mut self.grad), ("intervals.views", &mut self.views)]
    }

    /// Width of each interval, frames.
    fn widths_in_frames(&self) -> Vec<f32> {
        (0..self.len()).map(|c| (self.end(c) - self.starts.value[c]) / self.frame).collect()
    }

    /// End of an interval: the start of the next, or 1.
    fn end(&self, c: usize) -> f32 {
        self.starts.value.get(c + 1).copied().unwrap_or(1.0)
    }

    /// No move makes an interval narrower than this, normalised time: the larger of two frames and a fifth of an equal
    /// interval.
    fn min_width(&self) -> f32 {
        (2.0 * self.frame).max(0.2 / self.len() as f32)
    }

    /// A message if no boundary can ever move under these settings.
    pub fn warning(&self) -> Option<String> {
        let narrow = || {
            let n = self.len();
            (self.config.on && self.config.rule == Rule::Clean && 1.0 / (n as f32) < self.min_width()).then(|| {
                format!("intervals.segments = {n}: an interval is narrower than two frames, so no boundary can move; use fewer")
            })
        };
        self.config.warning().or_else(narrow)
    }
}

impl Params for Intervals {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        f(&self.starts);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        f(&mut self.starts);
    }
}

#[cfg(test)]
mod tests;
