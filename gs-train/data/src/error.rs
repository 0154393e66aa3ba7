//! Errors of readers: what is wrong, where, why it matters, what to do.

mod explained;

use std::fmt;
use std::path::{Path, PathBuf};

use super::options::TimeRange;
use gs_core::io::IoError;

/// Missing files are named one by one up to this many, then counted.
const MISSING_NAMED: usize = 20;

/// Where in the data: the file, and inside it a JSON path, row or byte offset (empty: the whole file).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// Path of the file, as it was opened.
    pub file: PathBuf,
    /// Position inside it, for example `frames[17].time`, `images, row 3` or `byte 120`.
    pub at: String,
}

impl Place {
    /// A place inside a file.
    pub fn new(file: &Path, at: impl Into<String>) -> Self {
        Self { file: file.to_path_buf(), at: at.into() }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file.display())?;
        if self.at.is_empty() { Ok(()) } else { write!(f, ", {}", self.at) }
    }
}

/// Why a data set cannot be used: what is wrong, where, why it matters and what to do.
///
/// `Display` is the headline alone; [`Self::report`] is the text that the command line prints. [`Self::code`] is stable.
///
/// ```
/// use gs_data::{DataOptions, Dataset};
///
/// let e = Dataset::open("no/such/folder".as_ref(), &DataOptions::default()).unwrap_err();
/// assert_eq!(e.code(), "data.path");
/// assert_eq!(
///     e.report(),
///     "error[data.path]: there is no folder no/such/folder\n  why  without it there is nothing to read\n  do   check the path"
/// );
/// ```
#[derive(Debug, thiserror::Error)]
pub enum DataError {
    /// The folder does not exist or is no folder.
    #[error("there is no folder {}", .path.display())]
    NotFound {
        /// The folder asked for.
        path: PathBuf,
    },
    /// No reader recognises the folder, or there is no reader of the name asked for.
    #[error("no known data layout in {} ({looked_for})", .path.display())]
    Layout {
        /// The folder asked for.
        path: PathBuf,
        /// Names of the layouts tried, or the unknown name.
        looked_for: String,
    },
    /// The operating system refused a read.
    #[error("cannot read {}: {source}", .file.display())]
    Read {
        /// Path of the file.
        file: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The operating system refused a write.
    #[error("cannot write {}: {source}", .file.display())]
    Write {
        /// Path of the file.
        file: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The target folder holds files already.
    #[error("{} is not empty", .path.display())]
    Occupied {
        /// Folder or file that exists.
        path: PathBuf,
    },
    /// A file is larger than its reader accepts.
    #[error("{place} needs {bytes} bytes, the limit is {limit}")]
    TooLarge {
        /// The file, and the part of it that is too large.
        place: Place,
        /// Bytes it has or would need.
        bytes: u64,
        /// Most bytes allowed for it.
        limit: u64,
    },
    /// The file is not what its format demands.
    #[error("{place}: {message}")]
    Syntax {
        /// File and position of the first error.
        place: Place,
        /// What the parser found there.
        message: String,
    },
    /// A binary file ends early.
    #[error("{place}: {needed} more bytes are needed, {present} are left")]
    Truncated {
        /// File and byte offset at which it ends.
        place: Place,
        /// Bytes the record needs (or the least a count implies).
        needed: u64,
        /// Bytes left in the file.
        present: u64,
    },
    /// A field is missing, has the wrong type, is not finite or out of its domain.
    #[error("{} is {value}", if .place.at.is_empty() { "a field" } else { .place.at.as_str() })]
    Field {
        /// File, and the field inside it.
        place: Place,
        /// The value found, or `missing`.
        value: String,
        /// What the field must be, or why it matters.
        why: &'static str,
        /// How to correct it, as advice.
        fix: &'static str,
    },
    /// A pose is not a rotation and a translation.
    #[error("{} has no rotation: {what}", .place.at)]
    Pose {
        /// File and field of the matrix or quaternion.
        place: Place,
        /// Measured deviation: lengths, determinant or dot product.
        what: String,
    },
    /// A training time lies outside the range.
    #[error(
        "frame \"{frame}\" has time {value}; {outside} of {total} training times lie outside {range}, all frames are in {span}{}",
        guess(span)
    )]
    Time {
        /// File, and the field inside it.
        place: Place,
        /// Name of the frame's view.
        frame: Box<str>,
        /// The stated time, in the data's units.
        value: f64,
        /// How many of how many training frames lie outside.
        outside: u32,
        /// Number of training frames.
        total: u32,
        /// First and last time of all frames.
        span: TimeRange,
        /// The range that training times must lie in.
        range: TimeRange,
    },
    /// Image files that do not exist; all of them, in file order.
    #[error("{}", missing_headline(.missing, *.total))]
    Missing {
        /// The file that lists them.
        listed_in: PathBuf,
        /// Every missing file, relative to the data folder.
        missing: Vec<PathBuf>,
        /// Number of images the file lists.
        total: usize,
    },
    /// Videos whose frames have not been extracted.
    #[error("{} holds {videos} videos without frames", .folder.display())]
    Video {
        /// The data folder that was opened.
        folder: PathBuf,
        /// Number of video files in it.
        videos: usize,
        /// The shell command that extracts them, run in the folder.
        command: String,
    },
    /// A path inside the data leaves the data folder.
    #[error("path \"{path}\" leaves the data folder")]
    Escape {
        /// File, and the field inside it.
        place: Place,
        /// The path as the file writes it.
        path: String,
        /// The end of it that exists in the folder: it is a path of another machine.
        inside: Option<Box<str>>,
    },
    /// A camera model without a reader.
    #[error("camera model {model} is not supported")]
    CameraModel {
        /// File and row or field of the camera.
        place: Place,
        /// Name or number of the model, or the coefficients that are not supported.
        model: String,
    },
    /// An image that cannot be decoded.
    #[error("cannot decode {}: {message}", .file.display())]
    Decode {
        /// Path of the image.
        file: PathBuf,
        /// Message of the decoder.
        message: String,
    },
    /// Initial points that cannot be read.
    #[error("cannot read the points: {source}")]
    Points {
        /// Path of the file.
        file: PathBuf,
        /// Error of the PLY reader.
        source: Box<gs_core::io::IoError>,
    },
    /// The template of a filmed person cannot be read.
    #[error("cannot read the template: {source}")]
    Character {
        /// Path of the file.
        file: PathBuf,
        /// Error of the template's reader.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// An image whose size is not that of its camera.
    #[error("{} is {}x{}, its camera is {}x{}", .file.display(), .got[0], .got[1], .want[0], .want[1])]
    ImageSize {
        /// Path of the image or mask.
        file: PathBuf,
        /// Width and height of the image, pixels.
        got: [u32; 2],
        /// Width and height that the camera states, pixels.
        want: [u32; 2],
    },
    /// No training view is left.
    #[error("{} gives no training view", .file.display())]
    Empty {
        /// The file that should list them.
        file: PathBuf,
    },
    /// An option, or an argument of a generated scene, outside its domain.
    #[error("{name} = {value} is not possible: {rule}")]
    Option {
        /// Name of the option, for example `data.scale`.
        name: &'static str,
        /// The value given, as text.
        value: String,
        /// The values allowed, as text.
        rule: String,
    },
    /// An option that has no effect on these data.
    #[error("{name} = {value} has no effect: {rule}")]
    Idle {
        /// Name of the option, for example `data.fps`.
        name: &'static str,
        /// The value given, as text.
        value: String,
        /// Why it has none, as text.
        rule: String,
    },
}

fn missing_headline(missing: &[PathBuf], total: usize) -> String {
    let named: Vec<String> = missing.iter().take(MISSING_NAMED).map(|p| p.display().to_string()).collect();
    let rest = missing.len().saturating_sub(MISSING_NAMED);
    let more = if rest > 0 { format!(" and {rest} more") } else { String::new() };
    format!("{} of {total} images are missing: {}{more}", missing.len(), named.join(", "))
}

impl DataError {
    /// [`Self::Field`] for a camera whose fields are out of their domain.
    pub(crate) fn camera(place: &Place, e: &gs_core::camera::CameraError) -> Self {
        Self::Field {
            place: place.clone(),
            value: format!("no usable camera ({e})"),
            why: "every ray of the view depends on it",
            fix: "correct the intrinsics, the pose or the size of the image",
        }
    }

