//! A run read back: settings, and the model at its newest checkpoint that verifies.
//!
//! Rendering and scoring also work from a single file: a checkpoint in a run folder, or a compact scene ([`crate::compact`]).

use super::folder::{self, RunFolder};
use super::provenance;
use super::{Resolved, RunError};
use crate::compact::{self, SETTINGS};
use crate::kept::Kept;
use gs_core::io::{IoError, SplatFormat};
use gs_data::{Dataset, ImageCache, Split, View};
use gs_metrics::{Lpips, Quantise};
use gs_train::checkpoint::{self, Checkpoint, Newest, Skipped};
use gs_train::device::Device;
use gs_train::evaluate::{EvalReport, Scoring, evaluate_with, evaluate_with_future, split_name};
use gs_train::ranks::Share;
use gs_train::registry::Registry;
use gs_train::saved::{self, Loaded};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;

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
    /// The ranks that score it together.
    pub share: Arc<Share>,
    /// The device that renders it where it is scored.
    pub device: Device,
    /// Rounding of frames to 8 bit before they are scored.
    pub quantise: Quantise,
    /// Reduces frames and images to half size before they are scored.
    pub half: bool,
    /// Scores LPIPS as well.
    pub lpips: Option<Arc<Lpips>>,
    /// Scores in the colours of the images as well.
    pub fit_colors: bool,
    /// What was kept of the data, as JSON.
    kept: Option<Value>,
    /// Whether the folder of the data was given, instead of the one the run has kept.
    moved: bool,
}

impl OpenRun {
    /// Opens a run folder, or a checkpoint or compact scene.
    ///
    /// # Errors
    /// If it is no run, or no checkpoint of it is usable; for a file, if it holds no settings and lies in no run folder.
    pub fn open(registry: &Registry, path: &Path) -> Result<Self, RunError> {
        Self::open_with(registry, path, None)
    }

    /// The same with the data in the folder `data`, if one is given, instead of where the run began.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_with(registry: &Registry, path: &Path, data: Option<&Path>) -> Result<Self, RunError> {
        check_exists(path)?;
        let (folder, newest) = if path.is_file() {
            if SplatFormat::of_path(path).is_some() {
                return Err(RunError::SplatFile { path: path.to_owned() });
            }
            let checkpoint = Checkpoint::load(path)?;
            (None, Newest { checkpoint, path: path.to_owned(), skipped: Vec::new() })
        } else {
            let folder = RunFolder::open(path)?;
            let newest = checkpoint::load_newest(&folder.checkpoints())?;
            (Some(folder), newest)
        };
        let (settings, kept) = settings(&newest, folder.as_ref(), path)?;
        let mut resolved = Resolved::read(registry, &settings, folder::CONFIG)?;
        if let Some(data) = data {
            resolved = resolved.with_data(data)?;
        }
        check_method(&newest, &resolved)?;
        let entry = registry.find(&resolved.run.method)?;
        // Only a method that cannot be built without the data's template has its data opened here.
        let avatar = if entry.needs_avatar { entry.avatar(&resolved.reopen_data()?)? } else { None };
        let loaded = saved::load_with(registry, &newest.checkpoint, None, avatar)
            .map_err(gs_train::trainer::TrainError::State)?;
        let Newest { path, skipped, .. } = newest;
        let (share, device, moved) = (Arc::default(), Device::default(), data.is_some());
        let (quantise, half, lpips, fit_colors) = Default::default();
        Ok(Self {
            folder,
            resolved,
            loaded,
            path,
            skipped,
            share,
            device,
            quantise,
            half,
            lpips,
            fit_colors,
            kept,
            moved,
        })
    }

    /// The data set of the run.
    ///
    /// # Errors
    /// If it is not where it was, or cannot be read.
    pub fn open_data(&self) -> Result<Dataset, RunError> {
        self.resolved.reopen_data()
    }

    /// Whether these are the data that the run was trained on, as far as it knows: without a digest of them, those at the path that it has
    /// kept.
    pub fn trained_on(&self, dataset: &Dataset) -> bool {
        let known = self.folder.as_ref().and_then(|folder| provenance::trained_on(folder, dataset));
        known.unwrap_or(!self.moved)
    }

    /// What the run has kept of its data; of the data themselves where they can be opened.
    ///
    /// # Errors
    /// As [`Self::open_data`], if nothing was kept or the folder of the data was given.
    pub fn kept(&self) -> Result<Kept, RunError> {
        match (self.open_data(), &self.kept) {
            (Ok(data), _) => Ok(Kept::of(&data)),
            (Err(_), Some(json)) if !self.moved => Ok(Kept::parse(json, folder::DATA)?),
            (Err(e), _) => Err(e),
        }
    }

    /// The training views; where the data are gone, the few that were kept, without images.
    ///
    /// # Errors
    /// As [`Self::open_data`], if no camera was kept or the folder of the data was given.
    pub fn training_views(&self) -> Result<Vec<View>, RunError> {
        let data = match self.open_data() {
            Ok(data) => return Ok(data.train),
            Err(e) => e,
        };
        self.kept().ok().map(|kept| kept.train).filter(|train| !train.is_empty()).ok_or(data)
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

    /// How its views are scored: by its ranks, on its device.
    pub fn scoring<'a>(&'a self, background: [f32; 3], images: &'a ImageCache) -> Scoring<'a> {
        Scoring {
            quantise: self.quantise,
            half: self.half,
            lpips: self.lpips.as_deref(),
            fit_colors: self.fit_colors,
            ..Scoring::new(background, images, &self.share, &self.device)
        }
    }

    /// Scores a split of the run's data.
    ///
    /// # Errors
    /// If the split is empty, an image cannot be read, or the device fails.
    pub fn score(&self, dataset: &Dataset, split: Split, background: [f32; 3]) -> Result<EvalReport, RunError> {
        check_views(dataset, split)?;
        let (model, images) = (&self.loaded.model, self.images());
        let mut report = evaluate_with(model, dataset, split, &self.scoring(background, &images))?;
        report.train_seconds = Some(self.loaded.train_seconds);
        Ok(report)
    }

    /// Scores the test views over the recipe's background, and the views beyond the last training time where there are any:
    /// what `metrics.json` holds.
    ///
    /// # Errors
    /// If there are no test views, an image cannot be read, or the device fails.
    pub fn score_for_folder(&self, dataset: &Dataset) -> Result<EvalReport, RunError> {
        check_views(dataset, Split::Test)?;
        let (model, images) = (&self.loaded.model, self.images());
        let scoring = self.scoring(self.background(), &images);
        let mut report = evaluate_with_future(model, dataset, Split::Test, &scoring)?;
        report.train_seconds = Some(self.loaded.train_seconds);
        Ok(report)
    }
}

