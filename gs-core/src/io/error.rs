//! What goes wrong at the border: which file, where in it, what was met, what to do.

use crate::camera::CameraError;
use crate::splats::SplatsError;
use std::fmt;
use std::path::Path;

/// Where in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum At {
    /// Byte offset from the start.
    Byte(u64),
    /// Line of a text header, counted from 1.
    Line(u64),
    /// Row of a table (splat index), counted from 0.
    Row(u64),
    /// Entry of a JSON list, counted from 0, with the field last met and the position in the text.
    Entry {
        /// Index in the list (0 for a single object).
        index: usize,
        /// Field last met; empty before the first.
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

/// Reading or writing failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum IoError {
    /// The operating system said no.
    #[error("{file}: cannot {action}: {source}")]
    Os {
        /// File name as given.
        file: Box<str>,
        /// What was tried: `open`, `read`, `write` …
        action: &'static str,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The content does not follow its format.
    #[error("{file}: {format}: {what} (at {at}); {advice}")]
    Malformed {
        /// File name as given.
        file: Box<str>,
        /// Format name.
        format: &'static str,
        /// Place of the offence.
        at: At,
        /// What was met.
        what: String,
        /// What to do.
        advice: &'static str,
    },
    /// The file ends before what its header promises.
    #[error(
        "{file}: {format}: `{field}` needs {need} bytes, only {have} are there (from byte {at}); \
         the file was cut short or its header is wrong: copy or export it again"
    )]
    Truncated {
        /// File name as given.
        file: Box<str>,
        /// Format name.
        format: &'static str,
        /// What was being read.
        field: String,
        /// Offset where it starts.
        at: u64,
        /// Bytes needed (saturated at `u64::MAX` when the product overflows).
        need: u64,
        /// Bytes present.
        have: u64,
    },
    /// A value is not finite or outside its domain.
    #[error("{file}: row {row}, `{field}` = {value} ({rule}); remove or repair that row")]
    Value {
        /// File name as given.
        file: Box<str>,
        /// Row (splat, pixel or list index), counted from 0.
        row: usize,
        /// Property or field name.
        field: String,
        /// Value met.
        value: f64,
        /// What the field must satisfy.
        rule: &'static str,
    },
    /// Something the format needs is absent.
    #[error("{file}: {format}: `{field}` is missing (at {at}); {advice}")]
    Missing {
        /// File name as given.
        file: Box<str>,
        /// Format name.
        format: &'static str,
        /// Where it was looked for.
        at: At,
        /// Property or field name.
        field: String,
        /// What to do.
        advice: &'static str,
    },
    /// A format, version or feature that is known but not read.
    #[error("{file}: {what} is not supported; {advice}")]
    Unsupported {
        /// File name as given.
        file: Box<str>,
        /// Format, version or feature.
        what: String,
        /// What to do.
        advice: &'static str,
    },
    /// More than [`super::Limits`] allow.
    #[error("{file}: {what} = {value} is above the limit {limit}; raise `{name}` in the limits if the file is sound")]
    Limit {
        /// File name as given.
        file: Box<str>,
        /// Quantity.
        what: &'static str,
        /// Value met.
        value: u64,
        /// Largest accepted.
        limit: u64,
        /// Field of [`super::Limits`].
        name: &'static str,
    },
    /// The target of a write exists.
    #[error("{file}: exists already; choose another name or allow overwriting")]
    Exists {
        /// File name as given.
        file: Box<str>,
    },
    /// A camera entry is complete but not a camera.
    #[error("{file}: entry {index} (`{name}`): {source}; correct that entry")]
    Camera {
        /// File name as given.
        file: Box<str>,
        /// Index in the list.
        index: usize,
        /// Name of the entry.
        name: String,
        /// Field and value.
        source: CameraError,
    },
    /// Splats to be written, or activated, are not sound.
    #[error("{0}; check the cloud before writing it")]
    Splats(#[from] SplatsError),
}

/// Name of a file and of its format, to make errors with.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub file: &'a str,
    pub format: &'static str,
}

impl Source<'_> {
    pub fn malformed(&self, at: At, what: impl Into<String>, advice: &'static str) -> IoError {
        IoError::Malformed { file: self.file.into(), format: self.format, at, what: what.into(), advice }
    }

    pub fn truncated(&self, field: impl Into<String>, at: usize, need: u64, have: usize) -> IoError {
        let (at, have) = (at as u64, have as u64);
        IoError::Truncated { file: self.file.into(), format: self.format, field: field.into(), at, need, have }
    }

    pub fn value(&self, row: usize, field: impl Into<String>, value: f64, rule: &'static str) -> IoError {
        IoError::Value { file: self.file.into(), row, field: field.into(), value, rule }
    }

    pub fn missing(&self, at: At, field: impl Into<String>, advice: &'static str) -> IoError {
        IoError::Missing { file: self.file.into(), format: self.format, at, field: field.into(), advice }
    }

    pub fn unsupported(&self, what: impl Into<String>, advice: &'static str) -> IoError {
        IoError::Unsupported { file: self.file.into(), what: what.into(), advice }
    }

    pub fn limit(&self, what: &'static str, value: u64, limit: u64, name: &'static str) -> IoError {
        IoError::Limit { file: self.file.into(), what, value, limit, name }
    }
}

/// An operating-system error with its file and action.
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
