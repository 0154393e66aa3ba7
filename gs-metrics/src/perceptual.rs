//! A perceptual **proxy**: a distance between images without learned weights. It is **not** LPIPS, its values cannot be
//! compared with LPIPS values, and it was not fitted to human judgements.
//!
//! People tolerate small shifts that keep the texture, and notice lost detail (blur) and false detail (noise, blocks).
//! Pixelwise scores do the reverse. The proxy compares local *statistics* of oriented detail instead of pixels, as models of
//! early vision do:
//!
//! 1. Luma is decomposed into a binomial pyramid of up to five levels.
//! 2. At each level four orientations (0°, 45°, 90°, 135°) of a first and a second directional derivative, each split into
//!    its positive and its negative part, give 16 responses ("simple cells", which tell light-dark from dark-light edges).
//! 3. Their squares are averaged by a Gaussian of σ = 2 pixels of the level and the root is taken: 16 amplitudes `f_k ≥ 0`
//!    which measure how much of each kind of detail is *near* a place. That makes the distance tolerant to small shifts; the
//!    tolerance doubles with each level.
//! 4. Amplitudes of both images are compared with divisive normalisation (masking): a change counts in proportion to the
//!    detail present, and fades below a contrast of 0.02:
//!    ```text
//!    d(p) = √( Σ_k (f_k − g_k)² / (Σ_k (f_k² + g_k²) + 0.02²) )          in [0, 1], as f, g ≥ 0
//!    ```
//!    and averaged over places, then over levels with equal weights: `D_detail`.
//! 5. Colours are compared over areas: luma and two chroma planes two levels above the coarsest one, `d(p) = |Δ| / √(|Δ|² + 0.2²)`, averaged: `D_colour`.
//!
//! `proxy = 0.8·D_detail + 0.2·D_colour`.
//!
//! **Properties.** 0 for identical images, bitwise symmetric, in `[0, 1]`; increases with blur, noise, blocking and
//! compression. The constants above are round numbers from the visibility of contrast, not fits. **Blind to**: chroma
//! detail, who or what is shown, and rearrangements inside a neighbourhood of about 4 pixels of a level that keep all 16
//! amplitudes. Bitwise the same for any number of threads.
//!
//! Sources of the parts: oriented energy and pooling, Adelson & Bergen 1985; divisive normalisation, Heeger 1992;
//! texture as pooled filter statistics, Portilla & Simoncelli 2000; why such comparisons predict people better than
//! pixels, Zhang, Isola, Efros, Shechtman, Wang, *The unreasonable effectiveness of deep features as a perceptual
//! metric*, CVPR 2018.
//!
//! ```
//! use gs_core::Image;
//! use gs_metrics::{mse, perceptual_proxy};
//! // Vertical stripes, shifted by a pixel or replaced by their mean: the squared error is the same.
//! let stripes = |shift: usize| {
//!     let data = (0..4096).map(|i| if (i % 64 + shift) / 4 % 2 == 0 { 0.3 } else { 0.7 }).collect();
//!     Image { width: 64, height: 64, channels: 1, data }
//! };
//! let (truth, shifted) = (stripes(0), stripes(1));
//! let flat = Image { data: vec![0.5; 4096], ..truth.clone() };
//! assert!((mse(&shifted, &truth)? - mse(&flat, &truth)?).abs() < 1e-6);
//! assert!(3.0 * perceptual_proxy(&shifted, &truth)? < perceptual_proxy(&flat, &truth)?);
//! # Ok::<(), gs_metrics::MetricError>(())
//! ```

use fearless_simd::{Level, Simd, SimdBase, SimdFloat, dispatch};
use gs_core::Image;
use rayon::prelude::*;

use crate::error::{MetricError, check_finite, check_pair, explain_non_finite};
use crate::masked::check_masked;
use crate::plane::{Plane, opponent_planes};
use crate::window::LANES;

