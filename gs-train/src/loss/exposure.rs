//! Images of one scene with exposures and white balances of their own. Every image has a linear map of colours, as in Hierarchical 3D Gaussians (Kerbl et
//! al. 2024), which learns affine ones by gradients. Here each is found by least squares whenever its image is drawn.
//!
//! ```text
//! loss of image k:   E_k x against y          x: frame, y: image k, E_k constant
//! then               E_k ← ½ (E_k + M_k)      M_k: the map from x to y (gs_metrics::ColorMap)
//! and                E_j ← E_j Ē⁻¹            for all images j: their mean stays the identity
//! ```
//! A background is no part of the scene and keeps its colour: `x` and `y` are what is before it, `1 − α` of it being seen, and it is added again after the map.
//! The last line holds the colours of the scene: brighter splats and darker maps would give the same images. Saturated values of an image are met by anything
//! above them, which then counts as they do and has no gradient.

use gs_core::Image;
use gs_metrics::color_map::SATURATED;
use gs_metrics::{ColorMap, MetricError};
use gs_raster::{Frame, FrameGrad};
use serde::{Deserialize, Serialize};

/// Section `[schedule.exposure]` of a configuration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExposureConfig {
    /// Whether frames are mapped to the colours of their image before they are compared.
    pub fit: bool,
    /// Share of the run after which they are.
    pub after: f64,
    /// What holds the maps near the identity ([`ColorMap::fit`]), above 0.
    pub ridge: f64,
}

impl Default for ExposureConfig {
    /// Frames are compared as they are.
    fn default() -> Self {
        Self { fit: false, after: 0.0, ridge: 1.0 }
    }
}

impl ExposureConfig {
    /// The ridge of the maps in a step, from 1, of so many; none where frames are compared as they are.
    pub(crate) fn at(&self, step: u32, steps: u32) -> Option<f64> {
        let share = f64::from(step.saturating_sub(1)) / f64::from(steps.max(1));
        (self.fit && share >= self.after).then_some(self.ridge)
    }
}

/// How a frame is mapped to the colours of its image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExposureFit {
    /// The map of the image.
    pub map: ColorMap,
    /// What holds the map that is fitted anew near the identity.
    pub ridge: f64,
}

/// A frame in the colours of its image, with buffers kept between calls.
#[derive(Default)]
pub(super) struct Mapped {
    /// Its colours.
    pub(super) colors: Image,
    /// Where a saturated value of the image took the place of one above it: there they are constants.
    met: Vec<usize>,
}

/// Adds `by` times what is seen of a background to the colours of a frame of this alpha.
fn add_background(colors: &mut Image, alpha: &[f32], background: [f32; 3], by: f32) {
    if background == [0.0; 3] {
        return;
    }
    for (pixel, alpha) in colors.data.as_chunks_mut::<3>().0.iter_mut().zip(alpha) {
        pixel.iter_mut().zip(background).for_each(|(v, b)| *v += by * (1.0 - alpha) * b);
    }
}

/// The map that brings what `frame` shows before a background nearest to what `target` shows there ([`ColorMap::fit`]). `colors` becomes what the frame shows.
pub(crate) fn fit_before(
    frame: &Frame,
    background: [f32; 3],
    target: &Image,
    mask: Option<&Image>,
    ridge: f64,
    colors: &mut Image,
) -> Result<ColorMap, MetricError> {
    colors.clone_from(&frame.rgb);
    if background == [0.0; 3] {
        return ColorMap::fit(colors, target, mask, ridge);
    }
    let mut shown = target.clone();
    [&mut *colors, &mut shown].into_iter().for_each(|image| add_background(image, &frame.alpha, background, -1.0));
    // Saturated colours stay so: they tell the map nothing.
    for ((shown, target), alpha) in shown.data.chunks_exact_mut(3).zip(target.data.chunks_exact(3)).zip(&frame.alpha) {
        if *alpha > 0.0 && target.iter().any(|y| *y >= SATURATED) {
            shown.fill(SATURATED);
        }
    }
    ColorMap::fit(colors, &shown, mask, ridge)
}

/// Maps what a frame shows before a background, and puts it before the background again.
pub(crate) fn map_before(map: &ColorMap, frame: &Frame, background: [f32; 3], colors: &mut Image) {
    map.apply(colors);
    add_background(colors, &frame.alpha, background, 1.0);
}

