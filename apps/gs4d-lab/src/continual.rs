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
//!
//! A run that was interrupted goes on in the round it was in, from its newest checkpoint, and ends with the bits of an
//! undisturbed one.

mod sequence;
mod standing;

use gs_data::Split;
use gs_train::evaluate::{MeanScores, evaluate};
use gs_train::registry::Registry;
pub use gs4d_run::folder::ROUNDS as FILE;
use gs4d_run::settings::Request;
use gs4d_run::training::few_views;
use gs4d_run::{Outcome, Progress, RunError, Training};
use sequence::Sequence;
use serde::{Deserialize, Serialize};
use serde_json::json;
use standing::{Standing, standing};
use std::path::Path;
use std::sync::atomic::AtomicBool;

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
    /// The command that goes on with the run, kept in its folder for messages.
    pub command: String,
}

/// One round, in normalised time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Round {
    /// `T_obs`: last time trained on.
    pub last: f64,
    /// End of the extrapolated interval.
    pub end: f64,
}

/// Scores of a round.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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

/// Trains and scores all rounds in the run folder `root`, and writes [`FILE`] there after each. `None` if `stop` was set. A
/// run of the same plan in that folder goes on where it stopped and ends with the same bits; with `overwrite` any run in it is
/// begun anew.
///
/// # Errors
/// Invalid rounds or settings, a run with other settings, no data, or an error of training or scoring.
pub fn run(
    plan: &Plan,
    root: &Path,
    overwrite: bool,
    stop: &AtomicBool,
    on_event: &mut dyn FnMut(Event),
) -> Result<Option<Vec<RoundScores>>, RunError> {
    let sequence = Sequence::of(plan)?;
    let identity = sequence.identity(plan);
    let found = if overwrite { None } else { standing(root, &identity, &sequence.ends)? };
    let (first, mut training, mut done) = match found {
        Some(Standing { folder, newest, round, done }) => {
            let known = folder.rounds().and_then(|rounds| rounds.get("data").cloned());
            if known.is_some_and(|data| data != sequence.origin()) {
                return Err(RunError::DataChanged { path: sequence.data(0)?.root.clone(), run: root.to_owned() });
            }
            let training = Training::resume_on(folder, newest, sequence.settings(round)?, sequence.data(round)?)?;
            (round, training, done)
        }
        None => {
            let rounds = json!({"command": plan.command, "plan": identity, "data": sequence.origin()});
            // A run that is there has this plan and no checkpoint, or is to be overwritten.
            let training = Training::begin_on(root, true, sequence.settings(0)?, sequence.data(0)?, Some(rounds))?;
            (0, training, Vec::new())
        }
    };
    for (k, &round) in sequence.rounds.iter().enumerate().skip(first) {
        on_event(Event::Round(k + 1, sequence.rounds.len(), round));
        if k > first {
            training = training.grow(sequence.settings(k)?, sequence.data(k)?)?;
        }
        if training.train(stop, &mut |p, _| on_event(Event::Step(p)))? != Outcome::Finished {
            return Ok(None);
        }
        done.push(scored(&training, round, plan.score_views)?);
        training.folder().write(FILE, &format!("{:#}\n", json!({"rounds": done})))?;
        done.last().into_iter().for_each(|scores| on_event(Event::Done(scores)));
    }
    let scores = training.score()?;
    training.report(&scores)?;
    Ok(Some(done))
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
mod tests;
