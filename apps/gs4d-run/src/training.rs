//! The training loop: steps, log lines, checkpoints, evaluations, and its three outcomes.

mod stage;
mod warnings;
mod window;

use super::RunError;
use super::folder::{self, Beginning, RunFolder};
use super::kept::Kept;
use super::log::Log;
use super::opened::{check_exists, check_method, metrics_json};
use super::provenance;
use super::ranks;
use super::saving::Patience;
use super::settings::{self, Resolved};
use super::summary::{ReportInput, build_report};
use gs_core::io::cameras::{NamedCamera, save_cameras};
use gs_core::io::write_file;
use gs_data::{Dataset, ImageCache, Split};
use gs_train::checkpoint::{self, Newest, Skipped};
use gs_train::device::Device;
use gs_train::evaluate::{EvalReport, Scoring, evaluate_with};
use gs_train::ranks::{Ranks, Share, alone};
use gs_train::registry::Registry;
use gs_train::renderer::file_stem;
use gs_train::trainer::{TrainError, TrainOptions, Trainer};
use gs4d_report::analysis::Snapshot;
use gs4d_report::png;
use serde_json::{Value, json};
pub use stage::{Scored, Stage};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use window::Window;

/// A run in progress, in memory and on the disk.
pub struct Training {
    trainer: Trainer,
    resolved: Resolved,
    folder: RunFolder,
    logs: Logs,
    patience: Patience,
    window: Window,
    /// Seconds of training at which this session stops; 0: never.
    stop_at: f64,
    /// Checkpoints that did not verify on resuming.
    skipped: Vec<Skipped>,
    /// What a user should know before it goes on.
    warnings: Vec<String>,
}

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

/// The logs of a run.
struct Logs {
    steps: Log,
    histograms: Log,
    journal: Log,
}

impl Logs {
    fn of(folder: &RunFolder) -> Self {
        let [steps, histograms, journal] = [folder::LOG, folder::HISTOGRAMS, folder::JOURNAL].map(|n| folder.log(n));
        Self { steps, histograms, journal }
    }
}

/// How a training session ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// All steps of the schedule are made.
    Finished,
    /// The time budget is spent; the state is in this file.
    BudgetSpent(PathBuf),
    /// It was asked to stop; the state is in this file.
    Interrupted(PathBuf),
}

