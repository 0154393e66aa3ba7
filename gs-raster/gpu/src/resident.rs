//! Frames of splats that kernels of one's own write on the device: nothing is copied.

use crate::error::GpuError;
use crate::memory::Array;
use crate::renderer::Renderer;
use crate::view::View;
use gs_core::{Camera, Color, SplatsRef, cast};
use gs_raster::RasterOptions;

/// How many splats there are, and what their colours are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Number of splats.
    pub splats: u32,
    /// Degree of the spherical harmonics of their colours; none: plain colours.
    pub sh_degree: Option<u8>,
}

/// The columns of splats on the device, `f32`, laid out as in [`gs_core::Splats`].
#[derive(Clone, Copy)]
pub struct SplatArrays<'a> {
    /// `[n, 3]`
    pub means: &'a Array,
    /// `[n, 4]`, `(w, x, y, z)`
    pub quats: &'a Array,
    /// `[n, 3]`
    pub scales: &'a Array,
    /// `[n]`
    pub opacities: &'a Array,
    /// `[n, K, 3]`, or `[n, 3]` for plain colours
    pub colors: &'a Array,
}

/// A frame on the device and what belongs to its gradient, `f32` where nothing else is said.
#[derive(Clone, Copy)]
pub struct FrameArrays<'a> {
    /// `[H, W, 3]`: the frame.
    pub rgb: &'a Array,
    /// `u32`; the last one is the number of (tile, splat) pairs of the frame. Where it is above [`Renderer::entries`] the frame is
    /// not whole, and neither are its gradients.
    pub totals: &'a Array,
    /// Cotangents of the frame, to be written before the gradients are computed: `[H, W, 3]` of its colours, then `[H, W]` of alpha
    /// and `[H, W]` of depth.
    pub d_frame: &'a Array,
    /// Gradients of the splats, column after column: means `[n, 3]`, quaternions `[n, 4]`, scales `[n, 3]`, opacities `[n]`,
    /// centres on the screen `[n, 2]`, radii in pixels `[n]`, and two numbers more per splat.
    pub grads: &'a Array,
    /// Gradients of the colours, laid out as they are.
    pub d_colors: &'a Array,
}

impl Shape {
    /// That of some splats.
    pub fn of(splats: SplatsRef<'_>) -> Self {
        let sh_degree = match splats.color {
            Color::Rgb(_) => None,
            Color::Sh { degree, .. } => Some(*degree),
        };
        Self { splats: cast::to_u32(splats.len()), sh_degree }
    }

    /// Values of a colour.
    fn color_width(self) -> usize {
        self.sh_degree.map_or(3, |degree| 3 * gs_core::sh::coeffs(degree))
    }
}

impl Renderer {
    /// Makes room for Gaussians of this shape, which kernels then write to [`Renderer::splats`].
    ///
    /// # Errors
    /// They do not fit the device.
    pub fn make_room(&mut self, shape: Shape) -> Result<(), GpuError> {
        self.last = None;
        let (gpu, c, n) = (&self.gpu, &mut self.columns, 4 * u64::from(shape.splats));
        c.means.resize(gpu, 3 * n)?;
        c.quats.resize(gpu, 4 * n)?;
        c.scales.resize(gpu, 3 * n)?;
        c.opacities.resize(gpu, n)?;
        c.profiles.resize(gpu, 0)?;
        c.colors.resize(gpu, n * shape.color_width() as u64)
    }

    /// Where the splats are.
    pub fn splats(&self) -> SplatArrays<'_> {
        let c = &self.columns;
        SplatArrays { means: &c.means, quats: &c.quats, scales: &c.scales, opacities: &c.opacities, colors: &c.colors }
    }

    /// Appends the passes of a frame of the Gaussians in [`Renderer::splats`], at least one, and makes room for its gradients.
    ///
    /// # Errors
    /// Something does not fit the device.
    pub fn encode_frame(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        shape: Shape,
        camera: &Camera,
        options: &RasterOptions,
    ) -> Result<(), GpuError> {
        self.last = None;
        let view = View::new(shape, camera, options, self.room(shape.splats));
        self.encode(encoder, &view, false)?;
        self.make_room_for_gradients(&view, shape.color_width())?;
        self.last = Some((view, false));
        Ok(())
    }

    /// Appends the passes of the gradients of that frame, once its cotangents are written.
    ///
    /// # Errors
    /// There was no frame before.
    pub fn encode_backward(&mut self, encoder: &mut wgpu::CommandEncoder) -> Result<(), GpuError> {
        let (view, with_profile) = self.last.ok_or(GpuError::NoFrame)?;
        let gpu = self.gpu.clone();
        self.encode_gradients(encoder, gpu.kernels(with_profile), &view, false);
        Ok(())
    }

    /// Where the last frame and its gradients are.
    pub fn frame(&self) -> FrameArrays<'_> {
        let (w, b) = (&self.work, &self.backward);
        FrameArrays { rgb: &w.rgb, totals: &w.sums, d_frame: &b.d_frame, grads: &b.grads, d_colors: &b.d_colors }
    }

    /// Number of (tile, splat) pairs that the last frame of [`Renderer::encode_frame`] had room for.
    pub fn entries(&self) -> u32 {
        self.last.map_or(0, |(view, _)| view.entries())
    }

    /// Makes room for frames of `total` (tile, splat) pairs.
    ///
    /// # Errors
    /// They do not fit the device.
    pub fn make_room_for_entries(&mut self, total: u32) -> Result<(), GpuError> {
        let entries = self.with_reserve(total);
        self.work.entry_tiles.resize(&self.gpu, 4 * u64::from(entries))
    }
}
