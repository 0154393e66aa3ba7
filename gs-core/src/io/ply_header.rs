//! The header of a `.ply` file: elements, their properties, and the offset of the data.
//!
//! Source: G. Turk, "The PLY Polygon File Format", 1994, with the type names of its common dialects (`float32` for
//! `float`, …). Lines end in LF or CRLF; `obj_info` lines are skipped, and comments but for those that say how splats are
//! drawn. A header must end within [`MAX_HEADER`] bytes. Nothing is allocated from a count: counts are only compared with the bytes present.

use super::error::{At, Source};
use super::{IoError, Limits};

/// Largest length of a header, bytes.
const MAX_HEADER: usize = 1 << 20;

/// Encoding of the data after the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    /// Numbers as text, separated by white space.
    Ascii,
    /// Binary, least significant byte first.
    Little,
    /// Binary, most significant byte first.
    Big,
}

/// Number type of a scalar property.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    /// `char` or `int8`, signed 8 bits.
    I8,
    /// `uchar` or `uint8`, unsigned 8 bits.
    U8,
    /// `short` or `int16`, signed 16 bits.
    I16,
    /// `ushort` or `uint16`, unsigned 16 bits.
    U16,
    /// `int` or `int32`, signed 32 bits.
    I32,
    /// `uint` or `uint32`, unsigned 32 bits.
    U32,
    /// `float` or `float32`, single precision.
    F32,
    /// `double` or `float64`, double precision.
    F64,
}

impl Scalar {
    /// Bytes of one binary value.
    pub(super) fn size(self) -> usize {
        match self {
            Scalar::I8 | Scalar::U8 => 1,
            Scalar::I16 | Scalar::U16 => 2,
            Scalar::I32 | Scalar::U32 | Scalar::F32 => 4,
            Scalar::F64 => 8,
        }
    }

    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Scalar::I8,
            "uchar" | "uint8" => Scalar::U8,
            "short" | "int16" => Scalar::I16,
            "ushort" | "uint16" => Scalar::U16,
            "int" | "int32" => Scalar::I32,
            "uint" | "uint32" => Scalar::U32,
            "float" | "float32" => Scalar::F32,
            "double" | "float64" => Scalar::F64,
            _ => return None,
        })
    }
}

/// One scalar property of an element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Property<'a> {
    /// Name as in the header.
    pub(super) name: &'a str,
    /// Number type of its values.
    pub(super) scalar: Scalar,
    /// Byte offset inside a binary row.
    pub(super) offset: usize,
}

/// One element: `count` rows of the same properties.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Element<'a> {
    /// Name as in the header; `vertex` for splats and points.
    pub(super) name: &'a str,
    /// Number of rows according to the header.
    pub(super) count: u64,
    /// Scalar properties in file order.
    pub(super) properties: Vec<Property<'a>>,
    /// Name of the first list property, if any: such rows have no fixed size.
    pub(super) list: Option<&'a str>,
    /// Bytes of a binary row (without lists).
    pub(super) stride: usize,
}

/// A parsed header, borrowing its names from the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Header<'a> {
    /// Encoding of all elements' data.
    pub(super) encoding: Encoding,
    /// Elements, in the order of the file.
    pub(super) elements: Vec<Element<'a>>,
    /// Offset of the first data byte.
    pub(super) data_start: usize,
    /// Whether the last comment that says how splats are drawn says anti-aliased.
    pub(super) antialiased: bool,
}

/// Whether a comment says that splats are drawn anti-aliased; none for a comment on anything else. Source: Brush writes
/// `SplatRenderMode: mip` or `default`, Postshot `antialiased 1` or `0`, and splat-transform 3 reads both, in any case (facts only).
fn antialiased(comment: &str) -> Option<bool> {
    let comment = comment.trim().to_ascii_lowercase();
    match comment.strip_prefix("splatrendermode:") {
        Some(mode) => Some(mode.trim() == "mip"),
        None => comment.strip_prefix("antialiased ").map(|flag| flag.trim() == "1"),
    }
}

