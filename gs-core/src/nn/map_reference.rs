//! Reference of the layers of maps: plain loops over any [`Real`], for tests of the fast layers.
//!
//! With `f64` they give reference values; with [`Dual`] also an exact derivative along one direction, so the gradient of a
//! whole network is checked without a second hand-written backward.
//!
//! ```
//! use gs_core::nn::map_reference::Dual;
//!
//! let x = Dual { v: 3.0, d: 1.0 };
//! assert_eq!(x * x + x, Dual { v: 12.0, d: 7.0 }); // (x² + x)' = 2x + 1
//! ```

use super::norm::EPSILON;
use crate::real::Real;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// A dual number `v + ε d` with `ε² = 0`: a value and its derivative along one direction.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Dual {
    /// Value `v` of the expression.
    pub v: f64,
    /// Derivative `d` of the expression.
    pub d: f64,
}

impl Add for Dual {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self { v: self.v + o.v, d: self.d + o.d }
    }
}

impl Sub for Dual {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        Self { v: self.v - o.v, d: self.d - o.d }
    }
}

impl Mul for Dual {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        Self { v: self.v * o.v, d: self.d * o.v + self.v * o.d }
    }
}

impl Div for Dual {
    type Output = Self;
    fn div(self, o: Self) -> Self {
        let v = self.v / o.v;
        Self { v, d: (self.d - v * o.d) / o.v }
    }
}

impl Neg for Dual {
    type Output = Self;
    fn neg(self) -> Self {
        Self { v: -self.v, d: -self.d }
    }
}

impl Real for Dual {
    fn lit(self, c: f64) -> Self {
        Self { v: c, d: 0.0 }
    }
    fn sqrt(self) -> Self {
        let v = self.v.sqrt();
        Self { v, d: self.d / (2.0 * v) }
    }
    fn max(self, other: Self) -> Self {
        if self.v > other.v { self } else { other }
    }
    fn min(self, other: Self) -> Self {
        if self.v < other.v { self } else { other }
    }
    fn select_lt(self, other: Self, then: Self, otherwise: Self) -> Self {
        if self.v < other.v { then } else { otherwise }
    }
}

/// A map `[height, width, channels]` without border.
#[derive(Clone, Debug, PartialEq)]
pub struct RefMap<T> {
    /// Number of rows of pixels.
    pub height: usize,
    /// Number of pixels per row.
    pub width: usize,
    /// Number of values per pixel.
    pub channels: usize,
    /// The `height · width · channels` values, row-major.
    pub data: Vec<T>,
}

impl<T: Real> RefMap<T> {
    /// The map of the values `f(y, x, c)`, called in row-major order.
    pub fn from_fn([height, width, channels]: [usize; 3], mut f: impl FnMut(usize, usize, usize) -> T) -> Self {
        let at = |i: usize| (i / channels / width, i / channels % width, i % channels);
        let data = (0..height * width * channels).map(|i| f(at(i).0, at(i).1, at(i).2)).collect();
        Self { height, width, channels, data }
    }

    /// The value of channel `c` at pixel `(y, x)`.
    pub fn at(&self, y: usize, x: usize, c: usize) -> T {
        self.data[(y * self.width + x) * self.channels + c]
    }

    /// The same map with zeros where `inside` (one flag per pixel) is false.
    pub fn masked(mut self, inside: &[bool]) -> Self {
        for (pixel, inside) in self.data.chunks_mut(self.channels).zip(inside) {
            if !inside {
                pixel.iter_mut().for_each(|v| *v = v.lit(0.0));
            }
        }
        self
    }
}

/// Convolution, `y[q, o] = b[o] + Σ x[s q + k − p, i] W[k, i, o]`, zero outside, `p = ⌊kernel / 2⌋`; no bias if `b` is empty.
pub fn conv<T: Real>(x: &RefMap<T>, w: &[T], b: &[T], kernel: usize, stride: usize) -> RefMap<T> {
    let outputs = w.len() / (kernel * kernel * x.channels);
    RefMap::from_fn([x.height / stride, x.width / stride, outputs], |qy, qx, o| {
        let mut sum = b.get(o).copied().unwrap_or(w[0].lit(0.0));
        for k in 0..kernel * kernel {
            let inside =
                |q: usize, k: usize, size: usize| (q * stride + k).checked_sub(kernel / 2).filter(|p| *p < size);
            let (Some(y), Some(px)) = (inside(qy, k / kernel, x.height), inside(qx, k % kernel, x.width)) else {
                continue;
            };
            for i in 0..x.channels {
                sum = sum + x.at(y, px, i) * w[(k * x.channels + i) * outputs + o];
            }
        }
        sum
    })
}

