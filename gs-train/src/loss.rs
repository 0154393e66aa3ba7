//! The image loss and its gradient: L1 and a list of weighted terms.
//!
//! ```text
//! L = ω mean|x − y| + Σ_k w_k L_k(x, y)        dL/dx = ω sign(x − y) / n + Σ_k w_k dL_k/dx        sign(0) = 0
//! ```
//! over `n = H · W · 3` values of a render `x` and its ground truth `y`. The schedule weighs the terms that every method may use:
//!
//! | setting | term | source |
//! |---|---|---|
//! | `lambda_l1` | ω; `1 − lambda_dssim` if absent | 3DGS: 0.8; MoDec-GS: 1 |
//! | `lambda_dssim` | `1 − SSIM`, over the image, the box of what it shows, or multi-scale | 3DGS: 0.2 |
//! | `lambda_fre` | amplitude spectra ([`gs_metrics::spectrum`]) | FAGS: 0.3 |
//! | `lambda_depth` | distance along the ray to a measured depth ([`GroundTruth::depth`]) | ours |
//!
//! A method adds terms of its own ([`Model::with_loss`](crate::model::Model::with_loss)), such as [`TextureTerm`] (DUT). Terms of
//! weight 0 are not computed. The ground truth stays 8-bit with alpha and is composited over the background here.
//!
//! With [`GroundTruth::exposure`] the render is `A x + α o`, in the colours of the ground truth, and the gradients `Aᵀ dL/dx` and, of alpha, `o · dL/dx`.
//!
//! With a mask `m` ([`GroundTruth::mask`]) the ground truth is `m y + (1 − m) x`, and the gradient `m dL/dx`: what is rendered outside is right as it is.

mod depth;
mod exposure;
mod mask;
mod region;
mod terms;

pub(crate) use exposure::Exposures;
use exposure::Mapped;
pub use exposure::{ExposureConfig, ExposureFit};
pub(crate) use exposure::{fit_before, map_before};
pub use region::Region;
pub use terms::{Dssim, LossTerm, SpectrumTerm, TermValue, TextureTerm};

use gs_core::Image;
use gs_data::ImageU8;
use gs_metrics::{ColorMap, MetricError};
use gs_raster::{Frame, FrameGrad};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Values per parallel piece; partial sums are added in the order of pieces.
const PIECE: usize = 1 << 14;
/// Values summed in `f32` before `f64` takes over.
const RUN: usize = 512;
/// Independent sums, so that the compiler may use vectors.
const LANES: usize = 16;

/// The loss of one view, or its mean over the views of a step.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct LossValues {
    /// Sum of all terms, each times its weight.
    pub total: f64,
    /// Mean absolute difference over pixels and channels.
    pub l1: f64,
    /// Mean squared difference over pixels and channels; with a mask, over those inside.
    pub mse: f64,
    /// The other terms that were computed, by name: SSIM itself, distances.
    pub terms: Vec<(Cow<'static, str>, f64)>,
    /// The map from the frame to the colours of its image, where one was fitted; none in a mean over views.
    #[serde(default)]
    pub color_map: Option<ColorMap>,
}

impl LossValues {
    /// A term by its name; absent where it was not computed.
    pub fn term(&self, name: &str) -> Option<f64> {
        self.terms.iter().find(|t| t.0 == name).map(|t| t.1)
    }

    /// Adds one of `n` views whose mean this becomes.
    pub(crate) fn add_mean(&mut self, view: &Self, n: f64) {
        self.total += view.total / n;
        self.l1 += view.l1 / n;
        self.mse += view.mse / n;
        for (name, value) in &view.terms {
            match self.terms.iter_mut().find(|t| t.0 == *name) {
                Some(sum) => sum.1 += value / n,
                None => self.terms.push((name.clone(), value / n)),
            }
        }
    }
}

/// What a frame is held against.
#[derive(Clone, Copy)]
pub struct GroundTruth<'a> {
    /// The image: 8-bit RGBA, straight alpha.
    pub image: &'a ImageU8,
    /// What it is composited over.
    pub background: [f32; 3],
    /// `[H, W, 1]` in 0..1: how much each pixel counts; none: all fully.
    pub mask: Option<&'a Image>,
    /// `[H, W, 1]`: camera-space z in world units, 0 where it was not measured.
    pub depth: Option<&'a Image>,
    /// How the frame is mapped to the colours of the image before they are compared; none: they are compared as they are.
    pub exposure: Option<ExposureFit>,
}

