//! Texel Gaussians: what a network (or nothing but an optimiser) says of each texel, and where the posed surface takes it.
//!
//! ```text
//! s = exp(clamp ŝ) κ      α = sigmoid(α̂)      r̂ = r/|r|      rgb = max(0, ½ + SH(h, direction))
//! μ = R (c + d) + τ       polar: q = q_R ⊗ r̂        affine: Σ = R Rot(r̂) diag(s²) Rot(r̂)ᵀ Rᵀ
//! ```
//! `c` is the texel's point on the deformed bind pose, `[R | τ]` the blended skinning matrix there, `q_R` its rotation, `κ`
//! the refinement of [`crate::scale_refine`] (DUT, supplement). Way back:
//! ```text
//! g_d = Rᵀ g_μ + 2λ d/(3K)     g_ŝ = g_s ∘ s     g_α̂ = g_α α(1 − α)     g_r̂ = q_R* ⊗ g_q     g_r = (g_r̂ − r̂ (r̂·g_r̂))/|r|
//! ```
//! `c`, `[R | τ]`, `q_R` and `κ` are constants, except that `dL/dc` can be asked for. Log-scales outside their range have no
//! gradient.
//!
//! # Rows
//! A map holds a texel's channels at its pixel; everything here works on compact rows of the valid texels alone
//! ([`Channels::gather`], [`Channels::scatter`]). Results are the same bits for any number of threads.
//!
//! # Far from the origin
//! `f32` positions in metres lose millimetres beyond 10 km. So the matrices are taken relative to the root in `f64`
//! ([`about`]) before they are narrowed, the splats are made there, and the camera follows ([`camera_about`]).

mod affine;
mod base;
mod channels;
mod decode;
pub mod merge;
pub mod row;
pub mod thin;
pub mod warm_up;

pub use base::{BaseError, TexelBase, about, camera_about};
pub use channels::{COLOR, Channels, ChannelsError, OFFSET, OPACITY, QUAT, SCALE};
pub use decode::{Covariance, DecodeOptions, decode, decode_backward, offset_penalty};
