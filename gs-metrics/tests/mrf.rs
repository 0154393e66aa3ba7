//! The MRF loss: truths, gradients against differences, `f32` against `f64`, hard images, files of weights.
//!
//! | what | tolerance |
//! |---|---|
//! | value in `f64` against the definition | 1e-12 relative |
//! | gradient in `f64` against central differences | 1e-5 of the largest entry |
//! | `f32` value and gradient against `f64` | 1e-3 |
//! | gradient of the whole loss along a direction, `f32`, against differences | 2e-2 |

use gs_core::{Image, Rng};
use gs_metrics::MetricError;
use gs_metrics::mrf::head::{HeadOptions, layer};
use gs_metrics::mrf::{FeatureNet, Mrf, MrfOptions};
use safetensors::tensor::{Dtype, TensorView};
use std::path::Path;

fn features(places: usize, channels: usize, seed: u64) -> Vec<f64> {
    let mut rng = Rng::new(seed, "features", 0, 0);
    (0..places * channels).map(|_| f64::from(rng.normal()).max(-0.3)).collect()
}

/// The definition, written out.
fn plain(x: &[f64], y: &[f64], channels: usize, o: &HeadOptions) -> f64 {
    let places = x.len() / channels;
    let unit = |v: &[f64], i: usize| {
        let mean = y[i * channels..][..channels].iter().sum::<f64>() / channels as f64;
        let centred: Vec<f64> = v[i * channels..][..channels].iter().map(|v| v - mean).collect();
        let length = centred.iter().map(|v| v * v).sum::<f64>().sqrt() + 1e-8;
        centred.into_iter().map(|v| v / length).collect::<Vec<f64>>()
    };
    let contexts: Vec<Vec<f64>> = (0..places)
        .map(|i| {
            let a = unit(x, i);
            let d: Vec<f64> = (0..places)
                .map(|j| (0.5 * (1.0 - a.iter().zip(unit(y, j)).map(|(a, b)| a * b).sum::<f64>())).clamp(0.0, 1.0))
                .collect();
            let least = d.iter().copied().fold(f64::INFINITY, f64::min) + o.floor;
            let w: Vec<f64> = d.iter().map(|d| ((1.0 - d / least) / o.bandwidth).exp()).collect();
            let sum: f64 = w.iter().sum();
            w.into_iter().map(|w| w / sum).collect()
        })
        .collect();
    let best = |j: usize| contexts.iter().map(|c| c[j]).fold(0.0, f64::max);
    -((0..places).map(best).sum::<f64>() / places as f64).ln()
}

fn largest(v: &[f64]) -> f64 {
    v.iter().fold(1e-30, |m, v| m.max(v.abs()))
}

#[test]
fn a_layer_is_its_definition_and_its_gradient_that_of_differences() {
    let options = HeadOptions::default();
    for (places, channels) in [(5, 3), (12, 8), (70, 4)] {
        let (mut x, y) = (features(places, channels, 1), features(places, channels, 2));
        let (value, grad) = layer(&x, &y, channels, &options, true);
        assert!((value / plain(&x, &y, channels, &options) - 1.0).abs() < 1e-12, "{places} places");
        let h = 1e-6;
        let scale = largest(&grad);
        for (k, got) in grad.iter().enumerate() {
            let mut at = |step: f64| {
                let before = x[k];
                x[k] += step;
                let value = plain(&x, &y, channels, &options);
                x[k] = before;
                value
            };
            let want = (at(h) - at(-h)) / (2.0 * h);
            assert!((got - want).abs() < 1e-5 * scale, "{places} places, {k}: {got} {want}");
        }
        assert!(layer(&x, &y, channels, &options, false).1.is_empty());
    }
}

