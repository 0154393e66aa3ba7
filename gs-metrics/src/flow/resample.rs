//! Blur and bilinear resampling combined in one weighted sum per axis, along y and then along x.
//!
//! The pyramid of Farneback's method blurs the frame at full size and then samples it at half-pixel centres; only the rows
//! that are sampled are blurred here. The blur reflects at the border without repeating the edge value, sampling repeats it.

use gs_core::cast;
use rayon::prelude::*;

/// The weights of one axis: output `i` is the weighted sum of `taps` values from index `first[i]`, which may lie outside.
#[derive(Debug)]
pub(super) struct Axis {
    taps: usize,
    first: Vec<isize>,
    weights: Vec<f32>,
    length: usize,
}

impl Axis {
    /// Samples `from` values, blurred by `kernel` (odd length), at `to` places.
    pub(super) fn new(from: usize, to: usize, kernel: &[f32]) -> Self {
        let (radius, taps) = ((kernel.len() / 2) as isize, kernel.len() + 1);
        let step = from as f64 / to as f64;
        let (mut first, mut weights) = (Vec::with_capacity(to), vec![0.0; to * taps]);
        for (i, weights) in weights.chunks_exact_mut(taps).enumerate() {
            // f32 as in OpenCV: its rounding is visible in the weights of wide images.
            let place = cast::to_f32((i as f64 + 0.5) * step - 0.5);
            #[expect(clippy::cast_possible_truncation, reason = "a place between −1 and the length")]
            let (mut at, mut fraction) = (place.floor() as isize, place - place.floor());
            if at < 0 {
                (at, fraction) = (0, 0.0);
            } else if at + 1 >= from as isize {
                (at, fraction) = (from as isize - 1, 0.0);
            }
            for (k, g) in kernel.iter().enumerate() {
                weights[k] += (1.0 - fraction) * g;
                weights[k + 1] += fraction * g;
            }
            first.push(at - radius);
        }
        Self { taps, first, weights, length: from }
    }

    /// The weights of output `i`.
    fn of(&self, i: usize) -> &[f32] {
        &self.weights[i * self.taps..(i + 1) * self.taps]
    }
}

/// Index `i` of `n` values, reflected about the first and the last.
fn reflect(i: isize, n: usize) -> usize {
    let last = n as isize - 1;
    if last == 0 {
        return 0;
    }
    let phase = i.rem_euclid(2 * last);
    phase.min(2 * last - phase) as usize
}

/// Resamples a plane `[H, W]` along both axes and multiplies it by `factor`, into `out`.
pub(super) fn resample(plane: &[f32], columns: &Axis, rows: &Axis, factor: f32, out: &mut [f32]) {
    let (width, out_width) = (columns.length, columns.first.len());
    // Columns outside the row that the first and last outputs read.
    let left = columns.first.first().map_or(0, |f| (-f).max(0)) as usize;
    let right = columns.first.last().map_or(0, |f| f + columns.taps as isize - width as isize).max(0) as usize;
    out.par_chunks_mut(out_width).enumerate().for_each_init(
        || vec![0.0f32; left + width + right],
        |line, (j, out)| {
            let middle = &mut line[left..left + width];
            middle.fill(0.0);
            for (k, weight) in rows.of(j).iter().enumerate() {
                let y = reflect(rows.first[j] + k as isize, rows.length);
                if *weight != 0.0 {
                    let row = &plane[y * width..(y + 1) * width];
                    middle.iter_mut().zip(row).for_each(|(m, v)| *m += weight * v);
                }
            }
            for i in (0..left).chain(left + width..left + width + right) {
                line[i] = line[left + reflect(i as isize - left as isize, width)];
            }
            for (i, o) in out.iter_mut().enumerate() {
                let at = (columns.first[i] + left as isize) as usize;
                let sum: f32 = columns.of(i).iter().zip(&line[at..]).map(|(w, v)| w * v).sum();
                *o = factor * sum;
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_reflect_without_the_edge() {
        let got: Vec<usize> = (-5..9).map(|i| reflect(i, 4)).collect();
        assert_eq!(got, [1, 2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1, 2]);
        assert_eq!((reflect(-3, 1), reflect(7, 1)), (0, 0));
    }

    #[test]
    fn a_ramp_is_sampled_at_half_pixels_and_constant_outside() {
        let ramp = [0.0, 1.0, 2.0, 3.0];
        let mut out = [0.0; 8];
        resample(&ramp, &Axis::new(4, 8, &[1.0]), &Axis::new(1, 1, &[1.0]), 2.0, &mut out);
        assert_eq!(out, [0.0, 0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.0]);
        let mut half = [0.0; 2];
        resample(&ramp, &Axis::new(4, 2, &[1.0]), &Axis::new(1, 1, &[1.0]), 1.0, &mut half);
        assert_eq!(half, [0.5, 2.5]);
    }

    #[test]
    fn the_blur_reflects_and_keeps_constants_at_every_size() {
        let quarter = [0.25, 0.5, 0.25];
        let mut out = [0.0; 3];
        resample(&[4.0, 0.0, 8.0], &Axis::new(3, 3, &quarter), &Axis::new(1, 1, &quarter), 1.0, &mut out);
        assert_eq!(out, [2.0, 3.0, 4.0]);
        for n in 1..9 {
            for m in 1..9 {
                let mut out = vec![0.0; m * n];
                let plane = vec![5.0; n * m];
                resample(&plane, &Axis::new(n, m, &quarter), &Axis::new(m, n, &quarter), 1.0, &mut out);
                assert!(out.iter().all(|v| (v - 5.0).abs() < 1e-5), "{n} {m}: {out:?}");
            }
        }
    }
}
