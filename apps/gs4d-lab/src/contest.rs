//! Contests: several entries on the same data, with the same seeds and the same time.
//!
//! An entry is a method with settings of its own. Under a time budget each entry first makes a pilot run: its recipe as it
//! stands, stopped after a fifth of the budget. What a step took at the pilot's end says how many steps fill the budget,
//! and the recipe is stretched or compressed to that many: every entry goes through all phases of its schedule, and none
//! is cut off. The seconds they really took are part of the result. Every trial is an ordinary run folder; a trial that
//! stands is not made again, one that was interrupted goes on.

use gs_train::evaluate::EvalReport;
use gs_train::registry::Registry;
pub use gs4d_eval::spread::{SCORES, Score, Spread};
use gs4d_run::folder::{LOG, METRICS};
use gs4d_run::settings::{Request, resolve};
use gs4d_run::{OpenRun, Outcome, Progress, Resolved, RunError, Training};
use serde::Serialize;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// The pilot's share of the time budget.
const PILOT_SHARE: f64 = 0.2;
/// Share of the pilot, from its end, that says what a step takes.
const SETTLED: f64 = 0.25;

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
    /// A method with the contest's preset and settings of its own.
    pub fn new(method: &str, sets: Vec<String>) -> Self {
        let label = std::iter::once(method).chain(sets.iter().map(String::as_str)).collect::<Vec<_>>().join(" ");
        Self { label, method: method.to_owned(), preset: None, sets }
    }

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

impl Length {
    /// The length of a time budget, else of a number of steps, else the recipe's.
    pub fn of(time_budget: Option<Duration>, steps: Option<u32>) -> Self {
        match (time_budget, steps) {
            (Some(time), _) => Length::Seconds(time.as_secs_f64()),
            (None, Some(steps)) => Length::Steps(steps),
            (None, None) => Length::Recipe,
        }
    }
}

/// What is to be compared.
#[derive(Clone, Debug)]
pub struct Contest {
    /// The methods there are.
    pub registry: Registry,
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
            self.resolved(entry, 0, self.length).map_err(|e| ContestError::run(&entry.label, e))?;
        }
        self.entries.iter().map(|entry| self.standing(entry, stop, tell)).collect()
    }

    /// Whether two entries come to the same settings.
    ///
    /// # Errors
    /// If settings are refused.
    pub fn same(&self, a: &Entry, b: &Entry) -> Result<bool, ContestError> {
        let of = |e: &Entry| self.resolved(e, 0, self.length).map_err(|s| ContestError::run(&e.label, s));
        let (a, b) = (of(a)?, of(b)?);
        Ok(a.method == b.method && a.run == b.run)
    }

    fn standing(&self, entry: &Entry, stop: &AtomicBool, tell: &mut dyn FnMut(Told)) -> Result<Standing, ContestError> {
        let length = self.length(entry, stop, tell)?;
        let mut trials = Vec::new();
        for &seed in &self.seeds {
            let run = self.root.join(entry.slug()).join(format!("seed-{seed}"));
            let scores = self.trial(entry, seed, length, &run, stop, tell)?;
            trials.push(Trial { seed, run, scores });
        }
        let resolved = self.resolved(entry, 0, length).map_err(|e| ContestError::run(&entry.label, e))?;
        let steps = resolved.steps();
        Ok(Standing { label: entry.label.clone(), steps, trials })
    }

    /// Length of an entry's trials, in steps where there is a time budget.
    fn length(&self, entry: &Entry, stop: &AtomicBool, tell: &mut dyn FnMut(Told)) -> Result<Length, ContestError> {
        let Length::Seconds(seconds) = self.length else { return Ok(self.length) };
        let run = self.root.join(entry.slug()).join("pilot");
        let seed = self.seeds.first().copied().unwrap_or(0);
        self.trial(entry, seed, Length::Seconds(PILOT_SHARE * seconds), &run, stop, tell)?;
        let failed = |e| ContestError::run(&entry.label, e);
        let pilot = OpenRun::open(&self.registry, &run).map_err(failed)?;
        let lines = pilot.folder().and_then(|folder| folder.log_lines(LOG)).map_err(failed)?;
        // A pilot too short for its log is known by its checkpoint.
        let mean = || pilot.loaded.train_seconds / f64::from(pilot.loaded.step.max(1));
        let per_step = settled_seconds(&lines).unwrap_or_else(mean);
        // Two leading digits: a repeated pilot gives the same number more often than not.
        let wanted = (seconds / per_step.max(1e-6)).clamp(1.0, 1e9);
        let unit = 10f64.powf(wanted.log10().floor() - 1.0).max(1.0);
        Ok(Length::Steps(((wanted / unit).floor() * unit) as u32))
    }

    fn trial(
        &self,
        entry: &Entry,
        seed: u64,
        length: Length,
        run: &Path,
        stop: &AtomicBool,
        tell: &mut dyn FnMut(Told),
    ) -> Result<EvalReport, ContestError> {
        let trial = format!("{} / {}", entry.label, run.file_name().unwrap_or_default().to_string_lossy());
        let failed = |e| ContestError::run(&trial, e);
        let resolved = self.resolved(entry, seed, length).map_err(failed)?;
        if let Ok(open) = OpenRun::open(&self.registry, run) {
            if open.resolved.method != resolved.method || open.resolved.run != resolved.run {
                return Err(ContestError::Other(run.to_owned()));
            }
            let kept = open.folder().and_then(|folder| folder.read(METRICS)).ok();
            let kept = kept.and_then(|text| serde_json::from_str(&text).ok());
            if let Some(scores) = kept {
                return Ok(scores);
            }
        }
        tell(Told::Trial(&trial));
        // A pilot that was interrupted begins anew: its budget is one of seconds, and short.
        let training = match OpenRun::open(&self.registry, run) {
            Ok(_) if !matches!(length, Length::Seconds(_)) => Training::resume(&self.registry, run, None, None),
            _ => Training::begin(run, true, resolved),
        };
        let mut training = training.map_err(failed)?;
        match training.train(stop, &mut |p, _| tell(Told::Step(p))).map_err(failed)? {
            Outcome::Interrupted(_) => Err(ContestError::Interrupted(run.to_owned())),
            _ => training.score().map_err(failed),
        }
    }

    fn resolved(&self, entry: &Entry, seed: u64, length: Length) -> Result<Resolved, RunError> {
        let (steps, time_budget) = match length {
            Length::Recipe => (None, None),
            Length::Steps(steps) => (Some(steps), None),
            Length::Seconds(seconds) => (None, Some(seconds)),
        };
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
        resolve(&self.registry, &request)
    }
}

