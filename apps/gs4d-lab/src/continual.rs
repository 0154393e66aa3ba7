//! Continual learning: training in rounds, each on a longer part of the sequence.
//!
//! A round trains on all views up to its time `T_obs`. Parameters, optimiser state and densification statistics are kept from
//! round to round; nothing is frozen. After each round the held-out views in `[0, T_obs]` (interpolation) and the views of all
//! cameras in `(T_obs, end]` (extrapolation) are scored, as GVFi and TRACE do.
//!
//! Times are normalised over the whole sequence, 0..1, in every round, so that a frame has the same time in all rounds.
//!
//! The first round follows the recipe. In later rounds the last stage of the recipe is continued for the given number of
//! steps, learning rates that decay are held at [`LATER_RATE`] of their start (8e-4 → 1e-4), and densification is over.
//! Settings of later rounds are applied last.

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

/// Name of the file with the scores of all rounds, in the run folder.
pub const FILE: &str = "continual.json";
/// In later rounds, learning rates that decay are held at this share of their start.
pub const LATER_RATE: f64 = 0.125;
/// Times closer than this are equal, normalised.
const TIME_TOLERANCE: f64 = 1e-6;

/// The parts of the sequence that the rounds train on and are scored on.
#[derive(Clone, Debug, PartialEq)]
pub enum Rounds {
    /// Rounds by time, normalised.
    Times {
        /// `T_obs` of each round: ascending, inside (0, 1).
        until: Vec<f64>,
        /// Length of the extrapolated interval after `T_obs`, above 0.
        future: f64,
    },
    /// Rounds by number of frames.
    Frames {
        /// Frames of the first round.
        first: usize,
        /// Frames added by each later round.
        per_round: usize,
        /// Extrapolated frames after the last one seen.
        next: usize,
        /// Frames of the last round; `None`: as many as leave `next` frames.
        last: Option<usize>,
    },
}

/// The experiment: data, method and rounds.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Methods that the request can name.
    pub registry: Registry,
    /// Method, preset, data, seed, settings, and the steps of the first round.
    pub request: Request,
    /// Parts of the sequence, one per round.
    pub rounds: Rounds,
    /// Steps of every later round.
    pub later_steps: u32,
    /// Settings of later rounds, `KEY=VALUE`, applied after all others.
    pub later_sets: Vec<String>,
    /// Most views scored of each split in a round, evenly spaced; 0: all.
    pub score_views: usize,
}

/// One round, in normalised time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Round {
    /// `T_obs`: last time trained on.
    pub last: f64,
    /// End of the extrapolated interval.
    pub end: f64,
}

/// Scores of a round.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RoundScores {
    /// The round, as the fields `last` and `end` in JSON.
    #[serde(flatten)]
    pub round: Round,
    /// Training views up to `T_obs`.
    pub views: usize,
    /// Training steps since the start of the first round.
    pub steps: u32,
    /// Training seconds since the start of the first round.
    pub seconds: f64,
    /// Splats after the round.
    pub splats: usize,
    /// Mean scores of the test views up to `T_obs`; `None` without such views.
    pub interpolation: Option<MeanScores>,
    /// Mean scores of the views of all cameras in `(T_obs, end]`; `None` without such views.
    pub extrapolation: Option<MeanScores>,
}

/// Progress of a run.
pub enum Event<'a> {
    /// A round begins: its number from 1, the number of rounds, its times.
    Round(usize, usize, Round),
    /// A training step is done.
    Step(Progress),
    /// A round is trained and scored.
    Done(&'a RoundScores),
}

impl Rounds {
    /// The rounds of a sequence with these frame times (normalised, ascending; unused by [`Rounds::Times`]).
    ///
    /// # Errors
    /// [`RunError::Rounds`] if there is no round, times do not ascend or leave nothing to extrapolate, or there are too few
    /// frames.
    pub(crate) fn plan(&self, times: &[f64]) -> Result<Vec<Round>, RunError> {
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
                let max_frames = last.unwrap_or(usize::MAX).min(times.len().saturating_sub(next));
                if first == 0 || per_round == 0 || next == 0 || first > max_frames {
                    let n = times.len();
                    return wrong(format!(
                        "{first} frames, then {per_round} a round with {next} to foretell: the data have {n}"
                    ));
                }
                let counts = (first..=max_frames).step_by(per_round);
                Ok(counts.map(|n| Round { last: times[n - 1], end: times[n - 1 + next] }).collect())
            }
        }
    }
}

/// The distinct times of all views: normalised, ascending.
fn timestamps(dataset: &Dataset) -> Vec<f64> {
    let all = [&dataset.train, &dataset.val, &dataset.test, &dataset.extrapolate].into_iter().flatten();
    let mut times: Vec<f64> = all.map(|v| f64::from(v.time.normalised)).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    times
}

