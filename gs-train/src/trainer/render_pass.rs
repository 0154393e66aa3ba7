//! The image side of a training view: splats to a frame, the frame against the ground truth, the loss back to the splats.

use super::on_device::Resident;
use super::{TrainError, Trainer};
use crate::clocks::motion_columns;
use crate::device::Device;
use crate::loss::{ExposureFit, GroundTruth, ImageLoss, LossValues};
use crate::method::{MethodError, RenderView};
use crate::non_finite::{NonFinite, zero_non_finite};
use gs_core::{Camera, Image, SplatsGrad, SplatsRef};
use gs_data::{DataError, ImageCache, ImageU8, View};
use gs_raster::{CameraGrad, Frame, FrameGrad, RasterOptions, Rasterizer, ScreenStats, Workspace};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::ops::{AddAssign, Div};
use std::sync::Arc;
use std::time::Instant;

/// Milliseconds of the phases of a step.
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize)]
pub struct Phases {
    /// Waiting for the ground-truth images of the batch.
    pub data: f64,
    /// The method: forward, backward and regularisers.
    pub field: f64,
    /// Forward pass of the rasteriser.
    pub raster_forward: f64,
    /// Image loss and its gradient.
    pub loss: f64,
    /// Backward pass of the rasteriser.
    pub raster_backward: f64,
    /// The last four and Adam, where a device makes the whole step.
    pub device: f64,
    /// Waiting for other ranks, and summing what they send.
    pub exchange: f64,
    /// Update of all parameters by Adam.
    pub adam: f64,
    /// End of the step: densification, growth and pruning.
    pub adapt: f64,
    /// The whole step, from the choice of views on.
    pub total: f64,
}

/// Rasteriser, and buffers of frames and loss, reused between steps.
pub(super) struct RenderPass {
    rasterizer: Box<dyn Rasterizer>,
    frame: Frame,
    d_frame: FrameGrad,
    stats: ScreenStats,
    pub loss: ImageLoss,
}

/// What learning from one view gave.
#[derive(Clone, Default, Serialize, Deserialize)]
pub(super) struct ViewLoss {
    /// The image loss.
    pub terms: LossValues,
    /// Terms of the method's own, weights applied.
    pub own: Vec<(Cow<'static, str>, f32)>,
    pub non_finite: NonFinite,
    /// Splats rendered.
    pub splats: usize,
    #[serde(skip)]
    pub ms: Phases,
}

/// One view of a step, ready to be rendered.
pub(super) struct ViewPass<'a> {
    pub pass: &'a mut RenderPass,
    pub images: &'a ImageCache,
    pub view: &'a View,
    pub camera: &'a Camera,
    /// Gradient with respect to the camera, where that learns.
    pub camera_grad: Option<CameraGrad>,
    /// Gradient of the splats' columns that move, where the camera's clock learns.
    pub motion_grad: Option<SplatsGrad>,
    /// How to render, over the background of this view.
    pub options: RasterOptions,
    /// How the frame is mapped to the colours of its image, where it is.
    pub exposure: Option<ExposureFit>,
    /// Share of this view in the loss of the step.
    pub share: f32,
    pub result: ViewLoss,
    /// The error of reading the ground truth, if that failed.
    pub data_error: Option<DataError>,
}

impl Phases {
    /// What `f` makes of each phase and that of the other.
    fn zip(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        Self {
            data: f(self.data, other.data),
            field: f(self.field, other.field),
            raster_forward: f(self.raster_forward, other.raster_forward),
            loss: f(self.loss, other.loss),
            raster_backward: f(self.raster_backward, other.raster_backward),
            device: f(self.device, other.device),
            exchange: f(self.exchange, other.exchange),
            adam: f(self.adam, other.adam),
            adapt: f(self.adapt, other.adapt),
            total: f(self.total, other.total),
        }
    }
}

impl AddAssign for Phases {
    fn add_assign(&mut self, other: Self) {
        *self = self.zip(other, |a, b| a + b);
    }
}

impl Div<f64> for Phases {
    type Output = Self;

