//! Errors of an import.

use gs_data::DataError;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;

/// What stopped an import. Stages that were done stay done.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// A program is not installed.
    #[error("{program} is not on the PATH as a file that may be run")]
    Missing {
        /// Its name.
        program: &'static str,
        /// How to install it.
        install: &'static str,
    },
    /// A program failed.
    #[error("{program} failed while it was to {task} ({status}){}", quoted(.tail))]
    Failed {
        /// Its name.
        program: &'static str,
        /// How to install it.
        install: &'static str,
        /// What it was asked for, after "to".
        task: String,
        /// How it ended.
        status: ExitStatus,
        /// Its last lines.
        tail: Vec<String>,
        /// The file with all of its lines.
        log: PathBuf,
    },
    /// Stopped by the caller.
    #[error("stopped while {task}")]
    Stopped {
        /// What was being done.
        task: String,
    },
    /// An input that cannot be used.
    #[error("{what}")]
    Input {
        /// What is wrong.
        what: String,
        /// The file or folder.
        path: PathBuf,
        /// Why that matters.
        why: &'static str,
        /// What to do.
        fix: String,
    },
    /// No cameras were found.
    #[error("{what}")]
    Cameras {
        /// What is wrong.
        what: String,
        /// What to do.
        fix: String,
    },
    /// The folder holds something that no import made.
    #[error("the folder is not empty, and no import made it")]
    Occupied {
        /// The folder.
        folder: PathBuf,
    },
    /// The folder holds an import of other inputs or settings.
    #[error("an import with other {what} is in that folder")]
    Changed {
        /// The folder.
        folder: PathBuf,
        /// What differs.
        what: String,
    },
    /// A data file that cannot be read or written.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A file that cannot be written.
    #[error(transparent)]
    Write(#[from] gs_core::io::IoError),
    /// A failed system call.
    #[error("cannot {action}: {source}")]
    Os {
        /// Completes "cannot …".
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
}

impl ImportError {
    /// For `map_err`: a failed system call on a path; `action` completes "cannot …".
    pub(crate) fn os(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Os { action, path, source }
    }
}

fn quoted(tail: &[String]) -> String {
    tail.iter().map(|line| format!("\n       | {line}")).collect()
}
