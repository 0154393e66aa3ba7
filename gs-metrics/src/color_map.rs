//! The map of colours that brings an image nearest to another: exposure and white balance that a render does not know.
//!
//! ```text
//! linear       A    = argmin  Σ_p m_p |A x_p − y_p|² + ρ n |A − I|²                        n = Σ_p m_p
//! with offset  A, o = argmin  Σ_p m_p |A x_p + α_p o − y_p|² + ρ n (|A − I|² + |o|²)
//! ```
//! over the pixels `x` of an image and `y` of its ground truth, `m` being how much a pixel counts. `ρ` holds the map near the identity: what the pixels do not
//! tell stays as it is. Pixels whose ground truth is saturated in a channel do not count: what they would be is not known.
//!
//! A linear map leaves black black, as light adds up. An offset stands for what a camera adds to all colours: its black level, stray light in the lens. The
//! image is premultiplied by its alpha, `α`, and the offset counts by it: what is not there gets none. An entry of `A` acts on colours of at most 1 and the
//! offset on alphas of at most 1, so the ridge holds both alike. An image that tells nothing of its ground truth, as that of another scene, is best mapped to
//! the mean of the ground truth: with an offset `A` then goes to 0.
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

#[cfg(test)]
mod tests;

use crate::error::{MetricError, check_pair, explain_non_finite};
use crate::masked::check_masked;
use glam::{DMat3, DVec3};
use gs_core::{Image, cast};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Pixels of one partial sum.
const CHUNK: usize = 1 << 12;
/// Channels.
const N: usize = 3;

/// `y = A x + o` on colours.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ColorMap {
    /// `A`, row by row.
    pub matrix: [[f64; 3]; 3],
    /// `o`, 0 unless the map was fitted with one.
    #[serde(default)]
    pub offset: [f64; 3],
}

/// Values from here on are saturated.
pub const SATURATED: f32 = 1.0;

/// Smallest ridge: images of one colour leave a map open.
const LEAST_RIDGE: f64 = 1e-12;
/// A matrix of a smaller determinant has no inverse.
const LEAST_DETERMINANT: f64 = 1e-6;

/// Sums over pixels: `m z zᵀ`, `m z yᵀ` and `m`, `z` being what is mapped: a colour, or a colour and its alpha.
#[derive(Clone, Copy)]
struct Sums<const I: usize> {
    gram: [[f64; I]; I],
    cross: [[f64; N]; I],
    count: f64,
}

