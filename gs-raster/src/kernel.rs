//! The fall-off of a splat as a seam of the blend: what happens between the Mahalanobis distance and alpha.
//!
//! The blend hands a kernel `p = log₂(o' g)` of sixteen pixels and asks for `o' ψ(g)`; on the way back it hands over
//! `dL/dα` and asks for `s = dL/d ln g`, for what the opacity gets, and for any sums of the kernel's own parameters.
//! A kernel with parameters reads them from the tile row (see [`crate::tiles::Row`]) and keeps its sums in `Extra`.

use crate::simd;
use fearless_simd::{f32x16, mask32x16, prelude::*};

/// A fall-off. Implementors are zero-sized; the blend is compiled once per kernel.
pub(crate) trait Falloff: Copy + Send + Sync {
    /// `o' ψ(g)` of each lane, and whether it reaches `min_alpha` (given as such and as its log₂).
    fn sample<S: Simd>(simd: S, p: f32x16<S>, log2_min_alpha: f32x16<S>) -> (f32x16<S>, mask32x16<S>);

    /// `s = dL/d ln g` from `o' ψ` and `dL/dα` (zero where capped or skipped).
    fn backward<S: Simd>(raw: f32x16<S>, d_alpha: f32x16<S>) -> f32x16<S>;

    /// Largest `a² + b²`, in the blend's log₂ units, at which a splat of `log₂ o'` still reaches `log₂ min_alpha`.
    fn support(log2_opacity: f64, log2_min_alpha: f64) -> f64;
}

/// The plain Gaussian, `ψ(g) = g`: opacity folds into the exponent and the threshold test needs no exponential.
#[derive(Clone, Copy)]
pub(crate) struct Gaussian;

impl Falloff for Gaussian {
    #[inline(always)]
    fn sample<S: Simd>(simd: S, p: f32x16<S>, log2_min_alpha: f32x16<S>) -> (f32x16<S>, mask32x16<S>) {
        (simd::exp2(simd, p), p.simd_ge(log2_min_alpha))
    }

    #[inline(always)]
    fn backward<S: Simd>(raw: f32x16<S>, d_alpha: f32x16<S>) -> f32x16<S> {
        raw * d_alpha
    }

    #[inline(always)]
    fn support(log2_opacity: f64, log2_min_alpha: f64) -> f64 {
        log2_opacity - log2_min_alpha
    }
}
