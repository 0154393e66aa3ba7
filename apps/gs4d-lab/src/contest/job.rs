//! One run of a contest: trained here, read back, or given as a command line.

use super::{ContestError, Event, TrialError};
use gs4d_run::settings::Request;
use gs4d_run::{Outcome, Resolved, RunError, Scored, Stage, Training, shell_quoted};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// A run of a contest.
#[derive(Clone, Debug)]
pub struct Job {
    /// `ENTRY / seed-N`, or `ENTRY / pilot`.
    pub trial: String,
    /// Run folder.
    pub run: PathBuf,
    pub(super) request: Request,
    pub(super) resolved: Resolved,
}

impl Job {
    pub(super) fn failed(&self, source: RunError) -> ContestError {
        TrialError { trial: self.trial.clone(), source: Box::new(source) }.into()
    }

    /// How far it has come.
    pub(super) fn stage(&self) -> Result<Stage, ContestError> {
        Stage::of(&self.run, &self.resolved).map_err(|e| self.failed(e))
    }

    /// Trains and scores it, unless that is done.
    pub(super) fn train(&self, stop: &AtomicBool, on_event: &mut dyn FnMut(Event)) -> Result<Scored, ContestError> {
        if let Stage::Finished(scored) = self.stage()? {
            return Ok(*scored);
        }
        on_event(Event::Trial(&self.trial));
        let failed = |e| self.failed(e);
        let mut training = Training::go_on(&self.run, self.resolved.clone()).map_err(failed)?;
        match training.train(stop, &mut |p, _| on_event(Event::Step(p))).map_err(failed)? {
            Outcome::Interrupted(_) => Err(ContestError::Interrupted(self.run.clone())),
            _ => Ok(Scored { scores: training.score().map_err(failed)?, step: training.trainer().steps_done() }),
        }
    }

    /// The result that stands.
    pub(super) fn read(&self) -> Result<Scored, ContestError> {
        let path = self.run.clone();
        match self.stage()? {
            Stage::Finished(scored) => Ok(*scored),
            Stage::Begun(step) => Err(self.failed(RunError::Unfinished { path, step, steps: self.resolved.steps() })),
            Stage::Missing => Err(self.failed(RunError::NotARun { path })),
        }
    }

    /// The `train` command that makes this run or goes on with it, quoted for a POSIX shell. It begins with `program`, as it
    /// stands, and its last word is the run folder.
    ///
    /// # Errors
    /// [`ContestError::Word`] if a word holds a line break or is not Unicode.
    pub fn command(&self, program: &str) -> Result<String, ContestError> {
        let Request { method, preset, data, steps, time_budget, seed, sets, file: _ } = &self.request;
        let text = |path: &Path| path.to_str().map(str::to_owned).ok_or_else(|| self.word(&path.to_string_lossy()));
        let mut words = vec!["train".to_owned()];
        words.extend(data.as_deref().map(text).transpose()?);
        let mut option =
            |name: &str, value: Option<String>| words.extend(value.into_iter().flat_map(|v| [name.to_owned(), v]));
        option("--method", Some(method.clone()));
        option("--preset", Some(preset.clone()));
        option("--steps", steps.map(|n| n.to_string()));
        option("--time-budget", time_budget.map(|s| format!("{s}s")));
        option("--seed", seed.map(|s| s.to_string()));
        sets.iter().for_each(|set| option("--set", Some(set.clone())));
        words.extend(["--continue".to_owned(), "--out".to_owned(), text(&self.run)?]);
        if let Some(broken) = words.iter().find(|w| w.contains(['\n', '\r'])) {
            return Err(self.word(broken));
        }
        Ok(std::iter::once(program.to_owned()).chain(words.into_iter().map(shell_quoted)).collect::<Vec<_>>().join(" "))
    }

    fn word(&self, word: &str) -> ContestError {
        ContestError::Word { trial: self.trial.clone(), word: word.to_owned() }
    }
}
