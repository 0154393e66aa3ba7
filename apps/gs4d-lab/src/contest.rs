//! Contests: several entries on the same data, with the same seeds and the same training time.
//!
//! An entry is a method with its own settings. Under a time budget each entry first trains a pilot: its recipe compressed to a
//! tenth of its steps. The mean seconds per step of the pilot give the number of steps that fill the budget, and the recipe is stretched or
//! compressed to that many, so that every entry goes through all stages of its schedule. A pilot longer than the budget is stopped. The measured seconds are part of the result. Every trial is an ordinary run folder; a finished trial is not
//! trained again, an interrupted one is resumed.
//!
//! The trials can be trained elsewhere: [`Contest::plan`] gives a command line for each, [`Contest::collect`] the results of
//! those that stand. [`run_all`] trains those of several contests at once, one on each core.

mod entry;
mod job;
mod pilot;
mod plan;
mod scored;
mod together;

pub use entry::Entry;
use gs_train::evaluate::EvalReport;
use gs_train::registry::Registry;
pub use gs4d_eval::spread::{SCORES, Score, Spread};
use gs4d_run::config::ConfigError;
use gs4d_run::settings::{self, Request, resolve};
use gs4d_run::{Progress, RunError, RunFolder, Scored, provenance};
pub use job::Job;
pub use plan::Plan;
use scored::Scene;
use serde::Serialize;
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::Duration;
pub use together::run_all;

/// Length of every trial.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Length {
    /// The number of steps of the preset.
    Recipe,
    /// This many steps; the recipe is stretched or compressed to them.
    Steps(u32),
    /// As many steps as fill this many seconds, measured by a pilot.
    Seconds(f64),
}

impl Length {
    /// From command-line options: a time budget wins over a number of steps; without both, the recipe.
    pub fn of(time_budget: Option<Duration>, steps: Option<u32>) -> Self {
        match (time_budget, steps) {
            (Some(time), _) => Length::Seconds(time.as_secs_f64()),
            (None, Some(steps)) => Length::Steps(steps),
            (None, None) => Length::Recipe,
        }
    }
}

/// Entries and the conditions they share.
#[derive(Clone, Debug)]
pub struct Contest {
    /// Methods that entries can name.
    pub registry: Registry,
    /// Folder of the dataset.
    pub data: PathBuf,
    /// Output folder: `ENTRY/seed-N` for each trial, `ENTRY/pilot` under a time budget.
    pub root: PathBuf,
    /// Preset of entries that name none.
    pub preset: String,
    /// The entries, in the order of the result.
    pub entries: Vec<Entry>,
    /// One trial per entry and seed.
    pub seeds: Vec<u64>,
    /// Length of every trial.
    pub length: Length,
    /// Settings of all entries, `KEY=VALUE`; those of an entry are applied after them.
    pub sets: Vec<String>,
}

/// One run of an entry with one seed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Trial {
    /// Seed of the run.
    pub seed: u64,
    /// Run folder.
    pub run: PathBuf,
    /// Scores on the test views.
    pub scores: EvalReport,
}

/// Result of one entry.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Standing {
    /// [`Entry::label`].
    pub label: String,
    /// Steps of every trial; `None` without the pilot that gives them.
    pub steps: Option<u64>,
    /// The trials that stand, in the order of [`Contest::seeds`].
    pub trials: Vec<Trial>,
}

impl Standing {
    /// Mean and deviation of a score over the trials that have it; `None` if none has.
    pub fn spread(&self, score: impl Fn(&EvalReport) -> Option<f64>) -> Option<Spread> {
        Spread::of(&self.trials.iter().filter_map(|t| score(&t.scores)).collect::<Vec<_>>())
    }

    /// The trial with this seed.
    pub fn of_seed(&self, seed: u64) -> Option<&Trial> {
        self.trials.iter().find(|t| t.seed == seed)
    }

    /// PSNR less that of another entry with the same seed ([`EvalReport::less`]), dB, for every seed of which both have it.
    pub fn psnr_less(&self, other: &Self) -> Vec<f64> {
        let pair = |t: &Trial| t.scores.less(&other.of_seed(t.seed)?.scores, |view| view.psnr);
        self.trials.iter().filter_map(pair).collect()
    }
}

/// The machines, threads and devices that trials were trained on, each once: seconds of several of them are not alike.
pub fn machines(standings: &[Standing]) -> BTreeSet<String> {
    let trials = standings.iter().flat_map(|s| &s.trials);
    trials.filter_map(|t| RunFolder::open(&t.run).ok()).flat_map(|folder| provenance::machines(&folder)).collect()
}

