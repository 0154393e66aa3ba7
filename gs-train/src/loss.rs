//! The image loss of the 3DGS family and its gradient:
//!
//! ```text
//! L = ω mean|x − y| + λ (1 − SSIM(x, y)) + φ mean||F x| − |F y|| + μ L_mrf        ω = 1 − λ unless it is given
//! dL/dx = ω sign(x − y) / n − λ dSSIM/dx + φ dL_fre/dx + μ dL_mrf/dx
//! ```
//! over `n = H · W · 3` values; SSIM with an 11-tap Gaussian window and zero padding, or MS-SSIM in its place,
//! `sign(0) = 0` (Kerbl et al. 2023, section 5; λ = 0.2). `F` is the orthonormal Fourier transform of the whole image
//! (FAGS, eq. 10; φ = 0.3; see [`gs_metrics::spectrum`]). `L_mrf` compares textures over the box of what the photograph shows
//! (DUT; μ = 0.01; see [`gs_metrics::mrf`], whose own features stand for VGG-19's). Terms of weight 0 are not computed.

use crate::schedule::ScheduleError;
use gs_core::Image;
use gs_data::ImageU8;
use gs_metrics::mrf::{FeatureNet, Mrf, MrfOptions};
use gs_metrics::{AmplitudeLoss, MetricError, MsSsim, MsSsimOptions, Ssim, SsimOptions};
use gs_raster::{Frame, FrameGrad};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Values per parallel piece; partial sums are added in the order of pieces.
const PIECE: usize = 1 << 14;
/// Values summed in `f32` before `f64` takes over.
const RUN: usize = 512;
/// Independent sums, so that the compiler may use vectors.
const LANES: usize = 16;

/// The likeness of structure that stands beside L1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Dssim {
    /// SSIM with zeros outside the image.
    #[default]
    Ssim,
    /// The same over the box of what the photograph shows (DUT: the person's), with zeros outside the box.
    SsimBox,
    /// MS-SSIM of five levels; both sides need more than 160 pixels.
    MsSsim,
}

impl Dssim {
    /// Verifies that images of `width` times `height` pixels can be compared.
    ///
    /// # Errors
    /// If a side is too short.
    pub fn check_size(self, width: u32, height: u32) -> Result<(), ScheduleError> {
        let side = width.min(height);
        if self != Dssim::MsSsim || side as usize > MsSsimOptions::default().side_limit() {
            return Ok(());
        }
        let rule = "ms_ssim needs training images with both sides above 160 pixels; use \"ssim\" or larger images";
        Err(ScheduleError { field: "dssim".to_owned(), value: side.into(), rule })
    }
}

/// Weights of the terms.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LossWeights {
    /// λ, `[0, 1]`.
    pub dssim: f32,
    /// What λ weighs.
    pub structure: Dssim,
    /// ω, at least 0; `1 − λ` if absent.
    pub l1: Option<f32>,
    /// φ, at least 0.
    pub fre: f32,
    /// μ, at least 0.
    pub mrf: f32,
    /// Side of the square that `L_mrf` resizes its box to, pixels.
    pub mrf_side: u32,
    /// The box of [`Dssim::SsimBox`] and of `L_mrf`; the whole image if absent.
    pub region: Option<Region>,
}

/// A rectangle of pixels; `high` is the first row and column beyond it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// Column and row of the first pixel.
    pub low: [usize; 2],
    /// Column and row behind the last pixel.
    pub high: [usize; 2],
}

impl Region {
    /// The smallest that holds all pixels of some opacity; none if there is no such pixel.
    pub fn shown(image: &ImageU8) -> Option<Self> {
        let opaque = (0..image.data.len() / 4).filter(|i| image.data[4 * i + 3] > 0);
        opaque.map(|i| [i % image.width, i / image.width]).fold(None, |found, [x, y]| {
            let Self { low, high } = found.unwrap_or(Self { low: [x, y], high: [x, y] });
            Some(Self { low: [low[0].min(x), low[1].min(y)], high: [high[0].max(x + 1), high[1].max(y + 1)] })
        })
    }

