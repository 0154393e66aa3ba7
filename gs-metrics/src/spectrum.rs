//! The distance between the amplitude spectra of two images, its value and its gradient.
//!
//! With `F` the two-dimensional discrete Fourier transform of a channel (whole image, no window),
//! ```text
//! L = reduce over bins and channels of  | |F(a)| − |F(b)| |
//! dL/da = w c Re Σ_k s_k u_k e^{+2πi k·x},     u = F(a) / |F(a)|,  s = sign(|F(a)| − |F(b)|),  sign(0) = 0
//! ```
//! with `c` the factor of the transform ([`FftNorm`]) and `w` that of the reduction ([`Reduce`]). FAGS trains with it; its
//! paper states neither factor. Only the defaults, orthonormal and mean, fit the weight of 0.3 in the paper: with them `L` is
//! at most the root of the mean squared error (Parseval and `||p| − |q|| ≤ |p − q|`).
//!
//! Amplitudes do not depend on position: `L` is the same for an image shifted cyclically or rotated by 180°, so it cannot be
//! the only loss term. Its gradient is dense over the pixels.
//!
//! # Numbers
//! `f32` transforms of any size, primes too; sums in `f64`. An orthonormal amplitude below
//! [`MIN_AMPLITUDE`] counts as 0 without gradient, because its phase is rounding. Sums over the whole spectrum run over half of
//! it, where columns whose mirror image is left out count twice.

use gs_core::{Image, cast};
use gs_fft::num_complex::Complex32;
use serde::{Deserialize, Serialize};

use crate::error::{MetricError, check_image, check_pair, explain_non_finite};
use crate::fft2::Fft2;

/// Orthonormal amplitudes below this value count as 0.
pub const MIN_AMPLITUDE: f32 = 1e-6;

/// The factor of the discrete Fourier transform, for an image of `W · H` pixels; names as in `numpy.fft`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FftNorm {
    /// `1 / √(W H)`: the root mean square of the amplitudes is that of the image.
    #[default]
    Ortho,
    /// 1: the plain sum over pixels.
    Backward,
    /// `1 / (W H)`: bin 0 is the mean of the image.
    Forward,
}

/// How the differences of all bins and channels become one number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Reduce {
    /// Their sum divided by their number, `W · H · C`.
    #[default]
    Mean,
    /// Their sum over bins and channels.
    Sum,
}

/// Options of the amplitude loss; the default is orthonormal and mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AmplitudeOptions {
    /// Factor of the transform; [`FftNorm::Ortho`] by default.
    pub norm: FftNorm,
    /// Reduction over bins and channels; [`Reduce::Mean`] by default.
    pub reduce: Reduce,
}

impl AmplitudeOptions {
    /// The loss over the sum of orthonormal differences.
    fn factor(&self, image: &Image) -> f64 {
        let pixels = (image.width * image.height) as f64;
        let norm = match self.norm {
            FftNorm::Ortho => 1.0,
            FftNorm::Backward => pixels.sqrt(),
            FftNorm::Forward => 1.0 / pixels.sqrt(),
        };
        match self.reduce {
            Reduce::Mean => norm / (pixels * image.channels as f64),
            Reduce::Sum => norm,
        }
    }
}

/// The amplitude loss with plans and buffers kept between calls, for a training loop.
///
/// ```
/// use gs_core::Image;
/// use gs_metrics::AmplitudeLoss;
/// let mut loss = AmplitudeLoss::default();
/// let a = Image { width: 2, height: 2, channels: 1, data: vec![1.0, 2.0, 3.0, 4.0] };
/// let b = Image { data: vec![1.0; 4], ..a.clone() };
/// let mut grad = Image::default();
/// assert_eq!(loss.value_and_grad(&a, &b, &mut grad)?, 1.5);
/// assert_eq!(grad.data, [-0.125, 0.125, 0.125, 0.375]);
/// # Ok::<(), gs_metrics::MetricError>(())
/// ```
#[derive(Debug, Default)]
pub struct AmplitudeLoss {
    options: AmplitudeOptions,
    fft: Option<Fft2>,
    /// Orthonormal amplitudes of the second image, `[C, W/2 + 1, H]`.
    target: Vec<f32>,
}

impl AmplitudeLoss {
    /// An evaluator with empty buffers.
    pub fn new(options: AmplitudeOptions) -> Self {
        Self { options, ..Self::default() }
    }

    /// The loss of two `[H, W, C]` images, at least 0, exactly 0 for identical ones.
    ///
    /// # Errors
    /// Different or empty shapes, more than 4 channels, a value that is not finite.
    pub fn value(&mut self, a: &Image, b: &Image) -> Result<f64, MetricError> {
        self.evaluate(a, b, None)
    }

