//! Differentiable rasteriser of Gaussian splats on the CPU: images forward, gradients of every parameter and of the
//! camera backward.
//!
//! ```
//! use gs_raster::{FrameGrad, RasterOptions, Workspace, measure, render, render_backward};
//!
//! let (splats, camera) = (measure::scene(1000, 3), measure::camera(64)); // or your own
//! let (options, mut workspace) = (RasterOptions::default(), Workspace::new());
//! let frame = render(&splats, &camera, &options, &mut workspace);
//! assert_eq!(frame.rgb.data.len(), 64 * 64 * 3);
//!
//! let d = FrameGrad { rgb: vec![1.0; frame.rgb.data.len()], ..FrameGrad::default() };
//! let (grad, stats) = render_backward(&splats, &camera, &options, &mut workspace, &d);
//! assert_eq!((grad.means.len(), stats.radii.len()), (1000, 1000));
//! ```
//!
//! # Conventions
//! Those of [`gs_core`]: OpenCV axes, pixel centres at +½, quaternions `(w, x, y, z)` of any length. Colours are
//! composited as given (display-encoded), front to back by camera depth, ties by row. Splats and cameras must have
//! passed their `check`; the frame is finite then.
//!
//! # Mathematics
//! EWA splatting (Zwicker et al. 2001) with the constants of 3D Gaussian Splatting (Kerbl et al. 2023), all in
//! [`RasterOptions`]; [`mod@reference`] states every formula in plain loops. Anti-aliasing scales opacities by the
//! square root of the determinant ratio before and after dilation (Yu et al. 2024, Mip-Splatting).
//!
//! # Kernels
//! The kernel profile is the Gaussian or one of the piecewise linear ones of [`gs_core::Kernel`], whose parameters get
//! gradients in [`gs_core::SplatsGrad::kernel`]. Supports come from the exact inverse of the profile, so soft kernels
//! are not truncated and sharp ones cost fewer tiles. Neutral parameters (`λ = ½`, acutance 0) give the Gaussian's
//! frame bit for bit, by its own path, and still get gradients. The frequency kernel with `β ≥ ½ + λ` never decays; it
//! ends at [`RasterOptions::kernel_cut`].
//!
//! # The fast path
//! 1. depths of all splats, one stable radix sort (exact to `f64`);
//! 2. in chunks front to back: project in `f64`, list the open tiles an ellipse touches, evaluate the colour of listed
//!    splats;
//! 3. blend each tile, sixteen pixels per vector; a tile whose pixels are all opaque closes and takes no further
//!    splats;
//! 4. backward: each (tile, splat) pair writes one record, each splat adds its records in tile order.
//!
//! The frame and its gradients are the same bits for any number of threads. Between instruction sets they agree within
//! the tolerance table of `tests/raster/production.rs`; `tests/golden` holds images and gradients of independent renderers.
//! Hidden splats and closed tiles cost next to nothing and change nothing; the only approximations are those of `f32`
//! arithmetic.
//!
//! # Gradients of the camera
//! [`render_backward_with_camera`] also returns the gradient of pose and intrinsics ([`CameraGrad`]), by every path: centre and
//! shape of the ellipse, the clamp of the Jacobian (whose bounds move with the principal point), anti-aliased opacities,
//! the direction from which colours are seen, depth. What culls or orders splats has no gradient. Sums over splats are in
//! `f64`, in blocks of fixed size. Whoever does not ask pays nothing.
//!
//! # More channels
//! [`render_channels`] and [`render_channels_backward`] take colours of any number of channels, in groups of three over one
//! projection, order and lists.
//!
//! # Several cameras
//! [`render_views`] and [`render_views_backward`] draw such colours, shared or of each camera, from several cameras, and sum
//! the gradients of the splats over them.
//!
//! # Other devices
//! [`Rasterizer`] is the same work on any device; [`Workspace`] is the one on the CPU.
//!
//! # What it leaves out
//! Distortion, rolling shutter, depth sorting per pixel, second-order gradients.

#![warn(unreachable_pub)]
#![warn(clippy::allow_attributes_without_reason)]

mod backward;
mod blend;
mod blend_backward;
#[cfg(test)]
mod brute_force;
mod camera_grad;
pub mod channels;
mod count;
mod forward;
mod frame;
mod kernel;
mod lanes;
pub mod measure;
mod options;
mod project;
mod rasterizer;
pub mod reference;
mod rows;
pub mod simd;
mod sort;
pub mod tiles;
mod views;
mod workspace;