#[test]
fn production_follows_the_reference() {
    let (places, channels) = (300, 64);
    let narrow = |v: &[f64]| v.iter().map(|v| *v as f32).collect::<Vec<f32>>();
    let both = |x: &[f64], y: &[f64]| {
        let want = layer(x, y, channels, &HeadOptions::default(), true);
        (want, layer(&narrow(x), &narrow(y), channels, &HeadOptions::default(), true))
    };
    let blend = |a: &[f64], near: f64, b: &[f64]| a.iter().zip(b).map(|(a, b)| a + near * b).collect::<Vec<f64>>();
    let (mut worst, mut steepest) = ([0.0f64; 2], 0.0f64);
    for (seed, near) in [1.0, 0.3, 0.1, 0.05].into_iter().enumerate() {
        let seed = seed as u64;
        // Sixty patches, each there five times with a little noise: every place has several that compete for it.
        let distinct: Vec<f64> = features(places / 5, channels, seed).repeat(5);
        let [x, y] = [100, 200].map(|k| blend(&distinct, near, &features(places, channels, k + seed)));
        let ((want, d_want), (got, d_got)) = both(&x, &y);
        assert!(want > 0.1, "nothing competes at {near}: {want}");
        let scale = largest(&d_want);
        let error = d_got.iter().zip(&d_want).map(|(a, b)| (f64::from(*a) - b).abs() / scale).fold(0.0, f64::max);
        println!("noise {near}: value {want:.4}, off by {:.1e}, gradient by {error:.1e}", got / want - 1.0);
        worst = [worst[0].max((got / want - 1.0).abs()), worst[1].max(error)];
        steepest = steepest.max(scale);
    }
    assert!(worst.iter().all(|w| *w < 1e-3), "{worst:?}");
    // Each place has one of its own and nothing else near: value and gradient vanish, whatever is rounded.
    let x = features(places, channels, 9);
    let ((want, d_want), (got, d_got)) = both(&x, &blend(&x, 0.03, &features(places, channels, 109)));
    assert!(want.abs() < 1e-6 && got.abs() < 1e-6, "{want} {got}");
    let slope = d_got.iter().zip(&d_want).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
    assert!(slope < 1e-3 * steepest, "{slope:e} beside {steepest:e}");
}

#[test]
fn patches_that_stand_apart_and_are_all_found_cost_nothing() {
    // Orthogonal patches: each is at distance 0 from itself and ½ from all others; in any order.
    let channels = 8;
    let mut y = vec![0.0f64; 64];
    (0..8).for_each(|i| y[i * channels + i] = 1.0);
    let turned: Vec<f64> = (0..8).flat_map(|i| y[(i + 3) % 8 * channels..][..channels].to_vec()).collect();
    let options = HeadOptions::default();
    assert!(layer(&y, &y, channels, &options, false).0.abs() < 1e-12);
    assert!(layer(&turned, &y, channels, &options, false).0.abs() < 1e-12);
    // One patch for all: seven are found by nobody, c = 1 for one of eight.
    let one: Vec<f64> = (0..8).flat_map(|_| y[..channels].to_vec()).collect();
    assert!((layer(&one, &y, channels, &options, false).0 - 8f64.ln()).abs() < 1e-12);
}

fn texture(side: usize, shift: f32, seed: u64) -> Image {
    let mut rng = Rng::new(seed, "waves", 0, 0);
    let waves: Vec<[f32; 4]> =
        (0..24).map(|_| [rng.range(-0.9, 0.9), rng.range(-0.9, 0.9), rng.range(0.0, 6.2), rng.uniform()]).collect();
    let mut image = Image::zeros(side, side, 3);
    for k in 0..side * side * 3 {
        let (x, y, c) = ((k / 3 % side) as f32 + shift, (k / 3 / side) as f32, k % 3);
        let wave =
            |(i, w): (usize, &[f32; 4])| if i % 3 == c { w[3] * (w[0] * x + w[1] * y + w[2]).sin() } else { 0.0 };
        image.data[k] = 0.5 + 0.12 * waves.iter().enumerate().map(wave).sum::<f32>();
    }
    image
}

fn blurred(image: &Image) -> Image {
    let mut out = image.clone();
    for y in 0..image.height {
        for x in 0..image.width {
            for c in 0..3 {
                let near = |d: usize, n: usize, at: usize| (at + d).saturating_sub(2).min(n - 1);
                let sum: f32 =
                    (0..25).map(|k| image.pixel(near(k % 5, image.width, x), near(k / 5, image.height, y))[c]).sum();
                out.pixel_mut(x, y)[c] = sum / 25.0;
            }
        }
    }
    out
}

fn small() -> Mrf {
    Mrf::new(FeatureNet::fixed_bank(), MrfOptions { side: 64, ..MrfOptions::default() }).unwrap()
}

