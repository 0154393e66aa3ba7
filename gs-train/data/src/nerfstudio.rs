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

use glam::DVec2;
use gs_core::{Time, cast};

use super::error::{DataError, Place};
use super::files::{Root, read_text};
use super::frames::{Listed, locate, name_views, share_cameras, with_headers};
use super::header::ImageHeader;
use super::intrinsics::{Adjusted, Intrinsics, hold_out, hold_out_note};
use super::json::{Document, Fields, MAX_JSON_BYTES, quote_non_finite, whole};
use super::lens::Lens;
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
    let fisheye = is_fisheye(&document.top())?;
    let shared = PartialIntrinsics::read(&document.top(), fisheye)?;
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

/// Whether the camera model is OpenCV's fisheye; others than that, pinhole and OpenCV are refused.
fn is_fisheye(top: &Fields) -> Result<bool, DataError> {
    match top.text("camera_model")? {
        None | Some("OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "PERSPECTIVE") => Ok(false),
        Some("OPENCV_FISHEYE") => Ok(true),
        Some(other) => Err(DataError::CameraModel { place: top.place("camera_model"), model: other.into() }),
    }
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

/// The intrinsics that an object states, each optional.
#[derive(Clone, Copy, Default)]
struct PartialIntrinsics {
    fl: [Option<f64>; 2],
    angle: [Option<f64>; 2],
    principal: [Option<f64>; 2],
    size: [Option<f64>; 2],
    /// `k1 k2 k3 p1 p2 k4`.
    lens: [Option<f64>; 6],
    fisheye: bool,
}

impl PartialIntrinsics {
    fn read(o: &Fields, fisheye: bool) -> Result<Self, DataError> {
        // What instant-ngp's scripts write beside the model.
        let fisheye = fisheye || o.flag("is_fisheye")?;
        let n = |key| o.number(key);
        let pair = |a, b| Ok::<_, DataError>([n(a)?, n(b)?]);
        let foreign: &[&'static str] = if fisheye { &["k5", "k6", "p1", "p2"] } else { &["k4", "k5", "k6"] };
        for key in foreign {
            if let Some(v) = o.number(key)?.filter(|&v| v != 0.0) {
                return Err(DataError::CameraModel { place: o.place(key), model: format!("with {key} = {v}") });
            }
        }
        let stated = Self {
            fl: pair("fl_x", "fl_y")?,
            angle: pair("camera_angle_x", "camera_angle_y")?,
            principal: pair("cx", "cy")?,
            size: pair("w", "h")?,
            lens: [n("k1")?, n("k2")?, n("k3")?, n("p1")?, n("p2")?, n("k4")?],
            fisheye,
        };
        let positive = "it must be positive";
        for (value, key) in stated.size.iter().chain(&stated.fl).zip(["w", "h", "fl_x", "fl_y"]) {
            if let Some(v) = value.filter(|&v| v <= 0.0) {
                return Err(o.fault(key, &v.to_string(), positive, "correct the number"));
            }
        }
        for (value, key) in stated.angle.iter().zip(["camera_angle_x", "camera_angle_y"]) {
            if let Some(v) = value.filter(|v| !(*v > 0.0 && *v < std::f64::consts::PI)) {
                return Err(o.fault(
                    key,
                    &v.to_string(),
                    "a field of view lies between 0 and pi",
                    "correct the number",
                ));
            }
        }
        Ok(stated)
    }

    /// Whether the focal length or the principal point is in pixels of a size.
    fn counts_pixels(&self) -> bool {
        self.fl.iter().chain(&self.principal).any(Option::is_some)
    }

    /// The values of a frame, else the shared ones.
    fn or(self, shared: &Self) -> Self {
        fn first<const N: usize>(own: [Option<f64>; N], shared: [Option<f64>; N]) -> [Option<f64>; N] {
            std::array::from_fn(|k| own[k].or(shared[k]))
        }
        Self {
            fl: first(self.fl, shared.fl),
            angle: first(self.angle, shared.angle),
            principal: first(self.principal, shared.principal),
            size: first(self.size, shared.size),
            lens: first(self.lens, shared.lens),
            fisheye: self.fisheye,
        }
    }

    /// Missing sizes are the image's, a missing principal point is the centre, a missing focal length comes from the field
    /// of view, a missing second one equals the first.
    fn complete(&self, header: &ImageHeader, place: &Place) -> Result<Intrinsics, DataError> {
        let image = [f64::from(header.width), f64::from(header.height)];
        let size = [0, 1].map(|k| self.size[k].unwrap_or(image[k]));
        let from_angle = |k: usize| self.angle[k].map(|a: f64| 0.5 * size[k] / (0.5 * a).tan());
        let focal = [0, 1].map(|k| self.fl[k].or(from_angle(k)));
        let (Some(fx), Some(fy)) = (focal[0].or(focal[1]), focal[1].or(focal[0])) else {
            return Err(DataError::Field {
                place: place.clone(),
                value: "without focal length".into(),
                why: "neither fl_x nor camera_angle_x is given, for all frames or for this one",
                fix: "add fl_x, fl_y, cx, cy, w and h",
            });
        };
        let principal = [0, 1].map(|k| self.principal[k].unwrap_or(0.5 * size[k]));
        let [k1, k2, k3, p1, p2, k4] = self.lens.map(Option::unwrap_or_default);
        Ok(Intrinsics {
            size: size.into(),
            focal: DVec2::new(fx, fy),
            principal: principal.into(),
            lens: Lens { fisheye: self.fisheye, k1, k2, k3, k4, p1, p2, skew: 0.0 },
        })
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
    let stated = PartialIntrinsics::read(frame, shared.fisheye)?.or(shared);
    if images.is_some_and(|folder| folder.trim_end_matches('/') != "images")
        && stated.counts_pixels()
        && stated.size.contains(&None)
    {
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
        let (camera, fitted) = intrinsics.camera(&header, &listed.path, &frame.pose, &frame.place)?;
        let lens = intrinsics.lens(options.undistort, &frame.place)?;
        adjusted.count(&intrinsics, &camera, fitted, lens.as_ref());
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
