use super::*;
use gs_core::Rng;

fn noise(seed: u64, width: usize, height: usize) -> Image {
    let mut rng = Rng::new(seed, "color-map", 0, 0);
    Image { width, height, channels: 3, data: (0..3 * width * height).map(|_| rng.uniform()).collect() }
}

const WARM: ColorMap = ColorMap::linear([[1.2, 0.05, 0.0], [0.02, 1.0, -0.03], [0.0, 0.1, 0.8]]);
const HAZY: ColorMap =
    ColorMap { matrix: [[0.7, 0.05, 0.0], [0.02, 0.6, -0.03], [0.0, 0.1, 0.65]], offset: [0.1, 0.15, 0.2] };

fn assert_near(a: &ColorMap, b: &ColorMap, by: f64) {
    let entries = |map: &ColorMap| [map.matrix.as_flattened(), &map.offset].concat();
    let pairs = entries(a).into_iter().zip(entries(b));
    assert!(pairs.into_iter().all(|(a, b)| (a - b).abs() < by), "{a:?} {b:?}");
}

#[test]
fn a_map_is_found_where_pixels_count() {
    let image = noise(1, 130, 71);
    let mut truth = image.clone();
    WARM.apply(&mut truth);
    assert_near(&ColorMap::fit(&image, &truth, None, 1e-12).unwrap(), &WARM, 1e-5);
    let mut mask = Image { width: 130, height: 71, channels: 1, data: vec![1.0; 130 * 71] };
    for p in (0..mask.data.len()).filter(|p| p % 3 == 0) {
        mask.data[p] = 0.0;
        truth.data[3 * p..3 * p + 3].fill(7.0);
    }
    assert_near(&ColorMap::fit(&image, &truth, Some(&mask), 1e-12).unwrap(), &WARM, 1e-5);
    mask.data.fill(0.0);
    assert_eq!(ColorMap::fit(&image, &truth, Some(&mask), 1e-12).unwrap(), ColorMap::IDENTITY);
}

/// A colour of `noise` premultiplied by an alpha of its own, in several chunks.
fn premultiplied() -> (Image, Vec<f32>) {
    let (mut image, mut alpha) = (noise(10, 130, 71), noise(11, 130, 71).data);
    alpha.truncate(130 * 71);
    for (pixel, a) in image.data.chunks_exact_mut(3).zip(&alpha) {
        pixel.iter_mut().for_each(|v| *v *= a);
    }
    (image, alpha)
}

#[test]
fn an_offset_is_found_where_pixels_count() {
    let (image, alpha) = premultiplied();
    let mut truth = image.clone();
    HAZY.apply_premultiplied(&mut truth, &alpha);
    let fit =
        |truth: &Image, mask: Option<&Image>| ColorMap::fit_with_offset(&image, &alpha, truth, mask, 1e-9).unwrap();
    assert_near(&fit(&truth, None), &HAZY, 1e-5);
    assert!(ColorMap::fit(&image, &truth, None, 1e-9).unwrap().offset == [0.0; 3]);
    assert_eq!(fit(&image, None), ColorMap::IDENTITY);
    let mut mask = Image { width: 130, height: 71, channels: 1, data: vec![1.0; 130 * 71] };
    for p in (0..mask.data.len()).filter(|p| p % 3 == 0) {
        mask.data[p] = 0.0;
        truth.data[3 * p..3 * p + 3].fill(0.9);
    }
    // Saturated pixels do not count either.
    truth.data[3..6].fill(SATURATED);
    assert_near(&fit(&truth, Some(&mask)), &HAZY, 1e-5);
    mask.data.fill(0.0);
    assert_eq!(fit(&truth, Some(&mask)), ColorMap::IDENTITY);
    let far = ColorMap::fit_with_offset(&image, &alpha, &truth, None, 1e6).unwrap();
    assert_near(&far, &ColorMap::IDENTITY, 1e-5);
}

