//! Why training stops.

use crate::error::RanksError;
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
    /// Another rank cannot go on.
    #[error("rank {rank}: {what}")]
    Rank {
        /// Number of the rank, from 0.
        rank: usize,
        /// Its error.
        what: String,
        /// The exit code of its error.
        code: u8,
    },
    /// Ranks cannot talk to each other.
    #[error(transparent)]
    Ranks(#[from] RanksError),
    /// Ranks hold other parameters than the first one. They are to be thrown away.
    #[error(
        "after step {step} the parameters of {} differ from those of rank 0: their machines compute differently; use \
         machines of one kind, and go back to the last checkpoint",
        list(ranks)
    )]
    Diverged {
        /// Number of the step, from 1.
        step: u32,
        /// The ranks that differ from the first.
        ranks: Vec<usize>,
    },
    /// The schedule is at its end.
    #[error("the schedule ends at step {0}; lengthen a stage to go on")]
    Finished(u32),
}

fn list(ranks: &[usize]) -> String {
    ranks.iter().map(|rank| format!("rank {rank}")).collect::<Vec<_>>().join(", ")
}

impl TrainError {
    /// A message of a rank that ends too early.
    pub(super) fn short(rank: usize) -> Self {
        RanksError::short(rank).into()
    }

    /// The exit code of the command line: 3 data, 4 numerical failure, 5 a device that fails, 2 wrong usage, 6 ranks that cannot
    /// talk, 1 ranks that differ.
    pub fn exit_code(&self) -> u8 {
        match self {
            TrainError::Data(_) => 3,
            TrainError::Numeric { .. } => 4,
            TrainError::Method(MethodError::Device(_)) => 5,
            TrainError::Rank { code, .. } => *code,
            TrainError::Ranks(_) => 6,
            TrainError::Diverged { .. } => 1,
            TrainError::Method(_) | TrainError::State(_) | TrainError::Finished(_) => 2,
        }
    }
}
