//! `gs4d reproduce nightly`: the papers' orders on few generated scenes.

use super::{ReproduceVerb, contests, failure, files, outcome, weights, write_page};
use crate::answer::Answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::verbs::jobs::{Jobs, ResultFile, with_missing};
use gs_core::io::write_file;
use gs4d_eval::folders::Lpips;
use gs4d_lab::aligned;
use gs4d_lab::contest::{Length, Results, TrialError};
use gs4d_reproduce::nightly::{SEEDS, TITLE, markdown, reproductions, sentence};
use gs4d_reproduce::{Outcome, Reproduction};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// What stands in place of a paper.
pub(super) const NAME: &str = "nightly";

/// The files of the job. Each of its tables has its own page below.
const FILES: [ResultFile; 2] = [("nightly.json", "\"protocol\""), ("nightly.md", TITLE)];

pub(super) fn run(verb: ReproduceVerb, global: &Global) -> Result<Answer, Failure> {
    let own = [
        ("--data", !verb.data.is_empty()),
        ("--scenes", !verb.scenes.is_empty()),
        ("--entries", !verb.entries.is_empty()),
        ("--time-budget", verb.time_budget.is_some()),
    ];
    if let Some((flag, _)) = own.into_iter().find(|(_, given)| *given) {
        return Err(Failure::usage(format!("nightly takes no {flag}"))
            .why("scenes, entries and steps stand in its tables")
            .remedy("run a single table: gs4d reproduce PAPER TABLE"));
    }
    let out = verb.out.clone();
    let conditions = verb.conditions(out.clone().unwrap_or_default(), &SEEDS)?;
    let tables = reproductions(verb.table.as_deref(), &conditions).map_err(failure)?;
    match out {
        Some(root) => {
            let job = Job { root, tables, weights: weights(&verb.lpips)?, jobs: verb.jobs };
            job.run(global)
        }
        None => Ok(list(&tables)),
    }
}

/// The tables of the job, with the number of their trainings.
fn list(tables: &[Reproduction]) -> Answer {
    let of = |table: &Reproduction| {
        let scenes: Vec<&str> = table.scenes.iter().map(|s| s.name()).collect();
        let trials = table.table.runnable().count() * scenes.len() * table.conditions.seeds.len();
        let Length::Steps(steps) = table.conditions.length else { return (Vec::new(), Value::Null) };
        let (name, scenes) = (table.table.full_name(), scenes.join(", "));
        let json = json!({"table": name, "scenes": scenes, "trainings": trials, "steps": steps});
        (vec![name, scenes, trials.to_string(), steps.to_string()], json)
    };
    let (rows, values): (Vec<_>, Vec<_>) = tables.iter().map(of).unzip();
    let text = aligned(&["table", "scenes", "trainings", "steps"], &rows, |column| column < 2)
        + "\nrun them: -o DIR; one of them: gs4d reproduce nightly TABLE -o DIR\n";
    Answer::new(text, json!(values))
}

/// The job in a folder.
struct Job {
    root: PathBuf,
    tables: Vec<Reproduction>,
    weights: Vec<Lpips>,
    jobs: Jobs,
}

impl Job {
    fn run(self, global: &Global) -> Result<Answer, Failure> {
        let (mut all, mut names) = (Vec::new(), Vec::new());
        for table in &self.tables {
            names.extend(table.scenes.iter().map(|s| format!("{} / {}", table.table.full_name(), s.name())));
            all.extend(contests(table, global)?);
        }
        if let Some(list) = self.jobs.plan(&all, global)? {
            return Ok(list);
        }
        self.jobs.check_results(&self.root, &FILES)?;
        for table in &self.tables {
            self.jobs.check_results(&table.conditions.root, &files(&table.table))?;
        }
        let mut results = self.jobs.all_results(&all, &names, global)?.into_iter();
        let (mut outcomes, mut missing, mut stands) = (Vec::new(), Vec::new(), false);
        for table in &self.tables {
            let results: Vec<Results> = results.by_ref().take(table.scenes.len()).collect();
            outcomes.push(outcome(table, &results, &self.weights, global)?);
            let own_stands = !results.iter().all(Results::none_stands);
            let own: Vec<TrialError> = results.into_iter().flat_map(|r| r.missing).collect();
            if let Some(outcome) = outcomes.last().filter(|_| own_stands) {
                write_page(table, outcome, &with_missing(json!(outcome), &own))?;
            }
            stands |= own_stands;
            let named = |m: TrialError| TrialError { trial: format!("{} / {}", table.table.full_name(), m.trial), ..m };
            missing.extend(own.into_iter().map(named));
        }
        let mut answer = answer(&outcomes, &missing);
        if stands {
            write(&self.root, &mut answer)?;
        }
        self.jobs.judge(answer, missing, global)
    }
}

/// What the outcomes say, as the page and as JSON.
fn answer(outcomes: &[Outcome], missing: &[TrialError]) -> Answer {
    let sentences: Vec<Value> = outcomes.iter().map(|o| json!({"table": o.table, "sentence": sentence(o)})).collect();
    Answer::new(markdown(outcomes), with_missing(json!({"sentences": sentences, "tables": outcomes}), missing))
}

/// Writes the files of the job, and says so.
fn write(root: &Path, answer: &mut Answer) -> Result<(), Failure> {
    for ((name, _), content) in FILES.iter().zip([format!("{:#}\n", answer.json), answer.text.clone()]) {
        write_file(&root.join(name), true, |out| out.write_all(content.as_bytes()))?;
    }
    answer.text.push_str(&format!("\n-> {}\n", root.join(FILES[1].0).display()));
    Ok(())
}
