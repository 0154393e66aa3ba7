use super::*;
use crate::loss::{Dssim, GroundTruth, ImageLoss};
use gs_core::Rng;
use gs_data::ImageU8;

const SIZE: [usize; 2] = [40, 30];

/// A smooth frame, and its image in other colours.
fn pair() -> (Frame, ImageU8) {
    let [width, height] = SIZE;
    let mut rng = Rng::new(3, "exposure", 0, 0);
    let waves: Vec<[f32; 4]> = (0..9).map(|_| [0; 4].map(|_| rng.range(0.2, 0.6))).collect();
    let color = |x: usize, y: usize, c: usize| {
        let wave = |w: &[f32; 4]| (w[0] * x as f32 + w[1] * y as f32 + 9.0 * w[2]).sin() * w[3];
        0.5 + 0.3 * waves[3 * c..3 * c + 3].iter().map(wave).sum::<f32>()
    };
    let pixels = (0..width * height).map(|p| std::array::from_fn(|c| color(p % width, p / width, c)));
    let colors: Vec<[f32; 3]> = pixels.collect();
    let shot = |v: f32, c: usize| (255.0 * (0.8 + 0.05 * c as f32) * v).round().clamp(0.0, 255.0) as u8;
    let image = colors.iter().flat_map(|p| [shot(p[0], 0), shot(p[1], 1), shot(p[2], 2), 255]).collect();
    let rgb = Image { width, height, channels: 3, data: colors.into_iter().flatten().collect() };
    let (alpha, depth) = (vec![1.0; width * height], vec![2.0; width * height]);
    (Frame { rgb, alpha, depth }, ImageU8 { width, height, data: image })
}

fn truth<'a>(image: &'a ImageU8, mask: Option<&'a Image>, map: Option<ColorMap>) -> GroundTruth<'a> {
    let exposure = map.map(|map| ExposureFit { map, ridge: 1e-6, offset: map.offset != [0.0; 3] });
    GroundTruth { image, background: [0.0; 3], mask, depth: None, exposure }
}

#[test]
fn another_exposure_is_no_error_once_its_map_is_known() {
    let ((frame, image), mut grad) = (pair(), FrameGrad::default());
    let mut loss = ImageLoss::new(0.8).with(0.2, Dssim::Ssim.term());
    let mut of = |map| loss.evaluate(&frame, &truth(&image, None, map), &mut grad).unwrap();
    let (plain, first) = (of(None), of(Some(ColorMap::IDENTITY)));
    assert_eq!((first.l1, first.term("exposure"), plain.color_map), (plain.l1, Some(0.0), None));
    let fitted = of(first.color_map);
    assert!(plain.l1 > 0.06 && fitted.l1 < 2e-3, "{} {}", plain.l1, fitted.l1);
    assert!(fitted.term("exposure").unwrap() > 0.05);
}

/// The map is constant where the loss goes back.
#[test]
fn gradients_match_finite_differences_with_the_map_held() {
    let ((mut frame, image), mut grad) = (pair(), FrameGrad::default());
    let mut rng = Rng::new(4, "exposure", 0, 0);
    frame.rgb.data.iter_mut().for_each(|v| *v += rng.range(-0.1, 0.1));
    let [width, height] = SIZE;
    let inside = |p: usize| f32::from(u8::from(p % width < 25));
    let mask = Image { width, height, channels: 1, data: (0..width * height).map(inside).collect() };
    let mut loss = ImageLoss::new(0.8).with(0.2, Dssim::Ssim.term());
    for mask in [None, Some(&mask)] {
        let map = ColorMap::linear([[0.8, 0.1, 0.0], [0.0, 0.9, -0.1], [0.05, 0.0, 0.7]]);
        loss.evaluate(&frame, &truth(&image, mask, Some(map)), &mut grad).unwrap();
        for at in [3 * (7 * width + 11), 3 * (20 * width + 3) + 2, 3 * (9 * width + 33) + 1] {
            let h = 1e-3;
            let mut value = |by: f32| {
                let mut moved = frame.clone();
                moved.rgb.data[at] += by;
                map.apply(&mut moved.rgb);
                loss.evaluate(&moved, &truth(&image, mask, None), &mut FrameGrad::default()).unwrap().total
            };
            let want = (value(h) - value(-h)) / f64::from(2.0 * h);
            let got = f64::from(grad.rgb[at]);
            assert!((got - want).abs() < 2e-2 * want.abs() + 3e-7, "value {at}: {got} {want}");
        }
    }
}

