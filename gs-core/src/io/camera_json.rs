//! One pass over camera JSON: entries are processed as they are parsed, so memory grows with the result, not the text.
//!
//! An entry is an object of which only the fields below are kept; all others are skipped without being built. The
//! nesting of skipped values is not recursed into.

use super::IoError;
use super::error::{At, Source};
use super::ply_header::clip;
use serde::de::{DeserializeSeed, Deserializer, Error as _, IgnoredAny, MapAccess, SeqAccess, Visitor};
use std::cell::{Cell, RefCell};
use std::fmt;

/// The numeric fields that are kept.
const NUMBERS: [&str; 19] = [
    "width",
    "height",
    "fx",
    "fy",
    "cx",
    "cy",
    "time",
    "w",
    "h",
    "fl_x",
    "fl_y",
    "camera_angle_x",
    "camera_angle_y",
    "k1",
    "k2",
    "k3",
    "k4",
    "p1",
    "p2",
];

/// The known fields of one object.
#[derive(Clone, Debug, Default)]
pub(super) struct Record {
    numbers: [Option<f64>; NUMBERS.len()],
    pub(super) name: Option<String>,
    pub(super) camera_model: Option<String>,
    /// instant-ngp's mark of a fisheye lens.
    pub(super) is_fisheye: bool,
    pub(super) position: Option<[f64; 3]>,
    pub(super) rotation: Option<[[f64; 3]; 3]>,
    pub(super) world_to_camera: Option<[[f64; 4]; 4]>,
    pub(super) transform_matrix: Option<[[f64; 4]; 4]>,
    /// Entries of its `frames` list, if it has one.
    pub(super) frames: Option<usize>,
}

impl Record {
    /// A numeric field by name.
    pub(super) fn number(&self, name: &str) -> Option<f64> {
        NUMBERS.iter().zip(&self.numbers).find(|(n, _)| **n == name).and_then(|(_, v)| *v)
    }
}

/// Position of the parser, for errors, and the typed error that stopped it.
pub(super) struct Context<'a> {
    pub(super) src: Source<'a>,
    index: Cell<usize>,
    field: RefCell<String>,
    failure: RefCell<Option<IoError>>,
}

/// Takes entry `index` of the list (a single object is entry 0).
type Sink<'s> = &'s mut dyn FnMut(usize, Record) -> Result<(), IoError>;

impl<'a> Context<'a> {
    pub(super) fn new(src: Source<'a>) -> Self {
        Self { src, index: Cell::new(0), field: RefCell::default(), failure: RefCell::default() }
    }

    /// Parses a list of records or one record and calls `sink` on each. With `frames` set, the document is an object and the
    /// records are those of its `frames` list.
    pub(super) fn parse(&self, text: &[u8], frames: bool, sink: Sink<'_>) -> Result<(), IoError> {
        let mut json = serde_json::Deserializer::from_slice(text);
        let outcome = if frames {
            json.deserialize_map(FramesOf { context: self, sink }).and_then(|()| json.end())
        } else {
            json.deserialize_any(Document { context: self, sink }).and_then(|()| json.end())
        };
        outcome.map_err(|e| {
            self.failure.take().unwrap_or_else(|| {
                let narrow = |v: usize| u32::try_from(v).unwrap_or(u32::MAX);
                let text = (narrow(e.line()), narrow(e.column()));
                let at = At::Entry { index: self.index.get(), field: self.field.take().into(), text };
                let full = e.to_string();
                let what = full.rsplit_once(" at line ").map_or(full.as_str(), |(head, _)| head);
                self.src.malformed(at, what, "JSON has no NaN or Infinity; correct that place")
            })
        })
    }

    /// Stores a typed error and returns a placeholder error of serde.
    fn stop<E: serde::de::Error>(&self, error: IoError) -> E {
        *self.failure.borrow_mut() = Some(error);
        E::custom("stopped")
    }
}

/// A list of records, or one.
struct Document<'c, 's> {
    context: &'c Context<'c>,
    sink: Sink<'s>,
}

impl<'de> Visitor<'de> for Document<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of camera objects, or one")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<(), A::Error> {
        let mut index = 0;
        while let Some(record) = list.next_element_seed(OneRecord(self.context))? {
            (self.sink)(index, record).map_err(|e| self.context.stop(e))?;
            index += 1;
            self.context.index.set(index);
            self.context.field.borrow_mut().clear();
        }
        Ok(())
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<(), A::Error> {
        let record = OneRecord(self.context).visit_map(map)?;
        (self.sink)(0, record).map_err(|e| self.context.stop(e))
    }
}

impl<'de> DeserializeSeed<'de> for Document<'_, '_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, json: D) -> Result<(), D::Error> {
        json.deserialize_seq(self)
    }
}

/// The records of an object's `frames` list.
struct FramesOf<'c, 's> {
    context: &'c Context<'c>,
    sink: Sink<'s>,
}

impl<'de> Visitor<'de> for FramesOf<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object with a list `frames`")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some(key) = map.next_key::<String>()? {
            if key == "frames" {
                map.next_value_seed(Document { context: self.context, sink: &mut *self.sink })?;
            } else {
                map.next_value::<IgnoredAny>()?;
            }
        }
        Ok(())
    }
}

