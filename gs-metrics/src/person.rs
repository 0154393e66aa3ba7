//! PSNR and SSIM as papers on avatars report them: of the person alone, over black.
//!
//! The mask (pixels above one half) is eroded by a cross of 3 × 3, so that mixed pixels of the outline do not count, and both images are multiplied by it.
//! * PSNR is over the **whole frame**; what is black in both raises it.
//! * SSIM is over the box of the mask, per channel, with an even window of 7 × 7 and sample covariance,
//!   ```text
//!   (2 μx μy + C1)(2 σxy + C2) / ((μx² + μy² + C1)(σx² + σy² + C2)),   σ with 1 / 48,   C1 = 0.01², C2 = 0.03²
//!   ```
//!   over windows that lie inside the box: the defaults of scikit-image's `structural_similarity`.
//!
//! Everything is `f64`, without gradient.
//!
//! ```
//! use gs_core::Image;
//! use gs_metrics::person_scores;
//! let flat = |c, v: f32| Image { width: 16, height: 16, channels: c, data: vec![v; 256 * c] };
//! let scores = person_scores(&flat(3, 0.5), &flat(3, 0.6), &flat(1, 1.0))?;
//! assert!((scores.mse - 0.01).abs() < 1e-8 && scores.ssim.is_some_and(|s| s > 0.98));
//! # Ok::<(), gs_metrics::MetricError>(())
//! ```

use crate::error::{MetricError, check_finite, check_pair};
use gs_core::Image;
use rayon::prelude::*;

/// Side of the window.
const SIDE: usize = 7;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Scores of a person.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PersonScores {
    /// Mean squared error over the whole frame, pixels outside the eroded mask black in both.
    pub mse: f64,
    /// Mean SSIM over the box of the eroded mask; none where the box has a side of less than 7 pixels, or is empty.
    pub ssim: Option<f64>,
}

/// The scores of an image `[H, W, C]` against its truth, both in `[0, 1]`, where `mask`, `[H, W, 1]`, is above one half.
///
/// # Errors
/// Different shapes, a mask of another size, or a value that is not finite.
pub fn person_scores(image: &Image, truth: &Image, mask: &Image) -> Result<PersonScores, MetricError> {
    check_pair(image, truth)?;
    let (first, second) = ((image.width, image.height, 1), mask.shape());
    if first != second {
        return Err(MetricError::Shape { what: "image and mask", first, second });
    }
    [("image", image), ("truth", truth), ("mask", mask)].into_iter().try_for_each(|(name, i)| check_finite(name, i))?;
    let inside = eroded(mask);
    let c = image.channels;
    let squares = inside.iter().enumerate().filter(|(_, inside)| **inside).flat_map(|(p, _)| c * p..c * p + c);
    let sum: f64 = squares.map(|k| (f64::from(image.data[k]) - f64::from(truth.data[k])).powi(2)).sum();
    let mse = sum / image.data.len().max(1) as f64;
    Ok(PersonScores { mse, ssim: ssim(image, truth, &inside) })
}

/// Pixels that are inside with their four neighbours; beyond the frame counts as inside.
fn eroded(mask: &Image) -> Vec<bool> {
    let (w, h) = (mask.width, mask.height);
    let on = |x: usize, y: usize| x >= w || y >= h || mask.data[y * w + x] > 0.5;
    let cross = |x: usize, y: usize| {
        let around = [(x, y), (x + 1, y), (x, y + 1), (x.wrapping_sub(1), y), (x, y.wrapping_sub(1))];
        around.into_iter().all(|(x, y)| on(x, y))
    };
    (0..w * h).map(|p| cross(p % w, p / w)).collect()
}

