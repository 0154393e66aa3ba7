//! Rasterisers on any device.
//!
//! [`Workspace`] renders on the CPU; another crate may render on another device. Whoever renders through a
//! `Box<dyn Rasterizer>` does not know which.

use crate::camera_grad::CameraGrad;
use crate::frame::{Frame, FrameGrad, ScreenStats};
use crate::options::RasterOptions;
use crate::workspace::Workspace;
use gs_core::{Camera, SplatsGrad, SplatsRef};
use std::error::Error;

/// Renders frames and their gradients on a device, reusing memory. Use one per concurrent caller.
///
/// Frames and gradients are those of [`mod@crate::reference`] up to rounding; the bits are the device's own.
///
/// ```
/// use gs_raster::{Frame, RasterOptions, Rasterizer, Workspace, measure};
///
/// let (splats, camera) = (measure::scene(1000, 0), measure::camera(64));
/// let (options, mut frame) = (RasterOptions::default(), Frame::default());
/// let mut rasterizer: Box<dyn Rasterizer> = Box::new(Workspace::new());
/// rasterizer.render_into(splats.view(), &camera, &options, &mut frame)?;
/// assert_eq!((rasterizer.device().as_str(), frame.alpha.len()), ("cpu", 64 * 64));
/// assert_eq!(frame, gs_raster::render(&splats, &camera, &options, &mut Workspace::new()));
/// # Ok::<(), gs_raster::DeviceError>(())
/// ```
pub trait Rasterizer: Send {
    /// Name of the device: `cpu`, or that of the adapter.
    fn device(&self) -> String;

    /// Renders `splats` from `camera`, as [`crate::render_into`].
    ///
    /// # Errors
    /// If the device fails.
    fn render_into(
        &mut self,
        splats: SplatsRef<'_>,
        camera: &Camera,
        options: &RasterOptions,
        frame: &mut Frame,
    ) -> Result<(), DeviceError>;

    /// Gradient with respect to the splats, as [`crate::render_backward_into`]. Must follow [`Self::render_into`] of the same
    /// splats, camera and options.
    ///
    /// # Errors
    /// If the device fails; `grad` and `stats` are undefined then.
    fn render_backward_into(
        &mut self,
        splats: SplatsRef<'_>,
        camera: &Camera,
        options: &RasterOptions,
        d: &FrameGrad,
        grad: &mut SplatsGrad,
        stats: &mut ScreenStats,
    ) -> Result<(), DeviceError>;

    /// The same and the gradient with respect to the camera, as [`crate::render_backward_with_camera`].
    ///
    /// # Errors
    /// As [`Self::render_backward_into`].
    fn render_backward_with_camera(
        &mut self,
        splats: SplatsRef<'_>,
        camera: &Camera,
        options: &RasterOptions,
        d: &FrameGrad,
        grad: &mut SplatsGrad,
        stats: &mut ScreenStats,
    ) -> Result<CameraGrad, DeviceError>;
}

/// A device that cannot render. The message is the device's: what failed, where, why, and what to do.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct DeviceError(Box<dyn Error + Send + Sync>);

impl DeviceError {
    /// Wraps an error of a device, or a message.
    pub fn new(error: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        Self(error.into())
    }
}

/// The CPU, which never fails.
impl Rasterizer for Workspace {
    fn device(&self) -> String {
        "cpu".to_owned()
    }

    fn render_into(
        &mut self,
        splats: SplatsRef<'_>,
        camera: &Camera,
        options: &RasterOptions,
        frame: &mut Frame,
    ) -> Result<(), DeviceError> {
        crate::render_into(splats, camera, options, self, frame);
        Ok(())
    }

    fn render_backward_into(
        &mut self,
        splats: SplatsRef<'_>,
        camera: &Camera,
        options: &RasterOptions,
        d: &FrameGrad,
        grad: &mut SplatsGrad,
        stats: &mut ScreenStats,
    ) -> Result<(), DeviceError> {
        crate::render_backward_into(splats, camera, options, self, d, grad, stats);
        Ok(())
    }

    fn render_backward_with_camera(
        &mut self,
        splats: SplatsRef<'_>,
        camera: &Camera,
        options: &RasterOptions,
        d: &FrameGrad,
        grad: &mut SplatsGrad,
        stats: &mut ScreenStats,
    ) -> Result<CameraGrad, DeviceError> {
        Ok(crate::render_backward_with_camera(splats, camera, options, self, d, grad, stats))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure;

    #[test]
    fn the_cpu_has_the_bits_of_the_functions() {
        let (splats, camera, options) = (measure::scene(300, 2), measure::camera(40), RasterOptions::default());
        let splats = splats.view();
        let (mut own, mut plain) = (Workspace::new(), Workspace::new());
        let (mut frame, mut want) = (Frame::default(), Frame::default());
        let rasterizer: &mut dyn Rasterizer = &mut own;
        rasterizer.render_into(splats, &camera, &options, &mut frame).unwrap();
        crate::render_into(splats, &camera, &options, &mut plain, &mut want);
        assert_eq!(frame, want);
        let d = FrameGrad { rgb: want.rgb.data.clone(), ..FrameGrad::default() };
        let mut results = [0; 4].map(|_| (SplatsGrad::default(), ScreenStats::default()));
        let [a, b, c, e] = &mut results;
        rasterizer.render_backward_into(splats, &camera, &options, &d, &mut a.0, &mut a.1).unwrap();
        let moved = rasterizer.render_backward_with_camera(splats, &camera, &options, &d, &mut b.0, &mut b.1).unwrap();
        crate::render_backward_into(splats, &camera, &options, &mut plain, &d, &mut c.0, &mut c.1);
        let expected =
            crate::render_backward_with_camera(splats, &camera, &options, &mut plain, &d, &mut e.0, &mut e.1);
        assert_eq!((&*a, &*b, moved), (&*c, &*e, expected));
    }

    #[test]
    fn an_error_has_the_message_of_its_device() {
        let inner = std::io::Error::other("out of memory on device 0; render smaller images");
        assert_eq!(DeviceError::new(inner).to_string(), "out of memory on device 0; render smaller images");
        assert_eq!(DeviceError::new("lost").to_string(), "lost");
    }
}
