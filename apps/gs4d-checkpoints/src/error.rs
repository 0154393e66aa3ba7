//! Why a checkpoint cannot be taken over.

/// A checkpoint that is no scene of gs4d.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CheckpointError {
    /// The bytes are no safetensors file.
    #[error("no safetensors file: {0}")]
    Format(String),
    /// The file was not written by the exporter, or its metadata cannot be read.
    #[error("the file has no {0} in its metadata; write it with export_checkpoint.py")]
    NotExported(&'static str),
    /// The file is of another code.
    #[error(
        "checkpoints of `{0}` are not known; known are 4DGaussians, Deformable-3D-GS, Grid4D, Scaffold-GS and TRACE"
    )]
    Code(String),
    /// A tensor is not in the file.
    #[error("the file has no tensor `{0}`")]
    Missing(String),
    /// A tensor has another type or shape.
    #[error("tensor `{name}` is {got}, not {want}")]
    Shape {
        /// Name of the tensor.
        name: String,
        /// Its type and shape.
        got: String,
        /// What is needed.
        want: String,
    },
    /// A setting of the checkpoint is missing or has another kind.
    #[error("the settings of the checkpoint have no usable `{0}`")]
    Setting(&'static str),
    /// The checkpoint uses what the method of gs4d does not have.
    #[error("{what} of {code} has no counterpart in method {method}")]
    Unsupported {
        /// Name of the code.
        code: &'static str,
        /// What the checkpoint uses.
        what: String,
        /// The method that was to hold it.
        method: &'static str,
    },
}
