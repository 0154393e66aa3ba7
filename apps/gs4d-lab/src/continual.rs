//! Learning while the sequence goes on: rounds that each let in more of it, and what is foretold after each.
//!
//! A round trains on everything seen up to its time `T_obs`; parameters, moments of the optimiser and growth statistics go on
//! from round to round, nothing is frozen. After it the held-out views of `[0, T_obs]` are scored (interpolation) and
//! the views of all cameras in `(T_obs, end]` (extrapolation), as GVFi and TRACE do.
//!
//! Times are of the whole sequence, 0..1, in every round: no network is asked for an old moment by another number.
//!
//! The first round follows the recipe. Its rates have then decayed; in later rounds those that decay are held at
//! [`LATER_RATE`] of their start (8e-4 → 1e-4), and its last stage goes on for as many steps as asked for. Density control
//! ends with the recipe. Settings of later rounds have the last word.

use gs_data::{Dataset, Split, View};
use gs_train::evaluate::{MeanScores, evaluate};
use gs_train::registry::Registry;
use gs4d_run::config::{Config, Source};
use gs4d_run::settings::{self, Request, resolve};
use gs4d_run::training::few_views;
use gs4d_run::{Outcome, Progress, Resolved, RunError, Training};
use serde::Serialize;
use serde_json::json;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// The table of a run, in its folder.
pub const FILE: &str = "continual.json";
/// Rates that decay are held at this share of their start in later rounds.
pub const LATER_RATE: f64 = 0.125;
/// Times this close are the same, normalised.
const SLACK: f64 = 1e-6;

/// How the sequence is let in.
#[derive(Clone, Debug, PartialEq)]
pub enum Rounds {
    /// Up to these times, normalised; the future of a round is so long.
    Times {
        /// `T_obs` of each round, rising, below 1.
        until: Vec<f64>,
        /// Length of the future.
        future: f64,
    },
    /// Frame by frame.
    Frames {
        /// Frames of the first round.
        first: usize,
        /// Frames that each later round adds.
        per_round: usize,
        /// Frames of the future.
        next: usize,
        /// Most frames seen; none: as long as there is a whole future.
        last: Option<usize>,
    },
}

/// What is asked for.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The methods there are.
    pub registry: Registry,
    /// Method, preset, data, seed, settings, and the steps of the first round.
    pub request: Request,
    /// The rounds.
    pub rounds: Rounds,
    /// Steps of every later round.
    pub later_steps: u32,
    /// Settings of later rounds, `KEY=VALUE`.
    pub later_sets: Vec<String>,
    /// Most views scored of each split in a round, evenly spaced; 0: all.
    pub score_views: usize,
}

/// One round: what is seen and what is foretold, normalised.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Round {
    /// `T_obs`.
    pub last: f64,
    /// End of the future.
    pub end: f64,
}

/// What came of a round.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RoundScores {
    /// Its times.
    #[serde(flatten)]
    pub round: Round,
    /// Training views.
    pub views: usize,
    /// Steps in all.
    pub steps: u32,
    /// Seconds of training in all.
    pub seconds: f64,
    /// Splats.
    pub splats: usize,
    /// Held-out views up to `T_obs`, where there are any.
    pub interpolation: Option<MeanScores>,
    /// Views of all cameras beyond it, where there are any.
    pub extrapolation: Option<MeanScores>,
}

/// What a run tells while it goes on.
pub enum Told<'a> {
    /// Round number, from 1, and their count.
    Round(usize, usize, Round),
    /// A step was made.
    Step(Progress),
    /// A round is done.
    Done(&'a RoundScores),
}

impl Rounds {
    /// The rounds of a sequence with these moments, normalised and in order.
    ///
    /// # Errors
    /// If there is none, times do not rise or leave no future, or there are too few frames.
    pub fn plan(&self, moments: &[f64]) -> Result<Vec<Round>, RunError> {
        let wrong = |why: String| Err(RunError::Rounds(why));
        match self {
            Self::Times { until, future } => {
                let rising = until.windows(2).all(|w| w[0] < w[1]);
                let inside = until.iter().all(|t| *t > 0.0 && *t < 1.0);
                if until.is_empty() || !rising || !inside {
                    return wrong(format!("rounds end at {until:?}: times must rise and lie between 0 and 1"));
                }
                if !(*future > 0.0 && future.is_finite()) {
                    return wrong(format!("a future of {future} is none"));
                }
                Ok(until.iter().map(|&last| Round { last, end: last + future }).collect())
            }
            &Self::Frames { first, per_round, next, last } => {
                let most = last.unwrap_or(usize::MAX).min(moments.len().saturating_sub(next));
                if first == 0 || per_round == 0 || next == 0 || first > most {
                    let n = moments.len();
                    return wrong(format!(
                        "{first} frames, then {per_round} a round with {next} to foretell: the data have {n}"
                    ));
                }
                let seen = (first..=most).step_by(per_round);
                Ok(seen.map(|n| Round { last: moments[n - 1], end: moments[n - 1 + next] }).collect())
            }
        }
    }
}