/// One camera object as a [`Record`].
struct OneRecord<'c>(&'c Context<'c>);

impl<'de> DeserializeSeed<'de> for OneRecord<'_> {
    type Value = Record;

    fn deserialize<D: Deserializer<'de>>(self, json: D) -> Result<Record, D::Error> {
        json.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for OneRecord<'_> {
    type Value = Record;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a camera object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Record, A::Error> {
        let mut record = Record::default();
        while let Some(key) = map.next_key::<String>()? {
            clip(&key).clone_into(&mut self.0.field.borrow_mut());
            match key.as_str() {
                "name" => record.name = map.next_value()?,
                "img_name" | "file_path" if record.name.is_none() => record.name = map.next_value()?,
                "camera_model" => record.camera_model = map.next_value()?,
                "is_fisheye" => record.is_fisheye = map.next_value::<serde_json::Value>()?.as_bool().unwrap_or(false),
                "position" => record.position = Some(map.next_value()?),
                "rotation" => record.rotation = map.next_value_seed(Rotation)?,
                "world_to_camera" => record.world_to_camera = Some(map.next_value_seed(Rows)?),
                "transform_matrix" => record.transform_matrix = Some(map.next_value_seed(Rows)?),
                "frames" => record.frames = Some(map.next_value_seed(Count)?),
                _ => match NUMBERS.iter().position(|n| *n == key) {
                    Some(at) => {
                        let value = map.next_value()?;
                        if let Some(slot) = record.numbers.get_mut(at) {
                            *slot = value;
                        }
                    }
                    None => {
                        map.next_value::<IgnoredAny>()?;
                    }
                },
            }
        }
        Ok(record)
    }
}

/// A 3×3 matrix as rows; a plain number (Blender's turntable angle has the same name) is skipped.
struct Rotation;

impl<'de> DeserializeSeed<'de> for Rotation {
    type Value = Option<[[f64; 3]; 3]>;

    fn deserialize<D: Deserializer<'de>>(self, json: D) -> Result<Self::Value, D::Error> {
        json.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Rotation {
    type Value = Option<[[f64; 3]; 3]>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a 3x3 matrix as a list of rows")
    }

    fn visit_f64<E>(self, _: f64) -> Result<Self::Value, E> {
        Ok(None)
    }

    fn visit_i64<E>(self, _: i64) -> Result<Self::Value, E> {
        Ok(None)
    }

    fn visit_u64<E>(self, _: u64) -> Result<Self::Value, E> {
        Ok(None)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
        let mut rows = [[0.0; 3]; 3];
        fill_rows(&mut rows, &mut list, 3, &self)?;
        Ok(Some(rows))
    }
}

/// A 4×4 matrix as three or four rows; the last row, if given, must be 0 0 0 1.
struct Rows;

impl<'de> DeserializeSeed<'de> for Rows {
    type Value = [[f64; 4]; 4];

    fn deserialize<D: Deserializer<'de>>(self, json: D) -> Result<Self::Value, D::Error> {
        json.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for Rows {
    type Value = [[f64; 4]; 4];

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a 4x4 matrix as a list of rows")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
        const LAST: [f64; 4] = [0.0, 0.0, 0.0, 1.0];
        let mut rows = [[0.0; 4], [0.0; 4], [0.0; 4], LAST];
        fill_rows(&mut rows, &mut list, 3, &self)?;
        if rows.last().is_some_and(|last| last.iter().zip(LAST).any(|(a, b)| (a - b).abs() > 1e-6)) {
            return Err(A::Error::custom("the last row of the matrix is not 0 0 0 1"));
        }
        Ok(rows)
    }
}

/// Reads rows of `N` numbers; at least `least` and at most `rows.len()` of them.
fn fill_rows<'de, const N: usize, A>(
    rows: &mut [[f64; N]],
    list: &mut A,
    least: usize,
    expected: &dyn serde::de::Expected,
) -> Result<(), A::Error>
where
    A: SeqAccess<'de>,
    [f64; N]: serde::Deserialize<'de>,
{
    for (i, row) in rows.iter_mut().enumerate() {
        match list.next_element()? {
            Some(values) => *row = values,
            None if i >= least => return Ok(()),
            None => return Err(A::Error::invalid_length(i, expected)),
        }
    }
    match list.next_element::<IgnoredAny>()? {
        Some(_) => Err(A::Error::invalid_length(rows.len() + 1, expected)),
        None => Ok(()),
    }
}

/// The length of a list whose entries are skipped.
struct Count;

impl<'de> DeserializeSeed<'de> for Count {
    type Value = usize;

    fn deserialize<D: Deserializer<'de>>(self, json: D) -> Result<usize, D::Error> {
        json.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for Count {
    type Value = usize;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of frames")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<usize, A::Error> {
        let mut count = 0;
        while list.next_element::<IgnoredAny>()?.is_some() {
            count += 1;
        }
        Ok(count)
    }
}