/// The image loss, with buffers kept between calls.
pub struct ImageLoss {
    l1: f32,
    depth: f32,
    terms: Vec<WeightedTerm>,
    ground_truth: Image,
    mapped: Mapped,
}

struct WeightedTerm {
    weight: f32,
    term: Box<dyn LossTerm>,
    grad: Image,
}

impl ImageLoss {
    /// `l1` times the mean absolute difference, and nothing else.
    pub fn new(l1: f32) -> Self {
        let (ground_truth, mapped) = Default::default();
        Self { l1, depth: 0.0, terms: Vec::new(), ground_truth, mapped }
    }

    /// The same with another term; one of weight 0 is left out.
    pub fn with(mut self, weight: f32, term: Box<dyn LossTerm>) -> Self {
        if weight > 0.0 {
            self.terms.push(WeightedTerm { weight, term, grad: Image::default() });
        }
        self
    }

    /// The same with the depth of frames, where it was measured, at this weight; at 0 it is not looked at.
    pub fn with_depth(self, weight: f32) -> Self {
        Self { depth: weight, ..self }
    }

    /// Weight of the mean absolute difference.
    pub(crate) fn l1_weight(&self) -> f32 {
        self.l1
    }

    /// Whether measured depth counts.
    pub fn needs_depth(&self) -> bool {
        self.depth > 0.0
    }

    /// The loss of a frame, its gradient with respect to the frame's colours, depth and alpha written into `grad` (empty where
    /// nothing counts).
    ///
    /// # Errors
    /// If the shapes differ, a term is not defined for their size, or a value is not finite.
    pub fn evaluate(
        &mut self,
        frame: &Frame,
        truth: &GroundTruth<'_>,
        grad: &mut FrameGrad,
    ) -> Result<LossValues, MetricError> {
        let mut target = std::mem::take(&mut self.ground_truth);
        truth.image.over_into(truth.background, &mut target);
        let boxed = self.terms.iter().any(|t| t.term.needs_region());
        let region = if boxed { Region::shown(truth.image) } else { None };
        let rendered = &frame.rgb;
        let (mask, measured) = (truth.mask, truth.depth.filter(|_| self.needs_depth()));
        for (what, map) in [("rendered frame and mask", mask), ("rendered frame and depth map", measured)] {
            let (first, second) = ((rendered.width, rendered.height, 1), map.map(Image::shape));
            if let Some(second) = second.filter(|s| *s != first) {
                return Err(MetricError::Shape { what, first, second });
            }
        }
        let mut mapped = std::mem::take(&mut self.mapped);
        let fitted =
            truth.exposure.map(|e| e.apply(frame, truth.background, &target, mask, &mut mapped)).transpose()?;
        let shown = if fitted.is_some() { &mapped.colors } else { rendered };
        if let Some(mask) = mask {
            mask::keep_outside(mask, shown, &mut target);
        }
        let values = self.evaluate_within(shown, &target, region, grad);
        self.ground_truth = target;
        let mut values = values?;
        if let Some(ExposureFit { map, .. }) = truth.exposure {
            mapped.pull_back(&map, truth.background, grad);
            values.terms.push(("exposure".into(), map.strength()));
        }
        values.color_map = fitted;
        self.mapped = mapped;
        if let Some(mask) = mask {
            values.mse /= mask::apply(mask, grad).max(f64::MIN_POSITIVE);
        }
        if let Some(measured) = measured {
            let off = depth::evaluate(frame, measured, mask, self.depth, grad);
            values.total += f64::from(self.depth) * off;
            values.terms.push(("depth".into(), off));
        }
        Ok(values)
    }

    /// The same against an image of three channels, within a region; the whole image if absent.
    fn evaluate_within(
        &mut self,
        rendered: &Image,
        target: &Image,
        region: Option<Region>,
        grad: &mut FrameGrad,
    ) -> Result<LossValues, MetricError> {
        let (first, second) = (rendered.shape(), target.shape());
        if first != second {
            return Err(MetricError::Shape { what: "rendered frame and ground truth", first, second });
        }
        let region = region.unwrap_or(Region { low: [0; 2], high: [rendered.width, rendered.height] });
        let mut values = Vec::with_capacity(self.terms.len());
        for t in &mut self.terms {
            values.push((t.term.name(), t.term.evaluate(rendered, target, region, &mut t.grad)?));
        }
        let factors = self.terms.iter().zip(&values).map(|(t, v)| (t.weight * v.1.grad_factor, t.grad.data.as_slice()));
        let [l1, mse] = self.gradient(rendered, target, &factors.collect::<Vec<_>>(), grad);
        let weighted = self.terms.iter().zip(&values).map(|(t, v)| f64::from(t.weight) * v.1.loss);
        let total = weighted.fold(f64::from(self.l1) * l1, |sum, v| sum + v);
        if !total.is_finite() {
            // The exact place comes from the metric's own check.
            return Err(gs_metrics::mse(rendered, target).err().unwrap_or(MetricError::Overflow { metric: "L1" }));
        }
        Ok(LossValues {
            total,
            l1,
            mse,
            terms: values.into_iter().map(|(name, v)| (name.into(), v.shown)).collect(),
            color_map: None,
        })
    }

