//! `gs4d contest`: several methods or settings on the same data, with the same seeds and the same time.

use super::train::time_text;
use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::progress::Progress;
use crate::{interrupt, parse};
use gs4d_lab::contest::{Contest, ContestError, Entry, Length, SCORES, Score, Spread, Standing, Told};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Compare methods or settings on the same data, with equal time and several seeds
#[derive(clap::Args)]
pub struct ContestVerb {
    /// Folder of the data.
    #[arg(value_name = "DATA")]
    data: PathBuf,
    /// A contestant: a method and settings of its own in one argument, for example "fags" or "fags:tiny ablate=gate"
    /// (repeatable). The others are compared with the first.
    #[arg(short, long = "entry", value_name = "ENTRY", required = true, value_parser = Entry::parse)]
    entries: Vec<Entry>,
    /// Preset of entries that name none.
    #[arg(long, default_value = "fast")]
    preset: String,
    #[command(flatten)]
    trials: Trials,
}

/// How trials are made, the same for all.
#[derive(clap::Args)]
pub struct Trials {
    /// Seeds; everything runs once with each.
    #[arg(long, value_delimiter = ',', default_value = "0")]
    pub seeds: Vec<u64>,
    /// Training time of every trial: recipes are stretched or compressed to fill it.
    #[arg(long, value_name = "TIME", value_parser = parse::duration, conflicts_with = "steps")]
    time_budget: Option<Duration>,
    /// Steps of every trial.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    steps: Option<u32>,
    /// A setting of all trials (repeatable).
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
    /// Folder of the trials and of what comes of them; trials that stand in it are not made again.
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
}

impl Trials {
    /// How long each of them is.
    pub fn length(&self) -> Length {
        Length::of(self.time_budget, self.steps)
    }
}

impl ContestVerb {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let length = self.trials.length();
        let Self { data, entries, preset, trials: Trials { seeds, sets, out: root, .. } } = self;
        let contest =
            Contest { registry: gs_methods::registry().clone(), data, root, preset, entries, seeds, length, sets };
        let standings = follow(global, |stop, tell| contest.run(stop, tell))?.map_err(failure)?;
        Ok(Answer::new(table(&standings), to_json(&standings)))
    }
}

/// Runs trials under a progress line for each, until done or interrupted.
pub fn follow<T>(global: &Global, run: impl FnOnce(&AtomicBool, &mut dyn FnMut(Told)) -> T) -> Result<T, Failure> {
    let stop = interrupt::flag()?;
    let mut progress: Option<Progress> = None;
    let result = run(&stop, &mut |told| match told {
        Told::Trial(name) => {
            if let Some(done) = progress.take() {
                done.finish();
            }
            global.say(name);
        }
        Told::Step(p) => {
            let line = progress.get_or_insert_with(|| Progress::new(u64::from(p.steps), "steps", global.quiet));
            line.at(u64::from(p.step), || format!("{:.2} dB  {} splats", p.psnr, p.splats));
        }
    });
    if let Some(done) = progress {
        done.finish();
    }
    Ok(result)
}

/// What went wrong in a trial.
pub fn failure(e: ContestError) -> Failure {
    let again = "the same command goes on where it stopped";
    match e {
        ContestError::Run { trial, source } => Failure::from(*source).why(format!("in the trial {trial}")),
        ContestError::Other(_) => Failure::new(Class::Io, "io.exists", e.to_string())
            .why("nothing is overwritten unless asked")
            .remedy("choose another folder with -o"),
        ContestError::Interrupted(_) => Failure::new(Class::Interrupted, "interrupted", e.to_string()).remedy(again),
    }
}

fn table(standings: &[Standing]) -> String {
    let width = standings.iter().map(|s| s.label.len()).max().unwrap_or(0).max(5);
    let mut text = format!("{:width$}  {:>8}  {:>7}", "entry", "steps", "dB");
    let scores: Vec<Score> =
        SCORES.into_iter().filter(|(_, _, score)| standings.iter().any(|s| s.spread(score).is_some())).collect();
    scores.iter().for_each(|(name, ..)| text.push_str(&format!("  {name:>15}")));
    text.push('\n');
    let psnr = |s: &Standing| s.spread(|r| r.mean.psnr).map(|p| p.mean);
    let first = standings.first().and_then(psnr);
    for standing in standings {
        let delta = psnr(standing).zip(first).map_or("-".to_owned(), |(p, f)| format!("{:+.2}", p - f));
        text.push_str(&format!("{:width$}  {:>8}  {delta:>7}", standing.label, standing.steps));
        for (_, digits, score) in &scores {
            text.push_str(&format!("  {:>15}", spread_text(standing.spread(score), *digits)));
        }
        text.push('\n');
    }
    let seconds: f64 = standings.iter().flat_map(|s| &s.trials).filter_map(|t| t.scores.train_seconds).sum();
    text.push_str(&format!(
        "dB: mean PSNR against the first entry; ± one standard deviation over seeds; {} of training\n",
        time_text(seconds)
    ));
    text
}

fn spread_text(spread: Option<Spread>, digits: usize) -> String {
    match spread {
        Some(s) if s.deviation > 0.0 => format!("{:.digits$} ±{:.digits$}", s.mean, s.deviation),
        Some(s) => format!("{:.digits$}", s.mean),
        None => "-".to_owned(),
    }
}

fn to_json(standings: &[Standing]) -> Value {
    let entry = |s: &Standing| {
        let spreads: serde_json::Map<_, _> =
            SCORES.iter().map(|(name, _, score)| ((*name).to_owned(), json!(s.spread(score)))).collect();
        let trials: Vec<Value> =
            s.trials.iter().map(|t| json!({"seed": t.seed, "run": t.run.display().to_string()})).collect();
        json!({"entry": s.label, "steps": s.steps, "over_seeds": spreads, "trials": trials})
    };
    json!({"entries": standings.iter().map(entry).collect::<Vec<_>>()})
}
