//! Nerfies and HyperNeRF captures (Park et al. 2021a, 2021b): one moving camera, or two on a rig.
//!
//! `dataset.json` lists `ids`, `train_ids`, `val_ids`; `metadata.json` gives each id its `time_id` (or `warp_id`) and
//! `camera_id`; `scene.json` holds `center` and `scale`; `camera/<id>.json` one camera; `rgb/<s>x/<id>.png` its picture at
//! `1/s` of full size; `points.npy`, optional, `P × 3` points.
//!
//! # Geometry
//! `orientation` is the rotation from world to camera with OpenCV axes, `position` the camera's centre. Cameras and points
//! are brought to the normalised frame: `x ← (x − center) · scale`. With `(x', y')` the distorted point of the plane `z = 1`
//! ([`super::lens`]; the files write the tangential pair as `p1 p2`),
//! ```text
//! u = focal_length · x' + skew · y' + cx        v = focal_length · pixel_aspect_ratio · y' + cy
//! ```
//! with pixel centres at +½: ours. Intrinsics scale with the exact ratio of the picture's size to `image_size`.
//!
//! # Splits and times
//! Where `val_ids` is not empty (`vrig` captures) `train_ids` train and `val_ids` are held out; else (`interp` captures) of
//! `ids` numbers 0, 4, 8, … train and 2, 6, 10, … are held out. `t = time_id / max(time_id)` over all ids.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec2, DVec3};
use gs_core::Time;
use serde_json::{Map, Value};

use super::error::{DataError, Place};
use super::files::Root;
use super::frames::{Listed, image_folder, locate, name_views, with_headers};
use super::header::ImageHeader;
use super::intrinsics::{Adjusted, Intrinsics};
use super::json::{Fields, read_object};
use super::lens::Lens;
use super::options::{DataOptions, TimeFrom, TimeRange};
use super::pose::{Pose, from_axes};
use super::times::{Draft, Drafts, settle};
use super::{Confidence, Dataset, ImageSource, Layout, PointCloud, View, cloud, sight};

/// The entry in [`super::LAYOUTS`].
pub(crate) const LAYOUT: Layout = Layout {
    name: "hypernerf",
    about: "Nerfies and HyperNeRF: dataset.json, metadata.json, scene.json, camera/ID.json and rgb/2x/ID.png",
    probe,
    open,
};

/// Picture folders, the size of published results first.
const IMAGE_FOLDERS: [&str; 5] = ["rgb/2x", "rgb/1x", "rgb/4x", "rgb/8x", "rgb/16x"];
/// Largest `dataset.json` and `metadata.json`: some 20 000 pictures.
const MAX_LIST_BYTES: u64 = 2 << 20;
/// Largest `scene.json` and camera file; usual ones have under 1 kB.
const MAX_SMALL_BYTES: u64 = 64 << 10;
/// Ids are whole numbers up to this, exact in `f64` and in `u32`.
const MAX_ID: f64 = u32::MAX as f64;

fn probe(dir: &Path) -> Option<Confidence> {
    let files = ["dataset.json", "metadata.json"].iter().all(|name| dir.join(name).is_file());
    (files && dir.join("camera").is_dir()).then_some(Confidence::Certain)
}