/// Reads the lines of a header; `number` counts from 1, `offset` is that of the next line.
struct Lines<'a> {
    bytes: &'a [u8],
    offset: usize,
    number: u64,
}

impl<'a> Lines<'a> {
    fn next(&mut self, src: Source<'_>) -> Result<&'a str, IoError> {
        self.number += 1;
        let rest = self.bytes.get(self.offset..).unwrap_or_default();
        let window = rest.get(..MAX_HEADER.saturating_sub(self.offset).min(rest.len())).unwrap_or_default();
        let Some(end) = window.iter().position(|&b| b == b'\n') else {
            let what = format!("the header does not end (no `end_header` in {} bytes)", self.offset + window.len());
            return Err(src.malformed(At::Line(self.number), what, "the file is cut short or not a PLY file"));
        };
        self.offset += end + 1;
        let line = window.get(..end).unwrap_or_default();
        let line = line.strip_suffix(b"\r").unwrap_or(line);
        std::str::from_utf8(line).map_err(|_| {
            src.malformed(At::Line(self.number), "a header line is not text", "save the header as UTF-8 or ASCII")
        })
    }
}

impl<'a> Header<'a> {
    /// Parses the header at the start of `bytes`.
    ///
    /// # Errors
    /// Names the header line of the first error.
    pub(super) fn parse(bytes: &'a [u8], src: Source<'_>) -> Result<Self, IoError> {
        if bytes.starts_with(b"\xEF\xBB\xBF") {
            let what = "a UTF-8 byte order mark precedes `ply`: a text editor has rewritten the file";
            return Err(src.malformed(At::Byte(0), what, "use the original file"));
        }
        let mut lines = Lines { bytes, offset: 0, number: 0 };
        if lines.next(src)?.trim_end() != "ply" {
            return Err(src.malformed(At::Line(1), "the first line is not `ply`", "give a PLY file"));
        }
        let (mut encoding, mut drawn) = (None, false);
        let mut elements: Vec<Element<'a>> = Vec::new();
        loop {
            let line = lines.next(src)?;
            let at = At::Line(lines.number);
            let mut words = line.split_ascii_whitespace();
            match words.next() {
                None | Some("obj_info") => {}
                Some("comment") => {
                    let text = line.trim_start().strip_prefix("comment").unwrap_or_default();
                    drawn = antialiased(text).unwrap_or(drawn);
                }
                Some("end_header") => break,
                Some("format") => encoding = Some(parse_format(words, at, src)?),
                Some("element") => {
                    let element = parse_element(words, at.clone(), src)?;
                    if elements.iter().any(|e| e.name == element.name) {
                        let what = format!("element `{}` appears twice", clip(element.name));
                        return Err(src.malformed(at, what, "repair the header"));
                    }
                    elements.push(element);
                }
                Some("property") => match elements.last_mut() {
                    Some(element) => parse_property(element, words, at, src)?,
                    None => {
                        return Err(src.malformed(at, "a property before any element", "repair the header"));
                    }
                },
                Some(word) => {
                    let what = format!("unknown header word `{}`", clip(word));
                    return Err(src.malformed(at, what, "repair the header"));
                }
            }
        }
        let Some(encoding) = encoding else {
            return Err(src.missing(At::Line(2), "format", "add a line such as `format binary_little_endian 1.0`"));
        };
        Ok(Self { encoding, elements, data_start: lines.offset, antialiased: drawn })
    }

