//! Bytes that a file refers to: `data:` URIs, or files in its folder.

use super::error::CharacterError;
use gs_core::io::{Limits, read_file};
use std::path::{Path, PathBuf};

/// The folder of a character's file, and the limits of reading.
pub(super) struct Folder<'a> {
    /// Name of the character's file, for errors.
    pub(super) file: &'a str,
    /// Its folder; `None` for a character from memory.
    pub(super) path: Option<&'a Path>,
    pub(super) limits: &'a Limits,
}

impl Folder<'_> {
    /// The bytes of a URI.
    pub(super) fn read(&self, uri: &str) -> Result<Vec<u8>, CharacterError> {
        match uri.strip_prefix("data:") {
            Some(data) => data_uri(data).ok_or_else(|| self.refused(uri, "is no base64 data")),
            None => Ok(read_file(&self.inside(uri)?, self.limits)?),
        }
    }

    /// The path of a relative URI, inside the folder also after links are resolved.
    fn inside(&self, uri: &str) -> Result<PathBuf, CharacterError> {
        let Some(folder) = self.path else {
            return Err(self.refused(uri, "is another file, and this one was read from memory"));
        };
        let name = percent_decoded(uri).ok_or_else(|| self.refused(uri, "is no text"))?;
        if name.contains([':', '\\', '\0']) || name.starts_with('/') || name.is_empty() {
            return Err(self.refused(uri, "is not a plain relative path"));
        }
        if name.split('/').any(|part| part == "..") {
            return Err(self.refused(uri, "leads out of the folder"));
        }
        let path = folder.join(&name);
        let os = |source| gs_core::io::IoError::Os { file: path.display().to_string().into(), action: "open", source };
        let real = path.canonicalize().map_err(os)?;
        if !real.starts_with(folder.canonicalize().map_err(os)?) {
            return Err(self.refused(uri, "is a link out of the folder"));
        }
        Ok(real)
    }

    fn refused(&self, uri: &str, why: &'static str) -> CharacterError {
        let shown: String = uri.chars().take(80).collect();
        CharacterError::Path { file: self.file.into(), uri: shown, why }
    }
}

/// The file name of a URI: `%41` is `A`; `None` if the result is not UTF-8 or an escape is incomplete.
///
/// ```
/// assert_eq!(gs_texel::read::percent_decoded("skin%20tex.png").as_deref(), Some("skin tex.png"));
/// ```
pub fn percent_decoded(uri: &str) -> Option<String> {
    let mut out = Vec::with_capacity(uri.len());
    let mut bytes = uri.bytes();
    while let Some(b) = bytes.next() {
        if b == b'%' {
            let digit = |d: Option<u8>| d.and_then(|d| char::from(d).to_digit(16));
            let value = 16 * digit(bytes.next())? + digit(bytes.next())?;
            out.push(value as u8);
        } else {
            out.push(b);
        }
    }
    String::from_utf8(out).ok()
}

/// The bytes of `[<type>];base64,<text>`.
fn data_uri(data: &str) -> Option<Vec<u8>> {
    let (head, text) = data.split_once(',')?;
    if !head.ends_with(";base64") {
        return None;
    }
    let mut out = Vec::with_capacity(text.len() / 4 * 3 + 3);
    let (mut bits, mut held) = (0u32, 0u32);
    for c in text.trim_end_matches('=').bytes() {
        let value = match c {
            b'A'..=b'Z' => c - b'A',
            b'a'..=b'z' => c - b'a' + 26,
            b'0'..=b'9' => c - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            _ => return None,
        };
        bits = bits << 6 | u32::from(value);
        held += 6;
        if held >= 8 {
            held -= 8;
            out.push((bits >> held) as u8);
            bits &= (1 << held) - 1;
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_uris() {
        assert_eq!(data_uri("application/octet-stream;base64,aGVsbG8=").unwrap(), b"hello");
        assert_eq!(data_uri(";base64,aGVsbG8h").unwrap(), b"hello!");
        assert_eq!(data_uri(";base64,").unwrap(), b"");
        assert_eq!(data_uri("text/plain,hello"), None);
        assert_eq!(data_uri(";base64,a\u{e9}"), None);
        assert_eq!(data_uri("no comma"), None);
    }

    #[test]
    fn escapes() {
        assert_eq!(percent_decoded("a%20b%2Fc").unwrap(), "a b/c");
        for bad in ["%FF", "%", "%4", "%zz", "%+1"] {
            assert_eq!(percent_decoded(bad), None, "{bad}");
        }
    }
}
