//! The fall-off of a splat as a seam of the blend: what happens between the Mahalanobis distance and alpha.
//!
//! The blend hands a kernel `p = log₂(o' g)` of sixteen pixels and asks for `o' ψ(g)`; on the way back it hands over
//! `dL/dα` and asks what opacity, geometry and the kernel's own parameters get. [`Bent`] works in units of the opacity,
//! so that no sample is divided by it: with `R = o' g`, `O = o'` and the constants `u, κ` of [`gs_core::kernel::Bend`],
//! ```text
//! M = R − O/2     H = min(R, O − R)     E = κ H      o' ψ = R + u · clamp(M, −E, E)
//! outer: E < |M|     o' dψ/d ln g = R · (outer ? k : 1 + u)
//! sums of the parameters:  Σ v sign H over outer samples,  Σ v M over the others        v = dL/d(o' ψ)
//! ```
//! A kernel with clamped knots has `E = 1` instead, above any `|M|`. `O` is the vector exponential of the very `log₂ o'` that the samples start from. A row with `u = 0` takes the
//! Gaussian's path, to the bit.

use crate::blend::Limits;
use crate::rows::Row;
use crate::simd;
use crate::tiles::LOG2_SCALE;
use fearless_simd::{f32x16, mask32x16, prelude::*};
use gs_core::Kernel;
use gs_core::kernel::Bend;
use rayon::prelude::*;

/// A fall-off. The blend is compiled once per implementor.
pub(crate) trait Falloff: Copy + Send + Sync {
    /// Whether rows carry a [`RowBend`] and records the two sums of its parameters.
    const BENT: bool;

    /// Constants of the splat in row `index` of the caller's columns, but for its opacity.
    fn bend(self, index: u32) -> RowBend;

    /// Sixteen samples of a row at `p = log₂(o' g)`.
    fn sample<S: Simd>(simd: S, row: &Row, p: f32x16<S>, limits: Limits) -> Sample<S>;

    /// Cotangents of the samples from `dL/dα`, zero in the lanes that do not learn.
    fn backward<S: Simd>(simd: S, row: &Row, sample: Sample<S>, learns: mask32x16<S>, d_alpha: f32x16<S>) -> Pull<S>;

    /// Largest `a² + b²`, in the blend's log₂ units, at which a splat of `log₂ o'` still reaches `log₂ min_alpha`;
    /// negative if nowhere.
    fn support(self, index: u32, log2_opacity: f64, log2_min_alpha: f64) -> f64;

    /// Largest Mahalanobis distance at which an opaque splat is visible, given the Gaussian's.
    fn widest(self, index: u32, gaussian: f64, log2_min_alpha: f64) -> f64;
}

/// Sixteen samples.
#[derive(Clone, Copy)]
pub(crate) struct Sample<S: Simd> {
    /// `o' g`.
    pub plain: f32x16<S>,
    /// `o' ψ(g)`.
    pub raw: f32x16<S>,
    /// Whether `raw` reaches `min_alpha`.
    pub reached: mask32x16<S>,
}

/// What sixteen samples give back.
#[derive(Clone, Copy)]
pub(crate) struct Pull<S: Simd> {
    /// `dL/d ln o'`.
    pub opacity: f32x16<S>,
    /// `dL/d ln g`.
    pub shape: f32x16<S>,
    /// Sums of the kernel's parameters: foot and plateau, flank.
    pub bend: [f32x16<S>; 2],
}

/// Constants of a bent row.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RowBend {
    pub u: f32,
    /// `E = κ H + bias`.
    pub kappa: f32,
    pub bias: f32,
    /// Slope of foot and plateau.
    pub foot: f32,
    /// Samples at `p` more than this below `log₂ o'` are cut off (unbounded fall-offs only).
    pub cut: f32,
    /// `o'`.
    pub opacity: f32,
}

/// The plain Gaussian, `ψ(g) = g`: opacity folds into the exponent and the threshold test needs no exponential.
#[derive(Clone, Copy)]
pub(crate) struct Gaussian;

impl Falloff for Gaussian {
    const BENT: bool = false;

    #[inline(always)]
    fn bend(self, _: u32) -> RowBend {
        RowBend::default()
    }

    #[inline(always)]
    fn sample<S: Simd>(simd: S, _: &Row, p: f32x16<S>, limits: Limits) -> Sample<S> {
        let raw = simd::exp2(simd, p);
        Sample { plain: raw, raw, reached: p.simd_ge(f32x16::splat(simd, limits.log2_min_alpha)) }
    }

    #[inline(always)]
    fn backward<S: Simd>(simd: S, _: &Row, sample: Sample<S>, learns: mask32x16<S>, d_alpha: f32x16<S>) -> Pull<S> {
        let zero = f32x16::splat(simd, 0.0);
        let s = learns.select(sample.raw * d_alpha, zero);
        Pull { opacity: s, shape: s, bend: [zero; 2] }
    }

    #[inline(always)]
    fn support(self, _: u32, log2_opacity: f64, log2_min_alpha: f64) -> f64 {
        log2_opacity - log2_min_alpha
    }

    #[inline(always)]
    fn widest(self, _: u32, gaussian: f64, _: f64) -> f64 {
        gaussian
    }
}

