//! Terms of the image loss beside L1.

use super::Region;
use crate::error::ScheduleError;
use gs_core::Image;
use gs_core::io::{Limits, read_file};
use gs_metrics::mrf::{FeatureNet, Mrf, MrfOptions};
use gs_metrics::spectrum::AmplitudeOptions;
use gs_metrics::{AmplitudeLoss, MetricError, MsSsim, MsSsimOptions, Ssim, SsimOptions};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A term of the image loss, with the buffers it keeps between calls.
pub trait LossTerm: Send + Sync {
    /// Its name in logs: `ssim`, `fre`, `mrf`.
    fn name(&self) -> &'static str;

    /// Whether it needs the box of what the ground truth shows.
    fn needs_region(&self) -> bool {
        false
    }

    /// The term of a render against its ground truth, both `[H, W, 3]`; `grad` takes the shape of `rendered`.
    ///
    /// # Errors
    /// If it is not defined for images of this size, or a value is not finite.
    fn evaluate(
        &mut self,
        rendered: &Image,
        ground_truth: &Image,
        region: Region,
        grad: &mut Image,
    ) -> Result<TermValue, MetricError>;
}

/// A term of one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TermValue {
    /// Value of the term before its weight; less is better.
    pub loss: f64,
    /// What logs show: the similarity itself where `loss` is one minus it.
    pub shown: f64,
    /// The gradient of `loss` is this times the written gradient.
    pub grad_factor: f32,
}

impl TermValue {
    /// A distance, which is minimised as it is.
    fn distance(value: f64) -> Self {
        Self { loss: value, shown: value, grad_factor: 1.0 }
    }

    /// A similarity `s`: `1 − s` is minimised.
    fn similarity(value: f64) -> Self {
        Self { loss: 1.0 - value, shown: value, grad_factor: -1.0 }
    }
}

/// Which similarity `lambda_dssim` weighs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Dssim {
    /// SSIM with zeros outside the image.
    #[default]
    Ssim,
    /// The same over the box of what the image shows (DUT: the person's), with zeros outside the box.
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

impl Dssim {
    /// The loss term of this choice, with its own memory.
    pub fn term(self) -> Box<dyn LossTerm> {
        match self {
            Dssim::Ssim => Box::new(SsimTerm(Ssim::new(SsimOptions::default()))),
            Dssim::SsimBox => {
                Box::new(SsimBoxTerm { ssim: Ssim::new(SsimOptions::default()), cropped: Cropped::default() })
            }
            Dssim::MsSsim => Box::new(MsSsimTerm(MsSsim::default())),
        }
    }
}

/// `1 − SSIM` with zeros outside the image.
struct SsimTerm(Ssim);

impl LossTerm for SsimTerm {
    fn name(&self) -> &'static str {
        "ssim"
    }

    fn evaluate(&mut self, x: &Image, y: &Image, _: Region, grad: &mut Image) -> Result<TermValue, MetricError> {
        self.0.value_and_grad(x, y, grad).map(TermValue::similarity)
    }
}

/// `1 − MS-SSIM` of five levels.
struct MsSsimTerm(MsSsim);

impl LossTerm for MsSsimTerm {
    fn name(&self) -> &'static str {
        "ssim"
    }

    fn evaluate(&mut self, x: &Image, y: &Image, _: Region, grad: &mut Image) -> Result<TermValue, MetricError> {
        self.0.value_and_grad(x, y, grad).map(TermValue::similarity)
    }
}

/// `1 − SSIM` over the region.
struct SsimBoxTerm {
    ssim: Ssim,
    cropped: Cropped,
}

impl LossTerm for SsimBoxTerm {
    fn name(&self) -> &'static str {
        "ssim"
    }

    fn needs_region(&self) -> bool {
        true
    }

    fn evaluate(&mut self, x: &Image, y: &Image, region: Region, grad: &mut Image) -> Result<TermValue, MetricError> {
        let Self { ssim, cropped } = self;
        cropped.within(region, x, y, grad, |x, y, grad| ssim.value_and_grad(x, y, grad)).map(TermValue::similarity)
    }
}

/// Mean difference of amplitude spectra (FAGS, eq. 10).
pub struct SpectrumTerm(AmplitudeLoss);

impl SpectrumTerm {
    /// The loss with this factor and reduction.
    pub fn new(options: AmplitudeOptions) -> Self {
        Self(AmplitudeLoss::new(options))
    }
}

impl LossTerm for SpectrumTerm {
    fn name(&self) -> &'static str {
        "fre"
    }

    fn evaluate(&mut self, x: &Image, y: &Image, _: Region, grad: &mut Image) -> Result<TermValue, MetricError> {
        self.0.value_and_grad(x, y, grad).map(TermValue::distance)
    }
}

/// Distance of textures over the region, by a Markov random field over the features of a fixed filter bank, or of VGG-19 (DUT).
pub struct TextureTerm {
    side: usize,
    /// File with the weights of VGG-19; none: the fixed bank.
    weights: Option<PathBuf>,
    /// Built at the first view, so that a run whose weights are gone can still be rendered, and, so that an impossible size is an error of that view.
    mrf: Option<Mrf>,
    cropped: Cropped,
}

impl TextureTerm {
    /// The region is resized to a square of this side, pixels. `weights` is a file for [`FeatureNet::vgg19`]; without one the features are those
    /// of [`FeatureNet::fixed_bank`].
    pub fn new(side: u32, weights: Option<PathBuf>) -> Self {
        Self { side: side as usize, weights, mrf: None, cropped: Cropped::default() }
    }

    fn features(&self) -> Result<FeatureNet, MetricError> {
        let Some(file) = &self.weights else { return Ok(FeatureNet::fixed_bank()) };
        let wrong = |why: String| MetricError::Option {
            name: "schedule.mrf_weights",
            value: format!("{} ({why})", file.display()),
            must: "a safetensors file with the parameters of torchvision's vgg19",
        };
        let bytes = read_file(file, &Limits::default()).map_err(|e| wrong(e.to_string()))?;
        FeatureNet::vgg19(&bytes).map_err(|e| wrong(e.to_string()))
    }
}

impl LossTerm for TextureTerm {
    fn name(&self) -> &'static str {
        "mrf"
    }

    fn needs_region(&self) -> bool {
        true
    }

    fn evaluate(&mut self, x: &Image, y: &Image, region: Region, grad: &mut Image) -> Result<TermValue, MetricError> {
        if self.mrf.is_none() {
            let options = MrfOptions { side: self.side, ..MrfOptions::default() };
            self.mrf = Some(Mrf::new(self.features()?, options)?);
        }
        let Some(mrf) = &self.mrf else { return Ok(TermValue::distance(0.0)) };
        let value = |x: &Image, y: &Image, grad: &mut Image| mrf.value_and_grad(x, y, grad).map(|terms| terms.total);
        self.cropped.within(region, x, y, grad, value).map(TermValue::distance)
    }
}

/// Render, ground truth and gradient within a region.
#[derive(Default)]
struct Cropped([Image; 3]);

impl Cropped {
    fn within(
        &mut self,
        region: Region,
        rendered: &Image,
        ground_truth: &Image,
        grad: &mut Image,
        evaluate: impl FnOnce(&Image, &Image, &mut Image) -> Result<f64, MetricError>,
    ) -> Result<f64, MetricError> {
        let [x, y, d] = &mut self.0;
        region.crop(rendered, x);
        region.crop(ground_truth, y);
        let value = evaluate(x, y, d)?;
        region.paste(d, rendered, grad);
        Ok(value)
    }
}
