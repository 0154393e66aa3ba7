//! Image metrics for rendering: PSNR, SSIM with its gradient, MS-SSIM, masked forms and a weight-free perceptual proxy.

pub mod error;
pub mod ms_ssim;
mod pool;
pub mod psnr;
pub mod ssim;
mod sweep;
mod window;

pub use error::MetricError;
pub use ms_ssim::{MsSsim, MsSsimOptions, ms_ssim, ms_ssim_with_grad};
pub use psnr::{mse, psnr, psnr_from_mse, psnr_of_mean_mse};
pub use ssim::{Padding, Ssim, SsimOptions, ssim, ssim_with_grad};
