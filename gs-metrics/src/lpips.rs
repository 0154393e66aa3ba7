//! LPIPS: the distance of two images in the features of a network, weighted by how people judged patches (Zhang et al. 2018).
//!
//! Colours in `[0, 1]` are mapped to `[−1, 1]`, shifted and scaled as published, put through the convolutions of AlexNet or VGG-16, and after each of five
//! of them the features of a place are divided by their length. With `w` the learnt weight of a channel, at least 0:
//! ```text
//! LPIPS = Σ_layer mean over places Σ_channel w (x − y)²
//! ```
//! gs4d has no weights. They come from a file that the user makes once, with the packages `lpips` and `safetensors` of Python:
//! ```text
//! import lpips, safetensors.torch
//! state = lpips.LPIPS(net="vgg").state_dict()       # or "alex"
//! state = {k: v.contiguous() for k, v in state.items() if not k.startswith("lins.")}
//! safetensors.torch.save_file(state, "lpips-vgg.safetensors")
//! ```
//! [`Lpips::weights`] names the network and the checksum of the file, which belong beside every value. The codes behind FAGS, MoDec-GS,
//! TRACE and DUT use VGG; DyCheck's masked distance is AlexNet's.
//!
//! **Range.** Evaluations that descend from that of 3DGS (FAGS, MoDec-GS, TRACE) leave out the map to `[−1, 1]`: their printed figures are those of
//! [`LpipsRange::Unit`]. Masked distances are DyCheck's in either case.
//!
//! **Numbers.** `f32`; distances agree with the package to 1e-5 of their value (`tests/metrics/lpips.rs`). Bitwise the same for any number of threads.

use crate::error::{MetricError, check_finite, check_pair};
use crate::frozen::{Chain, Layer};
use crate::masked::check_masked;
use crate::weights::{Weights, WeightsError};
use gs_core::{Image, cast};

/// Added to the length of features.
const EPSILON: f32 = 1e-10;
/// The published shift and scale of colours in `[−1, 1]`, for colours in `[0, 1]`.
const SIGNED: [[f32; 3]; 2] = [[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]];
/// The published shift and scale as they are.
const UNIT: [[f32; 3]; 2] = [[-0.030, -0.088, -0.188], [0.458, 0.448, 0.450]];
/// Channels of the convolutions of VGG-16; 0: a maximum over 2 × 2.
const VGG16: [usize; 17] = [64, 64, 0, 128, 128, 0, 256, 256, 256, 0, 512, 512, 512, 0, 512, 512, 512];

/// The network of the features.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LpipsNet {
    /// AlexNet.
    Alex,
    /// VGG-16.
    Vgg,
}

/// What becomes of colours before the network's shift and scale.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LpipsRange {
    /// They are mapped from `[0, 1]` to `[−1, 1]`, for which shift and scale were made.
    #[default]
    Signed,
    /// They stay in `[0, 1]`, as in the evaluation of 3DGS and what descends from it.
    Unit,
}

/// LPIPS with the weights of a file.
#[derive(Clone, Debug)]
pub struct Lpips {
    net: LpipsNet,
    chain: Chain,
    /// Weights of the channels of each layer of features.
    lines: Vec<Vec<f32>>,
    checksum: u32,
    range: LpipsRange,
}

impl Lpips {
    /// From the bytes of a safetensors file with the state of `lpips.LPIPS`; the network is the one the file holds.
    ///
    /// # Errors
    /// If the file cannot be read, or a parameter is missing, of another shape or not finite.
    pub fn read(file: &[u8]) -> Result<Self, WeightsError> {
        let weights = Weights::read(file)?;
        // The first convolution of AlexNet has windows of 11 × 11.
        let net = if weights.shape("net.slice1.0.weight").last() == Some(&11) { LpipsNet::Alex } else { LpipsNet::Vgg };
        let (layers, taps, channels) = match net {
            LpipsNet::Alex => alex(&weights)?,
            LpipsNet::Vgg => vgg(&weights)?,
        };
        let line = |(k, channels): (usize, usize)| weights.values(&line_name(&weights, k), &[1, channels, 1, 1]);
        let lines = channels.into_iter().enumerate().map(line).collect::<Result<_, _>>()?;
        let [mean, deviation] = SIGNED;
        let chain = Chain { mean, deviation, layers, taps };
        Ok(Self { net, chain, lines, checksum: crc32fast::hash(file), range: LpipsRange::Signed })
    }

