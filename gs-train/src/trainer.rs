//! Training: one view per step (or a batch of them), forward through method and rasteriser, backward through both, one
//! update of every parameter.
//!
//! Everything a step does is a function of the parameters, their Adam moments, the buffers and the step number:
//! views come in a random order that is shuffled anew each epoch from `(seed, epoch)`, so a run stopped at any step and
//! resumed from its [`Checkpoint`] continues bit for bit, on any number of threads.

use crate::adam::{Adam, Refused, Update};
use crate::checkpoint::Checkpoint;
use crate::densify::DensifyStats;
use crate::device::Device;
use crate::loss::LossValues;
use crate::method::MethodError;
use crate::model::Model;
use crate::registry::{Registry, section};
use crate::saved;
use crate::scene::{InitConfig, SceneInfo};
use crate::schedule::{FIELD, Schedule};
use gs_core::Param;
use gs_data::{Dataset, ImageCache};
use serde::Serialize;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

mod coding;
mod error;
mod learn;
mod on_device;
mod prefetch;
mod render_pass;
mod share;
mod sums;
mod team;
mod view_order;

pub use error::TrainError;
use learn::Learnt;
use on_device::Resident;
use prefetch::Prefetch;
pub use render_pass::Phases;
use render_pass::{RenderPass, Stopwatch};
use team::{Command, Team, all_gather_results, lost};
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

/// What one step of training did.
#[derive(Clone, Debug, PartialEq, Default, Serialize)]
pub struct StepReport {
    /// Number of the step, from 1.
    pub step: u32,
    /// The stage it lies in.
    pub stage: String,
    /// Names of the views of its batch.
    pub view: String,
    /// Image loss, mean over the views of the batch.
    pub loss: LossValues,
    /// Terms of the method's own and regularisers by name, weights applied, summed over views.
    pub penalties: Vec<(Cow<'static, str>, f32)>,
    /// Splats after the step, at most.
    pub splats: usize,
    /// Gradient rows refused because they were not finite.
    pub quarantined: u32,
    /// What density control and resets changed.
    pub adapted: DensifyStats,
    /// Events worth keeping, one JSON object each.
    pub events: Vec<serde_json::Value>,
    /// Time of each phase, milliseconds.
    pub ms: Phases,
    /// Bytes that this rank sent to others.
    pub sent_bytes: u64,
}

/// One run of a method on a data set, held in memory.
pub struct Trainer {
    model: Model,
    dataset: Arc<Dataset>,
    scene: SceneInfo,
    config: toml::Table,
    options: TrainOptions,
    adam: Adam,
    images: Arc<ImageCache>,
    prefetch: Prefetch,
    pass: RenderPass,
    device: Device,
    resident: Resident,
    order: ViewOrder,
    /// Update rules of the present step, by the name of a block.
    updates: BTreeMap<String, Option<Update>>,
    step: u32,
    seconds: f64,
    ranks: Team,
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
        entry.check(config)?;
        let init: InitConfig = section(entry.name, config, "init")?;
        entry.avatar(&dataset)?;
        let scene = SceneInfo::of(&dataset, &init, options.seed)?;
        let model = entry.model(config, &scene)?;
        Ok(Self { config: config.clone(), ..Self::with_method(model, dataset, scene, options)? })
    }

    /// A run at step 0 of a model that was built by hand.
    ///
    /// # Errors
    /// If its schedule does not fit the images or its parameters.
    pub fn with_method(
        mut model: Model,
        dataset: Arc<Dataset>,
        scene: SceneInfo,
        options: TrainOptions,
    ) -> Result<Self, TrainError> {
        check_run(&model, &dataset)?;
        let middle = 0.5 * (scene.bounds[0] + scene.bounds[1]);
        model.cameras_mut().add_missing(&dataset.train, middle.as_dvec3(), scene.extent);
        if model.cameras().config().time && !model.cameras().has_clocks() {
            let why = "cameras.time is on, and no camera has training images of several times (the data tell cameras apart by \
                       their numbers: `camera_index` in nerfstudio's layout; D-NeRF's has none); set it false";
            return Err(MethodError::Config { method: model.name(), why: why.into() }.into());
        }
        let images = Arc::new(image_cache(&dataset, &options, 1.0));
        let order = ViewOrder::new(options.seed, gs_data::moments::of_views(&dataset.train));
        let (adam, pass, config, updates) = (
            Adam::new(model.schedule().adam()),
            RenderPass::new(model.take_image_loss()),
            toml::Table::new(),
            BTreeMap::new(),
        );
        Ok(Self {
            model,
            dataset,
            scene,
            config,
            options,
            adam,
            images,
            prefetch: Prefetch::default(),
            pass,
            device: Device::default(),
            resident: Resident::default(),
            order,
            updates,
            step: 0,
            seconds: 0.0,
            ranks: Team::default(),
        })
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
        let options = TrainOptions { seed: loaded.scene.seed, image_bytes };
        let mut trainer = Self::with_method(loaded.model, dataset, loaded.scene, options)?;
        trainer.config = loaded.config;
        trainer.step = loaded.step;
        trainer.seconds = loaded.train_seconds;
        trainer.adam.set_updates(loaded.adam_updates);
        Ok(trainer)
    }

