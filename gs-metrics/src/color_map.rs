//! The linear map of colours that brings an image nearest to another: exposure and white balance that a render does not know.
//!
//! ```text
//! A = argmin  Σ_p m_p |A x_p − y_p|² + ρ n |A − I|²        n = Σ_p m_p
//! ```
//! over the pixels `x` of an image and `y` of its ground truth, `m` being how much a pixel counts. `ρ` holds the map near the identity: what the pixels do not
//! tell stays as it is. Pixels whose ground truth is saturated in a channel do not count: what they would be is not known. Black stays black: light adds up, and a map with an offset would put a haze over dark backgrounds wherever a render errs.
//!
//! ```
//! use gs_core::Image;
//! use gs_metrics::ColorMap;
//!
//! let image = Image { width: 4, height: 1, channels: 3, data: vec![0.1, 0.5, 0.2, 0.9, 0.3, 0.4, 0.2, 0.8, 0.6, 0.7, 0.1, 0.3] };
//! let brighter = Image { data: image.data.iter().map(|v| 1.2 * v).collect(), ..image.clone() };
//! let map = ColorMap::fit(&image, &brighter, None, 1e-9)?;
//! assert!((map.matrix[1][1] - 1.2).abs() < 1e-5 && map.matrix[1][2].abs() < 1e-5);
//! # Ok::<(), gs_metrics::MetricError>(())
//! ```

use crate::error::{MetricError, check_pair, explain_non_finite};
use crate::masked::check_masked;
use glam::DMat3;
use gs_core::Image;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Pixels of one partial sum.
const CHUNK: usize = 1 << 12;
/// Channels.
const N: usize = 3;

/// `y = A x` on colours.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ColorMap {
    /// `A`, row by row.
    pub matrix: [[f64; 3]; 3],
}

/// Values from here on are saturated.
pub const SATURATED: f32 = 1.0;

/// Smallest ridge: images of one colour leave a map open.
const LEAST_RIDGE: f64 = 1e-12;
/// A matrix of a smaller determinant has no inverse.
const LEAST_DETERMINANT: f64 = 1e-6;

/// Sums over pixels: `m x xᵀ`, `m x yᵀ` and `m`.
#[derive(Clone, Copy, Default)]
struct Sums {
    gram: [[f64; N]; N],
    cross: [[f64; N]; N],
    count: f64,
}

impl ColorMap {
    /// Nothing is changed.
    pub const IDENTITY: Self = Self { matrix: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] };

    /// The map from `image` to `truth`, both `[H, W, 3]`, over the pixels where `mask`, `[H, W, 1]`, counts; `ridge` is `ρ`, at least 1e-12, as
    /// which smaller ones are taken. The identity for an empty mask.
    ///
    /// # Errors
    /// Different shapes, other than three channels, a value that is not finite, or a mask below 0.
    pub fn fit(image: &Image, truth: &Image, mask: Option<&Image>, ridge: f64) -> Result<Self, MetricError> {
        check_pair(image, truth)?;
        let (width, height) = (image.width, image.height);
        let wrong = |what, first, second| Err(MetricError::Shape { what, first, second });
        if image.channels != 3 {
            return wrong("image and colours", image.shape(), (width, height, 3));
        }
        if let Some(mask) = mask {
            check_masked(image, truth, mask)?;
        }
        let ridge = ridge.max(LEAST_RIDGE);
        let pairs = image.data.par_chunks(3 * CHUNK).zip(truth.data.par_chunks(3 * CHUNK)).enumerate();
        let parts: Vec<Sums> = pairs
            .map(|(k, (x, y))| {
                let weights = mask.map(|m| &m.data[k * CHUNK..]);
                Sums::of(x.as_chunks().0, y.as_chunks().0, weights)
            })
            .collect();
        let mut sums = Sums::default();
        parts.iter().for_each(|part| sums.add(part));
        let finite = |sums: &[[f64; N]; N]| sums.as_flattened().iter().all(|v| v.is_finite());
        if !(finite(&sums.gram) && finite(&sums.cross)) {
            return Err(explain_non_finite("colour map", image, truth));
        }
        if sums.count <= 0.0 {
            return Ok(Self::IDENTITY);
        }
        for k in 0..N {
            sums.gram[k][k] += ridge * sums.count;
            sums.cross[k][k] += ridge * sums.count;
        }
        Ok(sums.solve())
    }

    /// Maps every colour of an image of three channels.
    pub fn apply(&self, image: &mut Image) {
        multiply(self.single(), &mut image.data);
    }

    /// From the gradient with respect to mapped colours, `[H, W, 3]`, to that with respect to the colours, the map being constant: `Aᵀ d`.
    pub fn pull_back(&self, grad: &mut [f32]) {
        let m = self.single();
        multiply(std::array::from_fn(|r| std::array::from_fn(|c| m[c][r])), grad);
    }

    /// The map that undoes this one; none where colours are lost.
    pub fn inverse(&self) -> Option<Self> {
        let map = self.columns();
        (map.is_finite() && map.determinant().abs() > LEAST_DETERMINANT).then(|| Self::of(map.inverse()))
    }

    /// First `first`, then this one.
    pub fn after(&self, first: &Self) -> Self {
        Self::of(self.columns() * first.columns())
    }

    /// `(1 − share) self + share other`, entry by entry.
    pub fn blend(&self, other: &Self, share: f64) -> Self {
        Self::of(self.columns() + share * (other.columns() - self.columns()))
    }

    /// Root mean square of what it changes on colours spread evenly over `[0, 1]³`.
    pub fn strength(&self) -> f64 {
        let change = self.columns() - DMat3::IDENTITY;
        let of = |c: usize| {
            let row = change.row(c);
            (0.5 * row.element_sum()).powi(2) + row.length_squared() / 12.0
        };
        ((0..N).map(of).sum::<f64>() / 3.0).sqrt()
    }

    fn columns(&self) -> DMat3 {
        DMat3::from_cols_array_2d(&self.matrix).transpose()
    }

    fn of(map: DMat3) -> Self {
        Self { matrix: map.transpose().to_cols_array_2d() }
    }

    #[expect(clippy::cast_possible_truncation, reason = "colours are single precision")]
    fn single(&self) -> [[f32; 3]; 3] {
        self.matrix.map(|row| row.map(|v| v as f32))
    }
}

