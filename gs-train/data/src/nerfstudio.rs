//! nerfstudio and instant-ngp: one `transforms.json` (Tancik et al. 2023; Müller et al. 2022).
//!
//! Intrinsics at top level or in each frame, those of the frame first: `fl_x fl_y cx cy w h`, or `camera_angle_x` (and
//! `camera_angle_y`), and the distortion `k1 k2 k3 p1 p2` of OpenCV, or with
//! `camera_model` `OPENCV_FISHEYE`, or `is_fisheye`, the `k1 k2 k3 k4` of its fisheye. Per frame `file_path`, `transform_matrix` (camera to
//! world, OpenGL axes) and optionally `time`, `camera_index` (frames of one camera of a rig share it; where any frame lacks it, frames of
//! one pose are of one camera), `mask_path` (white counts, black does not) and
//! `depth_file_path` (`.npy` or PNG of 16 bit, in millimetres unless `depth_unit_scale_factor` at top level says otherwise). `train_filenames`, `val_filenames`, `test_filenames` give the split; without
//! the first, every frame of neither other list trains; without any, every eighth view is held out. `data.images` names the folder
//! to read instead of `images/`. `ply_file_path` names the initial points. `applied_transform` is not used:
//! poses and points are both in the transformed world.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use gs_core::{Time, cast};

use super::error::{DataError, Place};
use super::files::{Root, read_text};
use super::frames::{Listed, locate, name_views, share_cameras, with_headers};
use super::header::ImageHeader;
use super::intrinsics::{Adjusted, PartialIntrinsics, hold_out, hold_out_note};
use super::json::{Document, Fields, MAX_JSON_BYTES, quote_non_finite, whole};
use super::options::DataOptions;
use super::pose::{Pose, from_opengl};
use super::times::{Draft, Drafts, settle};
use super::{Confidence, Dataset, DepthMap, ImageSource, Layout, PointCloud, View, mask, ply};

/// The entry in [`super::LAYOUTS`].
pub(crate) const LAYOUT: Layout = Layout {
    name: "nerfstudio",
    about: "nerfstudio and instant-ngp: transforms.json with intrinsics and optional distortion",
    probe,
    open,
};

fn probe(dir: &Path) -> Option<Confidence> {
    dir.join("transforms.json").is_file().then_some(Confidence::Likely)
}

/// Fields of a frame beside its image.
struct Frame {
    pose: Pose,
    time: Option<f64>,
    stated: PartialIntrinsics,
    time_place: Place,
    place: Place,
    written: String,
    mask: Option<PathBuf>,
    depth: Option<DepthMap>,
    camera: Option<u32>,
}

/// Reads a capture.
///
/// # Errors
/// See [`DataError`]; every error names file and field.
fn open(dir: &Path, options: &DataOptions) -> Result<Dataset, DataError> {
    options.without_fps(LAYOUT.name)?;
    let root = Root::new(dir)?;
    let file = dir.join("transforms.json");
    let text = read_text(&file, MAX_JSON_BYTES)?;
    let text = quote_non_finite(&text);
    let document = Document::parse(&file, &text)?;
    let shared = PartialIntrinsics::shared(&document.top())?;
    let unit = depth_unit(&document.top())?;
    let images = options.images.as_deref();
    let frames = (0..document.len())
        .map(|i| read_frame(&root, &document.frame(i)?, &shared, unit, images))
        .collect::<Result<_, _>>()?;
    let mut notes = Vec::new();
    let frames = with_headers(&file, frames, options, &mut notes)?;
    let has_alpha = frames.iter().any(|(_, h)| h.has_alpha);
    let written: Vec<String> = frames.iter().map(|(f, _)| f.rest.written.clone()).collect();
    let numbered = frames.iter().all(|(f, _)| f.rest.camera.is_some());
    let drafts = drafts(frames, numbered, options, &mut notes)?;
    let split = split(&document, &written, options, &mut notes)?;
    let mut drafts = deal(drafts, &split);
    if !numbered {
        share_cameras(&mut drafts);
    }
    if drafts.train.is_empty() {
        return Err(DataError::Empty { file });
    }
    let settled = settle(drafts, options, None)?;
    Ok(Dataset { points: points(&root, &document.top())?, ..settled.dataset(dir, LAYOUT.name, has_alpha, notes) })
}

