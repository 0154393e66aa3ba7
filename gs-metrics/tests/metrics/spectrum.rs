//! The amplitude loss against plain sums in `f64`, its gradient against central differences, and its invariances.
//!
//! | quantity | against | tolerance | why |
//! |---|---|---|---|
//! | reference gradient (f64) | central differences (f64), h = 1e-6 | 1e-6 of its largest entry | h² and rounding |
//! | value (f32) | reference | 5e-8 absolute | rounding of a transform of values up to 1; worst seen 2e-8 |
//! | gradient (f32) | reference | 2e-5 relative L2 | phases of small bins; no difference changes its sign here; worst seen 5e-6 |
//! | shifted cyclically, rotated by 180° | 0 | 1e-7 | rounding of a transform |

use crate::fourier::amplitude_loss64;
use crate::images::*;
use crate::reference::{Image64, relative_l2};
use gs_core::Image;
use gs_metrics::{AmplitudeLoss, AmplitudeOptions, FftNorm, MetricError, Reduce, mse};

const VALUE: f64 = 5e-8;
const GRAD: f64 = 2e-5;
const ZERO: f64 = 1e-7;

fn value_and_grad(a: &Image, b: &Image, options: AmplitudeOptions) -> (f64, Vec<f32>) {
    let (mut loss, mut grad) = (AmplitudeLoss::new(options), Image::default());
    let value = loss.value_and_grad(a, b, &mut grad).unwrap();
    assert_eq!(value.to_bits(), loss.value(a, b).unwrap().to_bits(), "the value does not depend on the gradient");
    (value, grad.data)
}

fn value(a: &Image, b: &Image) -> f64 {
    AmplitudeLoss::default().value(a, b).unwrap()
}

#[test]
fn known_values() {
    let a = Image { width: 2, height: 2, channels: 1, data: vec![1.0, 2.0, 3.0, 4.0] };
    let b = constant(2, 2, 1, 1.0);
    let (mean, grad) = value_and_grad(&a, &b, AmplitudeOptions::default());
    assert_eq!((mean, grad.as_slice()), (1.5, [-0.125, 0.125, 0.125, 0.375].as_slice()));
    let (reference, slope) = amplitude_loss64(&Image64::from(&a), &Image64::from(&b));
    assert!((reference - 1.5).abs() < 1e-14 && relative_l2(&grad, &slope) < 1e-14);
    // W H = 4 bins of one channel; √(W H) = 2.
    for (norm, reduce, factor) in [
        (FftNorm::Backward, Reduce::Mean, 2.0),
        (FftNorm::Forward, Reduce::Mean, 0.5),
        (FftNorm::Ortho, Reduce::Sum, 4.0),
        (FftNorm::Backward, Reduce::Sum, 8.0),
    ] {
        let (v, g) = value_and_grad(&a, &b, AmplitudeOptions { norm, reduce });
        assert_eq!(v, 1.5 * factor);
        assert!(g.iter().zip(&grad).all(|(g, m)| f64::from(*g) == f64::from(*m) * factor));
    }
}

#[test]
fn the_reference_gradient_is_the_derivative_of_the_reference() {
    for (w, h, c) in [(6, 5, 1), (7, 8, 3), (1, 11, 2), (12, 1, 1), (1, 1, 3)] {
        let a = Image64::from(&noise(w, h, c, 0.0, 1.0, 1));
        let b = Image64::from(&noise(w, h, c, 0.0, 1.0, 2));
        let (_, grad) = amplitude_loss64(&a, &b);
        let largest = grad.iter().fold(0.0f64, |m, g| m.max(g.abs()));
        for (i, slope) in grad.iter().enumerate() {
            let at = |h: f64| {
                let mut moved = a.clone();
                moved.data[i] += h;
                amplitude_loss64(&moved, &b).0
            };
            let numeric = (at(1e-6) - at(-1e-6)) / 2e-6;
            assert!((numeric - slope).abs() < 1e-6 * largest, "{w}x{h}x{c} at {i}: {numeric} {slope}");
        }
    }
}

#[test]
fn value_and_gradient_agree_with_the_reference_at_every_kind_of_size() {
    // Powers of two, mixed factors, primes on either side, one row, one column, one pixel.
    let sizes = [
        (32, 64, 3),
        (60, 50, 3),
        (37, 41, 3),
        (97, 30, 1),
        (24, 67, 2),
        (150, 137, 1),
        (1, 53, 3),
        (47, 1, 1),
        (1, 1, 4),
        (2, 3, 3),
    ];
    for (w, h, c) in sizes {
        for a in [noise(w, h, c, 0.0, 1.0, 5), with_noise(&scene(w, h, c), 0.05, 4)] {
            for amplitude in [0.02, 0.4] {
                let b = with_noise(&a, amplitude, 6);
                let (got, grad) = value_and_grad(&a, &b, AmplitudeOptions::default());
                let (want, slope) = amplitude_loss64(&Image64::from(&a), &Image64::from(&b));
                let (v, g) = ((got - want).abs(), relative_l2(&grad, &slope));
                println!("{w}x{h}x{c} noise {amplitude}: value {v:.1e} gradient {g:.1e}");
                assert!(v < VALUE && g < GRAD, "{w}x{h}x{c} noise {amplitude}: {v:e} {g:e}");
            }
        }
    }
}

/// The image whose pixel `(x, y)` is `at(x, y)` of this one.
fn rearranged(i: &Image, at: impl Fn(usize, usize) -> (usize, usize)) -> Image {
    let mut out = i.clone();
    for y in 0..i.height {
        for x in 0..i.width {
            let (u, v) = at(x, y);
            out.pixel_mut(x, y).copy_from_slice(i.pixel(u, v));
        }
    }
    out
}

