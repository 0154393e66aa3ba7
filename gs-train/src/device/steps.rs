//! Whole steps of training on a device.

use crate::adam::Factors;
use crate::method::{LossValue, Method, MovedCloud};
use gs_core::Camera;
use gs_data::ImageU8;
use gs_raster::{DeviceError, RasterOptions};

/// Makes whole steps of training: parameters, moments of the optimiser and statistics of densification stay on the device between
/// them. The [`Trainer`](crate::trainer::Trainer) has them copied back when it edits rows, saves or scores.
pub trait DeviceSteps: Send {
    /// What of this step the device cannot compute, in words; none if it can make it.
    fn lacks(&self, cloud: &MovedCloud<'_>, camera: &Camera) -> Option<String>;

    /// Copies the state of a method to the device.
    ///
    /// # Errors
    /// If the device fails, or the state does not fit it.
    fn load(&mut self, method: &dyn Method) -> Result<(), DeviceError>;

    /// Whether the device holds the image of this number in this size.
    fn has_image(&self, view: usize, scale: f64) -> bool;

    /// Copies the image of this number to the device.
    ///
    /// # Errors
    /// As [`Self::load`].
    fn put_image(&mut self, view: usize, scale: f64, image: &ImageU8) -> Result<(), DeviceError>;

    /// Makes a step from the state that was loaded: splats, frame, loss, gradients, regularisers, Adam, statistics.
    ///
    /// # Errors
    /// If the device fails. The state is then unknown.
    fn step(&mut self, step: &DeviceStep<'_>) -> Result<DeviceLoss, DeviceError>;

    /// Copies the state back.
    ///
    /// # Errors
    /// If the device fails.
    fn store(&mut self, method: &mut dyn Method) -> Result<(), DeviceError>;
}

/// One step of one view.
pub struct DeviceStep<'a> {
    /// What is rendered.
    pub cloud: MovedCloud<'a>,
    /// The camera.
    pub camera: &'a Camera,
    /// How to render.
    pub options: &'a RasterOptions,
    /// Number of the image, which the device holds.
    pub view: usize,
    /// Weight of the mean absolute difference.
    pub l1: f32,
    /// Weight of one minus SSIM; at 0 it need not be computed.
    pub dssim: f32,
    /// The update of the block of a name; none if it does not learn.
    pub update: &'a dyn Fn(&str) -> Option<Factors>,
}

/// What a step on a device gave.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DeviceLoss {
    /// Mean absolute difference over pixels and channels.
    pub l1: f64,
    /// Mean squared difference.
    pub mse: f64,
    /// Mean SSIM, where it counts.
    pub ssim: Option<f64>,
    /// Regularisers by name, weights applied.
    pub penalties: Vec<LossValue>,
    /// Splats whose gradients were not finite, and were left out.
    pub refused: u32,
    /// Row blocks with gradients that are not finite, whose values were left alone: name, number of rows, the first of them.
    pub refused_rows: Vec<(String, u32, u32)>,
    /// A shared block with such a gradient: the run cannot go on.
    pub refused_shared: Option<String>,
}
