//! VGG-19 (Simonyan and Zisserman 2015) up to `relu4_2`, with weights from a file of the user's.
//!
//! The file is in safetensors format with `f32` tensors named as in torchvision: `features.{k}.weight`, `[outputs, inputs, 3,
//! 3]`, and `features.{k}.bias`, `[outputs]`, for `k` of 0, 2, 5, 7, 10, 12, 14, 16, 19, 21. Others are not read. No weights come
//! with this project.

use super::net::{FeatureNet, Frozen, Link};
use safetensors::{Dtype, SafeTensors};
use std::path::{Path, PathBuf};

/// Number of each convolution in the file, channels in and out, and whether a pool stands before it.
const LAYERS: [(usize, usize, usize, bool); 10] = [
    (0, 3, 64, false),
    (2, 64, 64, false),
    (5, 64, 128, true),
    (7, 128, 128, false),
    (10, 128, 256, true),
    (12, 256, 256, false),
    (14, 256, 256, false),
    (16, 256, 256, false),
    (19, 256, 512, true),
    (21, 512, 512, false),
];
/// `relu3_2` and `relu4_2` among them.
const TAPPED: [usize; 2] = [12, 21];
/// Mean and deviation of the images it was trained on.
const IMAGENET: [[f32; 3]; 2] = [[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]];

/// A file that holds no VGG-19.
#[derive(Debug, thiserror::Error)]
pub enum VggError {
    /// It cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// It is not a safetensors file.
    #[error("{path} is not a safetensors file: {why}; export VGG-19 with torchvision's tensor names")]
    Format {
        /// The file.
        path: PathBuf,
        /// The reader's words.
        why: String,
    },
    /// A tensor is missing or of another shape or kind.
    #[error("{path}: tensor `{tensor}` must be f32 of shape {want:?}, found {got}")]
    Tensor {
        /// The file.
        path: PathBuf,
        /// Its name.
        tensor: String,
        /// The shape it must have.
        want: Vec<usize>,
        /// What is there.
        got: String,
    },
    /// A weight is NaN or infinite.
    #[error("{path}: tensor `{tensor}`, value {at} is not finite; export the weights again")]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// Name of the tensor.
        tensor: String,
        /// Which value.
        at: usize,
    },
}

impl FeatureNet {
    /// The published network of the MRF loss with weights from a file.
    ///
    /// # Errors
    /// If the file cannot be read, or a tensor is missing, misshapen or not finite.
    pub fn vgg19(path: &Path) -> Result<Self, VggError> {
        let bytes = std::fs::read(path).map_err(|source| VggError::Read { path: path.to_owned(), source })?;
        let format = |e: safetensors::SafeTensorError| VggError::Format { path: path.to_owned(), why: e.to_string() };
        let file = SafeTensors::deserialize(&bytes).map_err(format)?;
        let (mut links, mut taps) = (Vec::new(), Vec::new());
        for (number, inputs, outputs, pooled) in LAYERS {
            let weight = tensor(path, &file, &format!("features.{number}.weight"), vec![outputs, inputs, 3, 3])?;
            let bias = tensor(path, &file, &format!("features.{number}.bias"), vec![outputs])?;
            if pooled {
                links.push(Link::Pool);
            }
            // From [outputs, inputs, 3, 3] to [3, 3, inputs, outputs].
            let at = |k: usize| (k % outputs * inputs + k / outputs % inputs) * 9 + k / (outputs * inputs);
            let weight = (0..weight.len()).map(|k| weight[at(k)]).collect();
            links.push(Link::Conv(Frozen { kernel: 3, stride: 1, inputs, outputs, weight, bias }));
            if TAPPED.contains(&number) {
                taps.push(links.len() - 1);
            }
        }
        // relu4_2 counts as style and as content.
        Ok(Self { name: "id-mrf", links, taps, weights: vec![1.0, 2.0], normal: IMAGENET })
    }
}

fn tensor(path: &Path, file: &SafeTensors<'_>, name: &str, want: Vec<usize>) -> Result<Vec<f32>, VggError> {
    let view = file.tensor(name).ok();
    let good = view.as_ref().filter(|v| v.dtype() == Dtype::F32 && v.shape() == want);
    let Some(view) = good else {
        let got = view.map_or("nothing".to_owned(), |v| format!("{:?} of shape {:?}", v.dtype(), v.shape()));
        return Err(VggError::Tensor { path: path.to_owned(), tensor: name.to_owned(), want, got });
    };
    let (values, _) = view.data().as_chunks::<4>();
    let values: Vec<f32> = values.iter().map(|b| f32::from_le_bytes(*b)).collect();
    match values.iter().position(|v| !v.is_finite()) {
        Some(at) => Err(VggError::NotFinite { path: path.to_owned(), tensor: name.to_owned(), at }),
        None => Ok(values),
    }
}