#[test]
fn cyclic_shifts_and_rotations_by_180_degrees_give_zero() {
    for (w, h) in [(40, 36), (31, 43)] {
        let a = with_noise(&scene(w, h, 3), 0.1, 3);
        let shifted = rearranged(&a, |x, y| ((x + 5) % w, (y + 11) % h));
        let rotated = rearranged(&a, |x, y| (w - 1 - x, h - 1 - y));
        assert!(value(&a, &shifted) < ZERO && value(&a, &rotated) < ZERO);
        // A shift with repeated edge pixels is not cyclic.
        let cut = rearranged(&a, |x, y| ((x + 5).min(w - 1), y));
        assert!(value(&a, &cut) > 1e-3);
    }
}

#[test]
fn constant_images_have_only_the_gradient_of_their_mean() {
    for (w, h) in [(40, 30), (37, 29), (200, 101)] {
        let (a, b) = (constant(w, h, 3, 0.75), constant(w, h, 3, 0.25));
        let (v, grad) = value_and_grad(&a, &b, AmplitudeOptions::default());
        let n = (w * h) as f64;
        assert!((v / (0.5 / n.sqrt()) - 1.0).abs() < 1e-5, "{v}");
        let want = 1.0 / (n * n.sqrt() * 3.0);
        assert!(grad.iter().all(|g| (f64::from(*g) / want - 1.0).abs() < 1e-4), "{w}x{h}");
        let (none, flat) = value_and_grad(&a, &a, AmplitudeOptions::default());
        assert!(none == 0.0 && flat.iter().all(|g| *g == 0.0));
        let black = constant(w, h, 3, 0.0);
        let (_, flat) = value_and_grad(&black, &a, AmplitudeOptions::default());
        assert!(flat.iter().all(|g| *g == 0.0), "no phase, no gradient");
    }
}

#[test]
fn never_above_the_root_of_the_mean_squared_error() {
    for seed in 0..6 {
        let a = with_noise(&scene(33, 40, 3), 0.3, seed);
        for b in [scene(33, 40, 3), noise(33, 40, 3, 0.0, 1.0, 100 + seed), constant(33, 40, 3, 0.5)] {
            let (loss, rmse) = (value(&a, &b), mse(&a, &b).unwrap().sqrt());
            assert!(loss > 0.0 && loss <= rmse * (1.0 + 1e-6), "{loss} {rmse}");
        }
    }
}

#[test]
fn a_blur_weighs_more_here_than_in_l1() {
    let a = scene(96, 96, 3);
    let blurred = rearranged_mean(&a);
    let l1 = a.data.iter().zip(&blurred.data).map(|(p, q)| f64::from((p - q).abs())).sum::<f64>() / a.data.len() as f64;
    let noisy = with_noise(&a, 2.0 * l1 as f32, 9);
    let l1_noise =
        a.data.iter().zip(&noisy.data).map(|(p, q)| f64::from((p - q).abs())).sum::<f64>() / a.data.len() as f64;
    assert!(value(&blurred, &a) / l1 > 1.2 * value(&noisy, &a) / l1_noise);
}

/// Each pixel with its right and lower neighbours, averaged.
fn rearranged_mean(i: &Image) -> Image {
    let (w, h) = (i.width, i.height);
    let moved: Vec<Image> = [(0, 0), (1, 0), (0, 1), (1, 1)]
        .map(|(dx, dy)| rearranged(i, move |x, y| ((x + dx).min(w - 1), (y + dy).min(h - 1))))
        .into();
    let data = (0..i.data.len()).map(|k| moved.iter().map(|m| m.data[k]).sum::<f32>() / 4.0).collect();
    Image { data, ..i.clone() }
}

#[test]
fn the_same_bits_for_any_pool_and_for_reused_buffers() {
    let a = noise(83, 127, 3, 0.0, 1.0, 9);
    let b = with_noise(&a, 0.1, 10);
    let bits = |(v, g): (f64, Vec<f32>)| (v.to_bits(), g.iter().map(|g| g.to_bits()).collect::<Vec<_>>());
    let run = |threads| in_pool(threads, || bits(value_and_grad(&a, &b, AmplitudeOptions::default())));
    let one = run(1);
    assert!(one == run(2) && one == run(4));
    let (mut kept, mut grad) = (AmplitudeLoss::default(), Image::default());
    kept.value_and_grad(&noise(90, 40, 1, 0.0, 1.0, 2), &constant(90, 40, 1, 0.5), &mut grad).unwrap();
    let value = kept.value_and_grad(&a, &b, &mut grad).unwrap();
    assert!(bits((value, grad.data)) == one);
}

#[test]
fn bad_input_is_an_error_that_names_the_fault() {
    let a = noise(9, 7, 3, 0.0, 1.0, 1);
    let (mut loss, mut grad) = (AmplitudeLoss::default(), Image::default());
    for bad in [f32::NAN, f32::INFINITY] {
        let mut b = a.clone();
        b.data[3 * 9 * 2 + 4] = bad;
        let want = |which| MetricError::NotFinite { which, x: 1, y: 2, channel: 1 };
        assert_eq!(loss.value(&a, &b).unwrap_err(), want("b"));
        assert_eq!(loss.value_and_grad(&b, &a, &mut grad).unwrap_err(), want("a"));
    }
    assert!(matches!(loss.value(&a, &constant(9, 8, 3, 0.0)), Err(MetricError::Shape { .. })));
    assert!(matches!(loss.value(&Image::zeros(0, 3, 3), &Image::zeros(0, 3, 3)), Err(MetricError::TooSmall { .. })));
    assert!(matches!(loss.value(&a, &constant(9, 7, 3, 1e30)), Err(MetricError::Overflow { .. })));
}