    /// The same with another range of colours, for [`Self::distance`].
    pub fn with_range(self, range: LpipsRange) -> Self {
        Self { range, ..self }
    }

    /// The network.
    pub fn net(&self) -> LpipsNet {
        self.net
    }

    /// The network and the CRC-32 of the file, for example `alex 1a2b3c4d`, and the range if it is [`LpipsRange::Unit`].
    pub fn weights(&self) -> String {
        let name = match self.net {
            LpipsNet::Alex => "alex",
            LpipsNet::Vgg => "vgg",
        };
        let range = match self.range {
            LpipsRange::Signed => "",
            LpipsRange::Unit => ", colours in [0, 1]",
        };
        format!("{name} {:08x}{range}", self.checksum)
    }

    /// The distance of two `[H, W, 3]` images with values in `[0, 1]`; 0 for equal ones.
    ///
    /// # Errors
    /// Different or empty shapes, other than 3 channels, a side below 32 pixels or so, a value that is not finite.
    pub fn distance(&self, a: &Image, b: &Image) -> Result<f64, MetricError> {
        let mean = |map: Map| map.values.iter().map(|v| f64::from(*v)).sum::<f64>() / map.values.len() as f64;
        finite(self.maps(a, b, self.range)?.map(mean).sum())
    }

    /// DyCheck's distance where `mask`, `[H, W, 1]` in `[0, 1]`, counts: both images are black outside, the maps of the layers are resized to
    /// the images (bilinear, pixel centres on pixel centres), and their sum is averaged with the weights of the mask.
    ///
    /// # Errors
    /// As [`Self::distance`]; a mask of another size, or one without weight.
    pub fn masked(&self, a: &Image, b: &Image, mask: &Image) -> Result<f64, MetricError> {
        check_masked(a, b, mask)?;
        let weight = mask.data.iter().map(|w| f64::from(*w)).sum::<f64>();
        if weight <= 0.0 {
            return Err(MetricError::EmptyMask);
        }
        let black = |image: &Image| {
            let data = image.data.chunks_exact(3).zip(&mask.data).flat_map(|(p, w)| [p[0] * w, p[1] * w, p[2] * w]);
            Image { data: data.collect(), ..*image }
        };
        let mean = |map: Map| {
            let at = |k: usize| f64::from(mask.data[k]) * map.at(k % a.width, k / a.width, [a.width, a.height]);
            (0..mask.data.len()).map(at).sum::<f64>() / weight
        };
        finite(self.maps(&black(a), &black(b), LpipsRange::Signed)?.map(mean).sum())
    }

    /// The weighted squared differences of normalised features of each layer.
    fn maps(&self, a: &Image, b: &Image, range: LpipsRange) -> Result<impl Iterator<Item = Map>, MetricError> {
        check_pair(a, b)?;
        if a.channels != 3 {
            return Err(MetricError::Channels { metric: "LPIPS", got: a.channels, need: "3" });
        }
        let need = self.chain.min_side();
        if a.width < need || a.height < need {
            let (width, height, hint) = (a.width, a.height, "compare larger images");
            return Err(MetricError::TooSmall { metric: "LPIPS", need, width, height, hint });
        }
        check_finite("a", a)?;
        check_finite("b", b)?;
        let [mean, deviation] = match range {
            LpipsRange::Signed => SIGNED,
            LpipsRange::Unit => UNIT,
        };
        let [x, y] = [a, b].map(|image| self.chain.forward_normalised(image, mean, deviation));
        let of = |((x, y), line): ((&Image, &Image), &Vec<f32>)| Map::of(x, y, line);
        Ok(x.features().zip(y.features()).zip(&self.lines).map(of).collect::<Vec<_>>().into_iter())
    }
}

