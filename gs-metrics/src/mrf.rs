//! Texture against texture: the implicit diversified Markov random field loss on features of two images, its value and its
//! gradient (Wang et al. 2018, "Image inpainting via generative multi-column convolutional neural networks"; the form of DUT).
//!
//! Images are resized to `side × side` (bilinear, corners on corners) and put through a [`FeatureNet`]. At each layer, with
//! features `X` of the first image at places `i` and `Y` of the second at places `j`:
//! ```text
//! m_i = mean over channels of Y_i          x_i = (X_i − m_i)/(|X_i − m_i| + 1e-8),  y_j likewise
//! d_ij = (1 − x_i·y_j)/2 in [0, 1]         d̃_ij = d_ij/(min_j d_ij + 1e-5)
//! c_ij = w_ij/Σ_j w_ij,  w_ij = exp((1 − d̃_ij)/h),  h = ½          L_layer = −ln( (1/|J|) Σ_j max_i c_ij )
//! ```
//! `L = Σ weight · L_layer`. It is small where every patch of the second image has a patch of the first that is closer to it
//! than to anything else: blur, which is a little like everything, is dear. It is not symmetric and not 0 for equal images
//! whose patches repeat.
//!
//! **Networks.** [`FeatureNet::vgg19`] takes the published network's weights from a file of the user's; with it this is the
//! published loss. [`FeatureNet::fixed_bank`], the default, has no learned weights: oriented derivatives and random
//! orthogonal convolutions of the same strides. Its value is the "mrf-proxy" and not comparable with the other's.
//!
//! **Cost** grows with the fourth power of `side`: at 256 the first layer compares 4096 places with 4096. Half the side, or
//! every few steps only, is what a CPU bears.
//!
//! **Numbers.** `1 − x·y` in `f32` is good to 1e-7 beside the 1e-5 above, so where features agree almost exactly the value is
//! good to a percent; elsewhere to 1e-4. Features of no length (a plain background) have no gradient. Bitwise the same for any
//! number of threads.

mod bank;
pub mod head;
mod net;
mod resample;
mod vgg;

pub use net::{FeatureNet, Tape};
pub use vgg::VggError;

use crate::error::{MetricError, check_finite, check_pair};
use gs_core::Image;
use head::HeadOptions;

/// Options of the loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MrfOptions {
    /// Side both images are resized to, pixels.
    pub side: usize,
    /// Constants of a layer.
    pub head: HeadOptions,
}

impl Default for MrfOptions {
    fn default() -> Self {
        Self { side: 256, head: HeadOptions::default() }
    }
}

/// One evaluation.
#[derive(Clone, Debug, PartialEq)]
pub struct MrfTerms {
    /// `Σ weight · L_layer`.
    pub total: f64,
    /// `L_layer`, unweighted.
    pub layers: Vec<f64>,
}

/// The loss with its network.
pub struct Mrf {
    net: FeatureNet,
    options: MrfOptions,
}

impl Default for Mrf {
    /// The proxy at the published size.
    fn default() -> Self {
        Self { net: FeatureNet::fixed_bank(), options: MrfOptions::default() }
    }
}

impl Mrf {
    /// The loss on the features of `net`.
    ///
    /// # Errors
    /// If the side is smaller than the network takes.
    pub fn new(net: FeatureNet, options: MrfOptions) -> Result<Self, MetricError> {
        if options.side < net.least_side() {
            let value = options.side.to_string();
            return Err(MetricError::Option { name: "side", value, must: "at least the network's smallest side" });
        }
        Ok(Self { net, options })
    }

    /// What the score is called in reports: "mrf-proxy" unless the network has learned weights.
    pub fn name(&self) -> &'static str {
        self.net.name()
    }

    /// The loss of two `[H, W, 3]` images of one shape (crops to a mask's box, as a rule).
    ///
    /// # Errors
    /// Different or empty shapes, other than 3 channels, a value that is not finite.
    pub fn value(&self, a: &Image, b: &Image) -> Result<MrfTerms, MetricError> {
        self.evaluate(a, b, None)
    }

    /// [`Mrf::value`] and its gradient with respect to `a`, written over `grad` (reshaped if need be).
    ///
    /// # Errors
    /// Those of [`Mrf::value`]; `grad` then holds nothing of use.
    pub fn value_and_grad(&self, a: &Image, b: &Image, grad: &mut Image) -> Result<MrfTerms, MetricError> {
        self.evaluate(a, b, Some(grad))
    }

    fn evaluate(&self, a: &Image, b: &Image, grad: Option<&mut Image>) -> Result<MrfTerms, MetricError> {
        check_pair(a, b)?;
        if a.channels != 3 {
            return Err(MetricError::Channels { metric: "the MRF loss", got: a.channels, need: "3" });
        }
        check_finite("a", a)?;
        check_finite("b", b)?;
        let side = self.options.side;
        let tape = self.net.forward(&resample::resize(a, side));
        let target = self.net.forward(&resample::resize(b, side));
        let (mut layers, mut cotangents) = (Vec::new(), Vec::new());
        for ((x, y), weight) in tape.layers().zip(target.layers()).zip(self.net.weights()) {
            let (value, mut d) = head::layer(&x.data, &y.data, x.channels, &self.options.head, grad.is_some());
            layers.push(value);
            d.iter_mut().for_each(|v| *v *= *weight as f32);
            cotangents.push(Image { data: d, width: x.width, height: x.height, channels: x.channels });
        }
        let total = layers.iter().zip(self.net.weights()).map(|(l, w)| l * w).sum::<f64>();
        if !total.is_finite() {
            return Err(MetricError::Overflow { metric: "the MRF loss" });
        }
        if let Some(grad) = grad {
            *grad = resample::resize_backward(&self.net.backward(&tape, &cotangents), a.width, a.height);
        }
        Ok(MrfTerms { total, layers })
    }
}