    fn crop(self, from: &Image, to: &mut Image) {
        let ([x0, y0], [x1, y1], c) = (self.low, self.high, from.channels);
        (to.width, to.height, to.channels) = (x1 - x0, y1 - y0, c);
        to.data.clear();
        (y0..y1)
            .for_each(|y| to.data.extend_from_slice(&from.data[(y * from.width + x0) * c..(y * from.width + x1) * c]));
    }

    /// `from`, of the region's size, into zeros of the shape of `like`.
    fn paste(self, from: &Image, like: &Image, to: &mut Image) {
        (to.width, to.height, to.channels) = like.shape();
        to.data.clear();
        to.data.resize(like.data.len(), 0.0);
        let ([x0, y0], width) = (self.low, from.width * from.channels);
        for (y, row) in from.data.chunks_exact(width.max(1)).enumerate() {
            to.data[((y0 + y) * like.width + x0) * like.channels..][..width].copy_from_slice(row);
        }
    }
}

impl LossWeights {
    /// ω.
    fn of_l1(&self) -> f32 {
        self.l1.unwrap_or(1.0 - self.dssim)
    }
}

/// The terms of one evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize)]
pub struct LossTerms {
    /// `ω L1 + λ (1 − SSIM) + φ L_fre + μ L_mrf`.
    pub total: f64,
    /// Mean absolute difference.
    pub l1: f64,
    /// Mean squared difference.
    pub mse: f64,
    /// Mean SSIM, or MS-SSIM where that is asked for; absent at λ = 0.
    pub ssim: Option<f64>,
    /// Mean difference of amplitudes; absent at φ = 0.
    pub fre: Option<f64>,
    /// Likeness of textures; absent at μ = 0.
    pub mrf: Option<f64>,
}

/// The image loss, with buffers kept between calls.
#[derive(Default)]
pub struct ImageLoss {
    ssim: Ssim,
    ms_ssim: MsSsim,
    amplitudes: AmplitudeLoss,
    rendered: Image,
    target: Image,
    ssim_grad: Image,
    fre_grad: Image,
    /// With the side it resizes to.
    mrf: Option<(u32, Mrf)>,
    mrf_grad: Image,
    /// Rendered frame, ground truth and gradient within a region.
    cropped: [Image; 3],
}

impl ImageLoss {
    /// An evaluator with empty buffers.
    pub fn new() -> Self {
        Self { ssim: Ssim::new(SsimOptions::default()), ..Self::default() }
    }

    /// The loss of a frame against a ground-truth image over `background`, its gradient with respect to the frame's colours
    /// written into `grad.rgb` (alpha and depth: none).
    ///
    /// # Errors
    /// If the shapes differ, a side is too short for MS-SSIM, or a value is not finite.
    pub fn evaluate(
        &mut self,
        frame: &mut Frame,
        ground_truth: &ImageU8,
        background: [f32; 3],
        weights: &LossWeights,
        grad: &mut FrameGrad,
    ) -> Result<LossTerms, MetricError> {
        let mut target = std::mem::take(&mut self.target);
        ground_truth.over_into(background, &mut target);
        let terms = self.evaluate_against(frame, &target, weights, grad);
        self.target = target;
        terms
    }

    /// The same against an image of three channels.
    fn evaluate_against(
        &mut self,
        frame: &mut Frame,
        target: &Image,
        weights: &LossWeights,
        grad: &mut FrameGrad,
    ) -> Result<LossTerms, MetricError> {
        // The frame's pixels are lent to an image for the time of the call.
        let data = std::mem::take(&mut frame.rgb);
        self.rendered = Image { width: frame.width, height: frame.height, channels: 3, data };
        let terms = self.terms(target, weights, grad);
        frame.rgb = std::mem::take(&mut self.rendered.data);
        terms
    }

