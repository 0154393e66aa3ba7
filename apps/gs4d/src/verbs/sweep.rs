//! `gs4d sweep`: one setting at a time varied around a preset.

use super::contest::{Trials, failure, follow};
use super::train::time_text;
use crate::answer::Answer;
use crate::failure::Failure;
use crate::global::Global;
use gs_core::io::write_file;
use gs4d_lab::aligned;
use gs4d_lab::contest::{Contest, Entry};
use gs4d_lab::sweep::page::page;
use gs4d_lab::sweep::{Row, Vary, csv, sweep};
use serde_json::json;
use std::path::{Path, PathBuf};

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

impl SweepVerb {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let length = self.trials.length();
        let Self { data, method, preset, vary, trials: Trials { seeds, sets, out: root, .. } } = self;
        let title = format!("{method}, preset {preset}");
        let (registry, base) = (gs_methods::registry().clone(), Entry::new(&method));
        let contest = Contest { registry, data, root: root.clone(), preset, entries: Vec::new(), seeds, length, sets };
        let rows = follow(global, |stop, on_event| sweep(&contest, &base, &vary, stop, on_event))?.map_err(failure)?;
        let json = json!({"title": title, "rows": rows});
        let html = page(&title, &rows).map_err(|e| Failure::from(gs4d_run::RunError::from(e)))?;
        for (name, content) in [("sweep.json", format!("{json:#}\n")), ("sweep.csv", csv(&rows)), ("sweep.html", html)]
        {
            write_file(&root.join(name), true, |out| out.write_all(content.as_bytes()))?;
        }
        Ok(Answer::new(table(&rows, &root), json))
    }
}

fn table(rows: &[Row], root: &Path) -> String {
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
    text.push_str(&format!("-> {}\n", root.join("sweep.html").display()));
    text
}
