//! Chains of frozen layers, forward and backward with respect to the image: convolutions followed by `max(·, 0)`, and maxima over windows.
//!
//! Nothing is trained: there are no gradients of weights.

use gs_core::Image;
use gs_core::nn::gemm::{Mat, MatMut, Write, gemm};
use rayon::prelude::*;

/// A layer of a [`Chain`].
#[derive(Clone, Debug)]
pub(crate) enum Layer {
    Conv(Conv),
    /// The maximum over windows of this side, `stride` apart; windows lie inside the map.
    Max {
        side: usize,
        stride: usize,
    },
}

/// A convolution followed by `max(·, 0)`.
#[derive(Clone, Debug, Default)]
pub(crate) struct Conv {
    pub(crate) kernel: usize,
    pub(crate) stride: usize,
    /// Zeros around the map.
    pub(crate) padding: usize,
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    /// `[kernel, kernel, inputs, outputs]`.
    pub(crate) weight: Vec<f32>,
    /// `[outputs]`; empty: zeros.
    pub(crate) bias: Vec<f32>,
}

/// Layers after a normalisation of colours; the outputs of some are features.
#[derive(Clone, Debug)]
pub(crate) struct Chain {
    /// Subtracted from the channels of the image.
    pub(crate) mean: [f32; 3],
    /// What they are divided by then.
    pub(crate) deviation: [f32; 3],
    pub(crate) layers: Vec<Layer>,
    /// Layers whose outputs are features, ascending.
    pub(crate) taps: Vec<usize>,
}

/// Outputs of one forward pass, kept for the backward pass.
#[derive(Clone, Debug)]
pub(crate) struct Tape {
    /// The normalised image and the outputs of all layers.
    maps: Vec<Image>,
    taps: Vec<usize>,
}

impl Tape {
    /// The features layer by layer, `[height, width, channels]` each.
    pub(crate) fn features(&self) -> impl Iterator<Item = &Image> {
        self.taps.iter().map(|t| &self.maps[t + 1])
    }
}

impl Chain {
    /// Features of an `[H, W, 3]` image whose sides are at least [`Self::min_side`].
    pub(crate) fn forward(&self, image: &Image) -> Tape {
        self.forward_normalised(image, self.mean, self.deviation)
    }

    /// The same with another normalisation of colours.
    pub(crate) fn forward_normalised(&self, image: &Image, mean: [f32; 3], deviation: [f32; 3]) -> Tape {
        let normal = |(k, v): (usize, &f32)| (v - mean[k % 3]) / deviation[k % 3];
        let data = image.data.iter().enumerate().map(normal).collect();
        let mut maps = vec![Image { data, width: image.width, height: image.height, channels: image.channels }];
        for layer in &self.layers {
            maps.push(layer.forward(&maps[maps.len() - 1]));
        }
        Tape { maps, taps: self.taps.clone() }
    }

    /// `d_image` from the cotangents of all features, each shaped as its map.
    pub(crate) fn backward(&self, tape: &Tape, d_features: &[Image]) -> Image {
        let mut d = Image::default();
        for (k, layer) in self.layers.iter().enumerate().rev() {
            if let Some(tap) = self.taps.iter().position(|t| *t == k) {
                if d.data.is_empty() {
                    d = d_features[tap].clone();
                } else {
                    d.data.iter_mut().zip(&d_features[tap].data).for_each(|(a, b)| *a += b);
                }
            }
            if !d.data.is_empty() {
                d = layer.backward(&tape.maps[k], &tape.maps[k + 1], &d);
            }
        }
        d.data.iter_mut().enumerate().for_each(|(k, v)| *v /= self.deviation[k % 3]);
        d
    }

    /// Pixels of the image for a pixel of the last layer, along each side.
    pub(crate) fn stride(&self) -> usize {
        let stride = |layer: &Layer| match layer {
            Layer::Conv(conv) => conv.stride,
            Layer::Max { stride, .. } => *stride,
        };
        self.layers.iter().map(stride).product()
    }

    /// The least side of an image for which no layer is empty.
    pub(crate) fn min_side(&self) -> usize {
        self.layers.iter().rev().fold(1, |side, layer| layer.input_side(side))
    }
}

impl Layer {
    fn forward(&self, x: &Image) -> Image {
        match self {
            Self::Conv(conv) => conv.forward(x),
            Self::Max { side, stride } => largest(x, *side, *stride),
        }
    }

    fn backward(&self, x: &Image, y: &Image, d: &Image) -> Image {
        match self {
            Self::Conv(conv) => conv.backward(x, y, d),
            Self::Max { side, stride } => largest_backward(x, d, *side, *stride),
        }
    }

    /// The least side of a map that gives `side` values.
    fn input_side(&self, side: usize) -> usize {
        match self {
            // The first and the last tap may lie in the padding.
            Self::Conv(c) => ((side - 1) * c.stride + c.kernel).saturating_sub(2 * c.padding).max(1),
            Self::Max { side: window, stride } => (side - 1) * stride + window,
        }
    }
}