/// Frames above saturated values are constants of the loss, for themselves and in the windows of their neighbours.
#[test]
fn gradients_match_finite_differences_where_images_are_saturated() {
    let ((mut frame, mut image), mut grad) = (pair(), FrameGrad::default());
    let [width, height] = SIZE;
    let mut paint = |x: usize, y: usize, color: [f32; 3], bytes: [u8; 3]| {
        let at = y * width + x;
        frame.rgb.data[3 * at..3 * at + 3].copy_from_slice(&color);
        image.data[4 * at..4 * at + 3].copy_from_slice(&bytes);
        3 * at
    };
    for k in 0..100 {
        paint(10 + k % 10, 8 + k / 10, [1.6; 3], [255; 3]);
    }
    let bright = paint(19, 12, [1.5, 1.7, 1.6], [255; 3]);
    let beside = paint(21, 12, [0.2; 3], [128; 3]);
    let red = paint(5, 20, [1.6, 0.2, 0.2], [255, 128, 128]);
    let inside = |p: usize| f32::from(u8::from(p % width < 25));
    let mask = Image { width, height, channels: 1, data: (0..width * height).map(inside).collect() };
    let map = ColorMap::linear([[0.8, 0.1, 0.0], [0.0, 0.9, -0.1], [0.05, 0.0, 0.7]]);
    let mut loss = ImageLoss::new(0.8).with(0.2, Dssim::Ssim.term());
    for mask in [None, Some(&mask)] {
        let truth = truth(&image, mask, Some(map));
        loss.evaluate(&frame, &truth, &mut grad).unwrap();
        assert_eq!(grad.rgb[bright..bright + 3], [0.0; 3]);
        assert!(grad.rgb[red..red + 3].iter().all(|g| *g != 0.0), "its green and blue are not saturated");
        for at in [bright, bright + 2, beside, beside + 1, red, red + 1, red + 2] {
            let h = 4e-3;
            let mut value = |by: f32| {
                let mut moved = frame.clone();
                moved.rgb.data[at] += by;
                loss.evaluate(&moved, &truth, &mut FrameGrad::default()).unwrap().total
            };
            let want = (value(h) - value(-h)) / f64::from(2.0 * h);
            let got = f64::from(grad.rgb[at]);
            assert!((got - want).abs() < 2e-2 * want.abs() + 1e-6, "value {at}: {got} {want}");
        }
    }
}

/// A frame over a background, half of which is seen, and its image.
fn pair_over(background: [f32; 3]) -> (Frame, ImageU8) {
    let (mut frame, mut image) = pair();
    let mut rng = Rng::new(5, "exposure", 0, 0);
    for (p, alpha) in frame.alpha.iter_mut().enumerate() {
        let byte = if p % 3 == 0 { 0 } else { rng.range(60.0, 250.0).round() as u8 };
        (*alpha, image.data[4 * p + 3]) = (f32::from(byte) / 255.0, byte);
        for (c, b) in background.into_iter().enumerate() {
            frame.rgb.data[3 * p + c] = *alpha * frame.rgb.data[3 * p + c] + (1.0 - *alpha) * b;
        }
    }
    (frame, image)
}

#[test]
fn a_background_keeps_its_colour() {
    let background = [1.0, 0.9, 0.2];
    let ((frame, image), mut grad) = (pair_over(background), FrameGrad::default());
    let mut loss = ImageLoss::new(0.8).with(0.2, Dssim::Ssim.term());
    let over = |map| GroundTruth { background, ..truth(&image, None, Some(map)) };
    let fitted = loss.evaluate(&frame, &over(ColorMap::IDENTITY), &mut grad).unwrap().color_map.unwrap();
    assert!(loss.evaluate(&frame, &over(fitted), &mut grad).unwrap().l1 < 2e-3);
}