/// Largest number of levels of the pyramid.
const MAX_LEVELS: usize = 5;
/// Fewest pixels on the shorter side of a level other than the first.
const MIN_SIDE: usize = 16;
/// Contrast below which differences of detail fade.
const DETAIL_SCALE: f32 = 0.02;
/// Difference of colour at which [`colour_distance`] is `1/√2`.
const COLOUR_SCALE: f32 = 0.2;
/// Weight of `D_colour` in the proxy.
const COLOUR_WEIGHT: f64 = 0.2;
/// Responses per place: 4 orientations × (first, second derivative) × (positive, negative part).
const FEATURES: usize = 16;
/// Distance of pooled places, pixels of the level.
const STRIDE: usize = 4;
/// Taps of the pooling window, centred on a block of [`STRIDE`] pixels.
const POOL_TAPS: usize = 3 * STRIDE;
/// Standard deviation of the pooling window in pixels.
const POOL_SIGMA: f32 = 2.0;
/// Pooled rows of one parallel task.
const BAND: usize = 4;

/// The perceptual proxy of two `[H, W, 1 or 3]` images with values in `[0, 1]`: 0 for identical ones, at most 1, symmetric.
/// **Not LPIPS**; the [module](self) defines it.
///
/// # Errors
/// Different or empty shapes, a number of channels other than 1 and 3, or a value that is not finite.
pub fn perceptual_proxy(a: &Image, b: &Image) -> Result<f64, MetricError> {
    check_pair(a, b)?;
    check_finite("a", a)?;
    check_finite("b", b)?;
    distance(a, b, Plane { width: a.width, height: a.height, data: vec![1.0; a.width * a.height] })
}

/// The proxy over a mask, in analogy to DyCheck's masked LPIPS: both images are multiplied by the mask `[H, W, 1]` (weights in
/// `[0, 1]`), and every mean over places is weighted by the mean of the mask around the place. A mask of ones gives
/// [`perceptual_proxy`].
///
/// # Errors
/// Those of [`perceptual_proxy`]; a mask of another size, negative, not finite, or empty.
pub fn masked_perceptual_proxy(a: &Image, b: &Image, mask: &Image) -> Result<f64, MetricError> {
    check_masked(a, b, mask)?;
    if mask.data.iter().all(|m| *m == 0.0) {
        return Err(MetricError::EmptyMask);
    }
    let masked = |i: &Image| {
        let pixels = i.data.chunks_exact(i.channels).zip(&mask.data);
        Image { data: pixels.flat_map(|(p, m)| p.iter().map(move |v| v * m)).collect(), ..i.clone() }
    };
    distance(&masked(a), &masked(b), Plane { width: a.width, height: a.height, data: mask.data.clone() })
}

/// The proxy with a weight for each pixel.
fn distance(a: &Image, b: &Image, mut weights: Plane) -> Result<f64, MetricError> {
    if a.channels != 1 && a.channels != 3 {
        return Err(MetricError::Channels { metric: "the perceptual proxy", got: a.channels, need: "1 or 3" });
    }
    let (mut x, mut y) = (opponent_planes(a), opponent_planes(b));
    let (mut detail, mut levels) = (0.0, 0);
    loop {
        detail += detail_distance(&x[0], &y[0], &weights);
        levels += 1;
        if levels == MAX_LEVELS || x[0].width.min(x[0].height) < 2 * MIN_SIDE {
            break;
        }
        (x, y, weights) = (halve_all(&x), halve_all(&y), weights.halve());
    }
    (x, y, weights) = (halve_all(&halve_all(&x)), halve_all(&halve_all(&y)), weights.halve().halve());
    let colour = colour_distance(&x, &y, &weights);
    let value = (1.0 - COLOUR_WEIGHT) * detail / levels as f64 + COLOUR_WEIGHT * colour;
    if value.is_finite() { Ok(value) } else { Err(explain_non_finite("the perceptual proxy", a, b)) }
}

fn halve_all(planes: &[Plane]) -> Vec<Plane> {
    planes.iter().map(Plane::halve).collect()
}

