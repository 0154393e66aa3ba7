//! Checks of a data set before training.
//!
//! [`examine`] opens a folder as training would, runs every check and returns a [`Checkup`]: one [`Finding`] per check, with
//! what it means and a command or an edit that fixes it. A fault that stops the reader is reported and, where options can
//! get around it, the folder is opened again with those, so that one call finds more than the first fault.
//!
//! ```
//! use gs4d_doctor::{CheckOptions, Verdict, examine};
//!
//! let checkup = examine(std::path::Path::new("/there/is/no/such/folder"), &CheckOptions::default());
//! assert_eq!(checkup.count(Verdict::Problem), 1);
//! assert_eq!((checkup.findings[0].code, checkup.summary().as_str()), ("data.path", "1 problem, 0 warnings"));
//! ```
//!
//! | module | checks |
//! |---|---|
//! | `sample` | which of many images are read |
//! | `reduced` | none: it keeps reduced images, so that later checks decode few again |
//! | `images` | files: readable, blank, duplicate, exposure, sharpness, alpha, masks |
//! | `clock`, `in_step` | times: source, gaps, two images of one camera at one time, cameras whose clock is off |
//! | `poses` | cameras: epipolar error of matched corners, under the poses and under other conventions |
//! | `silhouettes` | cameras: the visual hull of alpha or masks must cover every silhouette |
//! | `corner_fit`, `hull_fit` | single views: another pose that explains the image far better, and which faults would be found |
//! | `template` | a filmed person: the posed template must cover its silhouettes; poses, cameras and clocks that do not fit |
//! | `start` | initial points and the scene box |
//! | `cost` | memory and time of a training run, extrapolated from a few steps |
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

mod clock;
mod corner_fit;
mod cost;
mod epipolar;
mod features;
mod figures;
mod hull_fit;
mod images;
mod in_step;
mod matching;
mod page;
mod pose_readings;
mod poses;
#[cfg(test)]
mod power;
mod reduced;
mod refit;
mod rig;
mod sample;
mod silhouettes;
mod start;
mod template;
mod views;

pub use cost::{Cost, CostOptions, StageCost};
pub use page::{is_page, page};
pub use template::{CameraOutlines, JointOutlines, Outlines};

use gs_core::Image;
use gs_data::{
    Confidence, DataError, DataOptions, Dataset, ImageU8, LAYOUTS, TimeRange, TimeShift, detect, write_times,
};
use reduced::Reduced;
use sample::Sample;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Places listed in a finding; the rest is counted.
const MAX_PLACES: usize = 12;
/// Reader faults after which opening the folder is given up.
const MAX_FAULTS: usize = 6;

/// Severity of a [`Finding`], from harmless to fatal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The check found nothing wrong.
    Ok,
    /// Information; nothing has to be done.
    Note,
    /// Likely to cost quality, or assumed.
    Warning,
    /// Training would fail or learn something wrong.
    Problem,
}

/// The outcome of one check.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// What was checked: `layout`, `images`, `masks`, `time`, `split`, `poses`, `template`, `init`, `bound`, `memory`, `duration`.
    pub topic: &'static str,
    /// Stable name of the finding: `images.blank`, or the code of the reader's error.
    pub code: &'static str,
    /// How grave the finding is.
    pub verdict: Verdict,
    /// The outcome in one sentence.
    pub what: String,
    /// Files, views or fields concerned: the first few, then `and N more`.
    pub places: Vec<String>,
    /// A command or an edit that fixes it, where one is known.
    pub fix: Option<String>,
    /// The setting of `scene.toml` that fixes it, where one does.
    pub setting: Option<Setting>,
}

/// A setting of `scene.toml` that fixes a finding; [`apply`] writes it.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Setting {
    /// `data.time_range`.
    Range(TimeRange),
    /// `data.time_shift`.
    Shift(TimeShift),
}

/// Writes the settings that findings come with into `scene.toml` of a folder; those written, in words.
///
/// # Errors
/// If the file cannot be read or written.
pub fn apply(dir: &Path, findings: &[Finding]) -> Result<Vec<String>, DataError> {
    let settings: Vec<&Setting> = findings.iter().filter_map(|f| f.setting.as_ref()).collect();
    for setting in &settings {
        match setting {
            Setting::Range(range) => write_times(dir, Some(*range), None)?,
            Setting::Shift(shift) => write_times(dir, None, Some(shift))?,
        };
    }
    let text = |s: &&Setting| match s {
        Setting::Range(range) => format!("data.time_range={range}"),
        Setting::Shift(shift) => format!("data.time_shift={shift}"),
    };
    Ok(settings.iter().map(text).collect())
}