/// World units per unit of depth maps: millimetres, as nerfstudio takes them, unless the file says otherwise.
fn depth_unit(top: &Fields) -> Result<f64, DataError> {
    let key = "depth_unit_scale_factor";
    match top.number(key)?.unwrap_or(1e-3) {
        unit if unit > 0.0 => Ok(unit),
        unit => {
            Err(top.fault(key, &unit.to_string(), "depth is measured in it", "state world units per unit of the files"))
        }
    }
}

fn read_frame(
    root: &Root,
    frame: &Fields,
    shared: &PartialIntrinsics,
    depth_unit: f64,
    images: Option<&str>,
) -> Result<Listed<Frame>, DataError> {
    let written = frame.required_text("file_path")?.to_string();
    let image = images.map_or(Ok(written.clone()), |folder| in_folder(&written, folder))?;
    let (shown, path) = locate(root, &image, &frame.place("file_path"))?;
    let place = frame.place("transform_matrix");
    let file = |key: &'static str| frame.text(key)?.map(|m| root.resolve(m, &frame.place(key))).transpose();
    let stated = PartialIntrinsics::of_frame(frame, shared)?;
    if images.is_some_and(|folder| folder.trim_end_matches('/') != "images") && stated.counts_pixels_of_no_size() {
        return Err(DataError::Field {
            place: frame.place("w"),
            value: "missing, or h is".into(),
            why: "the images that data.images names may have another size than the focal length is stated for",
            fix: "add w and h",
        });
    }
    let rest = Frame {
        pose: from_opengl(&frame.matrix("transform_matrix")?, &place)?,
        time: frame.number("time")?,
        stated,
        time_place: frame.place("time"),
        place: frame.place(""),
        written,
        mask: file("mask_path")?,
        depth: file("depth_file_path")?.map(|file| DepthMap { file, unit: depth_unit }),
        camera: camera_index(frame)?,
    };
    Ok(Listed { shown, path, rest })
}

/// The path of an image in another folder: `images/a.png` in `images_4` is `images_4/a.png`.
fn in_folder(written: &str, folder: &str) -> Result<String, DataError> {
    let unix = written.replace('\\', "/");
    let inside = unix.trim_start_matches("./").strip_prefix("images/").ok_or_else(|| DataError::Option {
        name: "data.images",
        value: folder.into(),
        rule: format!("it replaces images/ in the paths of frames, and \"{written}\" is not there"),
    })?;
    Ok(format!("{}/{inside}", folder.trim_end_matches('/')))
}

/// The number of a camera that took several frames.
fn camera_index(frame: &Fields) -> Result<Option<u32>, DataError> {
    let key = "camera_index";
    let Some(stated) = frame.number(key)? else { return Ok(None) };
    let index = whole(stated, 0..=u32::MAX);
    index
        .map(Some)
        .ok_or_else(|| frame.fault(key, &stated.to_string(), "cameras are numbered from 0", "correct the number"))
}

fn drafts(
    frames: Vec<(Listed<Frame>, ImageHeader)>,
    numbered: bool,
    options: &DataOptions,
    notes: &mut Vec<String>,
) -> Result<Vec<Draft>, DataError> {
    let shown: Vec<PathBuf> = frames.iter().map(|(f, _)| f.shown.clone()).collect();
    let mut adjusted = Adjusted::default();
    let mut drafts = Vec::with_capacity(frames.len());
    for (k, (listed, header)) in frames.into_iter().enumerate() {
        let frame = listed.rest;
        let id = frame.camera.filter(|_| numbered).unwrap_or(cast::to_u32(k));
        let intrinsics = frame.stated.complete(&header, &frame.place)?;
        let (camera, lens) =
            adjusted.fit(&intrinsics, &header, &listed.path, &frame.pose, &frame.place, options.undistort)?;
        let mut view = View::new("", camera, Time::default(), ImageSource::File(listed.path), id);
        frame.depth.as_ref().map_or(Ok(()), DepthMap::check)?;
        (view.lens, view.depth) = (lens, frame.depth);
        if let Some(file) = frame.mask {
            mask::check(&file, [view.camera.width, view.camera.height])?;
            view.mask = Some(ImageSource::File(file));
        }
        drafts.push(Draft { view, stated: frame.time, place: frame.time_place });
    }
    notes.extend(adjusted.notes());
    name_views(&mut drafts, &shown);
    Ok(drafts)
}