/// The part of a map that images tell nothing of is that of the identity.
#[test]
fn even_images_leave_an_offset_finite() {
    let image = |color: [f32; 3]| Image { width: 40, height: 40, channels: 3, data: color.repeat(1600) };
    let (black, grey, noisy) = (image([0.0; 3]), image([0.5, 0.4, 0.3]), noise(12, 40, 40));
    let fit = |from: &Image, alpha: f32, to: &Image, ridge| {
        ColorMap::fit_with_offset(from, &[alpha; 1600], to, None, ridge).unwrap()
    };
    for ridge in [1e-9, 1e-3] {
        assert_eq!(fit(&black, 0.0, &noisy, ridge), ColorMap::IDENTITY, "nothing is there to be mapped");
        assert_eq!(fit(&black, 1.0, &black, ridge), ColorMap::IDENTITY);
        // Four numbers for a row of one equation, those nearest to the identity.
        let map = fit(&grey, 1.0, &image([0.6; 3]), ridge);
        let mut mapped = grey.clone();
        map.apply(&mut mapped);
        assert!(mapped.data.iter().all(|v| (v - 0.6).abs() < 1e-3), "{ridge}: {map:?}");
        let nearest = [0.1, 0.2, 0.3].map(|change| change / (0.5 * 0.5 + 0.4 * 0.4 + 0.3 * 0.3 + 1.0));
        assert!(map.offset.iter().zip(nearest).all(|(o, n)| (o - n).abs() < 2e-3), "{ridge}: {map:?}");
        // No part of the image tells of an even ground truth.
        let flat = fit(&noisy, 1.0, &grey, ridge);
        assert!(flat.matrix.as_flattened().iter().chain(&flat.offset).all(|v| v.abs() < 0.6), "{ridge}: {flat:?}");
    }
}

#[test]
fn the_ridge_pulls_to_the_identity() {
    let image = noise(2, 40, 40);
    let mut truth = image.clone();
    WARM.apply(&mut truth);
    let away = |ridge| {
        let map = ColorMap::fit(&image, &truth, None, ridge).unwrap();
        let off = |m: &ColorMap| (m.matrix[0][0] - 1.0).powi(2) + (m.matrix[2][2] - 1.0).powi(2);
        off(&map)
    };
    assert!(away(1e-6) > away(0.1) && away(0.1) > away(10.0) && away(1e6) < 1e-6);
    assert_near(&ColorMap::fit(&image, &image, None, 1e-3).unwrap(), &ColorMap::IDENTITY, 1e-9);
    // An even image tells three numbers of nine.
    let even = Image { data: vec![0.5; image.data.len()], ..image.clone() };
    let dark = Image { data: vec![0.4; image.data.len()], ..image };
    let mut mapped = even.clone();
    ColorMap::fit(&even, &dark, None, 1e-6).unwrap().apply(&mut mapped);
    assert!(mapped.data.iter().all(|v| (v - 0.4).abs() < 1e-4));
}

/// A map that makes the squared error least: no change of an entry makes it less.
#[test]
fn the_solution_is_the_least() {
    let (image, truth) = (noise(3, 20, 15), noise(4, 20, 15));
    let (ridge, mut alpha) = (0.01, noise(13, 20, 15).data);
    alpha.truncate(300);
    let cost = |map: &ColorMap| {
        let mut mapped = image.clone();
        map.apply_premultiplied(&mut mapped, &alpha);
        let error: f64 = mapped.data.iter().zip(&truth.data).map(|(a, b)| f64::from(a - b).powi(2)).sum();
        let off = map.matrix.as_flattened().iter().zip(ColorMap::IDENTITY.matrix.as_flattened());
        let offset = map.offset.iter().map(|o| o.powi(2)).sum::<f64>();
        error + ridge * 300.0 * (off.map(|(a, b)| (a - b).powi(2)).sum::<f64>() + offset)
    };
    let linear = ColorMap::fit(&image, &truth, None, ridge).unwrap();
    let affine = ColorMap::fit_with_offset(&image, &alpha, &truth, None, ridge).unwrap();
    assert!(linear.offset == [0.0; 3] && cost(&affine) < cost(&linear));
    for (best, entries) in [(linear, 9_usize), (affine, 12)] {
        for (k, h) in (0..entries).flat_map(|k| [(k, -0.01), (k, 0.01)]) {
            let mut other = best;
            match k {
                9.. => other.offset[k - 9] += h,
                _ => other.matrix.as_flattened_mut()[k] += h,
            }
            assert!(cost(&other) > cost(&best), "entry {k}");
        }
    }
}

