//! What a run and a compact scene keep of their data, so that they can be viewed, orbited and exported where the data are not.

use crate::RunError;
use gs_core::Time;
use gs_core::io::cameras::{NamedCamera, parse_cameras, write_cameras};
use gs_core::io::{At, IoError, Limits};
use gs_data::{Dataset, ImageSource, ImageU8, View};
use gs4d_eval::forecast::Clock;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::sync::Arc;

/// Number of cameras kept of a split, at most.
const MAX_CAMERAS: usize = 16;
/// Number of timestamps kept, at most.
const MAX_TIMES: usize = 400;
/// The field with the number of the physical camera; where it is missing, cameras are numbered as they come.
const CAMERA_ID: &str = "camera_id";
/// What follows from the others.
const DERIVED: [&str; 3] = ["id", "position", "rotation"];

/// The number of views of each split.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SplitSizes {
    /// Training views.
    pub train: usize,
    /// Held-out views within the training timestamps.
    pub test: usize,
    /// Held-out views beyond them.
    pub extrapolate: usize,
}

/// What is kept of the data of a run.
#[derive(Clone, Debug, Default)]
pub struct Kept {
    /// Up to 16 training views, evenly spaced, without images.
    pub train: Vec<View>,
    /// Up to 16 held-out views, evenly spaced, without images.
    pub held_out: Vec<View>,
    /// Training timestamps, normalised, ascending; at most 400, evenly spaced, the first and the last among them.
    pub times: Vec<f32>,
    /// The data's own time at normalised times 0 and 1; `None` where it is the normalised time.
    pub clock: Option<[f64; 2]>,
    /// Number of views of each split of the data.
    pub splits: SplitSizes,
}

/// The parts of [`Kept`] that are no views, as they are stored.
#[derive(Serialize, Deserialize)]
struct Stored {
    #[serde(default)]
    times: Vec<f32>,
    #[serde(default)]
    clock: Option<[f64; 2]>,
    #[serde(default)]
    splits: SplitSizes,
}

impl Kept {
    /// What is kept of a data set.
    pub fn of(data: &Dataset) -> Self {
        let mut times: Vec<f32> = data.train.iter().map(|v| v.time.normalised).collect();
        times.sort_by(f32::total_cmp);
        times.dedup();
        Self {
            train: without_images(&data.train),
            held_out: without_images(&data.test),
            times: spaced(&times, MAX_TIMES),
            clock: Clock::of(data).map(|c| [c.start, c.start + c.rate]),
            splits: SplitSizes { train: data.train.len(), test: data.test.len(), extrapolate: data.extrapolate.len() },
        }
    }

    /// The seconds at normalised times 0 and 1: those of the data's own time where it leaves 0..1, and so is in seconds.
    pub fn seconds(&self) -> Option<[f64; 2]> {
        self.clock.filter(|[start, end]| *start < 0.0 || *end > 1.0)
    }

    /// As JSON: `train` and `held_out` as camera lists, `times`, `clock`, `splits`.
    pub(crate) fn to_json(&self) -> Result<Value, RunError> {
        let Self { times, clock, splits, .. } = self.clone();
        let mut json = json!(Stored { times, clock, splits });
        json["train"] = cameras_json(&self.train)?;
        json["held_out"] = cameras_json(&self.held_out)?;
        Ok(json)
    }

    /// Reads [`Self::to_json`]; `file` is the name used in errors. A list of cameras alone is taken for training views, and the
    /// timestamps for theirs.
    ///
    /// # Errors
    /// Those of the camera reader; a time that is not finite; another shape.
    pub(crate) fn parse(json: &Value, file: &str) -> Result<Self, IoError> {
        let list = |key: &str| json.get(key).map_or(Ok(Vec::new()), |list| views(list, file));
        if json.is_array() {
            let train = views(json, file)?;
            let mut times: Vec<f32> = train.iter().map(|v| v.time.normalised).collect();
            times.sort_by(f32::total_cmp);
            times.dedup();
            return Ok(Self { train, times, ..Self::default() });
        }
        let Stored { times, clock, splits } = serde_json::from_value(json.clone()).map_err(|e| {
            let (file, advice) = (file.into(), "train the run again, or name its data with --data");
            IoError::Malformed { file, format: "JSON", at: At::Byte(0), what: e.to_string(), advice }
        })?;
        let clocks = clock.iter().flatten().copied();
        let all = times.iter().map(|&t| f64::from(t)).chain(clocks).enumerate();
        if let Some((row, value)) = all.into_iter().find(|(_, t)| !t.is_finite()) {
            let (file, field) = (file.into(), "times".to_owned());
            return Err(IoError::Value { file, row, field, value, rule: "must be finite" });
        }
        Ok(Self { train: list("train")?, held_out: list("held_out")?, times, clock, splits })
    }
}