/// The maximum over windows.
fn largest(x: &Image, side: usize, stride: usize) -> Image {
    let sides = |n: usize| (n - side) / stride + 1;
    let mut y = Image::zeros(sides(x.width), sides(x.height), x.channels);
    let row_len = y.width * y.channels;
    y.data.par_chunks_mut(row_len).enumerate().for_each(|(row, out)| {
        out.fill(f32::NEG_INFINITY);
        for (at, out) in out.chunks_exact_mut(x.channels).enumerate() {
            for (u, v) in window(at, row, side, stride) {
                out.iter_mut().zip(x.pixel(u, v)).for_each(|(o, v)| *o = o.max(*v));
            }
        }
    });
    y
}

/// The cotangent of each maximum goes to the first value of its window that has it.
fn largest_backward(x: &Image, d: &Image, side: usize, stride: usize) -> Image {
    let mut out = Image::zeros(x.width, x.height, x.channels);
    for row in 0..d.height {
        for at in 0..d.width {
            for c in 0..x.channels {
                let mut best = (f32::NEG_INFINITY, 0);
                for (u, v) in window(at, row, side, stride) {
                    let k = (v * x.width + u) * x.channels + c;
                    if x.data[k] > best.0 {
                        best = (x.data[k], k);
                    }
                }
                out.data[best.1] += d.pixel(at, row)[c];
            }
        }
    }
    out
}

/// The places of a window, row by row.
fn window(at: usize, row: usize, side: usize, stride: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..side * side).map(move |k| (at * stride + k % side, row * stride + k / side))
}

impl Conv {
    /// Rows or columns of the output for as many of the input.
    fn output_side(&self, side: usize) -> usize {
        (side + 2 * self.padding - self.kernel) / self.stride + 1
    }

    /// `max(x ∗ weight + bias, 0)` as one matrix product per row of the output.
    fn forward(&self, x: &Image) -> Image {
        let (width, height) = (self.output_side(x.width), self.output_side(x.height));
        let inner = self.kernel * self.kernel * self.inputs;
        let mut y = Image::zeros(width, height, self.outputs);
        y.data.par_chunks_mut((width * self.outputs).max(1)).enumerate().for_each(|(row, out)| {
            let mut patches = vec![0.0f32; width * inner];
            for (at, patch) in patches.chunks_exact_mut(inner).enumerate() {
                for (tap, values) in patch.chunks_exact_mut(self.inputs).enumerate() {
                    let (u, v) = (self.source(at, tap % self.kernel), self.source(row, tap / self.kernel));
                    if let Some((u, v)) = u.zip(v).filter(|(u, v)| *u < x.width && *v < x.height) {
                        values.copy_from_slice(x.pixel(u, v));
                    }
                }
            }
            if !self.bias.is_empty() {
                out.chunks_exact_mut(self.outputs).for_each(|out| out.copy_from_slice(&self.bias));
            }
            let weight = Mat::new(&self.weight, inner, self.outputs);
            gemm(MatMut::new(out, width, self.outputs), Mat::new(&patches, width, inner), weight, Write::Add);
            out.iter_mut().for_each(|v| *v = v.max(0.0));
        });
        y
    }

    /// The input row or column that tap `k` of output `at` reads; `None` before the first.
    fn source(&self, at: usize, k: usize) -> Option<usize> {
        (at * self.stride + k).checked_sub(self.padding)
    }

    /// `d_x` from the output `y` and its cotangent `d`: every input row gathers what it contributed.
    fn backward(&self, x: &Image, y: &Image, d: &Image) -> Image {
        let mut d_sum = d.clone();
        d_sum.data.iter_mut().zip(&y.data).filter(|(_, y)| **y <= 0.0).for_each(|(d, _)| *d = 0.0);
        let mut out = Image::zeros(x.width, x.height, self.inputs);
        let (row_len, patch_row) = (y.width * self.outputs, self.kernel * self.inputs);
        out.data.par_chunks_mut((x.width * self.inputs).max(1)).enumerate().for_each(|(v, out)| {
            let mut d_patches = vec![0.0f32; y.width * patch_row];
            for tap in 0..self.kernel {
                // The output row whose tap reads this row.
                let Some(offset) = (v + self.padding).checked_sub(tap) else { continue };
                let row = offset / self.stride;
                if offset % self.stride != 0 || row >= y.height {
                    continue;
                }
                let weight = Mat::new(&self.weight[tap * patch_row * self.outputs..], patch_row, self.outputs);
                let d = Mat::new(&d_sum.data[row * row_len..], y.width, self.outputs);
                gemm(MatMut::new(&mut d_patches, y.width, patch_row), d, weight.transposed(), Write::Set);
                for (at, d_patches) in d_patches.chunks_exact(patch_row).enumerate() {
                    for (k, values) in d_patches.chunks_exact(self.inputs).enumerate() {
                        if let Some(u) = self.source(at, k).filter(|u| *u < x.width) {
                            out[u * self.inputs..][..self.inputs].iter_mut().zip(values).for_each(|(o, s)| *o += s);
                        }
                    }
                }
            }
        });
        out
    }
}