    /// The same run on data that hold more views, with another configuration (a longer schedule): parameters, moments of the
    /// optimiser and buffers go on bit for bit, and the method is built for the new last training time. Exposures of images are fitted anew
    /// where there are others.
    ///
    /// # Errors
    /// As [`Trainer::resume`].
    pub fn with_more_views(
        mut self,
        registry: &Registry,
        dataset: Arc<Dataset>,
        config: &toml::Table,
    ) -> Result<Self, TrainError> {
        self.fetch()?;
        let next = Self::resume_with_more_views(registry, dataset, &self.state(), config, self.options.image_bytes)?;
        Ok(Self { images: self.images, ..next.on(&self.device)? })
    }

    /// A run continued from a checkpoint on data that may hold more views ([`Trainer::with_more_views`]).
    ///
    /// # Errors
    /// As [`Trainer::resume`].
    pub fn resume_with_more_views(
        registry: &Registry,
        dataset: Arc<Dataset>,
        checkpoint: &Checkpoint,
        config: &toml::Table,
        image_bytes: usize,
    ) -> Result<Self, TrainError> {
        let mut loaded =
            saved::load_with(registry, checkpoint, None, dataset.avatar.clone()).map_err(TrainError::State)?;
        loaded.model.exposures_mut().keep_of(dataset.train.len());
        let (scene, adam_updates) = (loaded.scene.seen_in(&dataset), &loaded.adam_updates);
        let (step, train_seconds) = (loaded.step, loaded.train_seconds);
        let run = saved::RunState { config, scene: &scene, step, adam_updates, train_seconds };
        Self::resume(registry, dataset, &saved::save(&loaded.model, &run), None, image_bytes)
    }

    /// The whole state, bit for bit. With ranks or a device that makes whole steps, [`Self::gather`] is called first.
    pub fn state(&self) -> Checkpoint {
        debug_assert!(!self.resident.is_newer(), "gather first");
        saved::save(&self.model, &self.run_state(&self.config, &self.scene))
    }

    /// What rendering the scene as it stands needs ([`saved::save_for_rendering`]). [`Self::fetch`] is called first.
    pub fn state_for_rendering(&self) -> Checkpoint {
        debug_assert!(!self.resident.is_newer(), "fetch first");
        saved::save_for_rendering(&self.model, &self.run_state(&self.config, &self.scene))
    }

