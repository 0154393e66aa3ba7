//! Layers of maps without parameters: max pooling, bilinear upsampling, concatenation, addition, ReLU; with gradients.
//!
//! Results are written at the given sites, other pixels keep their content; inputs are read everywhere.
//!
//! ```
//! use gs_core::nn::{Map, Sites, resample};
//!
//! let (mut x, mut y) = (Map::zeros(2, 2, 1, 0), Map::zeros(1, 1, 1, 0));
//! x.load(&[1.0, 4.0, 2.0, 3.0]);
//! resample::max_pool(&x, &mut y, &Sites::full(1, 1));
//! assert_eq!(y.pixel(0, 0), [4.0]);
//! ```

use super::gemm::Write;
use super::map::{Map, Sites};
use rayon::prelude::*;

/// Calls `f(y, x, pixel)` on every site of `out`, in parallel over rows.
fn at_sites(out: &mut Map, sites: &Sites, f: impl Fn(usize, usize, &mut [f32]) + Sync) {
    assert_eq!((sites.height(), sites.width()), (out.height(), out.width()), "sites of another map");
    let (channels, left) = (out.channels(), out.border() * out.channels());
    out.par_rows_mut(1).enumerate().for_each(|(y, row)| {
        for &x in sites.row(y) {
            f(y, x as usize, &mut row[left + x as usize * channels..][..channels]);
        }
    });
}

/// Replaces or adds, channel by channel: `out = value` or `out += value`.
fn put(out: &mut [f32], write: Write, value: impl Iterator<Item = f32>) {
    match write {
        Write::Set => out.iter_mut().zip(value).for_each(|(o, v)| *o = v),
        Write::Add => out.iter_mut().zip(value).for_each(|(o, v)| *o += v),
    }
}

/// 2 × 2 max pooling of each channel; `y` has half the height and width of `x`.
///
/// # Panics
/// If shapes do not fit.
pub fn max_pool(x: &Map, y: &mut Map, sites: &Sites) {
    assert_eq!(
        [x.height(), x.width(), x.channels()],
        [2 * y.height(), 2 * y.width(), y.channels()],
        "shape of the pooled map"
    );
    at_sites(y, sites, |y, at, out| {
        out.copy_from_slice(x.pixel(2 * y, 2 * at));
        for [dy, dx] in [[0, 1], [1, 0], [1, 1]] {
            out.iter_mut().zip(x.pixel(2 * y + dy, 2 * at + dx)).for_each(|(o, v)| *o = o.max(*v));
        }
    });
}

/// Backward of [`max_pool`] at `sites` of `dx`, replacing or adding. Among equal maxima the first in row-major order gets
/// the gradient. `y` is the result of the forward pass, `dy` its cotangent.
///
/// # Panics
/// If shapes do not fit.
pub fn max_pool_backward(x: &Map, y: &Map, dy: &Map, dx: &mut Map, sites: &Sites, write: Write) {
    assert_eq!(
        [x.height(), x.width(), x.channels()],
        [2 * y.height(), 2 * y.width(), y.channels()],
        "shape of the pooled map"
    );
    at_sites(dx, sites, |row, at, out| {
        let (big, d) = (y.pixel(row / 2, at / 2), dy.pixel(row / 2, at / 2));
        let earlier = &[[0, 0], [0, 1], [1, 0]][..row % 2 * 2 + at % 2];
        let own = x.pixel(row, at);
        let first = |c: usize| earlier.iter().all(|e| x.pixel(row / 2 * 2 + e[0], at / 2 * 2 + e[1])[c] != big[c]);
        put(out, write, (0..own.len()).map(|c| if own[c] == big[c] && first(c) { d[c] } else { 0.0 }));
    });
}

/// Upsampling by 2, bilinear with half-pixel centres, clamped at the edges: `y[2i] = ¼ x[i−1] + ¾ x[i]`,
/// `y[2i+1] = ¾ x[i] + ¼ x[i+1]` on either axis.
///
/// # Panics
/// If shapes do not fit.
pub fn upsample(x: &Map, y: &mut Map, sites: &Sites) {
    assert_eq!(
        [y.height(), y.width(), y.channels()],
        [2 * x.height(), 2 * x.width(), x.channels()],
        "shape of the upsampled map"
    );
    at_sites(y, sites, |row, at, out| {
        let ([near_y, far_y], [near_x, far_x]) = (sources(row, x.height()), sources(at, x.width()));
        let pixels = [x.pixel(near_y, near_x), x.pixel(near_y, far_x), x.pixel(far_y, near_x), x.pixel(far_y, far_x)];
        let [a, b, c, d] = pixels.map(|p| &p[..out.len()]);
        for (i, out) in out.iter_mut().enumerate() {
            *out = 0.5625 * a[i] + 0.1875 * (b[i] + c[i]) + 0.0625 * d[i];
        }
    });
}

