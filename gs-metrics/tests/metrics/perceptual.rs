//! The perceptual proxy orders distortions as people do: on generated images, and on public ones from the shared folder.

use crate::data::iqa_image;
use crate::distort::*;
use crate::images::{in_pool, noise, scene};
use gs_core::Image;
use gs_metrics::{MetricError, SsimOptions, perceptual_proxy, psnr, ssim};

fn proxy(a: &Image, b: &Image) -> f64 {
    perceptual_proxy(a, b).unwrap()
}

/// Checks that a series of distortions grows, and prints it.
fn grows(what: &str, truth: &Image, series: &[f32], distort: impl Fn(&Image, f32) -> Image) {
    let values: Vec<f64> = series.iter().map(|s| proxy(&distort(truth, *s), truth)).collect();
    println!("{what}: {series:?} -> {values:.4?}");
    assert!(values[0] > 0.0 && values.windows(2).all(|v| v[1] > v[0]), "{what}: {values:?}");
}

fn all_sweeps_grow(truth: &Image) {
    grows("blur", truth, &[0.4, 0.6, 1.0, 1.5, 2.5, 4.0], blur);
    grows("noise", truth, &[0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4], gaussian_noise);
    grows("8x8 coding", truth, &[0.02, 0.04, 0.08, 0.15, 0.3], quantised_dct);
    grows("blocks", truth, &[2.0, 4.0, 8.0, 16.0], |i, s| blocks(i, s as isize));
    grows("shift", truth, &[1.0, 2.0, 4.0, 8.0], |i, s| shift(i, s as isize));
    grows("warp", truth, &[1.0, 2.0, 4.0, 8.0], |i, s| warp(i, s, 64.0));
    grows("contrast", truth, &[0.95, 0.9, 0.7, 0.4], |i, s| tone(i, s, 0.0));
    grows("brightness", truth, &[0.02, 0.05, 0.1], |i, s| tone(i, 1.0, s));
}

/// The distortion of the family whose PSNR is that of `target`, by bisection; PSNR falls with `strength`.
fn at_equal_psnr(truth: &Image, target: f64, mut low: f32, mut high: f32, f: impl Fn(f32) -> Image) -> Image {
    for _ in 0..9 {
        let middle = (low * high).sqrt();
        if psnr(&f(middle), truth).unwrap() > target {
            low = middle;
        } else {
            high = middle;
        }
    }
    f(low)
}

/// A slight shift or warp is at a much smaller distance than blur, noise and coding of the same squared error.
fn shifts_are_tolerated(truth: &Image) {
    for moved in [shift(truth, 1), warp(truth, 1.5, 64.0)] {
        let target = psnr(&moved, truth).unwrap();
        let same_error = [
            ("blur", at_equal_psnr(truth, target, 0.2, 16.0, |s| blur(truth, s))),
            ("noise", at_equal_psnr(truth, target, 1e-3, 1.0, |s| gaussian_noise(truth, s))),
            ("coding", at_equal_psnr(truth, target, 1e-3, 2.0, |s| quantised_dct(truth, s))),
        ];
        let near = proxy(&moved, truth);
        for (what, image) in same_error {
            let far = proxy(&image, truth);
            println!("at {target:.2} dB: moved {near:.4}, {what} {far:.4}");
            assert!(far > 1.3 * near, "{what} at {target:.2} dB: {far} against {near}");
        }
    }
}

#[test]
fn generated_images_are_ordered() {
    let truth = textured(160, 150);
    all_sweeps_grow(&truth);
    shifts_are_tolerated(&truth);
    let negative = tone(&truth, -1.0, 1.0);
    assert!(proxy(&negative, &truth) > proxy(&blur(&truth, 1.0), &truth), "light and dark are distinguished");
}

/// [`scene`] with fine grain, so that blur removes detail everywhere.
fn textured(w: usize, h: usize) -> Image {
    let grain = blur(&noise(w, h, 3, -1.0, 1.0, 3), 0.7);
    let data = scene(w, h, 3).data.iter().zip(&grain.data).map(|(p, g)| (p + 0.12 * g).clamp(0.0, 1.0)).collect();
    Image { width: w, height: h, channels: 3, data }
}

#[test]
fn public_images_are_ordered() {
    for name in ["chelsea.png", "I01.BMP"] {
        let Some(whole) = iqa_image(name) else { return };
        let truth = crop(&whole, 120, 60, 200, 180);
        all_sweeps_grow(&truth);
        shifts_are_tolerated(&truth);
    }
}

