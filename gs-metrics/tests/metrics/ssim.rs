//! SSIM against plain loops in `f64`, its gradient against central differences, and the cases where variances cancel.
//!
//! | quantity | against | tolerance | why |
//! |---|---|---|---|
//! | reference gradient (f64) | central differences (f64), h = 1e-5 | 1e-7 of its largest entry | h² and rounding |
//! | value (f32) | reference | 5e-8 absolute | a sum of small terms; worst seen 9e-9 |
//! | value, flat images | reference | 5e-8 absolute | the variances do not cancel; worst seen 3e-8 |
//! | gradient (f32) | reference | 1e-6 relative L2 | worst seen 5e-7 |
//! | gradient, flat images that differ | reference | 1e-3 relative L2 | `d·G∗v − G∗(v·μd)` cancels; worst seen 3e-4 |

use crate::images::*;
use crate::reference::*;
use gs_core::Image;
use gs_metrics::{MetricError, Padding, Ssim, SsimOptions, ssim};

const VALUE: f64 = 5e-8;
const GRAD: f64 = 1e-6;
const GRAD_FLAT: f64 = 1e-3;

fn options(margin: usize) -> SsimOptions {
    let padding = if margin == 0 { Padding::Zero } else { Padding::Valid };
    SsimOptions { padding, ..SsimOptions::default() }
}

/// Value and gradient errors of one pair.
fn errors(a: &Image, b: &Image, margin: usize) -> (f64, f64) {
    let (a64, b64) = (Image64::from(a), Image64::from(b));
    let mut grad = Image::default();
    let value = Ssim::new(options(margin)).value_and_grad(a, b, &mut grad).unwrap();
    let plain = ssim(a, b, &options(margin)).unwrap();
    assert_eq!(value.to_bits(), plain.to_bits(), "the value does not depend on the gradient being asked for");
    let value_error = (value - mean_ssim64(&a64, &b64, margin)).abs();
    (value_error, relative_l2(&grad.data, &ssim_grad64(&a64, &b64, margin)))
}

#[test]
fn the_reference_gradient_is_the_derivative_of_the_reference() {
    for (c, margin) in [(1, 0), (3, 0), (1, 5), (3, 5)] {
        let a = noise(14, 13, c, 0.0, 1.0, 3);
        let (a64, b64) = (Image64::from(&a), Image64::from(&with_noise(&a, 0.3, 4)));
        let grad = ssim_grad64(&a64, &b64, margin);
        let largest = grad.iter().fold(0.0f64, |m, g| m.max(g.abs()));
        for i in (0..a.data.len()).step_by(5) {
            let at = |h: f64| {
                let mut moved = a64.clone();
                moved.data[i] += h;
                mean_ssim64(&moved, &b64, margin)
            };
            let numeric = (at(1e-5) - at(-1e-5)) / 2e-5;
            assert!((numeric - grad[i]).abs() < 1e-7 * largest, "{i}: {numeric} {}", grad[i]);
        }
    }
}

#[test]
fn value_and_gradient_agree_with_the_reference() {
    for (w, h, c, margin) in [(61, 47, 3, 0), (61, 47, 3, 5), (37, 83, 1, 0), (33, 131, 1, 5), (20, 300, 2, 0)] {
        for a in [noise(w, h, c, 0.0, 1.0, 5), scene(w, h, c)] {
            for amplitude in [0.003, 0.05, 0.5] {
                let (value, grad) = errors(&a, &with_noise(&a, amplitude, 6), margin);
                println!("{w}x{h}x{c} noise {amplitude}: value {value:.1e} gradient {grad:.1e}");
                assert!(value < VALUE && grad < GRAD, "{w}x{h}x{c} noise {amplitude}: {value:e} {grad:e}");
            }
        }
    }
}

#[test]
fn every_small_size_and_tail() {
    for n in 1..=40 {
        let (w, h) = (n, 41 - n);
        let a = noise(w, h, 3, 0.0, 1.0, n as u64);
        let b = with_noise(&a, 0.2, 7);
        let (value, grad) = errors(&a, &b, 0);
        assert!(value < VALUE && grad < GRAD, "{w}x{h}: {value:e} {grad:e}");
        if w >= 11 && h >= 11 {
            let (value, grad) = errors(&a, &b, 5);
            assert!(value < VALUE && grad < GRAD, "valid {w}x{h}: {value:e} {grad:e}");
        }
    }
}

