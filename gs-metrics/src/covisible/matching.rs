//! Whether the neighbourhoods of two images show the same.
//!
//! Values are rounded to 8 bits, so that all sums are whole numbers and exact. With the sums `D = Σ (a − b)²`, `E = Σ (a² + b²)`
//! and `S = (Σ a)² + (Σ b)²` over the `n` pixels of a window, and over channels, `mean (a − b)² ≤ ½ (var a + var b) + σ²` is
//! ```text
//! 2 n D ≤ n E − S + 2 σ² n²
//! ```

use gs_core::Image;

use crate::Quantise;

/// Half width of the window, pixels.
const RADIUS: usize = 3;
/// Noise that a match may have, steps of 8 bits per channel.
const NOISE: u64 = 5;
/// Most channels of an image.
const CHANNELS: usize = 3;

/// Sums over pixels.
#[derive(Clone, Copy, Default)]
struct Sums {
    /// `(a − b)²`, all channels.
    difference: u32,
    /// `a² + b²`, all channels.
    energy: u32,
    /// `a` and `b` of each channel.
    values: [[u32; 2]; CHANNELS],
}

impl Sums {
    /// Those of one pixel with these channels.
    fn of(a: &[f32], b: &[f32]) -> Self {
        let mut sums = Self::default();
        for ((a, b), values) in a.iter().zip(b).zip(&mut sums.values) {
            *values = [*a, *b].map(|v| u32::from(Quantise::Round.step(v)));
            sums.difference += values[0].abs_diff(values[1]).pow(2);
            sums.energy += values[0] * values[0] + values[1] * values[1];
        }
        sums
    }

    /// Applies `change` to each of these numbers and that of `other`.
    fn each(&mut self, other: &Self, change: impl Fn(u32, u32) -> u32) {
        self.difference = change(self.difference, other.difference);
        self.energy = change(self.energy, other.energy);
        for (own, other) in self.values.as_flattened_mut().iter_mut().zip(other.values.as_flattened()) {
            *own = change(*own, *other);
        }
    }

    /// Whether a window of `n` pixels with these sums matches in so many channels.
    fn matches(&self, n: usize, channels: usize) -> bool {
        let n = n as u64;
        let squares: u64 = self.values.as_flattened().iter().map(|v| u64::from(*v).pow(2)).sum();
        let noise = 2 * NOISE * NOISE * channels as u64 * n * n;
        2 * n * u64::from(self.difference) + squares <= n * u64::from(self.energy) + noise
    }
}

/// For each pixel, row-major, whether the windows around it match in two images of one shape, with up to 3 channels.
pub(super) fn matching(a: &Image, b: &Image) -> Vec<bool> {
    let (width, height, channels) = a.shape();
    let row = |y: usize| (0..width).map(move |x| Sums::of(a.pixel(x, y), b.pixel(x, y)));
    let mut columns = vec![Sums::default(); width];
    let mut out = Vec::with_capacity(width * height);
    for below in 0..height + RADIUS {
        if below < height {
            columns.iter_mut().zip(row(below)).for_each(|(c, s)| c.each(&s, |a, b| a + b));
        }
        if let Some(above) = below.checked_sub(2 * RADIUS + 1) {
            columns.iter_mut().zip(row(above)).for_each(|(c, s)| c.each(&s, |a, b| a - b));
        }
        if let Some(y) = below.checked_sub(RADIUS) {
            let rows = covered(y, height);
            along(&columns, |x, sums| out.push(sums.matches(rows * covered(x, width), channels)));
        }
    }
    out
}

/// Gives the sum over the window around each column, from left to right.
fn along(columns: &[Sums], mut take: impl FnMut(usize, &Sums)) {
    let mut sums = Sums::default();
    for right in 0..columns.len() + RADIUS {
        if let Some(entering) = columns.get(right) {
            sums.each(entering, |a, b| a + b);
        }
        if let Some(left) = right.checked_sub(2 * RADIUS + 1) {
            sums.each(&columns[left], |a, b| a - b);
        }
        if let Some(x) = right.checked_sub(RADIUS) {
            take(x, &sums);
        }
    }
}

/// How many of `n` places the window around the `i`-th covers.
fn covered(i: usize, n: usize) -> usize {
    (i + RADIUS + 1).min(n) - i.saturating_sub(RADIUS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    fn noise(width: usize, height: usize, channels: usize, seed: u64) -> Image {
        let mut rng = Rng::new(seed, "matching test", 0, 0);
        let data = (0..width * height * channels).map(|_| rng.uniform()).collect();
        Image { width, height, channels, data }
    }

    /// The definition in `f64`, pixel by pixel.
    fn plain(a: &Image, b: &Image, x: usize, y: usize) -> bool {
        let (w, h, channels) = a.shape();
        let (left, top) = (x.saturating_sub(RADIUS), y.saturating_sub(RADIUS));
        let (right, bottom) = ((x + RADIUS + 1).min(w), (y + RADIUS + 1).min(h));
        let places: Vec<_> = (top..bottom).flat_map(|y| (left..right).map(move |x| (x, y))).collect();
        let mean =
            |f: &dyn Fn(usize, usize) -> f64| places.iter().map(|(x, y)| f(*x, *y)).sum::<f64>() / places.len() as f64;
        let (mut error, mut variance) = (0.0, 0.0);
        for c in 0..channels {
            let value = |i: &Image, x, y| f64::from(Quantise::Round.step(i.pixel(x, y)[c]));
            error += mean(&|x, y| (value(a, x, y) - value(b, x, y)).powi(2));
            for i in [a, b] {
                variance += mean(&|x, y| value(i, x, y).powi(2)) - mean(&|x, y| value(i, x, y)).powi(2);
            }
        }
        error <= 0.5 * variance + (channels as u64 * NOISE * NOISE) as f64
    }

    #[test]
    fn running_sums_agree_with_the_definition() {
        for (w, h, c) in [(1, 1, 1), (2, 9, 3), (23, 17, 3), (5, 31, 1)] {
            let (a, b) = (noise(w, h, c, 1), noise(w, h, c, 2));
            let mixed: Vec<f32> = a.data.iter().zip(&b.data).map(|(a, b)| 0.4 * a + 0.6 * b).collect();
            let mixed = Image { data: mixed, ..a.clone() };
            let got = matching(&a, &mixed);
            let want: Vec<bool> = (0..w * h).map(|k| plain(&a, &mixed, k % w, k / w)).collect();
            assert_eq!(got, want, "{w}x{h}x{c}");
        }
    }

    #[test]
    fn the_same_matches_and_another_pattern_does_not() {
        let (a, b) = (noise(30, 20, 3, 1), noise(30, 20, 3, 2));
        assert!(matching(&a, &a).iter().all(|m| *m));
        let foreign = matching(&a, &b).iter().filter(|m| **m).count();
        assert!(foreign < 6, "{foreign} of 600 pixels");
        let grey = |v: f32| Image { width: 30, height: 20, channels: 1, data: vec![v / 255.0; 600] };
        assert!(matching(&grey(100.0), &grey(105.0)).iter().all(|m| *m), "within the noise");
        assert!(!matching(&grey(100.0), &grey(106.0)).iter().any(|m| *m));
    }
}