/// Weighted mean over places of `|Δ| / √(|Δ|² + COLOUR_SCALE²)`, `Δ` the difference of all planes.
fn colour_distance(x: &[Plane], y: &[Plane], weights: &Plane) -> f64 {
    let one = |i: usize| {
        let squared: f32 = x.iter().zip(y).map(|(p, q)| (p.data[i] - q.data[i]).powi(2)).sum();
        f64::from((squared / (squared + COLOUR_SCALE * COLOUR_SCALE)).sqrt())
    };
    let total: f64 = weights.data.iter().map(|w| f64::from(*w)).sum();
    weights.data.iter().enumerate().map(|(i, w)| f64::from(*w) * one(i)).sum::<f64>() / total
}

/// Weighted mean over pooled places of `d(p)` at one level: `D_detail` of that level.
fn detail_distance(x: &Plane, y: &Plane, weights: &Plane) -> f64 {
    let (rows, columns) = (x.height.div_ceil(STRIDE), x.width.div_ceil(STRIDE));
    let band = |index: usize| {
        let range = index * BAND..((index + 1) * BAND).min(rows);
        let (f, g) = (band_amplitudes(x, range.clone()), band_amplitudes(y, range.clone()));
        let places = f.as_chunks::<FEATURES>().0.iter().zip(g.as_chunks::<FEATURES>().0).enumerate();
        let mut sums = [0.0f64; 2];
        for (i, pair) in places {
            let weight = block_weight(weights, i % columns, range.start + i / columns);
            sums[0] += weight * place_distance(pair);
            sums[1] += weight;
        }
        sums
    };
    let sums: Vec<[f64; 2]> = (0..rows.div_ceil(BAND)).into_par_iter().with_max_len(1).map(band).collect();
    let [sum, total] = sums.iter().fold([0.0; 2], |t, s| [t[0] + s[0], t[1] + s[1]]);
    sum / total
}

/// Mean weight of the block of pixels of a pooled place.
fn block_weight(weights: &Plane, column: usize, row: usize) -> f64 {
    let (columns, rows) = (
        column * STRIDE..((column + 1) * STRIDE).min(weights.width),
        row * STRIDE..((row + 1) * STRIDE).min(weights.height),
    );
    let count = columns.len() * rows.len();
    let lines = rows.map(|y| &weights.data[y * weights.width..][columns.clone()]);
    lines.flatten().map(|w| f64::from(*w)).sum::<f64>() / count as f64
}

/// `d(p)`: the normalised difference of the amplitudes at one place.
fn place_distance((f, g): (&[f32; FEATURES], &[f32; FEATURES])) -> f64 {
    let (mut difference, mut energy) = (0.0, DETAIL_SCALE * DETAIL_SCALE);
    for (p, q) in f.iter().zip(g) {
        difference += (p - q) * (p - q);
        energy += p * p + q * q;
    }
    f64::from((difference / energy).sqrt())
}

/// Weights of the pooling window, with sum 1.
fn pool_weights() -> [f32; POOL_TAPS] {
    let middle = (POOL_TAPS as f32 - 1.0) / 2.0;
    let w: [f32; POOL_TAPS] = std::array::from_fn(|t| (-((t as f32 - middle) / POOL_SIGMA).powi(2) / 2.0).exp());
    let sum: f32 = w.iter().sum();
    w.map(|v| v / sum)
}

/// Amplitudes of the pooled rows `range`, `[rows, columns, FEATURES]`.
fn band_amplitudes(plane: &Plane, range: std::ops::Range<usize>) -> Vec<f32> {
    let weights = pool_weights();
    let stride = plane.width.next_multiple_of(LANES);
    let mut sums = vec![0.0f32; range.len() * FEATURES * stride];
    let mut rows: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; stride + 2]);
    for r in (range.start * STRIDE) as isize - STRIDE as isize..(range.end * STRIDE + STRIDE) as isize {
        let y = r.clamp(0, plane.height as isize - 1);
        for (k, row) in rows.iter_mut().enumerate() {
            pad_row(plane.row(y + k as isize - 1), row);
        }
        for (j, sums) in sums.chunks_exact_mut(FEATURES * stride).enumerate() {
            let tap = r + STRIDE as isize - ((range.start + j) * STRIDE) as isize;
            if let Some(weight) = usize::try_from(tap).ok().and_then(|t| weights.get(t)) {
                let [up, mid, down] = &rows;
                dispatch!(Level::new(), simd => add_energies(simd, [up, mid, down], *weight, stride, sums));
            }
        }
    }
    pool_columns(plane.width, stride, &weights, &sums)
}

