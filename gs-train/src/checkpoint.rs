//! Checkpoints: the whole state of a run in one file that is either complete and verified, or not there.
//!
//! # Promise
//! [`Checkpoint::save`] writes the file whole or not at all ([`gs_core::io::write_file`]). A process killed at any moment
//! leaves the older file or the newer one, never a mixture.
//! [`load_newest`] takes the newest file that verifies and tells which it skipped, and why.
//!
//! # File
//! All integers little endian. A file is a header and a fixed number of sections, and nothing behind them:
//! ```text
//! header   "GS4DCKPT"  version u32  sections u32  crc32 u32 (of the 16 bytes before)
//! section  name_len u32  payload_len u64  name  payload  crc32 u32 (of everything before, from name_len on)
//! ```
//! The first section is `meta` (JSON: step, configuration, schedule, counters); every other is a tensor: in a file of
//! version 1 of `f32`, kept bit for bit, in one of version 2 packed ([`Encoding`]).

mod container;
mod half;
mod packed;

use container::Fault;
pub use container::{PACKED_VERSION, VERSION};
use gs_core::io::{IoError, disk, temporary_beside, write_file};
pub use packed::{Coding, Encoding};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Checkpoints kept in a folder by [`Checkpoint::save_step`].
pub const KEPT: usize = 2;

/// The state of a run: free-form values and named tensors, in a fixed order.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Checkpoint {
    /// Everything that is not a tensor: step, configuration, schedule, counters. Finite `f64` values survive exactly.
    pub meta: serde_json::Value,
    /// Named blocks of `f32`, kept bit for bit (NaN payloads, denormals, −0 included).
    pub tensors: Vec<(String, Vec<f32>)>,
}

/// Why a checkpoint was not written or not read.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The file system refused to do `action` with `path`.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// Verb of the message: `read`, `write`, …
        action: &'static str,
        /// File or folder that was used.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file cannot be written.
    #[error(transparent)]
    Write(Box<IoError>),
    /// The bytes are not those that were written.
    #[error("{} is damaged at byte {offset}: {what}", path.display())]
    Damaged {
        /// File that was read.
        path: PathBuf,
        /// Byte at which the fault was noticed.
        offset: u64,
        /// What is wrong at that byte.
        what: String,
    },
    /// Written by another version of the layout.
    #[error("{} has checkpoint layout {found}, this program reads {VERSION} and {PACKED_VERSION}", path.display())]
    Version {
        /// File that was read.
        path: PathBuf,
        /// Layout version in its head.
        found: u32,
    },
    /// The state cannot be written down.
    #[error("checkpoint state cannot be stored: {0}")]
    State(String),
    /// No file of the folder verifies.
    #[error("no usable checkpoint in {}{}", dir.display(), list(skipped))]
    NoneUsable {
        /// Folder that was searched for checkpoints.
        dir: PathBuf,
        /// Files that were refused, newest first.
        skipped: Vec<Skipped>,
    },
    /// A tensor the program needs is missing or has another size.
    #[error("checkpoint tensor `{name}`: {what}")]
    Tensor {
        /// Name of the block or buffer.
        name: String,
        /// What is wrong with it.
        what: String,
    },
}

/// A file that was passed over.
#[derive(Clone, Debug, PartialEq)]
pub struct Skipped {
    /// File that was not used.
    pub path: PathBuf,
    /// Why it was not used: the message of its [`CheckpointError`].
    pub why: String,
}

/// The newest checkpoint of a folder that verifies.
#[derive(Debug)]
pub struct Newest {
    /// Its content, verified by checksum.
    pub checkpoint: Checkpoint,
    /// File it was read from.
    pub path: PathBuf,
    /// Newer files that did not verify, newest first.
    pub skipped: Vec<Skipped>,
}

fn list(skipped: &[Skipped]) -> String {
    skipped.iter().map(|s| format!("\n  skipped: {}", s.why)).collect()
}

