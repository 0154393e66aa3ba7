//! Features without learned weights: oriented filters, then fixed random convolutions.
//!
//! 1. 7 × 7 filters of stride 2: an even and an odd Gabor filter of luma in eight orientations, and two colour differences,
//!    each with its negative, as `max(·, 0)` follows. 36 channels.
//! 2. 3 × 3 convolutions of stride 2 with orthonormal random rows: 64 channels at stride 4, the first layer of features.
//! 3. The same again: 128 channels at stride 8, the second layer of features.
//!
//! The strides are those of `relu3_2` and `relu4_2` of VGG-19.

use super::net::FeatureNet;
use crate::frozen::{Chain, Conv, Layer};
use gs_core::{Rng, cast};

/// Side of the oriented filters, pixels.
const SIDE: usize = 7;
/// Number of orientations, evenly spaced over 180°.
const ORIENTATIONS: usize = 8;
/// Standard deviation of the Gabor envelope, pixels.
const SIGMA: f64 = 1.8;
/// Frequency of the Gabor wave, radians per pixel: a period of about 4.5 pixels.
const FREQUENCY: f64 = 1.4;
/// Rec. 601 luma, red minus green, blue minus yellow.
const COLORS: [[f64; 3]; 3] = [[0.299, 0.587, 0.114], [0.5, -0.5, 0.0], [-0.25, -0.25, 0.5]];

impl FeatureNet {
    /// The fixed filter bank: no learned weights, the same on every machine. Layers of 64 channels at stride 4 and of 128 at
    /// stride 8, with the weights 1 and 2.
    pub fn fixed_bank() -> Self {
        let first = oriented();
        let second = orthogonal("mrf.stride4", first.outputs, 64);
        let third = orthogonal("mrf.stride8", second.outputs, 128);
        let layers = [first, second, third].map(Layer::Conv).to_vec();
        let chain = Chain { mean: [0.5; 3], deviation: [0.5; 3], layers, taps: vec![1, 2] };
        Self { chain, weights: vec![1.0, 2.0] }
    }
}

/// Gabor filters of luma by angle and phase, then Gaussians of colour differences, each of norm 1 and with its negative.
fn oriented() -> Conv {
    let reach = (SIDE / 2) as f64;
    let plane = |f: &dyn Fn(f64, f64) -> f64, zero_mean: bool, color: [f64; 3]| {
        let at = |k: usize| f((k % SIDE) as f64 - reach, (k / SIDE) as f64 - reach);
        let mut values: Vec<f64> = (0..SIDE * SIDE).map(at).collect();
        let mean = if zero_mean { values.iter().sum::<f64>() / values.len() as f64 } else { 0.0 };
        values.iter_mut().for_each(|v| *v -= mean);
        let filter: Vec<f64> = values.iter().flat_map(|v| color.map(|c| c * v)).collect();
        let length = filter.iter().map(|v| v * v).sum::<f64>().sqrt();
        filter.into_iter().map(|v| v / length).collect::<Vec<f64>>()
    };
    let envelope = |x: f64, y: f64| (-(x * x + y * y) / (2.0 * SIGMA * SIGMA)).exp();
    let mut filters = Vec::new();
    for k in 0..ORIENTATIONS {
        let angle = std::f64::consts::PI * k as f64 / ORIENTATIONS as f64;
        let phase = move |x: f64, y: f64| FREQUENCY * (x * angle.cos() + y * angle.sin());
        filters.push(plane(&|x, y| envelope(x, y) * phase(x, y).cos(), true, COLORS[0]));
        filters.push(plane(&|x, y| envelope(x, y) * phase(x, y).sin(), true, COLORS[0]));
    }
    filters.extend(COLORS[1..].iter().map(|color| plane(&envelope, false, *color)));
    let signed: Vec<Vec<f64>> = filters.into_iter().flat_map(|f| [f.iter().map(|v| -v).collect(), f]).collect();
    conv(SIDE, 3, &signed)
}

/// 3 × 3 filters of stride 2: Gaussian random rows, orthonormalised by Gram-Schmidt.
fn orthogonal(name: &str, inputs: usize, outputs: usize) -> Conv {
    let mut filters: Vec<Vec<f64>> = Vec::with_capacity(outputs);
    for row in 0..outputs {
        let mut rng = Rng::new(0, name, 0, row as u64);
        let mut filter: Vec<f64> = (0..9 * inputs).map(|_| f64::from(rng.normal())).collect();
        // Twice: the second pass removes the rounding of the first.
        for other in filters.iter().chain(&filters) {
            let dot: f64 = filter.iter().zip(other).map(|(a, b)| a * b).sum();
            filter.iter_mut().zip(other).for_each(|(a, b)| *a -= dot * b);
        }
        let length = filter.iter().map(|v| v * v).sum::<f64>().sqrt();
        filter.iter_mut().for_each(|v| *v /= length);
        filters.push(filter);
    }
    conv(3, inputs, &filters)
}

/// A convolution of stride 2 from filters `[kernel, kernel, inputs]`.
fn conv(kernel: usize, inputs: usize, filters: &[Vec<f64>]) -> Conv {
    let outputs = filters.len();
    let size = kernel * kernel * inputs;
    let weight = (0..size).flat_map(|k| filters.iter().map(move |f| cast::to_f32(f[k]))).collect();
    Conv { kernel, stride: 2, padding: kernel / 2, inputs, outputs, weight, bias: Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Image;

    #[test]
    fn layers_have_the_strides_of_the_published_network() {
        let bank = FeatureNet::fixed_bank();
        let tape = bank.chain.forward(&Image::zeros(64, 64, 3));
        let shapes: Vec<_> = tape.features().map(Image::shape).collect();
        assert_eq!(shapes, [(16, 16, 64), (8, 8, 128)]);
        assert_eq!(bank.min_side(), 8);
    }

    #[test]
    fn random_filters_are_orthonormal() {
        let conv = orthogonal("test", 4, 20);
        let column = |o: usize| conv.weight.iter().skip(o).step_by(20);
        for a in 0..20 {
            for b in 0..=a {
                let dot: f64 = column(a).zip(column(b)).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum();
                assert!((dot - f64::from(u8::from(a == b))).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn plain_grey_gives_no_response() {
        let conv = oriented();
        assert_eq!(conv.outputs, 4 * ORIENTATIONS + 4);
        let flat: f32 =
            (0..conv.outputs).map(|o| conv.weight.iter().skip(o).step_by(conv.outputs).sum::<f32>().abs()).sum();
        assert!(flat < 1e-4, "{flat}");
    }
}