/// The dataset of a round: views up to `T_obs`, with those in `(T_obs, end]` as the extrapolation split.
fn part(whole: &Dataset, round: Round) -> Dataset {
    let t = |v: &View| f64::from(v.time.normalised);
    let past =
        |views: &[View]| views.iter().filter(|v| t(v) <= round.last + TIME_TOLERANCE).cloned().collect::<Vec<_>>();
    let all = [&whole.train, &whole.val, &whole.test, &whole.extrapolate].into_iter().flatten();
    let future =
        all.filter(|v| t(v) > round.last + TIME_TOLERANCE && t(v) <= round.end + TIME_TOLERANCE).cloned().collect();
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

/// The settings with `data.time_boundary` at the end of the last round.
fn bounded(resolved: &Resolved, last: f64) -> Result<Resolved, RunError> {
    let mut config = resolved.config.clone();
    config.put("data.time_boundary", last, Source::Flag("the rounds".into()))?;
    Resolved::of(&resolved.registry, config)
}

/// The settings of later rounds: learning rates that decay are held constant, then `sets`.
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

/// Trains and scores all rounds in the run folder `root`, and writes [`FILE`] there after each. `None` if `stop` was set.
///
/// # Errors
/// Invalid rounds or settings, no data, or an error of training or scoring.
pub fn run(
    plan: &Plan,
    root: &Path,
    overwrite: bool,
    stop: &AtomicBool,
    on_event: &mut dyn FnMut(Event),
) -> Result<Option<Vec<RoundScores>>, RunError> {
    let resolved = resolve(&plan.registry, &plan.request)?;
    let (resolved, whole, rounds) = sequence(&resolved, &plan.rounds)?;
    let after = later(&resolved, &plan.later_sets)?;
    let mut training: Option<Training> = None;
    let mut done: Vec<RoundScores> = Vec::new();
    for (k, &round) in rounds.iter().enumerate() {
        on_event(Event::Round(k + 1, rounds.len(), round));
        let seen = Arc::new(part(&whole, round));
        let mut current = match training.take() {
            None if seen.train.is_empty() => {
                return Err(RunError::Rounds(format!("no training view lies before {}", round.last)));
            }
            None => Training::begin_on(root, overwrite, resolved.clone(), seen)?,
            Some(previous) => {
                let steps = previous.trainer().steps_done();
                let longer = settings::lengthen(&after, steps.saturating_add(plan.later_steps), steps)?;
                previous.grow(longer, seen)?
            }
        };
        if current.train(stop, &mut |p, _| on_event(Event::Step(p)))? != Outcome::Finished {
            return Ok(None);
        }
        done.push(scored(&current, round, plan.score_views)?);
        current.folder().write(FILE, &format!("{:#}\n", json!({"rounds": done})))?;
        done.last().into_iter().for_each(|scores| on_event(Event::Done(scores)));
        training = Some(current);
    }
    if let Some(training) = &training {
        let scores = training.score()?;
        training.report(&scores)?;
    }
    Ok(Some(done))
}

/// Settings, dataset and rounds. `data.time_boundary` is the end of the last round, so that views up to it keep their splits.
fn sequence(resolved: &Resolved, rounds: &Rounds) -> Result<(Resolved, Dataset, Vec<Round>), RunError> {
    let times = match rounds {
        Rounds::Times { .. } => Vec::new(),
        Rounds::Frames { .. } => timestamps(&bounded(resolved, 0.5)?.open_data()?),
    };
    let rounds = rounds.plan(&times)?;
    let Some(last) = rounds.last() else { return Err(RunError::Rounds("there is no round".into())) };
    let resolved = bounded(resolved, last.last)?;
    let whole = resolved.open_data()?;
    Ok((resolved, whole, rounds))
}

/// Scores of a trained round; at most `max_views` views of each split, 0 for all.
fn scored(training: &Training, round: Round, max_views: usize) -> Result<RoundScores, RunError> {
    let (trainer, images) = (training.trainer(), training.images());
    let method = trainer.model();
    let background = method.background();
    let score = |split: Split| -> Result<Option<MeanScores>, RunError> {
        let dataset = trainer.dataset();
        let count = dataset.views(split).len();
        if count == 0 {
            return Ok(None);
        }
        let views = few_views(dataset, split, if max_views == 0 { count } else { max_views });
        Ok(Some(evaluate(method, &views, split, background, &images)?.mean))
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
        let o = SynthOptions::of_views(24, 24, 8);
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
        let rounds = run(&plan(&from), &root, false, &stop, &mut |event| {
            if let Event::Step(p) = event {
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
