//! Decoded images: 8-bit RGBA, straight alpha, display-encoded.

use gs_core::{Image, cast};
use rayon::prelude::*;

/// Pixels per parallel task.
const CHUNK: usize = 1 << 13;

/// An RGBA image of `u8`: straight alpha, display-encoded, row-major, origin top left.
///
/// ```
/// use gs_data::ImageU8;
///
/// let image = ImageU8 { width: 2, height: 1, data: vec![255, 0, 0, 255, 0, 255, 0, 0] };
/// assert_eq!(image.pixel(0, 0), [255, 0, 0, 255]);
/// assert_eq!(image.over([0.0, 0.0, 1.0]).data, [1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
/// assert_eq!(image.box_downscaled(1, 1).data, [255, 0, 0, 128]); // premultiplied: transparent green adds nothing
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct ImageU8 {
    /// Number of columns, pixels.
    pub width: usize,
    /// Number of rows, pixels.
    pub height: usize,
    /// `[height, width, 4]` values: RGBA, straight alpha, 0 to 255.
    pub data: Vec<u8>,
}

impl ImageU8 {
    /// The image over a background colour, `C α + B (1 − α)`: `[H, W, 3]` in 0..1, display-encoded, as the 3DGS family blends.
    pub fn over(&self, background: [f32; 3]) -> Image {
        let mut image = Image::default();
        self.over_into(background, &mut image);
        image
    }

    /// [`Self::over`] into an image whose memory is reused.
    pub fn over_into(&self, background: [f32; 3], image: &mut Image) {
        (image.width, image.height, image.channels) = (self.width, self.height, 3);
        image.data.resize(self.width * self.height * 3, 0.0);
        let pieces = image.data.par_chunks_mut(3 * CHUNK).zip(self.data.par_chunks(4 * CHUNK));
        pieces.for_each(|(to, from)| {
            for (to, p) in to.chunks_exact_mut(3).zip(from.chunks_exact(4)) {
                let a = f32::from(p[3]) / 255.0;
                for ((to, &value), b) in to.iter_mut().zip(p).zip(background) {
                    *to = f32::from(value) / 255.0 * a + b * (1.0 - a);
                }
            }
        });
    }

    /// The alpha channel, `[H, W, 1]` in 0..1.
    pub fn alpha(&self) -> Image {
        let data = self.data.chunks_exact(4).map(|p| f32::from(p[3]) / 255.0).collect();
        Image { width: self.width, height: self.height, channels: 1, data }
    }

    /// RGBA of the pixel in column `x` and row `y`.
    ///
    /// # Panics
    /// If it lies outside the image.
    pub fn pixel(&self, x: usize, y: usize) -> [u8; 4] {
        let at = (y * self.width + x) * 4;
        std::array::from_fn(|c| self.data[at + c])
    }

    /// Area average of premultiplied colour and of alpha, to `width × height` (neither larger than the image's). Each new pixel
    /// averages the exact rectangle it covers; half size is the 2×2 mean. Colour under zero alpha becomes black.
    pub fn box_downscaled(&self, width: usize, height: usize) -> Self {
        let columns = spans(self.width, width);
        let rows = spans(self.height, height);
        let mut data = Vec::with_capacity(width * height * 4);
        for row in &rows {
            for column in &columns {
                data.extend_from_slice(&self.area_mean(column, row));
            }
        }
        Self { width, height, data }
    }

    fn area_mean(&self, column: &Span, row: &Span) -> [u8; 4] {
        let (mut sum, mut weight) = ([0.0f64; 4], 0.0);
        for (j, wy) in row.iter() {
            for (i, wx) in column.iter() {
                let p = self.pixel(i, j);
                let w = wx * wy;
                let a = w * f64::from(p[3]);
                for c in 0..3 {
                    sum[c] += a * f64::from(p[c]);
                }
                sum[3] += a;
                weight += w;
            }
        }
        if sum[3] == 0.0 {
            return [0; 4];
        }
        let to_u8 = |v: f64| cast::to_u8(v + 0.5);
        [to_u8(sum[0] / sum[3]), to_u8(sum[1] / sum[3]), to_u8(sum[2] / sum[3]), to_u8(sum[3] / weight)]
    }
}

/// The source cells that one target cell covers: `first..=last`, the outer two with partial weights.
struct Span {
    first: usize,
    weights: Vec<f64>,
}

impl Span {
    fn iter(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.weights.iter().enumerate().map(|(k, &w)| (self.first + k, w))
    }
}

fn spans(source: usize, target: usize) -> Vec<Span> {
    (0..target)
        .map(|k| {
            // In units of 1/target of a source cell, so the arithmetic is exact.
            let (start, end) = (k * source, (k + 1) * source);
            let first = start / target;
            let last = end.div_ceil(target);
            let weights = (first..last)
                .map(|i| (end.min((i + 1) * target) - start.max(i * target)) as f64 / target as f64)
                .collect();
            Span { first, weights }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: usize, height: usize, pixels: &[[u8; 4]]) -> ImageU8 {
        ImageU8 { width, height, data: pixels.concat() }
    }

    #[test]
    fn over_is_straight_alpha() {
        let im = image(1, 1, &[[255, 0, 51, 51]]);
        let c = im.over([1.0, 1.0, 0.0]);
        for (got, want) in c.data.iter().zip([1.0, 0.8, 0.04]) {
            assert!((got - want).abs() < 1e-6);
        }
        assert!((im.alpha().data[0] - 0.2).abs() < 1e-7);
    }

    #[test]
    fn half_size_is_the_two_by_two_mean_of_premultiplied_colour() {
        let im = image(2, 2, &[[200, 0, 0, 255], [0, 0, 0, 0], [100, 10, 0, 255], [7, 7, 7, 0]]);
        assert_eq!(im.box_downscaled(1, 1).data, [150, 5, 0, 128]);
        let clear = image(2, 1, &[[9, 9, 9, 0], [8, 8, 8, 0]]);
        assert_eq!(clear.box_downscaled(1, 1).data, [0, 0, 0, 0]);
    }

    #[test]
    fn fractions_of_pixels_are_weighed() {
        let im = image(3, 1, &[[0, 0, 0, 255], [90, 0, 0, 255], [240, 0, 0, 255]]);
        // Cells cover 1.5 pixels: (0 + 0.5·90)/1.5 = 30 and (0.5·90 + 240)/1.5 = 190.
        assert_eq!(im.box_downscaled(2, 1).data, [30, 0, 0, 255, 190, 0, 0, 255]);
        assert_eq!(im.box_downscaled(3, 1), im, "the same size is the same image");
    }
}
