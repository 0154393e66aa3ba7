//! The gather loop of every convolution: at each output pixel the sum over the taps of a kernel, input pixel times matrix.
//!
//! ```text
//! out[q, o] = start + Σ_taps Σ_i in[base(q) + tap, i] · M_tap[i, o]
//! ```
//! A convolution, its input gradient and a transposed convolution differ only in the [`Plan`]: the steps of pixels, and
//! the taps of each phase of the output grid. There is no im2col: a block of pixels times a block of outputs stays in
//! registers during the loop over the taps' input rows, which are in the cache; matrices are packed once per call in the
//! order they are read.
//!
//! The order of every sum is taps, then inputs, for each output alone. It depends neither on threads nor on which other
//! pixels are sites, so a pixel gets the same bits in any set of sites.

use super::gemm::Write;
use super::map::{Map, Sites};
use fearless_simd::{Level, Simd, SimdBase, SimdFloat, dispatch, f32x16};
use rayon::prelude::*;
use std::cell::Cell;

/// Lanes of a vector of outputs.
const LANES: usize = 16;
/// Rows of a packed matrix used before the next block of pixels: about 128 KiB at 64 outputs.
const DEPTH: usize = 512;
/// Largest number of pixels in a parallel piece.
const MAX_PIECE: usize = 512;
/// Smallest number of pixels in a piece; smaller maps are not split, as every piece reads all matrices.
const MIN_PIECE: usize = 128;

/// One step from the base pixel of the input, and the matrix that belongs to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Tap {
    /// Step in pixel rows, downwards.
    pub(super) y: isize,
    /// Step in columns, to the right.
    pub(super) x: isize,
    /// Index of the tap's matrix.
    pub(super) matrix: usize,
}

/// The taps of the output pixels with `y ≡ self.y`, `x ≡ self.x` modulo the output step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Phase {
    pub(super) y: usize,
    pub(super) x: usize,
    pub(super) taps: Vec<Tap>,
}

/// How output pixels find their inputs: the base of output `(y, x)` is `(y / out_step, x / out_step) · in_step`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Plan {
    pub(super) in_step: usize,
    pub(super) out_step: usize,
    pub(super) phases: Vec<Phase>,
}

impl Plan {
    /// `kernel × kernel` taps around `stride · q`, with zero padding of `pad`.
    pub(super) fn forward(kernel: usize, stride: usize, pad: usize) -> Self {
        let step = |k: usize| k as isize - pad as isize;
        let taps = (0..kernel * kernel)
            .map(|matrix| Tap { y: step(matrix / kernel), x: step(matrix % kernel), matrix })
            .collect();
        Self { in_step: stride, out_step: 1, phases: vec![Phase { y: 0, x: 0, taps }] }
    }

    /// The adjoint of [`Plan::forward`]: output `p` collects every `q` and tap `k` with `stride · q + k − pad = p`.
    pub(super) fn adjoint(kernel: usize, stride: usize, pad: usize) -> Self {
        let step = |phase: usize, k: usize| {
            let (whole, stride) = ((phase + pad) as isize - k as isize, stride as isize);
            (whole.rem_euclid(stride) == 0).then_some(whole / stride)
        };
        let phase = |index: usize| {
            let (y, x) = (index / stride, index % stride);
            let taps = (0..kernel * kernel).filter_map(|matrix| {
                let (ty, tx) = (step(y, matrix / kernel)?, step(x, matrix % kernel)?);
                Some(Tap { y: ty, x: tx, matrix })
            });
            Phase { y, x, taps: taps.collect() }
        };
        Self { in_step: 1, out_step: stride, phases: (0..stride * stride).map(phase).collect() }
    }
}

/// Matrices `[inputs, outputs]`, one per tap; element `(i, o)` of matrix `m` is
/// `data[m · inputs · outputs + i · row + o · column]`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Matrices<'a> {
    pub(super) data: &'a [f32],
    pub(super) inputs: usize,
    pub(super) outputs: usize,
    pub(super) row: usize,
    pub(super) column: usize,
}