#[test]
fn blur_costs_more_than_a_shift_of_a_pixel() {
    let (sharp, shifted) = (texture(64, 0.0, 5), texture(64, 1.0, 5));
    let of = |a: &Image| small().value(a, &sharp).unwrap().total;
    let [same, shift, blur, other] = [of(&sharp), of(&shifted), of(&blurred(&sharp)), of(&texture(64, 0.0, 6))];
    println!("same {same:.4}, shifted {shift:.4}, blurred {blur:.4}, another texture {other:.4}");
    assert!(same < shift && shift < blur && shift < other);
}

#[test]
fn terms_are_weighted_and_named() {
    let (a, b) = (texture(50, 0.0, 1), texture(50, 2.0, 2));
    let terms = small().value(&a, &b).unwrap();
    assert_eq!(terms.total, terms.layers[0] + 2.0 * terms.layers[1]);
    assert_eq!(small().name(), "mrf-proxy");
    let mut grad = Image::default();
    assert_eq!(small().value_and_grad(&a, &b, &mut grad).unwrap(), terms);
    assert_eq!(grad.shape(), a.shape());
}

/// The whole way back, through resizing, features and comparison, along random directions of pixels.
#[test]
fn gradient_of_the_whole_loss_along_directions() {
    let (a, b) = (texture(40, 0.3, 7), texture(40, 0.0, 7));
    let loss = small();
    let mut grad = Image::default();
    loss.value_and_grad(&a, &b, &mut grad).unwrap();
    let mut worst = 0.0f64;
    for seed in 0..6 {
        let mut rng = Rng::new(seed, "direction", 0, 0);
        let along: Vec<f32> = grad.data.iter().map(|g| g.signum() * rng.uniform()).collect();
        let at = |h: f32| {
            let data = a.data.iter().zip(&along).map(|(v, d)| v + h * d).collect();
            loss.value(&Image { data, ..a.clone() }, &b).unwrap().total
        };
        let h = 1e-4f32;
        let want = (at(h) - at(-h)) / f64::from(2.0 * h);
        let got: f64 = grad.data.iter().zip(&along).map(|(g, d)| f64::from(*g) * f64::from(*d)).sum();
        worst = worst.max((got / want - 1.0).abs());
    }
    println!("along directions: {worst:.1e}");
    assert!(worst < 2e-2, "{worst:e}");
}

#[test]
fn plain_and_black_images_give_finite_gradients() {
    let flat = |v: f32| Image { width: 30, height: 20, channels: 3, data: vec![v; 1800] };
    let mut half = flat(0.0);
    half.data[900..].copy_from_slice(&texture(30, 0.0, 3).data[..900]);
    for (a, b) in [(flat(0.0), flat(0.0)), (flat(0.0), flat(1.0)), (flat(0.5), half.clone()), (half, flat(0.0))] {
        let mut grad = Image::default();
        let terms = small().value_and_grad(&a, &b, &mut grad).unwrap();
        assert!(terms.total.is_finite() && grad.first_non_finite().is_none());
        assert!(grad.data.iter().all(|g| g.abs() < 1e3), "{}", grad.data.iter().fold(0.0f32, |m, g| m.max(g.abs())));
    }
    let one = Image { width: 1, height: 1, channels: 3, data: vec![0.2, 0.4, 0.6] };
    let mut grad = Image::default();
    assert!(small().value_and_grad(&one, &one, &mut grad).unwrap().total.is_finite());
    assert_eq!(grad.shape(), (1, 1, 3));
}

#[test]
fn bad_images_and_options_are_refused() {
    let good = texture(16, 0.0, 1);
    let mut bad = good.clone();
    bad.pixel_mut(3, 2)[1] = f32::NAN;
    let e = small().value(&bad, &good).unwrap_err();
    assert!(matches!(e, MetricError::NotFinite { which: "a", x: 3, y: 2, channel: 1 }), "{e}");
    assert!(matches!(small().value(&good, &bad).unwrap_err(), MetricError::NotFinite { which: "b", .. }));
    let e = small().value(&Image::zeros(4, 4, 1), &Image::zeros(4, 4, 1)).unwrap_err();
    assert!(matches!(e, MetricError::Channels { .. }), "{e}");
    assert!(matches!(small().value(&good, &Image::zeros(4, 4, 3)), Err(MetricError::Shape { .. })));
    assert!(matches!(small().value(&Image::default(), &Image::default()), Err(MetricError::Malformed { .. })));
    let e = Mrf::new(FeatureNet::fixed_bank(), MrfOptions { side: 7, ..MrfOptions::default() }).err();
    assert!(matches!(e, Some(MetricError::Option { name: "side", .. })));
}

