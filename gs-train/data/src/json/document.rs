//! The object at the top of `transforms*.json`: scalars, frames and lists of file names.

use super::fields::{Fields, shorten};
use super::raw::{List, keep_small};
use super::syntax;
use crate::error::{DataError, Place};
use serde::de::{Deserializer, Error as _, MapAccess, Visitor};
use serde_json::value::RawValue;
use serde_json::{Map, Value};
use std::borrow::Cow;
use std::fmt;
use std::path::Path;

/// Largest single frame; a usual one has 700 bytes.
const MAX_FRAME_BYTES: usize = 64 << 10;
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
    /// Parses `text`, the contents of `file` after [`quote_non_finite`](super::quote_non_finite).
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

#[cfg(test)]
mod tests {
    use crate::json::tests::parse;

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
