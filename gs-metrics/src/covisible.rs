//! Co-visibility: which pixels of an image enough images of a set show as well. Captures of one moving camera are scored
//! where it holds ([`masked`](crate::masked)).
//!
//! With the [`flow`](crate::flow) `f` from the image `I` to another one, `J`, and the flow `b` back, `J` sees the pixel `x` if
//! ```text
//! |f(x) + b(x + f(x))|² ≤ 0.01 (|f(x)|² + |b(x + f(x))|²) + 0.5             there and back returns, pixels²
//! mean (I − J∘f)² ≤ ½ (var I + var J∘f) + (5/255)²                          the colours match, sums over channels
//! ```
//! and `x` is co-visible if more than `max(5, ⌊N/10⌋)` of the `N` images of the set see it.
//!
//! The first line is the criterion of Sundaram, Brox and Keutzer (*Dense point trajectories by GPU-accelerated large
//! displacement optical flow*, ECCV 2010, eq. 5). DyCheck has it and the count (Gao et al. 2022, `tools/process_covisible.py`),
//! with RAFT for the flow. `b` is bilinear and 0 outside the image, as there: what leaves the image by more than 0.71 pixels
//! is not seen.
//!
//! The second line is ours ([`CovisibleOptions::colors`]); means and variances are over 7 × 7 pixels. Where `J` has no match,
//! Farneback's least squares still give a small or smooth flow, which returns. Without the second line most of what an object
//! hides in `J` would count as seen. Two patches that have nothing in common differ by the sum of their variances; half of
//! it is a correlation of one half.
//!
//! # What it cannot see
//! * What moves further than the flow can follow counts as not seen. Without coarse features that is a few pixels.
//! * A hidden strip narrower than about 4 pixels mostly counts as seen: the flow of its neighbours covers it. Of a band of about 4
//!   pixels beside borders between motions a part counts as not seen.
//! * Surfaces of one colour match each other.

use gs_core::{Image, cast};
use rayon::prelude::*;

use crate::error::{MetricError, check_pair};
use crate::flow::{Expansion, Farneback, Flow};
use matching::matching;

mod matching;

/// When an image sees a pixel, and how many must; the default is DyCheck's, with colours.
///
/// ```
/// let rule = gs_metrics::CovisibleOptions::default();
/// assert_eq!([6, 59, 60, 300].map(|images| rule.needed(images)), [6, 6, 7, 31]);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CovisibleOptions {
    /// Largest `|f + b|²` where nothing moves, pixels²; 0.5.
    pub slack: f32,
    /// What is added to it, over `|f|² + |b|²`; 0.01.
    pub growth: f32,
    /// Whether colours must match as well; true. DyCheck looks at the flow alone.
    pub colors: bool,
    /// A co-visible pixel is seen by more images than this; 5.
    pub more_than: usize,
    /// It is also seen by more images than this share of all, in `[0, 1)`, rounded down; 0.1.
    pub share: f64,
}

impl Default for CovisibleOptions {
    fn default() -> Self {
        Self { slack: 0.5, growth: 0.01, colors: true, more_than: 5, share: 0.1 }
    }
}

impl CovisibleOptions {
    /// Fewest of `images` images that must see a co-visible pixel: `1 + max(more_than, ⌊share · images⌋)`.
    pub fn needed(&self, images: usize) -> usize {
        1 + self.more_than.max(cast::to_usize(self.share * images as f64))
    }

    fn check(&self) -> Result<(), MetricError> {
        let must = "a finite number that is not negative";
        for (name, value) in [("slack", self.slack), ("growth", self.growth)] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(MetricError::Option { name, value: value.to_string(), must });
            }
        }
        Ok(())
    }

    /// Whether the flow `there` and `back` returns to the pixel in column `x` and row `y`.
    fn returns(&self, there: &Flow, back: &Flow, x: usize, y: usize) -> bool {
        let square = |d: [f32; 2]| d[0] * d[0] + d[1] * d[1];
        let f = there.at(x, y);
        let b = bilinear(back, x as f32 + f[0], y as f32 + f[1]);
        square([f[0] + b[0], f[1] + b[1]]) <= self.growth * (square(f) + square(b)) + self.slack
    }
}