    fn terms(&mut self, target: &Image, weights: &LossWeights, grad: &mut FrameGrad) -> Result<LossTerms, MetricError> {
        let (first, second) = (self.rendered.shape(), target.shape());
        if first != second {
            return Err(MetricError::Shape { what: "rendered frame and ground truth", first, second });
        }
        let (drawn, lambda, phi, mu) = (&self.rendered, weights.dssim, weights.fre, weights.mrf);
        let all = Region { low: [0; 2], high: [drawn.width, drawn.height] };
        let region = weights.region.unwrap_or(all);
        let ssim = match weights.structure {
            _ if lambda <= 0.0 => None,
            Dssim::Ssim => Some(self.ssim.value_and_grad(drawn, target, &mut self.ssim_grad)?),
            Dssim::SsimBox => {
                let [a, b, d] = &mut self.cropped;
                region.crop(drawn, a);
                region.crop(target, b);
                let value = self.ssim.value_and_grad(a, b, d)?;
                region.paste(d, drawn, &mut self.ssim_grad);
                Some(value)
            }
            Dssim::MsSsim => Some(self.ms_ssim.value_and_grad(drawn, target, &mut self.ssim_grad)?),
        };
        let fre = match phi > 0.0 {
            true => Some(self.amplitudes.value_and_grad(drawn, target, &mut self.fre_grad)?),
            false => None,
        };
        let mrf = match mu > 0.0 {
            true => {
                let side = weights.mrf_side;
                if self.mrf.as_ref().is_none_or(|kept| kept.0 != side) {
                    let options = MrfOptions { side: side as usize, ..MrfOptions::default() };
                    self.mrf = Some((side, Mrf::new(FeatureNet::fixed_bank(), options)?));
                }
                let [a, b, d] = &mut self.cropped;
                region.crop(drawn, a);
                region.crop(target, b);
                let value = self.mrf.as_ref().map(|kept| kept.1.value_and_grad(a, b, d)).transpose()?;
                region.paste(d, drawn, &mut self.mrf_grad);
                value.map(|terms| terms.total)
            }
            false => None,
        };
        let data = &self.rendered.data;
        grad.alpha.clear();
        grad.depth.clear();
        grad.rgb.resize(data.len(), 0.0);
        let step = weights.of_l1() / data.len() as f32;
        let [ssim_grad, fre_grad, mrf_grad] =
            [&self.ssim_grad, &self.fre_grad, &self.mrf_grad].map(|g| g.data.as_slice());
        let pairs = data.par_chunks(PIECE).zip(target.data.par_chunks(PIECE));
        let pieces = grad.rgb.par_chunks_mut(PIECE).zip(pairs).enumerate();
        let sums: Vec<[f64; 2]> = pieces
            .map(|(i, (g, (x, y)))| {
                let sums = l1_piece(x, y, step, g);
                if ssim.is_some() {
                    g.iter_mut().zip(&ssim_grad[i * PIECE..]).for_each(|(g, s)| *g -= lambda * s);
                }
                if fre.is_some() {
                    g.iter_mut().zip(&fre_grad[i * PIECE..]).for_each(|(g, f)| *g += phi * f);
                }
                if mrf.is_some() {
                    g.iter_mut().zip(&mrf_grad[i * PIECE..]).for_each(|(g, m)| *g += mu * m);
                }
                sums
            })
            .collect();
        let n = data.len() as f64;
        let [l1, mse] = sums.iter().fold([0.0; 2], |a, s| [a[0] + s[0] / n, a[1] + s[1] / n]);
        let weight = f64::from(lambda);
        let spectral = fre.map_or(0.0, |f| f64::from(phi) * f);
        let textural = mrf.map_or(0.0, |m| f64::from(mu) * m);
        let total = f64::from(weights.of_l1()) * l1 + ssim.map_or(0.0, |s| weight * (1.0 - s)) + spectral + textural;
        if !total.is_finite() {
            // The exact place comes from the metric's own check.
            return Err(gs_metrics::mse(&self.rendered, target)
                .err()
                .unwrap_or(MetricError::Overflow { metric: "L1" }));
        }
        Ok(LossTerms { total, l1, mse, ssim, fre, mrf })
    }
}

