//! Contests: several entries on the same data, with the same seeds and the same time.
//!
//! An entry is a method with settings of its own. Under a time budget each entry first makes a short pilot run of its
//! whole recipe, compressed; the pilot's seconds per step say how many steps fill the budget, and the recipe is stretched
//! to that many. So every entry goes through all phases of its schedule, and none is cut off. Every trial is an ordinary
//! run folder; a trial that stands is not made again, one that was interrupted goes on.

use crate::evaluate::EvalReport;
use crate::run::folder::METRICS;
use crate::run::settings::{Request, resolve};
use crate::run::{OpenRun, Outcome, Progress, Resolved, RunError, Training};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// The pilot's share of the steps of the recipe.
const PILOT_SHARE: f64 = 0.04;
/// Steps of a pilot, at least.
const PILOT_STEPS: f64 = 150.0;

/// A contestant: `METHOD[:PRESET] [KEY=VALUE …]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The text it was made from.
    pub label: String,
    method: String,
    preset: Option<String>,
    sets: Vec<String>,
}

impl Entry {
    /// Reads an entry.
    ///
    /// # Errors
    /// If there is no method, or a word after it is no `KEY=VALUE`.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut words = text.split_whitespace();
        let name = words.next().ok_or("an entry begins with a method, for example \"fourdgs\"")?;
        let (method, preset) = match name.split_once(':') {
            Some((method, preset)) => (method, Some(preset.to_owned())),
            None => (name, None),
        };
        let sets: Vec<String> = words.map(str::to_owned).collect();
        if let Some(bad) = sets.iter().find(|s| !s.contains('=')) {
            return Err(format!("`{bad}` in the entry \"{text}\" is no KEY=VALUE"));
        }
        let label = std::iter::once(name).chain(sets.iter().map(String::as_str)).collect::<Vec<_>>().join(" ");
        Ok(Self { label, method: method.to_owned(), preset, sets })
    }

    /// A name for its folder.
    fn slug(&self) -> String {
        self.label.chars().map(|c| if c.is_ascii_alphanumeric() || "._-=".contains(c) { c } else { '_' }).collect()
    }
}

/// How long every trial may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Length {
    /// The recipe as its preset has it.
    Recipe,
    /// So many steps.
    Steps(u32),
    /// As many steps as fill so many seconds.
    Seconds(f64),
}

/// What is to be compared.
#[derive(Clone, Debug)]
pub struct Contest {
    /// Folder of the data.
    pub data: PathBuf,
    /// Folder of the trials.
    pub root: PathBuf,
    /// Preset of entries that name none.
    pub preset: String,
    /// The contestants.
    pub entries: Vec<Entry>,
    /// Every entry runs once with each.
    pub seeds: Vec<u64>,
    /// Length of every trial.
    pub length: Length,
    /// Settings of all entries, `KEY=VALUE`.
    pub sets: Vec<String>,
}

/// One run of an entry.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Trial {
    /// Its seed.
    pub seed: u64,
    /// Its folder.
    pub run: PathBuf,
    /// Its scores.
    pub scores: EvalReport,
}

/// All runs of an entry.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Standing {
    /// The entry.
    pub label: String,
    /// Steps of every trial.
    pub steps: u64,
    /// Its runs, in the order of seeds.
    pub trials: Vec<Trial>,
}

/// Mean and standard deviation over seeds (`n − 1` in the denominator; 0 for one seed).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub deviation: f64,
}

impl Spread {
    /// Of some values; `None` without any.
    pub fn of(values: &[f64]) -> Option<Self> {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        (!values.is_empty()).then(|| Self { mean, deviation: (squares / (n - 1.0).max(1.0)).sqrt() })
    }
}

impl Standing {
    /// A score over all seeds; trials without it are left out.
    pub fn spread(&self, score: impl Fn(&EvalReport) -> Option<f64>) -> Option<Spread> {
        Spread::of(&self.trials.iter().filter_map(|t| score(&t.scores)).collect::<Vec<_>>())
    }
}

/// What a contest tells while it runs.
pub enum Told<'a> {
    /// A trial begins (or goes on): its name.
    Trial(&'a str),
    /// A step was made.
    Step(Progress),
}

