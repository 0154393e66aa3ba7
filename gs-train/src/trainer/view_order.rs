//! Which view is drawn when.
//!
//! Views come without replacement: every one of a pool once, in a random order of its own, then the pool is made anew.
//! The pool is all views, or those of the first timestamp, or those up to a time that grows with the steps
//! ([`Stage`](crate::schedule::Stage): `first_moment`, `window_parts`; TRACE). It is made anew when it grows, too: what is let
//! in is seen at once, before it has gone far, and a share of the draws may be of it alone (`window_newest`). All of it is a
//! function of `(seed, draw)`, so a resumed run goes on as if it had never stopped.

use crate::schedule::Schedule;
use gs_core::{Rng, cast};
use std::cell::{Cell, RefCell};

/// Where views are taken from.
#[derive(Clone, Copy, Debug)]
struct Pool {
    /// Views up to this time.
    to: f32,
    /// The last draw before the pool is made anew, at the latest.
    until: u32,
    /// A share of the draws, and the time that their views begin at.
    newest: (f64, f32),
}

impl Pool {
    /// Whether draw `at`, from 0, is one of the newest views, and how many of its kind were made before.
    fn draw(&self, at: u32) -> (bool, u32) {
        let newest = |draws: u32| cast::to_u32(cast::to_usize(f64::from(draws) * self.newest.0));
        let before = newest(at);
        if newest(at + 1) > before { (true, before) } else { (false, at - before) }
    }
}

/// The views of a pool that are drawn alike; beside the seed, their order depends on nothing else.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Lot {
    /// Number of the pool.
    epoch: u32,
    /// Whether they are its newest.
    newest: bool,
    /// Their first and last time.
    times: [f32; 2],
}

/// Times this close to a limit, normalised, lie inside.
const SLACK: f32 = 1e-6;
/// Orders that are kept: of all views and of the newest, of the pool of a step and of that of the next.
const KEPT: usize = 4;

/// The training views in the order of a schedule.
#[derive(Clone, Debug)]
pub(crate) struct ViewOrder {
    seed: u64,
    /// The moment of each view, normalised time.
    times: Vec<f32>,
    /// The same, ascending.
    sorted: Vec<f32>,
    /// How many of them differ.
    moments: u32,
    /// Number and begin of the pool the last view came from: where the search for the next one starts.
    last: Cell<(u32, u32)>,
    /// The orders last drawn from, the latest first.
    orders: RefCell<Vec<(Lot, Vec<usize>)>>,
}

impl ViewOrder {
    /// Views of these moments, normalised time.
    pub(crate) fn new(seed: u64, times: Vec<f32>) -> Self {
        let mut sorted = times.clone();
        sorted.sort_by(f32::total_cmp);
        let moments = cast::to_u32(sorted.chunk_by(|a, b| b - a <= SLACK).count());
        Self { seed, times, sorted, moments, last: Cell::default(), orders: RefCell::default() }
    }

    /// Index of the view drawn as number `draw` (from 1) of a run.
    pub(crate) fn view(&self, schedule: &Schedule, draw: u32) -> usize {
        let last = self.last.get();
        let (mut epoch, mut begin) = if draw > last.1 { last } else { (0, 0) };
        loop {
            let pool = self.pool(schedule, begin + 1);
            let views = self.views_until(pool.to).max(1);
            let end = (begin + views as u32).min(pool.until);
            if draw <= end {
                self.last.set((epoch, begin));
                let (newest, at) = pool.draw(draw - begin - 1);
                let from = if newest { pool.newest.1 } else { f32::MIN };
                return self.pick(Lot { epoch, newest, times: [from, pool.to] }, at);
            }
            (epoch, begin) = (epoch + 1, end);
        }
    }

    /// The view at a place of the order of a lot; after the last comes the first again.
    fn pick(&self, lot: Lot, at: u32) -> usize {
        let mut orders = self.orders.borrow_mut();
        let kept = orders.iter().position(|(of, _)| *of == lot);
        let (_, order) = kept.map_or_else(|| (lot, self.shuffled(lot)), |k| orders.remove(k));
        let view = order.get(at as usize % order.len().max(1)).copied().unwrap_or(0);
        orders.insert(0, (lot, order));
        orders.truncate(KEPT);
        view
    }

    /// The views of a lot in the order they are drawn.
    fn shuffled(&self, Lot { epoch, newest, times: [from, to] }: Lot) -> Vec<usize> {
        let views: Vec<usize> = self.within(from, to).collect();
        let order = Rng::new(self.seed, "view-order", epoch, newest.into()).permutation(views.len());
        order.into_iter().map(|k| views[k as usize]).collect()
    }

