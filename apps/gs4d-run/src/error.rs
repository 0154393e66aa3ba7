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
    /// The folder holds a run with other settings than those asked for.
    #[error("{} holds a run with other settings", path.display())]
    OtherSettings {
        /// The folder of the run.
        path: PathBuf,
    },
    /// The run has not reached the end of its schedule.
    #[error("{} is unfinished: its newest checkpoint is of step {step} of {steps}", path.display())]
    Unfinished {
        /// The folder of the run.
        path: PathBuf,
        /// Step of its newest checkpoint, 0 if there is none.
        step: u32,
        /// Steps of its schedule.
        steps: u64,
    },
    /// The run is trained in rounds, and cannot be resumed without them.
    #[error("{} is trained in rounds: go on with `{command}`", path.display())]
    InRounds {
        /// The folder of the run.
        path: PathBuf,
        /// The command that goes on with it.
        command: String,
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
    /// A file of splats, where a run is needed.
    #[error("{} is a splat file, not a run", path.display())]
    SplatFile {
        /// The file.
        path: PathBuf,
    },
    /// A split that is to be scored is empty.
    #[error("the data have no {split} views; they have {others}")]
    NoViews {
        /// Name of the split.
        split: &'static str,
        /// Sizes of the splits that have views.
        others: String,
    },
    /// The data of a run are not where they were, or a scene does not say where they are.
    #[error(
        "{}",
        if path.as_os_str().is_empty() { "this scene does not say where its data are".to_owned() }
        else { format!("the data of this run are not at {}", path.display()) }
    )]
    DataGone {
        /// The folder they were in; empty if it is not known.
        path: PathBuf,
    },
    /// The data are not those that the run began with.
    #[error("the data at {} are not those that the run began with", path.display())]
    DataChanged {
        /// Folder of the data.
        path: PathBuf,
        /// Folder of the run.
        run: PathBuf,
    },
    /// The settings are not those that the run wrote.
    #[error("{} was changed since the run wrote it", path.display())]
    SettingsChanged {
        /// File of the settings.
        path: PathBuf,
    },
    /// All training views have one timestamp, and the method learns motion.
    #[error("all training views of {} have one timestamp, and {method} learns motion", path.display())]
    Static {
        /// Folder of the data.
        path: PathBuf,
        /// The method.
        method: String,
    },
    /// A checkpoint of another method than the run's.
    #[error("{} is of method {found}; this run trains {method}", path.display())]
    OtherMethod {
        /// The checkpoint.
        path: PathBuf,
        /// Its method.
        found: String,
        /// The method of the run.
        method: String,
    },
    /// More memory is needed than may be taken.
    #[error("{what} needs about {need_mib} MiB of memory, and {limit_mib} MiB may be taken")]
    Memory {
        /// What needs it.
        what: String,
        /// Estimate of what it needs, MiB.
        need_mib: u64,
        /// What may be taken, MiB.
        limit_mib: u64,
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
