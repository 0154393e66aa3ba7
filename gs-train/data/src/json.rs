//! `transforms*.json`: a few scalars and a long list of frames, read with a bound on memory and the JSON path of
//! every error.
//!
//! Frames are kept as slices of the text and parsed one at a time, so memory stays near the size of the file. Python writes `NaN` and `Infinity` bare, which JSON forbids; they are accepted as tokens so that the field that
//! holds one can be named.

use std::borrow::Cow;
use std::fmt;
use std::ops::RangeInclusive;
use std::path::Path;

use gs_core::cast;
use serde::de::{Deserializer, Error as _, MapAccess, SeqAccess, Visitor};
use serde_json::value::RawValue;
use serde_json::{Map, Value};

use super::error::{DataError, Place};
use super::files::read_text;

/// Largest JSON file read.
pub(crate) const MAX_JSON_BYTES: u64 = 64 << 20;
/// Largest single frame; a usual one has 700 bytes.
const MAX_FRAME_BYTES: usize = 64 << 10;
/// Scalars beside the frames are kept up to this size and number.
const MAX_FIELD_BYTES: usize = 4 << 10;
const MAX_FIELDS: usize = 256;
/// The remedy for numbers of the wrong shape.
const FIX: &str = "export the file again";
/// Shortest possible frame: a 4×4 matrix alone has 41 characters.
const MIN_FRAME_BYTES: usize = 41;

/// A parsed `transforms*.json`: scalars, frames and lists of file names.
pub(crate) struct Document<'a> {
    file: &'a Path,
    top: Map<String, Value>,
    frames: Vec<&'a RawValue>,
    lists: Vec<(String, Vec<&'a RawValue>)>,
}

impl<'a> Document<'a> {
    /// Parses `text`, the contents of `file` after [`quote_non_finite`].
    ///
    /// # Errors
    /// `data.syntax` with line and column.
    pub(crate) fn parse(file: &'a Path, text: &'a str) -> Result<Self, DataError> {
        let mut json = serde_json::Deserializer::from_str(text);
        let visitor = TopVisitor { max_frames: text.len() / MIN_FRAME_BYTES + 1 };
        let (top, frames, lists) =
            json.deserialize_map(visitor).and_then(|v| json.end().map(|()| v)).map_err(|e| syntax(file, "", &e))?;
        Ok(Self { file, top, frames, lists })
    }

    /// The scalars beside the frames.
    pub(crate) fn top(&self) -> Fields<'_> {
        Fields { file: self.file, prefix: String::new(), map: Cow::Borrowed(&self.top) }
    }

    /// Number of frames.
    pub(crate) fn len(&self) -> usize {
        self.frames.len()
    }

    /// Frame `i`.
    ///
    /// # Errors
    /// `data.syntax` if it is no object, or larger than any frame should be.
    pub(crate) fn frame(&self, i: usize) -> Result<Fields<'_>, DataError> {
        let prefix = format!("frames[{i}]");
        let text = self.frames[i].get();
        if text.len() > MAX_FRAME_BYTES {
            let place = Place::new(self.file, prefix);
            return Err(DataError::TooLarge { place, bytes: text.len() as u64, limit: MAX_FRAME_BYTES as u64 });
        }
        let map = serde_json::from_str(text).map_err(|e| syntax(self.file, &prefix, &e))?;
        Ok(Fields { file: self.file, prefix, map: Cow::Owned(map) })
    }

    /// A top-level list of file names, if present.
    ///
    /// # Errors
    /// `data.field` if an entry is no text.
    pub(crate) fn names(&self, key: &str) -> Result<Option<Vec<String>>, DataError> {
        let Some((_, list)) = self.lists.iter().find(|(k, _)| k == key) else { return Ok(None) };
        let parse = |(i, raw): (usize, &&RawValue)| {
            serde_json::from_str(raw.get()).map_err(|_| DataError::Field {
                place: Place::new(self.file, format!("{key}[{i}]")),
                value: shorten(raw.get()),
                why: "the split is a list of file names",
                fix: "write each name in quotes",
            })
        };
        list.iter().enumerate().map(parse).collect::<Result<_, _>>().map(Some)
    }
}

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

/// The entries of a list as slices of its text, at most `max` of them.
///
/// # Errors
/// If it is no list, or longer.
pub(crate) fn slices(list: &RawValue, max: usize) -> serde_json::Result<Vec<&RawValue>> {
    let mut json = serde_json::Deserializer::from_str(list.get());
    serde::de::DeserializeSeed::deserialize(List(max), &mut json)
}

/// A value for an error text, at most 40 characters.
fn shorten(text: &str) -> String {
    let mut short: String = text.chars().take(40).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    short
}

