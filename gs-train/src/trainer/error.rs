//! Why training stops.

use crate::method::MethodError;
use gs_data::DataError;

/// Why training cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The data cannot be read.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The method cannot be built.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// Gradients were not finite, too many or in a weight that all splats share. The parameters are to be thrown away.
    #[error("step {step}, view {view}: {what}; go back to the last checkpoint and lower the learning rates")]
    Numeric {
        /// Number of the step, from 1.
        step: u32,
        /// Name of the view, or of all views of the batch.
        view: String,
        /// What was met, and where.
        what: String,
    },
    /// A checkpoint does not fit.
    #[error("checkpoint: {0}")]
    State(String),
    /// The schedule is at its end.
    #[error("the schedule ends at step {0}; lengthen a stage to go on")]
    Finished(u32),
}

impl TrainError {
    /// The exit code of the command line: 3 data, 4 numerical failure, 2 wrong usage.
    pub fn exit_code(&self) -> u8 {
        match self {
            TrainError::Data(_) => 3,
            TrainError::Numeric { .. } => 4,
            TrainError::Method(_) | TrainError::State(_) | TrainError::Finished(_) => 2,
        }
    }
}