/// Initial value of the sum of an output.
#[derive(Clone, Copy, Debug)]
pub(super) enum Start<'a> {
    /// The sum starts at zero.
    Zero,
    /// The sum starts at one value per output channel.
    Bias(&'a [f32]),
    /// The sum starts at the content of the output.
    Content,
}

impl From<Write> for Start<'_> {
    fn from(write: Write) -> Self {
        match write {
            Write::Set => Self::Zero,
            Write::Add => Self::Content,
        }
    }
}

thread_local! {
    /// Packed matrices, kept between calls. Taken out while in use; a nested call allocates a buffer of its own.
    static PANELS: Cell<Vec<f32>> = const { Cell::new(Vec::new()) };
    /// Offsets of the pixels of a piece.
    static PIXELS: Cell<Vec<[usize; 2]>> = const { Cell::new(Vec::new()) };
}

/// Calls `f` with this thread's buffer of packed matrices.
pub(super) fn with_panels<R>(f: impl FnOnce(&mut Vec<f32>) -> R) -> R {
    let mut panels = PANELS.take();
    let result = f(&mut panels);
    PANELS.set(panels);
    result
}

/// Calls `f` with this thread's list of pixels, emptied.
pub(super) fn with_pixels<R>(f: impl FnOnce(&mut Vec<[usize; 2]>) -> R) -> R {
    let mut pixels = PIXELS.take();
    pixels.clear();
    let result = f(&mut pixels);
    PIXELS.set(pixels);
    result
}

/// Blocks of outputs that fit in registers with a block of pixels, as `(first output, vectors)`.
#[inline(always)]
fn blocks(level: Level, outputs: usize) -> impl Iterator<Item = (usize, usize)> {
    let widest = if is_wide(level) { 4 } else { 1 };
    let vectors = outputs.div_ceil(LANES);
    (0..vectors).step_by(widest).map(move |v| (v * LANES, widest.min(vectors - v)))
}

/// Whether registers hold 16 lanes (AVX-512, which has 32 of them).
#[inline(always)]
pub(super) fn is_wide(level: Level) -> bool {
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    return level.as_avx512().is_some();
    #[cfg(not(any(target_arch = "x86", target_arch = "x86_64")))]
    return false;
}

/// Packs the matrices as `[block of outputs][matrix][input][16 · vectors]`, zeros beyond the last output.
fn pack(matrices: &Matrices<'_>, count: usize, panels: &mut Vec<f32>) {
    let Matrices { data, inputs, outputs, row, column } = *matrices;
    let padded = outputs.div_ceil(LANES) * LANES;
    panels.resize(count * inputs * padded, 0.0);
    let mut rest = panels.as_mut_slice();
    for (first, vectors) in blocks(Level::new(), outputs) {
        let (width, live) = (vectors * LANES, (outputs - first).min(vectors * LANES));
        let (panel, tail) = rest.split_at_mut(count * inputs * width);
        rest = tail;
        panel.par_chunks_mut((inputs * width).max(1)).enumerate().for_each(|(m, panel)| {
            let from = &data[m * inputs * outputs..][..inputs * outputs];
            for (i, line) in panel.chunks_exact_mut(width).enumerate() {
                line[live..].fill(0.0);
                let at = i * row + first * column;
                if column == 1 {
                    line[..live].copy_from_slice(&from[at..at + live]);
                } else {
                    line[..live].iter_mut().enumerate().for_each(|(o, v)| *v = from[at + o * column]);
                }
            }
        });
    }
}

