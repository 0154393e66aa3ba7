//! How the boundaries of intervals move.
//!
//! With ḡ the mean gradient of the intervals observed, `std` their sample deviation and δ = step / N:
//! ```text
//! hot = { c : ḡ_c > mean + τ std }
//! for c in hot:  if c > 0: b_c += δ;   if c < N − 1: b_{c+1} −= δ        a busy interval shrinks from both sides
//! ```
//! The two moves of a boundary between two busy intervals cancel. A move is rejected if the interval it shortens would
//! fall below the minimum width; boundaries are processed in order. `b_0` never moves.
//!
//! The released rule ([`Rule::Ref`]) has N − 1 slots, counts gradients of interval j + 1 in slot j, and moves the two
//! boundaries around `b_j`, one step each, as long as they do not meet: of slot 1 that moves `b_0`.

use super::{Intervals, Rule};
use gs_core::cast;
use serde::{Deserialize, Serialize};

/// One boundary move of a pass.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Move {
    /// Index of the boundary, 1 … N − 1; 0 as well under [`Rule::Ref`].
    pub boundary: usize,
    /// Normalised time before the pass.
    pub from: f32,
    /// Normalised time after the pass.
    pub to: f32,
}

/// A boundary whose move was rejected.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rejected {
    /// Index of the boundary, 1 … N − 1; 0 as well under [`Rule::Ref`].
    pub boundary: usize,
    /// Normalised time of the boundary, unchanged.
    pub at: f32,
    /// Reason of the rejection, for people.
    pub reason: String,
}

/// Findings and moves of one pass of [`Intervals::adjust`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Adjustment {
    /// Step within the stage's schedule.
    pub clock: u32,
    /// Training step of the run.
    pub step: u32,
    /// Mean gradient of each slot, ḡ; `None` if no view was observed.
    pub means: Vec<Option<f32>>,
    /// Gradient above which a slot is busy; `None` if fewer than two slots have a mean.
    pub threshold: Option<f32>,
    /// Indices of the busy slots.
    pub hot: Vec<usize>,
    /// The moves of boundaries, in order.
    pub moves: Vec<Move>,
    /// The rejected moves, in order.
    pub rejected: Vec<Rejected>,
    /// Width of every interval after the pass, frames.
    pub frames: Vec<f32>,
}

const CANCELLED: &str = "busy on both sides";
const TOO_NARROW: &str = "an interval would be too narrow";
const WOULD_MEET: &str = "it would meet its neighbour";

impl Intervals {
    /// Moves the boundaries if a pass is due at step `clock` of the stage's schedule, and resets the statistic; `None`
    /// between passes. `step` is copied to [`Adjustment::step`].
    pub fn adjust(&mut self, clock: u32, step: u32) -> Option<Adjustment> {
        if !(self.observes_at(clock) && clock.is_multiple_of(self.config.period)) {
            return None;
        }
        let means = self.means();
        let threshold = threshold(&means, self.config.tau);
        let above = |c: &usize| means[*c].zip(threshold).is_some_and(|(mean, threshold)| f64::from(mean) > threshold);
        let hot: Vec<usize> = (0..means.len()).filter(above).collect();
        let (moves, rejected) = match self.config.rule {
            Rule::Clean => self.shrink(&hot),
            Rule::Ref => self.shrink_released(&hot),
        };
        self.grad.fill(0.0);
        self.views.fill(0.0);
        let threshold = threshold.map(cast::to_f32);
        Some(Adjustment { clock, step, means, threshold, hot, moves, rejected, frames: self.widths_in_frames() })
    }

    fn means(&self) -> Vec<Option<f32>> {
        let slots = match self.config.rule {
            Rule::Clean => self.len(),
            Rule::Ref => self.len() - 1,
        };
        let mean = |c: usize| match self.config.rule {
            // The released code counts an interval without views as 0.
            Rule::Ref if self.views[c] == 0.0 => Some(0.0),
            _ => (self.views[c] > 0.0).then(|| self.grad[c] / self.views[c]),
        };
        (0..slots).map(mean).collect()
    }

    fn shrink(&mut self, hot: &[usize]) -> (Vec<Move>, Vec<Rejected>) {
        let n = self.len();
        let delta = self.config.step / n as f32;
        let mut wanted: Vec<Vec<f32>> = vec![Vec::new(); n];
        for &c in hot {
            if c > 0 {
                wanted[c].push(delta);
            }
            if c + 1 < n {
                wanted[c + 1].push(-delta);
            }
        }
        let (mut moves, mut rejected) = (Vec::new(), Vec::new());
        for (boundary, wanted) in wanted.iter().enumerate() {
            let at = self.starts.value[boundary];
            let reject = |reason: &str| Rejected { boundary, at, reason: reason.to_owned() };
            match wanted[..] {
                [] => {}
                [by] if self.keeps_min_width(boundary, at + by) => {
                    self.starts.value[boundary] = at + by;
                    moves.push(Move { boundary, from: at, to: at + by });
                }
                [_] => rejected.push(reject(TOO_NARROW)),
                _ => rejected.push(reject(CANCELLED)),
            }
        }
        (moves, rejected)
    }

    /// Whether boundary `b` may move to `to`: the interval that becomes shorter keeps the minimum width.
    fn keeps_min_width(&self, b: usize, to: f32) -> bool {
        let starts = &self.starts.value;
        let left = if to > starts[b] { self.end(b) - to } else { to - starts[b - 1] };
        left >= self.min_width()
    }

    fn shrink_released(&mut self, hot: &[usize]) -> (Vec<Move>, Vec<Rejected>) {
        let last = self.len() - 1;
        let delta = self.config.step / self.len() as f32;
        let (mut moves, mut rejected) = (Vec::new(), Vec::new());
        for &j in hot {
            let right = (j != 0).then(|| (j - 1, delta));
            let left = (j + 1 != last).then_some((j + 1, -delta));
            for (boundary, by) in right.into_iter().chain(left) {
                let (at, stop) = (self.starts.value[boundary], self.starts.value[j]);
                let to = at + by;
                if if by > 0.0 { to < stop } else { to > stop } {
                    self.starts.value[boundary] = to;
                    moves.push(Move { boundary, from: at, to });
                } else {
                    rejected.push(Rejected { boundary, at, reason: WOULD_MEET.to_owned() });
                }
            }
        }
        (moves, rejected)
    }
}

/// Mean plus τ sample deviations of the means there are; `None` for fewer than two.
fn threshold(means: &[Option<f32>], tau: f32) -> Option<f64> {
    let values: Vec<f64> = means.iter().flatten().map(|&v| f64::from(v)).collect();
    if values.len() < 2 {
        return None;
    }
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
    Some(mean + f64::from(tau) * variance.sqrt())
}