/// The settings of the run, and what was kept of its data: of its folder; of a file, what it holds itself, else those of the folder it lies in.
fn settings(newest: &Newest, folder: Option<&RunFolder>, path: &Path) -> Result<(String, Option<Value>), RunError> {
    let meta = &newest.checkpoint.meta;
    if let Some(settings) = meta.get(SETTINGS).and_then(Value::as_str).filter(|_| folder.is_none()) {
        let kept = [compact::DATA, compact::CAMERAS].iter().find_map(|key| meta.get(*key));
        return Ok((settings.to_owned(), kept.cloned()));
    }
    let around;
    let run = match folder {
        Some(folder) => folder,
        None => {
            around = RunFolder::around(path)?;
            &around
        }
    };
    let read = |name: &&str| serde_json::from_str(&run.read(name).ok()?).ok();
    Ok((run.read(folder::CONFIG)?, [folder::DATA, folder::CAMERAS].iter().find_map(read)))
}

/// Fails if nothing is at a path, as opening a file there does.
///
/// # Errors
/// [`RunError::Io`].
pub fn check_exists(path: &Path) -> Result<(), RunError> {
    let missing = |source| IoError::Os { file: path.display().to_string().into(), action: "open", source };
    std::fs::metadata(path).map(drop).map_err(|e| missing(e).into())
}

/// Fails if a split has no views.
fn check_views(dataset: &Dataset, split: Split) -> Result<(), RunError> {
    if !dataset.views(split).is_empty() {
        return Ok(());
    }
    let all = [Split::Train, Split::Val, Split::Test, Split::Extrapolate].map(|s| (s, dataset.views(s).len()));
    let others: Vec<String> =
        all.iter().filter(|(_, n)| *n > 0).map(|(s, n)| format!("{n} {} views", split_name(*s))).collect();
    Err(RunError::NoViews { split: split_name(split), others: others.join(", ") })
}

/// Fails if a checkpoint is of another method than its run.
pub(crate) fn check_method(newest: &Newest, resolved: &Resolved) -> Result<(), RunError> {
    let (found, method) = (newest.checkpoint.meta["method"].as_str(), &resolved.run.method);
    match found {
        Some(found) if found != method => {
            let (path, found) = (newest.path.clone(), found.to_owned());
            Err(RunError::OtherMethod { path, found, method: method.clone() })
        }
        _ => Ok(()),
    }
}

/// The scores of a split as `metrics.json` holds them: those of [`EvalReport`], with the step and the bytes of the scene.
pub fn metrics_json(report: &EvalReport, step: u32) -> Value {
    let mut json = json!(report);
    json["step"] = json!(step);
    json["bytes"] = json!(report.parameter_bytes);
    json
}
