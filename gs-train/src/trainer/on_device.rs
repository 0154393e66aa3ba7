//! Steps that a device makes as wholes, and where the state of the run is meanwhile.

use super::learn::{Learnt, Views};
use super::render_pass::{Phases, Stopwatch, ViewLoss};
use super::{TrainError, Trainer};
use crate::adam::{Factors, Refused};
use crate::device::{DeviceLoss, DeviceStep, DeviceSteps};
use crate::loss::{Dssim, LossValues};
use crate::method::{MethodError, MovedCloud, ViewCtx};
use crate::non_finite::NonFinite;
use crate::schedule::LearningRate;
use crate::timestamp::Timestamp;
use gs_core::cast;
use gs_data::View;
use gs_raster::DeviceError;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// What hinders whole steps where frames are mapped to the colours of images.
const EXPOSED: &str = "exposures are fitted";

/// What makes whole steps, and which copy of the state is the present one.
#[derive(Default)]
pub(super) struct Resident {
    steps: Option<Box<dyn DeviceSteps>>,
    /// Why there are none though the device was asked for them.
    refused: Option<String>,
    state: Copies,
    /// Whether the last step was made there.
    made: bool,
}

/// Where the present state is.
#[derive(Clone, Copy, PartialEq, Eq, Default)]
enum Copies {
    #[default]
    Host,
    Both,
    Device,
}

impl Resident {
    pub(super) fn new(opened: Result<Option<Box<dyn DeviceSteps>>, DeviceError>) -> Self {
        let refused = opened.as_ref().err().map(ToString::to_string);
        Self { steps: opened.ok().flatten(), refused, ..Self::default() }
    }

    /// Whether the device has made steps since the state was copied back.
    pub(super) fn is_newer(&self) -> bool {
        self.state == Copies::Device
    }
}

impl Trainer {
    /// Copies what a device holds back, where it makes whole steps: to be called before the model is looked at.
    ///
    /// # Errors
    /// If the device fails.
    pub fn fetch(&mut self) -> Result<(), TrainError> {
        let Resident { steps, state, .. } = &mut self.resident;
        if let (Some(steps), Copies::Device) = (steps, *state) {
            steps.store(&mut *self.model).map_err(MethodError::from)?;
            *state = Copies::Both;
        }
        Ok(())
    }

    /// The same, before the state is changed on the host.
    pub(super) fn leave_device(&mut self) -> Result<(), TrainError> {
        self.fetch()?;
        self.resident.state = Copies::Host;
        Ok(())
    }

    /// Why the coming steps, or some of them, are not made on the device as wholes, in words; none if all are.
    pub fn device_lacks(&self) -> Option<String> {
        let Resident { steps, refused, .. } = &self.resident;
        let Some(steps) = steps else { return Some(refused.clone().unwrap_or("the device only renders".to_owned())) };
        if self.schedule().exposure.fit {
            return Some(EXPOSED.to_owned());
        }
        let views = self.views(&self.dataset, self.step + 1);
        match self.on_device(&views) {
            Ok((view, cloud)) => steps.lacks(&cloud, &self.images.camera(view)),
            Err(why) => Some(why.to_owned()),
        }
    }

    /// The view and the cloud of a step that may be made as a whole, or what hinders it.
    fn on_device<'a>(&'a self, views: &Views<'a>) -> Result<(&'a View, MovedCloud<'a>), &'static str> {
        let schedule = self.model.schedule();
        let &[(_, view)] = &views.drawn[..] else { return Err("steps have more than one view") };
        let sparse = |rule: &LearningRate| rule.sparse || schedule.sparse_adam;
        let hindrances = [
            (self.ranks.size() > 1, "ranks train on the CPU"),
            (self.model.has_own_losses(), "the method has a loss of its own"),
            (schedule.lambda_fre > 0.0, "the amplitude-spectrum loss (schedule.lambda_fre) is on"),
            (schedule.lambda_depth > 0.0, "measured depth (schedule.lambda_depth) counts"),
            (schedule.lambda_dssim > 0.0 && schedule.dssim != Dssim::Ssim, "schedule.dssim is not ssim"),
            (self.model.exposure(views.step, views.indices[0]).is_some(), EXPOSED),
            (self.model.cameras().row(view).is_some(), "cameras are refined"),
            // The state would travel between steps with a mask and steps without.
            (self.dataset.train.iter().any(|view| view.mask_loss), "the loss has a mask"),
            (schedule.lr.values().flat_map(BTreeMap::values).any(sparse), "updates are sparse"),
        ];
        if let Some((_, why)) = hindrances.into_iter().find(|(hinders, _)| *hinders) {
            return Err(why);
        }
        let camera = &view.camera;
        let ctx = ViewCtx { at: Timestamp::new(view.time), camera, draw: 0, last: true };
        Ok((view, self.model.moved_cloud(&ctx)?))
    }

