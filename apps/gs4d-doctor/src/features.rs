//! Corner features of images and their matches in another image.
//!
//! Corners are where the smaller eigenvalue of the structure tensor is large (Shi and Tomasi 1994); each is described by a
//! 9×9 patch of the smoothed image, brought to mean 0 and length 1, so that the scalar product of two is their normalised
//! correlation. A match must be mutual, have a high correlation, and pass the ratio test against the second best (Lowe 2004).

use gs_core::Image;
use rayon::prelude::*;

/// Samples along each side of a patch, and pixels between them.
const PATCH_SIDE: usize = 9;
const PATCH_STEP: usize = 2;
/// Pixels on each side of a corner that its patch and the smoothing read.
const PATCH_RADIUS: usize = PATCH_SIDE / 2 * PATCH_STEP + 1;
/// Most corners of an image, and the side of the cells that hold at most one, pixels.
const MAX_CORNERS: usize = 700;
const MIN_DISTANCE: usize = 5;
/// Least smaller eigenvalue of a corner, for intensities in `[0, 1]`.
const MIN_STRENGTH: f32 = 2e-4;
/// Least correlation of a match, and the largest ratio of `1 − correlation` of the best to that of the second best.
const MIN_CORRELATION: f32 = 0.85;
const MAX_RATIO: f32 = 0.7;
/// Corners that are compared at once with all those of another image.
const PART: usize = 64;

/// A corner and its descriptor.
#[derive(Clone, Debug)]
pub(super) struct Corner {
    /// Centre of its pixel, `(x, y)` in pixels.
    pub(super) at: [f64; 2],
    patch: Patch,
}

type Patch = [f32; PATCH_SIDE * PATCH_SIDE];

