//! Texel Gaussians: from the channels of each texel, predicted by a network or optimised directly, to posed splats.
//!
//! ```text
//! s = exp(clamp ŝ) κ      α = sigmoid(α̂)      r̂ = r/|r|      rgb = max(0, ½ + SH(h, direction))
//! μ = R (c + d) + τ       polar: q = q_R ⊗ r̂        affine: Σ = R Rot(r̂) diag(s²) Rot(r̂)ᵀ Rᵀ
//! ```
//! `c` is the texel's point on the deformed bind pose, `[R | τ]` the blended skinning matrix there, `q_R` its rotation, `κ`
//! the factor of [`crate::scale_refine`] (DUT, supplement). Backward:
//! ```text
//! g_d = Rᵀ g_μ + 2λ d/(3K)     g_ŝ = g_s ∘ s     g_α̂ = g_α α(1 − α)     g_r̂ = q_R* ⊗ g_q     g_r = (g_r̂ − r̂ (r̂·g_r̂))/|r|
//! ```
//! `c`, `[R | τ]`, `q_R` and `κ` are constants, except that `dL/dc` is available. Log-scales outside their range have no
//! gradient.
//!
//! # Rows
//! A map holds the channels of a texel at its pixel. Functions here take compact rows `[K, width]` of the valid texels
//! ([`Channels::gather`], [`Channels::scatter`]). Results are the same bits for any number of threads.
//!
//! # Far from the origin
//! Base maps and splats are `f32` in the world: beyond 10 km from its origin they lose millimetres.
//!
//! ```
//! use gs_texel::gaussians::{COLOR, Channels, DecodeOptions, OPACITY, TexelBase, decode};
//! use glam::{Affine3A, Vec3};
//!
//! // One texel at (0, 1, 0), moved by one along x, with zero channels but for a red DC coefficient.
//! let base = TexelBase {
//!     points: vec![Vec3::Y],
//!     transforms: vec![Affine3A::from_translation(Vec3::X)],
//!     rotations: vec![[1.0, 0.0, 0.0, 0.0]],
//!     kappas: vec![1.0],
//! };
//! let channels = Channels::new(0)?;
//! let mut row = vec![0.0; channels.width()];
//! (row[0..3].fill(-4.0), row[OPACITY] = 0.0, row[COLOR] = 1.0);
//! let splats = decode(&row, channels, &base, &DecodeOptions::default())?;
//! assert_eq!((splats.means[0], splats.opacities[0]), (Vec3::new(1.0, 1.0, 0.0), 0.5));
//! assert_eq!(splats.scales[0], Vec3::splat((-4.0f32).exp()));
//! # Ok::<(), gs_texel::gaussians::ChannelsError>(())
//! ```

mod affine;
mod base;
mod channels;
mod decode;
pub mod row;
pub mod warm_up;

pub use base::{BaseError, TexelBase};
pub use channels::{COLOR, Channels, ChannelsError, OFFSET, OPACITY, QUAT, SCALE};
pub use decode::{Covariance, DecodeOptions, decode, decode_backward, offset_penalty};
