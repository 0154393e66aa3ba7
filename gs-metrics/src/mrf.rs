//! The implicit diversified Markov random field (ID-MRF) loss between the features of two images, its value and its gradient.
//!
//! Images are resized to `side × side` (bilinear, corners on corners) and put through a [`FeatureNet`]. At each layer, with
//! features `X` of the first image at places `i` and `Y` of the second at places `j`:
//! ```text
//! m_i = mean over channels of Y_i          x_i = (X_i − m_i)/(|X_i − m_i| + 1e-8),  y_j likewise
//! d_ij = (1 − x_i·y_j)/2 in [0, 1]         d̃_ij = d_ij/(min_j d_ij + 1e-5)
//! c_ij = w_ij/Σ_j w_ij,  w_ij = exp((1 − d̃_ij)/h),  h = ½          L_layer = −ln( (1/|J|) Σ_j max_i c_ij )
//! ```
//! `L = Σ weight · L_layer`. It is small where every patch of the second image has a patch of the first that is closer to it
//! than to any other patch. A blurred patch is equally close to many, so blur costs much. The loss is not symmetric, and not 0
//! for equal images whose patches repeat.
//!
//! **Features.** [`FeatureNet::fixed_bank`] has no learned weights: oriented filters and random orthogonal convolutions with
//! the strides of `relu3_2` and `relu4_2` of VGG-19: values are a proxy that cannot be compared with those of papers. [`FeatureNet::vgg19`] reads
//! the published features from a file of the user, which `safetensors.torch.save_file(torchvision.models.vgg19(weights="DEFAULT").state_dict(), FILE)` writes.
//!
//! **Cost** grows with the fourth power of `side`: at 256 the first layer compares 4096 places with 4096. On a CPU use half the
//! side, or evaluate the loss every few steps only.
//!
//! **Numbers.** `1 − x·y` has an error of 1e-7 in `f32` beside the 1e-5 above: where features agree almost exactly the relative
//! error of the value is about 1e-2, elsewhere 1e-4. Features of norm 0 (a flat background) have no gradient. Bitwise the same
//! for any number of threads.
//!
//! Wang, Tao, Qi, Shen, Jia, *Image inpainting via generative multi-column convolutional neural networks*, NeurIPS 2018; the
//! form with a mean per place is that of DUT.
//!
//! ```
//! use gs_core::Image;
//! use gs_metrics::mrf::{FeatureNet, Mrf, MrfOptions};
//! let loss = Mrf::new(FeatureNet::fixed_bank(), MrfOptions { side: 32, ..MrfOptions::default() })?;
//! let pattern = |k: usize| (k * k % 101) as f32 / 100.0;
//! let sharp = Image { width: 32, height: 32, channels: 3, data: (0..3072).map(pattern).collect() };
//! let flat = Image { data: vec![0.5; 3072], ..sharp.clone() };
//! assert!(loss.value(&sharp, &sharp)?.total < loss.value(&flat, &sharp)?.total);
//! # Ok::<(), gs_metrics::MetricError>(())
//! ```

mod bank;
pub mod layer;
mod net;
mod resample;

pub use net::FeatureNet;

use crate::error::{MetricError, check_finite, check_pair};
use gs_core::{Image, cast};
use layer::LayerOptions;

/// Image size and constants of [`Mrf`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MrfOptions {
    /// Side in pixels of the squares both images are resized to, at least 8. Default 256.
    pub side: usize,
    /// Constants of the loss of a layer, the same for all.
    pub layer: LayerOptions,
}

impl Default for MrfOptions {
    fn default() -> Self {
        Self { side: 256, layer: LayerOptions::default() }
    }
}

/// The value of the loss and its terms.
#[derive(Clone, Debug, PartialEq)]
pub struct MrfTerms {
    /// The loss `L = Σ weight · L_layer`.
    pub total: f64,
    /// `L_layer` of each layer of features, finest first, without its weight.
    pub layers: Vec<f64>,
}

/// The ID-MRF loss on the features of a network.
pub struct Mrf {
    net: FeatureNet,
    options: MrfOptions,
}

impl Default for Mrf {
    /// The fixed filter bank with default options.
    fn default() -> Self {
        Self { net: FeatureNet::fixed_bank(), options: MrfOptions::default() }
    }
}

impl Mrf {
    /// The loss on the features of `net`.
    ///
    /// # Errors
    /// If `side` is smaller than the largest stride of the network.
    pub fn new(net: FeatureNet, options: MrfOptions) -> Result<Self, MetricError> {
        if options.side < net.min_side() {
            let value = options.side.to_string();
            return Err(MetricError::Option { name: "side", value, must: "at least the network's smallest side" });
        }
        Ok(Self { net, options })
    }

    /// The loss of two `[H, W, 3]` images of one shape, typically crops to the bounding box of a mask.
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
        let tape = self.net.chain.forward(&resample::resize(a, side));
        let target = self.net.chain.forward(&resample::resize(b, side));
        let (mut layers, mut cotangents) = (Vec::new(), Vec::new());
        for ((x, y), weight) in tape.features().zip(target.features()).zip(&self.net.weights) {
            let (value, mut d) = layer::layer_loss(&x.data, &y.data, x.channels, &self.options.layer, grad.is_some());
            layers.push(value);
            d.iter_mut().for_each(|v| *v *= cast::to_f32(*weight));
            cotangents.push(Image { data: d, width: x.width, height: x.height, channels: x.channels });
        }
        let total = layers.iter().zip(&self.net.weights).map(|(l, w)| l * w).sum::<f64>();
        if !total.is_finite() {
            return Err(MetricError::Overflow { metric: "the MRF loss" });
        }
        if let Some(grad) = grad {
            *grad = resample::resize_backward(&self.net.chain.backward(&tape, &cotangents), a.width, a.height);
        }
        Ok(MrfTerms { total, layers })
    }
}
