//! Image metrics for rendering: PSNR, SSIM with its gradient, MS-SSIM, masked forms and a weight-free perceptual proxy.

pub mod error;
pub mod masked;
pub mod ms_ssim;
pub mod perceptual;
mod plane;
mod pool;
pub mod psnr;
pub mod report;
pub mod ssim;
mod sweep;
mod window;

pub use error::MetricError;
pub use masked::{MaskedSsim, masked_mse, masked_psnr, masked_ssim};
pub use ms_ssim::{MsSsim, MsSsimOptions, ms_ssim, ms_ssim_with_grad};
pub use perceptual::perceptual_proxy;
pub use psnr::{mse, psnr, psnr_from_mse, psnr_of_mean_mse};
pub use report::{Mean, Scorer, Scores, Summary};
pub use ssim::{Padding, Ssim, SsimOptions, ssim, ssim_with_grad};