impl ColorMap {
    /// Nothing is changed.
    pub const IDENTITY: Self = Self::linear([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);

    /// The map of a matrix, given row by row, without an offset.
    pub const fn linear(matrix: [[f64; 3]; 3]) -> Self {
        Self { matrix, offset: [0.0; 3] }
    }

    /// The linear map from `image` to `truth`, both `[H, W, 3]`, over the pixels where `mask`, `[H, W, 1]`, counts; `ridge` is `ρ`, at least 1e-12, as
    /// which smaller ones are taken. The identity for an empty mask.
    ///
    /// # Errors
    /// Different shapes, other than three channels, a value that is not finite, or a mask below 0.
    pub fn fit(image: &Image, truth: &Image, mask: Option<&Image>, ridge: f64) -> Result<Self, MetricError> {
        let sums = Sums::over(image, truth, mask, |_, x| x)?;
        Ok(sums.map_or(Self::IDENTITY, |sums| sums.solve(ridge.max(LEAST_RIDGE))))
    }

    /// The same with an offset, `image` being premultiplied by `alpha`, `[H, W]` in 0..1.
    ///
    /// ```
    /// use gs_core::Image;
    /// use gs_metrics::ColorMap;
    ///
    /// let data = vec![0.1, 0.5, 0.2, 0.9, 0.3, 0.4, 0.2, 0.8, 0.6, 0.7, 0.1, 0.3, 0.4, 0.4, 0.1];
    /// let image = Image { width: 5, height: 1, channels: 3, data };
    /// let hazy = Image { data: image.data.iter().map(|v| 0.8 * v + 0.1).collect(), ..image.clone() };
    /// let map = ColorMap::fit_with_offset(&image, &[1.0; 5], &hazy, None, 1e-9)?;
    /// assert!((map.matrix[1][1] - 0.8).abs() < 1e-5 && (map.offset[1] - 0.1).abs() < 1e-5);
    /// # Ok::<(), gs_metrics::MetricError>(())
    /// ```
    ///
    /// # Errors
    /// As [`Self::fit`]; an alpha that is not finite, or not one for each pixel.
    pub fn fit_with_offset(
        image: &Image,
        alpha: &[f32],
        truth: &Image,
        mask: Option<&Image>,
        ridge: f64,
    ) -> Result<Self, MetricError> {
        let (width, height, which) = (image.width, image.height, "alpha");
        if 3 * alpha.len() != image.data.len() {
            return Err(MetricError::Malformed { which, shape: (width, height, 1), len: alpha.len() });
        }
        if let Some(at) = alpha.iter().position(|a| !a.is_finite()) {
            let width = width.max(1);
            return Err(MetricError::NotFinite { which, x: at % width, y: at / width, channel: 0 });
        }
        let sums = Sums::over(image, truth, mask, |p, [r, g, b]| [r, g, b, f64::from(alpha[p])])?;
        Ok(sums.map_or(Self::IDENTITY, |sums| sums.solve_with_offset(ridge.max(LEAST_RIDGE))))
    }

    /// Maps every colour of an image of three channels.
    pub fn apply(&self, image: &mut Image) {
        multiply(self.single(), &mut image.data);
        self.add_offset(&mut image.data, std::iter::repeat(&1.0));
    }

    /// The same for an image that is premultiplied by `alpha`, `[H, W]`: `A x + α o`.
    pub fn apply_premultiplied(&self, image: &mut Image, alpha: &[f32]) {
        multiply(self.single(), &mut image.data);
        self.add_offset(&mut image.data, alpha);
    }

    fn add_offset<'a>(&self, colors: &mut [f32], alpha: impl IntoIterator<Item = &'a f32>) {
        if self.offset == [0.0; 3] {
            return;
        }
        let offset = self.offset.map(cast::to_f32);
        for (pixel, alpha) in colors.as_chunks_mut::<3>().0.iter_mut().zip(alpha) {
            pixel.iter_mut().zip(offset).for_each(|(v, o)| *v += alpha * o);
        }
    }

    /// From the gradient with respect to mapped colours, `[H, W, 3]`, to that with respect to the colours, the map being constant: `Aᵀ d`. With respect
    /// to the alpha of a premultiplied image it is `o · d`.
    pub fn pull_back(&self, grad: &mut [f32]) {
        let m = self.single();
        multiply(std::array::from_fn(|r| std::array::from_fn(|c| m[c][r])), grad);
    }

    /// The map that undoes this one; none where colours are lost.
    pub fn inverse(&self) -> Option<Self> {
        let map = self.columns();
        (map.is_finite() && map.determinant().abs() > LEAST_DETERMINANT).then(|| {
            let undone = map.inverse();
            Self::of(undone, -(undone * self.shift()))
        })
    }

    /// First `first`, then this one.
    pub fn after(&self, first: &Self) -> Self {
        Self::of(self.columns() * first.columns(), self.columns() * first.shift() + self.shift())
    }

    /// `(1 − share) self + share other`, entry by entry.
    pub fn blend(&self, other: &Self, share: f64) -> Self {
        let shift = self.shift() + share * (other.shift() - self.shift());
        Self::of(self.columns() + share * (other.columns() - self.columns()), shift)
    }

    /// Root mean square of what it changes on colours spread evenly over `[0, 1]³`.
    pub fn strength(&self) -> f64 {
        let change = self.columns() - DMat3::IDENTITY;
        let of = |c: usize| {
            let row = change.row(c);
            (0.5 * row.element_sum() + self.offset[c]).powi(2) + row.length_squared() / 12.0
        };
        ((0..N).map(of).sum::<f64>() / 3.0).sqrt()
    }

    fn columns(&self) -> DMat3 {
        DMat3::from_cols_array_2d(&self.matrix).transpose()
    }

    fn shift(&self) -> DVec3 {
        DVec3::from_array(self.offset)
    }