/// Why a contest ended early.
#[derive(Debug, thiserror::Error)]
pub enum ContestError {
    /// A trial failed.
    #[error("{trial}: {source}")]
    Run {
        /// Name of the trial.
        trial: String,
        /// Its reason.
        #[source]
        source: Box<RunError>,
    },
    /// The folder of a trial holds a run with other settings.
    #[error("{} holds a run with other settings", .0.display())]
    Other(PathBuf),
    /// The user asked to stop; the trial is saved and goes on when the contest is asked for again.
    #[error("interrupted; what was trained is saved in {}", .0.display())]
    Interrupted(PathBuf),
}

impl ContestError {
    fn run(trial: &str, source: RunError) -> Self {
        ContestError::Run { trial: trial.to_owned(), source: Box::new(source) }
    }
}

impl Contest {
    /// Runs every entry with every seed; `done` is told each standing as it is complete.
    ///
    /// # Errors
    /// If settings are refused, a trial fails, or `stop` was set.
    pub fn run(&self, stop: &AtomicBool, tell: &mut dyn FnMut(Told)) -> Result<Vec<Standing>, ContestError> {
        // Settings of all entries are verified before anything is trained.
        for entry in &self.entries {
            self.resolved(entry, 0, None).map_err(|e| ContestError::run(&entry.label, e))?;
        }
        self.entries.iter().map(|entry| self.standing(entry, stop, tell)).collect()
    }

    fn standing(&self, entry: &Entry, stop: &AtomicBool, tell: &mut dyn FnMut(Told)) -> Result<Standing, ContestError> {
        let steps = self.steps(entry, stop, tell)?;
        let mut trials = Vec::new();
        for &seed in &self.seeds {
            let run = self.root.join(entry.slug()).join(format!("seed-{seed}"));
            let scores = self.trial(entry, seed, steps, &run, stop, tell)?.scores;
            trials.push(Trial { seed, run, scores });
        }
        let steps = match steps {
            Some(steps) => u64::from(steps),
            None => self.resolved(entry, 0, None).map_or(0, |r| r.steps()),
        };
        Ok(Standing { label: entry.label.clone(), steps, trials })
    }

    /// Steps of an entry's trials, if they are not those of its recipe.
    fn steps(&self, entry: &Entry, stop: &AtomicBool, tell: &mut dyn FnMut(Told)) -> Result<Option<u32>, ContestError> {
        let seconds = match self.length {
            Length::Recipe => return Ok(None),
            Length::Steps(steps) => return Ok(Some(steps)),
            Length::Seconds(seconds) => seconds,
        };
        let failed = |e| ContestError::run(&entry.label, e);
        let recipe = self.resolved(entry, 0, None).map_err(failed)?.steps();
        let pilot = (PILOT_SHARE * recipe as f64).max(PILOT_STEPS) as u32;
        let run = self.root.join(entry.slug()).join("pilot");
        let seed = self.seeds.first().copied().unwrap_or(0);
        let made = self.trial(entry, seed, Some(pilot), &run, stop, tell)?;
        let per_step = made.seconds / f64::from(pilot);
        // Two leading digits: a repeated pilot gives the same number more often than not.
        let wanted = (seconds / per_step.max(1e-6)).clamp(1.0, 1e9);
        let unit = 10f64.powf(wanted.log10().floor() - 1.0).max(1.0);
        Ok(Some(((wanted / unit).floor() * unit) as u32))
    }

    fn trial(
        &self,
        entry: &Entry,
        seed: u64,
        steps: Option<u32>,
        run: &Path,
        stop: &AtomicBool,
        tell: &mut dyn FnMut(Told),
    ) -> Result<Made, ContestError> {
        let trial = format!("{} / {}", entry.label, run.file_name().unwrap_or_default().to_string_lossy());
        let failed = |e| ContestError::run(&trial, e);
        let resolved = self.resolved(entry, seed, steps).map_err(failed)?;
        if let Ok(open) = OpenRun::open(run) {
            if open.resolved.method != resolved.method || open.resolved.run.data != resolved.run.data {
                return Err(ContestError::Other(run.to_owned()));
            }
            let kept = open.folder.read(METRICS).ok().and_then(|text| serde_json::from_str(&text).ok());
            if let Some(scores) = kept {
                return Ok(Made { scores, seconds: open.loaded.train_seconds });
            }
        }
        tell(Told::Trial(&trial));
        let training = match OpenRun::open(run) {
            Ok(_) => Training::resume(run, None, None),
            Err(_) => Training::begin(run, true, resolved),
        };
        let mut training = training.map_err(failed)?;
        match training.train(stop, &mut |p| tell(Told::Step(p))).map_err(failed)? {
            Outcome::Interrupted(_) => Err(ContestError::Interrupted(run.to_owned())),
            _ => {
                let seconds = training.trainer().train_seconds();
                Ok(Made { scores: training.score().map_err(failed)?, seconds })
            }
        }
    }

