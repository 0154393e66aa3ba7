//! `gs4d compare methods`: several methods or settings on the same data, with the same seeds and the same time.

use super::jobs::{Jobs, ResultFile, check_seeds, failure, with_missing};
use super::train::time_text;
use crate::answer::Answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::create_folder;
use crate::parse;
use gs_core::io::write_file;
use gs4d_lab::aligned;
use gs4d_lab::contest::{Contest, Entry, Length, Results, SCORES, Score, Spread, Standing, Trial, machines};
use gs4d_report::html::{self, section};
use gs4d_run::RunError;
use gs4d_run::compare::page::course;
use gs4d_run::folder::{LOG, RunFolder};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::time::Duration;

/// Train methods or settings on the same data with the same seeds, and compare them; --steps or --time-budget makes them equally long
#[derive(clap::Args)]
pub struct ContestVerb {
    /// Folder of the data.
    #[arg(value_name = "DATA")]
    data: PathBuf,
    /// An entry: a method and its own settings in one argument, for example "fags" or "fags:tiny ablate=gate"
    /// (repeatable). The others are compared with the first.
    #[arg(short, long = "entry", value_name = "ENTRY", required = true, value_parser = Entry::parse)]
    entries: Vec<Entry>,
    /// Preset of entries that name none.
    #[arg(long, default_value = "fast")]
    preset: String,
    #[command(flatten)]
    trials: Trials,
}

const TITLE: &str = "Methods compared";
/// The files of results.
const FILES: [ResultFile; 3] =
    [("compare.json", "\"over_seeds\""), ("compare.csv", "entry,steps,seeds"), ("compare.html", TITLE)];

/// Conditions shared by all trials.
#[derive(clap::Args)]
pub struct Trials {
    /// Seeds; everything runs once with each. Several, for example 0,1,2, show how much of a difference is chance.
    #[arg(long, value_delimiter = ',', default_value = "0")]
    pub seeds: Vec<u64>,
    /// Training time of every trial: schedules are stretched or compressed to fill it, and so run to their end (the flag of gs4d train stops
    /// a schedule that is left as it is).
    #[arg(long, value_name = "TIME", value_parser = parse::duration, conflicts_with = "steps")]
    time_budget: Option<Duration>,
    /// Steps of every trial [default: those of its preset].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    steps: Option<u32>,
    /// A setting of all trials (repeatable).
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
    /// Folder of the trials and of the results; finished trials in it are not trained again.
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    pub jobs: Jobs,
}

impl Trials {
    /// Length of every trial.
    pub fn length(&self) -> Length {
        Length::of(self.time_budget, self.steps)
    }
}

impl ContestVerb {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        check_seeds(&self.trials.seeds)?;
        let length = self.trials.length();
        let Self { data, entries, preset, trials: Trials { seeds, sets, out: root, jobs, .. } } = self;
        let contest =
            Contest { registry: gs_methods::registry().clone(), data, root, preset, entries, seeds, length, sets };
        if let Some(lengths) = unequal_lengths(&contest)? {
            global.say(format!("warning: {lengths}; --steps or --time-budget makes them equally long"));
        }
        if let Some(list) = jobs.plan(std::slice::from_ref(&contest), global)? {
            return Ok(list);
        }
        let root = &contest.root;
        jobs.check_results(root, &FILES)?;
        let results = jobs.results(&contest, global)?;
        let none_stands = results.none_stands();
        let Results { standings, missing } = results;
        let json = with_missing(to_json(&standings), &missing);
        let mut text = String::new();
        if !none_stands {
            text.push_str(&table(&standings));
            create_folder(root)?;
            let contents = [format!("{json:#}\n"), csv(&standings), page(&contest, &standings)?];
            for ((name, _), content) in FILES.iter().zip(contents) {
                write_file(&root.join(name), true, |out| out.write_all(content.as_bytes()))?;
            }
            text.push_str(&format!("-> {}\n", root.join("compare.html").display()));
        }
        jobs.judge(Answer::new(text, json), missing, global)
    }
}

/// That entries train for different numbers of steps, in words, where neither steps nor time were asked for.
fn unequal_lengths(contest: &Contest) -> Result<Option<String>, Failure> {
    if contest.length != Length::Recipe {
        return Ok(None);
    }
    // All trials of an entry are equally long.
    let one = Contest { seeds: contest.seeds.iter().take(1).copied().collect(), ..contest.clone() };
    let steps = one.collect().map_err(failure)?.standings.into_iter().filter_map(|s| Some((s.label, s.steps?)));
    let steps: Vec<(String, u64)> = steps.collect();
    if steps.iter().all(|(_, n)| *n == steps[0].1) {
        return Ok(None);
    }
    let each: Vec<String> = steps.iter().map(|(label, n)| format!("{label} {n}")).collect();
    Ok(Some(format!("entries train for different numbers of steps ({})", each.join(", "))))
}

/// PSNR of an entry less that of the first, with the same seeds.
fn differences(standings: &[Standing], entry: &Standing) -> Vec<f64> {
    standings.first().map_or_else(Vec::new, |first| entry.psnr_less(first))
}