type Top<'a> = (Map<String, Value>, Vec<&'a RawValue>, Vec<(String, Vec<&'a RawValue>)>);

struct TopVisitor {
    max_frames: usize,
}

impl<'de> Visitor<'de> for TopVisitor {
    type Value = Top<'de>;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("an object with frames")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Top<'de>, A::Error> {
        let (mut top, mut frames, mut lists) = (Map::new(), None, Vec::new());
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "frames" => {
                    if frames.replace(map.next_value_seed(List(self.max_frames))?).is_some() {
                        return Err(A::Error::custom("\"frames\" appears twice"));
                    }
                }
                "train_filenames" | "val_filenames" | "test_filenames" if lists.len() < 3 => {
                    lists.push((key, map.next_value_seed(List(self.max_frames))?));
                }
                _ => keep_small::<A::Error>(&mut top, key, map.next_value()?)?,
            }
        }
        let frames = frames.ok_or_else(|| A::Error::custom("there is no list \"frames\""))?;
        Ok((top, frames, lists))
    }
}

/// Parses a field and keeps it, if it is small and not too many are kept.
fn keep_small<E: serde::de::Error>(fields: &mut Map<String, Value>, key: String, raw: &RawValue) -> Result<(), E> {
    if raw.get().len() <= MAX_FIELD_BYTES && key.len() <= MAX_FIELD_BYTES && fields.len() < MAX_FIELDS {
        fields.insert(key, serde_json::from_str(raw.get()).map_err(E::custom)?);
    }
    Ok(())
}

/// The field `large` of an object as a slice of its text, if it is there, and those of its other fields that are small.
///
/// # Errors
/// If the text is no object, or has the field twice.
pub(crate) fn with_large<'a>(text: &'a str, large: &str) -> serde_json::Result<WithLarge<'a>> {
    let mut json = serde_json::Deserializer::from_str(text);
    json.deserialize_map(LargeVisitor(large)).and_then(|found| json.end().map(|()| found))
}

/// A large field, and small ones.
type WithLarge<'a> = (Option<&'a RawValue>, Map<String, Value>);

/// Visitor of an object with a large field of this name.
struct LargeVisitor<'k>(&'k str);

impl<'de> Visitor<'de> for LargeVisitor<'_> {
    type Value = WithLarge<'de>;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<WithLarge<'de>, A::Error> {
        let (mut large, mut fields) = (None, Map::new());
        while let Some(key) = map.next_key::<String>()? {
            if key != self.0 {
                keep_small::<A::Error>(&mut fields, key, map.next_value()?)?;
            } else if large.replace(map.next_value()?).is_some() {
                return Err(A::Error::custom(format!("\"{key}\" appears twice")));
            }
        }
        Ok((large, fields))
    }
}

/// Visitor of a list of at most this many entries, kept as slices.
struct List(usize);

impl<'de> serde::de::DeserializeSeed<'de> for List {
    type Value = Vec<&'de RawValue>;

    fn deserialize<D: Deserializer<'de>>(self, d: D) -> Result<Self::Value, D::Error> {
        d.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for List {
    type Value = Vec<&'de RawValue>;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a list")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self::Value, A::Error> {
        let mut list = Vec::new();
        while let Some(raw) = seq.next_element()? {
            if list.len() >= self.0 {
                return Err(A::Error::custom("the list has more entries than frames could fit the file"));
            }
            list.push(raw);
        }
        Ok(list)
    }
}

/// The whole number that `value` is, if it is one of the range.
pub(crate) fn whole(value: f64, range: RangeInclusive<u32>) -> Option<u32> {
    let limits = f64::from(*range.start())..=f64::from(*range.end());
    (value.fract() == 0.0 && limits.contains(&value)).then(|| cast::to_u32(cast::to_usize(value)))
}

/// The fields of one object, with their place.
pub(crate) struct Fields<'a> {
    file: &'a Path,
    prefix: String,
    map: Cow<'a, Map<String, Value>>,
}

impl<'a> Fields<'a> {
    /// The fields of `map`, at the JSON path `prefix` (empty: the whole file).
    pub(crate) fn new(file: &'a Path, prefix: impl Into<String>, map: &'a Map<String, Value>) -> Self {
        Self { file, prefix: prefix.into(), map: Cow::Borrowed(map) }
    }

    /// File and JSON path of a field.
    pub(crate) fn place(&self, key: &str) -> Place {
        let dot = if self.prefix.is_empty() || key.is_empty() { "" } else { "." };
        Place::new(self.file, format!("{}{dot}{key}", self.prefix))
    }

    /// A finite number, if the field is there (`null` counts as absent).
    ///
    /// # Errors
    /// `data.field` for anything else.
    pub(crate) fn number(&self, key: &str) -> Result<Option<f64>, DataError> {
        match self.map.get(key) {
            None | Some(Value::Null) => Ok(None),
            Some(v) => finite(v).map(Some).ok_or_else(|| not_finite(self.place(key), v)),
        }
    }

