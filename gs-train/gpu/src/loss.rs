//! The image loss on the device: L1 and SSIM.

use crate::pass::At;
use bytemuck::{Pod, Zeroable};
use gs_core::Camera;
use gs_gpu::{Array, FrameArrays, Gpu, GpuError};
use gs_train::device::DeviceLoss;

/// Side of the tile of a workgroup, pixels.
const SIDE: u32 = 16;
/// Colour channels.
const CHANNELS: u32 = 3;

/// See `shaders/ssim.wgsl`.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct LossUniform {
    size: [u32; 2],
    tiles: [u32; 2],
    background: [f32; 4],
    l1: f32,
    dssim: f32,
    unused: [f32; 2],
}

/// What the loss needs on the device.
pub(crate) struct ImageLoss {
    maps: Array,
    /// Sums of each tile and channel: SSIM, absolute and squared differences, nothing.
    pub partials: Array,
}

/// Bytes of the largest array of the loss of a view.
pub(crate) fn largest_array(camera: &Camera) -> u64 {
    4 * 9 * u64::from(camera.width) * u64::from(camera.height)
}

/// The loss of a view.
pub(crate) struct View<'a> {
    pub camera: &'a Camera,
    pub background: [f32; 3],
    pub l1: f32,
    pub dssim: f32,
    /// `[H, W]`: RGBA.
    pub image: &'a Array,
}

impl View<'_> {
    fn tiles(&self) -> [u32; 2] {
        [self.camera.width, self.camera.height].map(|side| side.div_ceil(SIDE))
    }

    /// Values of the frame.
    fn values(&self) -> f64 {
        f64::from(self.camera.width) * f64::from(self.camera.height) * f64::from(CHANNELS)
    }

    /// Sums of all tiles as the means they stand for.
    pub(crate) fn means(&self, partials: &[[f32; 4]]) -> DeviceLoss {
        let mean = |k: usize| partials.iter().map(|v| f64::from(v[k])).sum::<f64>() / self.values();
        let ssim = (self.dssim > 0.0).then(|| mean(0));
        DeviceLoss { l1: mean(1), mse: mean(2), ssim, ..DeviceLoss::default() }
    }
}

impl ImageLoss {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        Self { maps: Array::new(gpu, "gradients of SSIM"), partials: Array::new(gpu, "sums of the loss") }
    }

    pub(crate) fn resize(&mut self, gpu: &Gpu, view: &View<'_>) -> Result<(), GpuError> {
        let [columns, rows] = view.tiles().map(u64::from);
        self.maps.resize(gpu, largest_array(view.camera))?;
        self.partials.resize(gpu, 16 * u64::from(CHANNELS) * columns * rows)
    }

    /// The cotangent of a frame, and the sums of its tiles.
    pub(crate) fn encode(&self, at: &mut At<'_, '_>, view: &View<'_>, frame: &FrameArrays<'_>) {
        let tiles = view.tiles();
        let [r, g, b] = view.background;
        let own = LossUniform {
            size: [view.camera.width, view.camera.height],
            tiles,
            background: [r, g, b, 0.0],
            l1: (f64::from(view.l1) / view.values()) as f32,
            dssim: (f64::from(view.dssim) / view.values()) as f32,
            unused: [0.0; 2],
        };
        let own = at.uniforms.add(&own);
        let size = [tiles[0], CHANNELS * tiles[1]];
        let kernels = [
            (&at.kernels.loss_forward, [&self.maps, &self.partials]),
            (&at.kernels.loss_backward, [&self.maps, frame.d_frame]),
        ];
        for (kernel, [maps, out]) in kernels {
            let arrays = [frame.rgb, view.image, maps, out];
            kernel.run(at.pass, &kernel.bind_part(at.gpu.device(), at.uniforms.part(&own), &arrays), size);
        }
    }
}
