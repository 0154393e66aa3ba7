//! Training: one view per step, forward through method and rasteriser, back through both, one update of every parameter.
//!
//! Everything a step does is a function of the parameters, their moments, the growth statistics and the step number:
//! views come in a random order that is drawn anew each epoch from `(seed, epoch)`, so a run stopped at any step and
//! resumed from its [`Checkpoint`] continues bit for bit, on any number of threads.

use crate::adam::{Adam, AdamOptions, Refused};
use crate::checkpoint::Checkpoint;
use crate::data::{DataError, Dataset, ImageCache, View};
use crate::density::Adapted;
use crate::guard::{Quarantine, quarantine};
use crate::loss::{ImageLoss, LossTerms};
use crate::methods::{self, InitConfig, Method, MethodEntry, MethodError, SceneInfo};
use crate::moment::Moment;
use gs_core::{Camera, Image, Param, Rng, Splats, SplatsGrad};
use gs_metrics::MetricError;
use gs_raster::{Frame, FrameGrad, RasterOptions, ScreenStats, Workspace, render_backward_into, render_into};
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

/// What a run needs beside data and configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainOptions {
    /// Seed of every random number.
    pub seed: u64,
    /// Decoded images kept in memory, at most, bytes.
    pub image_bytes: usize,
}

impl Default for TrainOptions {
    /// Seed 0, 512 MiB of images.
    fn default() -> Self {
        Self { seed: 0, image_bytes: 512 << 20 }
    }
}

/// Why training cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The data cannot be read.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The method cannot be built.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// Gradients were not finite, too many or in a weight that all splats share. The parameters are to be thrown away.
    #[error("step {step}, view {view}: {what}; go back to the last checkpoint and lower the learning rates")]
    Numeric {
        /// Step being made.
        step: u32,
        /// View being learnt from.
        view: String,
        /// What was met, and where.
        what: String,
    },
    /// A checkpoint does not fit.
    #[error("checkpoint: {0}")]
    State(String),
    /// The schedule is at its end.
    #[error("the schedule ends at step {0}; lengthen a stage to go on")]
    Finished(u32),
}

impl TrainError {
    /// The exit code of the command line: 3 data, 4 numerical failure, 2 wrong usage.
    pub fn exit_code(&self) -> u8 {
        match self {
            TrainError::Data(_) => 3,
            TrainError::Numeric { .. } => 4,
            TrainError::Method(_) | TrainError::State(_) | TrainError::Finished(_) => 2,
        }
    }
}

/// Milliseconds of the phases of a step.
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize)]
pub struct Phases {
    /// Fetching and compositing the photograph.
    pub data: f64,
    /// Cloud and field, forward and backward, and penalties.
    pub field: f64,
    /// Drawing.
    pub raster_forward: f64,
    /// Image loss and its gradient.
    pub loss: f64,
    /// Drawing, backward.
    pub raster_backward: f64,
    /// The optimiser.
    pub adam: f64,
    /// Density control.
    pub adapt: f64,
    /// The whole step.
    pub total: f64,
}

/// What a step did.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StepReport {
    /// Its number, from 1.
    pub step: u32,
    /// The stage it lies in.
    pub stage: String,
    /// The view learnt from.
    pub view: String,
    /// The image loss.
    pub loss: LossTerms,
    /// Regularisers, weights applied.
    pub penalties: Vec<(&'static str, f32)>,
    /// Splats after the step.
    pub splats: usize,
    /// Gradient rows refused because they were not finite.
    pub quarantined: u32,
    /// What density control did.
    pub adapted: Adapted,
    /// Milliseconds per phase.
    pub ms: Phases,
}

/// Scratch of the drawing side, reused between steps.
#[derive(Default)]
struct Easel {
    workspace: Workspace,
    frame: Frame,
    d_frame: FrameGrad,
    stats: ScreenStats,
    loss: ImageLoss,
}

/// What drawing found.
#[derive(Default)]
struct Drawn {
    terms: LossTerms,
    quarantine: Quarantine,
    error: Option<MetricError>,
    ms: Phases,
}

/// A run in memory.
pub struct Trainer {
    method: Box<dyn Method>,
    dataset: Arc<Dataset>,
    scene: SceneInfo,
    config: toml::Table,
    options: TrainOptions,
    adam: Adam,
    cache: ImageCache,
    easel: Easel,
    step: u32,
    seconds: f64,
}

impl Trainer {
    /// A run at step 0: `config` is the resolved configuration of the method of that name.
    ///
    /// # Errors
    /// If the method, its configuration or the first points cannot be used.
    pub fn new(
        dataset: Arc<Dataset>,
        method: &str,
        config: &toml::Table,
        options: TrainOptions,
    ) -> Result<Self, TrainError> {
        let entry = MethodEntry::find(method)?;
        let init: InitConfig = methods::section(entry.name, config, "init")?;
        let scene = SceneInfo::of(&dataset, &init, options.seed)?;
        let method = (entry.build)(config, &scene)?;
        Ok(Self::of(dataset, method, scene, config, options))
    }

