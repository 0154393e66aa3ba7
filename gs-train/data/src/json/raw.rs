//! Large lists and fields of an object as slices of its text, and those of its other fields that are small.

use serde::de::{DeserializeSeed, Deserializer, Error as _, MapAccess, SeqAccess, Visitor};
use serde_json::value::RawValue;
use serde_json::{Map, Value};
use std::fmt;

/// Scalars beside the frames are kept up to this size and number.
const MAX_FIELD_BYTES: usize = 4 << 10;
const MAX_FIELDS: usize = 256;

/// The entries of a list as slices of its text, at most `max` of them.
///
/// # Errors
/// If it is no list, or longer.
pub(crate) fn slices(list: &RawValue, max: usize) -> serde_json::Result<Vec<&RawValue>> {
    let mut json = serde_json::Deserializer::from_str(list.get());
    DeserializeSeed::deserialize(List(max), &mut json)
}

/// Parses a field and keeps it, if it is small and not too many are kept.
pub(super) fn keep_small<E: serde::de::Error>(
    fields: &mut Map<String, Value>,
    key: String,
    raw: &RawValue,
) -> Result<(), E> {
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
pub(super) struct List(pub(super) usize);

impl<'de> DeserializeSeed<'de> for List {
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