fn finite(value: f64) -> Result<f64, MetricError> {
    if value.is_finite() { Ok(value) } else { Err(MetricError::Overflow { metric: "LPIPS" }) }
}

/// The distances of a layer, `[height, width]`.
struct Map {
    values: Vec<f32>,
    width: usize,
    height: usize,
}

impl Map {
    fn of(x: &Image, y: &Image, line: &[f32]) -> Self {
        let place = |(x, y): (&[f32], &[f32])| {
            let (a, b) = (inverse_length(x), inverse_length(y));
            x.iter().zip(y).zip(line).map(|((x, y), w)| w * (x * a - y * b).powi(2)).sum::<f32>()
        };
        let places = x.data.chunks_exact(x.channels).zip(y.data.chunks_exact(y.channels));
        Self { values: places.map(place).collect(), width: x.width, height: x.height }
    }

    /// The value at a pixel of an image of this size.
    fn at(&self, x: usize, y: usize, [width, height]: [usize; 2]) -> f64 {
        let (x0, x1, u) = between(x, width, self.width);
        let (y0, y1, v) = between(y, height, self.height);
        let value = |x: usize, y: usize| f64::from(self.values[y * self.width + x]);
        let row = |y: usize| value(x0, y) * (1.0 - u) + value(x1, y) * u;
        row(y0) * (1.0 - v) + row(y1) * v
    }
}

/// The two places of a line of `n` that pixel `at` of `of` lies between, and how far it is from the first.
fn between(at: usize, of: usize, n: usize) -> (usize, usize, f64) {
    let place = ((at as f64 + 0.5) * n as f64 / of as f64 - 0.5).max(0.0);
    let first = cast::to_usize(place).min(n - 1);
    (first, (first + 1).min(n - 1), place - first as f64)
}

fn inverse_length(v: &[f32]) -> f32 {
    1.0 / (v.iter().map(|v| v * v).sum::<f32>().sqrt() + EPSILON)
}

/// The name of the learnt weights of a layer: with or without the drop-out that they are trained with.
fn line_name(weights: &Weights, k: usize) -> String {
    let bare = format!("lin{k}.model.0.weight");
    if weights.has(&bare) { bare } else { format!("lin{k}.model.1.weight") }
}

type Built = (Vec<Layer>, Vec<usize>, Vec<usize>);

fn alex(weights: &Weights) -> Result<Built, WeightsError> {
    let conv = |name: &str, shape, channels| weights.conv(&format!("net.{name}"), shape, channels);
    let pool = || Layer::Max { side: 3, stride: 2 };
    let layers = vec![
        conv("slice1.0", [11, 4, 2], [3, 64])?,
        pool(),
        conv("slice2.3", [5, 1, 2], [64, 192])?,
        pool(),
        conv("slice3.6", [3, 1, 1], [192, 384])?,
        conv("slice4.8", [3, 1, 1], [384, 256])?,
        conv("slice5.10", [3, 1, 1], [256, 256])?,
    ];
    Ok((layers, vec![0, 2, 4, 5, 6], vec![64, 192, 384, 256, 256]))
}

fn vgg(weights: &Weights) -> Result<Built, WeightsError> {
    // Slices end after relu1_2, relu2_2, relu3_3, relu4_3 and relu5_3.
    let slice = |index: usize| 1 + [4, 9, 16, 23].iter().filter(|first| index >= **first).count();
    let layers = weights.vgg(&VGG16, |index| format!("net.slice{}.{index}", slice(index)))?;
    Ok((layers, vec![1, 4, 8, 12, 16], vec![64, 128, 256, 512, 512]))
}