/// The different times of all views, normalised.
fn moments(dataset: &Dataset) -> Vec<f64> {
    let all = [&dataset.train, &dataset.val, &dataset.test, &dataset.extrapolate].into_iter().flatten();
    let mut times: Vec<f64> = all.map(|v| f64::from(v.time.normalised)).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    times
}

/// What a round may see of the sequence, and its future.
fn part(whole: &Dataset, round: Round) -> Dataset {
    let t = |v: &View| f64::from(v.time.normalised);
    let past = |views: &[View]| views.iter().filter(|v| t(v) <= round.last + SLACK).cloned().collect::<Vec<_>>();
    let all = [&whole.train, &whole.val, &whole.test, &whole.extrapolate].into_iter().flatten();
    let future = all.filter(|v| t(v) > round.last + SLACK && t(v) <= round.end + SLACK).cloned().collect();
    let train = past(&whole.train);
    let dynamic = train.iter().any(|v| t(v) != t(&train[0]));
    Dataset {
        train,
        val: past(&whole.val),
        test: past(&whole.test),
        extrapolate: future,
        points: whole.points.clone(),
        dynamic,
        ..whole.without_views()
    }
}

/// The settings with a boundary at the end of the last round.
fn bounded(resolved: &Resolved, last: f64) -> Result<Resolved, RunError> {
    let mut config = resolved.config.clone();
    config.put("data.time_boundary", last, Source::Flag("the rounds".into()))?;
    Resolved::of(&resolved.registry, config)
}

/// The settings of later rounds: rates that decay are held, and what the user says.
fn later(resolved: &Resolved, sets: &[String]) -> Result<Resolved, RunError> {
    let mut config = resolved.config.clone();
    let number = |config: &Config, key: &str| config.get(key).and_then(|s| s.value.as_float());
    let groups: Vec<String> = config.iter().filter_map(|(k, _)| Some(k.strip_suffix(".start")?.to_owned())).collect();
    for group in groups.iter().filter(|g| g.starts_with("schedule.lr.")) {
        let (start_key, end_key) = (format!("{group}.start"), format!("{group}.end"));
        if let (Some(start), Some(end)) = (number(&config, &start_key), number(&config, &end_key))
            && end < start
        {
            let held = (LATER_RATE * start).max(end);
            for key in [&start_key, &end_key] {
                config.put(key, held, Source::Flag("later rounds".into()))?;
            }
        }
    }
    for assignment in sets {
        config.set(assignment)?;
    }
    Resolved::of(&resolved.registry, config)
}

/// Runs the rounds; the folder is that of a run, with [`FILE`] beside what a run has. None if `stop` was set on the way.
///
/// # Errors
/// If the rounds cannot be made, or whatever training and scoring finds.
pub fn run(
    plan: &Plan,
    root: &Path,
    overwrite: bool,
    stop: &AtomicBool,
    tell: &mut dyn FnMut(Told),
) -> Result<Option<Vec<RoundScores>>, RunError> {
    let resolved = resolve(&plan.registry, &plan.request)?;
    let (resolved, whole, rounds) = sequence(&resolved, &plan.rounds)?;
    let after = later(&resolved, &plan.later_sets)?;
    let mut training: Option<Training> = None;
    let mut done: Vec<RoundScores> = Vec::new();
    for (k, &round) in rounds.iter().enumerate() {
        tell(Told::Round(k + 1, rounds.len(), round));
        let seen = Arc::new(part(&whole, round));
        let mut now = match training.take() {
            None if seen.train.is_empty() => {
                return Err(RunError::Rounds(format!("no training view lies before {}", round.last)));
            }
            None => Training::begin_on(root, overwrite, resolved.clone(), seen)?,
            Some(before) => {
                let made = before.trainer().steps_done();
                let longer = settings::lengthen(&after, made.saturating_add(plan.later_steps), made)?;
                before.grow(longer, seen)?
            }
        };
        if now.train(stop, &mut |p, _| tell(Told::Step(p)))? != Outcome::Finished {
            return Ok(None);
        }
        done.push(scored(&now, round, plan.score_views)?);
        now.folder().write(FILE, &format!("{:#}\n", json!({"rounds": done})))?;
        done.last().into_iter().for_each(|scores| tell(Told::Done(scores)));
        training = Some(now);
    }
    if let Some(training) = &training {
        let scores = training.score()?;
        training.report(&scores)?;
    }
    Ok(Some(done))
}

