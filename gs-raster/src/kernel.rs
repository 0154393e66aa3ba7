//! Kernel profiles: how alpha follows from the Mahalanobis distance. The blend is generic over them.
//!
//! Forward, a profile maps `p = log₂(o' g)` of sixteen pixels to `o' ψ(g)`. Backward, it maps `dL/dα` to the cotangents
//! of opacity, geometry and its own parameters. [`PiecewiseLinear`] works in units of the opacity, so that no sample is
//! divided by it: with `R = o' g`, `O = o'` and the constants `u, κ` of [`gs_core::kernel::Profile`],
//! ```text
//! M = R − O/2     H = min(R, O − R)     E = κ H      o' ψ = R + u · clamp(M, −E, E)
//! outer: E < |M|     o' dψ/d ln g = R · (outer ? k : 1 + u)
//! sums of the parameters:  Σ v sign H over outer samples,  Σ v M over the others        v = dL/d(o' ψ)
//! ```
//! A kernel with clamped knots has `E = 1` instead, above any `|M|`. `O` is the vector exponential of the `log₂ o'` that
//! the samples use. A row with `u = 0` takes the Gaussian's path, bit for bit.

use crate::options::Limits;
use crate::rows::Row;
use crate::simd;
use crate::tiles::LOG2_SCALE;
use fearless_simd::{f32x16, mask32x16, prelude::*};
use gs_core::Kernel;
use gs_core::kernel::Profile;
use rayon::prelude::*;

/// A kernel profile ψ. The blend is compiled once per implementor.
pub(crate) trait KernelProfile: Copy + Send + Sync {
    /// Whether rows carry [`ProfileConsts`], and records the two sums of the kernel's parameters.
    const HAS_PARAMS: bool;

    /// Constants of the splat in row `index` of the caller's columns; its opacity is filled in later.
    fn consts(self, index: u32) -> ProfileConsts;

    /// Sixteen samples of a row at `p = log₂(o' g)`.
    fn sample<S: Simd>(simd: S, row: &Row, p: f32x16<S>, limits: Limits) -> Sample<S>;

    /// Cotangents of the samples from `dL/dα`; zero in the lanes outside `has_grad`.
    fn backward<S: Simd>(
        simd: S,
        row: &Row,
        sample: Sample<S>,
        has_grad: mask32x16<S>,
        d_alpha: f32x16<S>,
    ) -> SampleGrad<S>;

    /// Largest `a² + b²`, in the blend's log₂ units, at which a splat of `log₂ o'` still reaches `log₂ min_alpha`.
    /// Negative if it does nowhere.
    fn support(self, index: u32, log2_opacity: f64, log2_min_alpha: f64) -> f64;

    /// Largest Mahalanobis distance at which an opaque splat reaches `min_alpha`; `gaussian` is that of the Gaussian.
    fn max_distance(self, index: u32, gaussian: f64, log2_min_alpha: f64) -> f64;
}

/// One splat at sixteen pixels.
#[derive(Clone, Copy)]
pub(crate) struct Sample<S: Simd> {
    /// `o' g`: the Gaussian before ψ.
    pub gaussian: f32x16<S>,
    /// `o' ψ(g)`: alpha before the cap.
    pub raw: f32x16<S>,
    /// Lanes whose `raw` reaches `min_alpha`.
    pub visible: mask32x16<S>,
}

/// Cotangents of sixteen samples, not yet summed.
#[derive(Clone, Copy)]
pub(crate) struct SampleGrad<S: Simd> {
    /// `dL/d ln o'`.
    pub d_ln_opacity: f32x16<S>,
    /// `dL/d ln g`.
    pub d_ln_g: f32x16<S>,
    /// `v sign H` on foot and plateau, `v M` on the flank (see the module's equations).
    pub d_kernel: [f32x16<S>; 2],
}

