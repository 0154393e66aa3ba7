//! Runs the kernels of [`crate::window`] over an image in bands of rows: forward and, on request, backward in one sweep.
//!
//! Each input row is filtered horizontally into a ring buffer of eleven rows. A full ring gives one row of scores and
//! cotangents. Those are blurred horizontally into a second ring, which gives one row of the gradient. No buffer has the
//! size of the image. Bands overlap by the radius of the window and depend on the height of the image alone, so the result
//! does not depend on the number of threads.

use std::sync::Mutex;

use fearless_simd::{Level, Simd, dispatch};
use gs_core::Image;
use rayon::prelude::*;

use crate::window::{self, Consts, Fields, LANES, Maps, RADIUS, Rows, TAPS};

/// Rows of a band before rounding. More rows recompute fewer overlaps; fewer rows balance the threads better.
const BAND_ROWS: usize = 64;
/// Accumulators of the scores of a row: divisible by 1, 2, 3 and 4 channels, so each lane belongs to one channel.
const SUM_LANES: usize = 48;
/// Fields in the first ring: mean and variance of `s` and of `d`.
const FIELDS: usize = 4;
/// Fields in the second ring: the cotangents `u`, `v_s`, `v_d`.
const BACK_FIELDS: usize = 3;

/// Which factor of SSIM is averaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Term {
    /// SSIM: luminance times contrast and structure.
    Full,
    /// Contrast and structure only (the upper levels of MS-SSIM).
    Contrast,
}

/// Constants, factor and border of one sweep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Task {
    /// Window weights and SSIM constants.
    pub consts: Consts,
    /// Factor of SSIM that is averaged.
    pub term: Term,
    /// Pixels on each side that are not scored: 0 with zero padding, [`RADIUS`] for the valid area.
    pub margin: usize,
}

/// Row buffers kept between sweeps, so that a training step does not allocate.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    pool: Mutex<Vec<Band>>,
    sums: Vec<[f64; 4]>,
}