#[test]
fn threads_do_not_change_bits() {
    let (a, b) = (texture(64, 0.4, 8), texture(64, 0.0, 8));
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut grad = Image::default();
        pool.install(|| (small().value_and_grad(&a, &b, &mut grad).unwrap(), grad.clone()))
    };
    assert!(run(1) == run(5));
}

const LAYERS: [(usize, usize, usize); 10] = [
    (0, 3, 64),
    (2, 64, 64),
    (5, 64, 128),
    (7, 128, 128),
    (10, 128, 256),
    (12, 256, 256),
    (14, 256, 256),
    (16, 256, 256),
    (19, 256, 512),
    (21, 512, 512),
];

/// A network that hands its input on, the first layer from the pixel above.
fn write_network(path: &Path, spoil: impl Fn(&str, &mut Vec<usize>, &mut Vec<f32>)) {
    let mut tensors = Vec::new();
    for (number, inputs, outputs) in LAYERS {
        let mut weight = vec![0.0f32; outputs * inputs * 9];
        let tap = if number == 0 { 1 } else { 4 };
        (0..inputs.min(outputs)).for_each(|i| weight[(i * inputs + i) * 9 + tap] = 1.0);
        for (what, mut shape, mut values) in
            [("weight", vec![outputs, inputs, 3, 3], weight), ("bias", vec![outputs], vec![0.0; outputs])]
        {
            let name = format!("features.{number}.{what}");
            spoil(&name, &mut shape, &mut values);
            let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
            tensors.push((name, shape, bytes));
        }
    }
    let views = tensors.iter().map(|(n, s, b)| (n.clone(), TensorView::new(Dtype::F32, s.clone(), b).unwrap()));
    std::fs::write(path, safetensors::serialize(views.collect::<Vec<_>>(), None).unwrap()).unwrap();
}

#[test]
fn a_file_of_weights_is_read_in_its_own_order() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("vgg19.safetensors");
    write_network(&path, |_, _, _| ());
    let net = FeatureNet::vgg19(&path).unwrap();
    assert_eq!((net.name(), net.least_side()), ("id-mrf", 8));
    // One bright pixel at (4, 3) arrives at row 4, and pooled by 4 at (1, 1).
    let mut image = Image::zeros(16, 16, 3);
    image.pixel_mut(4, 3).fill(1.0);
    let tape = net.forward(&image);
    let layers: Vec<&Image> = tape.layers().collect();
    assert_eq!([layers[0].shape(), layers[1].shape()], [(4, 4, 256), (2, 2, 512)]);
    let bright = (1.0 - 0.485f32) / 0.229;
    for (x, y) in (0..4).flat_map(|y| (0..4).map(move |x| (x, y))) {
        let want = if (x, y) == (1, 1) { bright } else { 0.0 };
        assert!((layers[0].pixel(x, y)[0] - want).abs() < 1e-5, "({x}, {y}): {}", layers[0].pixel(x, y)[0]);
        assert_eq!(layers[0].pixel(x, y)[3], 0.0);
    }
    let mut d: Vec<Image> = layers.iter().map(|l| Image::zeros(l.width, l.height, l.channels)).collect();
    d[0].pixel_mut(1, 1)[0] = 1.0;
    d[1].pixel_mut(0, 0)[0] = 2.0;
    let back = net.backward(&tape, &d);
    assert!((back.pixel(4, 3)[0] - 3.0 / 0.229).abs() < 1e-4, "{}", back.pixel(4, 3)[0]);
    assert_eq!(back.data.iter().filter(|v| **v != 0.0).count(), 1);
}

#[test]
fn files_without_the_network_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("vgg19.safetensors");
    let error = || FeatureNet::vgg19(&path).unwrap_err().to_string();
    assert!(error().contains("cannot read"), "{}", error());
    std::fs::write(&path, b"not a network").unwrap();
    assert!(error().contains("is not a safetensors file"), "{}", error());
    write_network(&path, |name, shape, _| {
        if name == "features.7.weight" {
            shape.swap(0, 2);
        }
    });
    assert!(error().contains("`features.7.weight` must be f32 of shape [128, 128, 3, 3]"), "{}", error());
    write_network(&path, |name, _, values| {
        if name == "features.19.bias" {
            values[5] = f32::INFINITY;
        }
    });
    assert!(error().contains("`features.19.bias`, value 5 is not finite"), "{}", error());
}