/// A flow at a place between pixel centres; 0 outside the image.
fn bilinear(flow: &Flow, x: f32, y: f32) -> [f32; 2] {
    let (left, top) = (x.floor(), y.floor());
    let (ax, ay) = (x - left, y - top);
    let corners = [
        (left, top, (1.0 - ax) * (1.0 - ay)),
        (left + 1.0, top, ax * (1.0 - ay)),
        (left, top + 1.0, (1.0 - ax) * ay),
        (left + 1.0, top + 1.0, ax * ay),
    ];
    let (columns, rows) = (0.0..flow.width as f32, 0.0..flow.height as f32);
    let inside = corners.into_iter().filter(|(x, y, _)| columns.contains(x) && rows.contains(y));
    inside.fold([0.0; 2], |sum, (x, y, weight)| {
        let d = flow.at(cast::to_usize(x), cast::to_usize(y));
        [sum[0] + weight * d[0], sum[1] + weight * d[1]]
    })
}

/// How many images of a set see each pixel of an image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Seen {
    /// Width of the image, pixels.
    pub width: usize,
    /// Height of the image, pixels.
    pub height: usize,
    /// Number of images that see the pixel, `[H, W]` row-major.
    pub counts: Vec<u32>,
}

impl Seen {
    /// The co-visibility mask `[H, W, 1]`: 1 where at least `needed` images see the pixel ([`CovisibleOptions::needed`]), else 0.
    pub fn mask(&self, needed: usize) -> Image {
        let data = self.counts.iter().map(|n| f32::from(*n as usize >= needed)).collect();
        Image { width: self.width, height: self.height, channels: 1, data }
    }
}

/// Counts for each pixel of `image` how many of a set of images see it. `load` gives the `k`-th of them, from 0; threads share
/// the set, and a few of its images are in memory at a time. All images are `[H, W, 1 or 3]` in `[0, 1]`, of one shape.
///
/// ```
/// use gs_core::Image;
/// use gs_metrics::{CovisibleOptions, MetricError, seen};
/// let wave = |x: f32, y: f32| 0.5 + 0.2 * (0.3 * x).sin() + 0.2 * (0.25 * y).cos();
/// let frame = |dx: f32| {
///     let data = (0..64 * 48).map(|i| wave((i % 64) as f32 - dx, (i / 64) as f32)).collect();
///     Image { width: 64, height: 48, channels: 1, data }
/// };
/// let rule = CovisibleOptions { more_than: 1, ..CovisibleOptions::default() };
/// let seen = seen(&frame(0.0), 3, |k| Ok::<_, MetricError>(frame(k as f32 - 1.0)), &rule)?;
/// let mask = seen.mask(rule.needed(3));
/// assert_eq!((mask.shape(), mask.pixel(32, 24)), ((64, 48, 1), &[1.0][..]));
/// # Ok::<(), MetricError>(())
/// ```
///
/// # Errors
/// That of `load`; images of different shapes, with 2 or 4 channels or with a value that is not finite; `slack` or `growth` that
/// is negative or not finite. Of several errors any one.
pub fn seen<E: From<MetricError> + Send>(
    image: &Image,
    images: usize,
    load: impl Fn(usize) -> Result<Image, E> + Sync,
    options: &CovisibleOptions,
) -> Result<Seen, E> {
    options.check()?;
    let mut own = Expansion::default();
    Farneback::default().expand(image, &mut own)?;
    let add = |mut tally: Tally, k: usize| {
        tally.add(image, &own, &load(k)?, options)?;
        Ok::<_, E>(tally)
    };
    let tallies = (0..images).into_par_iter().try_fold(Tally::default, add);
    let counts = tallies.map(|tally| tally.map(|t| t.counts)).try_reduce(Vec::new, |a, b| Ok(sum(a, b)))?;
    let counts = sum(counts, vec![0; image.width * image.height]);
    Ok(Seen { width: image.width, height: image.height, counts })
}