impl Mapped {
    /// From the gradient with respect to its colours, to that with respect to colours and alpha of the frame: with colours `x`, mapped ones
    /// `E x + (1 − α) (b − E b)`.
    pub(super) fn pull_back(&self, map: &ColorMap, background: [f32; 3], grad: &mut FrameGrad) {
        self.met.iter().for_each(|&at| grad.rgb[at] = 0.0);
        if background != [0.0; 3] {
            let mut mapped = Image { width: 1, height: 1, channels: 3, data: background.to_vec() };
            map.apply(&mut mapped);
            let slope: [f32; 3] = std::array::from_fn(|c| mapped.data[c] - background[c]);
            let of = |g: &[f32; 3]| g.iter().zip(slope).map(|(g, s)| g * s).sum::<f32>();
            grad.alpha.clear();
            grad.alpha.extend(grad.rgb.as_chunks().0.iter().map(of));
        }
        map.pull_back(&mut grad.rgb);
    }
}

impl ExposureFit {
    /// Writes a frame in the colours of `target` to `mapped`, both over `background`; gives the map that fits best.
    pub(super) fn apply(
        &self,
        frame: &Frame,
        background: [f32; 3],
        target: &Image,
        mask: Option<&Image>,
        mapped: &mut Mapped,
    ) -> Result<ColorMap, MetricError> {
        let Mapped { colors, met } = mapped;
        let best = fit_before(frame, background, target, mask, self.ridge, colors)?;
        map_before(&self.map, frame, background, colors);
        met.clear();
        for (at, (v, y)) in colors.data.iter_mut().zip(&target.data).enumerate() {
            if *y >= SATURATED && *v > *y {
                *v = *y;
                met.push(at);
            }
        }
        Ok(best)
    }
}

/// Share of a new map in that of its image.
const NEW: f64 = 0.5;

/// The maps of all training images, row by row; empty before the first was fitted.
#[derive(Clone, Debug, Default)]
pub(crate) struct Exposures(Vec<[f32; 9]>);

impl Exposures {
    /// From the values of a checkpoint.
    pub(crate) fn of(values: &[f32]) -> Self {
        Self(values.as_chunks().0.to_vec())
    }

    /// For a checkpoint.
    pub(crate) fn values(&self) -> &[f32] {
        self.0.as_flattened()
    }

    /// The map of an image.
    pub(crate) fn map(&self, image: usize) -> ColorMap {
        self.0.get(image).map_or(ColorMap::IDENTITY, map_of)
    }

    /// Forgets all maps unless they are of so many images: those of another number are others.
    pub(crate) fn keep_of(&mut self, images: usize) {
        if self.0.len() != images {
            self.0.clear();
        }
    }

    /// Another map was fitted to an image, of so many.
    pub(crate) fn blend_in(&mut self, image: usize, map: &ColorMap, images: usize) {
        self.keep_of(images);
        self.0.resize(images, rows_of(&ColorMap::IDENTITY));
        self.0[image] = rows_of(&self.map(image).blend(map, NEW));
        let mean = |k: usize| self.0.iter().map(|map| f64::from(map[k])).sum::<f64>() / images as f64;
        let mean = ColorMap { matrix: std::array::from_fn(|row| std::array::from_fn(|c| mean(3 * row + c))) };
        if let Some(undo) = mean.inverse() {
            self.0.iter_mut().for_each(|map| *map = rows_of(&map_of(map).after(&undo)));
        }
    }
}

fn map_of(rows: &[f32; 9]) -> ColorMap {
    ColorMap { matrix: std::array::from_fn(|row| std::array::from_fn(|c| f64::from(rows[3 * row + c]))) }
}

#[expect(clippy::cast_possible_truncation, reason = "colours are single precision")]
fn rows_of(map: &ColorMap) -> [f32; 9] {
    std::array::from_fn(|k| map.matrix.as_flattened()[k] as f32)
}

#[cfg(test)]
mod tests {
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
        let exposure = map.map(|map| ExposureFit { map, ridge: 1e-6 });
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
            let map = ColorMap { matrix: [[0.8, 0.1, 0.0], [0.0, 0.9, -0.1], [0.05, 0.0, 0.7]] };
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
        let map = ColorMap { matrix: [[0.8, 0.1, 0.0], [0.0, 0.9, -0.1], [0.05, 0.0, 0.7]] };
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

