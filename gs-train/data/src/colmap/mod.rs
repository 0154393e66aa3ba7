//! COLMAP sparse models, text and binary (Schönberger and Frahm 2016; format: COLMAP documentation, "Output Format").
//!
//! `cameras`, `images` and `points3D` lie in `sparse/0`, `sparse`, `colmap/sparse/0` or the folder itself. Poses are world
//! to camera as quaternion `(w, x, y, z)` and translation with OpenCV axes, pixel centres at +½. Models
//! SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE and OPENCV_FISHEYE are
//! read, others refused by name. A model has no times: it is static unless `data.time_from` says otherwise. Renumbered images are paired in order of number
//! (`numbered.rs`), with a note.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use glam::{DVec2, DVec3};
use gs_core::Time;
#[cfg(feature = "avatar")]
use gs_core::cast;

#[cfg(feature = "avatar")]
use super::avatar::rig::RigCamera;
use super::error::{DataError, Place};
use super::files::Root;
use super::frames::{Listed, image_folder, name_views, with_headers};
use super::header::ImageHeader;
use super::intrinsics::{Adjusted, Intrinsics, hold_out, hold_out_note};
use super::lens::Lens;
use super::options::{DataOptions, TimeFrom, TimeRange};
use super::pose::{Pose, from_quaternion};
use super::times::{Draft, Drafts, Settled, settle};
use super::{Confidence, Dataset, ImageSource, Layout, PointCloud, View};

mod binary;
mod numbered;
mod points;
mod reconstruction;
mod text;

use points::SparsePoints;
pub use reconstruction::{Reconstruction, Registered};

/// The entry in [`super::LAYOUTS`].
pub(crate) const LAYOUT: Layout =
    Layout { name: "colmap", about: "COLMAP sparse model (text or binary) with an image folder", probe, open };

/// The entry of the layout of Nvidia's dynamic scenes.
pub(crate) const NVIDIA: Layout = Layout {
    name: "nvidia",
    about: "Nvidia's dynamic scenes as one moving camera: a COLMAP model in dense/sparse, frames in dense/images",
    probe: probe_dense,
    open: open_dense,
};

const MODEL_FOLDERS: [&str; 4] = ["sparse/0", "sparse", "colmap/sparse/0", "."];
const IMAGE_FOLDERS: [&str; 5] = ["images", "images_2", "images_4", "images_8", "input"];
const DENSE_MODEL_FOLDERS: [&str; 2] = ["dense/sparse", "dense/sparse/0"];
const DENSE_IMAGE_FOLDERS: [&str; 3] = ["dense/images", "dense/images_2", "dense/images_4"];
const EXTENSIONS: [&str; 6] = ["png", "jpg", "jpeg", "PNG", "JPG", "JPEG"];

fn probe(dir: &Path) -> Option<Confidence> {
    model_folder(dir, &MODEL_FOLDERS).map(|_| Confidence::Likely)
}

fn probe_dense(dir: &Path) -> Option<Confidence> {
    model_folder(dir, &DENSE_MODEL_FOLDERS).map(|_| Confidence::Likely)
}

/// The model's folder and whether it is binary.
fn model_folder(dir: &Path, folders: &[&str]) -> Option<(PathBuf, bool)> {
    let all = |folder: &Path, ext: &str| {
        ["cameras", "images"].iter().all(|name| folder.join(format!("{name}.{ext}")).is_file())
    };
    folders.iter().map(|f| dir.join(f)).find_map(|folder| {
        if all(&folder, "bin") { Some((folder, true)) } else { all(&folder, "txt").then_some((folder, false)) }
    })
}

/// A row of `images`.
struct ImageRow {
    /// Its index, counted from 0.
    row: usize,
    /// Its number in the model, which tracks of points name.
    id: u32,
    name: String,
    quat: [f64; 4],
    translation: DVec3,
    camera: u32,
}

/// The camera models that are read.
const MODELS: [&str; 8] = [
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "OPENCV_FISHEYE",
];

