//! `gs4d doctor`: checks a data set before training.

use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::output::create_folder;
use gs_core::io::{IoError, folder_of, write_file};
use gs_data::DataOptions;
use gs4d_doctor::{
    CheckOptions, Checkup, CostOptions, Finding, Outlines, Verdict, apply, examine_and_tell, is_page, page,
};
use gs4d_run::settings::{Request, assigns, resolve};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Rounds of settings that are written and checked again.
const MAX_FIXES: usize = 4;

/// Check a data set: layout, images, times, poses, points, box, memory and time; say what is wrong and how to fix it
#[derive(clap::Args)]
pub struct Doctor {
    /// The folder.
    #[arg(value_name = "DATA")]
    data: PathBuf,
    /// Read it with this layout [default: the one that fits].
    #[arg(long)]
    layout: Option<String>,
    /// A setting of the data, for example data.scale=0.5, or of the run that is tried (repeatable).
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// The method whose memory and time are estimated.
    #[arg(short, long, default_value = "fourdgs")]
    method: String,
    /// Its preset.
    #[arg(long, default_value = "fast")]
    preset: String,
    /// Read every image; else of more than 300 a sample, spread evenly over cameras and times.
    #[arg(long)]
    all: bool,
    /// Estimate neither memory nor time.
    #[arg(long)]
    no_cost: bool,
    /// The page with images [default: doctor.html, which is left out where it cannot be written].
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Write the settings that findings come with into scene.toml of the folder, and check again.
    #[arg(long)]
    fix: bool,
    /// Overwrite a file in its place that is no page of the doctor.
    #[arg(short, long)]
    force: bool,
    /// Exit with 7 on warnings as well.
    #[arg(long)]
    strict: bool,
}

