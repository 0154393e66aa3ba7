//! Saving a checkpoint where the disk may refuse for a while.

use crate::RunError;
use gs_train::checkpoint::{Checkpoint, CheckpointError};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What a training does when the disk refuses.
pub(crate) struct Patience {
    /// How long to wait before each further try of a checkpoint.
    pub(crate) pauses: Vec<Duration>,
    /// Is called with what the disk refused.
    pub(crate) warn: Box<dyn Fn(&str) + Send>,
}

impl Default for Patience {
    /// Three further tries after 1, 5 and 20 seconds; warnings on stderr.
    fn default() -> Self {
        let warn = |text: &str| drop(writeln!(std::io::stderr(), "warning: {text}"));
        Self { pauses: [1, 5, 20].map(Duration::from_secs).to_vec(), warn: Box::new(warn) }
    }
}

impl Patience {
    /// Saves a step ([`Checkpoint::save_step`]); what the system refuses is tried again.
    ///
    /// # Errors
    /// That of the last try.
    pub(crate) fn save_step(&self, state: &Checkpoint, folder: &Path, step: u32) -> Result<PathBuf, RunError> {
        let mut pauses = self.pauses.iter();
        loop {
            let refused = match state.save_step(folder, step) {
                Err(e @ (CheckpointError::Write(_) | CheckpointError::Io { .. })) => e,
                saved => return Ok(saved?),
            };
            let Some(pause) = pauses.next() else { return Err(refused.into()) };
            let free = free_bytes(folder).map_or(String::new(), |free| format!("; {free} bytes are free"));
            (self.warn)(&format!("{refused}{free}; trying again in {} s", pause.as_secs_f64()));
            std::thread::sleep(*pause);
        }
    }
}

/// Bytes that a user may still write to the disk of a folder; `None` where the system does not say.
#[cfg(unix)]
fn free_bytes(folder: &Path) -> Option<u64> {
    let disk = rustix::fs::statvfs(folder).ok()?;
    disk.f_bavail.checked_mul(disk.f_frsize)
}

#[cfg(not(unix))]
fn free_bytes(_: &Path) -> Option<u64> {
    None
}