/// Up to `most` items, evenly spaced, the first and the last among them.
fn spaced<T: Clone>(all: &[T], most: usize) -> Vec<T> {
    let n = all.len().min(most);
    (0..n).filter_map(|k| all.get(k * (all.len() - 1) / (n - 1).max(1))).cloned().collect()
}

/// Up to [`MAX_CAMERAS`] views, evenly spaced, without their images.
fn without_images(views: &[View]) -> Vec<View> {
    let without_image = |v: &View| View::new(&v.name, v.camera.clone(), v.time, no_image(), v.camera_id);
    gs_data::evenly(views.len(), MAX_CAMERAS).map(|k| without_image(&views[k])).collect()
}

fn no_image() -> ImageSource {
    ImageSource::Memory(Arc::new(ImageU8 { width: 0, height: 0, data: Vec::new() }))
}

/// Views as camera JSON.
fn cameras_json(views: &[View]) -> Result<Value, RunError> {
    let named =
        |v: &View| NamedCamera { name: v.name.clone(), camera: v.camera.clone(), time: Some(v.time.normalised) };
    let cameras: Vec<NamedCamera> = views.iter().map(named).collect();
    let mut text = Vec::new();
    let written = write_cameras(&cameras, &mut text).and_then(|()| Ok(serde_json::from_slice(&text)?));
    let mut json: Value = written.map_err(|source| RunError::io("write", "the cameras".as_ref(), source))?;
    let entries = json.as_array_mut().into_iter().flatten().filter_map(Value::as_object_mut);
    for (entry, v) in entries.zip(views) {
        entry.retain(|key, _| !DERIVED.contains(&key.as_str()));
        entry.insert(CAMERA_ID.into(), json!(v.camera_id));
    }
    Ok(json)
}

/// The cameras of such JSON, as views without images.
fn views(json: &Value, file: &str) -> Result<Vec<View>, IoError> {
    if json.as_array().is_some_and(Vec::is_empty) {
        return Ok(Vec::new());
    }
    let cameras = parse_cameras(json.to_string().as_bytes(), file, &Limits::default())?;
    let view = |(k, c): (u32, NamedCamera)| {
        let time = Time::new(c.time.unwrap_or(0.0)).unwrap_or_default();
        let camera_id = json[k as usize][CAMERA_ID].as_u64().and_then(|id| u32::try_from(id).ok());
        View::new(&c.name, c.camera, time, no_image(), camera_id.unwrap_or(k))
    };
    Ok((0..).zip(cameras).map(view).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_comes_back_as_it_was() {
        let data = gs_synth::testkit::scene("balls", 16, 40);
        let kept = Kept::of(&data);
        let back = Kept::parse(&kept.to_json().unwrap(), "kept").unwrap();
        assert_eq!((back.train.len(), back.splits.train), (MAX_CAMERAS, 40));
        assert_eq!((&back.train[0].camera, &back.train[0].name), (&data.train[0].camera, &data.train[0].name));
        assert_eq!(back.train[8].camera, data.train[20].camera);
        assert_eq!(
            (back.train[8].camera_id, data.train[20].camera_id),
            (20, 20),
            "each view has a camera of its own here"
        );
        assert_eq!(back.train[8].time.normalised, data.train[20].time.normalised);
        assert_eq!(back.held_out.len(), data.test.len().min(MAX_CAMERAS));
        assert_eq!((&back.times, back.clock, back.splits), (&kept.times, kept.clock, kept.splits));
        assert_eq!(back.times.len(), 40);
        let of = |clock| Kept { clock, ..Kept::default() }.seconds();
        assert_eq!([of(None), of(Some([0.0, 0.99])), of(Some([2.0, 5.0]))], [None, None, Some([2.0, 5.0])]);
    }

    #[test]
    fn nothing_and_a_list_of_cameras_alone_are_read() {
        let nothing = Kept::parse(&Kept::default().to_json().unwrap(), "kept").unwrap();
        assert!(nothing.train.is_empty() && nothing.times.is_empty());
        let kept = Kept::of(&gs_synth::testkit::scene("balls", 16, 8));
        let list = Kept::parse(&kept.to_json().unwrap()["train"], "kept").unwrap();
        assert_eq!((list.train.len(), &list.times), (8, &kept.times));
    }

    #[test]
    fn timestamps_keep_both_ends() {
        let all: Vec<u32> = (0..1000).collect();
        let some = spaced(&all, 400);
        assert_eq!((some.len(), some[0], some[399]), (400, 0, 999));
        assert_eq!(spaced(&all[..1], 400), [0]);
        assert!(spaced::<u32>(&[], 400).is_empty());
    }

    #[test]
    fn a_time_that_is_no_number_is_an_error() {
        // Larger than the largest f32.
        let error = Kept::parse(&json!({"times": [0.0, 1e300]}), "kept").unwrap_err();
        assert!(matches!(error, IoError::Value { row: 1, .. }), "{error}");
    }
}
