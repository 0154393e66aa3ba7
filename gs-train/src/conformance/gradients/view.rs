//! The functional of a view and its gradients.

use super::{BlockGradient, gradients};
use crate::method::{LossValue, MethodError, RenderView, ViewCtx};
use crate::model::Model;
use crate::timestamp::Timestamp;
use gs_core::{Camera, Rng, Splats, SplatsGrad, SplatsRef};
use gs_raster::reference::{self, Cutoff, Scene};
use gs_raster::{ClampGrad, FrameGrad, RasterOptions, ScreenStats, Workspace, render, render_backward};

/// A view whose image the functional is made of.
pub struct View {
    at: Timestamp,
    camera: Camera,
    step: u32,
    options: RasterOptions,
    weights: Vec<f32>,
}

impl View {
    /// The view of a camera at a timestamp, in step `step` of the schedule. It is rendered without the visible steps at α =
    /// 1/255 and T = 1e-4, which no gradient accounts for.
    pub fn new(model: &Model, step: u32, at: Timestamp, camera: Camera) -> Self {
        let options = model.raster_options([0.2, 0.4, 0.6]);
        let options = RasterOptions { min_alpha: 1e-7, stop: 1e-9, clamp_grad: ClampGrad::Exact, ..options };
        let (width, height) = (camera.width as usize, camera.height as usize);
        let patches = width.div_ceil(8);
        let weight = |i: usize| {
            let (pixel, channel) = (i / 3, i % 3);
            let patch = pixel / width / 8 * patches + pixel % width / 8;
            Rng::new(1, "weights", channel as u32, patch as u64).normal()
        };
        let weights = (0..3 * width * height).map(weight).collect();
        Self { at, camera, step, options, weights }
    }

    /// Timestamp at which the splats are asked for.
    pub fn at(&self) -> &Timestamp {
        &self.at
    }

    /// Camera from which the image is rendered.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The gradients of the functional as a training step finds them.
    ///
    /// # Errors
    /// If the step fails.
    pub fn gradients(&self, model: &mut Model) -> Result<Vec<BlockGradient>, MethodError> {
        model.clear_grads();
        self.step(model, &mut Backward { view: self, stats: ScreenStats::default() })?;
        Ok(gradients(model))
    }

    /// The splats that a training step renders; none if it leaves the view unrendered.
    ///
    /// # Errors
    /// If the step fails.
    pub fn splats(&self, model: &mut Model) -> Result<Splats, MethodError> {
        let mut record = Record::default();
        self.step(model, &mut record)?;
        Ok(record.splats)
    }

    /// The functional of splats; NaN if there are none.
    pub fn value(&self, scene: &Scene<f64>) -> f64 {
        if scene.means.is_empty() {
            return f64::NAN;
        }
        let frame = reference::render(scene, &self.camera, &self.options, Cutoff::Hard);
        frame.rgb.as_flattened().iter().zip(&self.weights).map(|(v, w)| v * f64::from(*w)).sum()
    }

    /// The functional of the present parameters; NaN if the step fails.
    pub fn functional(&self, model: &mut Model) -> f64 {
        self.splats(model).map_or(f64::NAN, |splats| self.value(&Scene::new(&splats)))
    }

    fn step(&self, model: &mut Model, render: &mut dyn RenderView) -> Result<Vec<LossValue>, MethodError> {
        model.begin_step(self.step);
        model.step(&ViewCtx { at: self.at, camera: &self.camera, draw: 0, last: false }, render)
    }
}

/// Pulls the weights of the functional back to the splats.
struct Backward<'a> {
    view: &'a View,
    stats: ScreenStats,
}

impl RenderView for Backward<'_> {
    fn render(&mut self, splats: SplatsRef<'_>, grad: &mut SplatsGrad) -> Result<&ScreenStats, MethodError> {
        let (View { camera, options, weights, .. }, mut workspace) = (self.view, Workspace::new());
        render(splats, camera, options, &mut workspace);
        let upstream = FrameGrad { rgb: weights.clone(), ..FrameGrad::default() };
        (*grad, self.stats) = render_backward(splats, camera, options, &mut workspace, &upstream);
        Ok(&self.stats)
    }
}

/// Keeps the splats and renders nothing.
#[derive(Default)]
struct Record {
    splats: Splats,
    stats: ScreenStats,
}

impl RenderView for Record {
    fn render(&mut self, splats: SplatsRef<'_>, grad: &mut SplatsGrad) -> Result<&ScreenStats, MethodError> {
        self.splats = splats.to_splats();
        grad.reset(splats);
        self.stats = ScreenStats { grad_means2d: vec![[0.0; 2]; splats.len()], radii: vec![0.0; splats.len()] };
        Ok(&self.stats)
    }
}
