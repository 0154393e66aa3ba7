//! `gs4d compare settings`: one setting at a time varied around a preset.

use super::contest::Trials;
use super::jobs::{ResultFile, check_seeds, failure, with_missing};
use super::train::time_text;
use crate::answer::Answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::output::create_folder;
use gs_core::io::write_file;
use gs4d_lab::aligned;
use gs4d_lab::contest::{Contest, Entry, Results};
use gs4d_lab::sweep::page::{SUBTITLE, page};
use gs4d_lab::sweep::{Row, Sweep, Vary, csv};
use serde_json::json;
use std::path::PathBuf;

/// Vary settings one at a time around a preset: table, CSV and a chart of quality against bytes
#[derive(clap::Args)]
pub struct SweepVerb {
    /// Folder of the data.
    #[arg(value_name = "DATA")]
    data: PathBuf,
    /// The method.
    #[arg(short, long)]
    method: String,
    /// The preset that settings are varied around.
    #[arg(long, default_value = "fast")]
    preset: String,
    /// A setting and its values (repeatable), for example "init.points=1000|2000|4000".
    #[arg(long, value_name = "KEY=A|B|C", required = true, value_parser = Vary::parse)]
    vary: Vec<Vary>,
    #[command(flatten)]
    trials: Trials,
}

/// The files of results.
const FILES: [ResultFile; 3] = [("sweep.json", "\"rows\""), ("sweep.csv", "setting,psnr"), ("sweep.html", SUBTITLE)];

impl SweepVerb {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        check_seeds(&self.trials.seeds)?;
        let length = self.trials.length();
        let Self { data, method, preset, vary, trials: Trials { seeds, sets, out: root, jobs, .. } } = self;
        let title = format!("{method}, preset {preset}");
        let (registry, base) = (gs_methods::registry().clone(), Entry::new(&method));
        let contest = Contest { registry, data, root: root.clone(), preset, entries: Vec::new(), seeds, length, sets };
        let sweep = Sweep::new(contest, &base, &vary).map_err(failure)?;
        if let Some(list) = jobs.plan(std::slice::from_ref(&sweep.contest), global)? {
            return Ok(list);
        }
        jobs.check_results(&root, &FILES)?;
        let results = jobs.results(&sweep.contest, global)?;
        let none_stands = results.none_stands();
        let Results { standings, missing } = results;
        let rows = sweep.rows(&standings);
        let json = with_missing(json!({"title": title, "rows": rows}), &missing);
        let mut text = String::new();
        if !none_stands {
            text.push_str(&table(&rows));
            let html = page(&title, &rows).map_err(|e| Failure::from(gs4d_run::RunError::from(e)))?;
            create_folder(&root)?;
            for ((name, _), content) in FILES.iter().zip([format!("{json:#}\n"), csv(&rows), html]) {
                write_file(&root.join(name), true, |out| out.write_all(content.as_bytes()))?;
            }
            text.push_str(&format!("-> {}\n", root.join("sweep.html").display()));
        }
        jobs.judge(Answer::new(text, json), missing, global)
    }
}

fn table(rows: &[Row]) -> String {
    let (mut head, mut cells) = Row::table(rows, "-");
    head.push("");
    for (cells, row) in cells.iter_mut().zip(rows) {
        cells.push(if row.repeats_preset() { "the preset's" } else { "" }.to_owned());
    }
    let last = head.len() - 1;
    let mut text = aligned(&head, &cells, |column| column == 0 || column == last);
    let trained = rows.iter().filter(|r| !r.repeats_preset());
    let seconds: f64 = trained.filter_map(|r| Some(r.seconds? * r.runs.len() as f64)).sum();
    text.push_str(&format!("means over seeds; proxy is not LPIPS; {} of training\n", time_text(seconds)));
    text
}