    fn div(self, by: f64) -> Self {
        self.zip(self, |ms, _| ms / by)
    }
}

impl RenderPass {
    /// A pass on the CPU with empty buffers.
    pub(super) fn new(loss: ImageLoss) -> Self {
        let (frame, d_frame, stats) = Default::default();
        Self { rasterizer: Box::new(Workspace::new()), frame, d_frame, stats, loss }
    }
}

impl Trainer {
    /// The same run, its frames rendered on this device from now on, its steps made there where the device can ([`Self::device_lacks`] says why
    /// not). The bits of a run are those of its device.
    ///
    /// # Errors
    /// If the device fails.
    pub fn on(mut self, device: &Device) -> Result<Self, TrainError> {
        self.leave_device()?;
        self.pass.rasterizer = device.open().map_err(MethodError::from)?;
        self.resident = Resident::new(device.open_steps());
        self.device = device.clone();
        Ok(self)
    }

    /// The device that frames are rendered on.
    pub fn device(&self) -> &Device {
        &self.device
    }
}

impl RenderView for ViewPass<'_> {
    fn render(&mut self, splats: SplatsRef<'_>, grad: &mut SplatsGrad) -> Result<&ScreenStats, MethodError> {
        let RenderPass { rasterizer, frame, d_frame, stats, loss } = &mut *self.pass;
        let mut clock = Stopwatch::new();
        let ms = &mut self.result.ms;
        let (image, mask, depth) = match read(self.images, self.view, loss.needs_depth()) {
            Ok(read) => read,
            Err(e) => {
                let why = MethodError::Render(e.to_string());
                self.data_error = Some(e);
                return Err(why);
            }
        };
        let background = self.options.background;
        let (mask, depth, exposure) = (mask.as_deref(), depth.as_deref(), self.exposure);
        let truth = GroundTruth { image: &image, background, mask, depth, exposure };
        ms.data += clock.lap();
        rasterizer.render_into(splats, self.camera, &self.options, frame)?;
        ms.raster_forward += clock.lap();
        self.result.terms = loss.evaluate(frame, &truth, d_frame)?;
        if self.share != 1.0 {
            let FrameGrad { rgb, alpha, depth } = d_frame;
            [rgb, alpha, depth].into_iter().flatten().for_each(|g| *g *= self.share);
        }
        ms.loss += clock.lap();
        match &mut self.camera_grad {
            Some(sum) => {
                let (camera, options) = (self.camera, &self.options);
                *sum += rasterizer.render_backward_with_camera(splats, camera, options, d_frame, grad, stats)?;
            }
            None => rasterizer.render_backward_into(splats, self.camera, &self.options, d_frame, grad, stats)?,
        }
        if self.share != 1.0 {
            stats.grad_means2d.as_flattened_mut().iter_mut().for_each(|g| *g /= self.share);
        }
        self.result.non_finite = zero_non_finite(grad);
        if let Some(kept) = &mut self.motion_grad {
            *kept = motion_columns(grad);
        }
        self.result.splats = splats.len();
        ms.raster_backward += clock.lap();
        Ok(stats)
    }
}

type Read = (Arc<ImageU8>, Option<Arc<Image>>, Option<Arc<Image>>);

/// The image of a view, the mask its loss counts inside of, and its depth if that is wanted.
fn read(images: &ImageCache, view: &View, with_depth: bool) -> Result<Read, DataError> {
    let mask = if view.mask_loss { images.mask(view)? } else { None };
    let depth = if with_depth { images.depth(view)? } else { None };
    Ok((images.get(view)?, mask, depth))
}

/// Milliseconds since the last lap.
pub(super) struct Stopwatch(Instant);

impl Stopwatch {
    /// Started now.
    pub(super) fn new() -> Self {
        Self(Instant::now())
    }

    /// Milliseconds since the start or the last lap.
    pub(super) fn lap(&mut self) -> f64 {
        let now = Instant::now();
        let ms = now.duration_since(self.0).as_secs_f64() * 1e3;
        self.0 = now;
        ms
    }
}
