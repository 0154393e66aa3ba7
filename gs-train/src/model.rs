//! A method with the schedule it is trained by.

use crate::adam::Update;
use crate::cameras::{CameraConfig, Cameras, KnownCamera};
use crate::capabilities::{Capabilities, FreezeOptions, FreezeReport, Overlay, Quantity, StageView};
use crate::loss::{ExposureFit, Exposures, ImageLoss, LossTerm};
use crate::method::{Method, MethodError};
use crate::report::Section;
use crate::schedule::Schedule;
use crate::timestamp::Timestamp;
use gs_core::{Camera, Param, Params, Splats};
use gs_raster::RasterOptions;
use serde_json::Value;
use std::any::Any;
use std::ops::{Deref, DerefMut};

/// A method, its name and its schedule: all that training and rendering need. It dereferences to its [`Method`].
pub struct Model {
    name: &'static str,
    method: Box<dyn Method>,
    schedule: Schedule,
    /// Terms of the image loss beside those of the schedule, with their weights.
    losses: Vec<(f32, Box<dyn LossTerm>)>,
    /// Whether there were any.
    own_losses: bool,
    cameras: Cameras,
    /// Maps to the colours of training images.
    exposures: Exposures,
}

impl Model {
    /// A method of this name, about to make its first step.
    ///
    /// # Errors
    /// If the schedule cannot be followed.
    pub fn new(name: &'static str, method: impl Method + 'static, schedule: Schedule) -> Result<Self, MethodError> {
        schedule.check()?;
        let (losses, cameras) = Default::default();
        let exposures = Exposures::default();
        let method: Box<dyn Method> = Box::new(method);
        let mut model = Self { name, method, schedule, losses, own_losses: false, cameras, exposures };
        model.begin_step(0);
        Ok(model)
    }

    /// The same with a term of the method's own in the image loss; at weight 0 it is not computed.
    pub fn with_loss(mut self, weight: f32, term: impl LossTerm + 'static) -> Self {
        self.losses.push((weight, Box::new(term)));
        self.own_losses |= weight > 0.0;
        self
    }

    /// The same with corrections of zero for cameras.
    pub(crate) fn with_cameras(self, config: CameraConfig, known: Vec<KnownCamera>) -> Self {
        Self { cameras: Cameras::new(config, known), ..self }
    }

    /// Corrections of the training cameras; empty where none are learnt.
    pub fn cameras(&self) -> &Cameras {
        &self.cameras
    }

    /// The same, to change them.
    pub(crate) fn cameras_mut(&mut self) -> &mut Cameras {
        &mut self.cameras
    }

    /// How a parameter is updated in the step begun, if it learns then; `extent` is that of the scene, world units. Corrections of
    /// cameras rest while only the field learns.
    pub(crate) fn update(&self, p: &Param, step: u32, extent: f32) -> Option<Update> {
        if !Cameras::owns(&p.name) {
            return self.schedule.update(p, step, extent).filter(|_| self.method.takes_part(&p.name));
        }
        let share = f64::from(step.saturating_sub(1)) / f64::from(self.schedule.steps().max(1));
        self.cameras.update(&p.name, share, extent).filter(|_| !self.schedule.field_alone(step))
    }

    /// Whether corrections of poses learn in a step.
    pub(crate) fn refines_cameras(&self, step: u32) -> bool {
        let learns = |p: &Param| !Cameras::is_clocks(&p.name) && self.update(p, step, 1.0).is_some();
        self.cameras.blocks().iter().any(learns)
    }

    /// Whether offsets of clocks learn in a step.
    pub(crate) fn refines_clocks(&self, step: u32) -> bool {
        let learns = |p: &Param| Cameras::is_clocks(&p.name) && self.update(p, step, 1.0).is_some();
        self.cameras.blocks().iter().any(learns)
    }

    /// How frames are mapped to the colours of a training image in a step, if they are.
    pub(crate) fn exposure(&self, step: u32, image: usize) -> Option<ExposureFit> {
        let ridge = self.schedule.exposure.at(step, self.schedule.steps())?;
        Some(ExposureFit { ridge, offset: self.schedule.exposure.offset, map: self.exposures.map(image) })
    }

    /// Maps to the colours of training images.
    pub(crate) fn exposures(&self) -> &Exposures {
        &self.exposures
    }

    /// The same, to be changed.
    pub(crate) fn exposures_mut(&mut self) -> &mut Exposures {
        &mut self.exposures
    }

    /// Whether the method has terms of its own in the image loss.
    pub(crate) fn has_own_losses(&self) -> bool {
        self.own_losses
    }

    /// The image loss of the schedule and the terms of the method's own, which it takes from the model.
    pub(crate) fn take_image_loss(&mut self) -> ImageLoss {
        let own = std::mem::take(&mut self.losses);
        own.into_iter().fold(self.schedule.image_loss(), |loss, (weight, term)| loss.with(weight, term))
    }

