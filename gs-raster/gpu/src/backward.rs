//! The gradient of a frame on the device.

use crate::device::Gpu;
use crate::error::GpuError;
use crate::kernels::{Kernel, Kernels};
use crate::memory::{Array, Readback};
use crate::renderer::{Renderer, copy};
use crate::resident::Shape;
use crate::sort::groups;
use crate::view::View;
use gs_core::{Camera, SplatsGrad, SplatsRef};
use gs_raster::{CameraGrad, FrameGrad, RasterOptions, ScreenStats};

/// Bytes of a record: twelve sums.
pub(crate) const RECORD: u64 = 48;
/// Bytes of a splat's gradients, and of what a workgroup sums of the camera's: sixteen numbers.
const ROW: u64 = 64;
/// Splats of one workgroup.
const GROUP: u64 = 256;
/// Splats of one workgroup where sixteen threads add the records of each.
const GATHERED: u64 = 16;
/// Splats of one workgroup where each needs many registers.
const SMALL_GROUP: u64 = 64;

/// What a backward pass computes on its way.
pub(crate) struct Backward {
    pub d_frame: Array,
    records: Array,
    sums: Array,
    pub grads: Array,
    pub d_colors: Array,
    camera: Array,
    readback: Readback,
}

impl Backward {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        Self {
            d_frame: Array::new(gpu, "cotangents of pixels"),
            records: Array::new(gpu, "gradient records of entries"),
            sums: Array::new(gpu, "gradient sums of splats"),
            grads: Array::new(gpu, "gradients of splats"),
            d_colors: Array::new(gpu, "gradients of colours"),
            camera: Array::new(gpu, "gradient of the camera"),
            readback: Readback::default(),
        }
    }
}

impl Renderer {
    /// Gradient of the loss whose cotangents are `d` with respect to every column of `splats`, written to `grad` and
    /// `stats` as [`gs_raster::render_backward_into`] does.
    ///
    /// Must follow [`Renderer::render_into`] of the same splats, camera and options. `d` must be finite.
    ///
    /// # Errors
    /// There was no such frame, something does not fit the device, or it failed.
    ///
    /// # Panics
    /// If a column of `d` is neither empty nor of the size of the frame.
    pub fn render_backward_into<'a>(
        &mut self,
        splats: impl Into<SplatsRef<'a>>,
        camera: &Camera,
        options: &RasterOptions,
        d: &FrameGrad,
        grad: &mut SplatsGrad,
        stats: &mut ScreenStats,
    ) -> Result<(), GpuError> {
        self.pull(splats.into(), camera, options, d, grad, stats, None)
    }

    /// [`Renderer::render_backward_into`], and the gradient with respect to the camera's pose and intrinsics.
    ///
    /// # Errors
    /// As [`Renderer::render_backward_into`].
    pub fn render_backward_with_camera<'a>(
        &mut self,
        splats: impl Into<SplatsRef<'a>>,
        camera: &Camera,
        options: &RasterOptions,
        d: &FrameGrad,
        grad: &mut SplatsGrad,
        stats: &mut ScreenStats,
    ) -> Result<CameraGrad, GpuError> {
        let mut camera_grad = CameraGrad::default();
        self.pull(splats.into(), camera, options, d, grad, stats, Some(&mut camera_grad))?;
        Ok(camera_grad)
    }

    #[expect(clippy::too_many_arguments, reason = "those of the public functions")]
    fn pull(
        &mut self,
        splats: SplatsRef<'_>,
        camera: &Camera,
        options: &RasterOptions,
        d: &FrameGrad,
        grad: &mut SplatsGrad,
        stats: &mut ScreenStats,
        camera_grad: Option<&mut CameraGrad>,
    ) -> Result<(), GpuError> {
        let (view, with_profile) = self.last.ok_or(GpuError::NoFrame)?;
        if !view.same_shape(&View::new(Shape::of(splats), camera, options, 0)) {
            return Err(GpuError::NoFrame);
        }
        grad.reset(splats);
        if splats.is_empty() {
            *stats = ScreenStats::default();
            return Ok(());
        }
        self.make_room_for_gradients(&view, splats.color.width())?;
        self.write_cotangents(&view, d);
        let gpu = self.gpu.clone();
        let desc = wgpu::CommandEncoderDescriptor { label: Some("gradient") };
        let mut encoder = gpu.device().create_command_encoder(&desc);
        self.encode_gradients(&mut encoder, gpu.kernels(with_profile), &view, camera_grad.is_some());
        let b = &mut self.backward;
        let mut sum = CameraGrad::default();
        let with_camera = [&b.grads, &b.d_colors, &b.camera];
        let arrays = if camera_grad.is_some() { &with_camera[..] } else { &with_camera[..2] };
        b.readback.submit(&gpu, encoder, arrays, |i, bytes| match i {
            0 => unpack(splats, bytes, grad, stats),
            1 => copy(bytes, grad.color.len(), &mut grad.color),
            _ => sum = sum_camera(bytes),
        })?;
        if let Some(to) = camera_grad {
            *to = sum;
        }
        Ok(())
    }

    /// `colors` is the number of values of a splat's colour.
    pub(crate) fn make_room_for_gradients(&mut self, view: &View, colors: usize) -> Result<(), GpuError> {
        let (gpu, b) = (&self.gpu, &mut self.backward);
        b.d_frame.resize(gpu, 5 * bytes_of_a_plane(view))?;
        let n = u64::from(view.splats());
        if !gpu.float_atomics() {
            b.records.resize(gpu, RECORD * u64::from(view.entries()))?;
        }
        b.sums.resize(gpu, RECORD * n)?;
        b.grads.resize(gpu, ROW * n)?;
        b.camera.resize(gpu, ROW * n.div_ceil(SMALL_GROUP))?;
        b.d_colors.resize(gpu, 4 * n * colors as u64)
    }

    fn write_cotangents(&self, view: &View, d: &FrameGrad) {
        let (to, pixels) = (&self.backward.d_frame, bytes_of_a_plane(view));
        to.write_or_zero(&self.gpu, 0, 3 * pixels, &d.rgb);
        to.write_or_zero(&self.gpu, 3 * pixels, pixels, &d.alpha);
        to.write_or_zero(&self.gpu, 4 * pixels, pixels, &d.depth);
    }

    /// Blend backward, the sums of each splat, and what they pull back.
    pub(crate) fn encode_gradients(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        kernels: &Kernels,
        view: &View,
        with_camera: bool,
    ) {
        let (gpu, w, c, b) = (&self.gpu, &self.work, &self.columns, &self.backward);
        let run = |pass: &mut wgpu::ComputePass<'_>, k: &Kernel, arrays: &[&Array], size| {
            k.run(pass, &k.bind(gpu.device(), arrays), size);
        };
        let order = &w.entry_order.values[w.sorted];
        let tiles = [
            &w.view,
            &w.ranges,
            order,
            &w.entry_splats,
            &w.projected,
            &w.transmittance,
            &w.last,
            &b.d_frame,
            if gpu.float_atomics() { &b.sums } else { &b.records },
        ];
        if gpu.float_atomics() {
            encoder.clear_buffer(b.sums.buffer(), 0, None);
        }
        run(&mut self.timer.pass(encoder, "blend backward"), &kernels.blend_backward, &tiles, view.tiles());
        let n = u64::from(view.splats());
        let pass = &mut self.timer.pass(encoder, "splats backward");
        if !gpu.float_atomics() {
            run(pass, &kernels.gather, &[&w.view, &w.spans, &b.records, &b.sums], groups(n, GATHERED));
        }
        let geometry = [&w.view, &c.means, &c.quats, &c.scales, &c.opacities, &w.spans, &b.sums, &b.grads, &b.camera];
        run(pass, &kernels.geometry_backward, &geometry[..8], groups(n, SMALL_GROUP));
        let color = [&w.view, &c.means, &c.colors, &w.spans, &b.sums, &b.d_colors, &b.grads];
        run(pass, &kernels.color_backward, &color, groups(n, GROUP));
        if with_camera {
            run(pass, &kernels.camera_backward, &geometry, groups(n, SMALL_GROUP));
        }
    }
}

