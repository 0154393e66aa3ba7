//! Masked resampling of maps.

use gs_core::Image;
use rayon::prelude::*;

/// Filter of one output cell along an axis: the first input cell and the weights from there on.
struct Taps {
    first: usize,
    weights: Vec<f64>,
}

/// A triangle filter as wide as the larger of the two cells, renormalised at borders (half-pixel centres).
fn taps(from: usize, to: usize) -> Vec<Taps> {
    let scale = from as f64 / to as f64;
    let support = scale.max(1.0);
    let of_cell = |i: usize| {
        let centre = (i as f64 + 0.5) * scale;
        let lo = (centre - support).floor().max(0.0) as usize;
        let hi = ((centre + support).ceil() as usize).min(from);
        let weight = |j: usize| (1.0 - (j as f64 + 0.5 - centre).abs() / support).max(0.0);
        let weights: Vec<f64> = (lo..hi).map(weight).collect();
        let total: f64 = weights.iter().sum();
        Taps { first: lo, weights: weights.into_iter().map(|w| w / total).collect() }
    };
    (0..to).map(of_cell).collect()
}

/// Resizes a map to `size × size` with a triangle filter. Also returns the valid share of each cell, `size²` values in
/// `[0, 1]`.
///
/// With a mask `m`, values are `Σ w m x / Σ w m`: nothing bleeds in from outside the charts, and cells without a valid texel
/// are 0. Without a mask, `Σ w x` (DUT's published code).
///
/// # Panics
/// If the mask does not have one value per texel, or the map has no channel.
pub fn resize(map: &Image, mask: Option<&[f32]>, size: usize) -> (Image, Vec<f32>) {
    let (width, height, c) = map.shape();
    assert!(mask.is_none_or(|m| m.len() == width * height), "a mask value for every texel");
    assert!(c > 0, "a channel");
    let (across, down) = (taps(width, size), taps(height, size));
    // Rows first, into f64: values times mask, and the mask beside them.
    let mut narrow = vec![0.0f64; height * size * (c + 1)];
    narrow.par_chunks_mut((size * (c + 1)).max(1)).enumerate().for_each(|(y, out)| {
        for (taps, out) in across.iter().zip(out.chunks_exact_mut(c + 1)) {
            for (i, w) in taps.weights.iter().enumerate() {
                let at = y * width + taps.first + i;
                let w = w * mask.map_or(1.0, |m| f64::from(m[at]));
                let values = &map.data[at * c..(at + 1) * c];
                out.iter_mut().zip(values).for_each(|(o, v)| *o += w * f64::from(*v));
                out[c] += w;
            }
        }
    });
    let mut out = Image::zeros(size, size, c);
    let mut share = vec![0.0; size * size];
    out.data.par_chunks_mut((size * c).max(1)).zip(share.par_chunks_mut(size.max(1))).zip(&down).for_each(
        |((out, share), taps)| {
            let mut sum = vec![0.0f64; c + 1];
            for x in 0..size {
                sum.fill(0.0);
                for (i, w) in taps.weights.iter().enumerate() {
                    let at = ((taps.first + i) * size + x) * (c + 1);
                    sum.iter_mut().zip(&narrow[at..=at + c]).for_each(|(s, v)| *s += w * v);
                }
                share[x] = sum[c] as f32;
                let norm = if sum[c] > 1e-6 { 1.0 / sum[c] } else { 0.0 };
                out[x * c..(x + 1) * c].iter_mut().zip(&sum).for_each(|(o, s)| *o = (s * norm) as f32);
            }
        },
    );
    (out, share)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halving_has_the_taps_1_3_3_1() {
        let t = &taps(8, 4)[1];
        assert_eq!((t.first, t.weights.clone()), (1, vec![0.125, 0.375, 0.375, 0.125]));
        let first = &taps(8, 4)[0];
        assert_eq!(first.weights.len(), 3);
        assert!((first.weights.iter().sum::<f64>() - 1.0).abs() < 1e-15);
    }

    #[test]
    fn a_mask_keeps_the_outside_out() {
        // Left half 0.7 and valid, right half −5 and not.
        let mut map = Image::zeros(16, 16, 2);
        let mut mask = vec![0.0; 256];
        for (i, (mask, texel)) in mask.iter_mut().zip(map.data.chunks_exact_mut(2)).enumerate() {
            let valid = i % 16 < 7;
            *mask = if valid { 1.0 } else { 0.0 };
            texel.fill(if valid { 0.7 } else { -5.0 });
        }
        let (masked, share) = resize(&map, Some(&mask), 8);
        for (i, p) in masked.data.chunks(2).enumerate() {
            let want = if i % 8 < 4 { 0.7 } else { 0.0 };
            assert!((p[0] - want).abs() < 1e-6 && p[0] == p[1], "{i}: {p:?}");
        }
        assert!(share[2] == 1.0 && share[3] > 0.4 && share[3] < 1.0 && share[4] == 0.0);
        let (plain, _) = resize(&map, None, 8);
        assert!(plain.data[6] < 0.0, "the plain filter bleeds");
        let (same, _) = resize(&map, None, 16);
        assert_eq!(same, map);
    }

    #[test]
    fn a_ramp_stays_a_ramp_either_way() {
        let ramp = Image::from_data(12, 12, 1, (0..144).map(|i| (i % 12) as f32 + 0.5).collect()).unwrap();
        for size in [4usize, 6, 24, 36] {
            let (out, _) = resize(&ramp, None, size);
            let scale = 12.0 / size as f32;
            let border = (1.0f32.max(1.0 / scale)).ceil() as usize;
            for x in border..size - border {
                let want = (x as f32 + 0.5) * scale;
                assert!((out.pixel(x, size / 2)[0] - want).abs() < 1e-4, "{size} {x}");
            }
        }
    }
}
