//! The parts of a sequence that the rounds train on, and the settings of each round.

use super::{LATER_RATE, Plan, Round, Rounds, TIME_TOLERANCE};
use gs_data::{Dataset, View};
use gs4d_eval::moments::Moment;
use gs4d_run::config::{Config, Source};
use gs4d_run::provenance::origin;
use gs4d_run::settings::{self, resolve};
use gs4d_run::{Resolved, RunError};
use serde_json::{Map, Value, json};
use std::sync::Arc;

/// A plan with its data.
pub(super) struct Sequence {
    /// The parts, one per round; at least one.
    pub(super) rounds: Vec<Round>,
    /// Steps made at the end of each round.
    pub(super) ends: Vec<u32>,
    /// Settings of the first round. `data.time_boundary` is the end of the last one, so that views up to it keep their splits.
    first: Resolved,
    /// Settings of later rounds, before their lengths.
    after: Resolved,
    whole: Dataset,
}

impl Sequence {
    pub(super) fn of(plan: &Plan) -> Result<Self, RunError> {
        let resolved = resolve(&plan.registry, &plan.request)?;
        let times = match &plan.rounds {
            Rounds::Times { .. } => Vec::new(),
            Rounds::Frames { .. } => timestamps(&bounded(&resolved, 0.5)?.open_data()?),
        };
        let rounds = plan.rounds.plan(&times)?;
        let Some(last) = rounds.last() else { return Err(RunError::Rounds("there is no round".into())) };
        let first = bounded(&resolved, last.last)?;
        let (after, mut whole) = (later(&first, &plan.later_sets)?, first.open_data()?);
        if whole.points.is_some()
            && let Some(round) = rounds.first()
        {
            // The first cloud knows nothing of later rounds.
            whole.points = bounded(&resolved, round.last)?.open_data()?.points;
        }
        let steps = u32::try_from(first.steps()).unwrap_or(u32::MAX);
        let next = |end: &u32| Some(end.saturating_add(plan.later_steps));
        let ends = std::iter::successors(Some(steps), next).take(rounds.len()).collect();
        Ok(Self { rounds, ends, first, after, whole })
    }

    /// The settings of the k-th round, from 0.
    pub(super) fn settings(&self, k: usize) -> Result<Resolved, RunError> {
        match k.checked_sub(1) {
            None => Ok(self.first.clone()),
            Some(before) => settings::lengthen(&self.after, self.ends[k], self.ends[before]),
        }
    }

    /// The data of the k-th round, from 0.
    pub(super) fn data(&self, k: usize) -> Result<Arc<Dataset>, RunError> {
        let part = part(&self.whole, self.rounds[k]);
        if part.train.is_empty() {
            return Err(RunError::Rounds(format!("no training view lies before {}", self.rounds[k].last)));
        }
        Ok(Arc::new(part))
    }

    /// Hashes of the data of all rounds.
    pub(super) fn origin(&self) -> Value {
        json!(origin(&self.whole))
    }

    /// All that the result depends on, besides the data.
    pub(super) fn identity(&self, plan: &Plan) -> Value {
        let settings: Map<_, _> = self.first.config.iter().map(|(key, s)| (key.to_owned(), json!(s.value))).collect();
        json!({
            "settings": settings,
            "rounds": self.rounds,
            "later_steps": plan.later_steps,
            "later_sets": plan.later_sets,
            "score_views": plan.score_views,
        })
    }
}

/// The times by which each moment was seen by all cameras: normalised, ascending.
pub(super) fn timestamps(dataset: &Dataset) -> Vec<f64> {
    Moment::all(dataset).iter().map(|moment| f64::from(moment.last)).collect()
}

/// The dataset of a round: views up to `T_obs`, with those in `(T_obs, end]` as the extrapolation split.
pub(super) fn part(whole: &Dataset, round: Round) -> Dataset {
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
pub(super) fn bounded(resolved: &Resolved, last: f64) -> Result<Resolved, RunError> {
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