impl Finding {
    fn new(topic: &'static str, code: &'static str, verdict: Verdict, what: impl Into<String>) -> Self {
        Self { topic, code, verdict, what: what.into(), places: Vec::new(), fix: None, setting: None }
    }

    fn ok(topic: &'static str, what: impl Into<String>) -> Self {
        Self::new(topic, "ok", Verdict::Ok, what)
    }

    fn at<T: Into<String>>(mut self, places: impl IntoIterator<Item = T>) -> Self {
        let all: Vec<String> = places.into_iter().map(Into::into).collect();
        let more = all.len().saturating_sub(MAX_PLACES);
        self.places = all.into_iter().take(MAX_PLACES).collect();
        if more > 0 {
            self.places.push(format!("and {more} more"));
        }
        self
    }

    fn fix(mut self, fix: impl Into<String>) -> Self {
        self.fix = Some(fix.into());
        self
    }

    fn setting(mut self, setting: Option<Setting>) -> Self {
        self.setting = setting;
        self
    }
}

/// An image for the report that illustrates a finding.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Topic of the findings it belongs to: `poses`, `template`, `init` or `bound`.
    pub topic: &'static str,
    /// What the image shows, for people.
    pub caption: String,
    /// RGB in `[0, 1]`, `[H, W, 3]`.
    pub image: Image,
}

/// What [`examine`] found in a folder of data.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Checkup {
    /// The folder that was checked.
    pub root: PathBuf,
    /// Name of the layout it was read with; `None` if no reader could open it.
    pub layout: Option<&'static str>,
    /// Findings in the order of the topics.
    pub findings: Vec<Finding>,
    /// Assumptions of the reader, in words.
    pub notes: Vec<String>,
    /// How far a filmed person's template is from its silhouettes; `None` of other data, and without silhouettes.
    pub outlines: Option<Outlines>,
    /// Cost of training, where it was asked for and the run could start.
    pub cost: Option<Cost>,
    /// Images for the HTML report.
    #[serde(skip)]
    pub figures: Vec<Figure>,
}

impl Checkup {
    /// The number of findings of one severity.
    pub fn count(&self, verdict: Verdict) -> usize {
        self.findings.iter().filter(|f| f.verdict == verdict).count()
    }

    /// For example `1 problem, 2 warnings`.
    pub fn summary(&self) -> String {
        let of = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
        format!("{}, {}", of(self.count(Verdict::Problem), "problem"), of(self.count(Verdict::Warning), "warning"))
    }

    /// Adds findings, each of which `tell` is given.
    fn add(&mut self, findings: impl IntoIterator<Item = Finding>, tell: &mut dyn FnMut(&Finding)) {
        self.findings.extend(findings.into_iter().inspect(|f| tell(f)));
    }
}

/// How [`examine`] reads the data, and whether it estimates a run.
#[derive(Clone, Debug, Default)]
pub struct CheckOptions {
    /// Options that the reader is given.
    pub data: DataOptions,
    /// Whether to read every image; else of many a sample, spread evenly over cameras and times. It is the same each time.
    pub all: bool,
    /// The run whose cost is estimated; `None` skips the estimate, which trains for some steps.
    pub cost: Option<CostOptions>,
}

/// Runs all checks on a folder. Faults become findings, never errors.
pub fn examine(dir: &Path, exam: &CheckOptions) -> Checkup {
    examine_and_tell(dir, exam, &mut |_| ())
}