/// The split of a frame.
#[derive(Clone, Copy)]
enum Target {
    Train,
    Val,
    Test,
    Nowhere,
}

/// The list of the frames that train.
const TRAIN: &str = "train_filenames";
/// The lists of the frames that are held out; a frame of both is of the last.
const HELD_OUT: [(&str, Target); 2] = [("val_filenames", Target::Val), ("test_filenames", Target::Test)];

fn split(
    document: &Document,
    written: &[String],
    options: &DataOptions,
    notes: &mut Vec<String>,
) -> Result<Vec<Target>, DataError> {
    let train = document.names(TRAIN)?;
    let mut held = Vec::new();
    for (key, target) in HELD_OUT {
        held.push((key, document.names(key)?.unwrap_or_default(), target));
    }
    if train.is_none() && held.iter().all(|(_, list, _)| list.is_empty()) {
        let (_, out) = hold_out(written, options.hold_out);
        let mut targets = vec![Target::Train; written.len()];
        out.iter().for_each(|&i| targets[i] = Target::Test);
        notes.push(hold_out_note(options.hold_out, out.len()));
        return Ok(targets);
    }
    let frames: HashSet<String> = (0..document.len())
        .map(|i| Ok(document.frame(i)?.required_text("file_path")?.to_owned()))
        .collect::<Result<_, DataError>>()?;
    let mut listed: HashMap<&str, Target> = HashMap::new();
    for (i, name) in train.iter().flatten().enumerate() {
        if !frames.contains(name) {
            return Err(no_frame(document, TRAIN, i, name));
        }
        listed.insert(name, Target::Train);
    }
    for (key, list, target) in &held {
        for (i, name) in list.iter().enumerate() {
            if !frames.contains(name) {
                return Err(no_frame(document, key, i, name));
            }
            if matches!(listed.insert(name, *target), Some(Target::Train)) {
                return Err(DataError::Field {
                    place: document.top().place(&format!("{key}[{i}]")),
                    value: format!("\"{name}\", which {TRAIN} lists too"),
                    why: "a view that trains cannot be held out",
                    fix: "remove it from one of the lists",
                });
            }
        }
    }
    let others = written.iter().filter(|name| !listed.contains_key(name.as_str())).count();
    let rest = if train.is_some() { Target::Nowhere } else { Target::Train };
    if train.is_none() {
        notes.push(format!("the data have no {TRAIN}: the {others} frames that are not held out train"));
    } else if others > 0 {
        notes.push(format!("{others} frames are in none of the lists of file names and are not used"));
    }
    Ok(written.iter().map(|name| listed.get(name.as_str()).copied().unwrap_or(rest)).collect())
}

/// The `i`-th name of a list is that of no frame.
fn no_frame(document: &Document, key: &str, i: usize, name: &str) -> DataError {
    DataError::Field {
        place: document.top().place(&format!("{key}[{i}]")),
        value: format!("\"{name}\", which is the file_path of no frame"),
        why: "the frame that it means would be of another split",
        fix: "write it as the frame does",
    }
}

fn deal(drafts: Vec<Draft>, targets: &[Target]) -> Drafts {
    let mut dealt = Drafts::default();
    for (draft, target) in drafts.into_iter().zip(targets) {
        match target {
            Target::Train => dealt.train.push(draft),
            Target::Val => dealt.val.push(draft),
            Target::Test => dealt.test.push(draft),
            Target::Nowhere => {}
        }
    }
    dealt
}

fn points(root: &Root, top: &Fields) -> Result<Option<PointCloud>, DataError> {
    let Some(written) = top.text("ply_file_path")? else { return Ok(None) };
    let path = root.resolve(written, &top.place("ply_file_path"))?;
    ply::read_points(&path).map(Some)
}