    /// A frame and its image over white, half of which is seen.
    #[test]
    fn a_background_keeps_its_colour() {
        let ((mut frame, mut image), mut grad) = (pair(), FrameGrad::default());
        let background = [1.0, 0.9, 0.2];
        let mut rng = Rng::new(5, "exposure", 0, 0);
        for (p, alpha) in frame.alpha.iter_mut().enumerate() {
            let byte = if p % 3 == 0 { 0 } else { rng.range(60.0, 250.0).round() as u8 };
            (*alpha, image.data[4 * p + 3]) = (f32::from(byte) / 255.0, byte);
            for (c, b) in background.into_iter().enumerate() {
                frame.rgb.data[3 * p + c] = *alpha * frame.rgb.data[3 * p + c] + (1.0 - *alpha) * b;
            }
        }
        let mut loss = ImageLoss::new(0.8).with(0.2, Dssim::Ssim.term());
        let over = |map| GroundTruth { background, ..truth(&image, None, Some(map)) };
        let fitted = loss.evaluate(&frame, &over(ColorMap::IDENTITY), &mut grad).unwrap().color_map.unwrap();
        assert!(loss.evaluate(&frame, &over(fitted), &mut grad).unwrap().l1 < 2e-3);
        // The slope of alpha with the map held, colours being constant.
        let map = ColorMap { matrix: [[0.8, 0.1, 0.0], [0.0, 0.7, -0.1], [0.05, 0.0, 1.3]] };
        loss.evaluate(&frame, &over(map), &mut grad).unwrap();
        let slopes = grad.alpha.clone();
        for p in [7 * SIZE[0] + 12, 20 * SIZE[0] + 3, 9 * SIZE[0] + 34] {
            let h = 1e-3;
            let mut value = |by: f32| {
                let mut moved = frame.clone();
                moved.alpha[p] += by;
                loss.evaluate(&moved, &over(map), &mut FrameGrad::default()).unwrap().total
            };
            let want = (value(h) - value(-h)) / f64::from(2.0 * h);
            let got = f64::from(slopes[p]);
            assert!((got - want).abs() < 2e-2 * want.abs() + 3e-7, "pixel {p}: {got} {want}");
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
            let map = fit_before(&frame, background, &target, None, 1e-9, &mut Image::default()).unwrap();
            for c in 0..3 {
                assert!((map.matrix[c][c] - f64::from(gain)).abs() < 1e-3, "{background:?}: {:?}", map.matrix);
            }
        }
    }

    fn gains(of: [f64; 3]) -> ColorMap {
        ColorMap { matrix: [[of[0], 0.0, 0.0], [0.0, of[1], 0.0], [0.0, 0.0, of[2]]] }
    }

    /// Whatever all maps have in common is the scene's to learn.
    #[test]
    fn the_mean_of_the_maps_stays_the_identity() {
        let mut exposures = Exposures::default();
        for k in 0..30 {
            let map = ColorMap { matrix: [[1.6, 0.1, 0.0], [0.0, 1.2, 0.1], [0.1, 0.0, 0.5]] };
            exposures.blend_in(k % 4, &map.blend(&ColorMap::IDENTITY, 0.2 * (k % 3) as f64), 4);
            for (row, c) in (0..9).map(|k| (k / 3, k % 3)) {
                let mean = (0..4).map(|image| exposures.map(image).matrix[row][c]).sum::<f64>() / 4.0;
                assert!((mean - ColorMap::IDENTITY.matrix[row][c]).abs() < 1e-6, "{mean}");
            }
        }
        assert_eq!(Exposures::of(exposures.values()).map(2), exposures.map(2));
        assert_eq!(Exposures::default().map(7), ColorMap::IDENTITY);
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
        let config = ExposureConfig { fit: true, after: 0.1, ridge: 1e-3 };
        assert_eq!([1, 100, 101, 1000].map(|step| config.at(step, 1000)), [None, None, Some(1e-3), Some(1e-3)]);
        assert_eq!(ExposureConfig::default().at(1000, 1000), None);
        assert_eq!(ExposureConfig { after: 0.0, ..config }.at(1, 1000), Some(1e-3));
    }
}