/// Constants of one splat's piecewise linear profile.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ProfileConsts {
    pub u: f32,
    /// `E = κ H + bias`.
    pub kappa: f32,
    pub bias: f32,
    /// Slope `k` of ψ on foot and plateau.
    pub foot: f32,
    /// Samples with `p < log₂ o' − cut` are skipped; infinite unless the profile never decays.
    pub cut: f32,
    /// `o'`, the opacity after anti-aliasing compensation.
    pub opacity: f32,
}

/// The Gaussian, `ψ(g) = g`. Opacity folds into the exponent and the threshold test needs no exponential.
#[derive(Clone, Copy)]
pub(crate) struct Gaussian;

impl KernelProfile for Gaussian {
    const HAS_PARAMS: bool = false;

    #[inline(always)]
    fn consts(self, _: u32) -> ProfileConsts {
        ProfileConsts::default()
    }

    #[inline(always)]
    fn sample<S: Simd>(simd: S, _: &Row, p: f32x16<S>, limits: Limits) -> Sample<S> {
        let raw = simd::exp2(simd, p);
        Sample { gaussian: raw, raw, visible: p.simd_ge(f32x16::splat(simd, limits.log2_min_alpha)) }
    }

    #[inline(always)]
    fn backward<S: Simd>(
        simd: S,
        _: &Row,
        sample: Sample<S>,
        has_grad: mask32x16<S>,
        d_alpha: f32x16<S>,
    ) -> SampleGrad<S> {
        let zero = f32x16::splat(simd, 0.0);
        let s = has_grad.select(sample.raw * d_alpha, zero);
        SampleGrad { d_ln_opacity: s, d_ln_g: s, d_kernel: [zero; 2] }
    }

    #[inline(always)]
    fn support(self, _: u32, log2_opacity: f64, log2_min_alpha: f64) -> f64 {
        log2_opacity - log2_min_alpha
    }

    #[inline(always)]
    fn max_distance(self, _: u32, gaussian: f64, _: f64) -> f64 {
        gaussian
    }
}

/// The piecewise linear profiles of [`gs_core::Kernel`].
#[derive(Clone, Copy)]
pub(crate) struct PiecewiseLinear<'a> {
    kernel: &'a Kernel,
    /// One per row of the caller's columns. A splat has many entries and its constants cost divisions, so they are
    /// stored.
    consts: &'a [ProfileConsts],
    /// Largest `a² + b²` of a splat whose profile never decays, log₂ units.
    cut: f64,
}

/// Fewest splats per task when the constants are computed.
const MIN_TASK_SPLATS: usize = 2048;
/// Lowest argument of [`simd::exp2`].
const EXP2_MIN_ARG: f32 = -126.0;
/// Factor on the threshold at which ψ is inverted, so that the rounding of ψ in `f32` loses no pixel.
const SUPPORT_MARGIN: f64 = 1.0 - 1e-6;

impl<'a> PiecewiseLinear<'a> {
    /// The profiles of `n` splats, with their constants written to `consts`. `kernel` must not be the Gaussian;
    /// `kernel_cut` is a squared Mahalanobis distance.
    pub(crate) fn new(kernel: &'a Kernel, n: usize, kernel_cut: f64, consts: &'a mut Vec<ProfileConsts>) -> Self {
        let cut = kernel_cut * LOG2_SCALE * LOG2_SCALE;
        consts.resize(n, ProfileConsts::default());
        consts.par_iter_mut().with_min_len(MIN_TASK_SPLATS).enumerate().for_each(|(row, to)| {
            *to = kernel.bend(row).map_or(ProfileConsts::default(), |b| ProfileConsts::new(&b, cut));
        });
        Self { kernel, consts, cut }
    }
}

impl ProfileConsts {
    /// From the kernel's constants, without the opacity. `cut` ends profiles that never decay.
    fn new(bend: &Profile<f64>, cut: f64) -> Self {
        let (kappa, bias) = if bend.is_clamped() { (0.0, 1.0) } else { (bend.kappa as f32, 0.0) };
        let cut = if bend.is_unbounded() { cut as f32 } else { f32::INFINITY };
        Self { u: bend.u as f32, kappa, bias, foot: bend.foot as f32, cut, opacity: 0.0 }
    }
}