    fn resolved(&self, entry: &Entry, seed: u64, steps: Option<u32>) -> Result<Resolved, RunError> {
        resolve(&Request {
            method: entry.method.clone(),
            preset: entry.preset.clone().unwrap_or_else(|| self.preset.clone()),
            data: Some(self.data.clone()),
            steps,
            seed: Some(seed),
            sets: self.sets.iter().chain(&entry.sets).cloned().collect(),
            ..Request::default()
        })
    }
}

struct Made {
    scores: EvalReport,
    seconds: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::{SynthOptions, write};

    #[test]
    fn entries_are_read_and_bad_ones_named() {
        let entry = Entry::parse(" fourdgs:tiny  schedule.lambda_dssim=0.1 ").unwrap();
        assert_eq!((entry.method.as_str(), entry.preset.as_deref()), ("fourdgs", Some("tiny")));
        assert_eq!(entry.label, "fourdgs:tiny schedule.lambda_dssim=0.1");
        assert_eq!(entry.slug(), "fourdgs_tiny_schedule.lambda_dssim=0.1");
        assert!(Entry::parse("").is_err());
        assert!(Entry::parse("fourdgs quick").unwrap_err().contains("`quick`"));
    }

    #[test]
    fn spread_is_mean_and_sample_deviation() {
        assert_eq!(Spread::of(&[1.0, 3.0]), Some(Spread { mean: 2.0, deviation: 2f64.sqrt() }));
        assert_eq!(Spread::of(&[5.0]), Some(Spread { mean: 5.0, deviation: 0.0 }));
        assert_eq!(Spread::of(&[]), None);
    }

    #[test]
    fn trials_stand_once_made_and_the_budget_sets_the_steps() {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("data");
        let small = SynthOptions { size: 32, train_views: 6, val_views: 1, test_views: 2, ..SynthOptions::default() };
        write(&data, "static", &small, false).unwrap();
        let contest = Contest {
            data,
            root: folder.path().join("contest"),
            preset: "tiny".into(),
            entries: vec![Entry::parse("static3d").unwrap(), Entry::parse("static3d init.points=200").unwrap()],
            seeds: vec![0, 1],
            length: Length::Steps(20),
            sets: vec!["run.log_every=10".into()],
        };
        let stop = AtomicBool::new(false);
        let mut trials = 0;
        let mut count = |t: Told| trials += u32::from(matches!(t, Told::Trial(_)));
        let first = contest.run(&stop, &mut count).unwrap();
        assert_eq!(first.iter().map(|s| (s.steps, s.trials.len())).collect::<Vec<_>>(), [(20, 2), (20, 2)]);
        let again = contest.run(&stop, &mut count).unwrap();
        assert_eq!((trials, first == again), (4, true));
        assert!(first[0].spread(|s| s.mean.psnr).unwrap().deviation > 0.0, "seeds differ");

        let other = Contest { length: Length::Steps(21), ..contest.clone() };
        assert!(matches!(other.run(&stop, &mut |_| {}), Err(ContestError::Other(_))));
        let timed = Contest { length: Length::Seconds(0.5), root: folder.path().join("timed"), ..contest };
        let timed = timed.run(&stop, &mut |_| {}).unwrap();
        assert!(timed[0].steps > 20, "{} steps in half a second", timed[0].steps);
    }

    #[test]
    fn a_contest_stops_when_asked_and_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("data");
        let small = SynthOptions { size: 32, train_views: 4, val_views: 1, test_views: 1, ..SynthOptions::default() };
        write(&data, "static", &small, false).unwrap();
        let contest = Contest {
            data,
            root: folder.path().join("contest"),
            preset: "tiny".into(),
            entries: vec![Entry::parse("static3d").unwrap()],
            seeds: vec![3],
            length: Length::Steps(12),
            sets: Vec::new(),
        };
        let stop = AtomicBool::new(false);
        let halt = |t: Told| {
            if let Told::Step(p) = t {
                stop.store(p.step >= 5, std::sync::atomic::Ordering::Relaxed);
            }
        };
        let mut halt = halt;
        assert!(matches!(contest.run(&stop, &mut halt), Err(ContestError::Interrupted(_))));
        let done = contest.run(&AtomicBool::new(false), &mut |_| {}).unwrap();
        assert_eq!(done[0].trials.len(), 1);
    }
}