    /// The element of a name, and the byte offset where its rows start (for text: the start of all data).
    /// Elements before it must have rows of fixed size; its rows and those after it must fit in `len` bytes.
    pub(super) fn locate(
        &self,
        name: &str,
        len: usize,
        limits: &Limits,
        src: Source<'_>,
    ) -> Result<(&Element<'a>, usize, usize), IoError> {
        let mut start = self.data_start;
        for element in &self.elements {
            if let Some(list) = element.list {
                let what = format!("list property `{}` in element `{}`", clip(list), clip(element.name));
                return Err(src.unsupported(what, "export the vertices with plain properties only"));
            }
            // A text value takes a character and a separator; the last separator may be absent.
            let row_bytes = match self.encoding {
                Encoding::Ascii => (2 * element.properties.len()) as u64,
                Encoding::Little | Encoding::Big => element.stride as u64,
            };
            let need = element.count.saturating_mul(row_bytes);
            let have = len.saturating_sub(start);
            let last_separator = u64::from(self.encoding == Encoding::Ascii);
            if need > (have as u64).saturating_add(last_separator) {
                let field = format!("{} rows of element {}", element.count, clip(element.name));
                return Err(src.truncated(field, start, need, have));
            }
            if element.name == name {
                return Ok((element, start, limits.splats(src, element.count, 4 * element.properties.len())?));
            }
            if self.encoding != Encoding::Ascii {
                start = start.saturating_add(need as usize);
            }
        }
        let advice = "only files with that element hold splats or points";
        Err(src.missing(At::Byte(self.data_start as u64), format!("element {name}"), advice))
    }
}

/// At most 40 characters of a word from a file, for messages.
pub(super) fn clip(word: &str) -> &str {
    word.char_indices().nth(40).and_then(|(at, _)| word.get(..at)).unwrap_or(word)
}

fn parse_format<'a>(mut words: impl Iterator<Item = &'a str>, at: At, src: Source<'_>) -> Result<Encoding, IoError> {
    let encoding = match words.next() {
        Some("ascii") => Encoding::Ascii,
        Some("binary_little_endian") => Encoding::Little,
        Some("binary_big_endian") => Encoding::Big,
        other => {
            let what = format!("unknown format `{}`", clip(other.unwrap_or_default()));
            return Err(src.malformed(at, what, "use ascii, binary_little_endian or binary_big_endian"));
        }
    };
    match words.next() {
        Some("1.0") => Ok(encoding),
        other => {
            let what = format!("PLY version `{}`", clip(other.unwrap_or_default()));
            Err(src.malformed(at, what, "only version 1.0 exists"))
        }
    }
}

fn parse_element<'a>(
    mut words: impl Iterator<Item = &'a str>,
    at: At,
    src: Source<'_>,
) -> Result<Element<'a>, IoError> {
    let (name, count) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    let Ok(count) = count.parse::<u64>() else {
        let what = format!("element `{}` has count `{}`", clip(name), clip(count));
        return Err(src.malformed(at, what, "the count must be a whole number from 0 to 2^64 - 1"));
    };
    Ok(Element { name, count, properties: Vec::new(), list: None, stride: 0 })
}

