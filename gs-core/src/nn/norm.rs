//! Group normalisation of maps (Wu and He 2018, "Group normalization"), optionally followed by ReLU, and its gradient.
//!
//! ```text
//! x̂ = (x − μ_g) / σ_g       y = γ_c x̂ + β_c       σ_g² = Var_g + ε          g: consecutive channels of all sites
//! dx = (γ dy − mean_g(γ dy) − x̂ mean_g(γ dy x̂)) / σ_g       dγ = Σ dy x̂       dβ = Σ dy
//! ```
//! Statistics are over the given sites alone. They are computed row by row (mean, then squares about it, while the row is
//! in the cache) and merged in `f64` in row order (Chan, Golub and LeVeque 1979): one pass over memory, and no
//! cancellation where the mean is large against the standard deviation.
//!
//! ```
//! use gs_core::nn::{GroupNorm, Map, NormTape, Sites};
//!
//! let (mut x, mut y) = (Map::zeros(1, 2, 1, 0), Map::zeros(1, 2, 1, 0));
//! x.load(&[99.0, 101.0]); // mean 100, variance 1
//! GroupNorm::new("norm", 1, 1, false).forward(&x, &mut y, &Sites::full(1, 2), &mut NormTape::default());
//! assert!((y.pixel(0, 0)[0] + 1.0).abs() < 1e-5 && (y.pixel(0, 1)[0] - 1.0).abs() < 1e-5);
//! ```

use super::map::{Map, Sites};
use crate::{Param, Params};
use fearless_simd::{Level, Simd, dispatch};
use rayon::prelude::*;

/// Added to the variance (PyTorch's default).
pub(super) const EPSILON: f64 = 1e-5;

/// Group normalisation with a scale and a shift per channel.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupNorm {
    /// Scale `γ`, `[channels]`; initially 1.
    pub scale: Param,
    /// Shift `β`, `[channels]`; initially 0.
    pub shift: Param,
    groups: usize,
    relu: bool,
}

/// What the forward pass stores for the backward pass, and buffers that both reuse.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NormTape {
    /// `μ` of each channel's group, `[channels]`.
    mean: Vec<f32>,
    /// `1 / σ` of each channel's group, `[channels]`.
    inverse: Vec<f32>,
    /// One line of sums per row of the map.
    lines: Vec<f64>,
    /// `Σ dy`, then `Σ dy x̂`, per channel.
    totals: Vec<f64>,
    /// `mean_g(γ dy)` and `mean_g(γ dy x̂)` of each channel's group.
    means: [Vec<f32>; 2],
}

/// Mean and sum of squares about it of `count` values.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Moments {
    count: f64,
    mean: f64,
    squares: f64,
}

impl Moments {
    fn merge(self, other: Self) -> Self {
        let count = self.count + other.count;
        if other.count == 0.0 {
            return self;
        }
        let apart = other.mean - self.mean;
        let mean = self.mean + apart * other.count / count;
        Self { count, mean, squares: self.squares + other.squares + apart * apart * self.count * other.count / count }
    }
}

impl GroupNorm {
    /// A layer whose parameters are `{name}.scale` and `{name}.shift`; `relu`: `y = max(γ x̂ + β, 0)`.
    ///
    /// # Panics
    /// If `groups` does not divide `channels`.
    pub fn new(name: &str, channels: usize, groups: usize, relu: bool) -> Self {
        assert!(groups > 0 && channels.is_multiple_of(groups), "{channels} channels in {groups} groups");
        let scale = Param::shared(format!("{name}.scale"), vec![1.0; channels]);
        Self { scale, shift: Param::shared(format!("{name}.shift"), vec![0.0; channels]), groups, relu }
    }

    fn channels(&self) -> usize {
        self.scale.len()
    }

    /// Forward: computes `y` at `sites`; other pixels of `y` keep their content.
    ///
    /// # Panics
    /// If shapes differ.
    pub fn forward(&self, x: &Map, y: &mut Map, sites: &Sites, tape: &mut NormTape) {
        self.check(x, y, sites);
        self.measure(x, sites, tape);
        let NormTape { mean, inverse, .. } = tape;
        let line = Line { mean, inverse, scale: &self.scale.value, shift: &self.shift.value, relu: self.relu };
        let (channels, left) = (self.channels(), y.border() * self.channels());
        y.par_rows_mut(1).enumerate().for_each(|(at, y)| {
            let x = x.row(at);
            dispatch!(Level::new(), simd => line.forward(simd, sites.row(at), x, &mut y[left..], channels));
        });
    }

    fn check(&self, x: &Map, y: &Map, sites: &Sites) {
        let shape = |m: &Map| (m.height(), m.width(), m.channels());
        assert_eq!(shape(x), shape(y), "maps of a normalisation");
        assert_eq!(shape(x), (sites.height(), sites.width(), self.channels()), "map and layer");
    }