/// The corners of a grey image whose `inside` is set wherever a patch reaches, the strongest first.
pub(super) fn corners(grey: &Image, inside: &[bool]) -> Vec<Corner> {
    let (w, h) = (grey.width, grey.height);
    if w <= 2 * PATCH_RADIUS || h <= 2 * PATCH_RADIUS {
        return Vec::new();
    }
    let smooth = smoothed(&smoothed(grey));
    let strength = strengths(&smooth);
    let mut found: Vec<(f32, usize)> = Vec::new();
    for y in PATCH_RADIUS..h - PATCH_RADIUS {
        for x in PATCH_RADIUS..w - PATCH_RADIUS {
            let i = y * w + x;
            let s = strength[i];
            let peak = (0..9).all(|k| strength[(y + k / 3 - 1) * w + x + k % 3 - 1] <= s);
            let whole = [(0, 0), (PATCH_RADIUS, 0), (0, PATCH_RADIUS), (PATCH_RADIUS, PATCH_RADIUS)];
            let whole =
                || whole.iter().all(|&(a, b)| inside[(y - PATCH_RADIUS / 2 + b) * w + x - PATCH_RADIUS / 2 + a]);
            if s > MIN_STRENGTH && peak && whole() {
                found.push((s, i));
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut taken = vec![false; (w / MIN_DISTANCE + 1) * (h / MIN_DISTANCE + 1)];
    let mut out = Vec::new();
    for (_, i) in found {
        let (x, y) = (i % w, i / w);
        let cell = &mut taken[y / MIN_DISTANCE * (w / MIN_DISTANCE + 1) + x / MIN_DISTANCE];
        if !std::mem::replace(cell, true) {
            out.push(Corner { at: [x as f64 + 0.5, y as f64 + 0.5], patch: patch(&smooth, x, y) });
        }
        if out.len() == MAX_CORNERS {
            break;
        }
    }
    out
}

/// Matches between the corners of two images, as pairs of indices.
pub(super) fn match_corners(a: &[Corner], b: &[Corner]) -> Vec<(usize, usize)> {
    let part = |(k, some): (usize, &[Corner])| compared(some, k * PART, b);
    let parts: Vec<_> = a.par_chunks(PART).enumerate().map(part).collect();
    let mut back = vec![(f32::NEG_INFINITY, 0); b.len()];
    for (_, of_b) in &parts {
        for (best, other) in back.iter_mut().zip(of_b) {
            if other.0 > best.0 {
                *best = *other;
            }
        }
    }
    let forth = parts.iter().flat_map(|(of_a, _)| of_a).enumerate();
    forth.filter(|(i, best)| best.is_clear() && back[best.at].1 == *i).map(|(i, best)| (i, best.at)).collect()
}

/// The best match of a corner among others.
#[derive(Clone, Copy)]
struct Best {
    at: usize,
    /// Correlations of the best and of the second best.
    first: f32,
    second: f32,
}

impl Best {
    /// Of no others.
    const NONE: Self = Self { at: 0, first: f32::NEG_INFINITY, second: f32::NEG_INFINITY };

    /// With one more of the others; of equal ones the first stays.
    fn or(self, at: usize, correlation: f32) -> Self {
        if correlation > self.first {
            Self { at, first: correlation, second: self.first }
        } else {
            Self { second: self.second.max(correlation), ..self }
        }
    }

    /// Whether it passes both thresholds.
    fn is_clear(&self) -> bool {
        self.first >= MIN_CORRELATION && 1.0 - self.first <= MAX_RATIO * (1.0 - self.second)
    }
}

/// The best match of each of some corners of `a`, the first of which is number `from`, among those of `b`; and of each of `b`
/// among these the correlation and the number.
fn compared(some: &[Corner], from: usize, b: &[Corner]) -> (Vec<Best>, Vec<(f32, usize)>) {
    let mut of_b = vec![(f32::NEG_INFINITY, from); b.len()];
    let of_one = |(i, c): (usize, &Corner)| {
        let mut best = Best::NONE;
        for (j, (other, back)) in b.iter().zip(&mut of_b).enumerate() {
            let correlation = correlation(&c.patch, &other.patch);
            best = best.or(j, correlation);
            if correlation > back.0 {
                *back = (correlation, i);
            }
        }
        best
    };
    let of_a = (from..).zip(some).map(of_one).collect();
    (of_a, of_b)
}

/// The scalar product. Eight sums side by side are vectorised, one alone is not: all pairs of corners come here.
fn correlation(a: &Patch, b: &Patch) -> f32 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let mut sums = [0.0f32; 8];
    for (a, b) in a.iter().zip(b) {
        (0..8).for_each(|k| sums[k] += a[k] * b[k]);
    }
    let rest: f32 = a_rest.iter().zip(b_rest).map(|(x, y)| x * y).sum();
    sums.iter().sum::<f32>() + rest
}

fn patch(image: &Image, x: usize, y: usize) -> Patch {
    let half = PATCH_SIDE / 2 * PATCH_STEP;
    let mut p: Patch = std::array::from_fn(|k| {
        image.data[(y + k / PATCH_SIDE * PATCH_STEP - half) * image.width + x + k % PATCH_SIDE * PATCH_STEP - half]
    });
    let mean = p.iter().sum::<f32>() / p.len() as f32;
    let length = p.iter().map(|v| (v - mean).powi(2)).sum::<f32>().sqrt().max(1e-6);
    p.iter_mut().for_each(|v| *v = (*v - mean) / length);
    p
}

/// Smoothed by (1 4 6 4 1)/16 along both axes; borders are repeated.
fn smoothed(image: &Image) -> Image {
    let (w, h) = (image.width as isize, image.height as isize);
    let kernel = [1.0f32, 4.0, 6.0, 4.0, 1.0];
    let along = |from: &[f32], dx: isize, dy: isize| -> Vec<f32> {
        let at = |x: isize, y: isize| from[(y.clamp(0, h - 1) * w + x.clamp(0, w - 1)) as usize];
        let sum = |x: isize, y: isize| -> f32 {
            (-2isize..=2).zip(kernel).map(|(k, c)| c * at(x + k * dx, y + k * dy)).sum::<f32>() / 16.0
        };
        (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).map(|(x, y)| sum(x, y)).collect()
    };
    let data = along(&along(&image.data, 1, 0), 0, 1);
    Image { width: image.width, height: image.height, channels: 1, data }
}

/// The smaller eigenvalue of the structure tensor over 5×5 pixels; 0 at the border.
fn strengths(image: &Image) -> Vec<f32> {
    let (w, h) = (image.width, image.height);
    let mut tensor = vec![[0.0f32; 3]; w * h];
    for y in 1..h - 1 {
        for x in 1..w - 1 {
            let i = y * w + x;
            let gx = 0.5 * (image.data[i + 1] - image.data[i - 1]);
            let gy = 0.5 * (image.data[i + w] - image.data[i - w]);
            tensor[i] = [gx * gx, gx * gy, gy * gy];
        }
    }
    let mut out = vec![0.0; w * h];
    for y in 3..h.saturating_sub(3) {
        for x in 3..w.saturating_sub(3) {
            let mut sum = [0.0f32; 3];
            for row in y - 2..=y + 2 {
                for t in &tensor[row * w + x - 2..=row * w + x + 2] {
                    (0..3).for_each(|k| sum[k] += t[k]);
                }
            }
            let [a, b, c] = sum;
            out[y * w + x] = 0.5 * (a + c) - (0.25 * (a - c).powi(2) + b * b).sqrt();
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    /// Random blobs.
    fn texture(width: usize, height: usize) -> Image {
        let mut r = Rng::new(3, "test", 0, 0);
        let noise = Image { width, height, channels: 1, data: (0..width * height).map(|_| r.uniform()).collect() };
        smoothed(&noise)
    }

    fn cut(image: &Image, x0: usize, y0: usize, width: usize, height: usize) -> Image {
        let data = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let data = data.map(|(x, y)| 0.3 + 0.5 * image.data[(y + y0) * image.width + x + x0]).collect();
        Image { width, height, channels: 1, data }
    }

    #[test]
    fn a_shifted_image_has_its_corners_shifted() {
        let whole = texture(160, 120);
        let (a, b) = (cut(&whole, 0, 0, 140, 100), cut(&whole, 11, 7, 140, 100));
        let inside = vec![true; 140 * 100];
        let (a, b) = (corners(&a, &inside), corners(&b, &inside));
        let pairs = match_corners(&a, &b);
        assert!(pairs.len() > 60, "{} pairs of {} corners", pairs.len(), a.len());
        let right = pairs.iter().filter(|&&(i, j)| {
            (a[i].at[0] - b[j].at[0] - 11.0).abs() < 1.1 && (a[i].at[1] - b[j].at[1] - 7.0).abs() < 1.1
        });
        assert!(right.count() * 10 > pairs.len() * 9);
    }

    #[test]
    fn flat_small_and_hidden_images_have_none() {
        let flat = Image { width: 60, height: 60, channels: 1, data: vec![0.5; 3600] };
        assert!(corners(&flat, &vec![true; 3600]).is_empty());
        assert!(corners(&texture(60, 60), &vec![false; 3600]).is_empty());
        assert!(corners(&texture(8, 8), &[true; 64]).is_empty());
        assert!(match_corners(&[], &[]).is_empty());
    }
}
