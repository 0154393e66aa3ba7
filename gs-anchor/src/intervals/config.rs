//! Settings of the intervals.

use crate::rule::{RuleError, need};
use serde::{Deserialize, Serialize};

/// Which rules move the boundaries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rule {
    /// What the paper describes.
    Clean,
    /// What the released code does.
    Ref,
}

/// What is observed of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Statistic {
    /// The sum of the gradients' lengths over visible Gaussians: views that see more weigh more (published).
    Sum,
    /// Their mean.
    Mean,
}

/// Settings of the intervals. Steps are those of the schedule's clock.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IntervalConfig {
    /// Whether boundaries move at all.
    pub on: bool,
    /// Number of intervals, N.
    pub segments: u32,
    /// Views are observed and boundaries moved from this step …
    pub from: u32,
    /// … to this one.
    pub until: u32,
    /// Boundaries are moved every so many steps.
    pub period: u32,
    /// Intervals are busy whose gradient exceeds the mean by more than this many standard deviations, τ.
    pub tau: f32,
    /// Length of a move, in equal intervals: boundaries move by `step / N`.
    pub step: f32,
    /// Which rules.
    pub rule: Rule,
    /// What is observed.
    pub statistic: Statistic,
}

impl Default for IntervalConfig {
    /// The values of the paper.
    fn default() -> Self {
        Self {
            on: true,
            segments: 8,
            from: 500,
            until: 20_000,
            period: 1000,
            tau: 1.5,
            step: 0.01,
            rule: Rule::Clean,
            statistic: Statistic::Sum,
        }
    }
}

impl IntervalConfig {
    /// Whether a step lies within `from` and `until`; the released code leaves both ends out.
    pub(super) fn is_within(&self, clock: u32) -> bool {
        match self.rule {
            Rule::Clean => (self.from..=self.until).contains(&clock),
            Rule::Ref => clock > self.from && clock < self.until,
        }
    }

    /// Verifies every field.
    ///
    /// # Errors
    /// The first field out of its domain.
    pub fn check(&self) -> Result<(), RuleError> {
        need((1..=4096).contains(&self.segments), "intervals.segments", self.segments, "1 to 4096 intervals")?;
        need(self.period > 0, "intervals.period", self.period, "at least 1 step")?;
        need(self.tau.is_finite(), "intervals.tau", self.tau, "finite")?;
        let step = self.step;
        need(
            step > 0.0 && step < 0.5,
            "intervals.step",
            step,
            "above 0, below 0.5: an interval shrinks from both sides",
        )
    }

    /// A warning where no interval can ever be busy, for people.
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
