//! NVFi's dynamic scenes (Li et al. 2023), as GVFi, FreeGave and TRACE use them: static cameras, a past to train on and a
//! future to extrapolate to.
//!
//! # Files
//! * **Nested**, the original release: `transforms_{train,val,test}.json` with `camera_angle_x` and
//!   `data: {camera: {transform_matrix, frames: [{file_path, time}]}}`.
//! * **Flat**, the re-release, and the generated scenes of this project: the frames of [`super::blender`]. A folder has this form where its `scene.toml` states a boundary, or where all test views are later than all training views.
//! * **Labelled**, the indoor scenes with segmentations: one `transforms.json` whose frames have `img_path` and `segm_path`;
//!   `segm_path` with `.npy` is [`View::labels`](super::View::labels). All views train except those that
//!   `data.test_cameras` and the boundary hold out.
//!
//! Cameras are those of [`super::blender`]: camera to world, OpenGL axes, principal point in the centre unless the file, a
//! camera of a nested one or a frame states more.
//!
//! # Splits and times
//! Views of `train` train. Those of `val` (other cameras) and `test` are held out; views of any list later than the boundary
//! are the future. The boundary is `data.time_boundary`, else the one of `scene.toml`, else the last training time if held-out
//! views are later, else 0.75. Times are the authors' virtual time: one sequence is 0..1, frame `k` of `F` is at `k/F`, so times
//! are not rescaled unless `data.time_range` is given (ParticleNeRF: the frame that is 1). With `data.time_from=name` or `order`
//! the span of the training views is 0..1, and only `data.time_boundary` or `scene.toml` makes a boundary.
//! Views with the same pose are of one camera. Cameras are numbered in order of appearance; `data.test_cameras` refers to these numbers.
//!
//! # Initial points
//! `points3d.ply`; else the scene box: the cube ±1.5 for objects (images with alpha), NVFi's room where all cameras are
//! inside it, else a cube of the size of the rig.

use std::path::{Path, PathBuf};

use glam::Vec3;
use gs_core::Time;

use super::blender::{Frame, read_frame};
use super::error::DataError;
use super::files::{Root, read_text};
use super::frames::{Listed, name_views, number_cameras, with_headers};
use super::intrinsics::{Adjusted, PartialIntrinsics};
use super::json::{Document, Fields, MAX_JSON_BYTES, quote_non_finite};
use super::options::{DataOptions, TimeFrom, TimeRange};
use super::times::{Draft, Drafts, check_range, settle};
use super::{Confidence, Dataset, ImageSource, Layout, View, ply};

mod kind;
mod nested;

use kind::Kind;

/// The entry in [`super::LAYOUTS`].
pub(crate) const LAYOUT: Layout = Layout {
    name: "nvfi",
    about: "NVFi, TRACE, ParticleNeRF: transforms_{train,val,test}.json with a future, by cameras or by frames; labelled transforms.json",
    probe,
    open,
};

/// Half side of the scene box of objects.
const HALF_SIDE: f32 = 1.5;
/// The room of NVFi's indoor scenes: lower and upper corner.
const INDOOR_BOUNDS: [Vec3; 2] = [Vec3::new(-3.03, -3.03, -0.03), Vec3::new(3.03, 3.03, 6.03)];
/// The boundary where neither options nor files state one: as published.
const BOUNDARY: f64 = 0.75;
/// Initial points, optional.
const POINTS: &str = "points3d.ply";

fn probe(dir: &Path) -> Option<Confidence> {
    Kind::of(dir).map(|_| Confidence::Certain)
}

/// A frame and its label map.
struct LabelledFrame {
    frame: Frame,
    labels: Option<PathBuf>,
}

/// The views of one file.
#[derive(Default)]
struct List {
    drafts: Vec<Draft>,
    shown: Vec<PathBuf>,
    has_alpha: bool,
}

impl List {
    /// The views of this file, then those of another.
    fn and(mut self, other: Self) -> Self {
        self.drafts.extend(other.drafts);
        self.shown.extend(other.shown);
        self.has_alpha |= other.has_alpha;
        self
    }

    /// The views with their names.
    fn named(mut self) -> Vec<Draft> {
        name_views(&mut self.drafts, &self.shown);
        self.drafts
    }
}

/// Reads a scene.
///
/// # Errors
/// See [`DataError`]; every error names file and field.
fn open(dir: &Path, options: &DataOptions) -> Result<Dataset, DataError> {
    options.without_images(LAYOUT.name)?;
    options.without_fps(LAYOUT.name)?;
    let root = Root::new(dir)?;
    let mut notes = Vec::new();
    let kind = Kind::of(dir).unwrap_or(if dir.join(kind::TRAIN).is_file() { Kind::Flat } else { Kind::Labelled });
    let (train, held) = match kind {
        Kind::Labelled => (read_list(&root, kind, kind::LABELLED, options, &mut notes)?, List::default()),
        Kind::Nested | Kind::Flat => {
            let train = read_list(&root, kind, kind::TRAIN, options, &mut notes)?;
            let val = optional(&root, kind, kind::VAL, options, &mut notes)?;
            (train, val.and(optional(&root, kind, kind::TEST, options, &mut notes)?))
        }
    };
    if train.drafts.is_empty() {
        let name = if kind == Kind::Labelled { kind::LABELLED } else { kind::TRAIN };
        return Err(DataError::Empty { file: dir.join(name) });
    }
    let has_alpha = train.has_alpha;
    let options = &virtual_time(&train.drafts, &held.drafts, options)?;
    let mut drafts = Drafts { train: train.named(), val: Vec::new(), test: held.named() };
    let cameras = number_cameras(&mut drafts);
    notes.push(format!("{cameras} cameras, identified by their poses and numbered in order of appearance"));
    notes.push("the authors train at 800 pixels where images have them, and score renders reduced to half and truncated to 8 bit: gs4d eval --half --quantise truncate".into());
    let mut data = settle(drafts, options, None)?.dataset(dir, LAYOUT.name, has_alpha, notes);
    data.points = ply::initial_points(&root, POINTS, &mut data.notes)?;
    if data.points.is_none() {
        data.bounds = Some(bounds(&data));
    }
    Ok(data)
}

