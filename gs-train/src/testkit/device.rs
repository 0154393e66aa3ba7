//! A device that counts its calls and fails on demand.

use crate::device::Device;
use gs_core::{Camera, SplatsGrad, SplatsRef};
use gs_raster::{CameraGrad, DeviceError, Frame, FrameGrad, RasterOptions, Rasterizer, ScreenStats, Workspace};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

struct Fake {
    workspace: Workspace,
    calls: Arc<AtomicU32>,
    fails_at: u32,
}

impl Fake {
    fn call(&mut self) -> Result<&mut Workspace, DeviceError> {
        match self.calls.fetch_add(1, Ordering::Relaxed) + 1 {
            call if call == self.fails_at => Err(DeviceError::new("the fake device is lost")),
            _ => Ok(&mut self.workspace),
        }
    }
}

impl Rasterizer for Fake {
    fn device(&self) -> String {
        "fake".to_owned()
    }

    fn render_into(
        &mut self,
        splats: SplatsRef<'_>,
        camera: &Camera,
        options: &RasterOptions,
        frame: &mut Frame,
    ) -> Result<(), DeviceError> {
        self.call()?.render_into(splats, camera, options, frame)
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
        self.call()?.render_backward_into(splats, camera, options, d, grad, stats)
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
        self.call()?.render_backward_with_camera(splats, camera, options, d, grad, stats)
    }
}

/// A device that fails at one of its calls (from 1; 0: never), and the number of calls so far: the CPU by the name `fake`.
pub fn fake_device(fails_at: u32) -> (Device, Arc<AtomicU32>) {
    let calls = Arc::new(AtomicU32::new(0));
    let counted = calls.clone();
    let open = move || -> Result<Box<dyn Rasterizer>, DeviceError> {
        Ok(Box::new(Fake { workspace: Workspace::new(), calls: counted.clone(), fails_at }))
    };
    (Device::new("fake", open), calls)
}