    /// The pool that is made at a draw.
    fn pool(&self, schedule: &Schedule, draw: u32) -> Pool {
        let step = (draw - 1) / schedule.batch + 1;
        let (first, last) = (self.sorted.first().copied().unwrap_or(0.0), self.sorted.last().copied().unwrap_or(0.0));
        let up_to = |to, until| Pool { to, until, newest: (0.0, to) };
        let Some((stage, offset)) = schedule.stage_and_offset(step) else { return up_to(last, u32::MAX) };
        if offset >= stage.steps {
            return up_to(last, u32::MAX); // beyond the last step: images are read ahead
        }
        let stage = stage.in_moments(self.moments);
        let begin = step - 1 - offset;
        let end = (begin + stage.steps).saturating_mul(schedule.batch);
        if stage.first_moment && self.views_until(first) > 1 {
            up_to(first, end)
        } else if let Some((open, grows)) = stage.window(offset) {
            let grows = begin.saturating_add(grows).saturating_mul(schedule.batch);
            let let_in = |share: f64| first + (last - first) * cast::to_f32(share);
            let to = let_in(open);
            let before = let_in(open - 1.0 / f64::from(stage.window_parts)) + 2.0 * SLACK;
            let latest = self.sorted[self.views_until(to).max(1) - 1];
            Pool { newest: (stage.window_newest, latest.min(before)), ..up_to(to, grows.min(end)) }
        } else {
            up_to(last, if schedule.later_is_narrower(step) { end } else { u32::MAX })
        }
    }

    /// Number of views up to a time.
    fn views_until(&self, limit: f32) -> usize {
        self.sorted.partition_point(|&t| t <= limit + SLACK)
    }

