//! Training: one view per step (or a batch of them), forward through method and rasteriser, back through both, one update of every parameter.
//!
//! Everything a step does is a function of the parameters, their moments, the growth statistics and the step number:
//! views come in a random order that is shuffled anew each epoch from `(seed, epoch)`, so a run stopped at any step and
//! resumed from its [`Checkpoint`] continues bit for bit, on any number of threads.

use crate::adam::{Adam, Refused, Update};
use crate::checkpoint::Checkpoint;
use crate::densify::Adapted;
use crate::loss::{Dssim, LossTerms, Region};
use crate::method::{InitConfig, Method, MethodError, SceneInfo, section};
use crate::registry::Registry;
use crate::saved;
use crate::schedule::FIELD;
use crate::timestamp::Moment;
use gs_core::Param;
use gs_data::{Dataset, ImageCache, View};
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

mod error;
mod render_pass;
mod view_order;

pub use error::TrainError;
pub use render_pass::Phases;
use render_pass::{Drawn, Easel, Sheet, ms_since};
use view_order::ViewOrder;

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

/// What a step did.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StepReport {
    /// Its number, from 1.
    pub step: u32,
    /// The stage it lies in.
    pub stage: String,
    /// The views learnt from.
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
    order: ViewOrder,
    step: u32,
    seconds: f64,
}

impl Trainer {
    /// A run at step 0: `config` is the resolved configuration of the method of that name.
    ///
    /// # Errors
    /// If the method, its configuration or the first points cannot be used.
    pub fn new(
        registry: &Registry,
        dataset: Arc<Dataset>,
        method: &str,
        config: &toml::Table,
        options: TrainOptions,
    ) -> Result<Self, TrainError> {
        let entry = registry.find(method)?;
        let init: InitConfig = section(entry.name, config, "init")?;
        entry.avatar(&dataset)?;
        let scene = SceneInfo::of(&dataset, &init, options.seed)?;
        let method = (entry.build)(config, &scene)?;
        check_run(method.as_ref(), &dataset)?;
        Ok(Self::of(dataset, method, scene, config, options))
    }

    /// A run continued from a checkpoint, with another configuration if one is given (a longer schedule, say).
    ///
    /// # Errors
    /// If the checkpoint does not fit the method, its configuration or the data.
    pub fn resume(
        registry: &Registry,
        dataset: Arc<Dataset>,
        checkpoint: &Checkpoint,
        config: Option<&toml::Table>,
        image_bytes: usize,
    ) -> Result<Self, TrainError> {
        let loaded =
            saved::load_with(registry, checkpoint, config, dataset.avatar.clone()).map_err(TrainError::State)?;
        if dataset.train.len() as u32 != loaded.scene.views {
            let (now, then) = (dataset.train.len(), loaded.scene.views);
            return Err(TrainError::State(format!("the data have {now} training views, the run began with {then}")));
        }
        check_run(loaded.method.as_ref(), &dataset)?;
        let options = TrainOptions { seed: loaded.scene.seed, image_bytes };
        let mut trainer = Self::of(dataset, loaded.method, loaded.scene, &loaded.config, options);
        trainer.step = loaded.step;
        trainer.seconds = loaded.train_seconds;
        trainer.adam.set_updates(loaded.adam_updates);
        Ok(trainer)
    }

    /// The same run on data that hold more views, with another configuration (a longer schedule): parameters, moments of the
    /// optimiser and growth statistics go on bit for bit, and the method is built for the new last training time.
    ///
    /// # Errors
    /// As [`Trainer::resume`].
    pub fn with_more_views(
        self,
        registry: &Registry,
        dataset: Arc<Dataset>,
        config: &toml::Table,
    ) -> Result<Self, TrainError> {
        let scene = self.scene.clone().seen_in(&dataset);
        let state = self.state_as(config, &scene);
        let next = Self::resume(registry, dataset, &state, None, self.options.image_bytes)?;
        Ok(Self { cache: self.cache, ..next })
    }

    fn of(
        dataset: Arc<Dataset>,
        method: Box<dyn Method>,
        scene: SceneInfo,
        config: &toml::Table,
        options: TrainOptions,
    ) -> Self {
        let adam = Adam::default();
        let cache = ImageCache::new(options.image_bytes, 1.0);
        let easel = Easel::new();
        let order = ViewOrder::new(options.seed, dataset.train.iter().map(|v| v.time.normalised).collect());
        let config = config.clone();
        Self { method, dataset, scene, config, options, adam, cache, easel, order, step: 0, seconds: 0.0 }
    }

    /// The whole state, bit for bit.
    pub fn state(&self) -> Checkpoint {
        self.state_as(&self.config, &self.scene)
    }

    /// What drawing the scene as it stands needs ([`saved::look`]).
    pub fn look(&self) -> Checkpoint {
        saved::look(self.method.as_ref(), &self.run_state(&self.config, &self.scene))
    }

    fn state_as(&self, config: &toml::Table, scene: &SceneInfo) -> Checkpoint {
        saved::save(self.method.as_ref(), &self.run_state(config, scene))
    }

