//! Which of the three forms a folder has, decided by JSON keys and times, not by file names alone.

use std::path::Path;

use serde::Deserialize;
use serde_json::value::RawValue;

use crate::files::read_text;
use crate::json::{MAX_JSON_BYTES, quote_non_finite, slices};
use crate::scene_file;

pub(super) const TRAIN: &str = "transforms_train.json";
pub(super) const VAL: &str = "transforms_val.json";
pub(super) const TEST: &str = "transforms_test.json";
pub(super) const LABELLED: &str = "transforms.json";
/// Shortest possible frame with a time.
const MIN_FRAME_BYTES: usize = 41;

/// The form of a folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// `data`: an object of cameras with their frames.
    Nested,
    /// `frames`: a list, as in D-NeRF.
    Flat,
    /// Frames one by one, with label maps.
    Labelled,
}

/// The keys that decide.
#[derive(Deserialize)]
struct Keys<'a> {
    #[serde(borrow)]
    data: Option<&'a RawValue>,
    frames: Option<&'a RawValue>,
}

/// The keys of a frame that decide.
#[derive(Deserialize)]
struct FrameKeys<'a> {
    time: Option<f64>,
    #[serde(borrow)]
    img_path: Option<&'a RawValue>,
    segm_path: Option<&'a RawValue>,
}

impl Kind {
    /// The form of a folder; none if it has none of them. Files that cannot be read have none: the error is that of their reader.
    pub(super) fn of(dir: &Path) -> Option<Self> {
        if dir.join(TRAIN).is_file() {
            let train = text(dir, TRAIN)?;
            let keys: Keys = serde_json::from_str(&train).ok()?;
            if keys.data.is_some_and(|d| d.get().starts_with('{')) {
                return Some(Self::Nested);
            }
            let states_boundary = || scene_file::read(dir).is_ok_and(|s| s.time.boundary.is_some());
            return (states_boundary() || tests_are_later(dir, &keys)).then_some(Self::Flat);
        }
        let labelled = text(dir, LABELLED)?;
        let keys: Keys = serde_json::from_str(&labelled).ok()?;
        let frames = slices(keys.frames?, labelled.len() / MIN_FRAME_BYTES + 1).ok()?;
        let first: FrameKeys = serde_json::from_str(frames.first()?.get()).ok()?;
        (first.img_path.is_some() && first.segm_path.is_some()).then_some(Self::Labelled)
    }
}

fn text(dir: &Path, name: &str) -> Option<String> {
    let text = read_text(&dir.join(name), MAX_JSON_BYTES).ok()?;
    Some(quote_non_finite(&text).into_owned())
}

/// Whether every test view is later than every training view.
fn tests_are_later(dir: &Path, train: &Keys) -> bool {
    let read = || {
        let test = text(dir, TEST)?;
        let [_, last] = train.frames.and_then(span)?;
        let [first, _] = serde_json::from_str::<Keys>(&test).ok()?.frames.and_then(span)?;
        Some(first > last)
    };
    read().unwrap_or(false)
}

/// First and last time of a list of frames that all have one.
fn span(frames: &RawValue) -> Option<[f64; 2]> {
    let frames = slices(frames, frames.get().len() / MIN_FRAME_BYTES + 1).ok()?;
    let mut span: Option<[f64; 2]> = None;
    for frame in frames {
        let time = serde_json::from_str::<FrameKeys>(frame.get()).ok()?.time?;
        let [first, last] = span.unwrap_or([time, time]);
        span = Some([first.min(time), last.max(time)]);
    }
    span
}