/// Multiplies every colour by a matrix, given row by row.
fn multiply(matrix: [[f32; 3]; 3], colors: &mut [f32]) {
    colors.par_chunks_mut(3 * CHUNK).for_each(|chunk| {
        for pixel in chunk.as_chunks_mut::<3>().0 {
            let x = *pixel;
            *pixel = matrix.map(|[r, g, b]| r * x[0] + g * x[1] + b * x[2]);
        }
    });
}

impl Sums {
    fn of(image: &[[f32; 3]], truth: &[[f32; 3]], weights: Option<&[f32]>) -> Self {
        let mut sums = Self::default();
        for (p, (x, y)) in image.iter().zip(truth).enumerate() {
            if y.iter().any(|v| *v >= SATURATED) {
                continue;
            }
            let m = weights.map_or(1.0, |w| f64::from(w[p]));
            let (x, y) = (x.map(f64::from), y.map(f64::from));
            sums.count += m;
            for i in 0..N {
                (0..N).for_each(|j| sums.gram[i][j] += m * x[i] * x[j]);
                (0..N).for_each(|c| sums.cross[i][c] += m * x[i] * y[c]);
            }
        }
        sums
    }

    fn add(&mut self, other: &Self) {
        self.count += other.count;
        for (sums, others) in [(&mut self.gram, &other.gram), (&mut self.cross, &other.cross)] {
            sums.as_flattened_mut().iter_mut().zip(others.as_flattened()).for_each(|(sum, v)| *sum += v);
        }
    }

