//! Convolution of feature maps and its transpose, with gradients.
//!
//! ```text
//! y[q, o] = b[o] + Σ_{k,i} x[s q + k − p, i] W[k, i, o]        W: [kernel, kernel, inputs, outputs]
//! dx[s q + k − p, i] += Σ_o W[k, i, o] dy[q, o]
//! dW[k, i, o] = Σ_q x[s q + k − p, i] dy[q, o]                 db[o] = Σ_q dy[q, o]
//! ```
//! with stride `s` and zero padding `p = ⌊kernel / 2⌋`. A transposed convolution of kernel and stride 2
//! ([`ConvTranspose`]) is the second line with `p = 0`: its forward is the input gradient of a convolution, its input
//! gradient the forward of one.
//!
//! Values and input gradients are computed at the given sites of the result; its other pixels keep their content. Inputs
//! are read everywhere.
//!
//! ```
//! use gs_core::nn::{Conv, ConvSpec, Init, Map, Sites};
//!
//! let spec = ConvSpec { kernel: 3, stride: 1, inputs: 1, outputs: 1, bias: false };
//! let mut blur = Conv::new("blur", spec, Init::Zero, 0);
//! blur.weight.value = vec![1.0 / 9.0; 9];
//! let mut x = Map::zeros(3, 3, 1, blur.border());
//! x.load(&[0.0, 0.0, 0.0, 0.0, 9.0, 0.0, 0.0, 0.0, 0.0]);
//! let mut y = Map::zeros(3, 3, 1, 0);
//! blur.forward(&x, &mut y, &Sites::full(3, 3));
//! assert!(y.data().iter().all(|v| *v == 1.0));
//! ```

use super::CHUNKS;
use super::Init;
use super::dense::add_in_order;
use super::gather::{Matrices, Plan, Start, gather, is_wide, load, store, with_panels, with_pixels};
use super::gemm::Write;
use super::map::{Map, Sites};
use crate::{Param, Params, Rng};
use fearless_simd::{Level, Simd, SimdBase, SimdFloat, dispatch, f32x16};
use rayon::prelude::*;

/// Pixels summed before an addition to a weight gradient: their cotangents stay in the first-level cache.
const RUN: usize = 128;
/// Largest weight whose gradient is summed in parallel over pieces of the map, each with a copy of its own; larger ones
/// are parallel over their own rows.
const MAX_COPIED: usize = 1 << 18;
/// Rows of a large weight gradient in one parallel task.
const WEIGHT_ROWS: usize = 32;

/// A `kernel × kernel` convolution with zero padding that keeps the size (stride 1) or halves it (stride 2).
#[derive(Clone, Debug, PartialEq)]
pub struct Conv {
    /// Weight `W`, `[kernel, kernel, inputs, outputs]`, row-major.
    pub weight: Param,
    /// Bias `b`, `[outputs]`, if the layer has one.
    pub bias: Option<Param>,
    shape: Shape,
}

/// A transposed convolution of kernel 2 and stride 2 with bias: every pixel becomes 2 × 2.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvTranspose {
    /// Weight `W`, `[2, 2, outputs, inputs]`, row-major.
    pub weight: Param,
    /// Bias `b`, one value per output channel.
    pub bias: Param,
    /// Shape of the convolution whose transpose this is.
    shape: Shape,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Shape {
    kernel: usize,
    stride: usize,
    pad: usize,
    inputs: usize,
    outputs: usize,
}

impl Shape {
    fn weights(self) -> usize {
        self.kernel * self.kernel * self.inputs * self.outputs
    }

    /// Convolution at the sites of `y`: `y = x ∗ W`.
    fn apply(self, weight: &[f32], start: Start<'_>, x: &Map, y: &mut Map, sites: &Sites) {
        let Self { kernel, stride, pad, inputs, outputs } = self;
        let matrices = Matrices { data: weight, inputs, outputs, row: outputs, column: 1 };
        gather(&Plan::forward(kernel, stride, pad), &matrices, start, x, y, sites);
    }

    /// The transpose of [`Shape::apply`], at the sites of `x`.
    fn transpose(self, weight: &[f32], start: Start<'_>, y: &Map, x: &mut Map, sites: &Sites) {
        let Self { kernel, stride, pad, inputs, outputs } = self;
        let matrices = Matrices { data: weight, inputs: outputs, outputs: inputs, row: 1, column: outputs };
        gather(&Plan::adjoint(kernel, stride, pad), &matrices, start, y, x, sites);
    }
}

