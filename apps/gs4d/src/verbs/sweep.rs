//! `gs4d sweep`: one setting at a time varied around a preset.

use super::contest::{failure, follow};
use super::train::time_text;
use crate::answer::Answer;
use crate::failure::Failure;
use crate::{Global, parse};
use gs_train::contest::Length;
use gs_train::report::sweep::page;
use gs_train::sweep::{Row, Sweep, Vary, csv};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Vary settings one at a time around a preset: table, CSV and a chart of quality against bytes
#[derive(clap::Args)]
pub struct SweepVerb {
    /// Folder of the data.
    #[arg(value_name = "DATA")]
    data: PathBuf,
    /// The method.
    #[arg(short, long)]
    method: String,
    /// The preset everything is varied around.
    #[arg(long, default_value = "fast")]
    preset: String,
    /// A setting and its values (repeatable), for example "init.points=1000|2000|4000".
    #[arg(long, value_name = "KEY=A|B|C", required = true, value_parser = Vary::parse)]
    vary: Vec<Vary>,
    /// Seeds; every setting runs once with each.
    #[arg(long, value_delimiter = ',', default_value = "0")]
    seeds: Vec<u64>,
    /// Training time of every trial: recipes are stretched or compressed to fill it.
    #[arg(long, value_name = "TIME", value_parser = parse::duration, conflicts_with = "steps")]
    time_budget: Option<Duration>,
    /// Steps of every trial.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    steps: Option<u32>,
    /// A setting of all trials (repeatable).
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// Folder of the trials and of sweep.json, sweep.csv and sweep.html; trials that stand in it are not made again.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
}

impl SweepVerb {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let length = Length::of(self.time_budget, self.steps);
        let Self { data, method, preset, vary, seeds, sets, out: root, .. } = self;
        let title = format!("{method}, preset {preset}");
        let sweep = Sweep { data, root: root.clone(), method, preset, vary, seeds, length, sets };
        let rows = follow(global, |stop, tell| sweep.run(stop, tell))?.map_err(failure)?;
        let json = json!({"title": title, "rows": rows});
        let html = page(&title, &rows).map_err(|e| Failure::from(gs_train::run::RunError::from(e)))?;
        for (name, content) in [("sweep.json", format!("{json:#}\n")), ("sweep.csv", csv(&rows)), ("sweep.html", html)]
        {
            let path = root.join(name);
            std::fs::write(&path, content).map_err(|e| Failure::io("write", &path, &e))?;
        }
        Ok(Answer::new(table(&rows, &root), json))
    }
}

fn table(rows: &[Row], root: &Path) -> String {
    let width = rows.iter().map(|r| r.label().len()).max().unwrap_or(0).max(7);
    let number = |v: Option<f64>, digits: usize| v.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
    let mut text = format!("{:width$}", "setting");
    for name in ["psnr", "ssim", "proxy", "MB", "seconds", "splats", "steps"] {
        text.push_str(&format!("  {name:>9}"));
    }
    text.push('\n');
    for r in rows {
        let cells = [
            number(r.psnr, 2),
            number(r.ssim, 4),
            number(r.proxy, 4),
            number(r.megabytes, 3),
            number(r.seconds, 1),
            number(r.splats, 0),
            r.steps.to_string(),
        ];
        text.push_str(&format!("{:width$}", r.label()));
        cells.iter().for_each(|c| text.push_str(&format!("  {c:>9}")));
        text.push_str(if r.preset && r.key.is_some() { "  the preset's\n" } else { "\n" });
    }
    let trained = rows.iter().filter(|r| r.key.is_none() || !r.preset);
    let seconds: f64 = trained.filter_map(|r| Some(r.seconds? * r.runs.len() as f64)).sum();
    text.push_str(&format!("means over seeds; proxy is not LPIPS; {} of training\n", time_text(seconds)));
    text.push_str(&format!("-> {}\n", root.join("sweep.html").display()));
    text
}
