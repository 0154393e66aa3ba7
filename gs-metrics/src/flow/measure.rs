//! Warping by a flow, and statistics of flows.
//!
//! Sums are `f64`, in the order of pixels.

use gs_core::{Image, cast};

use super::Flow;
use crate::error::{MetricError, check_finite, check_image};

/// The length in pixels by which the displacements of a flow are divided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reference {
    /// The length of the longest displacement.
    Longest,
    /// This quantile, in `(0, 1]`, of the lengths: robust against a few outliers.
    Quantile(f64),
}

/// The motion inside a mask relative to the motion outside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskContrast {
    /// The length that [`Reference`] selects, pixels.
    pub reference: f64,
    /// Mean of `|flow| / reference` inside the mask.
    pub inside: f64,
    /// Mean of `|flow| / reference` outside the mask.
    pub outside: f64,
    /// `inside / outside`; `None` if nothing moves outside.
    pub ratio: Option<f64>,
}

/// Mean Euclidean distance in pixels between the displacements of two flows.
///
/// ```
/// use gs_metrics::flow::{Flow, end_point_error};
/// let moving = Flow { u: vec![3.0; 6], v: vec![4.0; 6], ..Flow::zeros(3, 2) };
/// assert_eq!(end_point_error(&moving, &Flow::zeros(3, 2))?, 5.0);
/// # Ok::<(), gs_metrics::MetricError>(())
/// ```
///
/// # Errors
/// Different sizes, malformed flows, or a value that is not finite.
pub fn end_point_error(a: &Flow, b: &Flow) -> Result<f64, MetricError> {
    a.check("flow a")?;
    b.check("flow b")?;
    if (a.width, a.height) != (b.width, b.height) {
        let (first, second) = ((a.width, a.height, 2), (b.width, b.height, 2));
        return Err(MetricError::Shape { what: "flows", first, second });
    }
    let pairs = a.u.iter().zip(&a.v).zip(b.u.iter().zip(&b.v));
    let sum: f64 = pairs.map(|((u, v), (p, q))| f64::from(u - p).hypot(f64::from(v - q))).sum();
    Ok(sum / a.u.len() as f64)
}

/// Circular variance of the directions, `1 − |mean of (cos θ, sin θ)|`: 0 if all displacements are parallel, near 1 if they point
/// in all directions. Counted are displacements of at least `least > 0` pixels, weighted by the mask `[H, W, 1]` if there is
/// one. `None` if no displacement counts.
///
/// # Errors
/// A malformed flow, a mask of another size or with negative weights, a value that is not finite, or `least` not positive.
pub fn circular_variance(flow: &Flow, mask: Option<&Image>, least: f32) -> Result<Option<f64>, MetricError> {
    flow.check("flow")?;
    mask.map_or(Ok(()), |m| check_mask(flow, m))?;
    if !(least > 0.0 && least.is_finite()) {
        let must = "a positive length in pixels: a pixel at rest has no direction";
        return Err(MetricError::Option { name: "least", value: least.to_string(), must });
    }
    let (mut cos, mut sin, mut total) = (0.0f64, 0.0f64, 0.0f64);
    for (i, length) in flow.magnitudes().into_iter().enumerate() {
        let weight = mask.map_or(1.0, |m| f64::from(m.data[i]));
        if length >= least {
            cos += weight * f64::from(flow.u[i]) / f64::from(length);
            sin += weight * f64::from(flow.v[i]) / f64::from(length);
            total += weight;
        }
    }
    Ok((total > 0.0).then(|| (1.0 - cos.hypot(sin) / total).max(0.0)))
}