    /// Writes the gradient of L1 and the terms, each with its factor; gives mean absolute and mean squared difference.
    fn gradient(&self, rendered: &Image, target: &Image, terms: &[(f32, &[f32])], grad: &mut FrameGrad) -> [f64; 2] {
        let data = &rendered.data;
        grad.alpha.clear();
        grad.depth.clear();
        grad.rgb.resize(data.len(), 0.0);
        let step = self.l1 / data.len() as f32;
        let pairs = data.par_chunks(PIECE).zip(target.data.par_chunks(PIECE));
        let pieces = grad.rgb.par_chunks_mut(PIECE).zip(pairs).enumerate();
        let sums: Vec<[f64; 2]> = pieces
            .map(|(i, (g, (x, y)))| {
                let sums = l1_piece(x, y, step, g);
                for (factor, term) in terms {
                    g.iter_mut().zip(&term[i * PIECE..]).for_each(|(g, t)| *g += factor * t);
                }
                sums
            })
            .collect();
        let n = data.len() as f64;
        sums.iter().fold([0.0; 2], |a, s| [a[0] + s[0] / n, a[1] + s[1] / n])
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
    use gs_metrics::mrf::{FeatureNet, Mrf, MrfOptions};
    use gs_metrics::spectrum::AmplitudeOptions;
    use gs_metrics::{AmplitudeLoss, MsSsim, Ssim, SsimOptions};

    fn pair() -> (Image, Image) {
        pair_of(37, 23)
    }

    fn plain(dssim: f32) -> ImageLoss {
        ImageLoss::new(1.0 - dssim).with(dssim, Dssim::Ssim.term())
    }

    fn pair_of(width: usize, height: usize) -> (Image, Image) {
        let mut rng = Rng::new(1, "loss", 0, 0);
        let mut noise = || (0..width * height * 3).map(|_| rng.uniform()).collect::<Vec<f32>>();
        let mut image = || Image { width, height, channels: 3, data: noise() };
        (image(), image())
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let (rendered, target) = pair();
        let mut grad = FrameGrad::default();
        for weight in [0.0, 0.2, 1.0] {
            let mut loss = plain(weight);
            loss.evaluate_within(&rendered, &target, None, &mut grad).unwrap();
            for at in [0, 100, 1000, 2552] {
                let mut value = |h: f32| {
                    let mut moved = rendered.clone();
                    moved.data[at] += h;
                    loss.evaluate_within(&moved, &target, None, &mut FrameGrad::default()).unwrap().total
                };
                let h = 0.25 * (rendered.data[at] - target.data[at]).abs().min(0.02);
                let want = (value(h) - value(-h)) / f64::from(2.0 * h);
                let error = (f64::from(grad.rgb[at]) - want).abs();
                assert!(error < 1e-2 * want.abs() + 2e-7, "weight {weight}, value {at}: {} {want}", grad.rgb[at]);
            }
        }
    }

    #[test]
    fn terms_are_the_definitions() {
        let (rendered, target) = pair();
        let mut grad = FrameGrad::default();
        let terms = plain(0.2).evaluate_within(&rendered, &target, None, &mut grad).unwrap();
        let n = target.data.len() as f64;
        let differences = rendered.data.iter().zip(&target.data).map(|(a, b)| f64::from(*a) - f64::from(*b));
        let (l1, mse) = differences.fold((0.0, 0.0), |s, d| (s.0 + d.abs() / n, s.1 + d * d / n));
        assert!((terms.l1 / l1 - 1.0).abs() < 1e-6 && (terms.mse / mse - 1.0).abs() < 1e-6);
        assert!((terms.total - 0.8 * terms.l1 - 0.2 * (1.0 - terms.term("ssim").unwrap())).abs() < 1e-7);
        let none = plain(0.0).evaluate_within(&rendered, &rendered, None, &mut grad).unwrap();
        assert_eq!((none.total, none.terms), (0.0, Vec::new()));
        assert!(grad.rgb.iter().all(|&g| g == 0.0), "sign(0) = 0");
    }

    #[test]
    fn the_spectral_term_is_added_with_its_weight() {
        let (rendered, target) = pair();
        let (mut grad, mut both, mut alone) = (FrameGrad::default(), FrameGrad::default(), Image::default());
        let without = plain(0.2).evaluate_within(&rendered, &target, None, &mut grad).unwrap();
        let mut loss = plain(0.2).with(0.3, Box::new(SpectrumTerm::new(AmplitudeOptions::default())));
        let with = loss.evaluate_within(&rendered, &target, None, &mut both).unwrap();
        let fre = AmplitudeLoss::default().value_and_grad(&rendered, &target, &mut alone).unwrap();
        assert_eq!((without.term("fre"), with.term("fre")), (None, Some(fre)));
        assert_eq!(with.term("ssim"), without.term("ssim"));
        assert_eq!(with.total, without.total + f64::from(0.3f32) * fre);
        let sums = grad.rgb.iter().zip(&alone.data).map(|(g, f)| g + 0.3 * f);
        assert!(both.rgb.iter().zip(sums).all(|(b, s)| *b == s));
    }

    #[test]
    fn outside_a_mask_nothing_counts() {
        let frame = Frame { rgb: pair().0, alpha: vec![1.0; 37 * 23], depth: vec![2.0; 37 * 23] };
        let bytes = |seed: u64| {
            let mut rng = Rng::new(seed, "loss.bytes", 0, 0);
            let data = (0..4 * 37 * 23).map(|i| if i % 4 == 3 { 255 } else { rng.below(256) as u8 }).collect();
            ImageU8 { width: 37, height: 23, data }
        };
        let inside = |p: usize| p % 37 < 20;
        let mask = Image {
            width: 37,
            height: 23,
            channels: 1,
            data: (0..37 * 23).map(|p| f32::from(u8::from(inside(p)))).collect(),
        };
        // Two images that differ outside the mask alone.
        let (first, mut second) = (bytes(1), bytes(2));
        for p in (0..37 * 23).filter(|p| inside(*p)) {
            second.data[4 * p..4 * p + 4].copy_from_slice(&first.data[4 * p..4 * p + 4]);
        }
        let mut loss = plain(0.2).with_depth(0.5);
        let mut of = |image: &ImageU8, mask: Option<&Image>, frame: &Frame, grad: &mut FrameGrad| {
            loss.evaluate(frame, &GroundTruth { image, background: [1.0; 3], mask, depth: None, exposure: None }, grad)
                .unwrap()
        };
        let (mut grad, mut again, mut whole) = Default::default();
        let values = of(&first, Some(&mask), &frame, &mut grad);
        assert_eq!(values, of(&second, Some(&mask), &frame, &mut again));
        assert_eq!(grad, again);
        let all = of(&first, None, &frame, &mut whole);
        assert!(
            values.l1 < all.l1
                && all == of(&first, Some(&Image { data: vec![1.0; 37 * 23], ..mask.clone() }), &frame, &mut again)
        );
        assert!((0..37 * 23).all(|p| inside(p) || grad.rgb[3 * p..3 * p + 3] == [0.0; 3]));
        assert!((0..37 * 23).filter(|p| inside(*p)).any(|p| grad.rgb[3 * p] != 0.0));
        // Finite differences of a pixel inside: near the border and far from it.
        for p in [5 * 37 + 19, 11 * 37 + 4] {
            let h = 1e-3;
            let mut at = |by: f32| {
                let mut moved = frame.clone();
                moved.rgb.data[3 * p] += by;
                of(&first, Some(&mask), &moved, &mut FrameGrad::default()).total
            };
            let want = (at(h) - at(-h)) / f64::from(2.0 * h);
            assert!((f64::from(grad.rgb[3 * p]) - want).abs() < 1e-2 * want.abs() + 1e-7, "{} {want}", grad.rgb[3 * p]);
        }
        let small = Image::zeros(3, 3, 1);
        let truth =
            GroundTruth { image: &first, background: [1.0; 3], mask: Some(&small), depth: None, exposure: None };
        let e = loss.evaluate(&frame, &truth, &mut grad).unwrap_err();
        assert!(matches!(e, MetricError::Shape { what: "rendered frame and mask", .. }), "{e}");
    }

    #[test]
    fn the_texture_term_is_added_over_the_box() {
        let (rendered, target) = pair();
        let region = Region { low: [3, 5], high: [30, 21] };
        let (mut grad, mut both, mut alone) = (FrameGrad::default(), FrameGrad::default(), Image::default());
        let texture = |side| plain(0.2).with(0.3, Box::new(TextureTerm::new(side, None)));
        let without = plain(0.2).evaluate_within(&rendered, &target, Some(region), &mut grad).unwrap();
        let with = texture(16).evaluate_within(&rendered, &target, Some(region), &mut both).unwrap();
        let [mut a, mut b] = [Image::default(), Image::default()];
        region.crop(&rendered, &mut a);
        region.crop(&target, &mut b);
        let options = MrfOptions { side: 16, ..MrfOptions::default() };
        let mrf =
            Mrf::new(FeatureNet::fixed_bank(), options).unwrap().value_and_grad(&a, &b, &mut alone).unwrap().total;
        assert_eq!((without.term("mrf"), with.term("mrf")), (None, Some(mrf)));
        assert_eq!(with.total, without.total + f64::from(0.3f32) * mrf);
        assert!(alone.data.iter().any(|g| *g != 0.0));
        for (k, (g, without)) in both.rgb.iter().zip(&grad.rgb).enumerate() {
            let (x, y) = (k / 3 % 37, k / 3 / 37);
            let inside = (3..30).contains(&x) && (5..21).contains(&y);
            let more = if inside { 0.3 * alone.pixel(x - 3, y - 5)[k % 3] } else { 0.0 };
            assert_eq!(*g, without + more, "({x}, {y})");
        }
        assert!(texture(4).evaluate_within(&rendered, &target, Some(region), &mut grad).is_err());
    }

    #[test]
    fn within_a_box_only_the_box_is_looked_at() {
        let region = Region { low: [3, 5], high: [30, 21] };
        let (rendered, target) = pair();
        let (mut grad, mut alone) = (FrameGrad::default(), Image::default());
        let mut loss = ImageLoss::new(0.0).with(1.0, Dssim::SsimBox.term());
        let terms = loss.evaluate_within(&rendered, &target, Some(region), &mut grad).unwrap();
        let [mut a, mut b] = [Image::default(), Image::default()];
        region.crop(&rendered, &mut a);
        region.crop(&target, &mut b);
        let value = Ssim::new(SsimOptions::default()).value_and_grad(&a, &b, &mut alone).unwrap();
        assert_eq!((a.shape(), terms.term("ssim")), ((27, 16, 3), Some(value)));
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
    fn ms_ssim_replaces_ssim_and_needs_large_images() {
        let ms_ssim = || ImageLoss::new(0.8).with(0.2, Dssim::MsSsim.term());
        let (rendered, target) = pair_of(170, 161);
        let (mut grad, mut alone) = (FrameGrad::default(), Image::default());
        let terms = ms_ssim().evaluate_within(&rendered, &target, None, &mut grad).unwrap();
        let value = MsSsim::default().value_and_grad(&rendered, &target, &mut alone).unwrap();
        assert_eq!(terms.term("ssim"), Some(value));
        let step = 0.8 / target.data.len() as f32;
        let at = |k: usize| sign(rendered.data[k] - target.data[k]) * step - 0.2 * alone.data[k];
        assert!((0..target.data.len()).all(|k| (grad.rgb[k] - at(k)).abs() <= 1e-7 * step));
        let (rendered, target) = pair();
        let e = ms_ssim().evaluate_within(&rendered, &target, None, &mut grad).unwrap_err();
        assert!(matches!(e, MetricError::TooSmall { need: 161, .. }), "{e}");
        assert_eq!(Dssim::MsSsim.check_size(161, 400), Ok(()));
        assert_eq!(Dssim::Ssim.check_size(1, 1), Ok(()));
        let e = Dssim::MsSsim.check_size(400, 160).unwrap_err();
        assert!(e.to_string().contains("dssim = 160") && e.to_string().contains("above 160 pixels"), "{e}");
    }

    #[test]
    fn bad_frames_are_refused() {
        let (mut rendered, target) = pair();
        rendered.data[7] = f32::NAN;
        let mut grad = FrameGrad::default();
        for lambda in [0.0, 0.2] {
            let e = plain(lambda).evaluate_within(&rendered, &target, None, &mut grad).unwrap_err();
            assert!(matches!(e, MetricError::NotFinite { x: 2, y: 0, channel: 1, .. }), "{e}");
        }
        let small = Image::zeros(3, 3, 3);
        let e = plain(0.2).evaluate_within(&rendered, &small, None, &mut grad).unwrap_err();
        assert!(matches!(e, MetricError::Shape { .. }));
    }
}