/// Seconds a step took in the last part of a log of at least two lines.
fn settled_seconds(lines: &[Value]) -> Option<f64> {
    let marks: Vec<[f64; 2]> =
        lines.iter().filter_map(|l| Some([l["step"].as_f64()?, l["seconds"].as_f64()?])).collect();
    let &[last_step, last] = marks.last()?;
    let [step, seconds] = marks.iter().find(|m| m[1] >= (1.0 - SETTLED) * last && m[0] < last_step)?;
    Some((last - seconds) / (last_step - step))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_synth::{SynthOptions, write};

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
    fn a_step_takes_what_it_took_at_the_end_of_the_pilot() {
        let line = |step: u32, seconds: f64| serde_json::json!({"step": step, "seconds": seconds});
        assert_eq!(settled_seconds(&[line(10, 1.0), line(20, 4.0), line(30, 9.0), line(40, 12.0)]), Some(0.3));
        assert_eq!(settled_seconds(&[line(10, 1.0)]), None);
        assert_eq!(settled_seconds(&[]), None);
    }

    #[test]
    fn trials_stand_once_made_and_the_budget_sets_the_steps() {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("data");
        let small = SynthOptions { size: 32, train_views: 6, val_views: 1, test_views: 2, ..SynthOptions::default() };
        write(&data, "static", &small, false).unwrap();
        let contest = Contest {
            registry: gs_methods::registry().clone(),
            data,
            root: folder.path().join("contest"),
            preset: "tiny".into(),
            entries: vec![Entry::parse("static3d").unwrap(), Entry::parse("static3d init.points=200").unwrap()],
            seeds: vec![0, 1],
            length: Length::Steps(20),
            sets: vec!["run.log_every=2".into()],
        };
        let stop = AtomicBool::new(false);
        let mut trials = 0;
        let mut count = |t: Told| trials += u32::from(matches!(t, Told::Trial(_)));
        let first = contest.run(&stop, &mut count).unwrap();
        assert_eq!(first.iter().map(|s| (s.steps, s.trials.len())).collect::<Vec<_>>(), [(20, 2), (20, 2)]);
        let again = contest.run(&stop, &mut count).unwrap();
        assert_eq!((trials, first == again), (4, true));
        assert!(first[0].spread(|s| s.mean.psnr).unwrap().deviation > 0.0, "seeds differ");

        let other = Contest { registry: gs_methods::registry().clone(), length: Length::Steps(21), ..contest.clone() };
        assert!(matches!(other.run(&stop, &mut |_| {}), Err(ContestError::Other(_))));
        let timed = Contest {
            registry: gs_methods::registry().clone(),
            length: Length::Seconds(2.0),
            root: folder.path().join("timed"),
            ..contest
        };
        let timed = timed.run(&stop, &mut |_| {}).unwrap();
        assert!(timed[0].steps > 20, "{} steps in two seconds", timed[0].steps);
    }

    #[test]
    fn a_contest_stops_when_asked_and_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("data");
        let small = SynthOptions { size: 32, train_views: 4, val_views: 1, test_views: 1, ..SynthOptions::default() };
        write(&data, "static", &small, false).unwrap();
        let contest = Contest {
            registry: gs_methods::registry().clone(),
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