/// A camera's model and parameters turned into intrinsics.
fn intrinsics(model: &str, size: [u64; 2], params: &[f64], place: &Place) -> Result<Intrinsics, DataError> {
    let field = |at: &str, value: String, why| DataError::Field {
        place: Place::new(&place.file, format!("{}.{at}", place.at)),
        value,
        why,
        fix: "export the model again",
    };
    if size.iter().any(|&s| s == 0 || s > u64::from(gs_core::camera::MAX_SIDE)) {
        return Err(field("size", format!("{}x{}", size[0], size[1]), "sides lie between 1 and 32768 pixels"));
    }
    if let Some(k) = params.iter().position(|v| !v.is_finite()) {
        return Err(field(&format!("params[{k}]"), params[k].to_string(), "it must be a finite number"));
    }
    let fisheye = Lens { fisheye: true, ..Lens::default() };
    let (focal, principal, lens) = match (model, params) {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => ([f, f], [cx, cy], Lens::default()),
        ("PINHOLE", &[fx, fy, cx, cy]) => ([fx, fy], [cx, cy], Lens::default()),
        ("SIMPLE_RADIAL", &[f, cx, cy, k1]) => ([f, f], [cx, cy], Lens { k1, ..Lens::default() }),
        ("RADIAL", &[f, cx, cy, k1, k2]) => ([f, f], [cx, cy], Lens { k1, k2, ..Lens::default() }),
        ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
            ([fx, fy], [cx, cy], Lens { k1, k2, p1, p2, ..Lens::default() })
        }
        ("SIMPLE_RADIAL_FISHEYE", &[f, cx, cy, k1]) => ([f, f], [cx, cy], Lens { k1, ..fisheye }),
        ("RADIAL_FISHEYE", &[f, cx, cy, k1, k2]) => ([f, f], [cx, cy], Lens { k1, k2, ..fisheye }),
        ("OPENCV_FISHEYE", &[fx, fy, cx, cy, k1, k2, k3, k4]) => {
            ([fx, fy], [cx, cy], Lens { k1, k2, k3, k4, ..fisheye })
        }
        (model, _) if MODELS.contains(&model) => {
            let value = format!("{} numbers", params.len());
            return Err(field("params", value, "the camera model has another number of parameters"));
        }
        _ => return Err(DataError::CameraModel { place: place.clone(), model: model.into() }),
    };
    let size = DVec2::new(size[0] as f64, size[1] as f64);
    Ok(Intrinsics { size, focal: focal.into(), principal: principal.into(), lens })
}

/// Reads a model.
///
/// # Errors
/// See [`DataError`]; every error names file and row.
fn open(dir: &Path, options: &DataOptions) -> Result<Dataset, DataError> {
    options.without_fps(LAYOUT.name)?;
    let root = Root::new(dir)?;
    let mut notes = Vec::new();
    let model = Model::read(dir, &MODEL_FOLDERS)?;
    let (drafts, has_alpha, ids) = model.drafts(&root, &IMAGE_FOLDERS, options, &mut notes)?;
    let settled = settle(drafts, options, None)?;
    let points = points_for(model.points, &settled, &ids, &mut notes);
    Ok(Dataset { points, ..settled.dataset(dir, LAYOUT.name, has_alpha, notes) })
}

/// Reads frames of one moving camera (Yoon et al. 2020, one camera of the rig per timestamp): image `k` of `n`, in order of
/// names, is at time `k / (n − 1)`, unless `data.time_from` asks for names.
///
/// # Errors
/// As [`open`].
fn open_dense(dir: &Path, options: &DataOptions) -> Result<Dataset, DataError> {
    let root = Root::new(dir)?;
    let mut notes = Vec::new();
    let model = Model::read(dir, &DENSE_MODEL_FOLDERS)?;
    let (drafts, has_alpha, ids) = model.drafts(&root, &DENSE_IMAGE_FOLDERS, options, &mut notes)?;
    let mut timed = options.clone();
    if timed.time_from == TimeFrom::File {
        let images = drafts.train.len() + drafts.test.len();
        timed.time_from = TimeFrom::Order;
        if images > 1 && timed.time_range.is_none() {
            timed.time_range = Some(TimeRange { start: 0.0, end: images as f64 - 1.0 });
        }
        notes.push(format!("image k of {images}, in order of names, is at time k/{}", images.max(2) - 1));
    }
    let settled = settle(drafts, &timed, None)?;
    let points = points_for(model.points, &settled, &ids, &mut notes);
    Ok(Dataset { points, ..settled.dataset(dir, NVIDIA.name, has_alpha, notes) })
}

/// The points of a model for a data set, by the numbers of the images of files; none where there are none.
fn points_for(
    points: Option<SparsePoints>,
    settled: &Settled,
    ids: &BTreeMap<PathBuf, u32>,
    notes: &mut Vec<String>,
) -> Option<PointCloud> {
    let points = points?;
    if settled.extrapolate.is_empty() {
        return Some(points.cloud);
    }
    let (all, has_tracks) = (points.cloud.positions.len(), points.has_tracks());
    let known = points.known_to(&settled.train, |file| ids.get(file).copied());
    let left_out = all - known.positions.len();
    notes.push(match has_tracks {
        true => format!(
            "{left_out} of {all} points of the model are left out: no training image before data.time_boundary saw them"
        ),
        false => "the model does not say which images saw its points: those of images after data.time_boundary are among them"
            .to_owned(),
    });
    (!known.positions.is_empty()).then_some(known)
}

