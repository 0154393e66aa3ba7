//! Draws Gaussian splats on the CPU, and pulls gradients back to every one of their parameters.

pub mod frame;
pub mod options;
pub mod reference;

pub use frame::{Frame, FrameGrad, ScreenStats};
pub use options::{ClampGrad, RasterOptions};