    /// [`AmplitudeLoss::value`] and its gradient with respect to `a`, `[H, W, C]`, written over `grad`, which is reshaped.
    ///
    /// # Errors
    /// Those of [`AmplitudeLoss::value`]; the content of `grad` is then unspecified.
    pub fn value_and_grad(&mut self, a: &Image, b: &Image, grad: &mut Image) -> Result<f64, MetricError> {
        self.evaluate(a, b, Some(grad))
    }

    fn evaluate(&mut self, a: &Image, b: &Image, grad: Option<&mut Image>) -> Result<f64, MetricError> {
        check_pair(a, b)?;
        let mut target = std::mem::take(&mut self.target);
        let value = self.measure(b, &mut target).map(|()| self.compare(a, &target, grad));
        self.target = target;
        match value {
            Ok(v) if v.is_finite() => Ok(v),
            _ => Err(explain_non_finite("the amplitude loss", a, b)),
        }
    }

    fn measure(&mut self, image: &Image, out: &mut Vec<f32>) -> Result<(), MetricError> {
        check_image("b", image)?;
        let fft = plan(&mut self.fft, image);
        let bins = fft.half() * image.height;
        out.resize(bins * image.channels, 0.0);
        let unit = ortho(image);
        let mut sum = 0.0;
        for (c, values) in out.chunks_exact_mut(bins).enumerate() {
            let sums = fft.spectrum(image, c, values, false, |_, column, values| {
                values.iter_mut().zip(&*column).for_each(|(v, f)| *v = amplitude(*f, unit));
                values.iter().map(|v| f64::from(*v)).sum()
            });
            sum += sums.iter().sum::<f64>();
        }
        if sum.is_finite() { Ok(()) } else { Err(explain_non_finite("the amplitude loss", image, image)) }
    }

    /// The loss; not finite if a value of `a` is not finite.
    fn compare(&mut self, a: &Image, target: &[f32], mut grad: Option<&mut Image>) -> f64 {
        let fft = plan(&mut self.fft, a);
        let factor = self.options.factor(a);
        let (unit, bins, invert) = (ortho(a), fft.half() * a.height, grad.is_some());
        if let Some(grad) = grad.as_deref_mut() {
            (grad.width, grad.height, grad.channels) = a.shape();
            grad.data.resize(a.data.len(), 0.0);
        }
        let mut sum = 0.0;
        for (c, want) in target.chunks_exact(bins).enumerate() {
            let height = a.height;
            let no_extra = &mut vec![(); bins];
            let sums = fft.spectrum(a, c, no_extra, invert, |kx, column, _| {
                difference(column, &want[kx * height..(kx + 1) * height], unit)
            });
            sum += sums.iter().enumerate().map(|(kx, s)| fft.multiplicity(kx) * s).sum::<f64>();
            if let Some(grad) = grad.as_deref_mut() {
                fft.real_inverse(cast::to_f32(factor * f64::from(unit)), c, grad);
            }
        }
        factor * sum
    }
}

/// Factor of the orthonormal transform.
fn ortho(image: &Image) -> f32 {
    cast::to_f32(1.0 / ((image.width * image.height) as f64).sqrt())
}

fn plan<'a>(fft: &'a mut Option<Fft2>, image: &Image) -> &'a mut Fft2 {
    if fft.as_ref().is_none_or(|f| !f.fits(image)) {
        *fft = None;
    }
    fft.get_or_insert_with(|| Fft2::new(image.width, image.height))
}

/// Orthonormal amplitude of a bin, 0 below [`MIN_AMPLITUDE`].
fn amplitude(bin: Complex32, unit: f32) -> f32 {
    let a = unit * (bin.re * bin.re + bin.im * bin.im).sqrt();
    if a < MIN_AMPLITUDE { 0.0 } else { a }
}

/// Sum of `| |F(a)| − |F(b)| |` over a column, given `|F(b)|` in `target`; the column becomes `s · u`, times `unit`.
fn difference(column: &mut [Complex32], target: &[f32], unit: f32) -> f64 {
    let mut sum = 0.0;
    for (bin, target) in column.iter_mut().zip(target) {
        let value = amplitude(*bin, unit);
        let d = value - target;
        sum += f64::from(d.abs());
        let sign = if d > 0.0 { unit } else { -unit };
        *bin = if d == 0.0 || value == 0.0 { Complex32::default() } else { *bin * (sign / value) };
    }
    sum
}
