//! Contests: several entries on the same data, with the same seeds and the same training time.
//!
//! An entry is a method with its own settings. Under a time budget each entry first trains a pilot: its unchanged recipe,
//! stopped after a fifth of the budget. The seconds per step at the end of the pilot give the number of steps that fill the
//! budget, and the recipe is stretched or compressed to that many, so that every entry goes through all stages of its
//! schedule. The measured seconds are part of the result. Every trial is an ordinary run folder; a finished trial is not
//! trained again, an interrupted one is resumed.

use gs_train::evaluate::EvalReport;
use gs_train::registry::Registry;
pub use gs4d_eval::spread::{SCORES, Score, Spread};
use gs4d_run::folder::{LOG, METRICS};
use gs4d_run::settings::{Request, resolve};
use gs4d_run::{OpenRun, Outcome, Progress, Resolved, ResumeRequest, RunError, Training};
use serde::Serialize;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Share of the time budget spent on the pilot.
const PILOT_SHARE: f64 = 0.2;
/// Seconds per step are measured over this last share of the pilot.
const MEASURED_SHARE: f64 = 0.25;

/// One entry of a contest: `METHOD[:PRESET] [KEY=VALUE …]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The parsed text with single spaces; the name of the entry in tables.
    pub label: String,
    method: String,
    preset: Option<String>,
    sets: Vec<String>,
}

impl Entry {
    /// A method with the preset of the contest and no settings of its own.
    pub fn new(method: &str) -> Self {
        Self { label: method.to_owned(), method: method.to_owned(), preset: None, sets: Vec::new() }
    }

    /// The same entry with one more setting `KEY=VALUE`.
    pub(crate) fn with(&self, set: String) -> Self {
        let label = format!("{} {set}", self.label);
        Self { label, sets: self.sets.iter().cloned().chain([set]).collect(), ..self.clone() }
    }

    /// Parses `METHOD[:PRESET] [KEY=VALUE …]`.
    ///
    /// # Errors
    /// If there is no method, or a word after it is no `KEY=VALUE`.
    ///
    /// ```
    /// use gs4d_lab::contest::Entry;
    /// assert_eq!(Entry::parse("fags:tiny  ablate=gate").unwrap().label, "fags:tiny ablate=gate");
    /// assert!(Entry::parse("fags quick").is_err());
    /// ```
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

    /// Name of the folder of its trials.
    fn slug(&self) -> String {
        self.label.chars().map(|c| if c.is_ascii_alphanumeric() || "._-=".contains(c) { c } else { '_' }).collect()
    }
}

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
    /// Steps of every trial.
    pub steps: u64,
    /// One trial per seed, in the order of [`Contest::seeds`].
    pub trials: Vec<Trial>,
}

impl Standing {
    /// Mean and deviation of a score over the trials that have it; `None` if none has.
    pub fn spread(&self, score: impl Fn(&EvalReport) -> Option<f64>) -> Option<Spread> {
        Spread::of(&self.trials.iter().filter_map(|t| score(&t.scores)).collect::<Vec<_>>())
    }
}

/// Progress of a contest.
pub enum Event<'a> {
    /// A trial is started or resumed: `ENTRY / seed-N`.
    Trial(&'a str),
    /// A training step is done.
    Step(Progress),
}

/// Why a contest ended without a result.
#[derive(Debug, thiserror::Error)]
pub enum ContestError {
    /// Settings of an entry are invalid, or a trial failed.
    #[error("{trial}: {source}")]
    Run {
        /// Entry, or entry and seed.
        trial: String,
        /// The cause.
        #[source]
        source: Box<RunError>,
    },
    /// The folder of a trial holds a run with different settings.
    #[error("{} holds a run with other settings", .0.display())]
    Other(PathBuf),
    /// The stop flag was set. The trial is saved, and running the contest again resumes it.
    #[error("interrupted; what was trained is saved in {}", .0.display())]
    Interrupted(PathBuf),
}

