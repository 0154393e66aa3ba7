//! Errors of runs.

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

/// A run that cannot start, continue or be read.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The folder is not empty.
    #[error("{} {}", path.display(), if *is_run { "holds a run already" } else { "holds files that are not a run's" })]
    Occupied {
        /// The folder a run was to begin in.
        path: PathBuf,
        /// Whether it holds an older run, which can be overwritten on request.
        is_run: bool,
    },
    /// The folder holds no run.
    #[error("{} is no run folder: it has no {}", path.display(), super::folder::CONFIG)]
    NotARun {
        /// The folder without a run.
        path: PathBuf,
    },
    /// A checkpoint without settings, outside of a run folder.
    #[error("{} holds no settings and lies in no run folder", path.display())]
    NoSettings {
        /// The checkpoint file without settings.
        path: PathBuf,
    },
    /// Another process holds the lock of the folder.
    #[error("another process is writing to {}", path.display())]
    Busy {
        /// The folder with the lock.
        path: PathBuf,
    },
    /// The requested rounds of continual training are not possible.
    #[error("{0}")]
    Rounds(String),
    /// The requested number of steps is not possible.
    #[error("{0}")]
    Steps(String),
    /// The file system refused to do `action` with `path`.
    #[error("cannot {action} {}: {source}", path.display())]
    Os {
        /// The operation, as a verb.
        action: &'static str,
        /// File or folder that was used.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file could not be written or read.
    #[error(transparent)]
    Io(#[from] IoError),
    /// A setting is unknown or has a wrong value.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The data cannot be used.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The method cannot be built.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// A checkpoint cannot be written or read.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// A training step failed, or the run cannot be resumed.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// A view cannot be rendered or scored.
    #[error(transparent)]
    Eval(#[from] EvalError),
    /// The report cannot be rendered.
    #[error(transparent)]
    Report(#[from] ReportError),
}

impl RunError {
    pub(crate) fn io(action: &'static str, path: &Path, source: io::Error) -> Self {
        RunError::Os { action, path: path.to_owned(), source }
    }
}
