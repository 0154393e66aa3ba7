//! A run that gets another length while steps of it are made: only its last stage changes, and shares of the run name the steps
//! that they named, so the steps already made stay valid.

use super::{Resolved, StageSteps, stages};
use crate::RunError;
use crate::config::{Config, Source};

use gs_train::domains;

/// A length that changes, and how many steps of it are made.
#[derive(Clone, Copy)]
struct Change {
    was: u64,
    now: u64,
    done: u64,
}

impl Change {
    /// The share that names the same step.
    fn same_step(self, share: f64) -> f64 {
        share * self.was as f64 / self.now as f64
    }

    /// Whether a step was made for which a share was over.
    fn passed(self, share: f64) -> bool {
        self.done > 0 && (self.done - 1) as f64 >= share * self.was as f64
    }

    /// The share that names the same step, where the new length would come to the old share again.
    fn once(self, share: f64) -> Option<f64> {
        (self.now > self.was && self.passed(share)).then(|| self.same_step(share))
    }
}

/// Shares with which what has begun stays as it is, where the run and its stage `last` get another length.
fn kept_shares(config: &Config, last: &str, run: Change, stage: Change) -> Vec<(String, f64)> {
    let number = |key: &str| config.get(key).and_then(|s| s.value.as_float());
    let mut kept = Vec::new();
    // Images that were let in stay in; what learns after a share of the run goes on.
    let window = last.replace(".steps", ".window_until");
    for (key, length) in [(window.as_str(), stage), ("schedule.exposure.after", run), ("cameras.after", run)] {
        kept.extend(number(key).map(|share| (key.to_owned(), length.same_step(share))));
    }
    // A rate that has begun to fall goes on falling as it did, and none has fallen before it begins.
    let falls =
        |until: f64| number("cameras.after").is_some_and(|after| run.passed(after) || run.same_step(after) >= until);
    let until = number("cameras.until").filter(|until| falls(*until));
    kept.extend(until.map(|share| ("cameras.until".to_owned(), run.same_step(share))));
    // A reach that has begun to open goes on opening as it did.
    let opens = config.get("physics.reach").and_then(|s| s.value.as_integer()).is_some_and(|reach| reach > 1);
    let reach = number("physics.reach_until").filter(|_| opens && stage.done > 0);
    kept.extend(reach.map(|share| ("physics.reach_until".to_owned(), stage.same_step(share))));
    // Shares of every stage stay what they are, unless this one is past them.
    for key in ["still.from", "still.until"] {
        kept.extend(number(key).and_then(|share| stage.once(share)).map(|share| (key.to_owned(), share)));
    }
    let settle = number("physics.settle").filter(|share| *share > 0.0);
    let settled = settle.and_then(|share| stage.once(1.0 - share));
    kept.extend(settled.map(|share| ("physics.settle".to_owned(), 1.0 - share)));
    kept
}