/// `M`, `H` and `E` of the module's equations.
#[inline(always)]
fn folded<S: Simd>(simd: S, k: &ProfileConsts, gaussian: f32x16<S>) -> [f32x16<S>; 3] {
    let c = |v: f32| f32x16::splat(simd, v);
    let h = gaussian.min(c(k.opacity) - gaussian);
    [gaussian - c(0.5 * k.opacity), h, h.mul_add(c(k.kappa), c(k.bias))]
}

impl KernelProfile for PiecewiseLinear<'_> {
    const HAS_PARAMS: bool = true;

    #[inline(always)]
    fn consts(self, index: u32) -> ProfileConsts {
        self.consts[index as usize]
    }

    #[inline(always)]
    fn sample<S: Simd>(simd: S, row: &Row, p: f32x16<S>, limits: Limits) -> Sample<S> {
        let k = &row.profile;
        let c = |v: f32| f32x16::splat(simd, v);
        let gaussian = simd::exp2(simd, p);
        if k.u == 0.0 {
            return Sample { gaussian, raw: gaussian, visible: p.simd_ge(c(limits.log2_min_alpha)) };
        }
        let [m, _, reach] = folded(simd, k, gaussian);
        let residual = m.max(c(0.0) - reach).min(reach);
        let raw = residual.mul_add(c(k.u), gaussian);
        let visible = raw.simd_ge(c(limits.min_alpha)) & p.simd_ge(c((row.log2_opacity - k.cut).max(EXP2_MIN_ARG)));
        Sample { gaussian, raw, visible }
    }

    #[inline(always)]
    fn backward<S: Simd>(
        simd: S,
        row: &Row,
        sample: Sample<S>,
        has_grad: mask32x16<S>,
        d_alpha: f32x16<S>,
    ) -> SampleGrad<S> {
        let k = &row.profile;
        let c = |v: f32| f32x16::splat(simd, v);
        let zero = c(0.0);
        let v = has_grad.select(d_alpha, zero);
        // The other lanes may hold anything, even NaN.
        let gaussian = has_grad.select(sample.gaussian, zero);
        let [m, h, reach] = folded(simd, k, gaussian);
        let outer = reach.simd_lt(m.abs());
        let signed = m.simd_le(zero).select(h, zero - h);
        let slope = outer.select(c(k.foot), c(1.0 + k.u));
        SampleGrad {
            d_ln_opacity: has_grad.select(sample.raw * d_alpha, zero),
            d_ln_g: gaussian * slope * v,
            d_kernel: [outer.select(signed * v, zero), outer.select(zero, m * v)],
        }
    }

    #[inline(always)]
    fn support(self, index: u32, log2_opacity: f64, log2_min_alpha: f64) -> f64 {
        let gaussian = log2_opacity - log2_min_alpha;
        match self.kernel.bend(index as usize) {
            Some(bend) if bend.u != 0.0 => {
                let reach = bend.support((-gaussian).exp2() * SUPPORT_MARGIN).map_or(-1.0, |g| -g.log2());
                if bend.is_unbounded() { reach.min(self.cut) } else { reach }
            }
            _ => gaussian,
        }
    }

    #[inline(always)]
    fn max_distance(self, index: u32, gaussian: f64, log2_min_alpha: f64) -> f64 {
        match self.kernel.bend(index as usize) {
            // A blunt kernel ends behind the Gaussian, above half its height a sharp one.
            Some(bend) if bend.u < 0.0 || log2_min_alpha > -1.0 => {
                self.support(index, 0.0, log2_min_alpha).max(0.0).sqrt() / LOG2_SCALE
            }
            _ => gaussian,
        }
    }
}
