//! Differentiable rasteriser of Gaussian splats on the GPU, through wgpu: Vulkan, Metal or Direct3D 12, no CUDA.
//!
//! The same splats, cameras, options, frames and gradients as [`gs_raster`], which is the reference: [`Renderer`] takes the
//! place of its `Workspace`.
//!
//! ```
//! use gs_gpu::{Gpu, Renderer};
//! use gs_raster::{Frame, FrameGrad, RasterOptions, ScreenStats, measure};
//!
//! let Ok(gpu) = Gpu::open() else { return Ok(()) }; // no GPU: render with gs_raster
//! let (splats, camera) = (measure::scene(1000, 3), measure::camera(64)); // or your own
//! let (options, mut frame) = (RasterOptions::default(), Frame::default());
//! let mut renderer = Renderer::new(&gpu);
//! renderer.render_into(&splats, &camera, &options, &mut frame)?;
//!
//! let d = FrameGrad { rgb: vec![1.0; frame.rgb.data.len()], ..FrameGrad::default() };
//! let (mut grad, mut stats) = (gs_core::SplatsGrad::default(), ScreenStats::default());
//! renderer.render_backward_into(&splats, &camera, &options, &d, &mut grad, &mut stats)?;
//! assert_eq!((grad.means.len(), stats.radii.len()), (1000, 1000));
//! # Ok::<(), gs_gpu::GpuError>(())
//! ```
//!
//! # Same bits
//! Two frames of the same splats, camera and options are the same bits on the same adapter and driver
//! ([`Gpu::description`]), and so are their gradients: there are no float atomics, no atomic compaction, and no sum whose
//! order depends on the width of a subgroup. WGSL leaves the rounding of some functions to the device, so between devices,
//! and between GPU and CPU, only a tolerance holds: the table of gs-raster's `tests/raster/production.rs`, which the tests of this
//! crate apply to the same scenes.
//!
//! # Accuracy
//! WGSL has no `f64`. Projection and the offsets of pixels are computed in pairs of `f32` with about 46 bits (Dekker 1971),
//! behind a barrier that no compiler can reassociate across. The device's `exp2` is measured when the first kernel is
//! built; where its relative error exceeds 2.5e-7 a polynomial takes its place.
//!
//! # The passes
//! 1. project: one thread a splat, ellipse and colour;
//! 2. depth order: stable radix sort, by 24 bits of the low part of the depth and then by its `f32`, ties by row;
//! 3. tile lists: counted, scanned, written splat by splat, and sorted stably by tile;
//! 4. blend: one workgroup a tile, one thread a pixel, front to back;
//! 5. blend backward: one thread an entry walks the pixels of its tile, on a diagonal schedule that keeps the order of
//!    blending for each pixel, and writes one record of twelve sums;
//! 6. splats backward: each splat adds its records in a tree of fixed shape, then projection and colour backward.
//!
//! All kernels keep to WebGPU's default limits: 8 storage buffers, 16 KiB of workgroup memory, 256 threads.
//!
//! # What it leaves out
//! More than three channels, and what [`gs_raster`] leaves out. A frame whose (tile, splat) pairs do not fit one buffer is refused: its gradient
//! takes 48 bytes of each, so 2.8 million fit the limits of a browser and 40 million and more those of a graphics card; the frame alone takes 4.
//! Splats wider than about 10⁹ pixels are not drawn. `RasterOptions::box_sigmas` cuts tiles of 16×16 pixels here, blocks of 4×4 on the CPU. A radius in
//! `ScreenStats` is above 0 where the splat touches a tile; on the CPU only where some of its tiles were not yet opaque when its turn came.

#![warn(unreachable_pub)]
#![warn(clippy::allow_attributes_without_reason)]

mod backward;
mod device;
mod error;
mod kernels;
mod memory;
mod probe;
mod rasterizer;
mod renderer;
mod resident;
mod sort;
mod timer;
mod view;

pub use device::{Gpu, GpuOptions};
pub use error::GpuError;
pub use kernels::{Bind, INDEX, Kernel};
pub use memory::{Array, Readback};
pub use renderer::Renderer;
pub use resident::{FrameArrays, Shape, SplatArrays};
pub use sort::groups;