/// Reads a capture.
///
/// # Errors
/// See [`DataError`]; every fault names file and field.
fn open(dir: &Path, options: &DataOptions) -> Result<Dataset, DataError> {
    let root = Root::new(dir)?;
    let mut notes = Vec::new();
    let frame = Frame::read(&dir.join("scene.json"))?;
    let lists = Lists::read(&dir.join("dataset.json"), &mut notes)?;
    let tags = Tags::read(&dir.join("metadata.json"), &mut notes)?;
    let last = lists.last_time(&tags)?;
    let folder = image_folder(&root, options, &IMAGE_FOLDERS, "it is a HyperNeRF capture without images")?;
    notes.push(format!("images come from \"{folder}\""));
    let reader = Reader { root: &root, folder: &folder, frame: &frame, tags: &tags, options };
    let (train, mut has_alpha) = reader.split(&lists, &lists.train, &mut notes)?;
    if train.is_empty() {
        return Err(DataError::Empty { file: lists.file.clone() });
    }
    let (test, alpha) = reader.split(&lists, &lists.test, &mut notes)?;
    has_alpha |= alpha;
    let whole = TimeRange { start: 0.0, end: last };
    let by_tags = options.time_from == TimeFrom::File;
    let span = options.time_range.or((by_tags && last > 0.0).then_some(whole));
    let timed = DataOptions { time_range: span, ..options.clone() };
    let mut settled = settle(Drafts { train, val: Vec::new(), test }, &timed, None)?;
    let points = frame.points(&root, &mut notes)?;
    let bounds = if points.is_none() { frame.bounds(&settled.train) } else { None };
    if settled.dynamic && by_tags {
        settled.source = format!("{} of metadata.json", tags.key);
    }
    Ok(Dataset { points, bounds, ..settled.dataset(dir, LAYOUT.name, has_alpha, notes) })
}

/// `scene.json`: the normalised frame.
struct Frame {
    centre: DVec3,
    scale: f64,
    depths: Option<[f64; 2]>,
}

impl Frame {
    fn read(file: &Path) -> Result<Self, DataError> {
        let map = read_object(file, MAX_SMALL_BYTES)?;
        let fields = Fields::new(file, "", &map);
        let centre = fields.numbers::<3>("center")?;
        let missing = |key| fields.fault(key, "missing", "cameras are normalised by it", "copy scene.json again");
        let scale = fields.required_number("scale")?;
        if scale <= 0.0 {
            return Err(fields.fault("scale", &scale.to_string(), "it must be positive", "correct the number"));
        }
        let depths = fields.number("near")?.zip(fields.number("far")?).map(<[f64; 2]>::from);
        Ok(Self { centre: centre.ok_or_else(|| missing("center"))?.into(), scale, depths })
    }

    fn normalise(&self, p: DVec3) -> DVec3 {
        (p - self.centre) * self.scale
    }

    /// The box of all that the training cameras see between `near` and `far`.
    fn bounds(&self, train: &[View]) -> Option<[glam::Vec3; 2]> {
        self.depths.and_then(|d| sight::bounds(train.iter().map(|v| (&v.camera, d))))
    }

    /// The points of `points.npy`, mid grey.
    fn points(&self, root: &Root, notes: &mut Vec<String>) -> Result<Option<PointCloud>, DataError> {
        let file = root.resolve("points.npy", &Place::new(root.dir(), "points.npy"))?;
        if !file.is_file() {
            notes.push("there is no points.npy: training starts from other points".into());
            return Ok(None);
        }
        let positions = cloud::read_triples(&file, |p| self.normalise(p))?;
        notes.push(format!("points.npy: {} points without colours", positions.len()));
        Ok(Some(PointCloud { colors: vec![[0.5; 3]; positions.len()], positions }))
    }
}

/// `dataset.json`: which ids train, and which are held out.
struct Lists {
    file: PathBuf,
    all: Vec<String>,
    train: Vec<String>,
    test: Vec<String>,
}

impl Lists {
    fn read(file: &Path, notes: &mut Vec<String>) -> Result<Self, DataError> {
        let map = read_object(file, MAX_LIST_BYTES)?;
        let all = names(file, &map, "ids")?;
        let (train, val) = (names(file, &map, "train_ids")?, names(file, &map, "val_ids")?);
        if let Some(count) = Fields::new(file, "", &map).number("count")?.filter(|&c| c != all.len() as f64) {
            notes.push(format!("dataset.json states a count of {count} and lists {} ids", all.len()));
        }
        let (train, test) = if val.is_empty() {
            notes.push("val_ids is empty: of ids every 4th trains, those half-way between are held out".into());
            let every_fourth = |start| all.iter().skip(start).step_by(4).cloned().collect::<Vec<_>>();
            (every_fourth(0), every_fourth(2))
        } else {
            (train, val)
        };
        let trained: HashSet<&String> = train.iter().collect();
        if let Some(i) = test.iter().position(|id| trained.contains(id)) {
            return Err(DataError::Field {
                place: Place::new(file, format!("val_ids[{i}]")),
                value: format!("\"{}\", which train_ids lists too", test[i]),
                why: "a view that trains cannot be held out",
                fix: "remove it from one of the lists",
            });
        }
        Ok(Self { file: file.to_path_buf(), all, train, test })
    }

