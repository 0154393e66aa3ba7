//! 2 × 2 average pooling with stride 2, and its adjoint.
//!
//! A side of odd length gets one line of zeros in front, which counts in the average, so `s → ⌈s/2⌉`. This is `avg_pool2d`
//! with padding `side mod 2`, whose line of zeros at the other end is never reached.

use gs_core::Image;
use rayon::prelude::*;

/// Output rows of one parallel task.
const ROWS: usize = 16;

/// Writes the pooled image into `out`, which is reshaped.
pub(crate) fn halve(image: &Image, out: &mut Image) {
    let (w, h, c) = image.shape();
    (out.width, out.height, out.channels) = (w.div_ceil(2), h.div_ceil(2), c);
    let row_len = out.width * c;
    out.data.resize(out.height * row_len, 0.0);
    let add_row = |row: &mut [f32], y: usize| {
        let source = &image.data[y * w * c..(y + 1) * w * c];
        let (head, body) = if w % 2 == 1 { source.split_at(c) } else { source.split_at(0) };
        let (first, rest) = row.split_at_mut(head.len());
        first.iter_mut().zip(head).for_each(|(o, v)| *o += 0.25 * v);
        for (o, pair) in rest.chunks_exact_mut(c).zip(body.chunks_exact(2 * c)) {
            (0..c).for_each(|k| o[k] += 0.25 * (pair[k] + pair[c + k]));
        }
    };
    out.data.par_chunks_mut(ROWS * row_len).enumerate().for_each(|(block, rows)| {
        for (j, row) in rows.chunks_exact_mut(row_len).enumerate() {
            row.fill(0.0);
            let bottom = 2 * (block * ROWS + j) + 1 - h % 2;
            bottom.checked_sub(1).into_iter().chain([bottom]).for_each(|y| add_row(row, y));
        }
    });
}

/// `fine[p] = fine[p]·gain[channel] + coarse[pooled p]/4`: the adjoint of [`halve`], added to a scaled gradient.
pub(crate) fn scale_and_add_adjoint(fine: &mut Image, gain: &[f32; 4], coarse: Option<&Image>) {
    let (w, h, c) = fine.shape();
    fine.data.par_chunks_mut(w * c).enumerate().for_each(|(y, row)| {
        let above = coarse.map(|i| &i.data[(y + h % 2) / 2 * i.width * c..]);
        for (x, pixel) in row.chunks_exact_mut(c).enumerate() {
            let at = (x + w % 2) / 2 * c;
            for k in 0..c {
                pixel[k] = pixel[k] * gain[k] + above.map_or(0.0, |a| 0.25 * a[at + k]);
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    fn noise(w: usize, h: usize, c: usize, seed: u64) -> Image {
        let mut rng = Rng::new(seed, "pool test", 0, 0);
        Image { width: w, height: h, channels: c, data: (0..w * h * c).map(|_| rng.normal()).collect() }
    }

    #[test]
    fn even_and_odd_sides() {
        let image = Image { width: 3, height: 2, channels: 1, data: vec![1.0, 2.0, 3.0, 5.0, 6.0, 7.0] };
        let mut out = Image::default();
        halve(&image, &mut out);
        assert_eq!((out.shape(), out.data), ((2, 1, 1), vec![1.5, 4.5]));
    }

    #[test]
    fn the_adjoint_has_the_same_inner_product() {
        for (w, h, c) in [(1, 1, 1), (2, 3, 3), (5, 4, 2), (7, 41, 3), (8, 8, 4)] {
            let (x, mut pooled) = (noise(w, h, c, 1), Image::default());
            halve(&x, &mut pooled);
            let y = noise(pooled.width, pooled.height, c, 2);
            let mut back = Image::zeros(w, h, c);
            scale_and_add_adjoint(&mut back, &[1.0; 4], Some(&y));
            let dot = |a: &Image, b: &Image| a.data.iter().zip(&b.data).map(|(p, q)| f64::from(p * q)).sum::<f64>();
            assert!((dot(&pooled, &y) - dot(&x, &back)).abs() < 1e-5, "{w}x{h}x{c}");
        }
    }
}
