//! Which view is drawn when.
//!
//! Views come without replacement: every one of a pool once, in a random order of its own, then the pool is made anew.
//! The pool is all views, or those of the first moment, or those up to a time that grows with the steps
//! ([`Stage::first_moment`], [`Stage::window_parts`](crate::schedule::Stage::window_parts): TRACE). All of it is a function
//! of `(seed, draw)`, so a resumed run goes on as if it had never stopped.

use crate::schedule::{Schedule, Stage};
use gs_core::Rng;

/// Times this close to a limit, normalised, lie inside.
const SLACK: f32 = 1e-6;

/// The training views in the order of a schedule.
#[derive(Clone, Debug)]
pub struct ViewOrder {
    seed: u64,
    /// Normalised time of each view.
    times: Vec<f32>,
    /// The same, ascending.
    sorted: Vec<f32>,
}

impl ViewOrder {
    /// Views of these normalised times.
    pub fn new(seed: u64, times: Vec<f32>) -> Self {
        let mut sorted = times.clone();
        sorted.sort_by(f32::total_cmp);
        Self { seed, times, sorted }
    }

    /// Index of the view drawn as number `draw` (from 1) of a run.
    pub fn view(&self, schedule: &Schedule, draw: u32) -> usize {
        let (mut epoch, mut begin) = (0, 0);
        loop {
            let limit = self.limit(schedule, begin + 1);
            let pool = self.sorted.partition_point(|&t| t <= limit + SLACK).max(1) as u32;
            let end = (begin + pool).min(next_break(schedule, begin));
            if draw <= end {
                let at = (draw - begin - 1) as usize;
                let chosen = Rng::new(self.seed, "view-order", epoch, 0).permutation(pool as usize)[at] as usize;
                return self.nth_within(limit, chosen);
            }
            (epoch, begin) = (epoch + 1, end);
        }
    }

    /// Last time of the pool that is made at a draw.
    fn limit(&self, schedule: &Schedule, draw: u32) -> f32 {
        let step = (draw - 1) / schedule.batch + 1;
        let (Some(&first), Some(&last)) = (self.sorted.first(), self.sorted.last()) else { return 0.0 };
        match schedule.stage_and_offset(step) {
            Some((stage, _)) if stage.first_moment => first,
            Some((stage, offset)) if stage.window_parts > 0 => {
                let open = (offset / stage.window_every.max(1) + 1).min(stage.window_parts);
                first + (last - first) * (open as f32 / stage.window_parts as f32)
            }
            _ => last,
        }
    }

    /// The `k`-th view, in their own order, of those up to a time.
    fn nth_within(&self, limit: f32, k: usize) -> usize {
        let inside = self.times.iter().enumerate().filter(|(_, t)| **t <= limit + SLACK);
        inside.map(|(i, _)| i).nth(k).unwrap_or(0)
    }
}

/// The last draw before the pool is made anew because a stage of first moments ends.
fn next_break(schedule: &Schedule, begin: u32) -> u32 {
    let mut end = 0;
    for (_, stage) in schedule.ordered() {
        let Stage { steps, first_moment, .. } = *stage;
        end += steps * schedule.batch;
        if first_moment && begin < end {
            return end;
        }
    }
    u32::MAX
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::MethodEntry;

    fn schedule(edit: impl Fn(&mut Schedule)) -> Schedule {
        let config = MethodEntry::find("defgs").unwrap().config("tiny").unwrap();
        let mut schedule: Schedule = config["schedule"].clone().try_into().unwrap();
        edit(&mut schedule);
        schedule
    }

    /// Four cameras at six moments.
    fn order() -> ViewOrder {
        ViewOrder::new(7, (0..24).map(|k| (k / 4) as f32 / 5.0).collect())
    }

    #[test]
    fn without_windows_every_epoch_shows_every_view_once() {
        let (order, schedule) = (order(), schedule(|_| ()));
        for epoch in 0..5u32 {
            let mut seen: Vec<usize> = (1..=24).map(|k| order.view(&schedule, 24 * epoch + k)).collect();
            let plain = Rng::new(7, "view-order", epoch, 0).permutation(24);
            assert!(
                seen.iter().zip(&plain).all(|(a, b)| *a == *b as usize),
                "the order is that of the epoch's own shuffle"
            );
            seen.sort_unstable();
            assert_eq!(seen, (0..24).collect::<Vec<_>>());
        }
    }

    #[test]
    fn warm_up_sees_the_first_moment_and_the_window_grows() {
        let schedule = schedule(|s| {
            let stages = &mut s.stages;
            *stages.get_mut("warm_up").unwrap() = Stage { steps: 10, first_moment: true, ..stages["warm_up"].clone() };
            let dynamic = Stage { window_parts: 5, window_every: 20, ..stages["dynamic"].clone() };
            *stages.get_mut("dynamic").unwrap() = dynamic;
        });
        let order = order();
        let moment = |draw| order.view(&schedule, draw) / 4;
        assert!((1..=10).all(|d| moment(d) == 0));
        // The pool is made anew right after the warm-up: a fifth of the span, moments 0 and 1, eight views.
        let mut first: Vec<usize> = (11..=18).map(|d| order.view(&schedule, d)).collect();
        first.sort_unstable();
        assert_eq!(first, (0..8).collect::<Vec<_>>());
        let latest = |from: u32| (from..from + 24).map(moment).max().unwrap();
        assert_eq!([latest(20), latest(200)], [2, 5]);
        assert!((30..40).all(|d| moment(d) <= 2));
    }
}