    /// A run continued from a checkpoint, with another configuration if one is given (a longer schedule, say).
    ///
    /// # Errors
    /// If the checkpoint does not fit the method, its configuration or the data.
    pub fn resume(
        dataset: Arc<Dataset>,
        checkpoint: &Checkpoint,
        config: Option<&toml::Table>,
        image_bytes: usize,
    ) -> Result<Self, TrainError> {
        let loaded = methods::saved::load(checkpoint, config).map_err(TrainError::State)?;
        if dataset.train.len() as u32 != loaded.scene.views {
            let (now, then) = (dataset.train.len(), loaded.scene.views);
            return Err(TrainError::State(format!("the data have {now} training views, the run began with {then}")));
        }
        let options = TrainOptions { seed: loaded.scene.seed, image_bytes };
        let mut trainer = Self::of(dataset, loaded.method, loaded.scene, &loaded.config, options);
        trainer.step = loaded.step;
        trainer.seconds = loaded.train_seconds;
        trainer.adam.set_updates(loaded.adam_updates);
        Ok(trainer)
    }

    fn of(
        dataset: Arc<Dataset>,
        method: Box<dyn Method>,
        scene: SceneInfo,
        config: &toml::Table,
        options: TrainOptions,
    ) -> Self {
        let schedule = method.schedule();
        let adam = Adam::new(AdamOptions { sparse: schedule.sparse_adam, ..AdamOptions::default() });
        let cache = ImageCache::new(options.image_bytes, 1.0);
        let easel = Easel { loss: ImageLoss::new(), ..Easel::default() };
        let config = config.clone();
        Self { method, dataset, scene, config, options, adam, cache, easel, step: 0, seconds: 0.0 }
    }

    /// The whole state, bit for bit.
    pub fn state(&self) -> Checkpoint {
        let run = methods::saved::RunState {
            method: self.method.name(),
            config: &self.config,
            scene: &self.scene,
            step: self.step,
            adam_updates: self.adam.updates(),
            train_seconds: self.seconds,
        };
        methods::saved::save(self.method.as_ref(), &run)
    }

    /// Makes the next step.
    ///
    /// # Errors
    /// At the end of the schedule, if the photograph cannot be read, or if gradients are not finite. After a numerical
    /// failure the parameters are to be thrown away.
    pub fn step(&mut self) -> Result<StepReport, TrainError> {
        let begun = Instant::now();
        let step = self.step + 1;
        if step > self.steps() {
            return Err(TrainError::Finished(self.steps()));
        }
        self.begin_stage(step);
        let dataset = self.dataset.clone();
        let view = &dataset.train[view_of_step(self.options.seed, step, dataset.train.len())];
        let (camera, target, options) = self.photograph(view, step)?;
        let data_ms = ms_since(begun);

        let fielded = Instant::now();
        self.method.set_step(step);
        let (mut drawn, lambda) = (Drawn::default(), self.method.schedule().lambda_dssim);
        let easel = &mut self.easel;
        self.method.step(&Moment::new(view.time), &camera, &mut |splats, d| {
            drawn = easel.draw(splats, &camera, &options, &target, lambda, d);
        });
        let penalties = self.method.penalties(step);
        let mut ms = Phases { data: data_ms, ..drawn.ms };
        ms.field = ms_since(fielded) - ms.raster_forward - ms.loss - ms.raster_backward;
        self.check_drawn(&drawn, step, view)?;

        let updated = Instant::now();
        let refused = self.update(step);
        ms.adam = ms_since(updated);
        self.check_refused(&refused, step, view)?;

        let adapting = Instant::now();
        let adapted = self.method.adapt(step, &self.easel.stats, &camera);
        ms.adapt = ms_since(adapting);
        self.step = step;
        ms.total = ms_since(begun);
        self.seconds += ms.total * 1e-3;
        Ok(StepReport {
            step,
            stage: self.stage_name(step),
            view: view.name.clone(),
            loss: drawn.terms,
            penalties,
            splats: self.method.len(),
            quarantined: drawn.quarantine.rows.max(refused.rows),
            adapted,
            ms,
        })
    }

    /// Steps made.
    pub fn steps_done(&self) -> u32 {
        self.step
    }

    /// Steps of the whole schedule.
    pub fn steps(&self) -> u32 {
        self.method.schedule().steps()
    }

    /// Seconds spent in steps, over all sessions of the run.
    pub fn train_seconds(&self) -> f64 {
        self.seconds
    }

    /// The method under training.
    pub fn method(&self) -> &dyn Method {
        self.method.as_ref()
    }

    /// What the method was built from.
    pub fn scene(&self) -> &SceneInfo {
        &self.scene
    }

    /// The data.
    pub fn dataset(&self) -> &Arc<Dataset> {
        &self.dataset
    }