#[test]
fn the_published_triple_is_ordered_as_people_do() {
    let names = ["lpips_ex_ref.png", "lpips_ex_p0.png", "lpips_ex_p1.png"];
    let [Some(truth), Some(blurred), Some(warped)] = names.map(iqa_image) else { return };
    let s = |i: &Image| (psnr(i, &truth).unwrap(), ssim(i, &truth, &SsimOptions::published()).unwrap());
    assert!(s(&blurred).0 > s(&warped).0 && s(&blurred).1 > s(&warped).1, "pixelwise scores prefer the blurred one");
    let (far, near) = (proxy(&blurred, &truth), proxy(&warped, &truth));
    println!("proxy: blurred {far:.4}, warped {near:.4}");
    assert!(far > 1.3 * near, "{far} {near}");
}

#[test]
fn strong_noise_is_further_than_small_changes() {
    let [Some(truth), Some(noisy)] = ["I01.BMP", "i01_01_5.bmp"].map(iqa_image) else { return };
    let far = proxy(&noisy, &truth);
    println!("noise of the published pair: {far:.4}");
    let small = [blur(&truth, 0.4), gaussian_noise(&truth, 0.01), quantised_dct(&truth, 0.03), shift(&truth, 1)];
    for image in small {
        assert!(proxy(&image, &truth) < 0.5 * far);
    }
}

#[test]
fn a_bounded_symmetric_distance() {
    for (w, h, c) in [(1, 1, 1), (1, 40, 3), (40, 1, 3), (7, 5, 3), (13, 17, 1), (31, 37, 3), (127, 131, 3)] {
        let (a, b) = (noise(w, h, c, 0.0, 1.0, 1), noise(w, h, c, 0.0, 1.0, 2));
        let (zero, one) = (noise(w, h, c, 0.0, 0.0, 1), noise(w, h, c, 1.0, 1.0, 1));
        for (x, y) in [(&a, &b), (&zero, &one), (&a, &zero), (&b, &one)] {
            let d = proxy(x, y);
            assert!(d > 0.0 && d <= 1.0, "{w}x{h}: {d}");
            assert_eq!(d.to_bits(), proxy(y, x).to_bits());
            assert_eq!(proxy(x, x), 0.0);
        }
    }
    for n in 1..=40 {
        let (a, b) = (noise(n, 41 - n, 3, 0.0, 1.0, 1), noise(n, 41 - n, 3, 0.0, 1.0, 2));
        assert!((0.0..=1.0).contains(&proxy(&a, &b)));
    }
}

#[test]
fn the_same_bits_for_any_pool() {
    let a = textured(149, 211);
    let b = gaussian_noise(&a, 0.05);
    let [one, two, four] = [1, 2, 4].map(|n| in_pool(n, || proxy(&a, &b).to_bits()));
    assert!(one == two && one == four);
}

#[test]
fn the_distance_does_not_change_under_rotation() {
    let a = textured(96, 96);
    let b = blur(&a, 1.0);
    let rotate = |i: &Image| {
        let mut out = Image::zeros(i.height, i.width, 3);
        for y in 0..i.height {
            (0..i.width).for_each(|x| out.pixel_mut(i.height - 1 - y, x).copy_from_slice(i.pixel(x, y)));
        }
        out
    };
    let (plain, rotated) = (proxy(&a, &b), proxy(&rotate(&a), &rotate(&b)));
    assert!((plain / rotated - 1.0).abs() < 0.01, "{plain} {rotated}");
}

#[test]
fn bad_input_is_an_error_that_names_the_fault() {
    let a = noise(20, 20, 3, 0.0, 1.0, 1);
    let mut bad = a.clone();
    bad.data[61] = f32::NAN;
    assert_eq!(perceptual_proxy(&a, &bad).unwrap_err(), MetricError::NotFinite { which: "b", x: 0, y: 1, channel: 1 });
    let huge = noise(20, 20, 3, 1e30, 2e30, 1);
    assert!(matches!(perceptual_proxy(&a, &huge), Err(MetricError::Overflow { .. })));
    let four = noise(20, 20, 4, 0.0, 1.0, 1);
    assert!(matches!(perceptual_proxy(&four, &four), Err(MetricError::Channels { got: 4, .. })));
    assert!(matches!(perceptual_proxy(&a, &noise(20, 21, 3, 0.0, 1.0, 1)), Err(MetricError::Shape { .. })));
}
