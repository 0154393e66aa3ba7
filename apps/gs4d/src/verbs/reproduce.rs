//! `gs4d reproduce`: the tables of the papers, run here.

mod nightly;

use super::eval::{RangeName, read_lpips};
use super::jobs::{Jobs, check_seeds, with_missing};
use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::output::create_folder;
use crate::parse;
use gs_core::io::write_file;
use gs4d_eval::folders::Lpips;
use gs4d_lab::aligned;
use gs4d_lab::contest::{Contest, Length, Results};
use gs4d_reproduce::documents::Listed;
use gs4d_reproduce::{
    Beside, Conditions, DataSet, Generated, Outcome, ReproduceError, Reproduction, Scene, Table, TableError, documents,
    page,
};
use gs4d_run::shell_quoted;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Run a table of one of the papers, published figures beside; without a table, list them
#[derive(clap::Args)]
pub struct ReproduceVerb {
    /// fags, modec, trace or dut; or nightly: the papers' orders on few generated scenes, small enough for a night.
    paper: Option<String>,
    /// Name of the table; without -o it is shown, not run. Of nightly PAPER-TABLE [default: all of it].
    #[arg(requires = "paper")]
    table: Option<String>,
    /// A folder that holds the papers' data sets (repeatable). Where no scene of a table is there, generated ones are run.
    #[arg(long, value_name = "DIR")]
    data: Vec<PathBuf>,
    /// Scenes, of the paper or generated [default: those that are there].
    #[arg(long, value_delimiter = ',', value_name = "NAME")]
    scenes: Vec<String>,
    /// Entries, by their names in the table; the others are compared with the first [default: all].
    #[arg(long, value_delimiter = ',', value_name = "NAME")]
    entries: Vec<String>,
    /// Seeds; everything runs once with each [default: 0,1,2; nightly: 0,1,2,3,4].
    #[arg(long, value_delimiter = ',')]
    seeds: Vec<u64>,
    /// Preset of all entries: fast (minutes), or published for the settings of each entry in its paper (days on a CPU), which gs4d train calls paper.
    #[arg(long, default_value = "fast")]
    preset: String,
    /// Steps of every trial.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    steps: Option<u32>,
    /// Training time of every trial: schedules are stretched or compressed to fill it, and so run to their end.
    #[arg(long, value_name = "TIME", value_parser = parse::duration, conflicts_with = "steps")]
    time_budget: Option<Duration>,
    /// Factor of the images' size, in place of that of the table (0..1].
    #[arg(long)]
    scale: Option<f64>,
    /// A setting of all trials (repeatable).
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// Adds columns of LPIPS with the weights of this safetensors file (see gs4d eval); repeatable, one for each network. The table says which network
    /// and which range of colours a column has.
    #[arg(long, value_name = "FILE")]
    lpips: Vec<PathBuf>,
    /// Folder of generated scenes, trials and results; finished trials in it are not trained again.
    #[arg(short, long, value_name = "DIR", requires = "paper")]
    out: Option<PathBuf>,
    #[command(flatten)]
    jobs: Jobs,
    /// Run nothing: say which tables of the documents in this repository of gs4d name a preset that has changed since they were measured.
    #[arg(long, value_name = "REPOSITORY", conflicts_with_all = ["paper", "out"])]
    check: Option<PathBuf>,
}

/// The files of a table's results, each with words that it holds.
fn files(table: &Table) -> [(String, &'static str); 2] {
    let name = table.full_name();
    [(format!("{name}.json"), "\"protocol\""), (format!("{name}.html"), "less published: the first column")]
}

impl ReproduceVerb {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        if let Some(root) = &self.check {
            return check(root, global);
        }
        if self.paper.as_deref() == Some(nightly::NAME) {
            return nightly::run(self, global);
        }
        let (Some(paper), Some(name)) = (&self.paper, &self.table) else {
            if self.out.is_some() {
                return Err(Failure::usage("no table to run").remedy("name one; gs4d reproduce lists them"));
            }
            return list(self.paper.as_deref(), &self.data);
        };
        let table = Table::find(paper, name).map_err(unknown)?;
        let Some(root) = self.out.clone() else {
            check_seeds(&self.seeds)?;
            return shown(&table, &self.data);
        };
        let reproduction = Reproduction::new(table, self.conditions(root, &[0, 1, 2])?).map_err(failure)?;
        reproduce(&reproduction, &weights(&self.lpips)?, &self.jobs, global)
    }

    /// The conditions that were asked for, in a folder, with these seeds where none was.
    fn conditions(&self, root: PathBuf, seeds: &[u64]) -> Result<Conditions, Failure> {
        check_seeds(&self.seeds)?;
        Ok(Conditions {
            data: self.data.clone(),
            scenes: self.scenes.clone(),
            entries: self.entries.clone(),
            seeds: if self.seeds.is_empty() { seeds.to_vec() } else { self.seeds.clone() },
            preset: (self.preset != "published").then(|| self.preset.clone()),
            length: Length::of(self.time_budget, self.steps),
            scale: self.scale,
            sets: self.sets.clone(),
            root,
        })
    }
}

