//! One pixel of the reference: the samples it blends, and their gradients.

use super::project::Projected;
use super::{Cutoff, PixelGrad, Scalar};
use crate::options::{ClampGrad, RasterOptions};
use gs_core::kernel::Partials;

/// One blended sample of a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample<T> {
    /// Position in the sorted list.
    pub splat: usize,
    /// Transmittance in front of it.
    pub transmittance: T,
    /// Alpha after cap and cutoff.
    pub alpha: T,
    /// `g = exp(−q/2)`, before ψ.
    gaussian: T,
    /// `ψ(g)` with its derivatives.
    psi: Partials<T>,
    /// `d alpha / d raw` with `raw = o' ψ(g)`.
    slope: T,
    /// `u − p`, splat centre minus pixel centre, pixels.
    offset: [T; 2],
}

/// Sums over all pixels of one splat's cotangents.
#[derive(Clone, Copy, Debug)]
pub(super) struct SplatSums<T> {
    pub mean2d: [T; 2],
    /// `dL/d` conic `xx, xy, yy` where `q = xx dx² + 2 xy dx dy + yy dy²`; the `xy` entry counts both.
    pub conic: [T; 3],
    /// `dL/do'` of the compensated opacity.
    pub opacity: T,
    pub rgb: [T; 3],
    pub depth: T,
    /// `Σ v outer`, `Σ v inner` with `v = dL/dψ`.
    pub kernel: [T; 2],
}

impl<T: Scalar> SplatSums<T> {
    pub(super) fn zero() -> Self {
        let z = T::from_f64(0.0);
        Self { mean2d: [z; 2], conic: [z; 3], opacity: z, rgb: [z; 3], depth: z, kernel: [z; 2] }
    }
}

/// `ψ(g)` with its derivatives.
fn profile<T: Scalar>(p: &Projected<T>, g: T) -> Partials<T> {
    let zero = T::from_f64(0.0);
    p.bend.map_or(Partials { value: g, slope: T::from_f64(1.0), outer: zero, inner: zero }, |b| b.partials(g))
}

/// `(alpha, d alpha / d raw)` after cap and cutoff; alpha 0 where skipped.
fn cut<T: Scalar>(raw: T, options: &RasterOptions, cutoff: Cutoff) -> (T, T) {
    let (zero, one) = (T::from_f64(0.0), T::from_f64(1.0));
    let (max, min) = (T::from_f64(options.max_alpha), T::from_f64(options.min_alpha));
    let exact = options.clamp_grad == ClampGrad::Exact;
    let (capped, slope) = if raw > max { (max, if exact { zero } else { one }) } else { (raw, one) };
    if capped < min {
        return (zero, zero);
    }
    if cutoff == Cutoff::Hard || capped > T::from_f64(2.0) * min {
        return (capped, slope);
    }
    // Smoothstep x²(3−2x) with x from 0 at min to 1 at 2·min.
    let x = (capped - min) / min;
    let (two, three, six) = (T::from_f64(2.0), T::from_f64(3.0), T::from_f64(6.0));
    let ramp = x * x * (three - two * x);
    (capped * ramp, slope * (ramp + capped * six * x * (one - x) / min))
}

/// The samples of a pixel front to back, the transmittance behind them, and the smallest relative decision margin.
pub(super) fn samples<T: Scalar>(
    splats: &[(usize, Projected<T>)],
    pixel: [T; 2],
    options: &RasterOptions,
    cutoff: Cutoff,
) -> (Vec<Sample<T>>, T, f64) {
    let one = T::from_f64(1.0);
    let stop = T::from_f64(options.stop);
    let mut list = Vec::new();
    let mut transmittance = one;
    let mut margin = f64::INFINITY;
    let mut near = |value: T, limit: f64| {
        margin = margin.min(((value.to_f64() - limit) / limit.max(f64::MIN_POSITIVE)).abs());
    };
    for (index, (_, p)) in splats.iter().enumerate() {
        let offset = [p.mean2d[0] - pixel[0], p.mean2d[1] - pixel[1]];
        let [a, b, c] = p.conic;
        let half_q =
            T::from_f64(0.5) * (a * offset[0] * offset[0] + c * offset[1] * offset[1]) + b * offset[0] * offset[1];
        if half_q < T::from_f64(0.0) {
            continue;
        }
        let gaussian = (-half_q).exp();
        let psi = profile(p, gaussian);
        if let Some(bend) = &p.bend {
            near(gaussian.min(one - gaussian), 0.5 / (1.0 + bend.kappa.to_f64()));
            if bend.is_unbounded() {
                near(half_q, 0.5 * options.kernel_cut);
                if half_q > T::from_f64(0.5 * options.kernel_cut) {
                    continue;
                }
            }
        }
        let raw = p.opacity * psi.value;
        near(raw, options.min_alpha);
        let (alpha, slope) = cut(raw, options, cutoff);
        if alpha <= T::from_f64(0.0) {
            continue;
        }
        let next = transmittance * (one - alpha);
        near(next, options.stop);
        if next <= stop {
            break;
        }
        list.push(Sample { splat: index, transmittance, alpha, gaussian, psi, slope, offset });
        transmittance = next;
    }
    (list, transmittance, margin)
}

/// Adds one pixel's contribution to the sums of the splats it sees, back to front.
pub(super) fn pixel_backward<T: Scalar>(
    splats: &[(usize, Projected<T>)],
    pixel: [T; 2],
    options: &RasterOptions,
    cutoff: Cutoff,
    d: &PixelGrad<T>,
    sums: &mut [SplatSums<T>],
) {
    let (d_rgb, d_alpha, d_depth) = *d;
    let (list, end, _) = samples(splats, pixel, options, cutoff);
    let background = options.background.map(|v| T::from_f64(f64::from(v)));
    // What lies behind the current sample, times the cotangents: the background, and the loss on accumulated alpha.
    let mut behind = end * (gs_core::real::dot3(background, d_rgb) - d_alpha);
    for s in list.iter().rev() {
        let p = &splats[s.splat].1;
        let light = gs_core::real::dot3(p.rgb, d_rgb) + p.depth * d_depth;
        let weight = s.transmittance * s.alpha;
        let v_alpha = s.transmittance * light - behind / (T::from_f64(1.0) - s.alpha);
        behind = behind + weight * light;
        let sum = &mut sums[s.splat];
        for (to, from) in sum.rgb.iter_mut().zip(d_rgb) {
            *to = *to + weight * from;
        }
        sum.depth = sum.depth + weight * d_depth;
        let v_raw = v_alpha * s.slope;
        sum.opacity = sum.opacity + v_raw * s.psi.value;
        // raw = o' ψ(exp(−q/2))
        let v_psi = v_raw * p.opacity;
        sum.kernel = [sum.kernel[0] + v_psi * s.psi.outer, sum.kernel[1] + v_psi * s.psi.inner];
        let v_half_q = -(v_psi * s.psi.slope * s.gaussian);
        let [dx, dy] = s.offset;
        let half = T::from_f64(0.5);
        sum.conic[0] = sum.conic[0] + v_half_q * half * dx * dx;
        sum.conic[1] = sum.conic[1] + v_half_q * dx * dy;
        sum.conic[2] = sum.conic[2] + v_half_q * half * dy * dy;
        let [a, b, c] = p.conic;
        sum.mean2d[0] = sum.mean2d[0] + v_half_q * (a * dx + b * dy);
        sum.mean2d[1] = sum.mean2d[1] + v_half_q * (b * dx + c * dy);
    }
}
