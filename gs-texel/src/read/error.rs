//! Errors of the readers: which file, where in it, what was found, and what to do.

use gs_core::io::IoError;

/// A character could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CharacterError {
    /// A file could not be opened or decoded.
    #[error(transparent)]
    Io(#[from] IoError),
    /// The text is neither glTF nor OBJ.
    #[error("{file}: {what}; the file is damaged or of another kind: export it again")]
    Syntax {
        /// File name as given.
        file: Box<str>,
        /// What the parser says of the text.
        what: String,
    },
    /// A part of the file violates its format.
    #[error("{file}: {place}: {what}; export the character again")]
    Malformed {
        /// File name as given.
        file: Box<str>,
        /// The invalid part, such as `accessor 3`.
        place: String,
        /// What the format demands and the part lacks.
        what: String,
    },
    /// A value is not finite or outside its domain.
    #[error("{file}: {place}, row {row}, component {component}: {value} is not finite; repair that row")]
    NotFinite {
        /// File name as given.
        file: Box<str>,
        /// The table, such as `accessor 3`.
        place: String,
        /// Row of the table, counted from 0.
        row: usize,
        /// Component of the row, counted from 0.
        component: usize,
        /// The value found: NaN, infinite or out of its domain.
        value: f64,
    },
    /// A URI names nothing that may be read: it leaves the folder, or is no base64 data.
    #[error("{file}: `{uri}` {why}; keep what the asset refers to in its own folder, under plain relative names")]
    Path {
        /// File name as given.
        file: Box<str>,
        /// The URI in the file, shortened for the message.
        uri: String,
        /// Why it is refused, as text.
        why: &'static str,
    },
    /// A feature of the format is not supported.
    #[error("{file}: {what} is not supported; {advice}")]
    Unsupported {
        /// File name as given.
        file: Box<str>,
        /// Name of the feature of the format.
        what: String,
        /// What to do instead, as text.
        advice: &'static str,
    },
    /// The file asks for more than its size allows.
    #[error("{file}: {what} needs more memory than a file of this size may ask for; its counts are wrong, or split it")]
    TooMuch {
        /// File name as given.
        file: Box<str>,
        /// The table that would be allocated.
        what: String,
    },
    /// Texture coordinates are needed and absent.
    #[error("{file}: {what} has no texture coordinates; unwrap the mesh, or have it laid out anew (auto_uv)")]
    NoUv {
        /// File name as given.
        file: Box<str>,
        /// The mesh or file without them.
        what: String,
    },
    /// The scene has no triangles.
    #[error("{file}: no triangles in the scene; give a file with a mesh")]
    Empty {
        /// File name as given.
        file: Box<str>,
    },
}
