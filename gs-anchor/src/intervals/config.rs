//! Settings of the intervals.

use crate::setting::{SettingError, require};
use serde::{Deserialize, Serialize};

/// The rule by which boundaries move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rule {
    /// The rule of the paper.
    Clean,
    /// The rule of the released code.
    Ref,
}

/// The statistic of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Statistic {
    /// Sum of the gradients' norms over visible Gaussians: views with more Gaussians weigh more (published).
    Sum,
    /// Mean of the gradients' norms over visible Gaussians.
    Mean,
}

/// What frames between two canonical times have of the deformations of the anchors there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Blend {
    /// The deformation of the canonical time before: anchors jump where an interval begins (published).
    #[default]
    Hold,
    /// A straight line from one to the next: anchors move, and turn sharply where an interval begins (ours).
    Linear,
    /// A cubic curve through them, with the slope between its neighbours at each (Catmull and Rom 1974; ours).
    Smooth,
}

/// Settings of the intervals. Steps count within the stage's schedule.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IntervalConfig {
    /// Whether boundaries move at all.
    pub on: bool,
    /// Number of intervals, `N`, 1 to 4096.
    pub segments: u32,
    /// Boundaries at first, `b_1 < … < b_{N−1}`, normalised time; empty: equal intervals.
    #[serde(default)]
    pub starts: Vec<f32>,
    /// First step at which views are observed and boundaries move.
    pub from: u32,
    /// Last step at which views are observed and boundaries move.
    pub until: u32,
    /// Boundaries move every `period` steps, at least 1.
    pub period: u32,
    /// An interval is busy if its gradient exceeds the mean by more than this many standard deviations, τ.
    pub tau: f32,
    /// Length of a move, in equal intervals: boundaries move by `step / N`.
    pub step: f32,
    /// The rule by which boundaries move.
    pub rule: Rule,
    /// The statistic of a view.
    pub statistic: Statistic,
    /// How frames between canonical times are deformed.
    #[serde(default)]
    pub blend: Blend,
}

impl Default for IntervalConfig {
    /// The values of the paper.
    fn default() -> Self {
        Self {
            on: true,
            segments: 8,
            starts: Vec::new(),
            from: 500,
            until: 20_000,
            period: 1000,
            tau: 1.5,
            step: 0.01,
            rule: Rule::Clean,
            statistic: Statistic::Sum,
            blend: Blend::Hold,
        }
    }
}

impl IntervalConfig {
    /// Whether a step lies within `from` and `until`; the released rule excludes both ends.
    pub(super) fn is_within(&self, clock: u32) -> bool {
        match self.rule {
            Rule::Clean => (self.from..=self.until).contains(&clock),
            Rule::Ref => clock > self.from && clock < self.until,
        }
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting out of its domain.
    pub fn check(&self) -> Result<(), SettingError> {
        require((1..=4096).contains(&self.segments), "intervals.segments", self.segments, "1 to 4096 intervals")?;
        let inside = [0.0].iter().chain(&self.starts).chain(&[1.0]).is_sorted_by(|a, b| a < b);
        let starts = self.starts.is_empty() || self.starts.len() + 1 == self.segments as usize && inside;
        let rule = "ascending between 0 and 1, one less than intervals.segments, or empty";
        require(starts, "intervals.starts", format!("{:?}", self.starts), rule)?;
        require(self.period > 0, "intervals.period", self.period, "at least 1 step")?;
        require(self.tau.is_finite(), "intervals.tau", self.tau, "finite")?;
        let keys = self.rule == Rule::Clean || self.blend == Blend::Hold;
        let blend = format!("{:?}", self.blend).to_lowercase();
        require(keys, "intervals.blend", blend, "hold, where intervals.rule is ref")?;
        let step = self.step;
        require(
            step > 0.0 && step < 0.5,
            "intervals.step",
            step,
            "above 0, below 0.5: an interval shrinks from both sides",
        )
    }

    /// A message if no interval can ever be busy under these settings.
    ///
    /// Among n values none exceeds their mean by more than `(n−1)/√n` standard deviations. The clean rule compares N
    /// intervals, the released one N − 1.
    pub fn warning(&self) -> Option<String> {
        let n = match self.rule {
            Rule::Clean => self.segments,
            Rule::Ref => self.segments.saturating_sub(1),
        };
        let bound = if n < 2 { 0.0 } else { f64::from(n - 1) / f64::from(n).sqrt() };
        // A value at the bound is compared by rounding alone.
        let idle = self.on && bound <= f64::from(self.tau) * (1.0 + 1e-6);
        idle.then(|| {
            format!(
                "intervals.segments = {}, intervals.tau = {}: no boundary can ever move, since no interval of so few lies \
                 more than {bound:.3} standard deviations above the mean; use more segments or a smaller tau",
                self.segments, self.tau
            )
        })
    }
}