/// The sum of two lists of counts; an empty list adds nothing.
fn sum(mut a: Vec<u32>, b: Vec<u32>) -> Vec<u32> {
    if a.is_empty() {
        return b;
    }
    a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
    a
}

/// Counts of some images of a set, and memory for the flows of the next.
#[derive(Default)]
struct Tally {
    counts: Vec<u32>,
    estimate: Farneback,
    expansion: Expansion,
    there: Flow,
    back: Flow,
}

impl Tally {
    /// Counts the pixels of `image`, whose expansion is `own`, that `other` sees.
    fn add(
        &mut self,
        image: &Image,
        own: &Expansion,
        other: &Image,
        options: &CovisibleOptions,
    ) -> Result<(), MetricError> {
        check_pair(image, other)?;
        self.estimate.expand(other, &mut self.expansion)?;
        self.estimate.between(own, &self.expansion, &mut self.there)?;
        self.estimate.between(&self.expansion, own, &mut self.back)?;
        let matches = if options.colors { Some(matching(image, &self.there.warp(other)?)) } else { None };
        self.counts.resize(image.width * image.height, 0);
        for (k, count) in self.counts.iter_mut().enumerate() {
            let (x, y) = (k % image.width, k / image.width);
            let matches = matches.as_ref().is_none_or(|m| m[k]);
            *count += u32::from(matches && options.returns(&self.there, &self.back, x, y));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uniform(width: usize, height: usize, d: [f32; 2]) -> Flow {
        let n = width * height;
        Flow { width, height, u: vec![d[0]; n], v: vec![d[1]; n] }
    }

    #[test]
    fn flow_returns_within_the_published_distance() {
        let rule = CovisibleOptions::default();
        let there = uniform(40, 30, [4.0, 3.0]);
        // |f|² + |b|² is about 50, so |f + b|² may be about 1.
        for (back, returns) in [([-4.0, -3.0], true), ([-4.9, -3.0], true), ([-5.2, -3.0], false), ([0.0, 0.0], false)]
        {
            assert_eq!(rule.returns(&there, &uniform(40, 30, back), 10, 10), returns, "{back:?}");
        }
        let still = uniform(40, 30, [0.0; 2]);
        assert!(rule.returns(&still, &uniform(40, 30, [0.7, 0.0]), 39, 29));
        assert!(!rule.returns(&still, &uniform(40, 30, [0.72, 0.0]), 39, 29));
    }

    #[test]
    fn what_leaves_the_image_does_not_return() {
        let rule = CovisibleOptions::default();
        let (there, back) = (uniform(40, 30, [5.0, 0.0]), uniform(40, 30, [-5.0, 0.0]));
        let row: Vec<bool> = (0..40).map(|x| rule.returns(&there, &back, x, 15)).collect();
        assert_eq!(row, (0..40).map(|x| x < 35).collect::<Vec<_>>());
        assert_eq!(bilinear(&back, 39.5, 10.0), [-2.5, 0.0], "half of it lies outside");
        assert_eq!(bilinear(&back, -1.0, f32::MAX), [0.0; 2]);
    }

    #[test]
    fn counts_add_up_and_make_a_mask() {
        assert_eq!(sum(Vec::new(), vec![1, 2]), [1, 2]);
        assert_eq!(sum(vec![1, 2], vec![3, 0]), [4, 2]);
        let seen = Seen { width: 3, height: 1, counts: vec![0, 2, 3] };
        assert_eq!(seen.mask(2).data, [0.0, 1.0, 1.0]);
        let few = CovisibleOptions { more_than: 2, share: 0.5, ..CovisibleOptions::default() };
        assert_eq!([0, 4, 5, 6, 9].map(|n| few.needed(n)), [3, 3, 3, 4, 5]);
    }
}