/// The points of the COLMAP model in the folder of a data set of any layout, where there is one. Where the end of the sequence is held out,
/// those that training images saw, which the model knows by the ends of their paths.
///
/// # Errors
/// See [`DataError`].
pub(super) fn points_beside(data: &Dataset) -> Result<Option<PointCloud>, DataError> {
    for folders in [&MODEL_FOLDERS[..], &DENSE_MODEL_FOLDERS] {
        if model_folder(&data.root, folders).is_some() {
            let Model { rows, points, .. } = Model::read(&data.root, folders)?;
            let Some(points) = points else { return Ok(None) };
            if data.extrapolate.is_empty() {
                return Ok(Some(points.cloud));
            }
            let ids: BTreeMap<&Path, u32> = rows.iter().map(|row| (Path::new(&row.name), row.id)).collect();
            let id = |file: &Path| {
                let parts: Vec<&OsStr> = file.iter().collect();
                (0..parts.len()).rev().find_map(|k| ids.get(&*parts[k..].iter().collect::<PathBuf>()).copied())
            };
            return Ok(Some(points.known_to(&data.train, id)));
        }
    }
    Ok(None)
}

/// The cameras of a model of a rig, one image each, by the names of the images.
///
/// # Errors
/// `data.layout` if there is no model; those of reading it.
#[cfg(feature = "avatar")]
pub(crate) fn rig(dir: &Path) -> Result<Vec<RigCamera>, DataError> {
    let model = Model::read(dir, &MODEL_FOLDERS)?;
    let camera = |row: &ImageRow| {
        let at = |field: &str| Place::new(&model.images_file, format!("images[{}].{field}", row.row));
        let Pose { rotation, translation } = pose(row, &at)?;
        let Intrinsics { size, focal, principal, lens } = *model.intrinsics(row, &at)?;
        let Lens { fisheye, k1, k2, k3, p1, p2, skew, .. } = lens;
        if fisheye {
            let model = "of a fisheye lens (avatar folders keep five coefficients of OpenCV)".to_owned();
            return Err(DataError::CameraModel { place: at("camera"), model });
        }
        Ok(RigCamera {
            name: row.name.clone(),
            size: Some([size.x, size.y].map(|side| cast::to_u32(cast::to_usize(side)))),
            k: [focal.x, skew * focal.x, principal.x, 0.0, focal.y, principal.y, 0.0, 0.0, 1.0],
            dist: [k1, k2, p1, p2, k3],
            rotation,
            translation,
            integer_centres: false,
        })
    };
    model.rows.iter().map(camera).collect()
}

/// The three files of a model.
struct Model {
    cameras: BTreeMap<u32, Intrinsics>,
    rows: Vec<ImageRow>,
    points: Option<SparsePoints>,
    images_file: PathBuf,
}

impl Model {
    fn read(dir: &Path, folders: &[&str]) -> Result<Self, DataError> {
        let (folder, is_binary) = model_folder(dir, folders).ok_or_else(|| DataError::Layout {
            path: dir.to_path_buf(),
            looked_for: format!("looked for cameras and images, .bin or .txt, in {}", folders.join(", ")),
        })?;
        let file = |name: &str| folder.join(format!("{name}.{}", if is_binary { "bin" } else { "txt" }));
        let (cameras_file, images_file, points_file) = (file("cameras"), file("images"), file("points3D"));
        let (cameras, rows) = if is_binary {
            (binary::cameras(&cameras_file)?, binary::images(&images_file)?)
        } else {
            (text::cameras(&cameras_file)?, text::images(&images_file)?)
        };
        let points = match (points_file.is_file(), is_binary) {
            (false, _) => None,
            (true, true) => Some(binary::points(&points_file)?),
            (true, false) => Some(text::points(&points_file)?),
        };
        Ok(Self { cameras, rows, points, images_file })
    }

    /// The intrinsics of an image.
    fn intrinsics(&self, row: &ImageRow, at: &dyn Fn(&str) -> Place) -> Result<&Intrinsics, DataError> {
        self.cameras.get(&row.camera).ok_or_else(|| DataError::Field {
            place: at("camera_id"),
            value: format!("{}, which cameras does not list", row.camera),
            why: "the image's intrinsics are unknown",
            fix: "export cameras and images together",
        })
    }

