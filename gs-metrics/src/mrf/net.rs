//! A network that sees more in an image than its pixels and can be walked backwards: a chain of frozen convolutions (each
//! followed by `max(·, 0)`) and pools, some of whose results are the features.
//!
//! Nothing here learns: there are no gradients of weights and no moments, so a network of 10 million weights costs 40 MB.

use gs_core::Image;
use gs_core::nn::gemm::{Mat, MatMut, Write, gemm};
use rayon::prelude::*;

/// One link.
#[derive(Clone, Debug)]
pub(super) enum Link {
    /// A convolution and `max(·, 0)`.
    Conv(Frozen),
    /// The largest of each 2 × 2 pixels; a last odd row or column is dropped.
    Pool,
}

/// Weights of a convolution with zero padding `⌊kernel/2⌋`.
#[derive(Clone, Debug)]
pub(super) struct Frozen {
    pub kernel: usize,
    pub stride: usize,
    pub inputs: usize,
    pub outputs: usize,
    /// `[kernel, kernel, inputs, outputs]`.
    pub weight: Vec<f32>,
    /// `[outputs]`.
    pub bias: Vec<f32>,
}

/// Frozen features of images.
#[derive(Clone, Debug)]
pub struct FeatureNet {
    /// What a score made with it is called in reports.
    pub(super) name: &'static str,
    pub(super) links: Vec<Link>,
    /// Links whose results are features, ascending.
    pub(super) taps: Vec<usize>,
    /// Weight of each layer of features in the loss.
    pub(super) weights: Vec<f64>,
    /// Subtracted from, and divided into, the channels of an image.
    pub(super) normal: [[f32; 3]; 2],
}

/// Results of all links.
#[derive(Clone, Debug)]
pub struct Tape {
    /// The normalised image and the results of all links.
    maps: Vec<Image>,
    taps: Vec<usize>,
}

impl Tape {
    /// The features, layer by layer, `[height, width, channels]`.
    pub fn layers(&self) -> impl Iterator<Item = &Image> {
        self.taps.iter().map(|t| &self.maps[t + 1])
    }
}

impl FeatureNet {
    /// What a score made with it is called in reports.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Weight of each layer in the loss.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Features of an `[H, W, 3]` image, all layers, with what the way back needs.
    pub fn forward(&self, image: &Image) -> Tape {
        let [mean, deviation] = self.normal;
        let normal = |(k, v): (usize, &f32)| (v - mean[k % 3]) / deviation[k % 3];
        let data = image.data.iter().enumerate().map(normal).collect();
        let mut maps = vec![Image { data, width: image.width, height: image.height, channels: image.channels }];
        for link in &self.links {
            let x = &maps[maps.len() - 1];
            let y = match link {
                Link::Conv(conv) => conv.forward(x),
                Link::Pool => pool(x),
            };
            maps.push(y);
        }
        Tape { maps, taps: self.taps.clone() }
    }

    /// `dL/d image` from the cotangents of all layers, each shaped as its layer.
    pub fn backward(&self, tape: &Tape, d_layers: &[Image]) -> Image {
        let mut d = Image::default();
        for (k, link) in self.links.iter().enumerate().rev() {
            if let Some(tap) = self.taps.iter().position(|t| *t == k) {
                if d.data.is_empty() {
                    d = d_layers[tap].clone();
                } else {
                    d.data.iter_mut().zip(&d_layers[tap].data).for_each(|(a, b)| *a += b);
                }
            }
            if !d.data.is_empty() {
                let (x, y) = (&tape.maps[k], &tape.maps[k + 1]);
                d = match link {
                    Link::Conv(conv) => conv.backward(x, y, &d),
                    Link::Pool => pool_backward(x, y, &d),
                };
            }
        }
        let deviation = self.normal[1];
        d.data.iter_mut().enumerate().for_each(|(k, v)| *v /= deviation[k % 3]);
        d
    }