/// Fills the sites of `out` by `plan`.
///
/// # Panics
/// If shapes do not fit or a tap reads beyond the border of `input`.
pub(super) fn gather(
    plan: &Plan,
    matrices: &Matrices<'_>,
    start: Start<'_>,
    input: &Map,
    out: &mut Map,
    sites: &Sites,
) {
    assert_eq!((input.channels(), out.channels()), (matrices.inputs, matrices.outputs), "channels of a convolution");
    assert_eq!((sites.height(), sites.width()), (out.height(), out.width()), "sites of another map");
    check_border(plan, input, out);
    let count = matrices.data.len() / (matrices.inputs * matrices.outputs).max(1);
    let rows = sites.rows_for((sites.len() / 8).clamp(MIN_PIECE, MAX_PIECE)).next_multiple_of(plan.out_step);
    with_panels(|panels| {
        pack(matrices, count, panels);
        let (stride, left, channels) = (out.row_stride(), out.border() * out.channels(), out.channels());
        out.par_rows_mut(rows).enumerate().for_each(|(piece, out)| {
            let first = piece * rows;
            let rows = first..(first + rows).min(sites.height());
            for phase in &plan.phases {
                with_pixels(|pixels| {
                    for y in rows.clone().filter(|y| y % plan.out_step == phase.y) {
                        let from = (y / plan.out_step * plan.in_step, (y - first) * stride + left);
                        let of_phase =
                            sites.row(y).iter().map(|&x| x as usize).filter(|x| x % plan.out_step == phase.x);
                        pixels.extend(
                            of_phase.map(|x| {
                                [input.offset(from.0, x / plan.out_step * plan.in_step), from.1 + x * channels]
                            }),
                        );
                    }
                    if !pixels.is_empty() {
                        let piece = Piece { input, panels, count, inputs: matrices.inputs, start, pixels, channels };
                        dispatch!(Level::new(), simd => piece.run(simd, &phase.taps, out));
                    }
                });
            }
        });
    });
}

/// Asserts that every tap of every base pixel lies inside the stored input.
fn check_border(plan: &Plan, input: &Map, out: &Map) {
    let border = input.border() as isize;
    for tap in plan.phases.iter().flat_map(|p| &p.taps) {
        for (step, extent, size) in [(tap.y, out.height(), input.height()), (tap.x, out.width(), input.width())] {
            let last = extent.div_ceil(plan.out_step).saturating_sub(1) * plan.in_step;
            let fits = step >= -border && last as isize + step < size as isize + border;
            assert!(fits, "a border of {border} is too narrow for a tap at {step} of a map of {size} pixels");
        }
    }
}

/// The pixels of one piece and one phase.
struct Piece<'a> {
    input: &'a Map,
    panels: &'a [f32],
    /// Number of matrices in a panel.
    count: usize,
    inputs: usize,
    start: Start<'a>,
    /// Offsets in the input, and in the piece of the output.
    pixels: &'a [[usize; 2]],
    /// Number of channels of the output.
    channels: usize,
}

/// Consecutive rows of one tap's packed matrix, and the offset of their input values.
#[derive(Clone, Copy)]
struct Span<'a> {
    /// Offset from the first value of the base pixel.
    step: isize,
    panel: &'a [f32],
}

