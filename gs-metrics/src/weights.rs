//! Weights of published networks, from safetensors files that the user supplies.

use crate::frozen::{Conv, Layer};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};

/// Why a network cannot be built from a file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WeightsError {
    /// The bytes are no safetensors file.
    #[error("no safetensors file: {0}")]
    Format(String),
    /// A parameter is not in the file.
    #[error("the file has no parameter `{name}`; {hint}")]
    Missing {
        /// Name of the parameter.
        name: String,
        /// What the file should be.
        hint: &'static str,
    },
    /// A parameter has another shape or type.
    #[error("parameter `{name}` is {got}, not {want}")]
    Shape {
        /// Name of the parameter.
        name: String,
        /// Its type and shape.
        got: String,
        /// What is needed.
        want: String,
    },
    /// A parameter has a value that is not finite.
    #[error("parameter `{name}` has a value that is not finite")]
    NotFinite {
        /// Name of the parameter.
        name: String,
    },
}

/// The parameters of a file.
pub(crate) struct Weights<'a>(SafeTensors<'a>);

impl<'a> Weights<'a> {
    pub(crate) fn read(file: &'a [u8]) -> Result<Self, WeightsError> {
        SafeTensors::deserialize(file).map(Self).map_err(|e| WeightsError::Format(e.to_string()))
    }

    pub(crate) fn has(&self, name: &str) -> bool {
        self.0.tensor(name).is_ok()
    }

    /// The shape of a parameter; empty if it is not there.
    pub(crate) fn shape(&self, name: &str) -> Vec<usize> {
        self.0.tensor(name).map_or_else(|_| Vec::new(), |t| t.shape().to_vec())
    }

    /// A parameter of this shape.
    pub(crate) fn values(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>, WeightsError> {
        let hint = "convert the published weights as the documentation of the function says";
        let missing = |_| WeightsError::Missing { name: name.to_owned(), hint };
        let tensor: TensorView = self.0.tensor(name).map_err(missing)?;
        if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
            let got = format!("{:?} {:?}", tensor.dtype(), tensor.shape());
            return Err(WeightsError::Shape { name: name.to_owned(), got, want: format!("F32 {shape:?}") });
        }
        let (chunks, _) = tensor.data().as_chunks::<4>();
        let values: Vec<f32> = chunks.iter().map(|b| f32::from_le_bytes(*b)).collect();
        match values.iter().all(|v| v.is_finite()) {
            true => Ok(values),
            false => Err(WeightsError::NotFinite { name: name.to_owned() }),
        }
    }

    /// A convolution `NAME.weight`, `[outputs, inputs, kernel, kernel]`, and `NAME.bias`.
    pub(crate) fn conv(
        &self,
        name: &str,
        [kernel, stride, padding]: [usize; 3],
        [inputs, outputs]: [usize; 2],
    ) -> Result<Layer, WeightsError> {
        let stored = self.values(&format!("{name}.weight"), &[outputs, inputs, kernel, kernel])?;
        let bias = self.values(&format!("{name}.bias"), &[outputs])?;
        let (taps, mut weight) = (kernel * kernel, vec![0.0; stored.len()]);
        for (k, v) in stored.into_iter().enumerate() {
            let (output, input, tap) = (k / (inputs * taps), k / taps % inputs, k % taps);
            weight[(tap * inputs + input) * outputs + output] = v;
        }
        Ok(Layer::Conv(Conv { kernel, stride, padding, inputs, outputs, weight, bias }))
    }

    /// Convolutions of 3 × 3 with these numbers of channels; 0 stands for a maximum over 2 × 2. `name` is given the index that torchvision
    /// has for a layer, in which the `max(·, 0)` count.
    pub(crate) fn vgg(&self, sizes: &[usize], name: impl Fn(usize) -> String) -> Result<Vec<Layer>, WeightsError> {
        let (mut layers, mut inputs, mut index) = (Vec::new(), 3, 0);
        for &outputs in sizes {
            if outputs == 0 {
                layers.push(Layer::Max { side: 2, stride: 2 });
                index += 1;
            } else {
                layers.push(self.conv(&name(index), [3, 1, 1], [inputs, outputs])?);
                inputs = outputs;
                index += 2;
            }
        }
        Ok(layers)
    }
}
