//! How a run begins in its folder, and how it goes on from there: later, on more data, on a device, with other ranks.

use super::{Logs, Training, Window, warnings};
use crate::folder::{self, Beginning, RunFolder};
use crate::kept::Kept;
use crate::opened::{check_exists, check_method};
use crate::saving::Patience;
use crate::settings::{self, Resolved};
use crate::{RunError, provenance, ranks};
use gs_data::Dataset;
use gs_train::checkpoint::{self, Newest};
use gs_train::device::Device;
use gs_train::ranks::{Ranks, alone};
use gs_train::registry::Registry;
use gs_train::trainer::{TrainOptions, Trainer};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// How a run is resumed.
#[derive(Clone, Debug, Default)]
pub struct ResumeRequest {
    /// Steps in all: the schedule is lengthened to that many ([`settings::lengthen`]).
    pub steps: Option<u32>,
    /// Seconds of training in this session; the run's original budget is not used again.
    pub budget: Option<f64>,
    /// Folder of the data, where they are not at the path the run has kept; the run keeps the new one.
    pub data: Option<PathBuf>,
    /// Decoded images kept in memory, at most, MiB; the run keeps the number.
    pub image_mib: Option<u32>,
    /// Go on with other data than the run began with.
    pub accept_changed_data: bool,
}

/// What a run keeps of its data, as the text of a file.
fn kept_text(dataset: &Dataset) -> Result<String, RunError> {
    Ok(format!("{}\n", Kept::of(dataset).to_json()?))
}

/// The trainer of a run before its first step.
fn new_trainer(resolved: &Resolved, dataset: Arc<Dataset>) -> Result<Trainer, RunError> {
    let options = TrainOptions { seed: resolved.run.seed, image_bytes: resolved.run.image_bytes() };
    Ok(Trainer::new(&resolved.registry, dataset, &resolved.run.method, &resolved.method, options)?)
}

/// The same trainer, the first of these ranks.
fn led(trainer: Trainer, resolved: &Resolved, ranks: Arc<dyn Ranks>) -> Result<Trainer, RunError> {
    if ranks.size() == 1 {
        return Ok(trainer);
    }
    ranks::call(&*ranks, resolved, trainer.dataset())?;
    Ok(trainer.lead(ranks)?)
}

impl Training {
    /// Begins a run in a new folder.
    ///
    /// # Errors
    /// If the folder is taken, the data or the method cannot be used, or nothing can move in the data and the method learns motion.
    pub fn begin(root: &Path, overwrite: bool, resolved: Resolved) -> Result<Self, RunError> {
        Self::begin_with_ranks(root, overwrite, resolved, alone())
    }

    /// The same, trained together with the other ranks ([`Self::with_ranks`]): an older run is overwritten once all of them can begin.
    ///
    /// # Errors
    /// As [`Self::begin`] and [`Self::with_ranks`].
    pub fn begin_with_ranks(
        root: &Path,
        overwrite: bool,
        resolved: Resolved,
        ranks: Arc<dyn Ranks>,
    ) -> Result<Self, RunError> {
        let dataset = Arc::new(resolved.open_data()?);
        let resolved = resolved.with_start_points(&dataset)?;
        resolved.fits(&dataset)?;
        let trainer = led(new_trainer(&resolved, dataset)?, &resolved, ranks)?;
        Self::begin_in(root, overwrite, resolved, trainer, None)
    }

    /// The same on a part of the data of the settings. A training in rounds gives what it needs to go on
    /// ([`RunFolder::rounds`]).
    ///
    /// # Errors
    /// If the folder is taken or the method cannot be used.
    pub fn begin_on(
        root: &Path,
        overwrite: bool,
        resolved: Resolved,
        dataset: Arc<Dataset>,
        rounds: Option<Value>,
    ) -> Result<Self, RunError> {
        let trainer = new_trainer(&resolved, dataset)?;
        Self::begin_in(root, overwrite, resolved, trainer, rounds)
    }

    fn begin_in(
        root: &Path,
        overwrite: bool,
        resolved: Resolved,
        trainer: Trainer,
        rounds: Option<Value>,
    ) -> Result<Self, RunError> {
        let config = resolved.to_toml()?;
        let mut provenance = provenance::begun(&resolved, &config, trainer.dataset(), trainer.steps());
        provenance["rounds"] = json!(rounds);
        let beginning = Beginning {
            config: &config,
            provenance: &format!("{provenance:#}\n"),
            data: &kept_text(trainer.dataset())?,
        };
        let folder = RunFolder::create(root, overwrite, &beginning)?;
        let stop_at = resolved.run.time_budget;
        let warnings = warnings::at_begin(&trainer, &resolved);
        Ok(Self { warnings, ..Self::new(trainer, resolved, folder, stop_at) })
    }

