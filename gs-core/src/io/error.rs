//! Errors of readers and writers: which file, where in it, what was found, what to do.

use crate::camera::CameraError;
use crate::splats::SplatsError;
use std::fmt;
use std::path::Path;

/// A position in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum At {
    /// Byte offset from the start.
    Byte(u64),
    /// Line of a text header, counted from 1.
    Line(u64),
    /// Row of a table (splat index), counted from 0.
    Row(u64),
    /// Entry of a JSON list, counted from 0, with the field last read and the position in the text.
    Entry {
        /// Index in the list, from 0 (0 for a single object).
        index: usize,
        /// Name of the field last read; empty before the first.
        field: Box<str>,
        /// Line and column, counted from 1; zero where unknown.
        text: (u32, u32),
    },
}

impl fmt::Display for At {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            At::Byte(at) => write!(f, "byte {at}"),
            At::Line(at) => write!(f, "header line {at}"),
            At::Row(at) => write!(f, "row {at}"),
            At::Entry { index, field, text } => {
                write!(f, "entry {index}")?;
                if !field.is_empty() {
                    write!(f, ", field `{field}`")?;
                }
                if text.0 > 0 {
                    write!(f, ", line {} column {}", text.0, text.1)?;
                }
                Ok(())
            }
        }
    }
}

/// An error of a reader or writer. Its message ends with what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum IoError {
    /// An error of the operating system.
    #[error("{file}: cannot {action}: {source}")]
    Os {
        /// Name of the file, as given by the caller.
        file: Box<str>,
        /// The action that failed: `open`, `read`, `write` …
        action: &'static str,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The disk, or the share of it that the user may fill, is full.
    #[error("cannot write {file}: {source}; {}{needed} bytes are needed", if *whole { "" } else { "more than " })]
    Full {
        /// Name of the file, as given by the caller.
        file: Box<str>,
        /// The error of the operating system.
        source: std::io::Error,
        /// Bytes of the file.
        needed: u64,
        /// Whether these are all its bytes; otherwise there are more.
        whole: bool,
    },
    /// The content does not follow its format.
    #[error("{file}: {format}: {what} (at {at}); {advice}")]
    Malformed {
        /// Name of the file, as given by the caller.
        file: Box<str>,
        /// Name of the format, such as `PLY`.
        format: &'static str,
        /// Position of the malformed content.
        at: At,
        /// The content that was found.
        what: String,
        /// What the user can do about it.
        advice: &'static str,
    },
    /// The file ends before what its header promises.
    #[error(
        "{file}: {format}: `{field}` needs {need} bytes, only {have} are there (from byte {at}); \
         the file was cut short or its header is wrong: copy or export it again"
    )]
    Truncated {
        /// Name of the file, as given by the caller.
        file: Box<str>,
        /// Name of the format, such as `PLY`.
        format: &'static str,
        /// The part that was being read.
        field: String,
        /// Byte offset where that part starts.
        at: u64,
        /// Bytes it needs (saturated at `u64::MAX`).
        need: u64,
        /// Bytes present from that offset.
        have: u64,
    },
    /// A value is not finite or outside its domain.
    #[error("{file}: row {row}, `{field}` = {value} ({rule}); remove or repair that row")]
    Value {
        /// Name of the file, as given by the caller.
        file: Box<str>,
        /// Row (splat, pixel or list index), counted from 0.
        row: usize,
        /// Name of the property or field.
        field: String,
        /// The value that was found.
        value: f64,
        /// The domain of the field, in words.
        rule: &'static str,
    },
    /// A part that the format requires is absent.
    #[error("{file}: {format}: `{field}` is missing (at {at}); {advice}")]
    Missing {
        /// Name of the file, as given by the caller.
        file: Box<str>,
        /// Name of the format, such as `PLY`.
        format: &'static str,
        /// The position where it is expected.
        at: At,
        /// Name of the property or field.
        field: String,
        /// What the user can do about it.
        advice: &'static str,
    },
    /// A format, version or feature that is known but not read.
    #[error("{file}: {what} is not supported; {advice}")]
    Unsupported {
        /// Name of the file, as given by the caller.
        file: Box<str>,
        /// The format, version or feature that is not supported.
        what: String,
        /// What the user can do about it.
        advice: &'static str,
    },
    /// A quantity above the bounds of [`super::Limits`].
    #[error("{file}: {what} = {value} is above the limit {limit}; raise `{name}` in the limits if the file is sound")]
    Limit {
        /// Name of the file, as given by the caller.
        file: Box<str>,
        /// The quantity that is limited.
        what: &'static str,
        /// The value that was found.
        value: u64,
        /// The largest value that is accepted.
        limit: u64,
        /// The field of [`super::Limits`] that sets the limit.
        name: &'static str,
    },
    /// The target of a write exists and `overwrite` is off.
    #[error("{file}: exists already; choose another name or allow overwriting")]
    Exists {
        /// Name of the file, as given by the caller.
        file: Box<str>,
    },
    /// A camera entry is complete but invalid.
    #[error("{file}: entry {index} (`{name}`): {source}; correct that entry")]
    Camera {
        /// Name of the file, as given by the caller.
        file: Box<str>,
        /// Index in the list, from 0.
        index: usize,
        /// Name that the file gives the entry.
        name: String,
        /// The invalid field and its value.
        source: CameraError,
    },
    /// Splats to be written or activated are invalid.
    #[error("{0}; check the cloud before writing it")]
    Splats(#[from] SplatsError),
}