impl Clone for Scratch {
    /// An empty scratch; buffers are not copied.
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// Buffers of one band.
#[derive(Debug, Default)]
struct Band {
    /// Padded rows of `s` and `d`.
    s: Vec<f32>,
    d: Vec<f32>,
    /// `[FIELDS][TAPS][stride]` and `[BACK_FIELDS][TAPS][stride]`.
    ring: Vec<f32>,
    back: Vec<f32>,
    /// Padded rows of the cotangents.
    maps: [Vec<f32>; BACK_FIELDS],
    /// A row of scores, then of the gradient.
    row: Vec<f32>,
}

/// Mean of `1 − term` over the scored pixels, per channel. `grad` receives the gradient with respect to `a` of the sum of the
/// **terms**, times `consts.scale`.
pub(crate) fn run(task: &Task, a: &Image, b: &Image, grad: Option<&mut [f32]>, scratch: &mut Scratch) -> [f64; 4] {
    let bands = 4 * a.height.div_ceil(4 * BAND_ROWS);
    let rows = a.height.div_ceil(bands);
    let row_len = a.width * a.channels;
    let (pool, sums) = (&scratch.pool, &mut scratch.sums);
    sums.clear();
    sums.resize(a.height.div_ceil(rows), [0.0; 4]);
    let one = |index: usize, sum: &mut [f64; 4], out: Option<&mut [f32]>| {
        let mut band = pool.lock().ok().and_then(|mut p| p.pop()).unwrap_or_default();
        let range = (index * rows)..((index + 1) * rows).min(a.height);
        *sum = dispatch!(Level::new(), simd => band_pass(simd, task, a, b, range, out, &mut band));
        if let Ok(mut p) = pool.lock() {
            p.push(band);
        }
    };
    match grad {
        Some(grad) => {
            let work = sums.par_iter_mut().zip(grad.par_chunks_mut(rows * row_len)).enumerate();
            work.with_max_len(1).for_each(|(i, (sum, out))| one(i, sum, Some(out)));
        }
        None => sums.par_iter_mut().enumerate().with_max_len(1).for_each(|(i, sum)| one(i, sum, None)),
    }
    let pixels = ((a.width - 2 * task.margin) * (a.height - 2 * task.margin)) as f64;
    let mut total = [0.0f64; 4];
    for sum in sums.iter() {
        total.iter_mut().zip(sum).for_each(|(t, s)| *t += s);
    }
    total.map(|t| t / pixels)
}

/// Sums of `1 − term` per channel over the rows `range`, and those rows of the gradient.
#[inline(always)]
fn band_pass<S: Simd>(
    simd: S,
    task: &Task,
    a: &Image,
    b: &Image,
    range: std::ops::Range<usize>,
    mut grad: Option<&mut [f32]>,
    band: &mut Band,
) -> [f64; 4] {
    let (n, reach) = (a.width * a.channels, RADIUS as isize);
    band.resize(n, a.channels);
    let mut lanes = [0.0f64; SUM_LANES];
    let halo = if grad.is_some() { reach } else { 0 };
    let (first, last) = (range.start as isize, range.end as isize);
    for r in first - halo - reach..last + halo + reach {
        band.filter_row(simd, task, a, b, r);
        let p = r - reach;
        if p < first - halo {
            continue;
        }
        let inside = p >= task.margin as isize && p < (a.height - task.margin) as isize;
        if inside {
            band.score(simd, task, a, p, grad.is_some());
            if (first..last).contains(&p) {
                add_scores(&band.row[task.margin * a.channels..n - task.margin * a.channels], &mut lanes);
            }
        }
        let Some(grad) = &mut grad else { continue };
        band.blur_maps(simd, task, a.channels, p, inside);
        let q = p - reach;
        if q >= first {
            let at = (q - first) as usize * n;
            band.gradient(simd, task, a, b, q, &mut grad[at..at + n]);
        }
    }
    let mut sums = [0.0; 4];
    lanes.iter().enumerate().for_each(|(k, v)| sums[k % a.channels] += v);
    sums
}

/// Adds the scores of a row to the lanes, value `i` to lane `i mod SUM_LANES`.
#[inline(always)]
fn add_scores(row: &[f32], lanes: &mut [f64; SUM_LANES]) {
    let chunks = row.chunks_exact(SUM_LANES);
    let tail = chunks.remainder();
    for chunk in chunks {
        for k in 0..SUM_LANES {
            lanes[k] += f64::from(chunk[k]);
        }
    }
    lanes.iter_mut().zip(tail).for_each(|(l, v)| *l += f64::from(*v));
}

/// `s = a + b` and `d = a − b` of one row, written after `pad` zeros.
#[inline(always)]
fn sum_and_difference(a: &[f32], b: &[f32], pad: usize, s: &mut [f32], d: &mut [f32]) {
    let n = a.len();
    let (s, d) = (&mut s[pad..pad + n], &mut d[pad..pad + n]);
    for i in 0..n {
        s[i] = a[i] + b[i];
        d[i] = a[i] - b[i];
    }
}

/// Index in a ring of image row `r`.
#[inline(always)]
fn slot(r: isize) -> usize {
    r.rem_euclid(TAPS as isize) as usize
}

/// The eleven rows of field `f` around row `p`.
#[inline(always)]
fn rows_of(ring: &[f32], f: usize, p: isize, stride: usize) -> Rows<'_> {
    std::array::from_fn(|k| {
        let at = (f * TAPS + slot(p - RADIUS as isize + k as isize)) * stride;
        &ring[at..at + stride]
    })
}

impl Band {
    /// Resizes all buffers for rows of `n` values; all padding is zero.
    fn resize(&mut self, n: usize, channels: usize) {
        let stride = n.next_multiple_of(LANES);
        let padded = stride + 2 * RADIUS * channels;
        for row in [&mut self.s, &mut self.d].into_iter().chain(&mut self.maps) {
            row.clear();
            row.resize(padded, 0.0);
        }
        self.ring.resize(FIELDS * TAPS * stride, 0.0);
        self.back.resize(BACK_FIELDS * TAPS * stride, 0.0);
        self.row.resize(stride, 0.0);
    }