    /// Resumes a run from its newest checkpoint that verifies.
    ///
    /// # Errors
    /// If no checkpoint is usable, data or settings have changed, the steps cannot be made, or it is trained in rounds.
    pub fn resume(registry: &Registry, root: &Path, request: &ResumeRequest) -> Result<Self, RunError> {
        check_exists(root)?;
        let folder = RunFolder::open_to_write(root)?;
        if let Some(rounds) = folder.rounds() {
            let command = rounds["command"].as_str().unwrap_or("gs4d continual").to_owned();
            return Err(RunError::InRounds { path: root.to_owned(), command });
        }
        let newest = checkpoint::load_newest(&folder.checkpoints())?;
        let before = folder.read(folder::CONFIG)?;
        let mut resolved = Resolved::read(registry, &before, folder::CONFIG)?;
        provenance::check_settings(&folder, &before)?;
        check_method(&newest, &resolved)?;
        if let Some(data) = &request.data {
            resolved = resolved.with_data(data)?;
        }
        if let Some(mib) = request.image_mib {
            resolved = resolved.with_image_cache(mib)?;
        }
        let done = newest.checkpoint.meta["step"].as_u64().and_then(|s| u32::try_from(s).ok()).unwrap_or(0);
        if let Some(steps) = request.steps {
            resolved = settings::lengthen(&resolved, steps, done)?;
        }
        let dataset = Arc::new(resolved.reopen_data()?);
        let changed = request.steps.is_some() || request.data.is_some() || request.image_mib.is_some();
        let config = if changed { resolved.to_toml()? } else { before.clone() };
        let session = provenance::resumed(&folder, &dataset, done, [&before, &config], request.accept_changed_data)?;
        let bytes = resolved.run.image_bytes();
        let trainer = Trainer::resume(registry, dataset, &newest.checkpoint, Some(&resolved.method), bytes)?;
        // First what the settings are compared with.
        session.provenance.map_or(Ok(()), |text| folder.write(folder::PROVENANCE, &text))?;
        if changed {
            folder.write(folder::CONFIG, &config)?;
        }
        folder.cut_logs(done)?;
        let stop_at = request.budget.map_or(0.0, |b| trainer.train_seconds() + b);
        let (skipped, warnings) = (newest.skipped, session.warnings);
        Ok(Self { skipped, warnings, ..Self::new(trainer, resolved, folder, stop_at) })
    }

    /// A run in a folder that is there.
    fn new(trainer: Trainer, resolved: Resolved, folder: RunFolder, stop_at: f64) -> Self {
        let (logs, patience, window) = (Logs::of(&folder), Patience::default(), Window::default());
        let (skipped, warnings) = Default::default();
        Self { trainer, resolved, folder, logs, patience, window, stop_at, skipped, warnings }
    }

    /// The same run, its frames rendered on this device from now on; its provenance names it. To be called before the first step.
    ///
    /// # Errors
    /// If the device fails, or the provenance cannot be written.
    pub fn on(mut self, device: &Device) -> Result<Self, RunError> {
        self.trainer = self.trainer.on(device)?;
        self.warnings.extend(provenance::note_device(&self.folder, device.name())?);
        Ok(self)
    }

    /// The same run, trained together with the other ranks, which are in [`follow`](crate::ranks::follow). Files, reports and bits
    /// are those of one rank.
    ///
    /// # Errors
    /// If a rank cannot be reached, cannot read the data, or cannot build the method.
    pub fn with_ranks(self, ranks: Arc<dyn Ranks>) -> Result<Self, RunError> {
        Ok(Self { trainer: led(self.trainer, &self.resolved, ranks)?, ..self })
    }

    /// Resumes a training in rounds from a checkpoint of its folder, with the settings and data of a round, which may hold more
    /// views than the checkpoint was made with.
    ///
    /// # Errors
    /// If the checkpoint does not fit the method, or something cannot be written.
    pub fn resume_on(
        folder: RunFolder,
        newest: Newest,
        resolved: Resolved,
        dataset: Arc<Dataset>,
    ) -> Result<Self, RunError> {
        let (config, bytes) = (&resolved.method, resolved.run.image_bytes());
        let state = &newest.checkpoint;
        let trainer = Trainer::resume_with_more_views(&resolved.registry, dataset, state, config, bytes)?;
        folder.write(folder::CONFIG, &resolved.to_toml()?)?;
        folder.write(folder::DATA, &kept_text(trainer.dataset())?)?;
        folder.cut_logs(trainer.steps_done())?;
        Ok(Self { skipped: newest.skipped, ..Self::new(trainer, resolved, folder, 0.0) })
    }

    /// Continues with more views and other settings ([`Trainer::with_more_views`]).
    ///
    /// # Errors
    /// If the method cannot be built anew or the settings cannot be written.
    pub fn grow(self, resolved: Resolved, dataset: Arc<Dataset>) -> Result<Self, RunError> {
        let trainer = self.trainer.with_more_views(&resolved.registry, dataset, &resolved.method)?;
        self.folder.write(folder::CONFIG, &resolved.to_toml()?)?;
        self.folder.write(folder::DATA, &kept_text(trainer.dataset())?)?;
        Ok(Self { trainer, resolved, window: Window::default(), ..self })
    }
}
