//! A run read back: settings, and the model at its newest checkpoint that verifies.
//!
//! Rendering and scoring also work from a single file: a checkpoint in a run folder, or a compact scene ([`crate::compact`]).

use super::folder::{self, RunFolder};
use super::{Resolved, RunError};
use crate::compact::SETTINGS;
use gs_data::{Dataset, ImageCache, Split};
use gs_train::checkpoint::{self, Checkpoint, Newest, Skipped};
use gs_train::evaluate::{EvalReport, evaluate, evaluate_with_future};
use gs_train::registry::Registry;
use gs_train::saved::{self, Loaded};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// A run, open for reading.
pub struct OpenRun {
    folder: Option<RunFolder>,
    /// Settings of the run, resolved as they were in training.
    pub resolved: Resolved,
    /// The model, its step and seconds of training.
    pub loaded: Loaded,
    /// The checkpoint it was read from.
    pub path: PathBuf,
    /// Newer checkpoints that did not verify.
    pub skipped: Vec<Skipped>,
}

impl OpenRun {
    /// Opens a run folder, or a checkpoint or compact scene.
    ///
    /// # Errors
    /// If it is no run, or no checkpoint of it is usable; for a file, if it holds no settings and lies in no run folder.
    pub fn open(registry: &Registry, path: &Path) -> Result<Self, RunError> {
        if path.is_file() {
            let checkpoint = Checkpoint::load(path)?;
            let settings = match checkpoint.meta.get(SETTINGS).and_then(Value::as_str) {
                Some(text) => text.to_owned(),
                None => RunFolder::around(path)?.read(folder::CONFIG)?,
            };
            return Self::of(
                registry,
                None,
                &settings,
                Newest { checkpoint, path: path.to_owned(), skipped: Vec::new() },
            );
        }
        let folder = RunFolder::open(path)?;
        let settings = folder.read(folder::CONFIG)?;
        let newest = checkpoint::load_newest(&folder.checkpoints())?;
        Self::of(registry, Some(folder), &settings, newest)
    }

    fn of(registry: &Registry, folder: Option<RunFolder>, settings: &str, newest: Newest) -> Result<Self, RunError> {
        let resolved = Resolved::read(registry, settings, folder::CONFIG)?;
        let entry = registry.find(&resolved.run.method)?;
        // Only a method that cannot be built without the data's template has its data opened here.
        let avatar = if entry.needs_avatar { entry.avatar(&resolved.open_data()?)? } else { None };
        let loaded = saved::load_with(registry, &newest.checkpoint, None, avatar)
            .map_err(gs_train::trainer::TrainError::State)?;
        Ok(Self { folder, resolved, loaded, path: newest.path, skipped: newest.skipped })
    }

    /// The folder of the run.
    ///
    /// # Errors
    /// If a single file was opened.
    pub fn folder(&self) -> Result<&RunFolder, RunError> {
        self.folder.as_ref().ok_or_else(|| RunError::NotARun { path: self.path.clone() })
    }

    /// The colour behind the scene that the method is evaluated over.
    pub fn background(&self) -> [f32; 3] {
        self.loaded.model.background()
    }

    /// The image cache of this run's data, at full size.
    pub fn images(&self) -> ImageCache {
        self.resolved.images()
    }

    /// Scores a split of the run's data.
    ///
    /// # Errors
    /// If the split is empty or an image cannot be read.
    pub fn score(&self, dataset: &Dataset, split: Split, background: [f32; 3]) -> Result<EvalReport, RunError> {
        let mut report = evaluate(&self.loaded.model, dataset, split, background, &self.images())?;
        report.train_seconds = Some(self.loaded.train_seconds);
        Ok(report)
    }

    /// Scores the test views over the recipe's background, and the views beyond the last training time where there are any:
    /// what `metrics.json` holds.
    ///
    /// # Errors
    /// If there are no test views or an image cannot be read.
    pub fn score_for_folder(&self, dataset: &Dataset) -> Result<EvalReport, RunError> {
        let method = &self.loaded.model;
        let images = self.images();
        let mut report = evaluate_with_future(method, dataset, Split::Test, self.background(), &images)?;
        report.train_seconds = Some(self.loaded.train_seconds);
        Ok(report)
    }
}

/// The scores of a split as `metrics.json` holds them: those of [`EvalReport`], with the step and the bytes of the scene.
pub fn metrics_json(report: &EvalReport, step: u32) -> Value {
    let mut json = json!(report);
    json["step"] = json!(step);
    json["bytes"] = json!(report.parameter_bytes);
    json
}