/// With the map held: those of alpha, the colours of the frame being constant, and those of the colours.
#[test]
fn gradients_of_alpha_match_finite_differences() {
    let linear = ColorMap::linear([[0.8, 0.1, 0.0], [0.0, 0.7, -0.1], [0.05, 0.0, 1.3]]);
    let affine = ColorMap { offset: [0.3, 0.4, 0.25], ..linear };
    let over_three = [[0.0; 3], [1.0; 3], [0.4, 0.9, 0.2]].map(|background| (background, affine));
    for (background, map) in [&over_three[..], &[([1.0, 0.9, 0.2], linear)]].concat() {
        let ((frame, image), mut grad) = (pair_over(background), FrameGrad::default());
        let mut loss = ImageLoss::new(0.8).with(0.2, Dssim::Ssim.term());
        let truth = GroundTruth { background, ..truth(&image, None, Some(map)) };
        loss.evaluate(&frame, &truth, &mut grad).unwrap();
        for p in [7 * SIZE[0] + 12, 20 * SIZE[0] + 3, 9 * SIZE[0] + 34] {
            let mut slope = |push: &dyn Fn(&mut Frame, f32)| {
                let h = 1e-3;
                let [above, below] = [h, -h].map(|by| {
                    let mut moved = frame.clone();
                    push(&mut moved, by);
                    loss.evaluate(&moved, &truth, &mut FrameGrad::default()).unwrap().total
                });
                (above - below) / f64::from(2.0 * h)
            };
            let of_alpha = (grad.alpha[p], slope(&|frame, by| frame.alpha[p] += by));
            let of_red = (grad.rgb[3 * p], slope(&|frame, by| frame.rgb.data[3 * p] += by));
            for (got, want) in [of_alpha, of_red] {
                let got = f64::from(got);
                assert!((got - want).abs() < 2e-2 * want.abs() + 3e-7, "{background:?}, pixel {p}: {got} {want}");
            }
        }
    }
    // Before black, a linear map leaves what alpha is to the colours.
    let ((frame, image), mut grad) = (pair_over([0.0; 3]), FrameGrad::default());
    ImageLoss::new(1.0).evaluate(&frame, &truth(&image, None, Some(linear)), &mut grad).unwrap();
    assert!(grad.alpha.is_empty());
}

/// Images in which black is not black: an offset makes them no error, before any background.
#[test]
fn offsets_are_fitted_where_they_are_wanted() {
    for background in [[0.0; 3], [1.0; 3]] {
        let ((frame, mut image), mut grad) = (pair_over(background), FrameGrad::default());
        let shift = 12u8;
        for pixel in image.data.chunks_exact_mut(4) {
            pixel[..3].iter_mut().for_each(|v| *v = v.saturating_add(shift));
        }
        let mut loss = ImageLoss::new(1.0);
        let mut fitted = |offset: bool| {
            let mut of = |map| {
                let exposure = Some(ExposureFit { map, ridge: 1e-6, offset });
                let truth = GroundTruth { background, exposure, ..truth(&image, None, None) };
                loss.evaluate(&frame, &truth, &mut grad).unwrap()
            };
            let map = of(ColorMap::IDENTITY).color_map.unwrap();
            (map, of(map).l1)
        };
        let [(linear, without), (affine, with)] = [fitted(false), fitted(true)];
        assert!(linear.offset == [0.0; 3] && with < 2e-3 && 2.0 * with < without, "{background:?}: {without} {with}");
        let want = f64::from(shift) / 255.0;
        assert!(affine.offset.iter().all(|o| (o - want).abs() < 2e-3), "{background:?}: {affine:?}");
    }
}