fn io_error(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> CheckpointError {
    move |source| CheckpointError::Io { action, path: path.to_owned(), source }
}

impl Checkpoint {
    /// The tensor of that name.
    ///
    /// # Errors
    /// If there is none.
    pub fn tensor(&self, name: &str) -> Result<&[f32], CheckpointError> {
        let found = self.tensors.iter().find(|(n, _)| n == name);
        found.map(|(_, v)| v.as_slice()).ok_or_else(|| CheckpointError::Tensor {
            name: name.to_owned(),
            what: "is not in this checkpoint".to_owned(),
        })
    }

    /// Takes the tensor of that name out.
    ///
    /// # Errors
    /// If there is none, or if it was taken before.
    pub fn take(&mut self, name: &str) -> Result<Vec<f32>, CheckpointError> {
        let at = self.tensors.iter().position(|(n, _)| n == name).ok_or_else(|| CheckpointError::Tensor {
            name: name.to_owned(),
            what: "is not in this checkpoint".to_owned(),
        })?;
        Ok(self.tensors.swap_remove(at).1)
    }

    /// Writes the file so that `path` holds the older state or this one at every moment.
    ///
    /// # Errors
    /// If the file system refuses: what was at `path` is untouched then, and no temporary file is left.
    pub fn save(&self, path: &Path) -> Result<(), CheckpointError> {
        self.write(path, |mut out, meta| container::write(&mut out, meta, &self.tensors))
    }

    /// Writes the file with packed tensors, the i-th by the i-th encoding, in the same safe way; gives the bytes of each.
    ///
    /// # Errors
    /// As [`Checkpoint::save`].
    pub fn save_packed(&self, path: &Path, encodings: &[Encoding]) -> Result<Vec<usize>, CheckpointError> {
        if encodings.len() != self.tensors.len() {
            let (n, m) = (encodings.len(), self.tensors.len());
            return Err(CheckpointError::State(format!("{n} encodings for {m} tensors")));
        }
        self.write(path, |mut out, meta| container::write_packed(&mut out, meta, &self.tensors, encodings))
    }

    fn write<T>(
        &self,
        path: &Path,
        content: impl FnOnce(&mut dyn Write, &[u8]) -> io::Result<T>,
    ) -> Result<T, CheckpointError> {
        let meta = serde_json::to_vec(&self.meta).map_err(|e| CheckpointError::State(e.to_string()))?;
        write_file(path, true, |out| content(out, &meta)).map_err(|e| CheckpointError::Write(Box::new(e)))
    }

    /// Reads a file and verifies every byte of it.
    ///
    /// # Errors
    /// If it cannot be read, is damaged (with the byte offset) or has another layout version.
    pub fn load(path: &Path) -> Result<Self, CheckpointError> {
        // Opening a pipe would wait for somebody to write to it.
        if fs::metadata(path).is_ok_and(|meta| !meta.is_file()) {
            return Err(io_error("open", path)(io::Error::other("it is no regular file")));
        }
        let file = File::open(path).map_err(io_error("open", path))?;
        let bytes = file.metadata().map_err(io_error("read", path))?.len();
        container::read(&mut io::BufReader::new(file), bytes).map_err(|fault| fault.of(path))
    }

    /// The bytes of the file.
    pub(crate) fn to_bytes(&self) -> Result<Vec<u8>, CheckpointError> {
        let meta = serde_json::to_vec(&self.meta).map_err(|e| CheckpointError::State(e.to_string()))?;
        let mut bytes = Vec::new();
        let written = container::write(&mut bytes, &meta, &self.tensors);
        written.map_err(|e| CheckpointError::State(e.to_string()))?;
        Ok(bytes)
    }

    /// What [`Checkpoint::to_bytes`] gave.
    pub(crate) fn from_bytes(bytes: &[u8]) -> Result<Self, CheckpointError> {
        container::read(&mut &bytes[..], bytes.len() as u64).map_err(|fault| fault.of(Path::new("state of a run")))
    }

    /// Saves as `dir/step-012000.gs4d`, points `dir/latest` at it, and removes all but the [`KEPT`] newest up to this step.
    ///
    /// # Errors
    /// As [`Checkpoint::save`]. Older files are removed only after this one is safe on the disk.
    pub fn save_step(&self, dir: &Path, step: u32) -> Result<PathBuf, CheckpointError> {
        let path = dir.join(file_name(step));
        self.save(&path)?;
        point_latest(dir, step)?;
        let older = steps_in(dir)?.into_iter().filter(|&s| s <= step);
        for old in older.skip(KEPT) {
            let old = dir.join(file_name(old));
            disk::remove_file(&old).map_err(io_error("remove the older", &old))?;
        }
        Ok(path)
    }
}

impl Fault {
    /// The fault with the file it was met in.
    fn of(self, path: &Path) -> CheckpointError {
        let path = path.to_owned();
        match self {
            Fault::Io(source) => CheckpointError::Io { action: "read", path, source },
            Fault::Version(found) => CheckpointError::Version { path, found },
            Fault::At(offset, what) => CheckpointError::Damaged { path, offset, what },
        }
    }
}

/// Name of the checkpoint of a step: `step-012000.gs4d`.
pub fn file_name(step: u32) -> String {
    format!("step-{step:06}.gs4d")
}

/// Steps of the checkpoints in a folder, newest first.
///
/// # Errors
/// If the folder cannot be read.
pub fn steps_in(dir: &Path) -> Result<Vec<u32>, CheckpointError> {
    let mut steps = Vec::new();
    for entry in fs::read_dir(dir).map_err(io_error("list", dir))? {
        let name = entry.map_err(io_error("list", dir))?.file_name();
        let digits = name.to_str().and_then(|n| n.strip_prefix("step-")?.strip_suffix(".gs4d"));
        steps.extend(digits.and_then(|d| d.parse::<u32>().ok()).filter(|&s| name.to_str() == Some(&file_name(s))));
    }
    steps.sort_unstable_by(|a, b| b.cmp(a));
    Ok(steps)
}

/// The newest checkpoint of a folder that verifies.
///
/// # Errors
/// If none does; the error lists each file and what is wrong with it.
pub fn load_newest(dir: &Path) -> Result<Newest, CheckpointError> {
    let mut skipped = Vec::new();
    for step in steps_in(dir)? {
        let path = dir.join(file_name(step));
        match Checkpoint::load(&path) {
            Ok(checkpoint) => return Ok(Newest { checkpoint, path, skipped }),
            Err(e) => skipped.push(Skipped { why: e.to_string(), path }),
        }
    }
    Err(CheckpointError::NoneUsable { dir: dir.to_owned(), skipped })
}

/// `latest` is for people and scripts; nothing here reads it.
#[cfg(unix)]
fn point_latest(dir: &Path, step: u32) -> Result<(), CheckpointError> {
    let link = dir.join("latest");
    let temporary = temporary_beside(&link);
    let linked = disk::link(&file_name(step), &temporary).and_then(|()| disk::rename(&temporary, &link));
    linked.map_err(|e| {
        // Best effort: the first error is the one that is returned.
        let _ = disk::remove_file(&temporary);
        io_error("link", &link)(e)
    })
}

#[cfg(not(unix))]
fn point_latest(_: &Path, _: u32) -> Result<(), CheckpointError> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tensors_by_name() {
        let mut c = Checkpoint { tensors: vec![("cloud.means".into(), vec![1.0, -2.5])], ..Checkpoint::default() };
        assert_eq!(c.tensor("cloud.means").unwrap().len(), 2);
        assert_eq!(c.take("cloud.means").unwrap(), [1.0, -2.5]);
        assert!(c.take("cloud.means").unwrap_err().to_string().contains("`cloud.means`"));
    }
}
