//! Images of half their size, as protocols that score at half resolution reduce them.

use gs_core::{Image, cast};

/// The image at half its size, `[⌊H/2⌋, ⌊W/2⌋, C]`: every pixel is the mean of the area it covers, 2 × 2 pixels where both sides are even; along an odd side areas
/// are a little longer than 2 and take parts of pixels (OpenCV's `INTER_AREA`). A side of one pixel stays.
///
/// ```
/// use gs_core::Image;
/// use gs_metrics::half_size;
/// let image = Image { width: 4, height: 2, channels: 1, data: vec![0.0, 1.0, 0.5, 0.5, 1.0, 0.0, 0.25, 0.75] };
/// assert_eq!(half_size(&image).data, [0.5, 0.5]);
/// ```
pub fn half_size(image: &Image) -> Image {
    let (columns, rows) = (spans(image.width), spans(image.height));
    let mut half = Image::zeros(columns.len(), rows.len(), image.channels);
    for (y, row) in rows.iter().enumerate() {
        for (x, column) in columns.iter().enumerate() {
            let pixel = half.pixel_mut(x, y);
            for (j, part) in row {
                for (i, of) in column {
                    pixel.iter_mut().zip(image.pixel(*i, *j)).for_each(|(sum, v)| *sum += part * of * v);
                }
            }
        }
    }
    half
}

/// For every pixel of the halved side the pixels of a side of `n` that it covers, and what part of it each of them is.
fn spans(n: usize) -> Vec<Vec<(usize, f32)>> {
    let halved = if n > 1 { n / 2 } else { n };
    // In units of 1/halved of a pixel, output i covers [i·n, (i + 1)·n] and pixel j [j·halved, (j + 1)·halved].
    let common = |i: usize, j: usize| ((i + 1) * n).min((j + 1) * halved) - (i * n).max(j * halved);
    let span = |i: usize| {
        let covered = i * n / halved..((i + 1) * n).div_ceil(halved);
        covered.map(|j| (j, cast::to_f32(common(i, j) as f64 / n as f64))).collect()
    };
    (0..halved).map(span).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn odd_sides_take_parts_of_pixels() {
        let close = |a: &[f32], b: &[f32]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
        let row = Image { width: 5, height: 1, channels: 1, data: vec![1.0, 2.0, 4.0, 8.0, 16.0] };
        assert!(close(&half_size(&row).data, &[(1.0 + 2.0 + 2.0) / 2.5, (2.0 + 8.0 + 16.0) / 2.5]));
        let square = Image { width: 3, height: 3, channels: 1, data: (0..9u8).map(f32::from).collect() };
        assert!(close(&half_size(&square).data, &[4.0]));
    }

    #[test]
    fn sizes_are_halved_and_constants_stay() {
        for (w, h) in [(0, 0), (1, 1), (1, 4), (2, 3), (7, 5), (101, 64)] {
            let half = half_size(&Image { width: w, height: h, channels: 3, data: vec![0.75; w * h * 3] });
            let side = |n: usize| if n > 1 { n / 2 } else { n };
            assert_eq!(half.shape(), (side(w), side(h), 3));
            assert!(half.data.iter().all(|v| (v - 0.75).abs() < 1e-6), "{w}x{h}");
        }
    }

    /// On even sides the bits of a quarter of the sum of four.
    #[test]
    fn even_sides_are_means_of_four() {
        let mut rng = gs_core::Rng::new(1, "half test", 0, 0);
        let image = Image { width: 6, height: 4, channels: 3, data: (0..72).map(|_| rng.normal()).collect() };
        let half = half_size(&image);
        for (y, x, c) in (0..2).flat_map(|y| (0..3).flat_map(move |x| (0..3).map(move |c| (y, x, c)))) {
            let at = |dx: usize, dy: usize| image.pixel(2 * x + dx, 2 * y + dy)[c];
            let mean = 0.25 * (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1));
            assert_eq!(half.pixel(x, y)[c].to_bits(), mean.to_bits());
        }
    }
}