/// Transposed convolution, `y[2 q + k, o] = b[o] + Σ x[q, i] W[k, o, i]`, `k` in `{0, 1}²`.
pub fn conv_transpose<T: Real>(x: &RefMap<T>, w: &[T], b: &[T]) -> RefMap<T> {
    RefMap::from_fn([2 * x.height, 2 * x.width, b.len()], |y, px, o| {
        let row = ((y % 2 * 2 + px % 2) * b.len() + o) * x.channels;
        (0..x.channels).fold(b[o], |sum, i| sum + x.at(y / 2, px / 2, i) * w[row + i])
    })
}

/// Group normalisation over the pixels that are `inside`; zero at the others.
pub fn group_norm<T: Real>(x: &RefMap<T>, scale: &[T], shift: &[T], groups: usize, inside: &[bool]) -> RefMap<T> {
    let per_group = x.channels / groups;
    let zero = scale[0].lit(0.0);
    let mean_of = |g: usize, f: &dyn Fn(T) -> T| {
        let (mut sum, mut count) = (zero, 0.0);
        for (pixel, _) in x.data.chunks(x.channels).zip(inside).filter(|(_, inside)| **inside) {
            for v in &pixel[g * per_group..][..per_group] {
                (sum, count) = (sum + f(*v), count + 1.0);
            }
        }
        sum / zero.lit(f64::max(count, 1.0))
    };
    let moments: Vec<[T; 2]> = (0..groups)
        .map(|g| {
            let mean = mean_of(g, &|v| v);
            [mean, mean_of(g, &|v| (v - mean) * (v - mean))]
        })
        .collect();
    let y = RefMap::from_fn([x.height, x.width, x.channels], |y, px, c| {
        let [mean, variance] = moments[c / per_group];
        (x.at(y, px, c) - mean) / (variance + zero.lit(EPSILON)).sqrt() * scale[c] + shift[c]
    });
    y.masked(inside)
}

/// ReLU of every value, `max(x, 0)`.
pub fn relu<T: Real>(mut x: RefMap<T>) -> RefMap<T> {
    x.data.iter_mut().for_each(|v| *v = v.max(v.lit(0.0)));
    x
}

/// 2 × 2 max pooling of each channel.
pub fn max_pool<T: Real>(x: &RefMap<T>) -> RefMap<T> {
    RefMap::from_fn([x.height / 2, x.width / 2, x.channels], |y, px, c| {
        let at = |dy, dx| x.at(2 * y + dy, 2 * px + dx, c);
        // Of equal values the first one is taken: `max` keeps its left side only if it is larger.
        at(1, 1).max(at(1, 0)).max(at(0, 1)).max(at(0, 0))
    })
}

/// Upsampling by 2: bilinear interpolation at `(at + ½) / 2 − ½`, clamped at the edges.
pub fn upsample<T: Real>(x: &RefMap<T>) -> RefMap<T> {
    let taps = |at: usize, size: usize| {
        let place = ((at as f64 + 0.5) / 2.0 - 0.5).max(0.0);
        let low = (place.floor() as usize).min(size - 1);
        [(low, 1.0 - place.fract()), ((low + 1).min(size - 1), place.fract())]
    };
    RefMap::from_fn([2 * x.height, 2 * x.width, x.channels], |y, px, c| {
        let mut sum = x.data[0].lit(0.0);
        for (sy, wy) in taps(y, x.height) {
            for (sx, wx) in taps(px, x.width) {
                sum = sum + x.at(sy, sx, c) * sum.lit(wy * wx);
            }
        }
        sum
    })
}

/// Concatenation of channels, those of `a` first.
pub fn concat<T: Real>(a: &RefMap<T>, b: &RefMap<T>) -> RefMap<T> {
    RefMap::from_fn([a.height, a.width, a.channels + b.channels], |y, x, c| match c.checked_sub(a.channels) {
        None => a.at(y, x, c),
        Some(c) => b.at(y, x, c),
    })
}

/// Sum of two maps, `a + b`.
pub fn add<T: Real>(a: &RefMap<T>, b: &RefMap<T>) -> RefMap<T> {
    RefMap::from_fn([a.height, a.width, a.channels], |y, x, c| a.at(y, x, c) + b.at(y, x, c))
}
