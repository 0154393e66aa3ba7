//! The MRF loss: known values, gradients against central differences, `f32` against `f64`, flat images, bad input.
//!
//! | what | tolerance |
//! |---|---|
//! | value in `f64` against the definition | 1e-12 relative |
//! | gradient in `f64` against central differences | 1e-5 of the largest entry |
//! | `f32` value and gradient against `f64` | 1e-3 |
//! | gradient of the whole loss along a direction, `f32`, against differences | 2e-2 |

use gs_core::{Image, Rng};
use gs_metrics::MetricError;
use gs_metrics::mrf::layer::{LayerOptions, layer_loss};
use gs_metrics::mrf::{FeatureNet, Mrf, MrfOptions};

fn features(places: usize, channels: usize, seed: u64) -> Vec<f64> {
    let mut rng = Rng::new(seed, "features", 0, 0);
    (0..places * channels).map(|_| f64::from(rng.normal()).max(-0.3)).collect()
}

/// The definition, written out.
fn plain(x: &[f64], y: &[f64], channels: usize, o: &LayerOptions) -> f64 {
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
            let least = d.iter().copied().fold(f64::INFINITY, f64::min) + o.epsilon;
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
fn a_layer_agrees_with_its_definition_and_its_gradient_with_differences() {
    let options = LayerOptions::default();
    for (places, channels) in [(5, 3), (12, 8), (70, 4)] {
        let (mut x, y) = (features(places, channels, 1), features(places, channels, 2));
        let (value, grad) = layer_loss(&x, &y, channels, &options, true);
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
        assert!(layer_loss(&x, &y, channels, &options, false).1.is_empty());
    }
}

#[test]
fn f32_agrees_with_f64() {
    let (places, channels) = (300, 64);
    let narrow = |v: &[f64]| v.iter().map(|v| *v as f32).collect::<Vec<f32>>();
    let both = |x: &[f64], y: &[f64]| {
        let want = layer_loss(x, y, channels, &LayerOptions::default(), true);
        (want, layer_loss(&narrow(x), &narrow(y), channels, &LayerOptions::default(), true))
    };
    let blend = |a: &[f64], near: f64, b: &[f64]| a.iter().zip(b).map(|(a, b)| a + near * b).collect::<Vec<f64>>();
    let (mut worst, mut steepest) = ([0.0f64; 2], 0.0f64);
    for (seed, near) in [1.0, 0.3, 0.1, 0.05].into_iter().enumerate() {
        let seed = seed as u64;
        // Sixty patches, each five times with a little noise: every place has several candidates.
        let distinct: Vec<f64> = features(places / 5, channels, seed).repeat(5);
        let [x, y] = [100, 200].map(|k| blend(&distinct, near, &features(places, channels, k + seed)));
        let ((want, d_want), (got, d_got)) = both(&x, &y);
        assert!(want > 0.1, "no candidates at {near}: {want}");
        let scale = largest(&d_want);
        let error = d_got.iter().zip(&d_want).map(|(a, b)| (f64::from(*a) - b).abs() / scale).fold(0.0, f64::max);
        println!("noise {near}: value {want:.4}, off by {:.1e}, gradient by {error:.1e}", got / want - 1.0);
        worst = [worst[0].max((got / want - 1.0).abs()), worst[1].max(error)];
        steepest = steepest.max(scale);
    }
    assert!(worst.iter().all(|w| *w < 1e-3), "{worst:?}");
    // Each place has exactly one close candidate: value and gradient vanish up to rounding.
    let x = features(places, channels, 9);
    let ((want, d_want), (got, d_got)) = both(&x, &blend(&x, 0.03, &features(places, channels, 109)));
    assert!(want.abs() < 1e-6 && got.abs() < 1e-6, "{want} {got}");
    let slope = d_got.iter().zip(&d_want).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
    assert!(slope < 1e-3 * steepest, "{slope:e} against {steepest:e}");
}

#[test]
fn distinct_patches_that_are_all_found_cost_nothing() {
    // Orthogonal patches: each is at distance 0 from itself and ½ from all others; in any order.
    let channels = 8;
    let mut y = vec![0.0f64; 64];
    (0..8).for_each(|i| y[i * channels + i] = 1.0);
    let turned: Vec<f64> = (0..8).flat_map(|i| y[(i + 3) % 8 * channels..][..channels].to_vec()).collect();
    let options = LayerOptions::default();
    assert!(layer_loss(&y, &y, channels, &options, false).0.abs() < 1e-12);
    assert!(layer_loss(&turned, &y, channels, &options, false).0.abs() < 1e-12);
    // One patch everywhere: seven are not found, c = 1 for one of eight.
    let one: Vec<f64> = (0..8).flat_map(|_| y[..channels].to_vec()).collect();
    assert!((layer_loss(&one, &y, channels, &options, false).0 - 8f64.ln()).abs() < 1e-12);
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
    let mut grad = Image::default();
    assert_eq!(small().value_and_grad(&a, &b, &mut grad).unwrap(), terms);
    assert_eq!(grad.shape(), a.shape());
}

/// The whole backward pass, through resizing, features and comparison, along random directions of pixels.
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
fn flat_and_black_images_give_finite_gradients() {
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
fn bad_images_and_options_are_errors() {
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