/// The options with range and boundary of the authors' virtual time, where the user sets none. Numbers of files are no such times.
///
/// # Errors
/// `data.time` if a training time lies outside 0..1.
fn virtual_time(train: &[Draft], held: &[Draft], options: &DataOptions) -> Result<DataOptions, DataError> {
    if options.time_from != TimeFrom::File {
        return Ok(options.clone());
    }
    let virtual_time = TimeRange { start: 0.0, end: 1.0 };
    if options.time_range.is_none() {
        check_range(train, [&[], &[]], virtual_time)?;
    }
    let whole = options.time_range.unwrap_or(virtual_time);
    let boundary = options.time_boundary.unwrap_or_else(|| own_boundary(train, held, whole));
    Ok(DataOptions { time_boundary: Some(boundary), time_range: Some(whole), ..options.clone() })
}

/// The share of the sequence that training views cover if held-out views are later, else [`BOUNDARY`].
fn own_boundary(train: &[Draft], held: &[Draft], whole: TimeRange) -> f64 {
    let last = |list: &[Draft]| list.iter().filter_map(|d| d.stated).fold(f64::NEG_INFINITY, f64::max);
    let share = (last(train) - whole.start) / (whole.end - whole.start);
    if last(held) > last(train) && share > 0.0 && share < 1.0 { share } else { BOUNDARY }
}

/// The views of a file that may be absent.
fn optional(
    root: &Root,
    kind: Kind,
    name: &str,
    options: &DataOptions,
    notes: &mut Vec<String>,
) -> Result<List, DataError> {
    if root.dir().join(name).is_file() {
        return read_list(root, kind, name, options, notes);
    }
    notes.push(format!("there is no {name}"));
    Ok(List::default())
}

fn read_list(
    root: &Root,
    kind: Kind,
    name: &str,
    options: &DataOptions,
    notes: &mut Vec<String>,
) -> Result<List, DataError> {
    let file = root.dir().join(name);
    let text = read_text(&file, MAX_JSON_BYTES)?;
    let text = quote_non_finite(&text);
    let frames = match kind {
        Kind::Nested => nested::read(root, &file, &text)?,
        Kind::Flat => flat(&file, &text, |frame, shared| {
            let Listed { shown, path, rest } = read_frame(root, frame, "file_path", shared)?;
            Ok(Listed { shown, path, rest: LabelledFrame { frame: rest, labels: None } })
        })?,
        Kind::Labelled => flat(&file, &text, |frame, shared| labelled(root, frame, shared))?,
    };
    let listed = with_headers(&file, frames, options, notes)?;
    let mut list = List::default();
    let mut adjusted = Adjusted::default();
    for (listed, header) in listed {
        let LabelledFrame { frame, labels } = listed.rest;
        let (camera, lens) = frame.camera(&header, &listed.path, options, &mut adjusted)?;
        let view = View::new("", camera, Time::default(), ImageSource::File(listed.path), 0);
        list.drafts.push(Draft { view: View { lens, labels, ..view }, stated: frame.time, place: frame.time_place });
        list.shown.push(listed.shown);
        list.has_alpha |= header.has_alpha;
    }
    notes.extend(adjusted.notes());
    Ok(list)
}

/// The frames of a file that lists them one by one; each is read with the intrinsics of all.
fn flat(
    file: &Path,
    text: &str,
    read: impl Fn(&Fields, &PartialIntrinsics) -> Result<Listed<LabelledFrame>, DataError>,
) -> Result<Vec<Listed<LabelledFrame>>, DataError> {
    let document = Document::parse(file, text)?;
    let shared = PartialIntrinsics::shared(&document.top())?;
    (0..document.len()).map(|i| read(&document.frame(i)?, &shared)).collect()
}

/// A frame with its label map.
fn labelled(root: &Root, frame: &Fields, shared: &PartialIntrinsics) -> Result<Listed<LabelledFrame>, DataError> {
    let Listed { shown, path, rest } = read_frame(root, frame, "img_path", shared)?;
    let written = with_npy(frame.required_text("segm_path")?);
    let place = frame.place("segm_path");
    let labels = root.resolve(&written, &place)?;
    if !labels.is_file() {
        return Err(DataError::Field {
            place,
            value: format!("\"{written}\", which does not exist"),
            why: "every frame of a labelled folder has a map of segments",
            fix: "copy the file, or correct the path",
        });
    }
    Ok(Listed { shown, path, rest: LabelledFrame { frame: rest, labels: Some(labels) } })
}

fn with_npy(written: &str) -> String {
    if written.ends_with(".npy") { written.to_owned() } else { format!("{written}.npy") }
}

/// The scene box of data without points.
fn bounds(data: &Dataset) -> [Vec3; 2] {
    if data.has_alpha {
        return [Vec3::splat(-HALF_SIDE), Vec3::splat(HALF_SIDE)];
    }
    let inside = |v: &View| {
        let p = v.camera.position().as_vec3();
        p.cmpge(INDOOR_BOUNDS[0]).all() && p.cmple(INDOOR_BOUNDS[1]).all()
    };
    if data.train.iter().all(inside) { INDOOR_BOUNDS } else { data.scene_bounds() }
}
