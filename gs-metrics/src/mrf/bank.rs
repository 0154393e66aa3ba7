//! Features without learned weights: what edges and lines are here, and random but fixed mixtures of what lies around.
//!
//! 1. 7 × 7 filters of stride 2: an even and an odd Gabor filter of luma in eight orientations, and two colour differences;
//!    each with its negative, as `max(·, 0)` follows. 36 channels.
//! 2. 3 × 3 convolutions of stride 2 with orthonormal random rows: 64 channels at stride 4 (a layer).
//! 3. The same again: 128 channels at stride 8 (a layer).
//!
//! The strides are those of `relu3_2` and `relu4_2` of VGG-19.

use super::net::{FeatureNet, Frozen, Link};
use gs_core::Rng;

/// Side of the oriented filters.
const SIDE: usize = 7;
/// Orientations.
const TURNS: usize = 8;
/// Standard deviation of their envelope, pixels.
const SIGMA: f64 = 1.8;
/// Radians per pixel of their wave: a period of about 4.5 pixels.
const WAVE: f64 = 1.4;
/// Rec. 601 luma, red minus green, blue minus yellow.
const COLORS: [[f64; 3]; 3] = [[0.299, 0.587, 0.114], [0.5, -0.5, 0.0], [-0.25, -0.25, 0.5]];

impl FeatureNet {
    /// The default network of the MRF loss; the same for everybody, on every machine.
    pub fn fixed_bank() -> Self {
        let first = oriented();
        let second = orthogonal("mrf.stride4", first.outputs, 64);
        let third = orthogonal("mrf.stride8", second.outputs, 128);
        let links = [first, second, third].map(Link::Conv).to_vec();
        Self { name: "mrf-proxy", links, taps: vec![1, 2], weights: vec![1.0, 2.0], normal: [[0.5; 3], [0.5; 3]] }
    }
}

/// Filters of luma by angle and phase, then blobs of colour, each of length 1 and with its negative.
fn oriented() -> Frozen {
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
    for turn in 0..TURNS {
        let angle = std::f64::consts::PI * turn as f64 / TURNS as f64;
        let along = move |x: f64, y: f64| WAVE * (x * angle.cos() + y * angle.sin());
        filters.push(plane(&|x, y| envelope(x, y) * along(x, y).cos(), true, COLORS[0]));
        filters.push(plane(&|x, y| envelope(x, y) * along(x, y).sin(), true, COLORS[0]));
    }
    filters.extend(COLORS[1..].iter().map(|color| plane(&envelope, false, *color)));
    let signed: Vec<Vec<f64>> = filters.into_iter().flat_map(|f| [f.iter().map(|v| -v).collect(), f]).collect();
    frozen(SIDE, 3, &signed)
}

/// 3 × 3 filters of stride 2 whose values are orthonormal rows, drawn from a stream of their own.
fn orthogonal(name: &str, inputs: usize, outputs: usize) -> Frozen {
    let mut filters: Vec<Vec<f64>> = Vec::with_capacity(outputs);
    for row in 0..outputs {
        let mut rng = Rng::new(0, name, 0, row as u64);
        let mut filter: Vec<f64> = (0..9 * inputs).map(|_| f64::from(rng.normal())).collect();
        // Twice, so that rounding of the first pass goes too.
        for other in filters.iter().chain(&filters) {
            let along: f64 = filter.iter().zip(other).map(|(a, b)| a * b).sum();
            filter.iter_mut().zip(other).for_each(|(a, b)| *a -= along * b);
        }
        let length = filter.iter().map(|v| v * v).sum::<f64>().sqrt();
        filter.iter_mut().for_each(|v| *v /= length);
        filters.push(filter);
    }
    frozen(3, inputs, &filters)
}

/// A convolution of stride 2 without bias from filters `[kernel, kernel, inputs]`.
fn frozen(kernel: usize, inputs: usize, filters: &[Vec<f64>]) -> Frozen {
    let outputs = filters.len();
    let size = kernel * kernel * inputs;
    let weight = (0..size).flat_map(|k| filters.iter().map(move |f| f[k] as f32)).collect();
    Frozen { kernel, stride: 2, inputs, outputs, weight, bias: vec![0.0; outputs] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Image;

    #[test]
    fn layers_have_the_strides_of_the_published_network() {
        let bank = FeatureNet::fixed_bank();
        let tape = bank.forward(&Image::zeros(64, 64, 3));
        let shapes: Vec<_> = tape.layers().map(Image::shape).collect();
        assert_eq!(shapes, [(16, 16, 64), (8, 8, 128)]);
        assert_eq!((bank.least_side(), bank.name()), (8, "mrf-proxy"));
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
    fn plain_grey_is_not_seen() {
        let conv = oriented();
        assert_eq!(conv.outputs, 4 * TURNS + 4);
        // Grey has no edges and no colour.
        let flat: f32 =
            (0..conv.outputs).map(|o| conv.weight.iter().skip(o).step_by(conv.outputs).sum::<f32>().abs()).sum();
        assert!(flat < 1e-4, "{flat}");
    }
}
