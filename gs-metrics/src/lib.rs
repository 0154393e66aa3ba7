//! Image metrics: scores of renders against ground-truth images, with gradients for those used as loss terms.
//!
//! | score | value | gradient | module |
//! |---|---|---|---|
//! | MSE, PSNR | [`mse`], [`psnr`](fn@psnr) | | [`psnr`](mod@psnr) |
//! | SSIM, zero-padded (training loss) or valid area (published) | [`ssim`](fn@ssim) | [`Ssim::value_and_grad`] | [`ssim`](mod@ssim) |
//! | MS-SSIM | [`ms_ssim`](fn@ms_ssim) | [`MsSsim::value_and_grad`] | [`ms_ssim`](mod@ms_ssim) |
//! | distance of amplitude spectra | [`AmplitudeLoss::value`] | [`AmplitudeLoss::value_and_grad`] | [`spectrum`] |
//! | sharpness relative to the ground truth | [`Sharpness`] | | [`sharpness`] |
//! | trajectories of points: temporal spectrum, second differences | [`high_energies`](trajectory::high_energies) | | [`trajectory`] |
//! | masked PSNR and SSIM (DyCheck) | [`masked_psnr`], [`masked_ssim`] | | [`masked`] |
//! | PSNR and SSIM of a person, as papers on avatars have them | [`person_scores`] | | [`person`] |
//! | optical flow (Farneback), its colour coding and statistics | [`farneback`](flow::farneback), [`Flow`] | | [`flow`] |
//! | tOF: flow of a render against flow of the ground truth | [`Tof`] | | [`tof`] |
//! | co-visibility masks: what enough other images show of an image | [`seen`] | | [`covisible`] |
//! | instance masks: AP, PQ, F1, mIoU | [`Segmentation`] | | [`segmentation`] |
//! | perceptual **proxy**, without learned weights, not LPIPS | [`perceptual_proxy`], [`masked_perceptual_proxy`] | | [`perceptual`] |
//! | linear map of colours nearest to the ground truth, or one with an offset | [`ColorMap::fit`], [`ColorMap::fit_with_offset`] | [`ColorMap::pull_back`] | [`ColorMap`] |
//! | LPIPS, with the user's weights | [`Lpips::distance`] | | [`lpips`] |
//! | ID-MRF texture loss on fixed filters, without learned weights | [`Mrf::value`](mrf::Mrf::value) | [`Mrf::value_and_grad`](mrf::Mrf::value_and_grad) | [`mrf`] |
//! | means over views | [`Scorer`], [`Summary`] | | [`report`] |
//!
//! # Conventions
//! Images are [`gs_core::Image`]: row-major, channels interleaved, display-encoded values in `[0, 1]`, 1 to 4 channels
//! (1 or 3 for some metrics). All channels count alike. Values are not clamped or quantised; a protocol that scores 8-bit
//! files quantises first ([`Quantise`]), one that scores at half resolution reduces then ([`half_size`]). Gradients are with
//! respect to the **first** image and have its shape.
//!
//! Values and gradients are bitwise equal for any number of threads of the current rayon pool. Bad input is a [`MetricError`]
//! that says what is wrong, where, and what to do. Images with NaN pixels are errors and have no score.
//!
//! ```
//! use gs_core::Image;
//! use gs_metrics::{Mean, SsimOptions, psnr, ssim};
//! let grey = Image { width: 16, height: 16, channels: 3, data: vec![0.5; 768] };
//! let darker = Image { data: vec![0.4; 768], ..grey.clone() };
//! assert!((psnr(&grey, &darker)? - 20.0).abs() < 1e-5);
//! assert_eq!(psnr(&grey, &grey)?, f64::INFINITY);
//! assert_eq!(ssim(&grey, &grey, &SsimOptions::default())?, 1.0);
//! assert_eq!(Mean::of([20.0, f64::INFINITY]).to_string(), "20.0000 (1 infinite)");
//! # Ok::<(), gs_metrics::MetricError>(())
//! ```
//!
//! # Not included
//! Learned weights of any kind (LPIPS and VGG-19 read them from files of the user); colour-managed and HDR comparisons.
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

pub mod color_map;
pub mod covisible;
pub mod error;
mod fft2;
pub mod flow;
mod frozen;
mod half;
pub mod lpips;
pub mod masked;
pub mod mrf;
pub mod ms_ssim;
pub mod perceptual;
pub mod person;
mod plane;
mod pool;
pub mod psnr;
mod quantise;
pub mod report;
pub mod segmentation;
pub mod sharpness;
pub mod spectrum;
pub mod ssim;
mod sweep;
#[cfg(feature = "testkit")]
pub mod testkit;
pub mod tof;
pub mod trajectory;
mod weights;
mod window;

pub use color_map::ColorMap;
pub use covisible::{CovisibleOptions, Seen, seen};
pub use error::MetricError;
pub use flow::Flow;
pub use half::half_size;
pub use lpips::{Lpips, LpipsNet, LpipsRange};
pub use masked::{MaskedSsim, masked_mse, masked_psnr, masked_ssim};
pub use ms_ssim::{MsSsim, MsSsimOptions, ms_ssim};
pub use perceptual::{masked_perceptual_proxy, perceptual_proxy};
pub use person::{PersonScores, person_scores};
pub use psnr::{mse, psnr, psnr_from_mse, psnr_of_mean_mse};
pub use quantise::Quantise;
pub use report::{Mean, Scorer, Scores, Summary};
pub use segmentation::{Overlap, SegmentScores, Segmentation};
pub use sharpness::Sharpness;
pub use spectrum::{AmplitudeLoss, AmplitudeOptions, FftNorm, Reduce};
pub use ssim::{Padding, Ssim, SsimOptions, ssim};
pub use tof::{Tof, TofOptions, TofScore};
pub use weights::WeightsError;