/// The progress of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Optimizer steps made so far.
    pub step: u32,
    /// Steps of the whole schedule.
    pub steps: u32,
    /// Loss, averaged over the steps since the last line of the log.
    pub loss: f64,
    /// PSNR of the training views since then, dB.
    pub psnr: f64,
    /// Number of splats after the step, at most.
    pub splats: usize,
    /// Gradient rows refused since then.
    pub quarantined: u64,
    /// Seconds spent in training so far.
    pub seconds: f64,
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

    /// Sets what happens when the disk refuses: a checkpoint is tried again after each of the `pauses` (default: 1, 5 and 20
    /// seconds), and `warn` is called with what was refused (default: a line on stderr). Lines of the logs are kept and written later.
    pub fn when_the_disk_refuses(&mut self, pauses: Vec<Duration>, warn: impl Fn(&str) + Send + 'static) {
        self.patience = Patience { pauses, warn: Box::new(warn) };
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

    /// Trains until the schedule ends, the time budget is spent or `stop` is set; saves in every case. `on_step` is called
    /// after every step.
    ///
    /// # Errors
    /// If a step fails (the last checkpoint stays good) or something cannot be written.
    pub fn train(
        &mut self,
        stop: &AtomicBool,
        on_step: &mut dyn FnMut(Progress, &mut Trainer),
    ) -> Result<Outcome, RunError> {
        loop {
            let step = self.trainer.steps_done();
            if step >= self.trainer.steps() {
                self.save()?;
                return Ok(Outcome::Finished);
            }
            if stop.load(Ordering::Relaxed) {
                return Ok(Outcome::Interrupted(self.save()?));
            }
            if self.stop_at > 0.0 && self.trainer.train_seconds() >= self.stop_at {
                return Ok(Outcome::BudgetSpent(self.save()?));
            }
            self.step(on_step)?;
        }
    }

    fn step(&mut self, on_step: &mut dyn FnMut(Progress, &mut Trainer)) -> Result<(), RunError> {
        let mut report = match self.trainer.step() {
            Ok(report) => report,
            Err(error) => {
                let at = self.trainer.steps_done();
                let line = json!({"step": at, "seconds": self.trainer.train_seconds(), "error": error.to_string()});
                self.logs.steps.add(&line, &self.patience.warn);
                return Err(error.into());
            }
        };
        let (step, events) = (report.step, std::mem::take(&mut report.events));
        self.window.add(report);
        let due = |every: u32| every > 0 && step.is_multiple_of(every);
        let run = &self.resolved.run;
        let (log, evaluation, save) = (due(run.log_every), due(run.eval_every), due(run.checkpoint_every));
        let histograms = due(run.histogram_every);
        let progress = self.progress();
        on_step(progress, &mut self.trainer);
        if log || step == self.trainer.steps() {
            self.log_steps();
        }
        if histograms {
            self.log_histograms()?;
        }
        events.iter().for_each(|line| self.logs.journal.add(line, &self.patience.warn));
        if evaluation {
            self.evaluate_while_training()?;
        }
        if save {
            self.save()?;
        }
        Ok(())
    }

    /// Writes a line of the log of the steps since the last one, if there are any.
    fn log_steps(&mut self) {
        if let Some(line) = self.window.line(self.trainer.train_seconds()) {
            self.logs.steps.add(&line, &self.patience.warn);
            self.window = Window::default();
        }
    }

    fn progress(&self) -> Progress {
        let w = &self.window;
        Progress {
            step: self.trainer.steps_done(),
            steps: self.trainer.steps(),
            loss: w.mean(w.loss),
            psnr: w.psnr(),
            splats: self.trainer.model().splat_count(),
            quarantined: w.quarantined,
            seconds: self.trainer.train_seconds(),
        }
    }

    /// Adds the quantities of the splats to their own log, if the method has any.
    fn log_histograms(&mut self) -> Result<(), RunError> {
        self.trainer.fetch()?;
        let snapshot = Snapshot::of(self.trainer.model())?;
        if snapshot.is_empty() {
            return Ok(());
        }
        let mut line = json!(snapshot);
        line["step"] = json!(self.trainer.steps_done());
        line["seconds"] = json!(self.trainer.train_seconds());
        self.logs.histograms.add(&line, &self.patience.warn);
        Ok(())
    }

    /// Scores a few validation views (test views are left for the end) and logs the means.
    fn evaluate_while_training(&mut self) -> Result<(), RunError> {
        self.trainer.fetch()?;
        let dataset = self.trainer.dataset();
        let split = if dataset.val.is_empty() { Split::Train } else { Split::Val };
        let few = few_views(dataset, split, self.resolved.run.eval_views as usize);
        let (images, share) = (self.images(), Share::default());
        let (background, device) = (self.background(), self.trainer.device());
        let scoring = Scoring::new(background, &images, &share, device);
        let report = evaluate_with(self.trainer.model(), &few, split, &scoring)?;
        let line = json!({
            "step": self.trainer.steps_done(),
            "seconds": self.trainer.train_seconds(),
            "eval": {"split": report.split, "views": report.views.len(), "mean": report.mean},
        });
        self.logs.steps.add(&line, &self.patience.warn);
        Ok(())
    }

    fn background(&self) -> [f32; 3] {
        self.trainer.model().background()
    }

    /// Scores the test views, or the training views where there are none, and beside them the views beyond the last training
    /// time where there are any; writes `metrics.json`, and `refined-cameras.json` where cameras were refined.
    ///
    /// # Errors
    /// If an image cannot be read or the file cannot be written.
    pub fn score(&self) -> Result<EvalReport, RunError> {
        let mut report = self.trainer.evaluate(&self.images())?;
        report.train_seconds = Some(self.trainer.train_seconds());
        self.folder.write_scores(metrics_json(&report, self.trainer.steps_done()), self.trainer.dataset())?;
        let refined = self.refined_cameras();
        if !refined.is_empty() {
            save_cameras(&self.folder.root().join(folder::REFINED_CAMERAS), &refined, true)?;
        }
        Ok(report)
    }

    /// The training cameras as they were corrected, in the order of views; empty where they were not.
    fn refined_cameras(&self) -> Vec<NamedCamera> {
        let corrections = self.trainer.model().cameras();
        let refined = self.trainer.dataset().train.iter().filter_map(|view| {
            let correction = corrections.of(view)?;
            let time = Some(correction.at(view.time).normalised);
            Some(NamedCamera { name: view.name.clone(), camera: correction.apply(&view.camera), time })
        });
        refined.collect()
    }

    /// Writes `report.html` for these scores, and the renders shown in it to `renders/`.
    ///
    /// # Errors
    /// If an image cannot be read or the file cannot be written.
    pub fn report(&self, scores: &EvalReport) -> Result<(), RunError> {
        let images = self.images();
        let material = ReportInput {
            folder: &self.folder,
            resolved: &self.resolved,
            method: self.trainer.model(),
            dataset: self.trainer.dataset(),
            images: &images,
            device: self.trainer.device(),
            scores,
            scene: self.trainer.scene(),
            step: self.trainer.steps_done(),
        };
        let report = build_report(&material)?;
        self.folder.write(folder::REPORT, &report.html()?)?;
        for view in &report.views {
            let name = format!("step-{:06}_{}.png", material.step, file_stem(&view.name));
            let bytes = png(&view.render)?;
            write_file(&self.folder.renders().join(name), true, |out| out.write_all(&bytes))?;
        }
        Ok(())
    }

    /// The image cache of this run's data, at full size.
    pub fn images(&self) -> ImageCache {
        self.resolved.images()
    }

    /// Saves the state now, and the lines of the logs that could not be written before. A checkpoint that the system refuses is
    /// tried again ([`Training::when_the_disk_refuses`]).
    ///
    /// # Errors
    /// If the system still refuses; older checkpoints stay good.
    pub fn save(&mut self) -> Result<PathBuf, RunError> {
        // A run that is resumed from here begins a new line.
        self.log_steps();
        let Logs { steps, histograms, journal } = &mut self.logs;
        [steps, histograms, journal].into_iter().for_each(|log| log.flush(&self.patience.warn));
        self.trainer.gather()?;
        self.patience.save_step(&self.trainer.state(), &self.folder.checkpoints(), self.trainer.steps_done())
    }

    /// The trainer with model and optimizer state.
    pub fn trainer(&self) -> &Trainer {
        &self.trainer
    }

    /// Settings of the run, resolved once.
    pub fn resolved(&self) -> &Resolved {
        &self.resolved
    }

    /// Folder that the run writes to.
    pub fn folder(&self) -> &RunFolder {
        &self.folder
    }

    /// What a user should know of resuming: other data, another instruction set.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Checkpoints that did not verify on resuming, newest first.
    pub fn skipped(&self) -> &[Skipped] {
        &self.skipped
    }
}

/// Whether an error is a numerical failure, after which the last checkpoint is the state to go back to.
pub fn is_numeric(error: &RunError) -> bool {
    matches!(error, RunError::Train(TrainError::Numeric { .. }))
}

/// A data set of at most `count` evenly spaced views of a split.
pub fn few_views(dataset: &Dataset, split: Split, count: usize) -> Dataset {
    let views = dataset.views(split);
    let count = count.clamp(1, views.len().max(1));
    let kept: Vec<_> = (0..count).filter_map(|i| views.get(i * views.len() / count).cloned()).collect();
    let mut few = dataset.without_views();
    match split {
        Split::Train => few.train = kept,
        Split::Val => few.val = kept,
        Split::Test => few.test = kept,
        Split::Extrapolate => few.extrapolate = kept,
    }
    few
}

#[cfg(test)]
mod tests;
