//! Multi-scale SSIM, its value and its gradient.
//!
//! With `cs_l` the mean contrast-structure factor at level `l` (the image halved `l − 1` times) and `ssim_L` the mean SSIM
//! at the last one, each over the valid area of one channel,
//! ```text
//! ms_ssim = mean over channels of  Π_{l<L} max(cs_l, 0)^{w_l} · max(ssim_L, 0)^{w_L},   L = 5
//! ```
//! with `w = (.0448, .2856, .3001, .2363, .1333)`, and 2 × 2 average pooling between levels. Border, pooling of odd
//! sides, clamping at 0 and the product per channel before the mean are those of the `pytorch-msssim` package, which the
//! papers on dynamic scenes use.
//!
//! Where a factor is clamped the whole product of that channel is 0, and its gradient is taken as 0.
//!
//! Wang, Simoncelli, Bovik, *Multi-scale structural similarity for image quality assessment*, Asilomar 2003 (eq. 7).
//!
//! ```
//! use gs_core::Image;
//! use gs_metrics::{MetricError, MsSsimOptions, ms_ssim};
//! let image = Image { width: 161, height: 161, channels: 1, data: vec![0.5; 161 * 161] };
//! assert_eq!(ms_ssim(&image, &image, &MsSsimOptions::default())?, 1.0);
//! let small = Image { width: 160, height: 160, channels: 1, data: vec![0.5; 160 * 160] };
//! let error = ms_ssim(&small, &small, &MsSsimOptions::default()).unwrap_err();
//! assert!(matches!(error, MetricError::TooSmall { need: 161, .. }));
//! # Ok::<(), MetricError>(())
//! ```

use gs_core::{Image, cast};

use crate::error::{MetricError, check_pair, explain_non_finite};
use crate::pool::{halve, scale_and_add_adjoint};
use crate::ssim::{Padding, SsimOptions};
use crate::sweep::{self, Scratch, Task, Term};
use crate::window::{RADIUS, TAPS};

/// Exponents of the five levels, finest first; their sum is 1.0001.
pub const WEIGHTS: [f64; 5] = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333];

/// Options of MS-SSIM; the default is the published metric on images in `[0, 1]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MsSsimOptions {
    /// Number of levels, 1 to 5; 5 by default, which needs more than 160 pixels on both sides.
    pub levels: usize,
    /// `K1` of the luminance factor, dimensionless; 0.01 by default.
    pub k1: f64,
    /// `K2` of the contrast-structure factor, dimensionless; 0.03 by default.
    pub k2: f64,
    /// Largest value minus smallest value an image may have; 1 by default.
    pub data_range: f64,
}

impl Default for MsSsimOptions {
    fn default() -> Self {
        Self { levels: WEIGHTS.len(), k1: 0.01, k2: 0.03, data_range: 1.0 }
    }
}

impl MsSsimOptions {
    /// A **reduced** MS-SSIM for images too small for five levels: the first `levels` weights, divided by their sum. Its
    /// values are not those of MS-SSIM, so report them under another name.
    pub fn reduced(levels: usize) -> Self {
        Self { levels, ..Self::default() }
    }

    /// Number of pixels that both sides must exceed: `10·2^(levels − 1)`, 160 for five levels.
    pub fn side_limit(&self) -> usize {
        (TAPS - 1) << (self.levels.clamp(1, WEIGHTS.len()) - 1)
    }

    /// Weights of the levels in use. The five published ones sum to 1.0001 and are taken as they are.
    fn weights(&self) -> Vec<f64> {
        let used = &WEIGHTS[..self.levels];
        let sum: f64 = if self.levels == WEIGHTS.len() { 1.0 } else { used.iter().sum() };
        used.iter().map(|w| w / sum).collect()
    }

    fn check(&self, image: &Image) -> Result<(), MetricError> {
        if !(1..=WEIGHTS.len()).contains(&self.levels) {
            return Err(MetricError::Option { name: "levels", value: self.levels.to_string(), must: "1 to 5" });
        }
        let (width, height) = (image.width, image.height);
        if width.min(height) <= self.side_limit() {
            let hint = "crop less, or use MsSsimOptions::reduced and report it as such";
            return Err(MetricError::TooSmall { metric: "MS-SSIM", need: self.side_limit() + 1, width, height, hint });
        }
        Ok(())
    }
}

/// One level of the pyramid.
#[derive(Clone, Debug, Default)]
struct Level {
    a: Image,
    b: Image,
    grad: Image,
}

/// MS-SSIM with buffers kept between calls, for a training loop.
#[derive(Clone, Debug, Default)]
pub struct MsSsim {
    options: MsSsimOptions,
    scratch: Scratch,
    /// Levels 2 to 5; level 1 is the images themselves.
    coarse: Vec<Level>,
}

impl MsSsim {
    /// An evaluator with empty buffers; [`MsSsim::value`] checks the options.
    pub fn new(options: MsSsimOptions) -> Self {
        Self { options, ..Self::default() }
    }