    fn of(map: DMat3, shift: DVec3) -> Self {
        Self { matrix: map.transpose().to_cols_array_2d(), offset: shift.to_array() }
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

impl<const I: usize> Sums<I> {
    const ZERO: Self = Self { gram: [[0.0; I]; I], cross: [[0.0; N]; I], count: 0.0 };

    /// Over the pixels of two images where a mask counts; `input` is what is mapped of a pixel, from its index and its colour. None if no pixel counts.
    fn over(
        image: &Image,
        truth: &Image,
        mask: Option<&Image>,
        input: impl Fn(usize, [f64; N]) -> [f64; I] + Sync,
    ) -> Result<Option<Self>, MetricError> {
        check_pair(image, truth)?;
        if image.channels != N {
            let second = (image.width, image.height, N);
            return Err(MetricError::Shape { what: "image and colours", first: image.shape(), second });
        }
        if let Some(mask) = mask {
            check_masked(image, truth, mask)?;
        }
        let pairs = image.data.par_chunks(3 * CHUNK).zip(truth.data.par_chunks(3 * CHUNK)).enumerate();
        let parts: Vec<Self> = pairs
            .map(|(k, (x, y))| {
                let first = k * CHUNK;
                let weights = mask.map(|m| &m.data[first..]);
                Self::of(x.as_chunks().0, y.as_chunks().0, weights, |p, x| input(first + p, x))
            })
            .collect();
        let mut sums = Self::ZERO;
        parts.iter().for_each(|part| sums.add(part));
        if !sums.values().all(|v| v.is_finite()) {
            return Err(explain_non_finite("colour map", image, truth));
        }
        Ok((sums.count > 0.0).then_some(sums))
    }

    fn of(
        image: &[[f32; N]],
        truth: &[[f32; N]],
        weights: Option<&[f32]>,
        input: impl Fn(usize, [f64; N]) -> [f64; I],
    ) -> Self {
        let mut sums = Self::ZERO;
        for (p, (x, y)) in image.iter().zip(truth).enumerate() {
            if y.iter().any(|v| *v >= SATURATED) {
                continue;
            }
            let m = weights.map_or(1.0, |w| f64::from(w[p]));
            let (z, y) = (input(p, x.map(f64::from)), y.map(f64::from));
            sums.count += m;
            for i in 0..I {
                (0..I).for_each(|j| sums.gram[i][j] += m * z[i] * z[j]);
                (0..N).for_each(|c| sums.cross[i][c] += m * z[i] * y[c]);
            }
        }
        sums
    }

    fn values(&self) -> impl Iterator<Item = &f64> {
        self.gram.as_flattened().iter().chain(self.cross.as_flattened())
    }

    fn add(&mut self, other: &Self) {
        self.count += other.count;
        let sums = self.gram.as_flattened_mut().iter_mut().chain(self.cross.as_flattened_mut());
        sums.zip(other.values()).for_each(|(sum, v)| *sum += v);
    }
}

impl Sums<N> {
    /// Solves the normal equations, which the ridge keeps regular.
    fn solve(mut self, ridge: f64) -> ColorMap {
        for k in 0..N {
            self.gram[k][k] += ridge * self.count;
            self.cross[k][k] += ridge * self.count;
        }
        let [gram, cross] = [self.gram, self.cross].map(|rows| DMat3::from_cols_array_2d(&rows).transpose());
        ColorMap::of((gram.inverse() * cross).transpose(), DVec3::ZERO)
    }
}

impl Sums<{ N + 1 }> {
    /// The same with an offset, by Cholesky's factorisation: a pivot is at least the ridge, whatever the pixels tell.
    fn solve_with_offset(mut self, ridge: f64) -> ColorMap {
        let least = ridge * self.count;
        // The unknown is the change of the identity, so that what needs none gets none.
        for i in 0..=N {
            (0..N).for_each(|c| self.cross[i][c] -= self.gram[i][c]);
            self.gram[i][i] += least;
        }
        for j in 0..=N {
            for i in j..=N {
                let rest = self.gram[i][j] - (0..j).map(|k| self.gram[i][k] * self.gram[j][k]).sum::<f64>();
                self.gram[i][j] = if i == j { rest.max(least).sqrt() } else { rest / self.gram[j][j] };
            }
        }
        for c in 0..N {
            for i in 0..=N {
                let dot: f64 = (0..i).map(|k| self.gram[i][k] * self.cross[k][c]).sum();
                self.cross[i][c] = (self.cross[i][c] - dot) / self.gram[i][i];
            }
            for i in (0..=N).rev() {
                let dot: f64 = (i + 1..=N).map(|k| self.gram[k][i] * self.cross[k][c]).sum();
                self.cross[i][c] = (self.cross[i][c] - dot) / self.gram[i][i];
            }
        }
        let [r, g, b, offset] = self.cross;
        ColorMap::of(DMat3::IDENTITY + DMat3::from_cols_array_2d(&[r, g, b]), DVec3::from_array(offset))
    }
}
