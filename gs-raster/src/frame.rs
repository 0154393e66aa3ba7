//! What drawing gives, and what comes back into it.

/// A drawn frame. All arrays are row-major, origin top left.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Frame {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height, width, 3]`: colour over the background (premultiplied colour if the background is black).
    pub rgb: Vec<f32>,
    /// `[height, width]`: accumulated alpha, `1 − T`.
    pub alpha: Vec<f32>,
    /// `[height, width]`: alpha-weighted camera depth `Σ w z` (divide by alpha for the mean), world units.
    pub depth: Vec<f32>,
}

/// Cotangents of a [`Frame`].
#[derive(Clone, Debug, PartialEq, Default)]
pub struct FrameGrad {
    /// `dL/d rgb`, `[height, width, 3]`.
    pub rgb: Vec<f32>,
    /// `dL/d alpha`, `[height, width]`; empty for none.
    pub alpha: Vec<f32>,
    /// `dL/d depth`, `[height, width]`; empty for none.
    pub depth: Vec<f32>,
}

/// What density control wants to know of each splat in one frame.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct ScreenStats {
    /// `dL/d means2d`, pixels, one per splat; zero where not visible.
    pub grad_means2d: Vec<[f32; 2]>,
    /// Radius of three standard deviations along the larger axis, pixels; 0 where not visible in this frame.
    pub radii: Vec<f32>,
}