    /// A number that must be there.
    ///
    /// # Errors
    /// `data.field` if it is not.
    pub(crate) fn required_number(&self, key: &str) -> Result<f64, DataError> {
        self.number(key)?.ok_or_else(|| self.fault(key, "missing", "the layout requires this number", "add the field"))
    }

    /// A list of exactly `N` finite numbers, if the field is there.
    ///
    /// # Errors
    /// `data.field` naming the entry.
    pub(crate) fn numbers<const N: usize>(&self, key: &str) -> Result<Option<[f64; N]>, DataError> {
        let cells = match self.map.get(key) {
            None | Some(Value::Null) => return Ok(None),
            Some(Value::Array(cells)) if cells.len() == N => cells,
            Some(v) => {
                return Err(self.fault(key, &v.to_string(), "it must be a list of numbers of fixed length", FIX));
            }
        };
        let mut out = [0.0; N];
        for (i, (value, cell)) in out.iter_mut().zip(cells).enumerate() {
            *value = finite(cell).ok_or_else(|| not_finite(self.place(&format!("{key}[{i}]")), cell))?;
        }
        Ok(Some(out))
    }

    /// Three rows of three finite numbers, which must be there.
    ///
    /// # Errors
    /// `data.field` naming the entry.
    pub(crate) fn rows3(&self, key: &str) -> Result<[[f64; 3]; 3], DataError> {
        self.rows(key)?.ok_or_else(|| self.fault(key, "missing", "it must be three rows of three numbers", FIX))
    }

    /// `N` rows of three finite numbers, if the field is there.
    ///
    /// # Errors
    /// `data.field` naming the entry.
    pub(crate) fn rows<const N: usize>(&self, key: &str) -> Result<Option<[[f64; 3]; N]>, DataError> {
        let rows = match self.map.get(key) {
            None | Some(Value::Null) => return Ok(None),
            Some(Value::Array(rows)) if rows.len() == N => rows,
            Some(v) => return Err(self.fault(key, &v.to_string(), "it must be rows of three numbers", FIX)),
        };
        let mut m = [[0.0; 3]; N];
        for (i, row) in rows.iter().enumerate() {
            let at = format!("{key}[{i}]");
            let cells = row.as_array().filter(|c| c.len() == 3);
            let cells =
                cells.ok_or_else(|| self.fault(&at, &row.to_string(), "it must be a row of three numbers", FIX))?;
            for (j, cell) in cells.iter().enumerate() {
                m[i][j] = finite(cell).ok_or_else(|| not_finite(self.place(&format!("{at}[{j}]")), cell))?;
            }
        }
        Ok(Some(m))
    }

    /// A text, if the field is there.
    ///
    /// # Errors
    /// `data.field` for anything else.
    pub(crate) fn text(&self, key: &str) -> Result<Option<&str>, DataError> {
        match self.map.get(key) {
            None | Some(Value::Null) => Ok(None),
            Some(Value::String(s)) => Ok(Some(s)),
            Some(v) => Err(self.fault(key, &v.to_string(), "it must be a text", "write it in quotes")),
        }
    }

    /// Whether a field is true; false where it is not there.
    ///
    /// # Errors
    /// `data.field` for anything else.
    pub(crate) fn flag(&self, key: &str) -> Result<bool, DataError> {
        match self.map.get(key) {
            None | Some(Value::Null) => Ok(false),
            Some(Value::Bool(v)) => Ok(*v),
            Some(v) => Err(self.fault(key, &v.to_string(), "it must be true or false", "correct the field")),
        }
    }

    /// A text that must be there.
    ///
    /// # Errors
    /// `data.field` if it is not.
    pub(crate) fn required_text(&self, key: &str) -> Result<&str, DataError> {
        self.text(key)?.ok_or_else(|| self.fault(key, "missing", "every frame names its image", "add the field"))
    }

    /// The first three rows of a 4×4 (or 3×4) matrix of finite numbers; a fourth row must be `0 0 0 1`.
    ///
    /// # Errors
    /// `data.field` naming the entry.
    pub(crate) fn matrix(&self, key: &str) -> Result<[[f64; 4]; 3], DataError> {
        const WHY: &str = "a rigid transform has 4 rows of 4 numbers, the last 0 0 0 1";
        const FIX: &str = "export the matrix again";
        let fault = |place: String, value: String| DataError::Field {
            place: Place::new(self.file, place),
            value,
            why: WHY,
            fix: FIX,
        };
        let at = self.place(key).at;
        let rows = match self.map.get(key) {
            None => return Err(fault(at, "missing".into())),
            Some(Value::Array(rows)) if rows.len() == 3 || rows.len() == 4 => rows,
            Some(v) => return Err(fault(at, shorten(&v.to_string()))),
        };
        let mut m = [[0.0, 0.0, 0.0, 1.0]; 4];
        for (i, row) in rows.iter().enumerate() {
            let cells = row.as_array().filter(|c| c.len() == 4);
            let cells = cells.ok_or_else(|| fault(format!("{at}[{i}]"), shorten(&row.to_string())))?;
            for (j, cell) in cells.iter().enumerate() {
                let place = || Place::new(self.file, format!("{at}[{i}][{j}]"));
                m[i][j] = finite(cell).ok_or_else(|| not_finite(place(), cell))?;
            }
        }
        if rows.len() == 4 && m[3].iter().zip([0.0, 0.0, 0.0, 1.0]).any(|(a, b)| (a - b).abs() > 1e-6) {
            return Err(fault(format!("{at}[3]"), shorten(&rows[3].to_string())));
        }
        Ok([m[0], m[1], m[2]])
    }