/// Name of a file and of its format, for the errors of its reader.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub(super) file: &'a str,
    pub(super) format: &'static str,
}

impl Source<'_> {
    pub(super) fn malformed(&self, at: At, what: impl Into<String>, advice: &'static str) -> IoError {
        IoError::Malformed { file: self.file.into(), format: self.format, at, what: what.into(), advice }
    }

    pub(super) fn truncated(&self, field: impl Into<String>, at: usize, need: u64, have: usize) -> IoError {
        let (at, have) = (at as u64, have as u64);
        IoError::Truncated { file: self.file.into(), format: self.format, field: field.into(), at, need, have }
    }

    pub(super) fn value(&self, row: usize, field: impl Into<String>, value: f64, rule: &'static str) -> IoError {
        IoError::Value { file: self.file.into(), row, field: field.into(), value, rule }
    }

    pub(super) fn missing(&self, at: At, field: impl Into<String>, advice: &'static str) -> IoError {
        IoError::Missing { file: self.file.into(), format: self.format, at, field: field.into(), advice }
    }

    pub(super) fn unsupported(&self, what: impl Into<String>, advice: &'static str) -> IoError {
        IoError::Unsupported { file: self.file.into(), what: what.into(), advice }
    }

    pub(super) fn limit(&self, what: &'static str, value: u64, limit: u64, name: &'static str) -> IoError {
        IoError::Limit { file: self.file.into(), what, value, limit, name }
    }
}

/// An error of the operating system with its file and action.
pub(super) fn os(path: &Path, action: &'static str, source: std::io::Error) -> IoError {
    IoError::Os { file: path.display().to_string().into(), action, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_say_what_where_and_what_to_do() {
        let src = Source { file: "a.ply", format: "PLY" };
        let text = src.malformed(At::Line(3), "count `-1`", "give a whole number").to_string();
        assert_eq!(text, "a.ply: PLY: count `-1` (at header line 3); give a whole number");
        let text = src.value(7, "rot_2", f64::NAN, "must be finite").to_string();
        assert_eq!(text, "a.ply: row 7, `rot_2` = NaN (must be finite); remove or repair that row");
        let at = At::Entry { index: 2, field: "fx".into(), text: (4, 9) };
        assert_eq!(at.to_string(), "entry 2, field `fx`, line 4 column 9");
        assert!(src.truncated("vertex", 10, 99, 3).to_string().contains("needs 99 bytes, only 3 are there"));
        assert!(src.limit("rows", 9, 5, "max_rows").to_string().contains("raise `max_rows`"));
    }
}