fn parameter(name: &str, what: &str, n: usize, init: Init, fans: [usize; 2], seed: u64) -> Param {
    let fan_in = 1.0 / (fans[0].max(1) as f32).sqrt();
    let bound = match init {
        Init::Zero => 0.0,
        Init::Xavier if what == "weight" => (6.0 / (fans[0] + fans[1]).max(1) as f32).sqrt(),
        Init::FanIn | Init::Xavier => fan_in,
    };
    let name = format!("{name}.{what}");
    let mut rng = Rng::new(seed, &name, 0, 0);
    let value = (0..n).map(|_| if bound > 0.0 { rng.range(-bound, bound) } else { 0.0 }).collect();
    Param::shared(name, value)
}

/// Shape of a convolution, for [`Conv::new`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConvSpec {
    /// Side of the kernel, odd: 1, 3 or 5.
    pub kernel: usize,
    /// Input pixels per output pixel and axis: 1 or 2.
    pub stride: usize,
    /// Number of channels of the input map.
    pub inputs: usize,
    /// Number of channels of the output map.
    pub outputs: usize,
    /// Whether a bias is added.
    pub bias: bool,
}

impl ConvSpec {
    /// Number of parameters of such a layer; the largest number where that is beyond it.
    pub fn count(&self) -> u64 {
        let taps = (self.kernel as u64).saturating_mul(self.kernel as u64);
        let weights = taps.saturating_mul(self.inputs as u64).saturating_mul(self.outputs as u64);
        weights.saturating_add(if self.bias { self.outputs as u64 } else { 0 })
    }
}

impl Conv {
    /// A layer whose parameters are `{name}.weight` and `{name}.bias`. The fan-in of its initialisation is
    /// `kernel² · inputs`.
    ///
    /// # Panics
    /// If the kernel is even or the stride zero.
    pub fn new(name: &str, spec: ConvSpec, init: Init, seed: u64) -> Self {
        let ConvSpec { kernel, stride, inputs, outputs, bias } = spec;
        assert!(kernel % 2 == 1 && stride > 0, "a convolution has an odd kernel and a stride");
        let shape = Shape { kernel, stride, pad: kernel / 2, inputs, outputs };
        let fans = [kernel * kernel * inputs, kernel * kernel * outputs];
        let weight = parameter(name, "weight", shape.weights(), init, fans, seed);
        let bias = bias.then(|| parameter(name, "bias", outputs, init, fans, seed));
        Self { weight, bias, shape }
    }

    /// Number of channels of the input map.
    pub fn inputs(&self) -> usize {
        self.shape.inputs
    }

    /// Number of channels of the output map.
    pub fn outputs(&self) -> usize {
        self.shape.outputs
    }

    /// Width of the border of zeros that an input needs, pixels: `⌊kernel / 2⌋`.
    pub fn border(&self) -> usize {
        self.shape.pad
    }

    /// Forward: computes `y` at `sites` from `x`.
    ///
    /// # Panics
    /// If channels or sizes do not fit, or the border of `x` is too narrow.
    pub fn forward(&self, x: &Map, y: &mut Map, sites: &Sites) {
        let start = self.bias.as_ref().map_or(Start::Zero, |b| Start::Bias(&b.value));
        self.shape.apply(&self.weight.value, start, x, y, sites);
    }

    /// Backward to the input at `sites` of `dx`, replacing or adding. `dy` must be zero where the output was not computed.
    ///
    /// # Panics
    /// As [`Conv::forward`]; `dy` needs a border of `⌊kernel / 2⌋` at stride 1.
    pub fn backward_input(&self, dy: &Map, dx: &mut Map, sites: &Sites, write: Write) {
        self.shape.transpose(&self.weight.value, write.into(), dy, dx, sites);
    }

    /// Backward to the parameters: adds the gradients of weight and bias, summed over the output's `sites`.
    ///
    /// # Panics
    /// As [`Conv::forward`].
    pub fn backward_params(&mut self, x: &Map, dy: &Map, sites: &Sites) {
        weight_gradient(self.shape, x, dy, sites, &mut self.weight.grad);
        if let Some(bias) = &mut self.bias {
            add_column_sums(dy, sites, &mut bias.grad);
        }
    }
}

impl Params for Conv {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        f(&self.weight);
        self.bias.iter().for_each(f);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        f(&mut self.weight);
        self.bias.iter_mut().for_each(f);
    }
}

impl ConvTranspose {
    /// A layer whose parameters are `{name}.weight` and `{name}.bias`; the fan-in is `inputs`.
    pub fn new(name: &str, inputs: usize, outputs: usize, init: Init, seed: u64) -> Self {
        let shape = Shape { kernel: 2, stride: 2, pad: 0, inputs: outputs, outputs: inputs };
        let weight = parameter(name, "weight", shape.weights(), init, [inputs, outputs], seed);
        Self { weight, bias: parameter(name, "bias", outputs, init, [inputs, outputs], seed), shape }
    }

