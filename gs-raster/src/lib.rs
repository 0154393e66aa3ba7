//! Draws Gaussian splats on the CPU, and pulls gradients back to every one of their parameters.

mod backward;
mod blend;
mod blend_backward;
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