    /// Mean and reciprocal standard deviation of each group.
    fn measure(&self, x: &Map, sites: &Sites, tape: &mut NormTape) {
        let (groups, channels) = (self.groups, self.channels());
        let width = 3 * groups;
        tape.lines.resize(sites.height() * width, 0.0);
        let lines = &mut tape.lines[..sites.height() * width];
        lines.par_chunks_mut(width).enumerate().for_each(|(y, line)| {
            let per_group = channels / groups;
            dispatch!(Level::new(), simd => row_moments(simd, sites.row(y), x.row(y), channels, per_group, line));
        });
        for column in [&mut tape.mean, &mut tape.inverse] {
            column.resize(channels, 0.0);
        }
        for g in 0..groups {
            let of_row = |line: &[f64]| Moments { count: line[3 * g], mean: line[3 * g + 1], squares: line[3 * g + 2] };
            let all = lines.chunks(width).map(of_row).fold(Moments::default(), Moments::merge);
            let variance = if all.count > 0.0 { all.squares / all.count } else { 0.0 };
            let of_group = g * channels / groups..(g + 1) * channels / groups;
            tape.mean[of_group.clone()].fill(all.mean as f32);
            tape.inverse[of_group].fill((1.0 / (variance + EPSILON).sqrt()) as f32);
        }
    }

    /// Backward, in place: `d` is the cotangent of `y` on entry and that of `x` on return, at `sites`. Adds the gradients
    /// of scale and shift. `x` and `tape` are those of the forward pass.
    ///
    /// # Panics
    /// If shapes differ.
    pub fn backward(&mut self, x: &Map, d: &mut Map, sites: &Sites, tape: &mut NormTape) {
        self.check(x, d, sites);
        let (channels, width) = (self.channels(), 2 * self.channels());
        let NormTape { mean, inverse, lines, totals, means } = tape;
        lines.resize(lines.len().max(sites.height() * width), 0.0);
        let lines = &mut lines[..sites.height() * width];
        let line = Line { mean, inverse, scale: &self.scale.value, shift: &self.shift.value, relu: self.relu };
        let left = d.border() * channels;
        d.par_rows_mut(1).zip(lines.par_chunks_mut(width)).enumerate().for_each(|(at, (d, sums))| {
            let d = &mut d[left..];
            dispatch!(Level::new(), simd => line.sums(simd, sites.row(at), x.row(at), d, channels, sums));
        });
        totals.clear();
        totals.resize(width, 0.0);
        lines.chunks(width).for_each(|row| totals.iter_mut().zip(row).for_each(|(t, v)| *t += v));
        let (sum_d, sum_dx) = totals.split_at(channels);
        let count = (sites.len() * channels / self.groups).max(1) as f64;
        means.iter_mut().for_each(|m| m.resize(channels, 0.0));
        let [first, second] = means;
        for g in 0..self.groups {
            let of_group = g * channels / self.groups..(g + 1) * channels / self.groups;
            let mean = |sums: &[f64]| of_group.clone().map(|c| f64::from(self.scale.value[c]) * sums[c]).sum::<f64>();
            first[of_group.clone()].fill((mean(sum_d) / count) as f32);
            second[of_group.clone()].fill((mean(sum_dx) / count) as f32);
        }
        d.par_rows_mut(1).enumerate().for_each(|(at, d)| {
            let d = &mut d[left..];
            dispatch!(Level::new(), simd => line.backward(simd, sites.row(at), x.row(at), d, [first, second]));
        });
        for c in 0..channels {
            self.shift.grad[c] += sum_d[c] as f32;
            self.scale.grad[c] += sum_dx[c] as f32;
        }
    }
}

impl Params for GroupNorm {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        f(&self.scale);
        f(&self.shift);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        f(&mut self.scale);
        f(&mut self.shift);
    }
}

/// Channels whose sums one pass over a row keeps in registers or the first-level cache.
const CHANNEL_BLOCK: usize = 64;