    fn run_state<'a>(&'a self, config: &'a toml::Table, scene: &'a SceneInfo) -> saved::RunState<'a> {
        saved::RunState {
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
    /// At the end of the schedule, if an image cannot be read, the device fails, or gradients are not finite. After a failure in
    /// the step the state is to be thrown away: the last checkpoint is good.
    pub fn step(&mut self) -> Result<StepReport, TrainError> {
        self.ask(Command::Step)?;
        let made = self.step_with_ranks();
        self.ranks.done(made, lost)
    }

    fn step_with_ranks(&mut self) -> Result<StepReport, TrainError> {
        // Entered once, the pool runs a step's many short loops without a change of threads for each.
        rayon::scope(|_| self.step_in_pool())
    }

    fn step_in_pool(&mut self) -> Result<StepReport, TrainError> {
        let mut whole = Stopwatch::new();
        let step = self.step + 1;
        if step > self.steps() {
            return Err(TrainError::Finished(self.steps()));
        }
        self.begin_step(step)?;
        let mut log = Vec::new();
        let (learnt, refused) = match self.step_on_device(step, &mut log)? {
            Some(done) => done,
            None => {
                self.leave_device()?;
                let mut learnt = self.learn(step)?;
                let refused = self.update(&mut learnt.ms)?;
                (learnt, refused)
            }
        };
        let Learnt { loss, penalties, refused: refused_in_views, views, mut ms } = learnt;
        self.check_refused(&refused, step, &views)?;

        let mut clock = Stopwatch::new();
        if self.model.needs_whole_rows() {
            self.share_rows()?;
        }
        ms.exchange += clock.lap();
        let events = self.model.end_step().map_err(TrainError::from);
        let events = match self.ranks.size() {
            1 => events?,
            _ => all_gather_results(&*self.ranks, events.map(|events| ((), events)))?.1,
        };
        ms.adapt = clock.lap();
        self.step = step;
        self.compare_ranks_at_times()?;
        ms.total = whole.lap();
        self.seconds += ms.total * 1e-3;
        Ok(StepReport {
            step,
            stage: self.schedule().at(step).stage,
            view: views,
            loss,
            penalties,
            splats: self.model.splat_count(),
            quarantined: refused_in_views.max(refused.rows),
            adapted: events.densified,
            events: log.into_iter().chain(events.log).collect(),
            ms,
            sent_bytes: self.ranks.take_sent(),
        })
    }

    /// The size of training images and the moments of the optimiser change at the border of stages, rates with every step.
    fn begin_step(&mut self, step: u32) -> Result<(), TrainError> {
        let scale = self.schedule().stage(step).map_or(1.0, |s| s.image_scale);
        if scale != self.images.scale() {
            self.images = Arc::new(image_cache(&self.dataset, &self.options, scale));
        }
        if self.schedule().position(step).fresh {
            self.leave_device()?;
            self.model.visit_mut(&mut Param::clear_moments);
            self.adam.restart();
        }
        self.model.begin_step(step);
        let (model, extent, updates) = (&self.model, self.scene.extent, &mut self.updates);
        model.visit(&mut |p| match updates.get_mut(&p.name) {
            Some(update) => *update = model.update(p, step, extent),
            None => {
                updates.insert(p.name.clone(), model.update(p, step, extent));
            }
        });
        Ok(())
    }

    /// Optimizer steps made, those of earlier sessions included.
    pub fn steps_done(&self) -> u32 {
        self.step
    }

    /// Steps of the whole schedule.
    pub fn steps(&self) -> u32 {
        self.schedule().steps()
    }

    /// Seconds spent in steps, over all sessions of the run.
    pub fn train_seconds(&self) -> f64 {
        self.seconds
    }

    /// The model with the parameters reached so far; [`Self::fetch`] is called first.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Stages, learning rates and weights of the loss.
    pub fn schedule(&self) -> &Schedule {
        self.model.schedule()
    }

    /// What the method was built from.
    pub fn scene(&self) -> &SceneInfo {
        &self.scene
    }

    /// The data set the run learns from.
    pub fn dataset(&self) -> &Arc<Dataset> {
        &self.dataset
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
        f64::from(rows) > f64::from(self.schedule().max_quarantine) * of as f64
    }
}

/// A cache of the images of a run at a scale, within its own limit and that of its data.
fn image_cache(dataset: &Dataset, options: &TrainOptions, scale: f64) -> ImageCache {
    ImageCache::new(options.image_bytes, scale).with_max_image_mib(dataset.max_image_mib)
}

/// Refuses, before the first step, images the loss is not defined for and stages in which nothing would learn.
fn check_run(model: &Model, dataset: &Dataset) -> Result<(), MethodError> {
    let schedule = model.schedule();
    schedule.check_images(dataset.train.iter().map(|v| &v.camera))?;
    if schedule.lambda_depth > 0.0 && dataset.train.iter().all(|v| v.depth.is_none()) {
        let why = "schedule.lambda_depth is above 0, and no training view has a depth map; set it 0".into();
        return Err(MethodError::Config { method: model.name(), why });
    }
    let (steps, views) = (schedule.steps(), dataset.train.len());
    let shortest = schedule.shortest(views);
    if u64::from(steps) < shortest && schedule.ordered().iter().any(|(_, s)| s.window(0).is_some()) {
        let why = format!(
            "images are let in by time, and {steps} steps would never draw some of the {views} training views; --steps {shortest} \
             draws them all"
        );
        return Err(MethodError::Config { method: model.name(), why });
    }
    let mut has_field = false;
    model.visit(&mut |p| has_field |= p.name.starts_with(FIELD));
    match schedule.ordered().into_iter().find(|(_, stage)| stage.field_alone && !has_field) {
        None => Ok(()),
        Some((name, _)) => {
            let why = format!(
                "only the field learns in stage `{name}` (field_alone), and this method has none; set it false"
            );
            Err(MethodError::Config { method: model.name(), why })
        }
    }
}