impl ContestError {
    fn run(trial: &str, source: RunError) -> Self {
        ContestError::Run { trial: trial.to_owned(), source: Box::new(source) }
    }
}

impl Contest {
    /// Trains and scores every entry with every seed; the results are in the order of the entries.
    ///
    /// # Errors
    /// Invalid settings (before anything is trained), a failed trial, or `stop` was set.
    pub fn run(&self, stop: &AtomicBool, on_event: &mut dyn FnMut(Event)) -> Result<Vec<Standing>, ContestError> {
        for entry in &self.entries {
            self.resolved(entry, 0, self.length).map_err(|e| ContestError::run(&entry.label, e))?;
        }
        self.entries.iter().map(|entry| self.standing(entry, stop, on_event)).collect()
    }

    /// Whether two entries resolve to the same settings.
    ///
    /// # Errors
    /// If settings are invalid.
    pub(crate) fn same(&self, a: &Entry, b: &Entry) -> Result<bool, ContestError> {
        let of = |e: &Entry| self.resolved(e, 0, self.length).map_err(|s| ContestError::run(&e.label, s));
        let (a, b) = (of(a)?, of(b)?);
        Ok(a.method == b.method && a.run == b.run)
    }

    fn standing(
        &self,
        entry: &Entry,
        stop: &AtomicBool,
        on_event: &mut dyn FnMut(Event),
    ) -> Result<Standing, ContestError> {
        let length = self.length(entry, stop, on_event)?;
        let mut trials = Vec::new();
        for &seed in &self.seeds {
            let run = self.root.join(entry.slug()).join(format!("seed-{seed}"));
            let scores = self.trial(entry, seed, length, &run, stop, on_event)?;
            trials.push(Trial { seed, run, scores });
        }
        let resolved = self.resolved(entry, 0, length).map_err(|e| ContestError::run(&entry.label, e))?;
        let steps = resolved.steps();
        Ok(Standing { label: entry.label.clone(), steps, trials })
    }