/// Head and rows: entry, steps, difference of PSNR to the first entry, and the scores that there are.
fn rows(standings: &[Standing]) -> (Vec<&'static str>, Vec<Vec<String>>) {
    let scores: Vec<Score> =
        SCORES.into_iter().filter(|(_, _, score)| standings.iter().any(|s| s.spread(score).is_some())).collect();
    let row = |(k, s): (usize, &Standing)| {
        let delta = match Spread::of(&differences(standings, s)) {
            Some(d) if k > 0 && d.deviation > 0.0 => format!("{:+.2} ±{:.2}", d.mean, d.deviation),
            Some(d) => format!("{:+.2}", d.mean),
            None => "-".to_owned(),
        };
        let scores = scores.iter().map(|(_, digits, score)| spread_text(s.spread(score), *digits));
        [s.label.clone(), s.steps.map_or("-".to_owned(), |n| n.to_string()), delta].into_iter().chain(scores).collect()
    };
    let head = ["entry", "steps", "dB"].into_iter().chain(scores.iter().map(|s| s.0)).collect();
    (head, standings.iter().enumerate().map(row).collect())
}

/// What the numbers of the table are.
fn remark(standings: &[Standing]) -> String {
    let seconds: f64 = standings.iter().flat_map(|s| &s.trials).filter_map(|t| t.scores.train_seconds).sum();
    let time = time_text(seconds);
    let machines = machines(standings).into_iter().collect::<Vec<_>>();
    let unlike = if machines.len() > 1 { format!("; not alike: {}", machines.join("; ")) } else { String::new() };
    format!(
        "dB: PSNR less that of the first entry with the same seed, view by view; ± one standard deviation over seeds; {time} of training{unlike}"
    )
}

fn table(standings: &[Standing]) -> String {
    let (head, rows) = rows(standings);
    format!("{}{}\n", aligned(&head, &rows, |column| column == 0), remark(standings))
}

fn page(contest: &Contest, standings: &[Standing]) -> Result<String, Failure> {
    let (head, rows) = rows(standings);
    let numeric: Vec<usize> = (1..head.len()).collect();
    let trials = standings.iter().flat_map(|s| s.trials.iter().map(move |t| (s, t)));
    let trials = trials.map(|(s, t)| vec![s.label.clone(), t.seed.to_string(), t.run.display().to_string()]);
    let seeds: Vec<String> = contest.seeds.iter().map(u64::to_string).collect();
    let log = |trial: &Trial| RunFolder::open(&trial.run)?.log_lines(LOG);
    let logs = |s: &Standing| s.trials.iter().map(log).collect::<Result<Vec<_>, RunError>>();
    let logs: Vec<Vec<Vec<Value>>> = standings.iter().map(logs).collect::<Result<_, _>>()?;
    let named = standings.iter().zip(&logs).map(|(s, l)| (s.label.as_str(), l.iter().map(Vec::as_slice).collect()));
    let course = course(&named.collect::<Vec<_>>()).map_err(RunError::from)?;
    let parts =
        section("Scores on held-out views", &remark(standings), &html::table(&head, &numeric, rows.into_iter()))
            + &course
            + &section("Trials", "", &html::table(&["entry", "seed", "run"], &[1], trials));
    let subtitle = format!("{} · seeds {} · preset {}", contest.data.display(), seeds.join(", "), contest.preset);
    Ok(html::document(TITLE, &subtitle, &parts))
}

/// One line for each entry: every score as mean and standard deviation over seeds.
fn csv(standings: &[Standing]) -> String {
    let names = SCORES.iter().map(|(name, ..)| format!(",{name},{name}_deviation")).collect::<String>();
    let mut text = format!("entry,steps,seeds{names}\n");
    for s in standings {
        let quoted = s.label.replace('"', "\"\"");
        let steps = s.steps.map_or(String::new(), |n| n.to_string());
        let values = SCORES
            .iter()
            .map(|(_, _, score)| s.spread(score).map_or(",,".to_owned(), |v| format!(",{},{}", v.mean, v.deviation)));
        text.push_str(&format!("\"{quoted}\",{steps},{}{}\n", s.trials.len(), values.collect::<String>()));
    }
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
        let psnr = |t: &Trial| t.scores.mean.psnr;
        let of_first = |seed| standings.first().and_then(|first| first.of_seed(seed)).and_then(psnr);
        let trial = |t: &Trial| {
            let less = psnr(t).zip(of_first(t.seed)).map(|(own, first)| own - first);
            json!({"seed": t.seed, "run": t.run.display().to_string(), "psnr_less_the_first": less})
        };
        let trials: Vec<Value> = s.trials.iter().map(trial).collect();
        let less = Spread::of(&differences(standings, s));
        json!({"entry": s.label, "steps": s.steps, "over_seeds": spreads, "psnr_less_the_first": less, "trials": trials})
    };
    json!({"entries": standings.iter().map(entry).collect::<Vec<_>>()})
}