/// Copies a row after one value of padding, repeating the values at both ends.
fn pad_row(row: &[f32], out: &mut [f32]) {
    let (first, last) = (row[0], row[row.len() - 1]);
    out[0] = first;
    out[1..=row.len()].copy_from_slice(row);
    out[row.len() + 1..].fill(last);
}

/// Adds `weight` times the squared rectified responses of one row to `sums`, `[FEATURES, stride]`.
///
/// `rows` are the row above, the row, and the row below, padded by one value. The second derivative is halved, so that both
/// derivatives have the same amplitude at a quarter of the sampling frequency.
#[inline(always)]
fn add_energies<S: Simd>(simd: S, rows: [&[f32]; 3], weight: f32, stride: usize, sums: &mut [f32]) {
    let lanes = S::f32s::LEN;
    let splat = |v: f32| S::f32s::splat(simd, v);
    let (half, zero, weight, diagonal) =
        (splat(0.5), splat(0.0), splat(weight), splat(std::f32::consts::FRAC_1_SQRT_2));
    for i in (0..stride).step_by(lanes) {
        let at = |row: usize, k: usize| S::f32s::from_slice(simd, &rows[row][i + k..i + k + lanes]);
        let centre = at(1, 1);
        let dx = half * (at(1, 2) - at(1, 0));
        let dy = half * (at(2, 1) - at(0, 1));
        let dxx = half * (at(1, 2) + at(1, 0)) - centre;
        let dyy = half * (at(2, 1) + at(0, 1)) - centre;
        let dxy = half * half * half * (at(2, 2) + at(0, 0) - at(0, 2) - at(2, 0));
        let mean = half * (dxx + dyy);
        let first = [dx, diagonal * (dx + dy), dy, diagonal * (dy - dx)];
        let second = [dxx, mean + dxy, dyy, mean - dxy];
        for k in 0..4 {
            for (kind, response) in [first[k], second[k]].into_iter().enumerate() {
                for (sign, part) in [response.max(zero), response.min(zero)].into_iter().enumerate() {
                    let sum = &mut sums[(4 * k + 2 * kind + sign) * stride + i..][..lanes];
                    let old = S::f32s::from_slice(simd, sum);
                    (weight * part).mul_add(part, old).store_slice(sum);
                }
            }
        }
    }
}

/// Pools along the rows of `[rows, FEATURES, stride]` and takes roots: `[rows, columns, FEATURES]`.
fn pool_columns(width: usize, stride: usize, weights: &[f32; POOL_TAPS], sums: &[f32]) -> Vec<f32> {
    let columns = width.div_ceil(STRIDE);
    let mut out = vec![0.0f32; sums.len() / stride * columns];
    let mut padded = vec![0.0f32; columns * STRIDE + POOL_TAPS];
    for (j, rows) in sums.chunks_exact(FEATURES * stride).enumerate() {
        for (f, row) in rows.chunks_exact(stride).enumerate() {
            padded[..STRIDE].fill(row[0]);
            padded[STRIDE..STRIDE + width].copy_from_slice(&row[..width]);
            padded[STRIDE + width..].fill(row[width - 1]);
            for c in 0..columns {
                let window = &padded[c * STRIDE..c * STRIDE + POOL_TAPS];
                let energy: f32 = window.iter().zip(weights).map(|(v, w)| v * w).sum();
                out[(j * columns + c) * FEATURES + f] = energy.sqrt();
            }
        }
    }
    out
}