#[test]
fn flat_images_do_not_cancel() {
    for (x, y) in [(1.0, 1.0), (1.0, 0.9), (0.7, 0.0), (1.0, 0.0), (0.3, 0.301)] {
        for margin in [0, 5] {
            let (a, b) = (constant(40, 30, 3, x), constant(40, 30, 3, y));
            let (value, grad) = errors(&a, &b, margin);
            assert!(value < VALUE, "{x} against {y}, margin {margin}: {value:e}");
            let bound = if x == y { f64::INFINITY } else { GRAD_FLAT };
            println!("flat {x} against {y}, margin {margin}: value {value:.1e} gradient {grad:.1e}");
            assert!(grad < bound, "{x} against {y}, margin {margin}: {grad:e}");
            let near = with_noise(&a, 1e-3, 8);
            let (value, grad) = errors(&near, &b, margin);
            println!("near {x} against {y}, margin {margin}: value {value:.1e} gradient {grad:.1e}");
            assert!(value < VALUE && grad < GRAD_FLAT, "near {x} against {y}: {value:e} {grad:e}");
        }
    }
}

#[test]
fn identical_images_score_exactly_one_with_no_gradient() {
    for (image, margin) in [(constant(30, 30, 3, 0.9), 0), (noise(31, 29, 3, 0.0, 1.0, 1), 5), (scene(40, 40, 1), 0)] {
        let mut grad = Image::default();
        assert_eq!(Ssim::new(options(margin)).value_and_grad(&image, &image, &mut grad).unwrap(), 1.0);
        assert!(grad.data.iter().all(|g| g.abs() < 1e-9));
    }
}

#[test]
fn symmetric_and_bounded() {
    let (a, b) = (noise(50, 40, 3, 0.0, 1.0, 1), noise(50, 40, 3, 0.0, 1.0, 2));
    let forth = ssim(&a, &b, &options(0)).unwrap();
    assert_eq!(forth.to_bits(), ssim(&b, &a, &options(0)).unwrap().to_bits());
    let negative = Image { data: a.data.iter().map(|v| 1.0 - v).collect(), ..a.clone() };
    let opposite = ssim(&a, &negative, &options(0)).unwrap();
    assert!((-1.0..0.0).contains(&opposite) && forth < 0.3, "{opposite} {forth}");
}

#[test]
fn the_same_bits_for_any_pool_and_for_reused_buffers() {
    let a = noise(83, 271, 3, 0.0, 1.0, 9);
    let b = with_noise(&a, 0.1, 10);
    let run = |threads| {
        in_pool(threads, || {
            let mut grad = Image::default();
            let value = Ssim::new(options(0)).value_and_grad(&a, &b, &mut grad).unwrap();
            (value.to_bits(), grad.data.iter().map(|g| g.to_bits()).collect::<Vec<_>>())
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(4));
    let mut kept = Ssim::new(options(0));
    let other = noise(97, 40, 1, 0.0, 1.0, 2);
    let mut grad = Image::default();
    kept.value_and_grad(&other, &constant(97, 40, 1, 0.5), &mut grad).unwrap();
    let value = kept.value_and_grad(&a, &b, &mut grad).unwrap();
    assert_eq!(value.to_bits(), one.0);
    assert!(grad.data.iter().map(|g| g.to_bits()).eq(one.1));
}

#[test]
fn bad_input_is_an_error_that_names_the_fault() {
    let a = noise(20, 20, 3, 0.0, 1.0, 1);
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for at in [0, 599, 1199] {
            let mut b = a.clone();
            b.data[at] = bad;
            for margin in [0, 5] {
                let want = MetricError::NotFinite { which: "b", x: at / 3 % 20, y: at / 60, channel: at % 3 };
                assert_eq!(ssim(&a, &b, &options(margin)).unwrap_err(), want);
            }
        }
    }
    let huge = constant(20, 20, 3, 1e30);
    assert_eq!(ssim(&a, &huge, &options(0)).unwrap_err(), MetricError::Overflow { metric: "SSIM" });
    assert!(matches!(ssim(&a, &constant(20, 19, 3, 0.0), &options(0)), Err(MetricError::Shape { .. })));
    let small = constant(10, 30, 3, 0.0);
    assert!(matches!(ssim(&small, &small, &options(5)), Err(MetricError::TooSmall { need: 11, .. })));
    for bad in [0.0, f64::NAN, 1e9] {
        let o = SsimOptions { k2: bad, ..SsimOptions::default() };
        assert!(matches!(ssim(&a, &a, &o), Err(MetricError::Option { name: "k2", .. })));
    }
}

#[test]
fn data_range_scales() {
    let a = noise(30, 30, 3, 0.0, 1.0, 1);
    let b = with_noise(&a, 0.2, 2);
    let big = |i: &Image| Image { data: i.data.iter().map(|v| v * 256.0).collect(), ..i.clone() };
    let wide = SsimOptions { data_range: 256.0, ..SsimOptions::default() };
    let (unit, scaled) = (ssim(&a, &b, &options(0)).unwrap(), ssim(&big(&a), &big(&b), &wide).unwrap());
    assert!((unit - scaled).abs() < 1e-6);
}