    /// Name of the method, as in `--method`.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Stages, learning rates and weights of the loss.
    pub fn schedule(&self) -> &Schedule {
        &self.schedule
    }

    /// Tells the method which step is about to be made, or was the last one made.
    pub fn begin_step(&mut self, step: u32) {
        self.method.begin_step(&self.schedule.at(step));
    }

    /// The background that evaluation renders over.
    pub fn background(&self) -> [f32; 3] {
        self.schedule.background.evaluation_color()
    }

    /// Rendering over a background, as in training.
    pub fn raster_options(&self, background: [f32; 3]) -> RasterOptions {
        self.schedule.raster_options(background)
    }

    /// All splats in the same order at every timestamp ([`Inspect::all_splats`](crate::capabilities::Inspect::all_splats)).
    ///
    /// # Errors
    /// As [`Method::splats`].
    pub fn all_splats(&self, at: &Timestamp, camera: &Camera) -> Result<Splats, MethodError> {
        self.capabilities().inspect.map_or_else(|| self.method.splats(at, camera), |i| i.all_splats(at, camera))
    }

    /// Scalar attributes of the splats; none where the method offers none.
    ///
    /// # Errors
    /// As [`Method::splats`].
    pub fn quantities(&self, at: &Timestamp) -> Result<Vec<Quantity>, MethodError> {
        self.capabilities().inspect.map_or_else(|| Ok(Vec::new()), |i| i.quantities(at))
    }

    /// Colours that may be rendered in place of the scene's.
    ///
    /// # Errors
    /// As [`Method::splats`].
    pub fn overlays(&self, at: &Timestamp) -> Result<Vec<Overlay>, MethodError> {
        self.capabilities().inspect.map_or_else(|| Ok(Vec::new()), |i| i.overlays(at))
    }

    /// The stages of the scene at a timestamp; the last is what is rendered.
    ///
    /// # Errors
    /// As [`Method::splats`].
    pub fn stages(&self, at: &Timestamp, camera: &Camera) -> Result<Vec<StageView>, MethodError> {
        match self.capabilities().inspect {
            Some(inspect) => inspect.stages(at, camera),
            None => Ok(vec![StageView { name: "full", splats: self.method.splats(at, camera)?, before: None }]),
        }
    }

    /// The method's own section of the report of a run that logged these events; none where the method offers none.
    ///
    /// # Errors
    /// As [`Method::splats`].
    pub fn report_section(&self, events: &[Value]) -> Result<Option<Section>, MethodError> {
        self.capabilities().inspect.map_or(Ok(None), |i| i.report_section(events))
    }

    /// The method as the type a crate knows it by.
    pub fn concrete<T: Any>(&self) -> Option<&T> {
        self.capabilities().concrete.and_then(|m| m.downcast_ref())
    }

    /// What the method offers beyond training and rendering.
    pub fn capabilities(&self) -> Capabilities<'_> {
        self.method.capabilities()
    }

    /// The same scene without what only training needs ([`Bake::fold`](crate::capabilities::Bake::fold)).
    pub fn fold(&self, config: &toml::Table) -> Option<(toml::Table, Self)> {
        let (config, method) = self.capabilities().bake?.fold(config)?;
        Some((config, self.with(method)))
    }

    /// The same scene with static splats left at rest ([`Bake::freeze_static`](crate::capabilities::Bake::freeze_static)).
    pub fn freeze_static(&self, options: &FreezeOptions<'_>) -> Option<(Self, FreezeReport)> {
        let (method, report) = self.capabilities().bake?.freeze_static(options)?;
        Some((self.with(method), report))
    }

    /// Calls `f` on every block: those of the method, then the corrections of cameras.
    pub fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.method.visit(f);
        self.cameras.blocks().iter().for_each(f);
    }

    /// The same, to change them.
    pub fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.method.visit_mut(f);
        self.cameras.blocks_mut().iter_mut().for_each(f);
    }

    /// Number of values of all blocks.
    pub fn param_count(&self) -> usize {
        Params::param_count(self)
    }

    fn with(&self, method: Box<dyn Method>) -> Self {
        let (schedule, cameras) = (self.schedule.clone(), self.cameras.clone());
        let exposures = self.exposures.clone();
        let own_losses = self.own_losses;
        Self { name: self.name, method, schedule, losses: Vec::new(), own_losses, cameras, exposures }
    }
}

impl Params for Model {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        Self::visit(self, f);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        Self::visit_mut(self, f);
    }
}

impl Deref for Model {
    type Target = dyn Method;

    fn deref(&self) -> &Self::Target {
        self.method.as_ref()
    }
}

impl DerefMut for Model {
    fn deref_mut(&mut self) -> &mut Self::Target {
        self.method.as_mut()
    }
}
