//! The training loop: steps, log lines, checkpoints, evaluations, and its three outcomes.

mod beginning;
mod stage;
mod warnings;
mod window;

use super::RunError;
use super::folder::{self, RunFolder};
use super::log::Log;
use super::opened::metrics_json;
use super::saving::Patience;
use super::settings::Resolved;
use super::summary::{ReportInput, build_report};
pub use beginning::ResumeRequest;
use gs_core::io::cameras::{NamedCamera, save_cameras};
use gs_core::io::write_file;
use gs_data::{Dataset, ImageCache, Split};
use gs_train::checkpoint::Skipped;
use gs_train::evaluate::{EvalReport, Scoring, evaluate_with};
use gs_train::ranks::Share;
use gs_train::renderer::file_stem;
use gs_train::trainer::{TrainError, Trainer};
use gs4d_report::analysis::Snapshot;
use gs4d_report::png;
use serde_json::json;
pub use stage::{Scored, Stage};
use std::path::PathBuf;
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

impl Training {
    /// Sets what happens when the disk refuses: a checkpoint is tried again after each of the `pauses` (default: 1, 5 and 20
    /// seconds), and `warn` is called with what was refused (default: a line on stderr). Lines of the logs are kept and written later.
    pub fn when_the_disk_refuses(&mut self, pauses: Vec<Duration>, warn: impl Fn(&str) + Send + 'static) {
        self.patience = Patience { pauses, warn: Box::new(warn) };
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

/// A data set of at most `count` evenly spaced views of a split, one at least.
pub fn few_views(dataset: &Dataset, split: Split, count: usize) -> Dataset {
    let views = dataset.views(split);
    let kept: Vec<_> = gs_data::evenly(views.len(), count.max(1)).map(|k| views[k].clone()).collect();
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
