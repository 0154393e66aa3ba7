//! The features of the MRF loss, forward and backward: a chain of frozen convolutions, each followed by `max(·, 0)`.
//!
//! Nothing is trained: there are no gradients of weights.

use gs_core::Image;
use gs_core::nn::gemm::{Mat, MatMut, Write, gemm};
use rayon::prelude::*;

/// Images in `[0, 1]` enter as `(v − MEAN) / DEVIATION`.
const MEAN: f32 = 0.5;
/// See [`MEAN`].
const DEVIATION: f32 = 0.5;

/// A convolution without bias, zero padding `⌊kernel/2⌋`, followed by `max(·, 0)`.
#[derive(Clone, Debug)]
pub(super) struct Conv {
    pub(super) kernel: usize,
    pub(super) stride: usize,
    pub(super) inputs: usize,
    pub(super) outputs: usize,
    /// `[kernel, kernel, inputs, outputs]`.
    pub(super) weight: Vec<f32>,
}

/// A frozen network whose activations are compared by [`Mrf`](super::Mrf).
///
/// The only one is [`FeatureNet::fixed_bank`]. Published VGG-19 features, which the papers use, are not included.
#[derive(Clone, Debug)]
pub struct FeatureNet {
    pub(super) convs: Vec<Conv>,
    /// Convolutions whose outputs are features, ascending.
    pub(super) taps: Vec<usize>,
    /// Weight in the loss of each layer of features.
    pub(super) weights: Vec<f64>,
}

/// Activations of one forward pass, kept for the backward pass.
#[derive(Clone, Debug)]
pub(super) struct Tape {
    /// The normalised image and the outputs of all convolutions.
    maps: Vec<Image>,
    taps: Vec<usize>,
}

impl Tape {
    /// The features layer by layer, `[height, width, channels]` each.
    pub(super) fn layers(&self) -> impl Iterator<Item = &Image> {
        self.taps.iter().map(|t| &self.maps[t + 1])
    }
}

impl FeatureNet {
    /// Features of an `[H, W, 3]` image.
    pub(super) fn forward(&self, image: &Image) -> Tape {
        let data = image.data.iter().map(|v| (v - MEAN) / DEVIATION).collect();
        let mut maps = vec![Image { data, width: image.width, height: image.height, channels: image.channels }];
        for conv in &self.convs {
            maps.push(conv.forward(&maps[maps.len() - 1]));
        }
        Tape { maps, taps: self.taps.clone() }
    }

    /// `d_image` from the cotangents of all layers of features, each shaped as its layer.
    pub(super) fn backward(&self, tape: &Tape, d_layers: &[Image]) -> Image {
        let mut d = Image::default();
        for (k, conv) in self.convs.iter().enumerate().rev() {
            if let Some(tap) = self.taps.iter().position(|t| *t == k) {
                if d.data.is_empty() {
                    d = d_layers[tap].clone();
                } else {
                    d.data.iter_mut().zip(&d_layers[tap].data).for_each(|(a, b)| *a += b);
                }
            }
            if !d.data.is_empty() {
                d = conv.backward(&tape.maps[k], &tape.maps[k + 1], &d);
            }
        }
        d.data.iter_mut().for_each(|v| *v /= DEVIATION);
        d
    }

    /// Side in pixels of the smallest square image that fills a pixel of every layer.
    pub(super) fn min_side(&self) -> usize {
        self.convs.iter().map(|c| c.stride).product()
    }
}

impl Conv {
    /// Rows or columns of the output for as many of the input.
    fn output_side(&self, side: usize) -> usize {
        side.div_ceil(self.stride)
    }

    /// `max(x ∗ weight, 0)` as one matrix product per row of the output.
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
            let weight = Mat::new(&self.weight, inner, self.outputs);
            gemm(MatMut::new(out, width, self.outputs), Mat::new(&patches, width, inner), weight, Write::Add);
            out.iter_mut().for_each(|v| *v = v.max(0.0));
        });
        y
    }

    /// The input row or column that tap `k` of output `at` reads; `None` before the first.
    fn source(&self, at: usize, k: usize) -> Option<usize> {
        (at * self.stride + k).checked_sub(self.kernel / 2)
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
                let Some(offset) = (v + self.kernel / 2).checked_sub(tap) else { continue };
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