    /// [`Self::Field`] for a value at the position `at` of a file that another program writes; a long one is cut.
    pub(crate) fn unexpected(file: &Path, at: &str, value: &str, why: &'static str) -> Self {
        let value = value.chars().take(80).collect();
        Self::Field { place: Place::new(file, at), value, why, fix: "export the file again" }
    }

    /// [`Self::Syntax`] at the position `at` of a file.
    pub fn syntax(file: &Path, at: impl Into<String>, message: impl Into<String>) -> Self {
        Self::Syntax { place: Place::new(file, at), message: message.into() }
    }

    /// [`Self::Read`] for a file the system did not let us read.
    pub fn read(file: &Path, source: std::io::Error) -> Self {
        Self::Read { file: file.to_path_buf(), source }
    }

    /// [`Self::Write`] for a file the system did not let us write.
    pub fn write(file: &Path, source: std::io::Error) -> Self {
        Self::Write { file: file.to_path_buf(), source }
    }

    /// [`Self::Write`] for a file that could not be written whole; [`Self::Occupied`] if it exists.
    pub fn unwritten(file: &Path, error: IoError) -> Self {
        let source = match error {
            IoError::Exists { .. } => return Self::Occupied { path: file.to_path_buf() },
            IoError::Os { source, .. } => source,
            IoError::Full { source, needed, .. } => {
                std::io::Error::new(source.kind(), format!("{source}; {needed} bytes are needed"))
            }
            other => std::io::Error::other(other),
        };
        Self::write(file, source)
    }

    /// [`Self::Decode`] for an image, with the decoder's message.
    pub fn decode(file: &Path, message: impl fmt::Display) -> Self {
        Self::Decode { file: file.to_path_buf(), message: message.to_string() }
    }
}

/// What times in such a range are, where their size tells.
fn guess(span: &TimeRange) -> &'static str {
    let whole = span.start.fract() == 0.0 && span.end.fract() == 0.0;
    match span.end {
        end if end > 1e14 => " (microseconds since 1970, it seems)",
        end if end > 1e11 => " (milliseconds since 1970, it seems)",
        end if end > 1e8 => " (seconds since 1970, it seems)",
        end if whole && end >= 2.0 => " (frame numbers, it seems)",
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_files_are_named_up_to_twenty_then_counted() {
        let missing = |n: usize| DataError::Missing {
            listed_in: "transforms.json".into(),
            missing: (0..n).map(|i| PathBuf::from(format!("images/{i:02}.png"))).collect(),
            total: 67,
        };
        let text = missing(17).to_string();
        assert!(text.starts_with("17 of 67 images are missing: images/00.png, ") && text.ends_with("images/16.png"));
        assert!(missing(23).to_string().ends_with("images/19.png and 3 more"));
    }
}
