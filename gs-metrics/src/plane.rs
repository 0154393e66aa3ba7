//! One-channel images for the perceptual proxy: opponent planes and a binomial pyramid.

use gs_core::Image;
use rayon::prelude::*;

/// Weights of RGB for luma and two chroma planes (BT.601, as in JPEG); chroma lies in `[−½, ½]`.
const OPPONENT: [[f32; 3]; 3] = [[0.299, 0.587, 0.114], [-0.168_736, -0.331_264, 0.5], [0.5, -0.418_688, -0.081_312]];
/// Binomial taps of the pyramid, sum 1.
const BINOMIAL: [f32; 5] = [0.0625, 0.25, 0.375, 0.25, 0.0625];

/// A plane of `width · height` values, row-major.
#[derive(Clone, Debug)]
pub(crate) struct Plane {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) data: Vec<f32>,
}

impl Plane {
    /// Row `y`; the nearest row where `y` is outside.
    pub(crate) fn row(&self, y: isize) -> &[f32] {
        let y = y.clamp(0, self.height as isize - 1) as usize;
        &self.data[y * self.width..(y + 1) * self.width]
    }

    /// The next level of the pyramid: the binomial blur at every second pixel, nearest values outside.
    pub(crate) fn halve(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut data = vec![0.0; width * height];
        data.par_chunks_mut(width).enumerate().for_each_init(Vec::new, |blurred: &mut Vec<f32>, (j, out)| {
            blurred.clear();
            blurred.resize(self.width, 0.0);
            for (t, weight) in BINOMIAL.iter().enumerate() {
                let row = self.row((2 * j + t) as isize - 2);
                blurred.iter_mut().zip(row).for_each(|(b, v)| *b += weight * v);
            }
            let at = |x: isize| blurred[x.clamp(0, self.width as isize - 1) as usize];
            for (i, o) in out.iter_mut().enumerate() {
                *o = (0..5).map(|t| BINOMIAL[t] * at((2 * i + t) as isize - 2)).sum();
            }
        });
        Self { width, height, data }
    }
}

/// Luma and, for RGB, two chroma planes of an image with 1 or 3 channels.
pub(crate) fn opponent_planes(image: &Image) -> Vec<Plane> {
    let plane = |data| Plane { width: image.width, height: image.height, data };
    if image.channels == 1 {
        return vec![plane(image.data.clone())];
    }
    let mix = |m: &[f32; 3]| image.data.chunks_exact(3).map(|p| m[0] * p[0] + m[1] * p[1] + m[2] * p[2]).collect();
    OPPONENT.iter().map(|m| plane(mix(m))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_stays_constant_at_every_size() {
        for n in 1..12 {
            let p = Plane { width: n, height: 12 - n, data: vec![0.75; n * (12 - n)] };
            let q = p.halve();
            assert_eq!((q.width, q.height), (n.div_ceil(2), (12 - n).div_ceil(2)));
            assert!(q.data.iter().all(|v| *v == 0.75));
        }
    }

    #[test]
    fn a_point_spreads_by_the_binomial() {
        let mut p = Plane { width: 9, height: 9, data: vec![0.0; 81] };
        p.data[4 * 9 + 4] = 1.0;
        let q = p.halve();
        assert_eq!(q.data[2 * 5 + 2], 0.375 * 0.375);
        assert_eq!(q.data[2 * 5 + 1], 0.375 * 0.0625);
    }

    #[test]
    fn grey_has_no_chroma() {
        let grey = Image { width: 2, height: 1, channels: 3, data: vec![0.5; 6] };
        let planes = opponent_planes(&grey);
        assert!(planes[0].data.iter().all(|v| (v - 0.5).abs() < 1e-6));
        assert!(planes[1..].iter().all(|p| p.data.iter().all(|v| v.abs() < 1e-6)));
    }
}