/// Count, mean and squares about it of each group in one row, as three values per group.
#[inline(always)]
fn row_moments<S: Simd>(_: S, xs: &[u32], row: &[f32], channels: usize, per_group: usize, line: &mut [f64]) {
    let count = xs.len() as f64;
    line.chunks_exact_mut(3).for_each(|m| m.copy_from_slice(&[count * per_group as f64, 0.0, 0.0]));
    if xs.is_empty() {
        return;
    }
    for squares in [false, true] {
        for first in (0..channels).step_by(CHANNEL_BLOCK) {
            let width = CHANNEL_BLOCK.min(channels - first);
            let mut about = [0.0f32; CHANNEL_BLOCK];
            if squares {
                about[..width]
                    .iter_mut()
                    .enumerate()
                    .for_each(|(c, a)| *a = line[(first + c) / per_group * 3 + 1] as f32);
            }
            let mut sums = [0.0f32; CHANNEL_BLOCK];
            for &x in xs {
                let pixel = &row[x as usize * channels + first..][..width];
                for ((s, v), a) in sums[..width].iter_mut().zip(pixel).zip(&about[..width]) {
                    let v = v - a;
                    *s += if squares { v * v } else { v };
                }
            }
            for (c, s) in sums[..width].iter().enumerate() {
                let at = (first + c) / per_group * 3 + 1 + usize::from(squares);
                line[at] += f64::from(*s) / if squares { 1.0 } else { count * per_group as f64 };
            }
        }
        if !squares {
            // The stored mean is the one that the squares are about.
            line.chunks_exact_mut(3).for_each(|m| m[1] = f64::from(m[1] as f32));
        }
    }
}

/// Statistics and parameters per channel, for the loop over one row.
struct Line<'a> {
    mean: &'a [f32],
    inverse: &'a [f32],
    scale: &'a [f32],
    shift: &'a [f32],
    relu: bool,
}

impl Line<'_> {
    /// `x̂` of channel `c`, and the output before ReLU.
    #[inline(always)]
    fn normal(&self, c: usize, x: f32) -> (f32, f32) {
        let normal = (x - self.mean[c]) * self.inverse[c];
        (normal, normal * self.scale[c] + self.shift[c])
    }

    #[inline(always)]
    fn forward<S: Simd>(&self, _: S, xs: &[u32], x: &[f32], y: &mut [f32], channels: usize) {
        let line = self.cut(channels);
        for &at in xs {
            let range = at as usize * channels..(at as usize + 1) * channels;
            let (x, y) = (&x[range.clone()], &mut y[range]);
            for c in 0..channels {
                let (_, value) = line.normal(c, x[c]);
                y[c] = if line.relu { value.max(0.0) } else { value };
            }
        }
    }

    /// Clips `d` by the ReLU; `Σ d` and `Σ d x̂` per channel, of one row.
    #[inline(always)]
    fn sums<S: Simd>(&self, _: S, xs: &[u32], x: &[f32], d: &mut [f32], channels: usize, sums: &mut [f64]) {
        let (sum_d, sum_dx) = sums.split_at_mut(channels);
        for first in (0..channels).step_by(CHANNEL_BLOCK) {
            let width = CHANNEL_BLOCK.min(channels - first);
            let (mut s, mut sx) = ([0.0f32; CHANNEL_BLOCK], [0.0f32; CHANNEL_BLOCK]);
            let line = Line {
                mean: &self.mean[first..][..width],
                inverse: &self.inverse[first..][..width],
                scale: &self.scale[first..][..width],
                shift: &self.shift[first..][..width],
                relu: self.relu,
            };
            let (s, sx) = (&mut s[..width], &mut sx[..width]);
            for &at in xs {
                let begin = at as usize * channels + first;
                let (x, d) = (&x[begin..][..width], &mut d[begin..][..width]);
                for c in 0..width {
                    let (normal, value) = line.normal(c, x[c]);
                    d[c] = if line.relu && value <= 0.0 { 0.0 } else { d[c] };
                    s[c] += d[c];
                    sx[c] += d[c] * normal;
                }
            }
            for c in 0..width {
                sum_d[first + c] = f64::from(s[c]);
                sum_dx[first + c] = f64::from(sx[c]);
            }
        }
    }

    /// `d = (γ d − first − x̂ second) / σ`.
    #[inline(always)]
    fn backward<S: Simd>(&self, _: S, xs: &[u32], x: &[f32], d: &mut [f32], [first, second]: [&[f32]; 2]) {
        let channels = first.len();
        let (line, second) = (self.cut(channels), &second[..channels]);
        for &at in xs {
            let range = at as usize * channels..(at as usize + 1) * channels;
            let (x, d) = (&x[range.clone()], &mut d[range]);
            for c in 0..channels {
                let (normal, _) = line.normal(c, x[c]);
                d[c] = (line.scale[c] * d[c] - first[c] - normal * second[c]) * line.inverse[c];
            }
        }
    }

    /// The same values as slices of length `channels`, so that loops over channels run without bounds checks.
    #[inline(always)]
    fn cut(&self, channels: usize) -> Self {
        Self {
            mean: &self.mean[..channels],
            inverse: &self.inverse[..channels],
            scale: &self.scale[..channels],
            shift: &self.shift[..channels],
            relu: self.relu,
        }
    }
}