#[test]
fn the_pull_back_is_the_transpose_and_threads_change_nothing() {
    let (image, d) = (noise(5, 90, 77), noise(6, 90, 77));
    let (mut mapped, mut back) = (image.clone(), d.data.clone());
    WARM.apply(&mut mapped);
    WARM.pull_back(&mut back);
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
    assert!((dot(&mapped.data, &d.data) / dot(&image.data, &back) - 1.0).abs() < 1e-6);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let alpha = &d.data[..90 * 77];
        pool.install(|| {
            let affine = ColorMap::fit_with_offset(&image, alpha, &d, None, 1e-3).unwrap();
            (ColorMap::fit(&image, &d, None, 1e-3).unwrap(), affine)
        })
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn maps_follow_each_other_and_are_undone() {
    let image = noise(8, 5, 4);
    let cold = ColorMap { matrix: [[0.7, 0.0, 0.1], [0.0, 0.9, 0.0], [0.1, 0.0, 1.1]], offset: [0.05, 0.0, -0.1] };
    let (mut steps, mut once) = (image.clone(), image.clone());
    cold.apply(&mut steps);
    HAZY.apply(&mut steps);
    HAZY.after(&cold).apply(&mut once);
    assert!(steps.data.iter().zip(&once.data).all(|(a, b)| (a - b).abs() < 1e-6));
    for map in [WARM, HAZY] {
        assert_near(&map.inverse().unwrap().after(&map), &ColorMap::IDENTITY, 1e-12);
        assert_near(&map.after(&map.inverse().unwrap()), &ColorMap::IDENTITY, 1e-12);
    }
    assert_eq!(ColorMap::linear([[0.3; 3]; 3]).inverse(), None);
    assert_near(&WARM.blend(&cold, 0.0), &WARM, 1e-15);
    assert_near(&WARM.blend(&cold, 1.0), &cold, 1e-15);
}

#[test]
fn what_cannot_be_fitted_is_refused() {
    let image = noise(7, 8, 8);
    let grey = Image::zeros(8, 8, 1);
    assert!(matches!(ColorMap::fit(&image, &noise(8, 8, 9), None, 1.0), Err(MetricError::Shape { .. })));
    assert!(matches!(ColorMap::fit(&grey, &grey, None, 1.0), Err(MetricError::Shape { .. })));
    assert!(matches!(ColorMap::fit(&image, &image, Some(&Image::zeros(7, 8, 1)), 1.0), Err(MetricError::Shape { .. })));
    let mut bad = image.clone();
    bad.data[5] = f32::NAN;
    assert!(matches!(ColorMap::fit(&bad, &image, None, 1.0), Err(MetricError::NotFinite { .. })));
    let with = |alpha: &[f32]| ColorMap::fit_with_offset(&image, alpha, &image, None, 1.0).unwrap_err();
    assert!(matches!(with(&[1.0; 63]), MetricError::Malformed { which: "alpha", len: 63, .. }));
    let mut alpha = [1.0; 64];
    alpha[10] = f32::NAN;
    assert_eq!(with(&alpha), MetricError::NotFinite { which: "alpha", x: 2, y: 1, channel: 0 });
}

#[test]
fn the_strength_is_what_colours_change() {
    assert_eq!(ColorMap::IDENTITY.strength(), 0.0);
    let image = noise(9, 300, 300);
    let mut mapped = image.clone();
    HAZY.apply(&mut mapped);
    let mean = image.data.iter().zip(&mapped.data).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
    assert!(((mean / image.data.len() as f64).sqrt() / HAZY.strength() - 1.0).abs() < 0.02);
}
