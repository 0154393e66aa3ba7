//! `transforms*.json`: a few scalars and a long list of frames, read with a bound on memory and the JSON path of
//! every error.
//!
//! Frames are kept as slices of the text and parsed one at a time, so memory stays near the size of the file. Python writes `NaN` and `Infinity` bare, which JSON forbids; they are accepted as tokens so that the field that
//! holds one can be named.

mod document;
mod fields;
mod raw;

pub(crate) use document::Document;
pub(crate) use fields::{Fields, whole};
pub(crate) use raw::{slices, with_large};

use std::borrow::Cow;
use std::path::Path;

use serde_json::{Map, Value};

use super::error::DataError;
use super::files::read_text;

/// Largest JSON file read.
pub(crate) const MAX_JSON_BYTES: u64 = 64 << 20;

/// The error of the parser, at its line and column or at the JSON path `prefix`.
fn syntax(file: &Path, prefix: &str, e: &serde_json::Error) -> DataError {
    let line = if prefix.is_empty() { format!("line {}, column {}", e.line(), e.column()) } else { prefix.to_string() };
    let text = e.to_string();
    let message = text.split(" at line ").next().unwrap_or(&text);
    DataError::syntax(file, line, message)
}

/// Reads a small JSON file that is one object. Python's bare `NaN` and `Infinity` become strings, so that readers can name the
/// field that holds one.
///
/// ```
/// # let folder = tempfile::tempdir()?;
/// let file = folder.path().join("scene.json");
/// std::fs::write(&file, r#"{"scale": 0.5, "near": NaN}"#)?;
/// let map = gs_data::json::read_object(&file, 1 << 10)?;
/// assert_eq!((map["scale"].as_f64(), map["near"].as_str()), (Some(0.5), Some("NaN")));
/// assert_eq!(gs_data::json::read_object(&file, 8).unwrap_err().code(), "limits.file");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// `limits.file` above `limit` bytes, `io.read`, `data.syntax` with line and column.
pub fn read_object(file: &Path, limit: u64) -> Result<Map<String, Value>, DataError> {
    let text = read_text(file, limit)?;
    serde_json::from_str(&quote_non_finite(&text)).map_err(|e| syntax(file, "", &e))
}

/// Puts Python's bare `NaN`, `Infinity` and `-Infinity` in quotes, outside of strings.
pub(crate) fn quote_non_finite(text: &str) -> Cow<'_, str> {
    if !text.contains("NaN") && !text.contains("Infinity") {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + text.len() / 2 + 8);
    let (mut quoted, mut escaped, mut rest) = (false, false, text);
    while let Some(c) = rest.chars().next() {
        let token = ["NaN", "Infinity", "-Infinity"].into_iter().find(|t| !quoted && rest.starts_with(t));
        if let Some(token) = token {
            out.push('"');
            out.push_str(token);
            out.push('"');
            rest = &rest[token.len()..];
            continue;
        }
        if c == '"' && !(quoted && escaped) {
            quoted = !quoted;
        }
        escaped = quoted && !escaped && c == '\\';
        out.push(c);
        rest = &rest[c.len_utf8()..];
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn parse(text: &str) -> Result<Document<'_>, DataError> {
        Document::parse(Path::new("t.json"), text)
    }

    #[test]
    fn python_constants_are_named() {
        let text = r#"{"a": "NaN stays \" NaN", "camera_angle_x": -Infinity, "frames": [{"time": NaN}]}"#;
        let quoted = quote_non_finite(text);
        let d = parse(&quoted).unwrap();
        assert_eq!(d.top().text("a").unwrap(), Some("NaN stays \" NaN"));
        assert_eq!(d.top().number("camera_angle_x").unwrap_err().to_string(), "camera_angle_x is -Infinity");
        assert_eq!(d.frame(0).unwrap().number("time").unwrap_err().to_string(), "frames[0].time is NaN");
    }
}
