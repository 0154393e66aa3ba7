//! MS-SSIM against plain loops in `f64` and its gradient against central differences of those.
//!
//! | quantity | against | tolerance | why |
//! |---|---|---|---|
//! | value (f32) | reference | 1e-7 absolute | five levels of an error of 1e-8 |
//! | gradient (f32) | central differences (f64), h = 1e-4, sampled pixels | 1e-5 of its largest entry | pooled images are rounded to f32 |

use crate::images::*;
use crate::reference::*;
use gs_core::Image;
use gs_metrics::ms_ssim::WEIGHTS;
use gs_metrics::{MetricError, MsSsim, MsSsimOptions, ms_ssim};

const VALUE: f64 = 1e-7;
const GRAD: f64 = 1e-5;

/// Average pooling as `avg_pool2d(kernel 2, padding side mod 2)`.
fn halve64(i: &Image64) -> Image64 {
    let (pw, ph) = ((i.width % 2) as isize, (i.height % 2) as isize);
    let (w, h) = ((i.width + 2 * pw as usize) / 2, (i.height + 2 * ph as usize) / 2);
    let mut data = Vec::new();
    for y in 0..h as isize {
        for x in 0..w as isize {
            for c in 0..i.channels {
                let sum: f64 = [(0, 0), (1, 0), (0, 1), (1, 1)]
                    .iter()
                    .map(|(dx, dy)| i.at(2 * x - pw + dx, 2 * y - ph + dy, c))
                    .sum();
                data.push(sum / 4.0);
            }
        }
    }
    Image64 { width: w, height: h, channels: i.channels, data }
}

fn ms_ssim64(a: &Image64, b: &Image64, levels: usize) -> f64 {
    let total: f64 = if levels == 5 { 1.0 } else { WEIGHTS[..levels].iter().sum() };
    let (mut a, mut b) = (a.clone(), b.clone());
    let mut products = vec![1.0; a.channels];
    for (l, weight) in WEIGHTS[..levels].iter().enumerate() {
        for (product, (full, contrast)) in products.iter_mut().zip(ssim64(&a, &b, 5)) {
            let factor: f64 = if l + 1 == levels { full } else { contrast };
            *product *= factor.max(0.0).powf(weight / total);
        }
        (a, b) = (halve64(&a), halve64(&b));
    }
    products.iter().sum::<f64>() / products.len() as f64
}

#[test]
fn value_agrees_with_the_reference() {
    for (w, h, c) in [(161, 176, 1), (167, 163, 3), (192, 181, 3)] {
        let a = scene(w, h, c);
        for amplitude in [0.02, 0.3] {
            let b = with_noise(&a, amplitude, 3);
            let got = ms_ssim(&a, &b, &MsSsimOptions::default()).unwrap();
            let want = ms_ssim64(&Image64::from(&a), &Image64::from(&b), 5);
            assert!((got - want).abs() < VALUE, "{w}x{h}x{c}: {got} {want}");
        }
    }
}

#[test]
fn gradient_agrees_with_central_differences() {
    for (w, h, c, levels) in [(25, 23, 3, 2), (47, 44, 1, 3), (11, 12, 2, 1)] {
        let a = with_noise(&scene(w, h, c), 0.1, 1);
        let b = with_noise(&a, 0.2, 2);
        let options = MsSsimOptions::reduced(levels);
        let mut grad = Image::default();
        let value = MsSsim::new(options).value_and_grad(&a, &b, &mut grad).unwrap();
        let (a64, b64) = (Image64::from(&a), Image64::from(&b));
        assert!((value - ms_ssim64(&a64, &b64, levels)).abs() < VALUE);
        let largest = grad.data.iter().fold(0.0f32, |m, g| m.max(g.abs()));
        for i in (0..a.data.len()).step_by(41) {
            let at = |step: f64| {
                let mut moved = a64.clone();
                moved.data[i] += step;
                ms_ssim64(&moved, &b64, levels)
            };
            let numeric = (at(1e-4) - at(-1e-4)) / 2e-4;
            let error = (numeric - f64::from(grad.data[i])).abs();
            assert!(error < GRAD * f64::from(largest), "{w}x{h} value {i}: {numeric} {}", grad.data[i]);
        }
    }
}

#[test]
fn five_levels_descend_along_the_gradient() {
    let a = with_noise(&scene(170, 165, 3), 0.05, 1);
    let b = scene(170, 165, 3);
    let mut grad = Image::default();
    let mut metric = MsSsim::new(MsSsimOptions::default());
    let value = metric.value_and_grad(&a, &b, &mut grad).unwrap();
    let norm2: f64 = grad.data.iter().map(|g| f64::from(*g).powi(2)).sum();
    let step = 1e-4 / norm2;
    let moved = a.data.iter().zip(&grad.data).map(|(v, g)| v + step as f32 * g).collect();
    let gained = metric.value(&Image { data: moved, ..a.clone() }, &b).unwrap() - value;
    assert!((gained / 1e-4 - 1.0).abs() < 0.02, "{gained}");
}

#[test]
fn identical_clamped_and_too_small() {
    let a = scene(161, 161, 3);
    let mut grad = Image::default();
    assert_eq!(MsSsim::new(MsSsimOptions::default()).value_and_grad(&a, &a, &mut grad).unwrap(), 1.0);
    let strong = noise(161, 161, 3, 0.0, 1.0, 4);
    let negative = Image { data: strong.data.iter().map(|v| 1.0 - v).collect(), ..strong.clone() };
    assert_eq!(MsSsim::new(MsSsimOptions::default()).value_and_grad(&strong, &negative, &mut grad).unwrap(), 0.0);
    assert!(grad.data.iter().all(|g| *g == 0.0));
    let small = scene(160, 300, 3);
    let e = ms_ssim(&small, &small, &MsSsimOptions::default()).unwrap_err();
    assert!(matches!(e, MetricError::TooSmall { need: 161, width: 160, .. }), "{e}");
    assert_eq!(ms_ssim(&small, &small, &MsSsimOptions::reduced(4)).unwrap(), 1.0);
    for levels in [0, 6] {
        let e = ms_ssim(&a, &a, &MsSsimOptions::reduced(levels)).unwrap_err();
        assert!(matches!(e, MetricError::Option { name: "levels", .. }), "{e}");
    }
    let mut bad = a.clone();
    bad.data[0] = f32::NAN;
    assert!(matches!(ms_ssim(&bad, &a, &MsSsimOptions::default()), Err(MetricError::NotFinite { which: "a", .. })));
}

#[test]
fn the_same_bits_for_any_pool() {
    let a = scene(211, 197, 3);
    let b = with_noise(&a, 0.1, 5);
    let run = |threads| {
        in_pool(threads, || {
            let mut grad = Image::default();
            let value = MsSsim::new(MsSsimOptions::default()).value_and_grad(&a, &b, &mut grad).unwrap();
            (value.to_bits(), grad.data.iter().map(|g| g.to_bits()).collect::<Vec<_>>())
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(4));
}
