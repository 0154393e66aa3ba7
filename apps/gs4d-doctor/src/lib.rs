//! What is right and what is wrong with a data set, before hours are spent on it.
//!
//! [`examine`] opens a folder as training would, looks at every part of it and gives a [`Checkup`]: one [`Finding`] per thing
//! that was looked at, with what it means and a command or an edit that mends it. A fault that stops the reader is found and,
//! where there is a way around it, passed, so that one look finds more than the first fault.
//!
//! | module | looks at |
//! |---|---|
//! | `images` | files: readable, blank, twice there, exposure, sharpness, alpha, masks |
//! | `clock` | times: source, gaps, two pictures of a camera at once, cameras that run late |
//! | `poses` | cameras: corners of photographs against the poses, and against what poses are often mistaken for |
//! | `silhouettes` | cameras again: what alpha or masks carve must fill them |
//! | `start` | points to begin with and the box |
//! | `cost` | memory and time of a training run, from a few steps of it |

mod clock;
mod cost;
mod features;
mod images;
mod page;
mod pictures;
mod poses;
mod silhouettes;
mod start;
mod suspects;

pub use cost::{Cost, CostOptions, StageCost};
pub use page::page;

use gs_core::Image;
use gs_data::{Confidence, DataError, DataOptions, Dataset, ImageCache, LAYOUTS, TimeRange, detect};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Names listed in a finding, at most.
const NAMED: usize = 12;
/// Faults of the reader that are passed, at most.
const PASSES: usize = 6;

/// How a thing was found to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// As it should be.
    Ok,
    /// Worth knowing.
    Note,
    /// Likely to cost quality, or assumed.
    Warning,
    /// Training would fail or learn something wrong.
    Problem,
}

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// `layout`, `images`, `masks`, `time`, `split`, `poses`, `init`, `bound`, `memory`, `duration`.
    pub topic: &'static str,
    /// Stable name of the finding: `images.blank`, or the code of the reader's error.
    pub code: &'static str,
    /// How it is.
    pub verdict: Verdict,
    /// What was found.
    pub what: String,
    /// Files, views or fields, the first few.
    pub places: Vec<String>,
    /// A command or an edit.
    pub fix: Option<String>,
}

impl Finding {
    fn new(topic: &'static str, code: &'static str, verdict: Verdict, what: impl Into<String>) -> Self {
        Self { topic, code, verdict, what: what.into(), places: Vec::new(), fix: None }
    }

    fn ok(topic: &'static str, what: impl Into<String>) -> Self {
        Self::new(topic, "ok", Verdict::Ok, what)
    }

    fn at<T: Into<String>>(mut self, places: impl IntoIterator<Item = T>) -> Self {
        let all: Vec<String> = places.into_iter().map(Into::into).collect();
        let more = all.len().saturating_sub(NAMED);
        self.places = all.into_iter().take(NAMED).collect();
        if more > 0 {
            self.places.push(format!("and {more} more"));
        }
        self
    }

    fn fix(mut self, fix: impl Into<String>) -> Self {
        self.fix = Some(fix.into());
        self
    }
}

/// A picture that shows what a finding says.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// The topic it belongs to.
    pub topic: &'static str,
    /// What is to be seen.
    pub caption: String,
    /// 3 channels.
    pub image: Image,
}

/// All findings about a folder.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Checkup {
    /// The folder.
    pub root: PathBuf,
    /// The layout it was read with.
    pub layout: Option<&'static str>,
    /// Findings in the order of the topics.
    pub findings: Vec<Finding>,
    /// What the reader assumed.
    pub notes: Vec<String>,
    /// What training would cost, where it was tried.
    pub cost: Option<Cost>,
    /// What is to be seen.
    #[serde(skip)]
    pub pictures: Vec<Picture>,
}

impl Checkup {
    /// How many findings are of a kind.
    pub fn count(&self, verdict: Verdict) -> usize {
        self.findings.iter().filter(|f| f.verdict == verdict).count()
    }

    /// Problems and warnings in words.
    pub fn summary(&self) -> String {
        let of = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
        format!("{}, {}", of(self.count(Verdict::Problem), "problem"), of(self.count(Verdict::Warning), "warning"))
    }

    fn add(&mut self, findings: impl IntoIterator<Item = Finding>) {
        self.findings.extend(findings);
    }
}

/// What is to be looked at.
#[derive(Clone, Debug, Default)]
pub struct Exam {
    /// How the folder is to be read.
    pub data: DataOptions,
    /// What a run would be tried with; none: no run is tried.
    pub cost: Option<CostOptions>,
}