/// Settings, data and rounds: the boundary of the data is the end of the last round, so that views keep their splits up to it.
fn sequence(resolved: &Resolved, rounds: &Rounds) -> Result<(Resolved, Dataset, Vec<Round>), RunError> {
    let known = match rounds {
        Rounds::Times { .. } => Vec::new(),
        Rounds::Frames { .. } => moments(&bounded(resolved, 0.5)?.open_data()?),
    };
    let rounds = rounds.plan(&known)?;
    let Some(last) = rounds.last() else { return Err(RunError::Rounds("there is no round".into())) };
    let resolved = bounded(resolved, last.last)?;
    let whole = resolved.open_data()?;
    Ok((resolved, whole, rounds))
}

/// Scores of a round that has been trained.
fn scored(training: &Training, round: Round, most: usize) -> Result<RoundScores, RunError> {
    let (trainer, photographs) = (training.trainer(), training.photographs());
    let method = trainer.model();
    let background = method.background();
    let score = |split: Split| -> Result<Option<MeanScores>, RunError> {
        let dataset = trainer.dataset();
        let count = dataset.views(split).len();
        if count == 0 {
            return Ok(None);
        }
        let views = few_views(dataset, split, if most == 0 { count } else { most });
        Ok(Some(evaluate(method, &views, split, background, &photographs)?.mean))
    };
    Ok(RoundScores {
        round,
        views: trainer.dataset().train.len(),
        steps: trainer.steps_done(),
        seconds: trainer.train_seconds(),
        splats: method.splat_count(),
        interpolation: score(Split::Test)?,
        extrapolation: score(Split::Extrapolate)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_synth::{SynthOptions, write};

    #[test]
    fn rounds_are_planned_by_times_and_by_frames() {
        let times = |until: &[f64], future| Rounds::Times { until: until.to_vec(), future }.plan(&[]);
        assert_eq!(times(&[0.25, 0.5], 0.25).unwrap()[1], Round { last: 0.5, end: 0.75 });
        for (until, future) in [
            (&[][..], 0.1),
            (&[0.5, 0.5], 0.1),
            (&[0.0, 0.5], 0.1),
            (&[0.5, 1.0], 0.1),
            (&[0.5], 0.0),
            (&[0.5], f64::NAN),
        ] {
            assert!(times(until, future).is_err(), "{until:?} {future}");
        }
        let moments: Vec<f64> = (0..150).map(|k| f64::from(k) / 149.0).collect();
        let frames = |first, per_round, next, last| Rounds::Frames { first, per_round, next, last }.plan(&moments);
        // PanopticSports: frames 0 to 14, one more each round, the next ten scored, up to the 135th.
        let rounds = frames(15, 1, 10, Some(135)).unwrap();
        assert_eq!((rounds.len(), rounds[0].last, rounds[0].end), (121, moments[14], moments[24]));
        assert_eq!((rounds[120].last, rounds[120].end), (moments[134], moments[144]));
        assert_eq!(frames(15, 1, 10, None).unwrap().len(), 126, "as long as ten frames are left");
        for (first, per_round, next) in [(0, 1, 1), (1, 0, 1), (1, 1, 0), (141, 1, 10), (1, 1, 150)] {
            assert!(frames(first, per_round, next, None).is_err(), "{first} {per_round} {next}");
        }
    }

    fn data(dir: &Path) {
        let o = SynthOptions { size: 24, train_views: 24, val_views: 0, test_views: 8, ..SynthOptions::default() };
        write(dir, "balls", &o, false).unwrap();
    }

    fn plan(data: &Path) -> Plan {
        Plan {
            registry: gs_methods::registry().clone(),
            request: Request {
                method: "defgs".into(),
                preset: "tiny".into(),
                data: Some(data.to_owned()),
                steps: Some(12),
                ..Request::default()
            },
            rounds: Rounds::Times { until: vec![0.3, 0.5, 0.7], future: 0.2 },
            later_steps: 5,
            later_sets: vec!["schedule.lr.cloud.sh_dc.start=0.0007".into()],
            score_views: 0,
        }
    }

    #[test]
    fn every_round_sees_more_and_goes_on() {
        let dir = tempfile::tempdir().unwrap();
        let (from, root) = (dir.path().join("data"), dir.path().join("run"));
        data(&from);
        let stop = AtomicBool::new(false);
        let mut steps = Vec::new();
        let rounds = run(&plan(&from), &root, false, &stop, &mut |told| {
            if let Told::Step(p) = told {
                steps.push(p.step);
            }
        });
        let rounds = rounds.unwrap().unwrap();
        assert_eq!(steps, (1..=22).collect::<Vec<_>>(), "one clock for all rounds");
        assert_eq!(rounds.iter().map(|r| r.steps).collect::<Vec<_>>(), [12, 17, 22]);
        assert!(rounds.windows(2).all(|r| r[0].views < r[1].views));
        let finite = |m: &Option<MeanScores>| m.as_ref().is_some_and(|m| m.psnr.is_some_and(|p| p > 3.0));
        assert!(rounds.iter().all(|r| finite(&r.interpolation) && finite(&r.extrapolation)), "{rounds:?}");
        // What it leaves is a run like any other: its data end where the last round did.
        let open = gs4d_run::OpenRun::open(gs_methods::registry(), &root).unwrap();
        assert_eq!((open.loaded.step, open.resolved.data.time_boundary), (22, Some(0.7)));
        let last = open.resolved.open_data().unwrap();
        assert_eq!(last.train.len(), rounds[2].views);
        assert!(
            (open.loaded.scene.last_time - last.train.iter().map(|v| v.time.normalised).fold(0.0, f32::max)).abs()
                < 1e-9
        );
        let rate = |key: &str| open.resolved.config.get(key).unwrap().value.as_float().unwrap();
        assert_eq!(rate("schedule.lr.cloud.sh_dc.start"), 0.0007);
        assert_eq!(rate("schedule.lr.cloud.means.start"), rate("schedule.lr.cloud.means.end"));
        assert!(root.join(FILE).is_file() && root.join("report.html").is_file());
        let again = dir.path().join("again");
        let same = run(&plan(&from), &again, false, &stop, &mut |_| {}).unwrap().unwrap();
        assert_eq!(
            same.iter().map(|r| r.extrapolation).collect::<Vec<_>>(),
            rounds.iter().map(|r| r.extrapolation).collect::<Vec<_>>(),
            "the same seed, the same bits"
        );
    }

    #[test]
    fn the_trainer_goes_on_with_the_same_parameters() {
        let dir = tempfile::tempdir().unwrap();
        let from = dir.path().join("data");
        data(&from);
        let resolved = bounded(&resolve(gs_methods::registry(), &plan(&from).request).unwrap(), 0.7).unwrap();
        let whole = resolved.open_data().unwrap();
        let of = |last| Arc::new(part(&whole, Round { last, end: 1.0 }));
        let mut training = Training::begin_on(&dir.path().join("run"), false, resolved.clone(), of(0.3)).unwrap();
        training.train(&AtomicBool::new(false), &mut |_, _| {}).unwrap();
        let before = training.trainer().state();
        let grown = training.grow(settings::lengthen(&resolved, 20, 12).unwrap(), of(0.6)).unwrap();
        let after = grown.trainer().state();
        assert_eq!(before.tensors, after.tensors, "parameters and moments, bit for bit");
        assert_eq!(before.meta["adam_updates"], after.meta["adam_updates"]);
        let last = |c: &gs_train::checkpoint::Checkpoint| c.meta["last_time"].as_f64().unwrap();
        assert!(last(&before) <= 0.3 + 1e-6 && last(&after) > 0.5 && last(&after) <= 0.6 + 1e-6);
        assert_eq!(grown.trainer().steps_done(), 12);
    }
}