/// Mean length of the flow inside and outside a mask `[H, W, 1]` (weights in `[0, 1]`).
///
/// # Errors
/// A malformed flow, a mask of another size or outside `[0, 1]`, a mask that is 0 or 1 everywhere, a quantile out of range.
pub fn mask_contrast(flow: &Flow, mask: &Image, reference: Reference) -> Result<MaskContrast, MetricError> {
    flow.check("flow")?;
    check_mask(flow, mask)?;
    let lengths = flow.magnitudes();
    let mut sums = [[0.0f64; 2]; 2];
    for (length, m) in lengths.iter().zip(&mask.data) {
        let m = f64::from(*m).min(1.0);
        for (sum, weight) in sums.iter_mut().zip([m, 1.0 - m]) {
            sum[0] += weight * f64::from(*length);
            sum[1] += weight;
        }
    }
    let [[inside, weight_inside], [outside, weight_outside]] = sums;
    if weight_inside == 0.0 || weight_outside == 0.0 {
        return Err(MetricError::EmptyMask);
    }
    let (inside, outside) = (inside / weight_inside, outside / weight_outside);
    let reference = f64::from(reference_length(lengths, reference)?);
    let of = |mean: f64| if reference > 0.0 { mean / reference } else { 0.0 };
    let ratio = (outside > 0.0).then(|| inside / outside);
    Ok(MaskContrast { reference, inside: of(inside), outside: of(outside), ratio })
}

fn reference_length(mut lengths: Vec<f32>, reference: Reference) -> Result<f32, MetricError> {
    lengths.sort_unstable_by(f32::total_cmp);
    let share = match reference {
        Reference::Longest => 1.0,
        Reference::Quantile(share) if share > 0.0 && share <= 1.0 => share,
        Reference::Quantile(share) => {
            let must = "in (0, 1], for example 0.95";
            return Err(MetricError::Option { name: "quantile", value: share.to_string(), must });
        }
    };
    Ok(lengths[cast::to_usize((share * lengths.len() as f64).ceil()).clamp(1, lengths.len()) - 1])
}

fn check_mask(flow: &Flow, mask: &Image) -> Result<(), MetricError> {
    check_image("mask", mask)?;
    let want = (flow.width, flow.height, 1);
    if mask.shape() != want {
        return Err(MetricError::Shape { what: "flow and mask (one channel)", first: want, second: mask.shape() });
    }
    check_finite("mask", mask)?;
    match mask.data.iter().position(|m| *m < 0.0) {
        Some(at) => Err(MetricError::NegativeMask { x: at % mask.width, y: at / mask.width }),
        None => Ok(()),
    }
}

