//! Several contests at once: each worker trains one trial at a time, on one thread.

use super::{Contest, ContestError, Event, Length, Results};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Trains and scores several contests as [`Contest::run`] does each, `workers` trials at a time on one thread each; results are those of [`Contest::run`], bit for
/// bit. Every contest must have a folder of its own. All contests come to a seed before any of them comes to the next, so what an interrupted job leaves
/// are pairs of all of them. `on_event` is given the number of the contest.
///
/// # Errors
/// Those of [`Contest::run`].
pub fn run_all(
    contests: &[Contest],
    workers: usize,
    stop: &AtomicBool,
    on_event: &(dyn Fn(usize, Event) + Sync),
) -> Result<Vec<Results>, ContestError> {
    for contest in contests {
        contest.check()?;
        contest.check_data()?;
    }
    let (parts, next, done) = (parts(contests), AtomicUsize::new(0), Mutex::new(Vec::new()));
    let work = || {
        // Where the system gives no more threads, those there are do the work.
        let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().ok();
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            let Some((of, part)) = parts.get(number) else { break };
            let run = || part.run(stop, &mut |event| on_event(*of, event));
            let results = alone.as_ref().map_or_else(run, |pool| pool.install(run));
            if results.is_err() {
                next.store(parts.len(), Ordering::Relaxed);
            }
            done.lock().unwrap_or_else(PoisonError::into_inner).push((number, results));
        }
    };
    let workers = workers.clamp(1, parts.len().max(1));
    std::thread::scope(|scope| {
        (1..workers).for_each(|_| drop(std::thread::Builder::new().spawn_scoped(scope, work)));
        work();
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by_key(|(number, _)| *number);
    let mut all: Vec<Option<Results>> = contests.iter().map(|_| None).collect();
    for (number, results) in done {
        let results = results?;
        match &mut all[parts[number].0] {
            Some(before) => before.add(results),
            none => *none = Some(results),
        }
    }
    Ok(all.into_iter().flatten().collect())
}

/// The contests with one seed each, seed by seed, each with the number of its contest. Under a time budget a contest is one part: all its trials wait for
/// the same pilots.
fn parts(contests: &[Contest]) -> Vec<(usize, Contest)> {
    let part = |contest: &Contest, k: usize| match contest.length {
        Length::Seconds(_) => (k == 0).then(|| contest.clone()),
        _ if contest.seeds.is_empty() => (k == 0).then(|| contest.clone()),
        _ => contest.seeds.get(k).map(|&seed| Contest { seeds: vec![seed], ..contest.clone() }),
    };
    let rounds = contests.iter().map(|c| c.seeds.len().max(1)).max().unwrap_or(0);
    let round = |k: usize| contests.iter().enumerate().filter_map(move |(of, c)| Some((of, part(c, k)?)));
    (0..rounds).flat_map(round).collect()
}

impl Results {
    /// Adds those of the same entries with other seeds.
    fn add(&mut self, more: Self) {
        for (standing, more) in self.standings.iter_mut().zip(more.standings) {
            standing.steps = standing.steps.or(more.steps);
            standing.trials.extend(more.trials);
        }
        self.missing.extend(more.missing);
    }
}