    /// The views, split, without times, whether their images carry alpha, and the number of the image of each file.
    fn drafts(
        &self,
        root: &Root,
        image_folders: &[&str],
        options: &DataOptions,
        notes: &mut Vec<String>,
    ) -> Result<(Drafts, bool, BTreeMap<PathBuf, u32>), DataError> {
        let folder = image_folder(root, options, image_folders, "there is a COLMAP model, but no image folder")?;
        let listed = find_images(root, &self.images_file, &self.rows, &folder, notes)?;
        let listed = with_headers(&self.images_file, listed, options, notes)?;
        let has_alpha = listed.iter().any(|(_, h)| h.has_alpha);
        let ids = listed.iter().map(|(l, _)| (l.path.clone(), l.rest.id)).collect();
        let drafts = split(self.listed(listed, options, notes)?, options, notes);
        if drafts.train.is_empty() {
            return Err(DataError::Empty { file: self.images_file.clone() });
        }
        Ok((drafts, has_alpha, ids))
    }

    /// The views of listed images.
    fn listed(
        &self,
        listed: Vec<(Listed<&ImageRow>, ImageHeader)>,
        options: &DataOptions,
        notes: &mut Vec<String>,
    ) -> Result<Vec<Draft>, DataError> {
        let shown: Vec<PathBuf> = listed.iter().map(|(l, _)| l.shown.clone()).collect();
        let mut adjusted = Adjusted::default();
        let mut drafts = Vec::with_capacity(listed.len());
        for (listed, header) in listed {
            let row = listed.rest;
            let at = |field: &str| Place::new(&self.images_file, format!("images[{}].{field}", row.row));
            let (pose, intrinsics) = (pose(row, &at)?, self.intrinsics(row, &at)?);
            let (camera, lens) =
                adjusted.fit(intrinsics, &header, &listed.path, &pose, &at("camera"), options.undistort)?;
            let mut view = View::new("", camera, Time::default(), ImageSource::File(listed.path), row.camera);
            view.lens = lens;
            drafts.push(Draft { view, stated: None, place: at("name") });
        }
        notes.extend(adjusted.notes());
        name_views(&mut drafts, &shown);
        Ok(drafts)
    }
}

fn find_images<'a>(
    root: &Root,
    images_file: &Path,
    rows: &'a [ImageRow],
    folder: &str,
    notes: &mut Vec<String>,
) -> Result<Vec<Listed<&'a ImageRow>>, DataError> {
    notes.push(format!("images come from \"{folder}\""));
    let paired = numbered::pairing(&root.resolve(folder, &Place::new(root.dir(), "data.images"))?, rows)?;
    notes.extend(paired.as_ref().map(|p| numbered::note(folder, p)));
    let mut renamed = 0;
    let mut listed = Vec::with_capacity(rows.len());
    for row in rows {
        let place = Place::new(images_file, format!("images[{}].name", row.row));
        let name = paired.as_ref().and_then(|p| p.get(&row.name)).unwrap_or(&row.name);
        let written = PathBuf::from(format!("{folder}/{name}"));
        let resolve = |p: &Path| root.resolve(&p.to_string_lossy(), &place);
        let mut path = resolve(&written)?;
        if !path.exists() {
            // Reduced copies often change the format: 0001.jpg becomes images_4/0001.png.
            let other = EXTENSIONS.iter().map(|e| written.with_extension(e)).find(|p| root.dir().join(p).exists());
            if let Some(other) = other {
                path = resolve(&other)?;
                renamed += 1;
            }
        }
        listed.push(Listed { shown: written, path, rest: row });
    }
    if renamed > 0 {
        notes.push(format!("{renamed} images have another extension than the model says"));
    }
    Ok(listed)
}

fn pose(row: &ImageRow, at: &dyn Fn(&str) -> Place) -> Result<Pose, DataError> {
    let named = ["qw", "qx", "qy", "qz", "tx", "ty", "tz"].into_iter();
    let values = row.quat.iter().copied().chain(row.translation.to_array());
    if let Some((field, value)) = named.zip(values).find(|(_, v)| !v.is_finite()) {
        return Err(DataError::Field {
            place: at(field),
            value: value.to_string(),
            why: "it must be a finite number",
            fix: "remove the image from the model, or reconstruct again",
        });
    }
    from_quaternion(row.quat, row.translation, &at("qvec"))
}

fn split(drafts: Vec<Draft>, options: &DataOptions, notes: &mut Vec<String>) -> Drafts {
    let names: Vec<String> = drafts.iter().map(|d| d.view.name.clone()).collect();
    let (train, test) = hold_out(&names, options.hold_out);
    notes.push(hold_out_note(options.hold_out, test.len()));
    let mut slots: Vec<Option<Draft>> = drafts.into_iter().map(Some).collect();
    let mut take = |list: Vec<usize>| list.into_iter().filter_map(|i| slots[i].take()).collect();
    Drafts { train: take(train), val: Vec::new(), test: take(test) }
}
