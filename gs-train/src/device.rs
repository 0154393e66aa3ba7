//! The device that frames are rendered on, and that makes whole steps of training where it can.

mod steps;

pub use steps::{DeviceLoss, DeviceStep, DeviceSteps};

use gs_raster::{DeviceError, Rasterizer, Workspace};
use std::fmt;
use std::sync::Arc;

/// Makes the rasterisers of a device; [`Device::default`] is the CPU.
///
/// ```
/// use gs_raster::Workspace;
/// use gs_train::device::Device;
///
/// let other = Device::new("an adapter", || Ok(Box::new(Workspace::new())));
/// assert_eq!((Device::default().name(), other.name()), ("cpu", "an adapter"));
/// let rasterizer = Device::default().open()?;
/// assert_eq!(rasterizer.device(), "cpu");
/// # Ok::<(), gs_raster::DeviceError>(())
/// ```
#[derive(Clone)]
pub struct Device {
    name: Arc<str>,
    open: Arc<Open>,
    steps: Option<Arc<OpenSteps>>,
}

type Open = dyn Fn() -> Result<Box<dyn Rasterizer>, DeviceError> + Send + Sync;
type OpenSteps = dyn Fn() -> Result<Box<dyn DeviceSteps>, DeviceError> + Send + Sync;

/// Name of the CPU as a device.
pub const CPU: &str = "cpu";

impl Device {
    /// A device of this name; `open` makes a rasteriser of it.
    pub fn new(
        name: impl Into<Arc<str>>,
        open: impl Fn() -> Result<Box<dyn Rasterizer>, DeviceError> + Send + Sync + 'static,
    ) -> Self {
        Self { name: name.into(), open: Arc::new(open), steps: None }
    }

    /// The same device, which makes whole steps of training as well.
    pub fn with_steps(
        self,
        steps: impl Fn() -> Result<Box<dyn DeviceSteps>, DeviceError> + Send + Sync + 'static,
    ) -> Self {
        Self { steps: Some(Arc::new(steps)), ..self }
    }

    /// `cpu`, or the name of the adapter.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether it is the CPU.
    pub fn is_cpu(&self) -> bool {
        *self.name == *CPU
    }

    /// A new rasteriser of the device.
    ///
    /// # Errors
    /// If the device fails.
    pub fn open(&self) -> Result<Box<dyn Rasterizer>, DeviceError> {
        (self.open)()
    }

    /// What makes whole steps, if the device does.
    ///
    /// # Errors
    /// If the device fails.
    pub fn open_steps(&self) -> Result<Option<Box<dyn DeviceSteps>>, DeviceError> {
        self.steps.as_ref().map(|open| open()).transpose()
    }
}

impl Default for Device {
    /// The CPU.
    fn default() -> Self {
        Self::new(CPU, || Ok(Box::new(Workspace::new())))
    }
}

impl fmt::Debug for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Device").field(&self.name).finish()
    }
}
