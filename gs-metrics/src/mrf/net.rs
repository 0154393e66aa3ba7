//! The features of the MRF loss.

use crate::frozen::Chain;
use crate::weights::{Weights, WeightsError};

/// A frozen network whose activations are compared by [`Mrf`](super::Mrf).
#[derive(Clone, Debug)]
pub struct FeatureNet {
    pub(super) chain: Chain,
    /// Weight in the loss of each layer of features.
    pub(super) weights: Vec<f64>,
}

impl FeatureNet {
    /// `relu3_2` and `relu4_2` of VGG-19, with the weights 1 and 2, from the bytes of a safetensors file with the parameters of torchvision's
    /// `vgg19` (`features.0.weight` …): what papers call the ID-MRF loss.
    ///
    /// # Errors
    /// If the file cannot be read, or a parameter is missing or of another shape.
    pub fn vgg19(file: &[u8]) -> Result<Self, WeightsError> {
        // Channels of the convolutions up to relu4_2; 0: a maximum over 2 × 2.
        const SIZES: [usize; 13] = [64, 64, 0, 128, 128, 0, 256, 256, 256, 256, 0, 512, 512];
        let weights = Weights::read(file)?;
        let layers = weights.vgg(&SIZES, |index| format!("features.{index}"))?;
        let (mean, deviation) = ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]);
        Ok(Self { chain: Chain { mean, deviation, layers, taps: vec![7, 12] }, weights: vec![1.0, 2.0] })
    }

    /// Side in pixels of the smallest square image that fills a pixel of every layer.
    pub(super) fn min_side(&self) -> usize {
        self.chain.stride()
    }
}