fn ssim(image: &Image, truth: &Image, inside: &[bool]) -> Option<f64> {
    let (w, c) = (image.width, image.channels);
    let at = |p: usize| [p % w, p / w];
    let all = inside.iter().enumerate().filter(|(_, inside)| **inside).map(|(p, _)| at(p));
    let corner = |f: fn(usize, usize) -> usize| all.clone().reduce(|a, b| [f(a[0], b[0]), f(a[1], b[1])]);
    let ([x0, y0], [x1, y1]) = (corner(usize::min)?, corner(usize::max)?);
    if x1 - x0 + 1 < SIDE || y1 - y0 + 1 < SIDE {
        return None;
    }
    let value = |image: &Image, x: usize, y: usize, k: usize| {
        if inside[y * w + x] { f64::from(image.data[(y * w + x) * c + k]) } else { 0.0 }
    };
    let window = |x0: usize, y0: usize, k: usize| {
        let [mut x, mut y, mut xx, mut yy, mut xy] = [0.0; 5];
        for (a, b) in (0..SIDE * SIDE).map(|i| (x0 + i % SIDE, y0 + i / SIDE)) {
            let (p, q) = (value(image, a, b, k), value(truth, a, b, k));
            x += p;
            y += q;
            xx += p * p;
            yy += q * q;
            xy += p * q;
        }
        let n = (SIDE * SIDE) as f64;
        let (mx, my) = (x / n, y / n);
        let of = |sum: f64, product: f64| (sum / n - product) * n / (n - 1.0);
        let (vx, vy, vxy) = (of(xx, mx * mx), of(yy, my * my), of(xy, mx * my));
        (2.0 * mx * my + C1) * (2.0 * vxy + C2) / ((mx * mx + my * my + C1) * (vx + vy + C2))
    };
    let row =
        |y: usize| (x0..=x1 + 1 - SIDE).flat_map(|x| (0..c).map(move |k| (x, k))).map(|(x, k)| window(x, y, k)).sum();
    let rows: Vec<f64> = (y0..y1 + 2 - SIDE).into_par_iter().map(row).collect();
    let count = (x1 + 2 - SIDE - x0) * rows.len() * c;
    Some(rows.iter().sum::<f64>() / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    fn noise(seed: u64, channels: usize) -> Image {
        let mut rng = Rng::new(seed, "person", 0, 0);
        Image { width: 13, height: 11, channels, data: (0..13 * 11 * channels).map(|_| rng.uniform()).collect() }
    }

    fn block(x: std::ops::Range<usize>, y: std::ops::Range<usize>) -> Image {
        let on = |p: usize| x.contains(&(p % 13)) && y.contains(&(p / 13));
        Image { width: 13, height: 11, channels: 1, data: (0..13 * 11).map(|p| f32::from(u8::from(on(p)))).collect() }
    }

    #[test]
    fn the_outline_does_not_count() {
        let truth = noise(1, 3);
        let mut image = truth.clone();
        let mask = block(2..12, 1..10);
        // Changes at the outline and outside, then one inside.
        for (x, y) in [(0, 0), (2, 5), (11, 3), (7, 1), (7, 9)] {
            image.data[(y * 13 + x) * 3] += 0.5;
        }
        assert_eq!(person_scores(&image, &truth, &mask).unwrap(), PersonScores { mse: 0.0, ssim: Some(1.0) });
        image.data[(5 * 13 + 6) * 3 + 1] += 0.5;
        let scores = person_scores(&image, &truth, &mask).unwrap();
        assert!((scores.mse - 0.25 / (13.0 * 11.0 * 3.0)).abs() < 1e-7 && scores.ssim.unwrap() < 1.0);
        // At the edge of the frame nothing is taken away.
        let all = block(0..13, 0..11);
        assert!(eroded(&all).iter().all(|m| *m));
    }

    #[test]
    fn a_window_is_that_of_its_definition() {
        let (a, b) = (noise(2, 1), noise(3, 1));
        // One window: a mask of 9 × 9 erodes to 7 × 7.
        let mask = block(1..10, 1..10);
        let values =
            |i: &Image| -> Vec<f64> { (0..49).map(|k| f64::from(i.data[(2 + k / 7) * 13 + 2 + k % 7])).collect() };
        let (x, y) = (values(&a), values(&b));
        let mean = |v: &[f64]| v.iter().sum::<f64>() / 49.0;
        let (mx, my) = (mean(&x), mean(&y));
        let cov = |p: &[f64], q: &[f64], mp: f64, mq: f64| {
            p.iter().zip(q).map(|(a, b)| (a - mp) * (b - mq)).sum::<f64>() / 48.0
        };
        let (vx, vy, vxy) = (cov(&x, &x, mx, mx), cov(&y, &y, my, my), cov(&x, &y, mx, my));
        let want = (2.0 * mx * my + C1) * (2.0 * vxy + C2) / ((mx * mx + my * my + C1) * (vx + vy + C2));
        let got = person_scores(&a, &b, &mask).unwrap().ssim.unwrap();
        assert!((got - want).abs() < 1e-12, "{got} {want}");
        assert_eq!(person_scores(&a, &b, &block(1..9, 1..9)).unwrap().ssim, None, "a box of 6 × 6");
        assert_eq!(person_scores(&a, &b, &block(0..0, 0..0)).unwrap(), PersonScores { mse: 0.0, ssim: None });
        assert!(person_scores(&a, &b, &Image::zeros(3, 3, 1)).is_err());
    }
}