/// The piecewise linear fall-offs of [`gs_core::Kernel`].
#[derive(Clone, Copy)]
pub(crate) struct Bent<'a> {
    kernel: &'a Kernel,
    /// Constants of every splat of the caller: a splat has many entries, and its constants cost divisions.
    bends: &'a [RowBend],
    /// Largest `a² + b²` of a splat that never decays.
    cut: f64,
}

/// Splats whose constants one task makes, at least.
const BEND_BLOCK: usize = 2048;
/// Lowest argument of the vector exponential.
const LOWEST: f32 = -126.0;
/// The inverse of ψ is taken at a threshold this much lower, against the rounding of ψ in `f32`.
const CONSERVATIVE: f64 = 1.0 - 1e-6;

impl<'a> Bent<'a> {
    /// The fall-off of `n` splats; `kernel` must not be the Gaussian, `kernel_cut` is a squared Mahalanobis distance.
    /// Their constants are written to `bends`.
    pub fn new(kernel: &'a Kernel, n: usize, kernel_cut: f64, bends: &'a mut Vec<RowBend>) -> Self {
        let cut = kernel_cut * LOG2_SCALE * LOG2_SCALE;
        bends.resize(n, RowBend::default());
        bends.par_iter_mut().with_min_len(BEND_BLOCK).enumerate().for_each(|(row, bend)| {
            *bend = kernel.bend(row).map_or(RowBend::default(), |b| RowBend::new(&b, cut));
        });
        Self { kernel, bends, cut }
    }
}

impl RowBend {
    /// Constants of a splat but for its opacity; `cut` ends unbounded fall-offs.
    fn new(bend: &Bend<f64>, cut: f64) -> Self {
        let (kappa, bias) = if bend.is_clamped() { (0.0, 1.0) } else { (bend.kappa as f32, 0.0) };
        let cut = if bend.is_unbounded() { cut as f32 } else { f32::INFINITY };
        Self { u: bend.u as f32, kappa, bias, foot: bend.foot as f32, cut, opacity: 0.0 }
    }
}

/// `M`, `H` and `E`.
#[inline(always)]
fn folded<S: Simd>(simd: S, bend: &RowBend, plain: f32x16<S>) -> [f32x16<S>; 3] {
    let c = |v: f32| f32x16::splat(simd, v);
    let h = plain.min(c(bend.opacity) - plain);
    [plain - c(0.5 * bend.opacity), h, h.mul_add(c(bend.kappa), c(bend.bias))]
}

impl Falloff for Bent<'_> {
    const BENT: bool = true;

    #[inline(always)]
    fn bend(self, index: u32) -> RowBend {
        self.bends[index as usize]
    }

    #[inline(always)]
    fn sample<S: Simd>(simd: S, row: &Row, p: f32x16<S>, limits: Limits) -> Sample<S> {
        let bend = &row.bend;
        let c = |v: f32| f32x16::splat(simd, v);
        let plain = simd::exp2(simd, p);
        if bend.u == 0.0 {
            return Sample { plain, raw: plain, reached: p.simd_ge(c(limits.log2_min_alpha)) };
        }
        let [m, _, reach] = folded(simd, bend, plain);
        let residual = m.max(c(0.0) - reach).min(reach);
        let raw = residual.mul_add(c(bend.u), plain);
        let reached = raw.simd_ge(c(limits.min_alpha)) & p.simd_ge(c((row.lo - bend.cut).max(LOWEST)));
        Sample { plain, raw, reached }
    }

    #[inline(always)]
    fn backward<S: Simd>(simd: S, row: &Row, sample: Sample<S>, learns: mask32x16<S>, d_alpha: f32x16<S>) -> Pull<S> {
        let bend = &row.bend;
        let c = |v: f32| f32x16::splat(simd, v);
        let zero = c(0.0);
        let v = learns.select(d_alpha, zero);
        // Lanes that do not learn may hold anything, not a number among it.
        let plain = learns.select(sample.plain, zero);
        let [m, h, reach] = folded(simd, bend, plain);
        let outer = reach.simd_lt(m.abs());
        let signed = m.simd_le(zero).select(h, zero - h);
        let slope = outer.select(c(bend.foot), c(1.0 + bend.u));
        Pull {
            opacity: learns.select(sample.raw * d_alpha, zero),
            shape: plain * slope * v,
            bend: [outer.select(signed * v, zero), outer.select(zero, m * v)],
        }
    }

    #[inline(always)]
    fn support(self, index: u32, log2_opacity: f64, log2_min_alpha: f64) -> f64 {
        let gaussian = log2_opacity - log2_min_alpha;
        match self.kernel.bend(index as usize) {
            Some(bend) if bend.u != 0.0 => {
                let reach = bend.support((-gaussian).exp2() * CONSERVATIVE).map_or(-1.0, |g| -g.log2());
                if bend.is_unbounded() { reach.min(self.cut) } else { reach }
            }
            _ => gaussian,
        }
    }

    #[inline(always)]
    fn widest(self, index: u32, gaussian: f64, log2_min_alpha: f64) -> f64 {
        match self.kernel.bend(index as usize) {
            // Sharp kernels end before the Gaussian does.
            Some(bend) if bend.u < 0.0 => self.support(index, 0.0, log2_min_alpha).max(0.0).sqrt() / LOG2_SCALE,
            _ => gaussian,
        }
    }
}