    /// The largest time of all ids, those of no split included.
    fn last_time(&self, tags: &Tags) -> Result<f64, DataError> {
        let mut last: f64 = 0.0;
        for id in self.all.iter().chain(&self.train).chain(&self.test) {
            last = last.max(tags.of(id)?.time);
        }
        Ok(last)
    }
}

/// A list of texts; a list that is not there is empty.
fn names(file: &Path, map: &Map<String, Value>, key: &str) -> Result<Vec<String>, DataError> {
    let fault = |at: String, value: &Value| DataError::Field {
        place: Place::new(file, at),
        value: value.to_string().chars().take(40).collect(),
        why: "ids are a list of texts",
        fix: "export dataset.json again",
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

/// `metadata.json`: when, and by which camera.
struct Tags {
    file: PathBuf,
    map: Map<String, Value>,
    /// The field that holds the time.
    key: &'static str,
}

struct Tag {
    time: f64,
    camera: u32,
}

impl Tags {
    fn read(file: &Path, notes: &mut Vec<String>) -> Result<Self, DataError> {
        let map = read_object(file, MAX_LIST_BYTES)?;
        let has = |key: &str| map.values().any(|v| v.get(key).is_some());
        let key = if has("time_id") { "time_id" } else { "warp_id" };
        if has("appearance_id") {
            notes.push("appearance ids are not used: all pictures are taken as equally exposed".into());
        }
        Ok(Self { file: file.to_path_buf(), map, key })
    }

    fn of(&self, id: &str) -> Result<Tag, DataError> {
        let Some(Value::Object(map)) = self.map.get(id) else {
            return Err(DataError::Field {
                place: Place::new(&self.file, id),
                value: "missing".into(),
                why: "dataset.json lists this id, and its time is unknown",
                fix: "copy metadata.json and dataset.json of the same capture",
            });
        };
        let fields = Fields::new(&self.file, id, map);
        let whole = |key: &str, value: f64| {
            let good = (0.0..=MAX_ID).contains(&value) && value.fract() == 0.0;
            let why = "ids are whole numbers from 0 to 4294967295";
            if good { Ok(value) } else { Err(fields.fault(key, &value.to_string(), why, "correct the number")) }
        };
        let time = whole(self.key, fields.required_number(self.key)?)?;
        let camera = whole("camera_id", fields.number("camera_id")?.unwrap_or(0.0))?;
        Ok(Tag { time, camera: camera as u32 })
    }
}

/// What one picture needs beside its file.
struct Shot {
    pose: Pose,
    intrinsics: Intrinsics,
    tag: Tag,
    place: Place,
    time_place: Place,
}

struct Reader<'a> {
    root: &'a Root,
    folder: &'a str,
    frame: &'a Frame,
    tags: &'a Tags,
    options: &'a DataOptions,
}

impl Reader<'_> {
    /// The views of a list of ids, and whether their pictures carry alpha.
    fn split(&self, lists: &Lists, ids: &[String], notes: &mut Vec<String>) -> Result<(Vec<Draft>, bool), DataError> {
        let listed = ids.iter().map(|id| self.shot(lists, id)).collect::<Result<Vec<_>, _>>()?;
        let listed = with_headers(&lists.file, listed, self.options, notes)?;
        let has_alpha = listed.iter().any(|(_, h)| h.has_alpha);
        let shown: Vec<PathBuf> = listed.iter().map(|(l, _)| l.shown.clone()).collect();
        let mut adjusted = Adjusted::default();
        let mut drafts = Vec::with_capacity(listed.len());
        for (listed, header) in listed {
            drafts.push(self.draft(listed, &header, &mut adjusted)?);
        }
        notes.extend(adjusted.notes());
        name_views(&mut drafts, &shown);
        Ok((drafts, has_alpha))
    }

    fn shot(&self, lists: &Lists, id: &str) -> Result<Listed<Shot>, DataError> {
        let listed_at = Place::new(&lists.file, format!("id \"{id}\""));
        let (shown, path) = locate(self.root, &format!("{}/{id}", self.folder), &listed_at)?;
        let file = self.root.resolve(&format!("camera/{id}.json"), &listed_at)?;
        let map = read_object(&file, MAX_SMALL_BYTES)?;
        let fields = Fields::new(&file, "", &map);
        let rest = Shot {
            pose: self.pose(&fields)?,
            intrinsics: intrinsics(&fields)?,
            tag: self.tags.of(id)?,
            place: fields.place(""),
            time_place: Place::new(&self.tags.file, format!("{id}.{}", self.tags.key)),
        };
        Ok(Listed { shown, path, rest })
    }

    fn pose(&self, camera: &Fields) -> Result<Pose, DataError> {
        let rows = camera.rows3("orientation")?.map(DVec3::from);
        let position = camera.numbers::<3>("position")?;
        let missing = || camera.fault("position", "missing", "it is the camera's centre", "export the cameras again");
        let centre = self.frame.normalise(position.ok_or_else(missing)?.into());
        // The rows of the rotation to the camera are the camera's axes in the world.
        let axes = DMat3::from_cols(rows[0], rows[1], rows[2]);
        from_axes(axes, centre, &camera.place("orientation"))
    }

    fn draft(&self, listed: Listed<Shot>, header: &ImageHeader, adjusted: &mut Adjusted) -> Result<Draft, DataError> {
        let shot = listed.rest;
        let (camera, rescaled) = shot.intrinsics.camera(header, &listed.path, &shot.pose, &shot.place)?;
        let lens = shot.intrinsics.lens(self.options.undistort, &shot.place)?;
        adjusted.count(&shot.intrinsics, &camera, rescaled, lens.as_ref());
        let mut view = View::new("", camera, Time::default(), ImageSource::File(listed.path), shot.tag.camera);
        view.lens = lens;
        Ok(Draft { view, stated: Some(shot.tag.time), place: shot.time_place })
    }
}