    /// The error for a value of this field.
    pub(crate) fn fault(&self, key: &str, value: &str, why: &'static str, fix: &'static str) -> DataError {
        DataError::Field { place: self.place(key), value: shorten(value), why, fix }
    }
}

fn finite(v: &Value) -> Option<f64> {
    v.as_f64().filter(|x| x.is_finite())
}

fn not_finite(place: Place, v: &Value) -> DataError {
    // `quote_non_finite` made these strings.
    let bare = v.as_str().filter(|s| ["NaN", "Infinity", "-Infinity"].contains(s));
    let value = shorten(&bare.map_or_else(|| v.to_string(), str::to_owned));
    let text = v.is_string() && bare.is_none();
    let fix = if text { "write it as a number, without quotes" } else { "correct the number" };
    DataError::Field { place, value, why: "it must be a finite number", fix }
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

    fn parse(text: &str) -> Result<Document<'_>, DataError> {
        Document::parse(Path::new("t.json"), text)
    }

    #[test]
    fn fields_are_read_with_their_place() {
        let text = r#"{"fl_x": 3.5, "big": [1,2], "frames": [{"file_path": "a", "time": 0.5}, {"time": "x"}]}"#;
        let d = parse(text).unwrap();
        assert_eq!((d.len(), d.top().number("fl_x").unwrap(), d.top().number("cx").unwrap()), (2, Some(3.5), None));
        let f = d.frame(0).unwrap();
        assert_eq!((f.required_text("file_path").unwrap(), f.number("time").unwrap()), ("a", Some(0.5)));
        let e = d.frame(1).unwrap().number("time").unwrap_err();
        assert!(e.to_string() == "frames[1].time is \"x\"" && e.fix().contains("without quotes"), "{e}");
        let e = d.frame(1).unwrap().required_text("file_path").unwrap_err().to_string();
        assert_eq!(e, "frames[1].file_path is missing");
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

    #[test]
    fn matrices_are_complete() {
        let with = |m: &str| {
            let text = format!("{{\"frames\": [{{\"m\": {m}}}]}}");
            let d = parse(&text).unwrap();
            d.frame(0).unwrap().matrix("m").map_err(|e| e.to_string())
        };
        let good = "[[1,0,0,5],[0,1,0,6],[0,0,1,7],[0,0,0,1]]";
        assert_eq!(with(good).unwrap()[1][3], 6.0);
        assert_eq!(with("[[1,0,0,5],[0,1,0,6],[0,0,1,7]]").unwrap()[2][3], 7.0);
        assert_eq!(with("[[1,0,0,5],[0,1,0],[0,0,1,7]]").unwrap_err(), "frames[0].m[1] is [0,1,0]");
        assert_eq!(with("[[1,0,0,5],[0,1,0,\"NaN\"],[0,0,1,7]]").unwrap_err(), "frames[0].m[1][3] is NaN");
        assert_eq!(with("7").unwrap_err(), "frames[0].m is 7");
        assert!(with("[[1,0,0,5],[0,1,0,6],[0,0,1,7],[0,0,0,2]]").unwrap_err().starts_with("frames[0].m[3]"));
    }

    #[test]
    fn damage_is_located() {
        for (text, want) in [
            ("{\"frames\": [{}", "line 1"),
            ("{}", "no list"),
            ("[]", "an object with frames"),
            ("{\"frames\": [] } x", "trailing"),
            ("{\"frames\": [], \"frames\": []}", "twice"),
        ] {
            let e = parse(text).err().unwrap();
            assert!(e.code() == "data.syntax" && e.report().contains(want), "{text}: {}", e.report());
        }
        let deep = format!("{{\"frames\": [{}]}}", "[".repeat(5000) + &"]".repeat(5000));
        assert_eq!(parse(&deep).unwrap().frame(0).err().unwrap().code(), "data.syntax");
        let many = format!("{{\"frames\": [{}0]}}", "0,".repeat(5000));
        assert!(parse(&many).err().unwrap().to_string().contains("more entries"));
    }
}