/// The input pixels of weight ¾ and ¼ of output pixel `at`.
fn sources(at: usize, size: usize) -> [usize; 2] {
    let near = at / 2;
    let far = if at.is_multiple_of(2) { near.saturating_sub(1) } else { (near + 1).min(size - 1) };
    [near, far]
}

/// Backward of [`upsample`] at `sites` of `dx`, replacing or adding. `dy` must be zero where no output was computed.
///
/// # Panics
/// If shapes do not fit.
pub fn upsample_backward(dy: &Map, dx: &mut Map, sites: &Sites, write: Write) {
    assert_eq!(
        [dy.height(), dy.width(), dy.channels()],
        [2 * dx.height(), 2 * dx.width(), dx.channels()],
        "shape of the upsampled map"
    );
    let (height, width) = (dx.height(), dx.width());
    at_sites(dx, sites, |row, at, out| {
        if write == Write::Set {
            out.fill(0.0);
        }
        for (y, wy) in targets(row, height) {
            for (x, wx) in targets(at, width) {
                let weight = wy * wx;
                out.iter_mut().zip(dy.pixel(y, x)).for_each(|(o, v)| *o += weight * v);
            }
        }
    });
}

/// The output pixels that read input pixel `at` of `size`, with their weights.
fn targets(at: usize, size: usize) -> impl Iterator<Item = (usize, f32)> {
    // At an edge the pixel itself takes the weight of the missing neighbour.
    let low = if at == 0 { (0, 1.0) } else { (2 * at, 0.75) };
    let high = if at + 1 == size { (2 * at + 1, 1.0) } else { (2 * at + 1, 0.75) };
    let before = (at > 0).then(|| (2 * at - 1, 0.25));
    let after = (at + 1 < size).then_some((2 * at + 2, 0.25));
    before.into_iter().chain([low, high]).chain(after)
}

/// Concatenation of channels, `y = [a, b]`.
///
/// # Panics
/// If shapes do not fit.
pub fn concat(a: &Map, b: &Map, y: &mut Map, sites: &Sites) {
    assert_eq!([a.height(), a.width()], [b.height(), b.width()], "concatenated maps");
    assert_eq!(a.channels() + b.channels(), y.channels(), "concatenated channels");
    at_sites(y, sites, |y, x, out| {
        let (left, right) = out.split_at_mut(a.channels());
        left.copy_from_slice(a.pixel(y, x));
        right.copy_from_slice(b.pixel(y, x));
    });
}

/// Backward of [`concat()`] for the part that begins at channel `first`, at `sites`, replacing or adding.
///
/// # Panics
/// If shapes do not fit.
pub fn concat_backward(dy: &Map, first: usize, part: &mut Map, sites: &Sites, write: Write) {
    at_sites(part, sites, |y, x, out| {
        let d = &dy.pixel(y, x)[first..][..out.len()];
        put(out, write, d.iter().copied());
    });
}

/// Residual addition followed by ReLU, `y = max(a + b, 0)`.
///
/// # Panics
/// If shapes differ.
pub fn add_relu(a: &Map, b: &Map, y: &mut Map, sites: &Sites) {
    at_sites(y, sites, |y, x, out| {
        let sum = a.pixel(y, x).iter().zip(b.pixel(y, x)).map(|(a, b)| (a + b).max(0.0));
        put(out, Write::Set, sum);
    });
}

/// ReLU in place, `y = max(y, 0)`, at `sites`.
pub fn relu_map(y: &mut Map, sites: &Sites) {
    at_sites(y, sites, |_, _, out| out.iter_mut().for_each(|v| *v = v.max(0.0)));
}

/// Backward of [`relu_map`] and [`add_relu`] in place, from their **output**: `d = 0` where `y = 0`.
///
/// # Panics
/// If shapes differ.
pub fn relu_map_backward(y: &Map, d: &mut Map, sites: &Sites) {
    at_sites(d, sites, |row, x, d| {
        d.iter_mut().zip(y.pixel(row, x)).for_each(|(d, y)| *d = if *y > 0.0 { *d } else { 0.0 });
    });
}

/// Copies (`to = from`) or adds (`to += from`) at `sites`.
///
/// # Panics
/// If shapes differ.
pub fn copy(from: &Map, to: &mut Map, sites: &Sites, write: Write) {
    at_sites(to, sites, |y, x, out| put(out, write, from.pixel(y, x).iter().copied()));
}
