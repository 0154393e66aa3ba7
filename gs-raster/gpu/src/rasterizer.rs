//! The GPU behind the trait that all rasterisers share.

use crate::renderer::Renderer;
use gs_core::{Camera, SplatsGrad, SplatsRef};
use gs_raster::{CameraGrad, DeviceError, Frame, FrameGrad, RasterOptions, Rasterizer, ScreenStats};

impl Rasterizer for Renderer {
    fn device(&self) -> String {
        self.gpu.description()
    }

    fn render_into(
        &mut self,
        splats: SplatsRef<'_>,
        camera: &Camera,
        options: &RasterOptions,
        frame: &mut Frame,
    ) -> Result<(), DeviceError> {
        Renderer::render_into(self, splats, camera, options, frame).map_err(DeviceError::new)
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
        Renderer::render_backward_into(self, splats, camera, options, d, grad, stats).map_err(DeviceError::new)
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
        Renderer::render_backward_with_camera(self, splats, camera, options, d, grad, stats).map_err(DeviceError::new)
    }
}