impl Doctor {
    /// The check-up of a folder with these settings, as it is without other flags, but for the cost of a run, with its page.
    pub fn of(data: PathBuf, out: PathBuf, sets: Vec<String>) -> Self {
        Self {
            data,
            layout: None,
            sets,
            method: "fourdgs".to_owned(),
            preset: "fast".to_owned(),
            all: false,
            no_cost: true,
            out: Some(out),
            fix: false,
            force: false,
            strict: false,
        }
    }

    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        match self.look(global)? {
            (answer, None) => Ok(answer),
            (answer, Some(problems)) => {
                answer.print(global.json)?;
                Err(problems)
            }
        }
    }

    /// What was found, and the failure if there are problems, or warnings with `--strict`.
    pub fn look(self, global: &Global) -> Result<(Answer, Option<Failure>), Failure> {
        self.check_page()?;
        self.check_fix()?;
        let mut checkup = self.examine(global)?;
        let mut written = Vec::new();
        while self.fix && written.len() < MAX_FIXES {
            let now = apply(&self.data, &checkup.findings)?;
            if now.is_empty() {
                break;
            }
            global.say(format!("wrote {} into scene.toml; checking again", now.join(" and ")));
            written.extend(now);
            checkup = self.examine(global)?;
        }
        let html = page(&checkup).map_err(|e| Failure::new(Class::Internal, "report", e.to_string()))?;
        let path = self.page();
        let saved = write_file(path, true, |out| out.write_all(html.as_bytes()));
        let place = path.display().to_string();
        let page = saved.is_ok().then_some(place.as_str());
        let json = json!({"checkup": checkup, "page": page, "written": written});
        let answer = Answer::new(text(&checkup, page, &written), json);
        match saved {
            // What was found is told all the same.
            Err(e) if self.out.is_some() => {
                answer.print(global.json)?;
                return Err(e.into());
            }
            Err(e) => global.say(format!("the page was left out: {e}; -o FILE writes it elsewhere")),
            Ok(()) => {}
        }
        Ok((answer, self.judge(&checkup)))
    }

    /// Where the page belongs.
    fn page(&self) -> &Path {
        self.out.as_deref().unwrap_or(Path::new("doctor.html"))
    }

    fn examine(&self, global: &Global) -> Result<Checkup, Failure> {
        let cost = CostOptions {
            registry: gs_methods::registry().clone(),
            method: self.method.clone(),
            preset: self.preset.clone(),
            sets: self.sets.clone(),
            limit_mib: global.max_mem.map(|mib| mib as f64),
        };
        let exam = CheckOptions { data: self.data_options()?, all: self.all, cost: (!self.no_cost).then_some(cost) };
        Ok(examine_and_tell(&self.data, &exam, &mut |finding| {
            if !global.json {
                global.say(outcome(finding));
            }
        }))
    }

    /// Refuses, before anything is checked, to write over a file that is no page of the doctor; creates the folder that was asked for.
    fn check_page(&self) -> Result<(), Failure> {
        let path = self.page();
        if !self.force && path.exists() && !is_page(path) {
            return Err(IoError::Exists { file: path.display().to_string().into() }.into());
        }
        self.out.as_deref().map_or(Ok(()), |out| create_folder(folder_of(out)))
    }

    /// Refuses to write what a flag overrides: the next check would find it again, and add to it.
    fn check_fix(&self) -> Result<(), Failure> {
        let times = ["data.time_shift", "data.time_range"];
        let set = |key: &&str| self.sets.iter().any(|s| assigns(s, key));
        match times.iter().find(|key| self.fix && set(key)) {
            Some(key) => {
                Err(Failure::usage(format!("--fix writes times into scene.toml, and --set {key} overrides them"))
                    .remedy("leave the --set out, or write it into [time] of scene.toml first"))
            }
            None => Ok(()),
        }
    }

    fn data_options(&self) -> Result<DataOptions, Failure> {
        let (method, preset, sets) = (self.method.clone(), self.preset.clone(), self.sets.clone());
        let data = resolve(gs_methods::registry(), &Request { method, preset, sets, ..Request::default() })?.data;
        Ok(DataOptions { layout: self.layout.clone().or(data.layout.clone()), ..data })
    }

    /// The failure if there are problems, or warnings with `--strict`.
    fn judge(&self, checkup: &Checkup) -> Option<Failure> {
        let [problems, warnings] = [Verdict::Problem, Verdict::Warning].map(|v| checkup.count(v));
        let failed = |class, id, what: String| {
            Failure::new(class, id, what).place(self.data.display()).remedy("see what to do behind each finding")
        };
        if problems > 0 {
            return Some(failed(Class::Data, "doctor.problems", checkup.summary()));
        }
        let strict = self.strict && warnings > 0;
        strict.then(|| {
            let what = format!("{}, and --strict was asked for", checkup.summary());
            failed(Class::Verification, "doctor.strict", what)
        })
    }
}

/// Findings as lines of a table, then the outlines of a filmed person.
fn text(c: &Checkup, page: Option<&str>, written: &[String]) -> String {
    let mut out = String::new();
    for f in &c.findings {
        out.push_str(&line(f));
    }
    out.push_str(&c.outlines.as_ref().map_or(String::new(), Outlines::text));
    if !written.is_empty() {
        out.push_str(&format!("wrote {} into {}\n", written.join(" and "), c.root.join("scene.toml").display()));
    }
    let settings = c.findings.iter().filter(|f| f.setting.is_some()).count();
    if settings > 0 {
        out.push_str(&format!("gs4d doctor {} --fix writes what is to be set into scene.toml\n", c.root.display()));
    }
    out + &format!("{}{}\n", c.summary(), page.map_or(String::new(), |p| format!(" - see {p}")))
}

/// Topic, sentence and verdict of a finding.
fn outcome(f: &Finding) -> String {
    let word = match f.verdict {
        Verdict::Ok => "ok".to_owned(),
        Verdict::Note => "note".to_owned(),
        Verdict::Warning => format!("warning[{}]", f.code),
        Verdict::Problem => format!("problem[{}]", f.code),
    };
    format!("{:<9} {}  {word}", f.topic, f.what)
}

fn line(f: &Finding) -> String {
    let mut out = outcome(f) + "\n";
    if !f.places.is_empty() {
        out.push_str(&format!("{:<9}   in   {}\n", "", f.places.join(", ")));
    }
    if let Some(fix) = &f.fix {
        out.push_str(&format!("{:<9}   do   {fix}\n", ""));
    }
    out
}