impl Piece<'_> {
    #[inline(always)]
    fn run<S: Simd>(&self, simd: S, taps: &[Tap], out: &mut [f32]) {
        let mut panel = self.panels;
        for (first, vectors) in blocks(simd.level(), self.channels) {
            let (own, rest) = panel.split_at(self.count * self.inputs * vectors * LANES);
            panel = rest;
            match vectors {
                4 => self.outputs::<S, 6, 4>(simd, taps, own, first, out),
                3 => self.outputs::<S, 8, 3>(simd, taps, own, first, out),
                2 => self.outputs::<S, 12, 2>(simd, taps, own, first, out),
                _ if is_wide(simd.level()) => self.outputs::<S, 14, 1>(simd, taps, own, first, out),
                _ => self.outputs::<S, 6, 1>(simd, taps, own, first, out),
            }
        }
    }

    /// The outputs `first..first + 16 V` of all pixels, [`DEPTH`] rows of the matrices at a time.
    #[inline(always)]
    fn outputs<S: Simd, const P: usize, const V: usize>(
        &self,
        simd: S,
        taps: &[Tap],
        panel: &[f32],
        first: usize,
        out: &mut [f32],
    ) {
        let stride = self.input.row_stride() as isize;
        let width = V * LANES;
        let depth = self.inputs.clamp(1, DEPTH / 2);
        let max_spans = (DEPTH / depth).max(1);
        let mut start = self.start;
        let mut spans = [Span { step: 0, panel: &[] }; DEPTH];
        let mut held = 0;
        let pieces = self.inputs.div_ceil(depth);
        let all = taps.len() * pieces;
        for k in 0..all {
            let (tap, from) = (taps[k / pieces], k % pieces * depth);
            let rows = depth.min(self.inputs - from);
            let step = tap.y * stride + tap.x * self.input.channels() as isize + from as isize;
            spans[held] = Span { step, panel: &panel[(tap.matrix * self.inputs + from) * width..][..rows * width] };
            held += 1;
            if held == max_spans.min(DEPTH) || k + 1 == all {
                self.pass::<S, P, V>(simd, &spans[..held], start, first, out);
                (held, start) = (0, Start::Content);
            }
        }
        if all == 0 {
            self.pass::<S, P, V>(simd, &[], start, first, out);
        }
    }

    /// Adds the spans to all pixels, `P` at a time.
    #[inline(always)]
    fn pass<S: Simd, const P: usize, const V: usize>(
        &self,
        simd: S,
        spans: &[Span<'_>],
        start: Start<'_>,
        first: usize,
        out: &mut [f32],
    ) {
        for pixels in self.pixels.chunks(P) {
            // The last block repeats its last pixel; only the first `pixels.len()` are written.
            let at: [[usize; 2]; P] = std::array::from_fn(|p| pixels[p.min(pixels.len() - 1)]);
            let live = (self.channels - first).min(V * LANES);
            let mut sum: [[f32x16<S>; V]; P] = match start {
                Start::Zero => [[f32x16::splat(simd, 0.0); V]; P],
                Start::Bias(bias) => [load(simd, &bias[first..first + live]); P],
                Start::Content => std::array::from_fn(|p| load(simd, &out[at[p][1] + first..][..live])),
            };
            for span in spans {
                add_span(simd, self.input.data(), &at, *span, &mut sum);
            }
            for (sum, at) in sum.iter().zip(&at).take(pixels.len()) {
                store(sum, &mut out[at[1] + first..][..live]);
            }
        }
    }
}

/// `sum[p][v] += in[p][i] · panel[i][v]`, `i` in order.
#[inline(always)]
fn add_span<S: Simd, const P: usize, const V: usize>(
    simd: S,
    input: &[f32],
    at: &[[usize; 2]; P],
    span: Span<'_>,
    sum: &mut [[f32x16<S>; V]; P],
) {
    let rows = span.panel.len() / (V * LANES);
    let inputs: [&[f32]; P] = std::array::from_fn(|p| &input[at[p][0].wrapping_add_signed(span.step)..][..rows]);
    let mut held = *sum;
    for (i, line) in span.panel.chunks_exact(V * LANES).enumerate().take(rows) {
        let line: [f32x16<S>; V] = std::array::from_fn(|v| f32x16::from_slice(simd, &line[v * LANES..][..LANES]));
        for (held, input) in held.iter_mut().zip(&inputs) {
            let value = f32x16::splat(simd, input[i]);
            for (held, line) in held.iter_mut().zip(&line) {
                *held = value.mul_add(*line, *held);
            }
        }
    }
    *sum = held;
}

/// `V` vectors from up to `16 V` values, zeros beyond them.
#[inline(always)]
pub(super) fn load<S: Simd, const V: usize>(simd: S, from: &[f32]) -> [f32x16<S>; V] {
    std::array::from_fn(|v| match from.get(v * LANES..(v + 1) * LANES) {
        Some(whole) => f32x16::from_slice(simd, whole),
        None => {
            let mut padded = [0.0; LANES];
            let rest = from.get(v * LANES..).unwrap_or_default();
            padded[..rest.len()].copy_from_slice(rest);
            f32x16::from_slice(simd, &padded)
        }
    })
}

/// Inverse of [`load`]: writes up to `16 V` values.
#[inline(always)]
pub(super) fn store<S: Simd, const V: usize>(from: &[f32x16<S>; V], to: &mut [f32]) {
    for (to, from) in to.chunks_mut(LANES).zip(from) {
        if to.len() == LANES {
            from.store_slice(to);
        } else {
            let mut padded = [0.0; LANES];
            from.store_slice(&mut padded);
            to.copy_from_slice(&padded[..to.len()]);
        }
    }
}