/// See [`Flow::warp`].
pub(super) fn warp(flow: &Flow, image: &Image) -> Result<Image, MetricError> {
    flow.check("flow")?;
    check_image("image", image)?;
    let (w, h, c) = image.shape();
    if (w, h) != (flow.width, flow.height) {
        return Err(MetricError::Shape {
            what: "flow and image",
            first: (flow.width, flow.height, c),
            second: (w, h, c),
        });
    }
    let mut out = Image::zeros(w, h, c);
    let last = [(w - 1) as f32, (h - 1) as f32];
    for y in 0..h {
        for x in 0..w {
            let [u, v] = flow.at(x, y);
            let (px, py) = ((x as f32 + u).clamp(0.0, last[0]), (y as f32 + v).clamp(0.0, last[1]));
            let (x0, y0) = (cast::to_usize(px), cast::to_usize(py));
            let (x1, y1) = ((x0 + 1).min(w - 1), (y0 + 1).min(h - 1));
            let (ax, ay) = (px - x0 as f32, py - y0 as f32);
            for k in 0..c {
                let mix = |y: usize| (1.0 - ax) * image.pixel(x0, y)[k] + ax * image.pixel(x1, y)[k];
                out.pixel_mut(x, y)[k] = (1.0 - ay) * mix(y0) + ay * mix(y1);
            }
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flow(w: usize, h: usize, f: impl Fn(usize, usize) -> [f32; 2]) -> Flow {
        let all: Vec<[f32; 2]> = (0..w * h).map(|i| f(i % w, i / w)).collect();
        Flow { width: w, height: h, u: all.iter().map(|d| d[0]).collect(), v: all.iter().map(|d| d[1]).collect() }
    }

    fn left_half(w: usize, h: usize) -> Image {
        let data = (0..w * h).map(|i| f32::from(u8::from(i % w < w / 2))).collect();
        Image { width: w, height: h, channels: 1, data }
    }

    #[test]
    fn the_end_point_error_is_a_mean_distance() {
        let a = flow(4, 3, |_, _| [3.0, 4.0]);
        assert_eq!(end_point_error(&a, &Flow::zeros(4, 3)).unwrap(), 5.0);
        let half = flow(4, 3, |x, _| if x < 2 { [3.0, 4.0] } else { [0.0, 0.0] });
        assert_eq!(end_point_error(&a, &half).unwrap(), 2.5);
        assert!(end_point_error(&a, &Flow::zeros(3, 4)).is_err());
        let nan = flow(4, 3, |x, y| if (x, y) == (2, 1) { [0.0, f32::NAN] } else { [0.0; 2] });
        let e = end_point_error(&a, &nan).unwrap_err();
        assert_eq!(e, MetricError::NotFinite { which: "flow b", x: 2, y: 1, channel: 1 });
    }

    #[test]
    fn the_circular_variance_runs_from_zero_to_one() {
        let parallel = flow(8, 8, |x, _| [x as f32, x as f32]);
        assert!(circular_variance(&parallel, None, 0.5).unwrap().unwrap() < 1e-7);
        let opposite = flow(8, 8, |x, _| if x < 4 { [2.0, 0.0] } else { [-1.0, 0.0] });
        assert_eq!(circular_variance(&opposite, None, 0.5).unwrap(), Some(1.0));
        assert_eq!(circular_variance(&opposite, Some(&left_half(8, 8)), 0.5).unwrap(), Some(0.0));
        assert_eq!(circular_variance(&opposite, None, 3.0).unwrap(), None);
        assert!(circular_variance(&opposite, None, 0.0).is_err());
        let corner = flow(2, 1, |x, _| if x == 0 { [1.0, 0.0] } else { [0.0, 1.0] });
        let got = circular_variance(&corner, None, 0.5).unwrap().unwrap();
        assert!((got - (1.0 - 0.5f64.sqrt())).abs() < 1e-12, "{got}");
    }

    #[test]
    fn motion_inside_and_outside_a_mask() {
        let f = flow(8, 5, |x, y| if x < 4 { [0.0, 3.0] } else { [if y == 0 { 5.0 } else { 0.0 }, 0.0] });
        let got = mask_contrast(&f, &left_half(8, 5), Reference::Longest).unwrap();
        assert_eq!((got.reference, got.inside, got.outside, got.ratio), (5.0, 0.6, 0.2, Some(3.0)));
        let got = mask_contrast(&f, &left_half(8, 5), Reference::Quantile(0.9)).unwrap();
        assert_eq!((got.reference, got.inside), (3.0, 1.0));
        let still = mask_contrast(&Flow::zeros(8, 5), &left_half(8, 5), Reference::Longest).unwrap();
        assert_eq!((still.inside, still.outside, still.ratio), (0.0, 0.0, None));
        let full = Image { data: vec![1.0; 40], ..left_half(8, 5) };
        assert_eq!(mask_contrast(&f, &full, Reference::Longest).unwrap_err(), MetricError::EmptyMask);
        assert!(mask_contrast(&f, &left_half(8, 5), Reference::Quantile(1.5)).is_err());
        assert!(mask_contrast(&f, &left_half(5, 8), Reference::Longest).is_err());
    }

    #[test]
    fn warping_resamples_the_second_image() {
        let image = Image { width: 5, height: 1, channels: 1, data: vec![0.0, 1.0, 2.0, 3.0, 4.0] };
        let got = flow(5, 1, |_, _| [1.5, 9.0]).warp(&image).unwrap();
        assert_eq!(got.data, [1.5, 2.5, 3.5, 4.0, 4.0]);
        assert_eq!(Flow::zeros(5, 1).warp(&image).unwrap(), image);
        assert!(Flow::zeros(1, 5).warp(&image).is_err());
    }
}