pub use backward::{render_backward_into, render_backward_with_camera};
pub use camera_grad::CameraGrad;
pub use channels::{Channels, ChannelsError, render_channels, render_channels_backward};
pub use count::blend_counts;
pub use forward::render_into;
pub use frame::{Frame, FrameGrad, Screen, ScreenStats};
pub use options::{ClampGrad, OptionError, RasterOptions, SimdLevel};
pub use rasterizer::{DeviceError, Rasterizer};
pub use views::{ViewsError, ViewsGrad, render_views, render_views_backward};
pub use workspace::Workspace;

use gs_core::{Camera, SplatsGrad, SplatsRef};

/// Renders `splats` from `camera`. [`render_into`] does the same without allocating.
///
/// ```
/// use gs_core::{Camera, Color, Kernel, Splats};
/// use gs_raster::{RasterOptions, Workspace, render};
///
/// // One green splat of opacity ½ in front of the centre of a single pixel.
/// let splats = Splats {
///     means: vec![glam::Vec3::new(0.0, 0.0, 2.0)],
///     quats: vec![[1.0, 0.0, 0.0, 0.0]],
///     scales: vec![glam::Vec3::splat(0.1)],
///     opacities: vec![0.5],
///     color: Color::Rgb(vec![[0.0, 1.0, 0.0]]),
///     kernel: Kernel::Gaussian,
/// };
/// let (rotation, translation) = (glam::DMat3::IDENTITY, glam::DVec3::ZERO);
/// let camera = Camera { width: 1, height: 1, fx: 10.0, fy: 10.0, cx: 0.5, cy: 0.5, rotation, translation };
/// let options = RasterOptions { background: [1.0, 0.0, 0.0], ..RasterOptions::default() };
/// let frame = render(&splats, &camera, &options, &mut Workspace::new());
/// for (got, want) in [(frame.rgb.data[0], 0.5), (frame.rgb.data[1], 0.5), (frame.alpha[0], 0.5), (frame.depth[0], 1.0)] {
///     assert!((got - want).abs() < 1e-6);
/// }
/// ```
pub fn render<'a>(
    splats: impl Into<SplatsRef<'a>>,
    camera: &Camera,
    options: &RasterOptions,
    workspace: &mut Workspace,
) -> Frame {
    let mut frame = Frame::default();
    render_into(splats, camera, options, workspace, &mut frame);
    frame
}

/// Gradient of the loss whose cotangents are `d` with respect to every column of `splats`, and screen-space statistics.
///
/// Must follow [`render`] of the same splats, camera and options with the same workspace. [`render_backward_into`] does
/// the same without allocating.
///
/// ```
/// use gs_raster::{FrameGrad, RasterOptions, Workspace, measure, render, render_backward};
///
/// // Alpha of the whole image against the opacity of one splat: a central difference agrees.
/// let (mut splats, camera, options) = (measure::scene(50, 0), measure::camera(24), RasterOptions::default());
/// splats.opacities.fill(0.3);
/// let mut workspace = Workspace::new();
/// let mut loss = |o: f32| {
///     splats.opacities[7] = o;
///     let frame = render(&splats, &camera, &options, &mut workspace);
///     let d = FrameGrad { alpha: vec![1.0; 24 * 24], ..FrameGrad::default() };
///     let (grad, _) = render_backward(&splats, &camera, &options, &mut workspace, &d);
///     (frame.alpha.iter().map(|&a| f64::from(a)).sum::<f64>(), f64::from(grad.opacities[7]))
/// };
/// let (slope, gradient) = ((loss(0.301).0 - loss(0.299).0) / 0.002, loss(0.3).1);
/// assert!((slope / gradient - 1.0).abs() < 0.05, "{slope} {gradient}");
/// ```
pub fn render_backward<'a>(
    splats: impl Into<SplatsRef<'a>>,
    camera: &Camera,
    options: &RasterOptions,
    workspace: &mut Workspace,
    d: &FrameGrad,
) -> (SplatsGrad, ScreenStats) {
    let (mut grad, mut stats) = (SplatsGrad::default(), ScreenStats::default());
    render_backward_into(splats, camera, options, workspace, d, &mut grad, &mut stats);
    (grad, stats)
}
