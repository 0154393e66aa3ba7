//! What goes wrong when a character is read: which file, where in it, what was met, what to do.

use gs_core::io::IoError;

/// A character could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CharacterError {
    /// A file could not be opened or decoded.
    #[error(transparent)]
    Io(#[from] IoError),
    /// The text is no glTF or OBJ.
    #[error("{file}: {what}; the file is damaged or of another kind: export it again")]
    Syntax {
        /// File name as given.
        file: Box<str>,
        /// What the parser met.
        what: String,
    },
    /// Something in the file does not fit its format.
    #[error("{file}: {place}: {what}; export the character again")]
    Malformed {
        /// File name as given.
        file: Box<str>,
        /// The thing that is wrong, such as `accessor 3`.
        place: String,
        /// What is wrong with it.
        what: String,
    },
    /// A value is not finite or outside its domain.
    #[error("{file}: {place}, row {row}, component {component}: {value} is not finite; repair that row")]
    NotFinite {
        /// File name as given.
        file: Box<str>,
        /// The table, such as `accessor 3`.
        place: String,
        /// Row, counted from 0.
        row: usize,
        /// Component of the row, counted from 0.
        component: usize,
        /// Value met.
        value: f64,
    },
    /// A URI that is not followed.
    #[error("{file}: `{uri}` {why}; keep what the asset refers to in its own folder, under plain relative names")]
    Path {
        /// File name as given.
        file: Box<str>,
        /// The URI, shortened.
        uri: String,
        /// Why it is refused.
        why: &'static str,
    },
    /// A feature that is known but not read.
    #[error("{file}: {what} is not supported; {advice}")]
    Unsupported {
        /// File name as given.
        file: Box<str>,
        /// The feature.
        what: String,
        /// What to do.
        advice: &'static str,
    },
    /// The file asks for more than its size allows.
    #[error("{file}: {what} needs more memory than a file of this size may ask for; its counts are wrong, or split it")]
    TooMuch {
        /// File name as given.
        file: Box<str>,
        /// What was about to be made.
        what: String,
    },
    /// Texture coordinates are needed and absent.
    #[error("{file}: {what} has no texture coordinates; unwrap the mesh, or have it laid out anew (auto_uv)")]
    NoUv {
        /// File name as given.
        file: Box<str>,
        /// The mesh or file.
        what: String,
    },
    /// There is nothing to draw.
    #[error("{file}: no triangles in the scene; give a file with a mesh")]
    Empty {
        /// File name as given.
        file: Box<str>,
    },
}