    /// Length of an entry's trials; a time budget is turned into steps by a pilot.
    fn length(
        &self,
        entry: &Entry,
        stop: &AtomicBool,
        on_event: &mut dyn FnMut(Event),
    ) -> Result<Length, ContestError> {
        let Length::Seconds(seconds) = self.length else { return Ok(self.length) };
        let run = self.root.join(entry.slug()).join("pilot");
        let seed = self.seeds.first().copied().unwrap_or(0);
        self.trial(entry, seed, Length::Seconds(PILOT_SHARE * seconds), &run, stop, on_event)?;
        let failed = |e| ContestError::run(&entry.label, e);
        let pilot = OpenRun::open(&self.registry, &run).map_err(failed)?;
        let lines = pilot.folder().and_then(|folder| folder.log_lines(LOG)).map_err(failed)?;
        // A pilot too short to have logged twice: mean over all its steps.
        let mean = || pilot.loaded.train_seconds / f64::from(pilot.loaded.step.max(1));
        let per_step = settled_seconds(&lines).unwrap_or_else(mean);
        // Rounded down to two digits, so that a repeated pilot usually gives the same number of steps.
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
        on_event: &mut dyn FnMut(Event),
    ) -> Result<EvalReport, ContestError> {
        let trial = format!("{} / {}", entry.label, run.file_name().unwrap_or_default().to_string_lossy());
        let failed = |e| ContestError::run(&trial, e);
        let resolved = self.resolved(entry, seed, length).map_err(failed)?;
        if let Ok(open) = OpenRun::open(&self.registry, run) {
            if open.resolved.method != resolved.method || open.resolved.run != resolved.run {
                return Err(ContestError::Other(run.to_owned()));
            }
            let saved = open.folder().and_then(|folder| folder.read(METRICS)).ok();
            let saved = saved.and_then(|text| serde_json::from_str(&text).ok());
            if let Some(scores) = saved {
                return Ok(scores);
            }
        }
        on_event(Event::Trial(&trial));
        // An interrupted pilot is started again: its budget is in seconds, and short.
        let training = match OpenRun::open(&self.registry, run) {
            Ok(_) if !matches!(length, Length::Seconds(_)) => {
                Training::resume(&self.registry, run, &ResumeRequest::default())
            }
            _ => Training::begin(run, true, resolved),
        };
        let mut training = training.map_err(failed)?;
        match training.train(stop, &mut |p, _| on_event(Event::Step(p))).map_err(failed)? {
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

/// Seconds per step over the last [`MEASURED_SHARE`] of a log; `None` for a log too short.
fn settled_seconds(lines: &[Value]) -> Option<f64> {
    let marks: Vec<[f64; 2]> =
        lines.iter().filter_map(|l| Some([l["step"].as_f64()?, l["seconds"].as_f64()?])).collect();
    let &[last_step, last] = marks.last()?;
    let [step, seconds] = marks.iter().find(|m| m[1] >= (1.0 - MEASURED_SHARE) * last && m[0] < last_step)?;
    Some((last - seconds) / (last_step - step))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_synth::{SynthOptions, write};

    /// A contest without entries on a small scene written below `folder`.
    fn tiny(folder: &Path, train_views: u32, test_views: u32) -> Contest {
        let data = folder.join("data");
        let small = SynthOptions { val_views: 1, ..SynthOptions::of_views(32, train_views, test_views) };
        write(&data, "static", &small, false).unwrap();
        Contest {
            registry: gs_methods::registry().clone(),
            data,
            root: folder.join("contest"),
            preset: "tiny".into(),
            entries: Vec::new(),
            seeds: vec![0],
            length: Length::Recipe,
            sets: Vec::new(),
        }
    }

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
        let contest = Contest {
            entries: vec![Entry::parse("static3d").unwrap(), Entry::parse("static3d init.points=200").unwrap()],
            seeds: vec![0, 1],
            length: Length::Steps(20),
            sets: vec!["run.log_every=2".into()],
            ..tiny(folder.path(), 6, 2)
        };
        let stop = AtomicBool::new(false);
        let mut trials = 0;
        let mut count = |t: Event| trials += u32::from(matches!(t, Event::Trial(_)));
        let first = contest.run(&stop, &mut count).unwrap();
        assert_eq!(first.iter().map(|s| (s.steps, s.trials.len())).collect::<Vec<_>>(), [(20, 2), (20, 2)]);
        let again = contest.run(&stop, &mut count).unwrap();
        assert_eq!((trials, first == again), (4, true));
        assert!(first[0].spread(|s| s.mean.psnr).unwrap().deviation > 0.0, "seeds differ");

        let other = Contest { length: Length::Steps(21), ..contest.clone() };
        assert!(matches!(other.run(&stop, &mut |_| {}), Err(ContestError::Other(_))));
        let timed = Contest { length: Length::Seconds(2.0), root: folder.path().join("timed"), ..contest };
        let timed = timed.run(&stop, &mut |_| {}).unwrap();
        assert!(timed[0].steps > 20, "{} steps in two seconds", timed[0].steps);
    }

    #[test]
    fn a_contest_stops_when_asked_and_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let contest = Contest {
            entries: vec![Entry::parse("static3d").unwrap()],
            seeds: vec![3],
            length: Length::Steps(12),
            ..tiny(folder.path(), 4, 1)
        };
        let stop = AtomicBool::new(false);
        let mut halt = |t: Event| {
            if let Event::Step(p) = t {
                stop.store(p.step >= 5, std::sync::atomic::Ordering::Relaxed);
            }
        };
        assert!(matches!(contest.run(&stop, &mut halt), Err(ContestError::Interrupted(_))));
        let done = contest.run(&AtomicBool::new(false), &mut |_| {}).unwrap();
        assert_eq!(done[0].trials.len(), 1);
    }
}