    /// Solves the normal equations, which the ridge keeps regular.
    fn solve(self) -> ColorMap {
        let [gram, cross] = [self.gram, self.cross].map(|rows| DMat3::from_cols_array_2d(&rows).transpose());
        ColorMap::of((gram.inverse() * cross).transpose())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    fn noise(seed: u64, width: usize, height: usize) -> Image {
        let mut rng = Rng::new(seed, "color-map", 0, 0);
        Image { width, height, channels: 3, data: (0..3 * width * height).map(|_| rng.uniform()).collect() }
    }

    const WARM: ColorMap = ColorMap { matrix: [[1.2, 0.05, 0.0], [0.02, 1.0, -0.03], [0.0, 0.1, 0.8]] };

    fn assert_near(a: &ColorMap, b: &ColorMap, by: f64) {
        let pairs = a.matrix.as_flattened().iter().zip(b.matrix.as_flattened());
        assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() < by), "{a:?} {b:?}");
    }

    #[test]
    fn a_map_is_found_where_pixels_count() {
        let image = noise(1, 130, 71);
        let mut truth = image.clone();
        WARM.apply(&mut truth);
        assert_near(&ColorMap::fit(&image, &truth, None, 1e-12).unwrap(), &WARM, 1e-5);
        let mut mask = Image { width: 130, height: 71, channels: 1, data: vec![1.0; 130 * 71] };
        for p in (0..mask.data.len()).filter(|p| p % 3 == 0) {
            mask.data[p] = 0.0;
            truth.data[3 * p..3 * p + 3].fill(7.0);
        }
        assert_near(&ColorMap::fit(&image, &truth, Some(&mask), 1e-12).unwrap(), &WARM, 1e-5);
        mask.data.fill(0.0);
        assert_eq!(ColorMap::fit(&image, &truth, Some(&mask), 1e-12).unwrap(), ColorMap::IDENTITY);
    }

    #[test]
    fn the_ridge_pulls_to_the_identity() {
        let image = noise(2, 40, 40);
        let mut truth = image.clone();
        WARM.apply(&mut truth);
        let away = |ridge| {
            let map = ColorMap::fit(&image, &truth, None, ridge).unwrap();
            let off = |m: &ColorMap| (m.matrix[0][0] - 1.0).powi(2) + (m.matrix[2][2] - 1.0).powi(2);
            off(&map)
        };
        assert!(away(1e-6) > away(0.1) && away(0.1) > away(10.0) && away(1e6) < 1e-6);
        assert_near(&ColorMap::fit(&image, &image, None, 1e-3).unwrap(), &ColorMap::IDENTITY, 1e-9);
        // An even image tells three numbers of nine.
        let even = Image { data: vec![0.5; image.data.len()], ..image.clone() };
        let dark = Image { data: vec![0.4; image.data.len()], ..image };
        let mut mapped = even.clone();
        ColorMap::fit(&even, &dark, None, 1e-6).unwrap().apply(&mut mapped);
        assert!(mapped.data.iter().all(|v| (v - 0.4).abs() < 1e-4));
    }

    /// A map that makes the squared error least: no change of an entry makes it less.
    #[test]
    fn the_solution_is_the_least() {
        let (image, truth) = (noise(3, 20, 15), noise(4, 20, 15));
        let ridge = 0.01;
        let cost = |map: &ColorMap| {
            let mut mapped = image.clone();
            map.apply(&mut mapped);
            let error: f64 = mapped.data.iter().zip(&truth.data).map(|(a, b)| f64::from(a - b).powi(2)).sum();
            let off = map.matrix.as_flattened().iter().zip(ColorMap::IDENTITY.matrix.as_flattened());
            error + ridge * 300.0 * off.map(|(a, b)| (a - b).powi(2)).sum::<f64>()
        };
        let best = ColorMap::fit(&image, &truth, None, ridge).unwrap();
        for k in 0..9 {
            for h in [-0.01, 0.01] {
                let mut other = best;
                other.matrix.as_flattened_mut()[k] += h;
                assert!(cost(&other) > cost(&best), "entry {k}");
            }
        }
    }

    #[test]
    fn the_pull_back_is_the_transpose_and_threads_change_nothing() {
        let (image, d) = (noise(5, 90, 77), noise(6, 90, 77));
        let (mut mapped, mut back) = (image.clone(), d.data.clone());
        WARM.apply(&mut mapped);
        WARM.pull_back(&mut back);
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
        assert!((dot(&mapped.data, &d.data) / dot(&image.data, &back) - 1.0).abs() < 1e-6);
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| ColorMap::fit(&image, &d, None, 1e-3).unwrap())
        };
        assert_eq!(with(1), with(3));
    }

    #[test]
    fn maps_follow_each_other_and_are_undone() {
        let image = noise(8, 5, 4);
        let cold = ColorMap { matrix: [[0.7, 0.0, 0.1], [0.0, 0.9, 0.0], [0.1, 0.0, 1.1]] };
        let (mut steps, mut once) = (image.clone(), image.clone());
        cold.apply(&mut steps);
        WARM.apply(&mut steps);
        WARM.after(&cold).apply(&mut once);
        assert!(steps.data.iter().zip(&once.data).all(|(a, b)| (a - b).abs() < 1e-6));
        assert_near(&WARM.inverse().unwrap().after(&WARM), &ColorMap::IDENTITY, 1e-12);
        assert_eq!(ColorMap { matrix: [[0.3; 3]; 3] }.inverse(), None);
        assert_near(&WARM.blend(&cold, 0.0), &WARM, 1e-15);
        assert_near(&WARM.blend(&cold, 1.0), &cold, 1e-15);
    }

    #[test]
    fn what_cannot_be_fitted_is_refused() {
        let image = noise(7, 8, 8);
        let grey = Image::zeros(8, 8, 1);
        assert!(matches!(ColorMap::fit(&image, &noise(8, 8, 9), None, 1.0), Err(MetricError::Shape { .. })));
        assert!(matches!(ColorMap::fit(&grey, &grey, None, 1.0), Err(MetricError::Shape { .. })));
        assert!(matches!(
            ColorMap::fit(&image, &image, Some(&Image::zeros(7, 8, 1)), 1.0),
            Err(MetricError::Shape { .. })
        ));
        let mut bad = image.clone();
        bad.data[5] = f32::NAN;
        assert!(matches!(ColorMap::fit(&bad, &image, None, 1.0), Err(MetricError::NotFinite { .. })));
    }

    #[test]
    fn the_strength_is_what_colours_change() {
        assert_eq!(ColorMap::IDENTITY.strength(), 0.0);
        let image = noise(9, 300, 300);
        let mut mapped = image.clone();
        WARM.apply(&mut mapped);
        let mean = image.data.iter().zip(&mapped.data).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
        assert!(((mean / image.data.len() as f64).sqrt() / WARM.strength() - 1.0).abs() < 0.02);
    }
}