    /// Number of channels of the input map.
    pub fn inputs(&self) -> usize {
        self.weight.len() / (4 * self.bias.len()).max(1)
    }

    /// Number of channels of the output map.
    pub fn outputs(&self) -> usize {
        self.bias.len()
    }

    /// Forward: computes `y`, twice the size of `x`, at `sites` of `y`.
    ///
    /// # Panics
    /// If channels or sizes do not fit.
    pub fn forward(&self, x: &Map, y: &mut Map, sites: &Sites) {
        self.shape.transpose(&self.weight.value, Start::Bias(&self.bias.value), x, y, sites);
    }

    /// Backward to the input at `sites` of `dx`, replacing or adding. `dy` must be zero where the output was not computed.
    ///
    /// # Panics
    /// If channels or sizes do not fit.
    pub fn backward_input(&self, dy: &Map, dx: &mut Map, sites: &Sites, write: Write) {
        self.shape.apply(&self.weight.value, write.into(), dy, dx, sites);
    }

    /// Backward to the parameters: adds the gradients of weight and bias. `dy` must be zero where the output was not
    /// computed. `sites` are those of the input, `out_sites` those of the output.
    ///
    /// # Panics
    /// If channels or sizes do not fit.
    pub fn backward_params(&mut self, x: &Map, dy: &Map, sites: &Sites, out_sites: &Sites) {
        weight_gradient(self.shape, dy, x, sites, &mut self.weight.grad);
        add_column_sums(dy, out_sites, &mut self.bias.grad);
    }
}

impl Params for ConvTranspose {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        f(&self.weight);
        f(&self.bias);
    }
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        f(&mut self.weight);
        f(&mut self.bias);
    }
}

/// Adds `Σ_q x[s q + k − p, i] dy[q, o]` to `grad[k, i, o]`.
fn weight_gradient(shape: Shape, x: &Map, dy: &Map, sites: &Sites, grad: &mut [f32]) {
    assert_eq!((x.channels(), dy.channels()), (shape.inputs, shape.outputs), "channels of a convolution");
    assert_eq!((sites.height(), sites.width()), (dy.height(), dy.width()), "sites of another map");
    assert!(x.border() >= shape.pad, "a border of {} is too narrow for a padding of {}", x.border(), shape.pad);
    with_pixels(|pixels| {
        for y in 0..sites.height() {
            // The base is the first tap: it may lie in the border.
            let from = |x_at: usize| x.offset(y * shape.stride, x_at * shape.stride);
            let first = shape.pad * (x.row_stride() + x.channels());
            pixels.extend(sites.row(y).iter().map(|&at| [from(at as usize) - first, dy.offset(y, at as usize)]));
        }
        let weights = Weights { shape, x, dy };
        if grad.len() <= MAX_COPIED {
            with_panels(|copies| weights.by_pieces(pixels, copies, grad));
        } else {
            let rows = WEIGHT_ROWS * shape.outputs;
            grad.par_chunks_mut(rows).enumerate().for_each(|(i, grad)| {
                dispatch!(Level::new(), simd => weights.rows(simd, pixels, i * WEIGHT_ROWS, grad));
            });
        }
    });
}

/// Operands of a weight gradient.
struct Weights<'a> {
    shape: Shape,
    x: &'a Map,
    dy: &'a Map,
}

impl Weights<'_> {
    /// At most [`CHUNKS`] pieces of the pixels, each into a copy; the copies are added in order.
    fn by_pieces(&self, pixels: &[[usize; 2]], copies: &mut Vec<f32>, grad: &mut [f32]) {
        let (size, piece) = (grad.len().max(1), pixels.len().div_ceil(CHUNKS).next_multiple_of(RUN));
        let pieces = pixels.len().div_ceil(piece.max(1));
        copies.resize(copies.len().max(pieces * size), 0.0);
        let copies = &mut copies[..pieces * size];
        copies.par_chunks_mut(size).zip(pixels.par_chunks(piece.max(1))).for_each(|(copy, pixels)| {
            copy.fill(0.0);
            dispatch!(Level::new(), simd => self.rows(simd, pixels, 0, copy));
        });
        add_in_order(grad, copies.chunks(size));
    }

    /// Adds to the rows of the gradient (a row is a tap and an input) from row `first`, as many as `grad` holds.
    #[inline(always)]
    fn rows<S: Simd>(&self, simd: S, pixels: &[[usize; 2]], first: usize, grad: &mut [f32]) {
        let Shape { kernel, inputs, outputs, .. } = self.shape;
        let rows = grad.len() / outputs;
        for pixels in pixels.chunks(RUN) {
            let mut row = 0;
            while row < rows {
                let (tap, input) = ((first + row) / inputs, (first + row) % inputs);
                let step = tap / kernel * self.x.row_stride() + tap % kernel * inputs + input;
                let group = Group { pixels, step, x: self.x.data(), dy: self.dy.data(), outputs };
                let live = (inputs - input).min(rows - row);
                let grad = &mut grad[row * outputs..];
                row += match live {
                    8.. if is_wide(simd.level()) => group.all::<S, 8>(simd, grad),
                    4.. => group.all::<S, 4>(simd, grad),
                    2.. => group.all::<S, 2>(simd, grad),
                    _ => group.all::<S, 1>(simd, grad),
                };
            }
        }
    }
}