/// Sums of absolute and squared differences; `step · sign(x − y)` goes to `grad`.
fn l1_piece(x: &[f32], y: &[f32], step: f32, grad: &mut [f32]) -> [f64; 2] {
    let mut sums = [0.0f64; 2];
    for ((x, y), grad) in x.chunks(RUN).zip(y.chunks(RUN)).zip(grad.chunks_mut(RUN)) {
        for ((x, y), g) in x.iter().zip(y).zip(grad) {
            *g = sign(x - y) * step;
        }
        // Short sums in f32 lanes, long ones in f64.
        let mut lanes = [[0.0f32; LANES]; 2];
        for (x, y) in x.chunks(LANES).zip(y.chunks(LANES)) {
            for (i, (x, y)) in x.iter().zip(y).enumerate() {
                let d = x - y;
                lanes[0][i] += d.abs();
                lanes[1][i] += d * d;
            }
        }
        for (sum, lanes) in sums.iter_mut().zip(lanes) {
            *sum += lanes.iter().map(|&v| f64::from(v)).sum::<f64>();
        }
    }
    sums
}

fn sign(d: f32) -> f32 {
    f32::from(i8::from(d > 0.0) - i8::from(d < 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    fn pair() -> (Frame, Image) {
        pair_of(37, 23)
    }

    fn plain(dssim: f32) -> LossWeights {
        LossWeights { dssim, ..LossWeights::default() }
    }

    fn pair_of(width: usize, height: usize) -> (Frame, Image) {
        let mut rng = Rng::new(1, "loss", 0, 0);
        let mut noise = || (0..width * height * 3).map(|_| rng.uniform()).collect::<Vec<f32>>();
        let frame = Frame { width, height, rgb: noise(), ..Frame::default() };
        (frame, Image { width, height, channels: 3, data: noise() })
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let (mut frame, target) = pair();
        let (mut loss, mut grad) = (ImageLoss::new(), FrameGrad::default());
        for weights in [0.0, 0.2, 1.0].map(plain) {
            loss.evaluate_against(&mut frame, &target, &weights, &mut grad).unwrap();
            for at in [0, 100, 1000, 2552] {
                let mut value = |h: f32| {
                    let mut moved = frame.clone();
                    moved.rgb[at] += h;
                    loss.evaluate_against(&mut moved, &target, &weights, &mut FrameGrad::default()).unwrap().total
                };
                let h = 0.25 * (frame.rgb[at] - target.data[at]).abs().min(0.02);
                let want = (value(h) - value(-h)) / f64::from(2.0 * h);
                let error = (f64::from(grad.rgb[at]) - want).abs();
                assert!(error < 1e-2 * want.abs() + 2e-7, "{weights:?}, value {at}: {} {want}", grad.rgb[at]);
            }
        }
    }

    #[test]
    fn terms_are_the_definitions_and_the_frame_is_given_back() {
        let (mut frame, target) = pair();
        let before = frame.clone();
        let mut grad = FrameGrad::default();
        let terms = ImageLoss::new().evaluate_against(&mut frame, &target, &plain(0.2), &mut grad).unwrap();
        assert_eq!(frame, before);
        let n = target.data.len() as f64;
        let differences = frame.rgb.iter().zip(&target.data).map(|(a, b)| f64::from(*a) - f64::from(*b));
        let (l1, mse) = differences.fold((0.0, 0.0), |s, d| (s.0 + d.abs() / n, s.1 + d * d / n));
        assert!((terms.l1 / l1 - 1.0).abs() < 1e-6 && (terms.mse / mse - 1.0).abs() < 1e-6);
        assert!((terms.total - 0.8 * terms.l1 - 0.2 * (1.0 - terms.ssim.unwrap())).abs() < 1e-7);
        let same = Image { data: frame.rgb.clone(), ..target };
        let none = ImageLoss::new().evaluate_against(&mut frame, &same, &plain(0.0), &mut grad).unwrap();
        assert_eq!((none.total, none.ssim, none.fre), (0.0, None, None));
        assert!(grad.rgb.iter().all(|&g| g == 0.0), "sign(0) = 0");
    }

    #[test]
    fn the_spectral_term_is_added_with_its_weight() {
        let (mut frame, target) = pair();
        let (mut grad, mut both, mut alone) = (FrameGrad::default(), FrameGrad::default(), Image::default());
        let without = ImageLoss::new().evaluate_against(&mut frame, &target, &plain(0.2), &mut grad).unwrap();
        let weights = LossWeights { fre: 0.3, ..plain(0.2) };
        let with = ImageLoss::new().evaluate_against(&mut frame, &target, &weights, &mut both).unwrap();
        let drawn = Image { data: frame.rgb.clone(), ..target.clone() };
        let fre = AmplitudeLoss::default().value_and_grad(&drawn, &target, &mut alone).unwrap();
        assert_eq!((without.fre, with.fre, with.ssim), (None, Some(fre), without.ssim));
        assert_eq!(with.total, without.total + f64::from(0.3f32) * fre);
        let sums = grad.rgb.iter().zip(&alone.data).map(|(g, f)| g + 0.3 * f);
        assert!(both.rgb.iter().zip(sums).all(|(b, s)| *b == s));
    }

    #[test]
    fn likeness_of_textures_is_added_over_the_box() {
        let (mut frame, target) = pair();
        let region = Region { low: [3, 5], high: [30, 21] };
        let (mut grad, mut both, mut alone) = (FrameGrad::default(), FrameGrad::default(), Image::default());
        let off = LossWeights { mrf_side: 16, region: Some(region), ..plain(0.2) };
        let without = ImageLoss::new().evaluate_against(&mut frame, &target, &off, &mut grad).unwrap();
        let with = ImageLoss::new()
            .evaluate_against(&mut frame, &target, &LossWeights { mrf: 0.3, ..off }, &mut both)
            .unwrap();
        let drawn = Image { data: frame.rgb.clone(), ..target.clone() };
        let [mut a, mut b] = [Image::default(), Image::default()];
        region.crop(&drawn, &mut a);
        region.crop(&target, &mut b);
        let options = MrfOptions { side: 16, ..MrfOptions::default() };
        let mrf =
            Mrf::new(FeatureNet::fixed_bank(), options).unwrap().value_and_grad(&a, &b, &mut alone).unwrap().total;
        assert_eq!((without.mrf, with.mrf, with.ssim), (None, Some(mrf), without.ssim));
        assert_eq!(with.total, without.total + f64::from(0.3f32) * mrf);
        assert!(alone.data.iter().any(|g| *g != 0.0));
        for (k, (g, without)) in both.rgb.iter().zip(&grad.rgb).enumerate() {
            let (x, y) = (k / 3 % 37, k / 3 / 37);
            let inside = (3..30).contains(&x) && (5..21).contains(&y);
            let more = if inside { 0.3 * alone.pixel(x - 3, y - 5)[k % 3] } else { 0.0 };
            assert_eq!(*g, without + more, "({x}, {y})");
        }
        let small = LossWeights { mrf: 0.3, mrf_side: 4, ..off };
        assert!(ImageLoss::new().evaluate_against(&mut frame, &target, &small, &mut grad).is_err());
    }

    #[test]
    fn within_a_box_only_the_box_is_looked_at() {
        let region = Region { low: [3, 5], high: [30, 21] };
        let (mut frame, target) = pair();
        let (mut grad, mut alone) = (FrameGrad::default(), Image::default());
        let weights = LossWeights { structure: Dssim::SsimBox, region: Some(region), ..plain(1.0) };
        let terms = ImageLoss::new().evaluate_against(&mut frame, &target, &weights, &mut grad).unwrap();
        let drawn = Image { data: frame.rgb.clone(), ..target.clone() };
        let [mut a, mut b] = [Image::default(), Image::default()];
        region.crop(&drawn, &mut a);
        region.crop(&target, &mut b);
        let value = Ssim::new(SsimOptions::default()).value_and_grad(&a, &b, &mut alone).unwrap();
        assert_eq!((a.shape(), terms.ssim), ((27, 16, 3), Some(value)));
        for (k, g) in grad.rgb.iter().enumerate() {
            let (x, y) = (k / 3 % 37, k / 3 / 37);
            let inside = (3..30).contains(&x) && (5..21).contains(&y);
            let want = if inside { -alone.pixel(x - 3, y - 5)[k % 3] } else { 0.0 };
            assert_eq!(*g, want, "({x}, {y})");
        }
        let mut image = ImageU8 { width: 37, height: 23, data: vec![0; 37 * 23 * 4] };
        assert_eq!(Region::shown(&image), None);
        for [x, y] in [[3, 7], [29, 20], [11, 5]] {
            image.data[(y * 37 + x) * 4 + 3] = 1;
        }
        assert_eq!(Region::shown(&image), Some(region));
    }

    #[test]
    fn ms_ssim_stands_in_for_ssim_and_needs_room() {
        let weights = LossWeights { structure: Dssim::MsSsim, ..plain(0.2) };
        let (mut frame, target) = pair_of(170, 161);
        let (mut grad, mut alone) = (FrameGrad::default(), Image::default());
        let terms = ImageLoss::new().evaluate_against(&mut frame, &target, &weights, &mut grad).unwrap();
        let drawn = Image { data: frame.rgb.clone(), ..target.clone() };
        let value = MsSsim::default().value_and_grad(&drawn, &target, &mut alone).unwrap();
        assert_eq!(terms.ssim, Some(value));
        let step = 0.8 / target.data.len() as f32;
        let at = |k: usize| sign(drawn.data[k] - target.data[k]) * step - 0.2 * alone.data[k];
        assert!((0..target.data.len()).all(|k| (grad.rgb[k] - at(k)).abs() <= 1e-7 * step));
        let (mut frame, target) = pair();
        let e = ImageLoss::new().evaluate_against(&mut frame, &target, &weights, &mut grad).unwrap_err();
        assert!(matches!(e, MetricError::TooSmall { need: 161, .. }), "{e}");
        assert_eq!(Dssim::MsSsim.check_size(161, 400), Ok(()));
        assert_eq!(Dssim::Ssim.check_size(1, 1), Ok(()));
        let e = Dssim::MsSsim.check_size(400, 160).unwrap_err();
        assert!(e.to_string().contains("dssim = 160") && e.to_string().contains("above 160 pixels"), "{e}");
    }

    #[test]
    fn bad_frames_are_refused() {
        let (mut frame, target) = pair();
        frame.rgb[7] = f32::NAN;
        let mut grad = FrameGrad::default();
        for lambda in [0.0, 0.2] {
            let e = ImageLoss::new().evaluate_against(&mut frame, &target, &plain(lambda), &mut grad).unwrap_err();
            assert!(matches!(e, MetricError::NotFinite { x: 2, y: 0, channel: 1, .. }), "{e}");
        }
        let small = Image::zeros(3, 3, 3);
        let e = ImageLoss::new().evaluate_against(&mut frame, &small, &plain(0.2), &mut grad).unwrap_err();
        assert!(matches!(e, MetricError::Shape { .. }));
    }
}