    /// MS-SSIM of two `[H, W, C]` images, in `[0, 1]`, 1 for identical images.
    ///
    /// # Errors
    /// Different or empty shapes, more than 4 channels, a side of at most [`MsSsimOptions::side_limit`], an option out of
    /// range, a value that is not finite.
    pub fn value(&mut self, a: &Image, b: &Image) -> Result<f64, MetricError> {
        self.evaluate(a, b, None)
    }

    /// [`MsSsim::value`] and its gradient with respect to `a`, `[H, W, C]`, written over `grad`, which is reshaped.
    ///
    /// # Errors
    /// Those of [`MsSsim::value`]; the content of `grad` is then unspecified.
    pub fn value_and_grad(&mut self, a: &Image, b: &Image, grad: &mut Image) -> Result<f64, MetricError> {
        self.evaluate(a, b, Some(grad))
    }

    fn evaluate(&mut self, a: &Image, b: &Image, mut grad: Option<&mut Image>) -> Result<f64, MetricError> {
        check_pair(a, b)?;
        self.options.check(a)?;
        let levels = self.options.levels;
        self.coarse.resize_with(levels - 1, Level::default);
        for l in 1..levels {
            let (finer, rest) = self.coarse.split_at_mut(l - 1);
            let (from_a, from_b) = finer.last().map_or((a, b), |f| (&f.a, &f.b));
            halve(from_a, &mut rest[0].a);
            halve(from_b, &mut rest[0].b);
        }
        let mut factors =
            vec![level_factors(&self.options, levels == 1, a, b, grad.as_deref_mut(), &mut self.scratch)?];
        for (l, level) in self.coarse.iter_mut().enumerate() {
            let Level { a, b, grad: level_grad } = level;
            let level_grad = grad.is_some().then_some(level_grad);
            factors.push(level_factors(&self.options, l + 2 == levels, a, b, level_grad, &mut self.scratch)?);
        }
        if factors.iter().flatten().any(|f| !f.is_finite()) {
            return Err(explain_non_finite("MS-SSIM", a, b));
        }
        let weights = self.options.weights();
        let product = |c: usize| factors.iter().zip(&weights).map(|(f, w)| f[c].max(0.0).powf(*w)).product::<f64>();
        let products: Vec<f64> = (0..a.channels).map(product).collect();
        if let Some(grad) = grad {
            self.backward(&factors, &products, &weights, grad);
        }
        Ok(products.iter().sum::<f64>() / products.len() as f64)
    }

    /// Scales the gradients of the levels by `∂ms_ssim/∂factor` and adds them up into that of the image.
    fn backward(&mut self, factors: &[[f64; 4]], products: &[f64], weights: &[f64], grad: &mut Image) {
        let gain = |l: usize| {
            let mut out = [0.0f32; 4];
            for (c, product) in products.iter().enumerate() {
                let f = factors[l][c];
                out[c] = if f > 0.0 { cast::to_f32(product * weights[l] / f / products.len() as f64) } else { 0.0 };
            }
            out
        };
        for l in (0..self.coarse.len()).rev() {
            let (head, tail) = self.coarse.split_at_mut(l + 1);
            scale_and_add_adjoint(&mut head[l].grad, &gain(l + 1), tail.first().map(|t| &t.grad));
        }
        scale_and_add_adjoint(grad, &gain(0), self.coarse.first().map(|t| &t.grad));
    }
}

/// Per channel: the mean SSIM (`last`) or contrast-structure factor of one level; `grad` gets its gradient.
fn level_factors(
    options: &MsSsimOptions,
    last: bool,
    a: &Image,
    b: &Image,
    grad: Option<&mut Image>,
    scratch: &mut Scratch,
) -> Result<[f64; 4], MetricError> {
    let pixels = ((a.width - 2 * RADIUS) * (a.height - 2 * RADIUS)) as f64;
    let MsSsimOptions { k1, k2, data_range, .. } = *options;
    let consts = SsimOptions { padding: Padding::Valid, k1, k2, data_range }.consts(1.0 / pixels)?;
    let term = if last { Term::Full } else { Term::Contrast };
    let data = grad.map(|g| {
        (g.width, g.height, g.channels) = a.shape();
        g.data.resize(a.data.len(), 0.0);
        g.data.as_mut_slice()
    });
    Ok(sweep::run(&Task { consts, term, margin: RADIUS }, a, b, data, scratch).map(|loss| 1.0 - loss))
}

/// MS-SSIM of two `[H, W, C]` images; see [`MsSsim::value`], which keeps its buffers.
///
/// # Errors
/// Those of [`MsSsim::value`].
pub fn ms_ssim(a: &Image, b: &Image, options: &MsSsimOptions) -> Result<f64, MetricError> {
    MsSsim::new(*options).value(a, b)
}
