//! Frames by camera: `{camera_angle_x, data: {camera: {transform_matrix, frames: [{file_path, time}]}}}`.

use std::fmt;
use std::path::Path;

use serde::de::{DeserializeSeed, Deserializer, Error as _, MapAccess, Visitor};
use serde_json::Value;
use serde_json::value::RawValue;

use super::LabelledFrame;
use crate::blender::Frame;
use crate::error::{DataError, Place};
use crate::files::Root;
use crate::frames::{Listed, locate};
use crate::intrinsics::PartialIntrinsics;
use crate::json::{Fields, slices, with_large};
use crate::pose::{Pose, from_opengl};

/// Shortest possible camera: a 4×4 matrix alone has 41 characters.
const MIN_CAMERA_BYTES: usize = 41;
/// Shortest possible frame: `{"file_path":"","time":0}`.
const MIN_FRAME_BYTES: usize = 20;
/// Largest frame; a usual one has 60 bytes.
const MAX_ENTRY_BYTES: usize = 64 << 10;

/// The frames of a file.
///
/// # Errors
/// `data.syntax`, `data.field`, `data.pose`, `data.camera_model`, `data.escape`, `limits.file`, with the JSON path.
pub(super) fn read(root: &Root, file: &Path, text: &str) -> Result<Vec<Listed<LabelledFrame>>, DataError> {
    let (data, top) = with_large(text, "data")
        .map_err(|e| DataError::syntax(file, format!("line {}, column {}", e.line(), e.column()), e.to_string()))?;
    let shared = PartialIntrinsics::shared(&Fields::new(file, "", &top))?;
    let fault = |value: &str, why| DataError::unexpected(file, "data", value, why);
    let data = data.ok_or_else(|| fault("missing", "it holds the frames of each camera"))?;
    let mut json = serde_json::Deserializer::from_str(data.get());
    let cameras = Cameras(text.len() / MIN_CAMERA_BYTES + 1).deserialize(&mut json);
    let cameras = cameras.map_err(|e| fault(&e.to_string(), "it holds an object for each camera"))?;
    let mut listed = Vec::new();
    for (name, raw) in cameras {
        let at = format!("data.{}", name.chars().take(80).collect::<String>());
        frames(root, file, &at, raw, &shared, &mut listed)?;
    }
    Ok(listed)
}

/// The frames of one camera, at the JSON path `at`.
fn frames(
    root: &Root,
    file: &Path,
    at: &str,
    raw: &RawValue,
    shared: &PartialIntrinsics,
    listed: &mut Vec<Listed<LabelledFrame>>,
) -> Result<(), DataError> {
    const WHY: &str = "a camera has a transform_matrix and frames";
    let (list, camera) =
        with_large(raw.get(), "frames").map_err(|_| DataError::unexpected(file, at, raw.get(), WHY))?;
    let fields = Fields::new(file, at, &camera);
    let shared = PartialIntrinsics::of_frame(&fields, shared)?;
    let pose = from_opengl(&fields.matrix("transform_matrix")?, &fields.place("transform_matrix"))?;
    let path = format!("{at}.frames");
    let list = list.ok_or_else(|| DataError::unexpected(file, &path, "missing", WHY))?;
    let entries = slices(list, list.get().len() / MIN_FRAME_BYTES + 1)
        .map_err(|e| DataError::unexpected(file, &path, &e.to_string(), "it is a list of frames"))?;
    for (i, entry) in entries.into_iter().enumerate() {
        listed.push(frame(root, file, &format!("{path}[{i}]"), entry, &pose, &shared)?);
    }
    Ok(())
}

fn frame(
    root: &Root,
    file: &Path,
    at: &str,
    raw: &RawValue,
    pose: &Pose,
    shared: &PartialIntrinsics,
) -> Result<Listed<LabelledFrame>, DataError> {
    let Value::Object(map) = small(file, at, raw)? else {
        return Err(DataError::unexpected(file, at, raw.get(), "a frame has a file_path and a time"));
    };
    let fields = Fields::new(file, at, &map);
    let (shown, path) = locate(root, fields.required_text("file_path")?, &fields.place("file_path"))?;
    let frame = Frame {
        pose: *pose,
        stated: PartialIntrinsics::of_frame(&fields, shared)?,
        time: fields.number("time")?,
        time_place: fields.place("time"),
        place: fields.place(""),
    };
    Ok(Listed { shown, path, rest: LabelledFrame { frame, labels: None } })
}

/// Parses an entry of limited size.
fn small(file: &Path, at: &str, raw: &RawValue) -> Result<Value, DataError> {
    if raw.get().len() > MAX_ENTRY_BYTES {
        let (bytes, limit) = (raw.get().len() as u64, MAX_ENTRY_BYTES as u64);
        return Err(DataError::TooLarge { place: Place::new(file, at), bytes, limit });
    }
    serde_json::from_str(raw.get()).map_err(|e| DataError::syntax(file, at, e.to_string()))
}

/// Visitor of an object of at most this many entries, kept as slices; each name occurs once.
struct Cameras(usize);

impl<'de> DeserializeSeed<'de> for Cameras {
    type Value = Vec<(String, &'de RawValue)>;

    fn deserialize<D: Deserializer<'de>>(self, d: D) -> Result<Self::Value, D::Error> {
        d.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Cameras {
    type Value = Vec<(String, &'de RawValue)>;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let (mut list, mut names) = (Vec::new(), std::collections::BTreeSet::new());
        while let Some((name, raw)) = map.next_entry::<String, &'de RawValue>()? {
            if list.len() >= self.0 {
                return Err(A::Error::custom("it has more entries than cameras could fit the file"));
            }
            if !names.insert(name.clone()) {
                return Err(A::Error::custom(format!("camera \"{name}\" appears twice")));
            }
            list.push((name, raw));
        }
        Ok(list)
    }
}
