//! Why a run cannot begin or go on.

use crate::config::ConfigError;
use gs_core::io::IoError;
use gs_data::DataError;
use gs_train::checkpoint::CheckpointError;
use gs_train::evaluate::EvalError;
use gs_train::method::MethodError;
use gs_train::trainer::TrainError;
use gs4d_report::ReportError;
use std::io;
use std::path::{Path, PathBuf};

/// Why a run cannot begin or go on.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The folder holds something already.
    #[error("{} {}", path.display(), if *is_run { "holds a run already" } else { "holds files that are not a run's" })]
    Occupied {
        /// The folder.
        path: PathBuf,
        /// Whether that is an older run, which may be overwritten when asked.
        is_run: bool,
    },
    /// There is no run.
    #[error("{} is no run folder: it has no {}", path.display(), super::folder::CONFIG)]
    NotARun {
        /// The folder.
        path: PathBuf,
    },
    /// A checkpoint outside a run.
    #[error("{} holds no settings and lies in no run folder", path.display())]
    NoSettings {
        /// The file.
        path: PathBuf,
    },
    /// Somebody else writes to it.
    #[error("another process is writing to {}", path.display())]
    Busy {
        /// The folder.
        path: PathBuf,
    },
    /// The rounds asked for cannot be made.
    #[error("{0}")]
    Rounds(String),
    /// The number of steps asked for cannot be made.
    #[error("{0}")]
    Steps(String),
    /// The file system refused.
    #[error("cannot {action} {}: {source}", path.display())]
    Os {
        /// What was tried.
        action: &'static str,
        /// File or folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// A file could not be written or read.
    #[error(transparent)]
    Io(#[from] IoError),
    /// Settings were refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The data cannot be used.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The method cannot be built.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// A checkpoint was not written or not read.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// Training stopped.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// An evaluation failed.
    #[error(transparent)]
    Eval(#[from] EvalError),
    /// The report was not made.
    #[error(transparent)]
    Report(#[from] ReportError),
}

impl RunError {
    pub(crate) fn io(action: &'static str, path: &Path, source: io::Error) -> Self {
        RunError::Os { action, path: path.to_owned(), source }
    }
}