    /// Images shrink and optimisers forget at the border of stages.
    fn begin_stage(&mut self, step: u32) {
        let scale = self.method.schedule().stage(step).map_or(1.0, |s| s.image_scale);
        if scale != self.cache.scale() {
            self.cache = ImageCache::new(self.options.image_bytes, scale);
        }
        if self.method.schedule().position(step).fresh {
            self.method.visit_mut(&mut Param::clear_moments);
            self.adam.restart();
        }
    }

    fn photograph(&self, view: &View, step: u32) -> Result<(Camera, Image, RasterOptions), TrainError> {
        let schedule = self.method.schedule();
        let background = schedule.background.color(self.options.seed, step);
        let image = self.cache.get(view)?;
        Ok((self.cache.camera(view), image.over(background), schedule.raster_options(background)))
    }

    fn update(&mut self, step: u32) -> Refused {
        let mut refused = Refused::default();
        let schedule = self.method.schedule();
        let clock = schedule.position(step).clock;
        let (eps, extent) = (schedule.adam_eps, self.scene.extent);
        let mut rates: BTreeMap<String, f32> = BTreeMap::new();
        self.method.visit(&mut |p| {
            let rate = schedule.rule(&p.name).map_or(0.0, |rule| rule.at(clock, extent));
            rates.insert(p.name.clone(), rate);
        });
        let adam = &mut self.adam;
        self.method.visit_mut(&mut |p| match rates.get(&p.name).copied() {
            Some(rate) if rate > 0.0 => adam.update(p, rate, eps, &mut refused),
            _ => p.clear_grad(),
        });
        refused
    }

    fn check_drawn(&self, drawn: &Drawn, step: u32, view: &View) -> Result<(), TrainError> {
        let numeric = |what| Err(TrainError::Numeric { step, view: view.name.clone(), what });
        if let Some(e) = &drawn.error {
            return numeric(e.to_string());
        }
        let (rows, of) = (drawn.quarantine.rows, self.easel.stats.radii.len());
        match drawn.quarantine.first {
            Some(first) if self.too_many(rows, of) => {
                numeric(format!("{rows} of {of} splats have gradients that are not finite, the first is splat {first}"))
            }
            _ => Ok(()),
        }
    }

    fn check_refused(&self, refused: &Refused, step: u32, view: &View) -> Result<(), TrainError> {
        let numeric = |what| Err(TrainError::Numeric { step, view: view.name.clone(), what });
        if let Some(name) = &refused.shared {
            return numeric(format!("the gradient of the shared weights `{name}` is not finite"));
        }
        match &refused.first {
            Some((name, row)) if self.too_many(refused.rows, refused.of as usize) => {
                let (rows, of) = (refused.rows, refused.of);
                numeric(format!("{rows} of {of} gradient rows are not finite, the first is row {row} of `{name}`"))
            }
            _ => Ok(()),
        }
    }

    fn too_many(&self, rows: u32, of: usize) -> bool {
        f64::from(rows) > f64::from(self.method.schedule().max_quarantine) * of as f64
    }

    fn stage_name(&self, step: u32) -> String {
        let schedule = self.method.schedule();
        schedule.ordered().get(schedule.position(step).stage).map_or(String::new(), |s| s.0.to_owned())
    }
}

impl Easel {
    /// Draws, compares, and pulls the loss back to the splats.
    fn draw(
        &mut self,
        splats: &Splats,
        camera: &Camera,
        options: &RasterOptions,
        target: &Image,
        lambda: f32,
        d: &mut SplatsGrad,
    ) -> Drawn {
        let mut drawn = Drawn::default();
        let begun = Instant::now();
        render_into(splats, camera, options, &mut self.workspace, &mut self.frame);
        drawn.ms.raster_forward = ms_since(begun);
        let begun = Instant::now();
        match self.loss.evaluate(&mut self.frame, target, lambda, &mut self.d_frame) {
            Ok(terms) => drawn.terms = terms,
            Err(e) => {
                drawn.error = Some(e);
                return drawn;
            }
        }
        drawn.ms.loss = ms_since(begun);
        let begun = Instant::now();
        render_backward_into(splats, camera, options, &mut self.workspace, &self.d_frame, d, &mut self.stats);
        drawn.quarantine = quarantine(d);
        drawn.ms.raster_backward = ms_since(begun);
        drawn
    }
}

/// Index of the view of a step (from 1): every view once per epoch, in a random order of its own.
pub fn view_of_step(seed: u64, step: u32, views: usize) -> usize {
    let n = views.max(1) as u32;
    let (epoch, at) = ((step - 1) / n, (step - 1) % n);
    Rng::new(seed, "view-order", epoch, 0).permutation(n as usize)[at as usize] as usize
}

fn ms_since(begun: Instant) -> f64 {
    begun.elapsed().as_secs_f64() * 1e3
}
