//! Split, time and camera of every image.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use super::super::error::{DataError, Place};
use super::super::json::{Fields, read_object, whole};

/// Largest `dataset.json`, `metadata.json` and split: some 20 000 images.
const MAX_LIST_BYTES: u64 = 2 << 20;

/// A list of ids, and where it stands.
pub(super) struct Ids {
    pub(super) file: PathBuf,
    key: &'static str,
    pub(super) ids: Vec<String>,
}

/// Which ids train, and which are held out.
pub(super) struct Lists {
    all: Vec<String>,
    pub(super) train: Ids,
    pub(super) test: Ids,
}

impl Lists {
    /// Reads the lists of a capture's folder.
    ///
    /// # Errors
    /// `data.field` for lists of the wrong type, and for an image of both splits; `io.read`, `data.syntax`, `limits.file`.
    pub(super) fn read(dir: &Path, notes: &mut Vec<String>) -> Result<Self, DataError> {
        let file = &dir.join("dataset.json");
        let map = read_object(file, MAX_LIST_BYTES)?;
        let all = names(file, &map, "ids")?;
        let listed = |key, ids| Ids { file: file.clone(), key, ids };
        let own = |key| names(file, &map, key).map(|ids| listed(key, ids));
        let (train, val) = (own("train_ids")?, own("val_ids")?);
        if let Some(count) = Fields::new(file, "", &map).number("count")?.filter(|&c| c != all.len() as f64) {
            notes.push(format!("dataset.json states a count of {count} and lists {} ids", all.len()));
        }
        let splits = ["train", "val"].map(|name| dir.join(format!("splits/{name}.json")));
        let (train, test) = if splits.iter().all(|f| f.is_file()) {
            notes.push("the split is that of splits/train.json and splits/val.json".into());
            let [train, val] = splits.map(frame_names);
            (train?, val?)
        } else if val.ids.is_empty() {
            notes.push("val_ids is empty: of ids every 4th trains, those half-way between are held out".into());
            // One is held out only between two that train, as 4DGaussians does.
            let every_fourth =
                |start: usize, end: usize| all.iter().take(end).skip(start).step_by(4).cloned().collect();
            (listed("ids", every_fourth(0, all.len())), listed("ids", every_fourth(2, all.len().saturating_sub(2))))
        } else {
            (train, val)
        };
        let trained: HashSet<&String> = train.ids.iter().collect();
        if let Some(id) = test.ids.iter().find(|id| trained.contains(id)) {
            return Err(DataError::Field {
                place: Place::new(&test.file, format!("{}, id \"{id}\"", test.key)),
                value: format!("in {} of {}, too", train.key, train.file.display()),
                why: "a view that trains cannot be held out",
                fix: "remove it from one of the lists",
            });
        }
        Ok(Self { all, train, test })
    }

    /// The largest time of all ids, those of no split included.
    pub(super) fn last_time(&self, tags: &Tags) -> Result<f64, DataError> {
        let mut last: f64 = 0.0;
        for id in self.all.iter().chain(&self.train.ids).chain(&self.test.ids) {
            last = last.max(tags.of(id)?.time);
        }
        Ok(last)
    }
}

/// The names of a split of DyCheck; its lists of times and cameras repeat `metadata.json` and must be as long.
fn frame_names(file: PathBuf) -> Result<Ids, DataError> {
    let map = read_object(&file, MAX_LIST_BYTES)?;
    let key = "frame_names";
    let ids = names(&file, &map, key)?;
    for other in ["time_ids", "camera_ids"] {
        if let Some(list) = map.get(other).and_then(Value::as_array).filter(|list| list.len() != ids.len()) {
            return Err(DataError::Field {
                place: Place::new(&file, other),
                value: format!("{} entries long, {key} is {}", list.len(), ids.len()),
                why: "the lists of a split belong together entry by entry",
                fix: "copy the split again, or remove the folder splits",
            });
        }
    }
    Ok(Ids { file, key, ids })
}

/// A list of texts; a missing list is empty.
fn names(file: &Path, map: &Map<String, Value>, key: &str) -> Result<Vec<String>, DataError> {
    let fault = |at: String, value: &Value| DataError::Field {
        place: Place::new(file, at),
        value: value.to_string().chars().take(40).collect(),
        why: "ids are a list of texts",
        fix: "export the file again",
    };
    match map.get(key) {
        None | Some(Value::Null) => Ok(Vec::new()),
        Some(Value::Array(list)) => {
            let text = |(i, v): (usize, &Value)| match v {
                Value::String(s) => Ok(s.clone()),
                _ => Err(fault(format!("{key}[{i}]"), v)),
            };
            list.iter().enumerate().map(text).collect()
        }
        Some(v) => Err(fault(key.into(), v)),
    }
}

/// `metadata.json`: the time and camera of every id.
pub(super) struct Tags {
    pub(super) file: PathBuf,
    map: Map<String, Value>,
    /// The field that holds the time.
    pub(super) key: &'static str,
}

/// Time and camera of an image.
pub(super) struct Tag {
    pub(super) time: f64,
    pub(super) camera: u32,
}

impl Tags {
    /// Reads the file.
    ///
    /// # Errors
    /// `io.read`, `data.syntax`, `limits.file`.
    pub(super) fn read(file: &Path, notes: &mut Vec<String>) -> Result<Self, DataError> {
        let map = read_object(file, MAX_LIST_BYTES)?;
        let has = |key: &str| map.values().any(|v| v.get(key).is_some());
        let key = if has("time_id") { "time_id" } else { "warp_id" };
        if has("appearance_id") {
            notes.push("appearance ids are not used: all images are taken as equally exposed".into());
        }
        Ok(Self { file: file.to_path_buf(), map, key })
    }

    /// The tag of an image.
    ///
    /// # Errors
    /// `data.field` if there is none, or its numbers are no ids.
    pub(super) fn of(&self, id: &str) -> Result<Tag, DataError> {
        let Some(Value::Object(map)) = self.map.get(id) else {
            return Err(DataError::Field {
                place: Place::new(&self.file, id),
                value: "missing".into(),
                why: "a list of the capture has this id, and its time is unknown",
                fix: "copy metadata.json, dataset.json and splits of the same capture",
            });
        };
        let fields = Fields::new(&self.file, id, map);
        let id = |key: &str, value: f64| {
            let why = "ids are whole numbers from 0 to 4294967295";
            whole(value, 0..=u32::MAX).ok_or_else(|| fields.fault(key, &value.to_string(), why, "correct the number"))
        };
        let time = id(self.key, fields.required_number(self.key)?)?;
        let camera = id("camera_id", fields.number("camera_id")?.unwrap_or(0.0))?;
        Ok(Tag { time: time.into(), camera })
    }
}
