//! Outputs of the rasteriser and their cotangents.

use gs_core::Image;

/// A rendered frame: colour, alpha and depth. All arrays are row-major, origin top left.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Frame {
    /// `[height, width, 3]`: colour composited over the background, so premultiplied by alpha if that is black. Not
    /// clamped above 1.
    pub rgb: Image,
    /// `[height, width]`: accumulated alpha `1 − T`, in `[0, 1]`.
    pub alpha: Vec<f32>,
    /// `[height, width]`: alpha-weighted camera depth `Σ w z` (divide by alpha for the mean), world units.
    pub depth: Vec<f32>,
}

/// Cotangents of a [`Frame`]: the gradient of a loss with respect to each of its arrays.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct FrameGrad {
    /// `dL/d rgb`, `[height, width, 3]`; empty stands for zero.
    pub rgb: Vec<f32>,
    /// `dL/d alpha`, `[height, width]`; empty stands for zero.
    pub alpha: Vec<f32>,
    /// `dL/d depth`, `[height, width]`; empty stands for zero.
    pub depth: Vec<f32>,
}

/// Screen-space statistics of each splat in one frame, for densification.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct ScreenStats {
    /// `[n]`: gradient with respect to the projected centre, per pixel; zero for splats that are not visible.
    pub grad_means2d: Vec<[f32; 2]>,
    /// `[n]`: three standard deviations along the larger screen axis, pixels, after dilation and whatever the kernel; 0
    /// for splats that are not visible.
    pub radii: Vec<f32>,
}

/// Where splats lie on the screen in one frame; zeros for those listed in no tile.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Screen {
    /// `[n]`: projected centre, pixels.
    pub means2d: Vec<[f32; 2]>,
    /// `[n]`: camera depth of the mean, world units.
    pub depths: Vec<f32>,
    /// `[n]`: as [`ScreenStats::radii`].
    pub radii: Vec<f32>,
}