/// Weights of LPIPS, of each network once.
fn weights(files: &[PathBuf]) -> Result<Vec<Lpips>, Failure> {
    let mut all: Vec<Lpips> = Vec::new();
    for file in files {
        // The range is that of the column.
        let lpips = read_lpips(file, RangeName::Signed)?;
        if all.iter().any(|known| known.net() == lpips.net()) {
            return Err(Failure::usage("two files of --lpips are of the same network")
                .place(file.display())
                .remedy("give one file for each network"));
        }
        all.push(lpips);
    }
    Ok(all)
}

fn reproduce(reproduction: &Reproduction, weights: &[Lpips], jobs: &Jobs, global: &Global) -> Result<Answer, Failure> {
    let root = &reproduction.conditions.root;
    let contests = contests(reproduction, global)?;
    if let Some(list) = jobs.plan(&contests, global)? {
        return Ok(list);
    }
    let files = files(&reproduction.table);
    jobs.check_results(root, &files)?;
    let results: Vec<Results> = contests.iter().map(|c| jobs.results(c, global)).collect::<Result<_, _>>()?;
    let outcome = outcome(reproduction, &results, weights, global)?;
    let none_stands = results.iter().all(Results::none_stands);
    let missing: Vec<_> = results.into_iter().flat_map(|r| r.missing).collect();
    let json = with_missing(json!(outcome), &missing);
    let mut text = String::new();
    if !none_stands {
        text.push_str(&page::text(&outcome));
        write_page(reproduction, &outcome, &json)?;
        text.push_str(&format!("-> {}\n", root.join(&files[1].0).display()));
    }
    jobs.judge(Answer::new(text, json), missing, global)
}

/// Writes the generated scenes of a table; its contests.
fn contests(reproduction: &Reproduction, global: &Global) -> Result<Vec<Contest>, Failure> {
    create_folder(&reproduction.conditions.root.join("data"))?;
    for other in reproduction.prepare().map_err(gs4d_run::RunError::from)? {
        let folder = other.display();
        global.say(format!(
            "warning: {folder} is not the scene that this version generates: its trials are of what is there"
        ));
    }
    reproduction.contests(gs_methods::registry()).map_err(unknown)
}

/// Our figures of a table beside the published ones, with the scores that training does not give.
fn outcome(
    reproduction: &Reproduction,
    results: &[Results],
    weights: &[Lpips],
    global: &Global,
) -> Result<Outcome, Failure> {
    let mut say = |run: &Path| global.say(format!("LPIPS and tOF of {}", run.display()));
    let beside = Beside::measure(reproduction, results, gs_methods::registry(), weights, &mut say)?;
    Ok(reproduction.outcome(results, &beside))
}

/// Writes the page of a table into its folder.
fn write_page(reproduction: &Reproduction, outcome: &Outcome, json: &Value) -> Result<(), Failure> {
    for ((name, _), content) in files(&reproduction.table).iter().zip([format!("{json:#}\n"), page::html(outcome)]) {
        let path = reproduction.conditions.root.join(name);
        write_file(&path, true, |out| out.write_all(content.as_bytes()))?;
    }
    Ok(())
}

/// The tables, with the number of their scenes that are there.
fn list(paper: Option<&str>, roots: &[PathBuf]) -> Result<Answer, Failure> {
    let all = Table::all().map_err(unknown)?;
    if let Some(wrong) = paper.filter(|p| !all.iter().any(|t| t.paper == *p)) {
        return Err(Failure::usage(format!("there is no paper `{wrong}`")).remedy("choose fags, modec, trace or dut"));
    }
    let sets = DataSet::all().map_err(unknown)?;
    let (mut rows, mut values) = (Vec::new(), Vec::new());
    for table in all.iter().filter(|t| paper.is_none_or(|p| t.paper == p)) {
        let set = table.data.as_ref().and_then(|d| sets.get(d));
        let here = set.map_or(0, |set| table.scenes.iter().filter(|s| set.folder(s, roots).is_ok()).count());
        let number = set.map(|_| match table.scenes.len() {
            0 => "generated ones alone".to_owned(),
            n => format!("{here} of {n}"),
        });
        let scenes = number.into_iter().chain(table.command.clone()).collect::<Vec<_>>().join(": ");
        rows.push(vec![table.paper.clone(), table.name.clone(), table.title.clone(), table.source.clone(), scenes]);
        values.push(json!({"paper": table.paper, "table": table.name, "title": table.title, "source": table.source,
            "data": set, "scenes": table.scenes.len(), "here": here, "command": table.command}));
    }
    let head = ["paper", "table", "shows", "printed in", "scenes here"];
    let text = aligned(&head, &rows, |_| true)
        + "\nshow one: gs4d reproduce PAPER TABLE; run it: -o DIR, with --data DIR where its scenes are\n\
           the papers' orders on few generated scenes: gs4d reproduce nightly\n";
    Ok(Answer::new(text, json!(values)))
}

