//! Structural similarity (SSIM), its value and its gradient.
//!
//! Per channel, with Gaussian-weighted local means `μ`, variances `σ²` and covariance `σxy` (11 × 11 taps, σ = 1.5):
//! ```text
//! ssim(p) = (2 μx μy + C1)(2 σxy + C2) / ((μx² + μy² + C1)(σx² + σy² + C2)),   C1 = (K1·range)², C2 = (K2·range)²
//! ```
//! and the score is the mean over pixels and channels. Two border conventions are in use and give different numbers:
//! [`Padding::Zero`] scores every pixel and reads zeros outside (the training loss of the 3DGS family, a convolution with
//! "same" padding), [`Padding::Valid`] scores only pixels whose whole window lies inside (the published metric).
//!
//! # Numbers
//! Filters are `f32`, with variances about the centre value of each window, so that flat areas do not cancel; means are `f64`.
//! Identical images give exactly 1. The gradient has the shape of an image and is with respect to the first argument;
//! SSIM itself is symmetric.
//!
//! Wang, Bovik, Sheikh, Simoncelli, IEEE TIP 13(4), 2004; K1, K2, window and σ are theirs.

use gs_core::{Image, cast};

use crate::error::{MetricError, check_pair, explain_non_finite};
use crate::sweep::{self, Scratch, Task, Term};
use crate::window::{Consts, RADIUS, TAPS, half_window};

/// Values outside the image, and which pixels are scored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Padding {
    /// Every pixel is scored; outside the image there are zeros (training loss of 3DGS and its descendants).
    #[default]
    Zero,
    /// Only pixels whose window lies inside are scored; both sides need at least 11 pixels (published metric).
    Valid,
}

/// Options of SSIM; the defaults are the training loss on images in `[0, 1]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SsimOptions {
    /// Border convention; [`Padding::Zero`] by default.
    pub padding: Padding,
    /// `K1` of the luminance factor, dimensionless; 0.01 by default.
    pub k1: f64,
    /// `K2` of the contrast-structure factor, dimensionless; 0.03 by default.
    pub k2: f64,
    /// Largest value minus smallest value an image may have; 1 by default, for display-encoded images.
    pub data_range: f64,
}

impl Default for SsimOptions {
    fn default() -> Self {
        Self { padding: Padding::Zero, k1: 0.01, k2: 0.03, data_range: 1.0 }
    }
}

impl SsimOptions {
    /// The published metric: the defaults with [`Padding::Valid`].
    pub fn published() -> Self {
        Self { padding: Padding::Valid, ..Self::default() }
    }

    /// Pixels on each side that are not scored.
    pub(crate) fn margin(&self) -> usize {
        match self.padding {
            Padding::Zero => 0,
            Padding::Valid => RADIUS,
        }
    }

    /// Checks the options and makes the constants of the kernels; `scale` multiplies the gradient.
    pub(crate) fn consts(&self, scale: f64) -> Result<Consts, MetricError> {
        for (name, value) in [("k1", self.k1), ("k2", self.k2), ("data_range", self.data_range)] {
            if !(value > 1e-6 && value < 1e6) {
                return Err(MetricError::Option { name, value: value.to_string(), must: "between 1e-6 and 1e6" });
            }
        }
        let square = |k: f64| cast::to_f32((k * self.data_range).powi(2));
        let g = half_window().map(cast::to_f32);
        Ok(Consts { g, c1: square(self.k1), c2: square(self.k2), scale: cast::to_f32(scale) })
    }

    /// Checks that images of this shape can be scored.
    fn check_size(&self, image: &Image) -> Result<(), MetricError> {
        if self.padding == Padding::Valid && image.width.min(image.height) < TAPS {
            let (width, height) = (image.width, image.height);
            let hint = "use Padding::Zero for smaller images";
            return Err(MetricError::TooSmall { metric: "SSIM with valid padding", need: TAPS, width, height, hint });
        }
        Ok(())
    }
}

/// SSIM with buffers kept between calls, for a training loop.
///
/// ```
/// use gs_core::Image;
/// use gs_metrics::{Ssim, SsimOptions};
/// let mut ssim = Ssim::new(SsimOptions::default());
/// let image = Image { width: 20, height: 20, channels: 3, data: vec![0.25; 1200] };
/// let mut grad = Image::default();
/// assert_eq!(ssim.value_and_grad(&image, &image, &mut grad)?, 1.0);
/// # Ok::<(), gs_metrics::MetricError>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Ssim {
    options: SsimOptions,
    scratch: Scratch,
}

impl Ssim {
    /// An evaluator with empty buffers; [`Ssim::value`] checks the options.
    pub fn new(options: SsimOptions) -> Self {
        Self { options, scratch: Scratch::default() }
    }

    /// Mean SSIM of two `[H, W, C]` images, at most 1, exactly 1 for identical images.
    ///
    /// # Errors
    /// Different or empty shapes, more than 4 channels, a side below 11 with [`Padding::Valid`], an option out of range, a
    /// value that is not finite.
    pub fn value(&mut self, a: &Image, b: &Image) -> Result<f64, MetricError> {
        self.evaluate(a, b, None)
    }

    /// [`Ssim::value`] and its gradient with respect to `a`, `[H, W, C]`, written over `grad`, which is reshaped.
    ///
    /// # Errors
    /// Those of [`Ssim::value`]; the content of `grad` is then unspecified.
    pub fn value_and_grad(&mut self, a: &Image, b: &Image, grad: &mut Image) -> Result<f64, MetricError> {
        check_pair(a, b)?;
        (grad.width, grad.height, grad.channels) = a.shape();
        grad.data.resize(a.data.len(), 0.0);
        self.evaluate(a, b, Some(&mut grad.data))
    }

    fn evaluate(&mut self, a: &Image, b: &Image, grad: Option<&mut [f32]>) -> Result<f64, MetricError> {
        check_pair(a, b)?;
        self.options.check_size(a)?;
        let margin = self.options.margin();
        let scored = (a.width - 2 * margin) * (a.height - 2 * margin) * a.channels;
        let consts = self.options.consts(1.0 / scored as f64)?;
        let loss = sweep::run(&Task { consts, term: Term::Full, margin }, a, b, grad, &mut self.scratch);
        let mean = 1.0 - loss.iter().sum::<f64>() / a.channels as f64;
        if mean.is_finite() { Ok(mean) } else { Err(explain_non_finite("SSIM", a, b)) }
    }
}

/// Mean SSIM of two `[H, W, C]` images; see [`Ssim::value`], which keeps its buffers.
///
/// ```
/// use gs_core::Image;
/// use gs_metrics::{SsimOptions, ssim};
/// // Without structure only the luminance factor is left: (2·0.25·0.75 + 1e-4) / (0.25² + 0.75² + 1e-4).
/// let flat = |v: f32| Image { width: 16, height: 16, channels: 1, data: vec![v; 256] };
/// let score = ssim(&flat(0.25), &flat(0.75), &SsimOptions::published())?;
/// assert!((score - 0.3751 / 0.6251).abs() < 1e-6);
/// # Ok::<(), gs_metrics::MetricError>(())
/// ```
///
/// # Errors
/// Those of [`Ssim::value`].
pub fn ssim(a: &Image, b: &Image, options: &SsimOptions) -> Result<f64, MetricError> {
    Ssim::new(*options).value(a, b)
}