fn parse_property<'a>(
    element: &mut Element<'a>,
    mut words: impl Iterator<Item = &'a str>,
    at: At,
    src: Source<'_>,
) -> Result<(), IoError> {
    let kind = words.next().unwrap_or_default();
    if kind == "list" {
        element.list = Some(words.nth(2).unwrap_or("?"));
        return Ok(());
    }
    let Some(scalar) = Scalar::parse(kind) else {
        let what = format!("unknown property type `{}`", clip(kind));
        return Err(src.malformed(at, what, "use char, uchar, short, ushort, int, uint, float or double"));
    };
    let Some(name) = words.next() else {
        return Err(src.malformed(at, "a property without a name", "repair the header"));
    };
    element.properties.push(Property { name, scalar, offset: element.stride });
    element.stride += scalar.size();
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SRC: Source<'static> = Source { file: "t.ply", format: "PLY" };

    fn parse(text: &str) -> Result<Header<'_>, IoError> {
        Header::parse(text.as_bytes(), SRC)
    }

    #[test]
    fn reads_elements_offsets_and_line_ends() {
        for eol in ["\n", "\r\n"] {
            let text =
                ["ply", "format ascii 1.0", "comment hi", "element vertex 2", "property uchar a", "property double b"]
                    .join(eol)
                    + eol
                    + "element face 1"
                    + eol
                    + "property list uchar int vertex_index"
                    + eol
                    + "end_header"
                    + eol;
            let h = parse(&text).unwrap();
            assert_eq!((h.encoding, h.data_start), (Encoding::Ascii, text.len()));
            let v = &h.elements[0];
            assert_eq!((v.name, v.count, v.stride, v.properties[1].offset), ("vertex", 2, 9, 1));
            assert_eq!(h.elements[1].list, Some("vertex_index"));
        }
    }

    #[test]
    fn comments_say_how_splats_are_drawn() {
        let says = |comments: &[&str]| {
            let lines: String = comments.iter().map(|c| format!("comment{c}\n")).collect();
            parse(&format!("ply\nformat ascii 1.0\n{lines}end_header\n")).unwrap().antialiased
        };
        for yes in [" SplatRenderMode: mip", "  SPLATRENDERMODE:  MIP  ", " antialiased 1"] {
            assert!(says(&[yes]), "{yes}");
        }
        for no in ["", " SplatRenderMode: default", " antialiased 0", " mip", " exported antialiased 1"] {
            assert!(!says(&[no]), "{no}");
        }
        assert!(!says(&[" antialiased 1", " SplatRenderMode: default", " SH degree: 3"]), "the last one counts");
    }

    #[test]
    fn every_error_names_its_line() {
        let error = |text: &str| parse(text).unwrap_err().to_string();
        assert!(error("\u{feff}ply\n").contains("byte order mark"));
        assert!(error("plyx\n").contains("header line 1"));
        assert!(error("ply\nformat ascii 2.0\n").contains("version `2.0` (at header line 2)"));
        assert!(error("ply\nformat utf8 1.0\n").contains("unknown format `utf8`"));
        assert!(error("ply\nproperty float x\n").contains("before any element"));
        assert!(error("ply\nelement vertex 1\nproperty half x\n").contains("type `half` (at header line 3)"));
        assert!(error("ply\nelement vertex 1\nproperty float\n").contains("without a name"));
        assert!(error("ply\nelement a 1\nelement a 1\n").contains("`a` appears twice (at header line 3)"));
        assert!(error("ply\nhello\n").contains("unknown header word `hello`"));
        assert!(error("ply\nend_header\n").contains("`format` is missing"));
        assert!(error("ply\nformat ascii 1.0\n").contains("does not end"));
        for count in ["-1", "18446744073709551616", "1e3", "x", ""] {
            assert!(error(&format!("ply\nelement vertex {count}\n")).contains("whole number"), "{count}");
        }
    }

    #[test]
    fn counts_are_compared_with_the_bytes_present() {
        for count in [3u64, 1 << 31, (1 << 32) - 1, 1 << 63, u64::MAX] {
            for format in ["ascii", "binary_little_endian"] {
                let text =
                    format!("ply\nformat {format} 1.0\nelement vertex {count}\nproperty double x\nend_header\n1 2 ");
                let e = parse(&text).unwrap().locate("vertex", text.len(), &Limits::default(), SRC).unwrap_err();
                assert!(matches!(e, IoError::Truncated { .. }), "{e}");
            }
        }
        let text = "ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int i\nelement vertex 0\nend_header\n";
        let e = parse(text).unwrap().locate("vertex", text.len(), &Limits::default(), SRC).unwrap_err();
        assert!(e.to_string().contains("list property `i`"), "{e}");
        let e = parse("ply\nformat ascii 1.0\nend_header\n").unwrap();
        assert!(matches!(e.locate("vertex", 99, &Limits::default(), SRC), Err(IoError::Missing { .. })));
        // Rows without properties take no bytes: only the limit on rows stops them.
        let text = format!("ply\nformat ascii 1.0\nelement vertex {}\nend_header\n", u64::MAX);
        let e = parse(&text).unwrap().locate("vertex", text.len(), &Limits::default(), SRC).unwrap_err();
        assert!(matches!(e, IoError::Limit { name: "max_rows", .. }), "{e}");
    }
}