/// Opaque in practice, the image overexposed: what it cut off over white tells no more than over black.
#[test]
fn saturated_colours_count_before_no_background() {
    let (gain, alpha, n) = (0.8f32, 0.9995f32, 64 * 64);
    for background in [[0.0; 3], [1.0; 3]] {
        let mut rng = Rng::new(6, "exposure", 0, 0);
        let shown: Vec<f32> = (0..3 * n).map(|_| rng.range(0.0, 1.6)).collect();
        let over = |v: f32| alpha * v + (1.0 - alpha) * background[0];
        let image = |data: Vec<f32>| Image { width: 64, height: 64, channels: 3, data };
        let target = image(shown.iter().map(|v| over(gain * v).min(1.0)).collect());
        let rgb = image(shown.into_iter().map(over).collect());
        let frame = Frame { rgb, alpha: vec![alpha; n], ..Frame::default() };
        let map = fit_before(&frame, background, &target, None, 1e-9, false, &mut Image::default()).unwrap();
        for c in 0..3 {
            assert!((map.matrix[c][c] - f64::from(gain)).abs() < 1e-3, "{background:?}: {:?}", map.matrix);
        }
    }
}

fn gains(of: [f64; 3]) -> ColorMap {
    ColorMap::linear([[of[0], 0.0, 0.0], [0.0, of[1], 0.0], [0.0, 0.0, of[2]]])
}

/// Whatever all maps have in common is the scene's to learn.
#[test]
fn the_mean_of_the_maps_stays_the_identity() {
    for offset in [[0.0; 3], [0.2, 0.1, -0.1]] {
        let mut exposures = Exposures::default();
        for k in 0..30 {
            let map = ColorMap { matrix: [[1.6, 0.1, 0.0], [0.0, 1.2, 0.1], [0.1, 0.0, 0.5]], offset };
            exposures.blend_in(k % 4, &map.blend(&ColorMap::IDENTITY, 0.2 * (k % 3) as f64), 4);
            let entries = |map: ColorMap| [map.matrix.as_flattened(), &map.offset].concat();
            let maps: Vec<Vec<f64>> = (0..4).map(|image| entries(exposures.map(image))).collect();
            for (at, want) in entries(ColorMap::IDENTITY).into_iter().enumerate() {
                let mean = maps.iter().map(|map| map[at]).sum::<f64>() / 4.0;
                assert!((mean - want).abs() < 1e-6, "entry {at}: {mean}");
            }
        }
        let [matrices, offsets] = exposures.values();
        assert_eq!((matrices.len(), offsets.len()), (36, if offset == [0.0; 3] { 0 } else { 12 }));
        assert_eq!(Exposures::of(matrices, offsets).map(2), exposures.map(2));
    }
    assert_eq!(Exposures::default().map(7), ColorMap::IDENTITY);
}

/// Maps of images that are lost in common cannot be undone, and stay.
#[test]
fn a_mean_without_an_inverse_changes_no_map() {
    let mut exposures = Exposures::default();
    let flat = ColorMap { matrix: [[-1.0, 0.0, 0.0], [0.0; 3], [0.0; 3]], offset: [0.5; 3] };
    exposures.blend_in(0, &flat, 1);
    assert_eq!(exposures.map(0), flat.blend(&ColorMap::IDENTITY, 0.5));
}

/// Once the scene has the mean colours, the maps are those of the images.
#[test]
fn maps_become_those_of_their_images() {
    let of = |image: usize| {
        let gain = 0.7 + 0.2 * image as f64;
        gains([gain, gain, 2.0 - gain])
    };
    let mut exposures = Exposures::default();
    (0..120).for_each(|k| exposures.blend_in(k % 4, &of(k % 4), 4));
    for image in 0..4 {
        let pairs = exposures
            .map(image)
            .matrix
            .as_flattened()
            .to_vec()
            .into_iter()
            .zip(of(image).matrix.as_flattened().to_vec());
        assert!(pairs.into_iter().all(|(got, want)| (got - want).abs() < 1e-3), "{:?}", exposures.map(image));
    }
}

#[test]
fn maps_begin_after_their_share_of_the_run() {
    let config = ExposureConfig { fit: true, after: 0.1, ridge: 1e-3, offset: false };
    assert_eq!([1, 100, 101, 1000].map(|step| config.at(step, 1000)), [None, None, Some(1e-3), Some(1e-3)]);
    assert_eq!(ExposureConfig::default().at(1000, 1000), None);
    assert_eq!(ExposureConfig { after: 0.0, ..config }.at(1, 1000), Some(1e-3));
}