    /// Filters input row `r` horizontally into the first ring; rows outside the image are zero.
    #[inline(always)]
    fn filter_row<S: Simd>(&mut self, simd: S, task: &Task, a: &Image, b: &Image, r: isize) {
        let (n, stride) = (a.width * a.channels, self.row.len());
        let field = |f: usize| (f * TAPS + slot(r)) * stride;
        if r < 0 || r >= a.height as isize {
            (0..FIELDS).for_each(|f| self.ring[field(f)..field(f) + stride].fill(0.0));
            return;
        }
        let at = r as usize * n;
        sum_and_difference(&a.data[at..at + n], &b.data[at..at + n], RADIUS * a.channels, &mut self.s, &mut self.d);
        for (f, z) in [(0, &self.s), (2, &self.d)] {
            let (low, high) = self.ring.split_at_mut(field(f + 1));
            let (mean, var) = (&mut low[field(f)..field(f) + stride], &mut high[..stride]);
            window::horizontal_moments(simd, &task.consts.g, a.channels, z, mean, var);
        }
    }

    /// Scores of row `p` into `row` and their cotangents into `maps`, which are zero outside the scored pixels.
    #[inline(always)]
    fn score<S: Simd>(&mut self, simd: S, task: &Task, a: &Image, p: isize, with_maps: bool) {
        let stride = self.row.len();
        let [mean_s, var_s, mean_d, var_d] = std::array::from_fn(|f| rows_of(&self.ring, f, p, stride));
        let fields = Fields { mean_s, var_s, mean_d, var_d };
        let pad = RADIUS * a.channels;
        let [u, v_s, v_d] = &mut self.maps;
        let inner = pad..pad + stride;
        let maps = with_maps.then(|| Maps {
            u: &mut u[inner.clone()],
            v_s: &mut v_s[inner.clone()],
            v_d: &mut v_d[inner.clone()],
        });
        match task.term {
            Term::Full => window::score_row::<S, true>(simd, &task.consts, &fields, &mut self.row, maps),
            Term::Contrast => window::score_row::<S, false>(simd, &task.consts, &fields, &mut self.row, maps),
        }
        if with_maps {
            let (n, margin) = (a.width * a.channels, task.margin * a.channels);
            for map in &mut self.maps {
                map[..pad + margin].fill(0.0);
                map[pad + n - margin..].fill(0.0);
            }
        }
    }

    /// Blurs the cotangents of row `p` into the second ring; rows that are not scored have zeros.
    #[inline(always)]
    fn blur_maps<S: Simd>(&mut self, simd: S, task: &Task, channels: usize, p: isize, inside: bool) {
        let stride = self.row.len();
        for (f, map) in self.maps.iter().enumerate() {
            let at = (f * TAPS + slot(p)) * stride;
            let out = &mut self.back[at..at + stride];
            if inside {
                window::blur_row(simd, &task.consts.g, channels, map, out);
            } else {
                out.fill(0.0);
            }
        }
    }

    /// Row `q` of the gradient, into `out`.
    #[inline(always)]
    fn gradient<S: Simd>(&mut self, simd: S, task: &Task, a: &Image, b: &Image, q: isize, out: &mut [f32]) {
        let (n, stride, pad) = (a.width * a.channels, self.row.len(), RADIUS * a.channels);
        let at = q as usize * n;
        sum_and_difference(&a.data[at..at + n], &b.data[at..at + n], pad, &mut self.s, &mut self.d);
        let [u, v_s, v_d] = std::array::from_fn(|f| rows_of(&self.back, f, q, stride));
        let blurred = [&u, &v_s, &v_d];
        window::gradient_row(simd, &task.consts, blurred, &self.s[pad..], &self.d[pad..], &mut self.row);
        out.copy_from_slice(&self.row[..n]);
    }
}