    /// Rows of the smallest image that has a pixel in every layer.
    pub fn least_side(&self) -> usize {
        let halvings = self.links.iter().filter(|l| !matches!(l, Link::Conv(c) if c.stride == 1)).count();
        1 << halvings
    }
}

impl Frozen {
    /// Rows or columns of the result.
    fn reduced(&self, side: usize) -> usize {
        side.div_ceil(self.stride)
    }

    fn forward(&self, x: &Image) -> Image {
        let (width, height) = (self.reduced(x.width), self.reduced(x.height));
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
            out.chunks_exact_mut(self.outputs).for_each(|o| o.copy_from_slice(&self.bias));
            let weight = Mat::new(&self.weight, inner, self.outputs);
            gemm(MatMut::new(out, width, self.outputs), Mat::new(&patches, width, inner), weight, Write::Add);
            out.iter_mut().for_each(|v| *v = v.max(0.0));
        });
        y
    }

    /// The input row or column that tap `k` of result `at` reads; none before the first.
    fn source(&self, at: usize, k: usize) -> Option<usize> {
        (at * self.stride + k).checked_sub(self.kernel / 2)
    }

    fn backward(&self, x: &Image, y: &Image, d: &Image) -> Image {
        let mut live = d.clone();
        live.data.iter_mut().zip(&y.data).filter(|(_, y)| **y <= 0.0).for_each(|(d, _)| *d = 0.0);
        let mut out = Image::zeros(x.width, x.height, self.inputs);
        let (line, across) = (y.width * self.outputs, self.kernel * self.inputs);
        out.data.par_chunks_mut((x.width * self.inputs).max(1)).enumerate().for_each(|(v, out)| {
            let mut spread = vec![0.0f32; y.width * across];
            for tap in 0..self.kernel {
                // Result rows whose tap reads this row.
                let Some(reach) = (v + self.kernel / 2).checked_sub(tap) else { continue };
                let row = reach / self.stride;
                if reach % self.stride != 0 || row >= y.height {
                    continue;
                }
                let weight = Mat::new(&self.weight[tap * across * self.outputs..], across, self.outputs);
                let d = Mat::new(&live.data[row * line..], y.width, self.outputs);
                gemm(MatMut::new(&mut spread, y.width, across), d, weight.transposed(), Write::Set);
                for (at, spread) in spread.chunks_exact(across).enumerate() {
                    for (k, values) in spread.chunks_exact(self.inputs).enumerate() {
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

/// The four pixels under a pooled one.
fn under(x: usize, y: usize) -> [(usize, usize); 4] {
    [(2 * x, 2 * y), (2 * x + 1, 2 * y), (2 * x, 2 * y + 1), (2 * x + 1, 2 * y + 1)]
}

fn pool(x: &Image) -> Image {
    let (width, height) = (x.width / 2, x.height / 2);
    let mut y = Image::zeros(width, height, x.channels);
    for (v, u) in (0..height).flat_map(|v| (0..width).map(move |u| (v, u))) {
        for (c, out) in y.pixel_mut(u, v).iter_mut().enumerate() {
            *out = under(u, v).iter().map(|(a, b)| x.pixel(*a, *b)[c]).fold(f32::NEG_INFINITY, f32::max);
        }
    }
    y
}

/// To the first of the largest, in reading order.
fn pool_backward(x: &Image, y: &Image, d: &Image) -> Image {
    let mut out = Image::zeros(x.width, x.height, x.channels);
    for (v, u) in (0..y.height).flat_map(|v| (0..y.width).map(move |u| (v, u))) {
        for c in 0..x.channels {
            let first = under(u, v).into_iter().find(|(a, b)| x.pixel(*a, *b)[c] == y.pixel(u, v)[c]);
            if let Some((a, b)) = first {
                out.pixel_mut(a, b)[c] += d.pixel(u, v)[c];
            }
        }
    }
    out
}