/// Looks at a folder.
pub fn examine(dir: &Path, exam: &Exam) -> Checkup {
    let mut checkup = Checkup { root: dir.to_path_buf(), ..Checkup::default() };
    let Some((data, options)) = open(dir, &exam.data, &mut checkup) else { return checkup };
    checkup.layout = Some(data.layout);
    checkup.notes.clone_from(&data.notes);
    let photographs = ImageCache::new(256 << 20, 1.0).with_max_image_mib(options.max_image_mib);
    let looked = images::look(&data, &photographs);
    checkup.add(looked.findings(&data));
    checkup.add(clock::look(&data, &looked));
    let readable = looked.readable(&data);
    if readable.train.is_empty() {
        return checkup;
    }
    let eyes = ImageCache::new(256 << 20, looked.small_scale()).with_max_image_mib(options.max_image_mib);
    let silhouettes = silhouettes::look(&readable);
    let (mut findings, mut pictures) = poses::look(&readable, &eyes, silhouettes.as_ref());
    // Under poses of another convention nothing is where it should be.
    if !findings.iter().any(|f| f.code == "poses.convention") {
        findings.extend(start::look(&readable));
    }
    checkup.add(findings);
    pictures.extend(pictures::all(&readable, &eyes, silhouettes.as_ref()));
    checkup.pictures = pictures;
    if let Some(options) = &exam.cost {
        let (findings, cost) = cost::look(&readable, options);
        checkup.add(findings);
        checkup.cost = cost;
    }
    checkup
}

/// Opens a folder, passing faults that can be passed; says which layout was taken and why.
fn open(dir: &Path, wanted: &DataOptions, checkup: &mut Checkup) -> Option<(Dataset, DataOptions)> {
    let mut options = wanted.clone();
    let mut faults: Vec<Finding> = Vec::new();
    let opened = loop {
        match Dataset::open(dir, &options) {
            Ok(data) => break Some(data),
            Err(e) => {
                let next = around(&e, &options);
                faults.push(fault(&e));
                match next.filter(|_| faults.len() < PASSES) {
                    Some(next) => options = next,
                    None => break None,
                }
            }
        }
    };
    checkup.add([layout(dir, wanted, opened.as_ref())].into_iter().flatten());
    checkup.add(faults);
    opened.map(|data| (data, options))
}

/// Options with which a fault of the reader does not stop it, where there are such.
fn around(e: &DataError, options: &DataOptions) -> Option<DataOptions> {
    let next = match e {
        DataError::Missing { .. } => DataOptions { allow_missing: true, ..options.clone() },
        DataError::Time { value, range, .. } => {
            let wide = TimeRange { start: range.start.min(*value), end: range.end.max(*value) };
            DataOptions { time_range: Some(wide), ..options.clone() }
        }
        _ => return None,
    };
    (next != *options).then_some(next)
}

/// An error of the reader as a finding.
fn fault(e: &DataError) -> Finding {
    let topic = match e.code() {
        "data.layout" | "data.path" | "data.syntax" | "data.truncated" | "data.empty" => "layout",
        "data.time" => "time",
        "data.pose" | "data.camera_model" => "poses",
        "data.points" => "init",
        "data.missing" | "data.image" | "data.image_size" | "limits.file" | "data.video" => "images",
        _ => "layout",
    };
    let what = format!("{e} ({})", e.why());
    let finding = Finding::new(topic, e.code(), Verdict::Problem, what).fix(e.fix());
    finding.at(e.place().map(|p| p.to_string()))
}

/// The layout that was taken, and others that might have been.
fn layout(dir: &Path, options: &DataOptions, data: Option<&Dataset>) -> Option<Finding> {
    let name = options.layout.as_deref().or_else(|| detect(dir).map(|l| l.name))?;
    let about = LAYOUTS.iter().find(|l| l.name == name).map_or("", |l| l.about);
    let asked = if options.layout.is_some() { ", as asked for" } else { "" };
    let counts = data.map_or(String::new(), |d| {
        format!(
            ": {} training, {} validation, {} test views, {} beyond the last training time",
            d.train.len(),
            d.val.len(),
            d.test.len(),
            d.extrapolate.len()
        )
    });
    let sure = |l: &&gs_data::Layout| (l.probe)(dir).filter(|_| l.name != name).map(|c| (c, l.name));
    let rivals: Vec<(Confidence, &str)> = LAYOUTS.iter().filter_map(|l| sure(&l)).collect();
    let own = LAYOUTS.iter().find(|l| l.name == name).and_then(|l| (l.probe)(dir));
    // What `nvfi` takes is always of `blender`'s form as well.
    let rival = |r: &&(Confidence, &str)| Some(r.0) == own && !(name == "nvfi" && r.1 == "blender");
    let close = rivals.iter().filter(rival).map(|r| r.1).collect::<Vec<_>>();
    let text = format!("{name}{asked} ({about}){counts}");
    if close.is_empty() || options.layout.is_some() {
        return Some(Finding::ok("layout", text));
    }
    let text = format!("{text}; the files would also do for {}", close.join(", "));
    Some(Finding::new("layout", "layout.ambiguous", Verdict::Note, text).fix(format!("--layout {}", close[0])))
}

/// The middle value; NaN without any.
fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Brightness of a colour as encoded (BT.601).
fn luma(rgb: [f32; 3]) -> f32 {
    0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2]
}