/// Changes the run to `total` steps by the length of its last stage. Shares of the run, and of that stage, name the steps that they
/// named, where their domains allow it.
///
/// # Errors
/// If `done` steps were made already and more than `total`, or the last stage would begin after `total`.
pub fn lengthen(resolved: &Resolved, total: u32, done: u32) -> Result<Resolved, RunError> {
    let stages: Vec<StageSteps> = stages(&resolved.config).into_iter().filter(|s| s.steps > 0).collect();
    let Some((StageSteps { key: last, steps: was, .. }, earlier)) = stages.split_last() else {
        return Err(RunError::Steps("the recipe has no steps".into()));
    };
    let before: u64 = earlier.iter().map(|s| s.steps).sum();
    if total < done || u64::from(total) <= before {
        let least = u64::from(done).max(before + 1);
        return Err(RunError::Steps(format!(
            "--steps {total} is not possible: {done} steps are made, at least {least}"
        )));
    }
    let mut config = resolved.config.clone();
    let (now, source) = (u64::from(total) - before, Source::Flag(format!("resume --steps {total}")));
    config.put(last, now as i64, source.clone())?;
    let done = u64::from(done);
    let stage = Change { was: *was, now, done: done.saturating_sub(before) };
    let run = Change { was: before + was, now: total.into(), done };
    let own = resolved.registry.find(&resolved.run.method)?.domains;
    let shares = if now == *was { Vec::new() } else { kept_shares(&config, last, run, stage) };
    for (key, share) in shares {
        let share = domains::domain(&key, own).map_or(share, |d| share.clamp(d.low, d.high));
        config.put(&key, share, source.clone())?;
    }
    Resolved::of(&resolved.registry, config)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::tests::request;
    use crate::settings::{Request, resolve};

    #[test]
    fn lengthening_touches_the_last_stage_and_shares_of_the_run_only() {
        let plain = resolve(gs_methods::registry(), &request(&[])).unwrap();
        let changed = |other: &Resolved| {
            let pairs = other.config.iter().zip(plain.config.iter());
            pairs.filter(|(a, b)| a.1.value != b.1.value).map(|(a, _)| a.0.to_owned()).collect::<Vec<_>>()
        };
        let long = lengthen(&plain, 450, 300).unwrap();
        assert_eq!(long.steps(), 450);
        let shares = ["cameras.after", "cameras.until", "schedule.exposure.after"];
        assert_eq!(changed(&long), [&shares[..], &["schedule.stages.all.steps"]].concat());
        assert!(changed(&lengthen(&plain, 300, 300).unwrap()).is_empty());
        assert!(lengthen(&plain, 200, 250).unwrap_err().to_string().contains("at least 250"));
    }

    /// Settings of a method, the steps of its run and of its last stage.
    fn of_method(method: &str, sets: &[&str]) -> (Resolved, u32, f64) {
        let request = Request { method: method.into(), ..request(sets) };
        let resolved = resolve(gs_methods::registry(), &request).unwrap();
        let (steps, last) = (resolved.steps(), stages(&resolved.config).last().unwrap().steps);
        assert!(last < steps, "{method} has stages");
        (resolved, u32::try_from(steps).unwrap(), last as f64)
    }

    fn assert_shares(resolved: &Resolved, want: &[(&str, f64)]) {
        for (key, want) in want {
            let got = resolved.config.get(key).unwrap().value.as_float().unwrap();
            assert!((got - want).abs() < 1e-12, "{key}: {got} {want}");
        }
    }

    #[test]
    fn what_has_begun_stays_begun_in_a_longer_run() {
        let [after, fallen, maps] = ["cameras.after", "cameras.until", "schedule.exposure.after"];
        let (from, until) = ("still.from", "still.until");
        let sets = ["cameras.after=0.2", "schedule.exposure.after=0.3"];
        let sets = [&sets[..], &["still.from=0.25", "still.until=0.75"]].concat();
        let (plain, steps, last) = of_method("defgs", &sets);
        let share = last / (last + f64::from(steps));
        let finished = lengthen(&plain, 2 * steps, steps).unwrap();
        assert_shares(
            &finished,
            &[(after, 0.1), (fallen, 0.5), (maps, 0.15), (from, 0.25 * share), (until, 0.75 * share)],
        );
        // Half of the last stage is made.
        let half = lengthen(&plain, 2 * steps, steps - last as u32 / 2).unwrap();
        assert_shares(&half, &[(after, 0.1), (fallen, 0.5), (maps, 0.15), (from, 0.25 * share), (until, 0.75)]);
        // A quarter of it is left out: what it is past it does not come to again.
        let shorter = lengthen(&plain, steps - last as u32 / 4, steps - last as u32 / 2).unwrap();
        assert_shares(&shorter, &[(from, 0.25), (until, 0.75)]);
        let unborn = lengthen(&plain, 2 * steps, 0).unwrap();
        assert_shares(&unborn, &[(after, 0.1), (fallen, 1.0), (maps, 0.15), (from, 0.25), (until, 0.75)]);
    }

    #[test]
    fn rates_of_cameras_stay_what_they_were_in_a_run_of_any_length() {
        let (plain, steps, _) = of_method("defgs", &["cameras.after=0.2", "cameras.rate_end=0.1"]);
        let fallen = |run: &Resolved, step: f64| {
            let of = |key: &str| run.config.get(key).unwrap().value.as_float().unwrap();
            let (share, after) = (step / run.steps() as f64, of("cameras.after"));
            of("cameras.rate_end").powf((share - after) / (of("cameras.until") - after))
        };
        let long = lengthen(&plain, 100 * steps, steps).unwrap();
        let longer = lengthen(&long, 1000 * steps, 100 * steps).unwrap();
        let shorter = lengthen(&plain, steps - 1, steps / 2).unwrap();
        for step in [0.2, 0.3, 0.5].map(|share| share * f64::from(steps)) {
            for run in [&long, &longer, &shorter] {
                assert!((fallen(run, step) / fallen(&plain, step) - 1.0).abs() < 1e-9, "{step} of {}", run.steps());
            }
        }
    }

    #[test]
    fn rates_of_cameras_begin_before_they_have_fallen_in_a_shorter_run() {
        let sets = ["cameras.after=0.5", "cameras.until=0.9"];
        let plain = resolve(gs_methods::registry(), &request(&sets)).unwrap();
        let shorter = lengthen(&plain, 160, 0).unwrap();
        assert_shares(&shorter, &[("cameras.after", 0.5 * 300.0 / 160.0), ("cameras.until", 0.9 * 300.0 / 160.0)]);
    }

    #[test]
    fn a_reach_that_has_begun_to_open_goes_on_as_it_did() {
        let until = "physics.reach_until";
        let (plain, steps, last) = of_method("trace", &[]);
        let begun = steps - last as u32 + 1;
        let share = last / (last + f64::from(steps));
        for (done, want) in [(0, 1.0), (begun - 1, 1.0), (begun, share), (steps, share)] {
            assert_shares(&lengthen(&plain, 2 * steps, done).unwrap(), &[(until, want)]);
        }
        let shorter = lengthen(&plain, steps - 1, begun).unwrap();
        assert_shares(&shorter, &[(until, last / (last - 1.0))]);
    }

    #[test]
    fn shares_of_the_end_go_on_and_shares_of_a_shorter_run_stay_in_their_domains() {
        let settle = "physics.settle";
        let (plain, steps, last) = of_method("trace", &["physics.settle=0.25"]);
        let share = last / (last + f64::from(steps));
        for (done, want) in [(steps, 1.0 - 0.75 * share), (steps / 2, 0.25)] {
            assert_shares(&lengthen(&plain, 2 * steps, done).unwrap(), &[(settle, want)]);
        }
        let (never, ..) = of_method("trace", &["physics.settle=0"]);
        assert_shares(&lengthen(&never, 2 * steps, steps).unwrap(), &[(settle, 0.0)]);
        let (late, ..) = of_method("trace", &["schedule.exposure.after=0.95"]);
        assert_shares(&lengthen(&late, steps - steps / 10, 0).unwrap(), &[("schedule.exposure.after", 1.0)]);
    }
}