    fn run_state<'a>(&'a self, config: &'a toml::Table, scene: &'a SceneInfo) -> saved::RunState<'a> {
        saved::RunState {
            method: self.method.name(),
            config,
            scene,
            step: self.step,
            adam_updates: self.adam.updates(),
            train_seconds: self.seconds,
        }
    }

    /// Makes the next step.
    ///
    /// # Errors
    /// At the end of the schedule, if the photograph cannot be read, or if gradients are not finite. After a numerical
    /// failure the parameters are to be thrown away.
    pub fn step(&mut self) -> Result<StepReport, TrainError> {
        // Entered once, the pool runs a step's many short loops without a change of threads for each.
        rayon::scope(|_| self.step_in_pool())
    }

    fn step_in_pool(&mut self) -> Result<StepReport, TrainError> {
        let begun = Instant::now();
        let step = self.step + 1;
        if step > self.steps() {
            return Err(TrainError::Finished(self.steps()));
        }
        self.begin_stage(step);
        self.method.set_step(step);
        let (drawn, views) = self.learn(step)?;
        let mut ms = drawn.ms;
        let regular = Instant::now();
        let penalties = self.method.penalties(step);
        ms.field += ms_since(regular);

        let updated = Instant::now();
        let refused = self.update(step);
        ms.adam = ms_since(updated);
        self.check_refused(&refused, step, &views)?;

        let adapting = Instant::now();
        let adapted = self.method.adapt(step);
        ms.adapt = ms_since(adapting);
        self.step = step;
        ms.total = ms_since(begun);
        self.seconds += ms.total * 1e-3;
        Ok(StepReport {
            step,
            stage: self.stage_name(step),
            view: views,
            loss: drawn.terms,
            penalties,
            splats: self.method.len(),
            quarantined: drawn.quarantine.rows.max(refused.rows),
            adapted,
            ms,
        })
    }

    /// Gradients of the mean loss of the step's views, and the names of these.
    fn learn(&mut self, step: u32) -> Result<(Drawn, String), TrainError> {
        let dataset = self.dataset.clone();
        let batch = self.method.schedule().batch;
        let (mut sum, mut names) = (Drawn::default(), Vec::new());
        for draw in (step - 1) * batch + 1..=step * batch {
            let view = &dataset.train[self.order.view(self.method.schedule(), draw)];
            let drawn = self.learn_view(view, draw, 1.0 / batch as f32)?;
            self.check_drawn(&drawn, step, view)?;
            sum.add(&drawn, f64::from(batch));
            names.push(view.name.as_str());
        }
        Ok((sum, names.join(", ")))
    }

    /// One view, which counts with its share in the step: gradients and statistics.
    fn learn_view(&mut self, view: &View, draw: u32, share: f32) -> Result<Drawn, TrainError> {
        let begun = Instant::now();
        let (mut drawn, at) = (Drawn::default(), Moment::new(view.time));
        if !self.method.looks() {
            self.method.step(&at, &self.cache.camera(view), &mut |_, _| ());
            drawn.ms.field = ms_since(begun);
            return self.check_trouble().map(|()| drawn);
        }
        let sheet = self.photograph(view, draw, share)?;
        let data = ms_since(begun);
        let easel = &mut self.easel;
        self.method.step(&at, &sheet.camera, &mut |splats, d| drawn = easel.draw(splats, &sheet, d));
        self.check_trouble()?;
        if drawn.error.is_none() {
            self.method.observe(&at, &self.easel.stats, &sheet.camera);
        }
        let ms = &mut drawn.ms;
        ms.data = data;
        ms.field = ms_since(begun) - data - ms.raster_forward - ms.loss - ms.raster_backward;
        Ok(drawn)
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

    /// What the method has to tell since the last call; see [`Method::journal`]. Every line names its `step`.
    pub fn journal(&mut self) -> Vec<serde_json::Value> {
        self.method.journal()
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

    fn photograph(&self, view: &View, draw: u32, share: f32) -> Result<Sheet, TrainError> {
        let schedule = self.method.schedule();
        let background = schedule.background.color(self.options.seed, draw);
        let image = self.cache.get(view)?;
        let mut weights = schedule.loss();
        if weights.structure == Dssim::SsimBox || weights.mrf > 0.0 {
            weights.region = Region::shown(&image);
        }
        Ok(Sheet {
            camera: self.cache.camera(view),
            options: schedule.raster_options(background),
            target: image.over(background),
            weights,
            share,
        })
    }

    fn update(&mut self, step: u32) -> Refused {
        let mut refused = Refused::default();
        let schedule = self.method.schedule();
        let extent = self.scene.extent;
        let mut updates: BTreeMap<String, Update> = BTreeMap::new();
        self.method.visit(&mut |p| {
            updates.extend(schedule.update(p, step, extent).map(|update| (p.name.clone(), update)));
        });
        let adam = &mut self.adam;
        self.method.visit_mut(&mut |p| match updates.get(&p.name) {
            Some(update) => adam.update(p, *update, &mut refused),
            None => p.clear_grad(),
        });
        refused
    }

    fn check_trouble(&self) -> Result<(), TrainError> {
        self.method.trouble().map_or(Ok(()), |why| Err(MethodError::Scene(why).into()))
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

    fn check_refused(&self, refused: &Refused, step: u32, views: &str) -> Result<(), TrainError> {
        let numeric = |what| Err(TrainError::Numeric { step, view: views.to_owned(), what });
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

/// Refuses, before the first step, images the loss is not defined for and stages in which nothing would learn.
fn check_run(method: &dyn Method, dataset: &Dataset) -> Result<(), MethodError> {
    let schedule = method.schedule();
    schedule.check_images(dataset.train.iter().map(|v| &v.camera))?;
    let mut has_field = false;
    method.visit(&mut |p| has_field |= p.name.starts_with(FIELD));
    match schedule.ordered().into_iter().find(|(_, stage)| stage.field_alone && !has_field) {
        None => Ok(()),
        Some((name, _)) => {
            let why = format!(
                "only the field learns in stage `{name}` (field_alone), and this method has none; set it false"
            );
            Err(MethodError::Config { method: method.name(), why })
        }
    }
}