/// Result of a contest.
#[derive(Debug)]
pub struct Results {
    /// One per entry, in their order.
    pub standings: Vec<Standing>,
    /// The trials and pilots without a result, in the order they were tried.
    pub missing: Vec<TrialError>,
}

impl Results {
    /// Whether there is no trial with a result.
    pub fn none_stands(&self) -> bool {
        self.standings.iter().all(|s| s.trials.is_empty())
    }
}

/// Progress of a contest.
pub enum Event<'a> {
    /// A trial is started or resumed: `ENTRY / seed-N`.
    Trial(&'a str),
    /// A training step is done.
    Step(Progress),
    /// A trial failed; the others go on.
    Failed(&'a TrialError),
}

/// A trial without a result, and why.
#[derive(Debug, thiserror::Error)]
#[error("{trial}: {source}")]
pub struct TrialError {
    /// `ENTRY / seed-N` or `ENTRY / pilot`; the entry alone if its settings are invalid.
    pub trial: String,
    /// The cause.
    #[source]
    pub source: Box<RunError>,
}

/// Why a contest ended without a result.
#[derive(Debug, thiserror::Error)]
pub enum ContestError {
    /// Settings of an entry are invalid, or a trial has no result.
    #[error(transparent)]
    Trial(#[from] TrialError),
    /// A word of a command line cannot stand in a list with one command per line.
    #[error("{trial}: {word:?} holds a line break or is not Unicode")]
    Word {
        /// The trial of the command line.
        trial: String,
        /// The word.
        word: String,
    },
    /// The stop flag was set. The trial is saved, and running the contest again resumes it.
    #[error("interrupted; what was trained is saved in {}", .0.display())]
    Interrupted(PathBuf),
}

/// Seed of all pilots, whichever seeds a contest has by and by.
const PILOT_SEED: u64 = 0;

/// Gives the result of a run: by training or by reading.
type Source<'a> = dyn FnMut(&Job) -> Result<Scored, ContestError> + 'a;

impl Contest {
    /// Trains and scores every entry with every seed. A trial that fails is named, and the others go on.
    ///
    /// # Errors
    /// Invalid settings or data that an entry cannot learn from (before anything is trained), or `stop` was set.
    pub fn run(&self, stop: &AtomicBool, on_event: &mut dyn FnMut(Event)) -> Result<Results, ContestError> {
        self.check_data()?;
        self.results(&mut |job| {
            let scored = job.train(stop, on_event);
            if let Err(ContestError::Trial(failed)) = &scored {
                on_event(Event::Failed(failed));
            }
            scored
        })
    }

    /// The results of the trials that stand; nothing is trained.
    ///
    /// # Errors
    /// Invalid settings.
    pub fn collect(&self) -> Result<Results, ContestError> {
        self.results(&mut |job| job.read())
    }

    fn results(&self, of: &mut Source) -> Result<Results, ContestError> {
        self.check()?;
        let mut missing = Vec::new();
        let standings = self.entries.iter().map(|entry| self.standing(entry, of, &mut missing));
        let standings = standings.collect::<Result<_, _>>()?;
        Ok(Results { standings, missing })
    }

    /// Whether the settings of all entries are valid.
    fn check(&self) -> Result<(), ContestError> {
        self.entries.iter().try_for_each(|entry| self.job(entry, "", 0, self.length).map(drop))
    }

    /// Whether every entry can learn from the data, and all are scored on the same images. Trials that stand need no data, so data that are gone
    /// are left to the others.
    fn check_data(&self) -> Result<(), ContestError> {
        let mut first: Option<(&str, Scene)> = None;
        for entry in &self.entries {
            let job = self.job(entry, "", 0, self.length)?;
            let data = match job.resolved.reopen_data() {
                Err(RunError::DataGone { .. }) => continue,
                data => data.map_err(|e| job.failed(e))?,
            };
            job.resolved.fits(&data).map_err(|e| job.failed(e))?;
            let own = Scene::of(&job.resolved, &data);
            match &first {
                None => first = Some((&entry.label, own)),
                Some((label, scene)) => scene.same(label, &own).map_err(|e| job.failed(e.into()))?,
            }
        }
        Ok(())
    }

    /// Whether two entries resolve to the same settings.
    ///
    /// # Errors
    /// If settings are invalid.
    pub(crate) fn same(&self, a: &Entry, b: &Entry) -> Result<bool, ContestError> {
        let of = |entry| self.job(entry, "", 0, self.length);
        Ok(of(a)?.resolved.trains_as(&of(b)?.resolved))
    }

    fn standing(
        &self,
        entry: &Entry,
        of: &mut Source,
        missing: &mut Vec<TrialError>,
    ) -> Result<Standing, ContestError> {
        let mut standing = Standing { label: entry.label.clone(), steps: None, trials: Vec::new() };
        let Some(length) = kept(self.length_of(entry, of), missing)? else { return Ok(standing) };
        for &seed in &self.seeds {
            let job = self.trial(entry, seed, length)?;
            standing.steps = Some(job.resolved.steps());
            let scored = kept(of(&job), missing)?;
            standing.trials.extend(scored.map(|s| Trial { seed, run: job.run, scores: s.scores }));
        }
        Ok(standing)
    }

    /// Length of an entry's trials; a time budget is turned into steps by a pilot.
    fn length_of(&self, entry: &Entry, of: &mut Source) -> Result<Length, ContestError> {
        match (self.length, self.pilot(entry)?) {
            (Length::Seconds(seconds), Some(pilot)) => {
                let scored = of(&pilot)?;
                let planned = u32::try_from(pilot.resolved.steps()).unwrap_or(u32::MAX);
                pilot::steps(&pilot.run, &scored, planned, seconds).map(Length::Steps).map_err(|e| pilot.failed(e))
            }
            (length, _) => Ok(length),
        }
    }

    /// The pilot of an entry under a time budget.
    fn pilot(&self, entry: &Entry) -> Result<Option<Job>, ContestError> {
        let Length::Seconds(seconds) = self.length else { return Ok(None) };
        let recipe = self.job(entry, "", PILOT_SEED, Length::Recipe)?.resolved.steps();
        let steps = pilot::length(u32::try_from(recipe).unwrap_or(u32::MAX));
        self.run_of(entry, "pilot", PILOT_SEED, (Some(steps), Some(seconds))).map(Some)
    }

    fn trial(&self, entry: &Entry, seed: u64, length: Length) -> Result<Job, ContestError> {
        self.job(entry, &format!("seed-{seed}"), seed, length)
    }

    /// The run of an entry in the folder `name`; without a name, settings to be looked at.
    fn job(&self, entry: &Entry, name: &str, seed: u64, length: Length) -> Result<Job, ContestError> {
        let lengths = match length {
            Length::Recipe => (None, None),
            Length::Steps(steps) => (Some(steps), None),
            Length::Seconds(seconds) => (None, Some(seconds)),
        };
        self.run_of(entry, name, seed, lengths)
    }

    /// The same of a number of steps and a time after which it stops, seconds.
    fn run_of(
        &self,
        entry: &Entry,
        name: &str,
        seed: u64,
        (steps, time_budget): (Option<u32>, Option<f64>),
    ) -> Result<Job, ContestError> {
        let request = Request {
            method: entry.method.clone(),
            preset: entry.preset.clone().unwrap_or_else(|| self.preset.clone()),
            data: Some(self.data.clone()),
            steps,
            time_budget,
            seed: Some(seed),
            sets: self.sets.iter().chain(&entry.sets).cloned().collect(),
            ..Request::default()
        };
        let trial = if name.is_empty() { entry.label.clone() } else { format!("{} / {name}", entry.label) };
        if request.sets.iter().any(|set| settings::assigns(set, "run.seed")) {
            let why = "run.seed is the seed of a trial: name seeds by --seeds, not by --set".to_owned();
            return Err(TrialError { trial, source: Box::new(ConfigError::Invalid(why).into()) }.into());
        }
        match resolve(&self.registry, &request) {
            Ok(resolved) => Ok(Job { trial, run: self.root.join(entry.slug()).join(name), request, resolved }),
            Err(source) => Err(TrialError { trial, source: Box::new(source) }.into()),
        }
    }
}

/// A result, or `None` for that of a trial without one, which is added to `missing`.
///
/// # Errors
/// Anything else.
fn kept<T>(result: Result<T, ContestError>, missing: &mut Vec<TrialError>) -> Result<Option<T>, ContestError> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(ContestError::Trial(error)) => {
            missing.push(error);
            Ok(None)
        }
        Err(other) => Err(other),
    }
}

#[cfg(test)]
mod tests;