/// Intrinsics of a camera file at full size.
fn intrinsics(camera: &Fields) -> Result<Intrinsics, DataError> {
    let positive = |key: &str, value: f64| {
        let bad = || camera.fault(key, &value.to_string(), "it must be positive", "export the cameras again");
        if value > 0.0 { Ok(value) } else { Err(bad()) }
    };
    let pair = |key: &str| {
        let missing = || camera.fault(key, "missing", "it is part of the intrinsics", "export the cameras again");
        camera.numbers::<2>(key)?.ok_or_else(missing)
    };
    let size = pair("image_size")?;
    for side in size {
        positive("image_size", side)?;
    }
    let f = positive("focal_length", camera.required_number("focal_length")?)?;
    let aspect = positive("pixel_aspect_ratio", camera.number("pixel_aspect_ratio")?.unwrap_or(1.0))?;
    let [k1, k2, k3] = camera.numbers("radial_distortion")?.unwrap_or_default();
    // Nerfies of 2021 wrote "tangential".
    let tangential = camera.numbers("tangential_distortion")?;
    let [p1, p2] = if tangential.is_some() { tangential } else { camera.numbers("tangential")? }.unwrap_or_default();
    let skew = camera.number("skew")?.unwrap_or(0.0) / f;
    Ok(Intrinsics {
        size: size.into(),
        focal: DVec2::new(f, f * aspect),
        principal: pair("principal_point")?.into(),
        lens: Lens { k1, k2, k3, p1, p2, skew },
    })
}
