//! Draws Gaussian splats on the CPU, and pulls gradients back to every one of their parameters.
//!
//! ```
//! use gs_raster::{RasterOptions, Workspace, render};
//!
//! let (splats, camera) = (gs_raster::measure::scene(1000, 3), gs_raster::measure::camera(64));
//! let frame = render(&splats, &camera, &RasterOptions::default(), &mut Workspace::new());
//! assert_eq!(frame.rgb.len(), 64 * 64 * 3);
//! ```
//!
//! # Conventions
//! Those of [`gs_core`]: OpenCV axes, pixel centres at +½, quaternions `(w, x, y, z)` of any length. Colours are blended
//! as they are, front to back by camera depth, ties by row. Splats and cameras must have passed their `check`; the
//! frame is finite then.
//!
//! # Mathematics
//! EWA splatting (Zwicker et al. 2001) with the constants of 3D Gaussian Splatting (Kerbl et al. 2023), all in
//! [`RasterOptions`]; [`mod@reference`] states every formula in plain loops. Anti-aliasing scales opacities by the square root
//! of the determinant ratio before and after dilation (Yu et al. 2024, Mip-Splatting).
//!
//! # Kernels
//! A splat falls off as the Gaussian or as one of the bent kernels of [`gs_core::Kernel`]; their parameters get gradients
//! in [`gs_core::SplatsGrad::kernel`]. Supports come from the exact inverse of the fall-off, so soft kernels keep their
//! skirts and sharp ones cost fewer tiles. Kernels at rest (`λ = ½`, acutance 0) give the Gaussian's frame to the bit, by
//! its own path, and still learn. The frequency kernel with `β ≥ ½ + λ` never decays; it ends at
//! [`RasterOptions::kernel_cut`].
//!
//! # How the fast path goes
//! 1. depths of all splats, one stable radix sort (exact to `f64`);
//! 2. in chunks front to back: project in `f64`, list the open tiles an ellipse touches, colour what was listed;
//! 3. blend each tile, sixteen pixels a vector; a tile whose pixels are all opaque closes and takes nothing further;
//! 4. backward: each (tile, splat) pair writes one record, each splat adds its records in tile order.
//!
//! The frame and its gradients are the same bits for any number of threads. Between instruction sets they agree within
//! the tolerance table of `tests/production.rs`. Hidden splats, empty columns and closed tiles cost next to nothing and
//! change nothing; the only approximations are those of `f32` arithmetic.
//!
//! # What it leaves out
//! Distortion, rolling shutter, depth sorting per pixel, second-order gradients, cotangents of the camera.

mod backward;
mod blend;
mod blend_backward;
#[cfg(test)]
mod brute_force;
mod count;
mod forward;
pub mod frame;
mod kernel;
pub mod measure;
pub mod options;
mod project;
pub mod reference;
mod rows;
pub mod simd;
mod sort;
pub mod tiles;
mod workspace;

pub use backward::render_backward_into;
pub use count::blend_counts;
pub use forward::render_into;
pub use frame::{Frame, FrameGrad, ScreenStats};
pub use options::{ClampGrad, RasterOptions, SimdLevel};
pub use workspace::Workspace;

use gs_core::{Camera, Splats, SplatsGrad};

/// Draws `splats` as `camera` sees them. [`render_into`] does the same without allocating.
pub fn render(splats: &Splats, camera: &Camera, options: &RasterOptions, workspace: &mut Workspace) -> Frame {
    let mut frame = Frame::default();
    render_into(splats, camera, options, workspace, &mut frame);
    frame
}

/// Gradient of a frame's loss with respect to every column of `splats`, and screen-space statistics. Must follow
/// [`render`] of the same splats, camera and options with the same workspace. [`render_backward_into`] does the same
/// without allocating.
pub fn render_backward(
    splats: &Splats,
    camera: &Camera,
    options: &RasterOptions,
    workspace: &mut Workspace,
    d: &FrameGrad,
) -> (SplatsGrad, ScreenStats) {
    let (mut grad, mut stats) = (SplatsGrad::default(), ScreenStats::default());
    render_backward_into(splats, camera, options, workspace, d, &mut grad, &mut stats);
    (grad, stats)
}