/// As [`examine`]; `tell` is given each finding as soon as its check ends.
pub fn examine_and_tell(dir: &Path, exam: &CheckOptions, tell: &mut dyn FnMut(&Finding)) -> Checkup {
    let mut checkup = Checkup { root: dir.to_path_buf(), ..Checkup::default() };
    let Some((data, options)) = open(dir, &exam.data, &mut checkup, tell) else { return checkup };
    checkup.layout = Some(data.layout);
    checkup.notes.clone_from(&data.notes);
    let sample = Sample::of(&data, exam.all);
    checkup.add(sample.finding(), tell);
    let reduced = Reduced::of(&data, options.max_image_mib);
    let keep = |at, whole: &ImageU8| reduced.keep(&data, at, whole);
    let checked = images::check(&data, &sample, options.max_image_mib, &keep);
    checkup.add(checked.findings(&data), tell);
    checkup.add(clock::check(&data, &checked), tell);
    let mut readable = checked.readable(&data);
    if readable.train.is_empty() {
        return checkup;
    }
    let (silhouettes, unreadable) = silhouettes::of_readable(&mut readable, reduced.silhouettes.as_ref());
    checkup.add(unreadable, tell);
    if readable.train.is_empty() {
        return checkup;
    }
    let (findings, mut figures) = poses::check(&readable, &reduced.small, silhouettes.as_ref());
    // Points and box mean nothing under poses of another convention.
    let sound = !findings.iter().any(|f| f.code == "poses.convention");
    checkup.add(findings, tell);
    if sound {
        checkup.add(start::check(&readable, silhouettes.as_ref()), tell);
    }
    let template = template::check(&readable, &reduced.small);
    checkup.add(template.findings, tell);
    checkup.outlines = template.outlines;
    figures.extend(template.figures);
    figures.extend(figures::all(&readable, &reduced.small, silhouettes.as_ref()));
    checkup.figures = figures;
    // A run that is tried has the memory to itself.
    drop((reduced, silhouettes));
    if let Some(options) = &exam.cost {
        let (findings, cost) = cost::check(&readable, options);
        checkup.add(findings, tell);
        checkup.cost = cost;
    }
    checkup
}

/// Opens a folder, with other options after a fault they get around; adds the layout and the faults to the findings.
fn open(
    dir: &Path,
    wanted: &DataOptions,
    checkup: &mut Checkup,
    tell: &mut dyn FnMut(&Finding),
) -> Option<(Dataset, DataOptions)> {
    let mut options = wanted.clone();
    let mut faults: Vec<Finding> = Vec::new();
    let opened = loop {
        match Dataset::open(dir, &options) {
            Ok(data) => break Some(data),
            Err(e) => {
                let next = around(&e, &options);
                faults.push(fault(&e));
                match next.filter(|_| faults.len() < MAX_FAULTS) {
                    Some(next) => options = next,
                    None => break None,
                }
            }
        }
    };
    checkup.add(layout(dir, wanted, opened.as_ref()), tell);
    checkup.add(faults, tell);
    opened.map(|data| (data, options))
}

/// Options that get around a fault of the reader, where there are any.
fn around(e: &DataError, options: &DataOptions) -> Option<DataOptions> {
    let next = match e {
        DataError::Missing { .. } => DataOptions { allow_missing: true, ..options.clone() },
        DataError::Time { span, .. } => DataOptions { time_range: Some(*span), ..options.clone() },
        _ => return None,
    };
    (next != *options).then_some(next)
}

/// A reader's error as a finding.
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
    let setting = match e {
        DataError::Time { span, .. } => Some(Setting::Range(*span)),
        _ => None,
    };
    let finding = Finding::new(topic, e.code(), Verdict::Problem, what).fix(e.fix()).setting(setting);
    finding.at(e.place().map(|p| p.to_string()))
}

/// The layout that was chosen, and others that would fit as well as it.
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
    // A `nvfi` folder always has the form of a `blender` folder, too.
    let rival = |r: &&(Confidence, &str)| Some(r.0) == own && !(name == "nvfi" && r.1 == "blender");
    let close = rivals.iter().filter(rival).map(|r| r.1).collect::<Vec<_>>();
    let text = format!("{name}{asked} ({about}){counts}");
    if close.is_empty() || options.layout.is_some() {
        return Some(Finding::ok("layout", text));
    }
    let text = format!("{text}; the files would also do for {}", close.join(", "));
    Some(Finding::new("layout", "layout.ambiguous", Verdict::Note, text).fix(format!("--layout {}", close[0])))
}

/// The upper median; NaN of no values.
fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Luma of an encoded RGB colour (BT.601).
fn luma(rgb: [f32; 3]) -> f32 {
    0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2]
}