    /// The views of these times, in their own order.
    fn within(&self, from: f32, to: f32) -> impl Iterator<Item = usize> + '_ {
        let within = move |t: f32| (from..=to + SLACK).contains(&t);
        (0..self.times.len()).filter(move |i| within(self.times[*i]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schedule::Stage;
    use crate::schedule::tests::schedule as plain;
    use std::collections::{BTreeMap, BTreeSet};

    /// A warm-up of 10 steps, then 200 with the field.
    fn schedule(edit: impl Fn(&mut Schedule)) -> Schedule {
        let stage = |order, steps| Stage { order, steps, dynamic: order > 0, image_scale: 1.0, ..Stage::default() };
        let mut schedule = plain(vec![]);
        schedule.stages = BTreeMap::from([("warm_up".to_owned(), stage(0, 10)), ("dynamic".to_owned(), stage(1, 200))]);
        edit(&mut schedule);
        schedule
    }

    /// Four cameras at six timestamps.
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
            let dynamic = Stage { window_parts: 5, window_until: 0.4, ..stages["dynamic"].clone() };
            *stages.get_mut("dynamic").unwrap() = dynamic;
        });
        let order = order();
        let moment = |draw| order.view(&schedule, draw) / 4;
        assert!((1..=10).all(|d| moment(d) == 0));
        // The pool is made anew right after the warm-up: a fifth of the span, timestamps 0 and 1, eight views.
        let mut first: Vec<usize> = (11..=18).map(|d| order.view(&schedule, d)).collect();
        first.sort_unstable();
        assert_eq!(first, (0..8).collect::<Vec<_>>());
        // It is made anew whenever the window grows: at draws 31, 51, 71 and 91, and shows all of it once more.
        let seen = |from: u32, n: u32| (from..from + n).map(|d| order.view(&schedule, d)).collect::<BTreeSet<_>>();
        for (part, from) in [31, 51, 71, 91].into_iter().enumerate() {
            let open = 4 * (part as u32 + 3);
            assert!(seen(from, 20.min(open)).iter().all(|v| *v < open as usize), "{part}");
            assert_eq!(seen(from, open.min(20)).len() as u32, open.min(20), "{part}: every one at most once");
        }
        assert_eq!(seen(91, 24).len(), 24);
    }

    #[test]
    fn half_of_the_draws_are_of_the_newest_part_until_all_had_their_turn() {
        let newest = Stage {
            steps: 240,
            dynamic: true,
            window_parts: 6,
            window_until: 0.5,
            window_newest: 0.5,
            ..Stage::default()
        };
        let schedule = schedule(|s| s.stages = BTreeMap::from([("dynamic".to_owned(), newest.clone())]));
        let order = order();
        let moments: Vec<usize> = (1..=240).map(|draw| order.view(&schedule, draw) / 4).collect();
        // A part of six opens every 20 steps: one timestamp of four cameras each.
        for (part, draws) in moments[..120].chunks(20).enumerate() {
            assert!(draws.iter().all(|m| *m <= part), "part {part}: {draws:?}");
            let new = draws.iter().filter(|m| **m == part).count();
            assert!((10..=if part == 0 { 20 } else { 15 }).contains(&new), "part {part}: {draws:?}");
        }
        let late = |part| moments[120..].iter().filter(|m| **m == part).count();
        assert!((0..6).all(|part| (8..=20).contains(&late(part))), "{:?}", &moments[120..]);
    }

    /// Of a hundred parts of six moments most would let in nothing, and the last moment would be the newest for a hundredth.
    #[test]
    fn more_parts_than_moments_give_each_moment_as_many_steps() {
        let order = order();
        let drawn = |window_parts| {
            let stage = Stage { steps: 200, window_parts, window_until: 0.5, window_newest: 0.5, ..Stage::default() };
            let schedule = schedule(|s| s.stages = BTreeMap::from([("follow".to_owned(), stage.clone())]));
            (1..=200).map(|draw| order.view(&schedule, draw)).collect::<Vec<_>>()
        };
        assert_eq!(drawn(100), drawn(6));
        assert_ne!(drawn(5), drawn(6));
    }

    #[test]
    fn a_pool_of_all_views_does_not_outlast_a_stage_before_a_window() {
        let windowed = |order, steps| Stage { order, steps, window_parts: 6, window_until: 0.5, ..Stage::default() };
        let stages = [("follow", windowed(0, 40)), ("dynamic", windowed(1, 60))];
        let schedule = schedule(|s| s.stages = stages.clone().map(|(name, stage)| (name.to_owned(), stage)).into());
        let order = order();
        assert!((41..=45).all(|draw| order.view(&schedule, draw) < 4), "the first of six parts");
    }

    #[test]
    fn a_pool_of_all_views_does_not_outlast_a_short_stage_before_a_window() {
        let plain = |order, steps| Stage { order, steps, ..Stage::default() };
        let window = Stage { window_parts: 6, window_until: 0.5, ..plain(2, 60) };
        let stages = [("a", plain(0, 10)), ("b", plain(1, 5)), ("c", window)];
        let schedule = schedule(|s| s.stages = stages.clone().map(|(name, stage)| (name.to_owned(), stage)).into());
        let order = order();
        assert!((16..=21).all(|draw| order.view(&schedule, draw) < 4), "the first of six parts");
    }

    /// A step draws its own views and those of the next, so pools are drawn from in turn.
    #[test]
    fn views_are_those_of_orders_that_are_shuffled_for_every_draw() {
        let window = |newest, steps| Stage {
            steps,
            window_parts: 6,
            window_until: 0.5,
            window_newest: newest,
            ..Stage::default()
        };
        for (batch, stage) in
            [(1, window(0.0, 200)), (3, window(0.5, 90)), (30, Stage { steps: 9, ..Stage::default() })]
        {
            let schedule = schedule(|s| {
                s.batch = batch;
                s.stages = BTreeMap::from([("dynamic".to_owned(), stage.clone())]);
            });
            let kept = order();
            for step in 0..stage.steps {
                for draw in step * batch + 1..=(step + 2) * batch {
                    assert_eq!(kept.view(&schedule, draw), order().view(&schedule, draw), "draw {draw} of {batch}");
                }
                assert!(kept.orders.borrow().len() <= KEPT);
            }
            let again: Vec<usize> = (1..=24).map(|draw| kept.view(&schedule, draw)).collect();
            assert_eq!(again, (1..=24).map(|draw| order().view(&schedule, draw)).collect::<Vec<_>>(), "from the start");
        }
    }

    #[test]
    fn a_first_moment_of_one_view_is_no_stage_of_its_own() {
        let order = ViewOrder::new(7, (0..24).map(|k| k as f32 / 23.0).collect());
        let schedule = schedule(|s| s.stages.values_mut().for_each(|stage| stage.first_moment = true));
        assert!((1..=10).map(|d| order.view(&schedule, d)).collect::<BTreeSet<_>>().len() == 10);
    }

    #[test]
    fn views_can_be_asked_for_beyond_the_last_step() {
        for batch in [1, 3, 8] {
            for first_moment in [true, false] {
                let schedule = schedule(|s| {
                    s.batch = batch;
                    let short =
                        Stage { steps: 48, window_parts: 8, window_until: 0.7, first_moment, ..Stage::default() };
                    s.stages = BTreeMap::from([("dynamic".to_owned(), short)]);
                });
                let order = order();
                assert!((1..=60 * batch).all(|draw| order.view(&schedule, draw) < 24));
            }
        }
    }
}
