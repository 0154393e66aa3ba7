//! A run read back: settings, the method at its newest checkpoint that verifies, the scores and pictures made from it.

use super::folder::{self, RunFolder};
use super::{Resolved, RunError};
use crate::checkpoint::{self, Skipped};
use crate::data::{Dataset, ImageCache, Split};
use crate::evaluate::{EvalReport, evaluate};
use crate::methods::saved::{self, Loaded};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// A run, open for reading.
pub struct OpenRun {
    /// The folder.
    pub folder: RunFolder,
    /// The settings.
    pub resolved: Resolved,
    /// The method, its step and seconds.
    pub loaded: Loaded,
    /// The checkpoint it was read from.
    pub path: PathBuf,
    /// Newer checkpoints that did not verify.
    pub skipped: Vec<Skipped>,
}

impl OpenRun {
    /// Opens a run folder.
    ///
    /// # Errors
    /// If it is no run, or no checkpoint of it is usable.
    pub fn open(root: &Path) -> Result<Self, RunError> {
        let folder = RunFolder::open(root)?;
        let resolved = Resolved::read(&folder.read(folder::CONFIG)?, folder::CONFIG)?;
        let newest = checkpoint::load_newest(&folder.checkpoints())?;
        let loaded = saved::load(&newest.checkpoint, None).map_err(crate::trainer::TrainError::State)?;
        Ok(Self { folder, resolved, loaded, path: newest.path, skipped: newest.skipped })
    }

    /// The colour behind the scene that the method is evaluated over.
    pub fn background(&self) -> [f32; 3] {
        self.loaded.method.schedule().background.evaluation_color()
    }

    /// Photographs of this run's data.
    pub fn photographs(&self) -> ImageCache {
        let bytes = (self.resolved.run.image_mib as usize) << 20;
        ImageCache::new(bytes, 1.0).with_max_image_mib(self.resolved.data.max_image_mib)
    }

    /// Scores a split of the run's data.
    ///
    /// # Errors
    /// If the split is empty or a photograph cannot be read.
    pub fn score(&self, dataset: &Dataset, split: Split, background: [f32; 3]) -> Result<EvalReport, RunError> {
        let mut report = evaluate(self.loaded.method.as_ref(), dataset, split, background, &self.photographs())?;
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