    /// Makes a step on the device, if it can; the rows are copied back where the end of the step looks at them. Where it could make the last one
    /// and not this one, `events` says why.
    pub(super) fn step_on_device(
        &mut self,
        step: u32,
        events: &mut Vec<Value>,
    ) -> Result<Option<(Learnt, Refused)>, TrainError> {
        let Some(mut steps) = self.resident.steps.take() else { return Ok(None) };
        let done = self.step_with(&mut *steps, step);
        self.resident.steps = Some(steps);
        let (mut learnt, refused, edits) = match done? {
            Ok(done) => done,
            Err(why) => {
                if std::mem::take(&mut self.resident.made) {
                    events.push(json!({"step": step, "made_on_the_cpu": why}));
                }
                return Ok(None);
            }
        };
        (self.resident.made, self.resident.state) = (true, Copies::Device);
        if edits {
            let mut clock = Stopwatch::new();
            self.leave_device()?;
            learnt.ms.device += clock.lap();
        }
        Ok(Some((learnt, refused)))
    }

    fn step_with(
        &mut self,
        steps: &mut dyn DeviceSteps,
        step: u32,
    ) -> Result<Result<(Learnt, Refused, bool), String>, TrainError> {
        let dataset = self.dataset.clone();
        let (views, next) = (self.views(&dataset, step), self.views(&dataset, step + 1));
        let hinders = match self.on_device(&views) {
            Ok((view, cloud)) => steps.lacks(&cloud, &self.images.camera(view)),
            Err(why) => Some(why.to_owned()),
        };
        if let Some(why) = hinders {
            return Ok(Err(why));
        }
        let (mut clock, mut ms) = (Stopwatch::new(), Phases::default());
        self.give_image(steps, &views, &next)?;
        ms.data = clock.lap();
        if self.resident.state == Copies::Host {
            steps.load(&*self.model).map_err(MethodError::from)?;
        }
        let mut factors: BTreeMap<&str, Factors> = BTreeMap::new();
        for (name, update) in &self.updates {
            if let Some(update) = update {
                factors.insert(name, self.adam.next(name, *update));
            }
        }
        let (schedule, draw) = (self.model.schedule(), views.drawn[0].0);
        let (view, cloud) = self.on_device(&views).map_err(|why| MethodError::from(DeviceError::new(why)))?;
        let job = DeviceStep {
            cloud,
            camera: &self.images.camera(view),
            options: &schedule.raster_options(schedule.background.color(self.options.seed, draw)),
            view: views.indices[0],
            l1: self.pass.loss.l1_weight(),
            dssim: schedule.lambda_dssim,
            update: &|name| factors.get(name).copied(),
        };
        let (edits, splats) = (job.cloud.edits, job.cloud.cloud.len());
        let loss = steps.step(&job).map_err(MethodError::from)?;
        let values = loss.values(job.l1, job.dssim);
        ms.device = clock.lap();
        let numeric = |what: String| TrainError::Numeric { step, view: view.name.clone(), what };
        if !values.total.is_finite() {
            return Err(numeric("the loss is not finite".to_owned()));
        }
        if self.too_many(loss.refused, splats) {
            return Err(numeric(format!("{} of {splats} splats have gradients that are not finite", loss.refused)));
        }
        let refused = loss.refused(splats);
        let non_finite = NonFinite { rows: loss.refused, first: None };
        let seen = ViewLoss { terms: values, non_finite, splats, ..ViewLoss::default() };
        let learnt = Learnt::of(&[seen], loss.penalties, views.names(), ms);
        Ok(Ok((learnt, refused, edits)))
    }

    /// Copies the image of a step to the device, unless it is there, and has that of the next one decoded meanwhile.
    fn give_image(
        &mut self,
        steps: &mut dyn DeviceSteps,
        views: &Views<'_>,
        next: &Views<'_>,
    ) -> Result<(), TrainError> {
        let scale = self.images.scale();
        if let ([next], [index]) = (&next.drawn[..], &next.indices[..])
            && !steps.has_image(*index, scale)
        {
            self.prefetch.request(&self.images, next.1);
        }
        let (index, (_, view)) = (views.indices[0], views.drawn[0]);
        if !steps.has_image(index, scale) {
            let image = self.images.get(view)?;
            steps.put_image(index, scale, &image).map_err(MethodError::from)?;
        }
        Ok(())
    }
}

impl DeviceLoss {
    /// As the loss of a view, its terms with these weights.
    fn values(&self, l1: f32, dssim: f32) -> LossValues {
        let ssim = self.ssim.map(|ssim| ("ssim".into(), ssim));
        let total = f64::from(l1) * self.l1 + self.ssim.map_or(0.0, |ssim| f64::from(dssim) * (1.0 - ssim));
        LossValues { total, l1: self.l1, mse: self.mse, terms: ssim.into_iter().collect(), color_map: None }
    }

    /// What Adam refused.
    fn refused(&self, splats: usize) -> Refused {
        let most = self.refused_rows.iter().rev().max_by_key(|(_, rows, _)| *rows);
        let (rows, first) = most.map_or((0, None), |(name, rows, row)| (*rows, Some((name.clone(), *row))));
        Refused { rows, of: cast::to_u32(splats), first, shared: self.refused_shared.clone() }
    }
}