/// One run of pixels, at one step from the bases.
struct Group<'a> {
    pixels: &'a [[usize; 2]],
    step: usize,
    x: &'a [f32],
    dy: &'a [f32],
    outputs: usize,
}

impl Group<'_> {
    /// `A` rows of the gradient, all outputs; returns `A`.
    #[inline(always)]
    fn all<S: Simd, const A: usize>(&self, simd: S, grad: &mut [f32]) -> usize {
        let mut first = 0;
        while first < self.outputs {
            let vectors = (self.outputs - first).div_ceil(16);
            first += 16
                * match vectors {
                    3 | 5.. if is_wide(simd.level()) => self.block::<S, A, 3>(simd, first, grad),
                    2 | 4 if is_wide(simd.level()) => self.block::<S, A, 2>(simd, first, grad),
                    _ => self.block::<S, A, 1>(simd, first, grad),
                };
        }
        A
    }

    /// `grad[a, first + o] += Σ_pixels x[a] dy[first + o]`; returns `V`.
    #[inline(always)]
    fn block<S: Simd, const A: usize, const V: usize>(&self, simd: S, first: usize, grad: &mut [f32]) -> usize {
        let live = (self.outputs - first).min(16 * V);
        let sum = if live == 16 * V {
            self.sums::<S, A, V>(simd, |at| {
                let dy = &self.dy[at + first..][..16 * V];
                std::array::from_fn(|v| f32x16::from_slice(simd, &dy[16 * v..][..16]))
            })
        } else {
            self.sums::<S, A, V>(simd, |at| load(simd, &self.dy[at + first..][..live]))
        };
        for (a, sum) in sum.iter().enumerate() {
            let grad = &mut grad[a * self.outputs + first..][..live];
            let mut total: [f32x16<S>; V] = load(simd, grad);
            total.iter_mut().zip(sum).for_each(|(t, s)| *t += *s);
            store(&total, grad);
        }
        V
    }

    /// `Σ_pixels x[a] dy`, where `read` reads the cotangents that begin at an offset.
    #[inline(always)]
    fn sums<S: Simd, const A: usize, const V: usize>(
        &self,
        simd: S,
        read: impl Fn(usize) -> [f32x16<S>; V],
    ) -> [[f32x16<S>; V]; A] {
        let mut sum = [[f32x16::splat(simd, 0.0); V]; A];
        for [x, dy] in self.pixels {
            let (x, dy) = (&self.x[x + self.step..][..A], read(*dy));
            for (sum, x) in sum.iter_mut().zip(x) {
                let x = f32x16::splat(simd, *x);
                for (sum, dy) in sum.iter_mut().zip(&dy) {
                    *sum = x.mul_add(*dy, *sum);
                }
            }
        }
        sum
    }
}

/// Adds `Σ map[q, c]` over the sites to `sums[c]`: rows in `f32`, their sum in `f64`.
fn add_column_sums(map: &Map, sites: &Sites, sums: &mut [f32]) {
    let channels = map.channels();
    with_panels(|lines| {
        lines.resize(lines.len().max(sites.height() * channels), 0.0);
        let lines = &mut lines[..sites.height() * channels];
        lines.par_chunks_mut(channels.max(1)).enumerate().for_each(|(y, line)| {
            line.fill(0.0);
            let row = map.row(y);
            for &x in sites.row(y) {
                line.iter_mut().zip(&row[x as usize * channels..]).for_each(|(s, v)| *s += v);
            }
        });
        for (c, sum) in sums.iter_mut().enumerate() {
            *sum += lines.iter().skip(c).step_by(channels).map(|v| f64::from(*v)).sum::<f64>() as f32;
        }
    });
}