/// A table that is not run: its published figures, its data.
fn shown(table: &Table, roots: &[PathBuf]) -> Result<Answer, Failure> {
    let mut text = page::published(table);
    let set = table.data.as_deref().map(DataSet::find).transpose().map_err(unknown)?;
    let mut scenes: Vec<Value> = Vec::new();
    if let Some(set) = &set {
        text.push_str(&format!("\n{}\nfrom {}; licence: {}\n{}\n", set.title, set.from, set.licence, set.layout));
        for scene in &table.scenes {
            let folder = set.folder(scene, roots).map(|f| f.display().to_string()).map_err(|e| e.to_string());
            let (Ok(said) | Err(said)) = &folder;
            text.push_str(&format!("{:18} {said}\n", scene.name));
            let check = folder.as_ref().ok().map(|folder| doctor(table, scene, folder));
            check.iter().for_each(|command| text.push_str(&format!("{:18} check it: {command}\n", "")));
            scenes.push(json!({"scene": scene.name, "folder": folder.as_ref().ok(), "absent": folder.as_ref().err(),
                "check": check}));
        }
        let names: Vec<&str> = set.generated.iter().map(Generated::name).collect();
        text.push_str(&format!("generated scenes that stand in: {}\n", names.join(", ")));
        if table.command.is_none() {
            text.push_str("run the table: -o DIR\n");
        }
    }
    Ok(Answer::new(text, json!({"table": table.full_name(), "source": table.source, "data": set, "scenes": scenes})))
}

/// The check of the folder of a scene, with the table's settings of data.
fn doctor(table: &Table, scene: &Scene, folder: &str) -> String {
    let sets = table.sets.iter().chain(&scene.sets).filter(|set| set.starts_with("data."));
    let sets: String = sets.map(|set| format!(" --set {}", shell_quoted(set.clone()))).collect();
    format!("gs4d doctor {}{sets}", shell_quoted(folder.to_owned()))
}

/// Which tables of a repository's documents are older than the preset they name.
fn check(root: &Path, global: &Global) -> Result<Answer, Failure> {
    let checked = documents::check(root, gs_methods::registry()).map_err(|e| {
        Failure::new(Class::Data, "data.documents", e.to_string())
            .remedy("pass the repository of gs4d, the folder of README.md and docs")
    })?;
    let number = checked.findings.len();
    let mut text: String = checked.findings.iter().map(|f| format!("{f}\n")).collect();
    let old = checked.tables.iter().filter(|(listed, _)| !listed.older_than.is_empty());
    old.clone().for_each(|(listed, _)| text.push_str(&known_old(listed)));
    let (tables, old) = (checked.tables.len(), old.count());
    text.push_str(&format!(
        "{tables} tables of figures, {old} of them older than a preset as their documents say; {number} findings\n"
    ));
    let answer = Answer::new(text, json!(checked));
    if number == 0 {
        return Ok(answer);
    }
    answer.print(global.json)?;
    Err(Failure::new(Class::Verification, "documents", format!("tables of figures with findings: {number}")).remedy(
        "measure the table again and keep the preset (gs4d config METHOD --preset PRESET > docs/presets/METHOD-PRESET.toml), delete it, or complete \
         its entry in docs/tables.toml",
    ))
}

/// A table that its document says to be older than a preset.
fn known_old(listed: &Listed) -> String {
    let Listed { file, head, commit, older_than, .. } = listed;
    format!("{file}: {head}: of {}, older than {}\n", commit.as_deref().unwrap_or_default(), older_than.join(", "))
}

fn unknown(e: TableError) -> Failure {
    match e {
        TableError::Unknown { .. } => Failure::usage(e.to_string()).remedy("gs4d reproduce lists them"),
        TableError::Wrong { .. } => Failure::new(Class::Internal, "internal", e.to_string()),
    }
}

fn failure(e: ReproduceError) -> Failure {
    let text = e.to_string();
    match e {
        ReproduceError::Table(e) => unknown(e),
        ReproduceError::Command(command) => Failure::usage(text).remedy(command),
        ReproduceError::Twice { .. } => Failure::usage(text).remedy("name each scene once in --scenes"),
        ReproduceError::UnknownScene { .. } => Failure::usage(text).remedy("choose one of these with --scenes"),
        ReproduceError::UnknownEntry { .. } => Failure::usage(text).remedy("choose one of these with --entries"),
        ReproduceError::AbsentScene { .. } => {
            Failure::new(Class::Data, "data.absent", text).remedy("pass its folder, or the one above, with --data")
        }
        ReproduceError::Data(e) => gs4d_run::RunError::from(e).into(),
    }
}