/// Bytes of one number per pixel.
fn bytes_of_a_plane(view: &View) -> u64 {
    let [width, height] = view.size().map(u64::from);
    4 * width * height
}

/// Columns of gradients, one after another, into those of the host; the order is that of `geometry_backward.wgsl`.
fn unpack(splats: SplatsRef<'_>, bytes: &[u8], grad: &mut SplatsGrad, stats: &mut ScreenStats) {
    let n = splats.len();
    stats.grad_means2d.resize(n, [0.0; 2]);
    stats.radii.resize(n, 0.0);
    let mut rest = bytes;
    take(&mut rest, &mut grad.means);
    take(&mut rest, &mut grad.quats);
    take(&mut rest, &mut grad.scales);
    take(&mut rest, &mut grad.opacities);
    take(&mut rest, &mut stats.grad_means2d);
    take(&mut rest, &mut stats.radii);
    let width = splats.kernel.width();
    if width > 0 {
        for (i, (sums, row)) in rest.as_chunks::<8>().0.iter().zip(grad.kernel.chunks_mut(width)).enumerate() {
            let sums: [f32; 2] = bytemuck::pod_read_unaligned(sums);
            splats.kernel.vjp(i, sums.map(f64::from), row);
        }
    }
}

/// Fills a column from the front of `rest`.
fn take<T: bytemuck::Pod>(rest: &mut &[u8], column: &mut [T]) {
    let (own, tail) = rest.split_at(size_of_val(column));
    bytemuck::cast_slice_mut(column).copy_from_slice(own);
    *rest = tail;
}

/// The sums of all workgroups, added in order.
fn sum_camera(bytes: &[u8]) -> CameraGrad {
    let mut sum = [0.0f64; 16];
    for row in bytes.as_chunks::<64>().0 {
        let row: [f32; 16] = bytemuck::pod_read_unaligned(row);
        sum.iter_mut().zip(row).for_each(|(to, from)| *to += f64::from(from));
    }
    let [fx, fy, cx, cy] = [sum[12], sum[13], sum[14], sum[15]];
    let mut grad = CameraGrad { fx, fy, cx, cy, ..CameraGrad::default() };
    grad.viewmat.as_flattened_mut().copy_from_slice(&sum[..12]);
    grad
}
