//! The runs of a comparison with their data, the conditions they must share, and their names.

use crate::compare::Options;
use crate::provenance::{DataOrigin, trained_on};
use crate::score_table::size_text;
use crate::summary::color_name;
use crate::{OpenRun, RunError, folder};
use gs_data::Dataset;
use gs_train::device::CPU;
use gs_train::evaluate::{EvalError, split_name};
use gs_train::method::MethodError;
use gs_train::registry::Registry;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Runs that cannot be compared.
#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    /// They differ in data or rendering conditions.
    #[error("{first} and {other} are not of the same data: {}", fields.join("; "))]
    Differ {
        /// The run that the others are compared with.
        first: PathBuf,
        /// The run that differs from it.
        other: PathBuf,
        /// The differing conditions, each with both values.
        fields: Vec<String>,
        /// Whether only the background differs, which [`Options::background`] can set.
        background_only: bool,
    },
    /// A view cannot be rendered.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// A view cannot be scored.
    #[error(transparent)]
    Eval(Box<EvalError>),
}

impl From<EvalError> for CompareError {
    fn from(e: EvalError) -> Self {
        CompareError::Eval(Box::new(e))
    }
}

/// A run of a comparison, with its data.
pub struct Side {
    /// Path it was read from.
    pub path: PathBuf,
    /// The run, open for reading.
    pub run: OpenRun,
    /// Its log; empty for a single file.
    pub log: Vec<Value>,
    pub(super) dataset: Dataset,
    /// The machine it was trained on, from its provenance.
    machine: Option<Value>,
}

impl Side {
    /// Opens a run, or a checkpoint or compact scene, with its data: in the folder `data`, or where the run began.
    ///
    /// # Errors
    /// If it cannot be read, or its data are gone.
    pub fn open(registry: &Registry, path: &Path, data: Option<&Path>) -> Result<Self, RunError> {
        let run = OpenRun::open_with(registry, path, data)?;
        let dataset = run.open_data()?;
        let (log, provenance) = match run.folder() {
            Ok(folder) => (folder.log_lines(folder::LOG)?, folder.read(folder::PROVENANCE).ok()),
            Err(_) => (Vec::new(), None),
        };
        let provenance: Option<Value> = provenance.and_then(|text| serde_json::from_str(&text).ok());
        let machine = provenance.map(|p| p["machine"].clone()).filter(|m| m.is_object());
        Ok(Self { path: path.to_owned(), run, log, dataset, machine })
    }

    /// Whether the data may be those that the run was trained on, as far as it knows.
    pub fn may_be_of_its_data(&self) -> bool {
        !self.run.folder().is_ok_and(|folder| trained_on(folder, &self.dataset) == Some(false))
    }

    /// The conditions that must agree: name and value.
    fn identity(&self, options: &Options) -> Vec<(&'static str, String)> {
        let views = self.dataset.views(options.split);
        let background = options.background.unwrap_or_else(|| self.run.background());
        let split = split_name(options.split);
        let DataOrigin { digest, details, .. } = DataOrigin::of(&self.dataset);
        vec![
            ("layout", self.dataset.layout.to_owned()),
            ("number of views", format!("{} of split {split}", views.len())),
            ("size", size_text(views, &self.run.images())),
            ("background", color_name(background)),
            ("data digest", digest),
            ("digest of times, lenses and depth", details),
        ]
    }

    pub(super) fn trained_on(&self) -> Option<String> {
        let machine = self.machine.as_ref()?;
        let text = |key: &str| machine[key].as_str().unwrap_or("–").to_owned();
        let commit = machine["commit"].as_str().map_or(String::new(), |c| format!(", commit {c}"));
        let device = machine["device"].as_str().filter(|d| *d != CPU);
        let device = device.map_or(String::new(), |d| format!(", rendered on {d}"));
        Some(format!(
            "{}, {} threads, {}{device}, gs4d {}{commit}",
            text("cpu"),
            machine["threads"],
            text("simd"),
            text("version")
        ))
    }
}

/// An error if a run has other conditions than the first.
pub(super) fn same_data(first: &Side, other: &Side, options: &Options) -> Result<(), CompareError> {
    let pairs = first.identity(options).into_iter().zip(other.identity(options));
    let differing: Vec<_> = pairs.filter(|(a, b)| a.1 != b.1).collect();
    if differing.is_empty() {
        return Ok(());
    }
    let fields = differing.iter().map(|((name, a), (_, b))| format!("{name} ({a}, {b})")).collect();
    let background_only = differing.iter().all(|(a, _)| a.0 == "background");
    Err(CompareError::Differ { first: first.path.clone(), other: other.path.clone(), fields, background_only })
}

/// Unique names: the last part of each path, whole paths where those are equal, with numbers where even these are.
pub(super) fn names(sides: &[Side]) -> Vec<String> {
    let paths: Vec<&Path> = sides.iter().map(|s| s.path.as_path()).collect();
    let last = |p: &Path| p.file_name().map_or_else(|| p.display().to_string(), |n| n.to_string_lossy().into_owned());
    let short: Vec<String> = paths.iter().map(|p| last(p)).collect();
    let name = |k: usize| {
        let twins = |of: &dyn Fn(usize) -> bool| (0..paths.len()).filter(|i| of(*i)).count() > 1;
        if !twins(&|i| short[i] == short[k]) {
            short[k].clone()
        } else if !twins(&|i| paths[i] == paths[k]) {
            paths[k].display().to_string()
        } else {
            format!("{} ({})", paths[k].display(), k + 1)
        }
    };
    (0..paths.len()).map(name).collect()
}
