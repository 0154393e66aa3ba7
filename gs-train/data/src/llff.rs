//! Forward-facing rigs with `poses_bounds.npy` (LLFF, Mildenhall et al. 2019), and videos of such rigs (Neu3D/DyNeRF, Li et
//! al. 2022).
//!
//! A row of `poses_bounds.npy` has 17 numbers: a row-major `3 × 5` matrix `[R | c | (H, W, f)]`, camera to world, then the
//! nearest and the farthest depth. The columns of `R` are down, right and backwards, so the OpenCV axes (right, down, forward) are
//! `[R₁, R₀, −R₂]`. Pixels are square, the principal point is the centre, rows follow the sorted names of cameras.
//!
//! * **Videos**: folders `camNN` with frames in `camNN/images` or directly inside, all of one count and with the same names.
//!   The first camera is held out, the others train. Frame `k` of `n` is at `t = k/n`, as Li et al. normalise it;
//!   `data.time_range=0..n−1` (in frames, or in seconds where `data.fps` is given) makes the last frame 1. For `camNN.mp4`
//!   without frames the error names the command that extracts them.
//! * **Images**: one image per row in `images`, `images_2`, `images_4`, `images_8` (or `data.images`), by sorted name;
//!   static unless `data.time_from` says otherwise, every `data.hold_out`-th held out.
//!
//! Images of another size than `W × H` rescale the intrinsics; `data.scale=0.5` gives the usual half resolution.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec2, DVec3};
use gs_core::{Time, cast};

use super::error::{DataError, Place};
use super::files::Root;
use super::frames::{Listed, image_folder, name_views, with_headers};
use super::header::ImageHeader;
use super::intrinsics::{Adjusted, Intrinsics, hold_out, hold_out_note};
use super::lens::Lens;
use super::options::{DataOptions, TimeFrom, TimeRange};
use super::pose::{Pose, from_axes};
use super::times::{Draft, Drafts, settle};
use super::{Confidence, Dataset, ImageSource, Layout, View, frustum, ply, table};

/// The entry in [`super::LAYOUTS`].
pub(crate) const LAYOUT: Layout = Layout {
    name: "llff",
    about: "LLFF and Neu3D/DyNeRF: poses_bounds.npy with an image folder, or with frames in camNN/images",
    probe,
    open,
};

const POSES: &str = "poses_bounds.npy";
/// Numbers per row of `poses_bounds.npy`.
const WIDTH: usize = 17;
const IMAGE_FOLDERS: [&str; 4] = ["images", "images_2", "images_4", "images_8"];
/// Initial points of prepared Neu3D scenes.
const POINTS: &str = "points3D_downsample2.ply";

fn probe(dir: &Path) -> Option<Confidence> {
    let has_poses = dir.join(POSES).is_file();
    let is_rig = || camera_names(dir).is_ok_and(|names| !names.is_empty());
    has_poses.then(|| if is_rig() { Confidence::Certain } else { Confidence::Likely })
}

/// A row of `poses_bounds.npy`.
struct Row {
    pose: Pose,
    intrinsics: Intrinsics,
    depths: [f64; 2],
    place: Place,
}

/// Row and frame of an image.
struct ImageAt {
    row: usize,
    frame: usize,
}

/// Reads a scene.
///
/// # Errors
/// See [`DataError`]; every error names file and row.
fn open(dir: &Path, options: &DataOptions) -> Result<Dataset, DataError> {
    let root = Root::new(dir)?;
    let file = dir.join(POSES);
    let rows = read_poses(&file)?;
    let cameras = camera_names(dir)?;
    let mut notes = Vec::new();
    let (listed, frames) = if cameras.is_empty() {
        options.without_fps(LAYOUT.name)?;
        (image_per_row(&root, rows.len(), options, &mut notes)?, 1)
    } else {
        videos(&root, &rows, &cameras, options, &mut notes)?
    };
    let is_rig = !cameras.is_empty();
    let listed = with_headers(&file, listed, options, &mut notes)?;
    let has_alpha = listed.iter().any(|(_, h)| h.has_alpha);
    // Without a rate the clock counts frames.
    let fps = options.fps.unwrap_or(1.0);
    let drafts = drafts(listed, &rows, (frames > 1).then_some(fps), &mut notes)?;
    let drafts = if is_rig { split_rig(drafts, &mut notes) } else { split_by_name(drafts, options, &mut notes) };
    if drafts.train.is_empty() {
        return Err(DataError::Empty { file });
    }
    let settled = settle(drafts, &clock(options, frames, fps, &mut notes), None)?;
    let points = ply::initial_points(&root, POINTS, &mut notes)?;
    let depths = |v: &View| rows[v.camera_id as usize].depths;
    let seen = || frustum::bounds(settled.train.iter().map(|v| (&v.camera, depths(v))));
    let bounds = if points.is_none() { seen() } else { None };
    if bounds.is_some() {
        notes.push("the scene box holds all view frusta between the nearest and farthest depth".into());
    }
    Ok(Dataset { points, bounds, ..settled.dataset(dir, LAYOUT.name, has_alpha, notes) })
}

fn read_poses(file: &Path) -> Result<Vec<Row>, DataError> {
    let values = table::read_rows(file, WIDTH)?;
    values.chunks_exact(WIDTH).enumerate().map(|(i, v)| read_row(file, i, v)).collect()
}

fn read_row(file: &Path, i: usize, v: &[f64]) -> Result<Row, DataError> {
    let place = Place::new(file, format!("row {i}"));
    let column = |j: usize| DVec3::new(v[j], v[5 + j], v[10 + j]);
    let (height, width, focal) = (v[4], v[9], v[14]);
    let fault = |value: String, why| DataError::Field {
        place: place.clone(),
        value,
        why,
        fix: "export poses_bounds.npy again",
    };
    let side = |s: f64| s >= 1.0 && s <= f64::from(gs_core::camera::MAX_SIDE);
    if !side(height) || !side(width) {
        return Err(fault(format!("of size {width}x{height}"), "sides lie between 1 and 32768 pixels"));
    }
    if focal <= 0.0 {
        return Err(fault(format!("of focal length {focal}"), "it must be positive"));
    }
    let axes = DMat3::from_cols(column(1), column(0), -column(2));
    let size = DVec2::new(width, height);
    Ok(Row {
        pose: from_axes(axes, column(3), &place)?,
        intrinsics: Intrinsics { size, focal: DVec2::splat(focal), principal: 0.5 * size, lens: Lens::default() },
        depths: [v[15], v[16]],
        place,
    })
}

/// Sorted names of cameras: folders `cam…` and files `cam….mp4`.
fn camera_names(dir: &Path) -> Result<BTreeSet<String>, DataError> {
    let names = entries(dir)?.into_iter().filter_map(|name| match name.strip_suffix(".mp4") {
        Some(stem) => Some(stem.to_string()),
        None => dir.join(&name).is_dir().then_some(name),
    });
    Ok(names.filter(|n| n.starts_with("cam") && n[3..].parse::<u32>().is_ok()).collect())
}

/// Names of the entries of a folder; names that are not UTF-8 are left out.
fn entries(dir: &Path) -> Result<Vec<String>, DataError> {
    let failed = |e| DataError::read(dir, e);
    let mut names = Vec::new();
    for entry in std::fs::read_dir(dir).map_err(failed)? {
        names.extend(entry.map_err(failed)?.file_name().into_string().ok());
    }
    Ok(names)
}

/// Images of a folder, sorted by name.
fn images(dir: &Path) -> Result<Vec<String>, DataError> {
    let is_image = |name: &String| {
        let extension = Path::new(name).extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
        extension.is_some_and(|e| ["png", "jpg", "jpeg"].contains(&e.as_str()))
    };
    let mut names: Vec<String> = entries(dir)?.into_iter().filter(is_image).collect();
    names.sort();
    Ok(names)
}

fn listed(root: &Root, folder: &str, name: &str, rest: ImageAt) -> Result<Listed<ImageAt>, DataError> {
    let shown = format!("{folder}/{name}");
    let path = root.resolve(&shown, &Place::new(root.dir(), shown.as_str()))?;
    Ok(Listed { shown: shown.into(), path, rest })
}

/// Checks that a count is that of the rows.
fn same_count(file: PathBuf, what: &str, count: usize, rows: usize) -> Result<(), DataError> {
    if count == rows {
        return Ok(());
    }
    Err(DataError::Field {
        place: Place::new(&file, POSES),
        value: format!("{rows} rows for {count} {what}"),
        why: "rows belong to sorted names one by one, so a missing one would shift all others",
        fix: "add what is missing, or remove its row",
    })
}

/// One image per row.
fn image_per_row(
    root: &Root,
    rows: usize,
    options: &DataOptions,
    notes: &mut Vec<String>,
) -> Result<Vec<Listed<ImageAt>>, DataError> {
    let missing = format!("there is {POSES}, but neither folders camNN nor an image folder");
    let folder = image_folder(root, options, &IMAGE_FOLDERS, &missing)?;
    let dir = root.resolve(&folder, &Place::new(root.dir(), "data.images"))?;
    let names = images(&dir)?;
    same_count(root.dir().to_path_buf(), &format!("images in \"{folder}\""), names.len(), rows)?;
    notes.push(format!("images come from \"{folder}\", in order of names"));
    names.iter().enumerate().map(|(row, name)| listed(root, &folder, name, ImageAt { row, frame: 0 })).collect()
}

/// All frames of all cameras, and how many each camera has.
fn videos(
    root: &Root,
    rows: &[Row],
    cameras: &BTreeSet<String>,
    options: &DataOptions,
    notes: &mut Vec<String>,
) -> Result<(Vec<Listed<ImageAt>>, usize), DataError> {
    same_count(root.dir().to_path_buf(), "cameras", cameras.len(), rows.len())?;
    let mut all = Vec::new();
    let mut first: Option<Vec<String>> = None;
    for (row, camera) in cameras.iter().enumerate() {
        let Some((folder, names)) = frames_of(root, camera, options)? else {
            return Err(unextracted(root, cameras.len(), rows));
        };
        let stems: Vec<String> = names.iter().map(|n| n.split('.').next().unwrap_or_default().to_string()).collect();
        let stems_wanted = first.get_or_insert_with(|| stems.clone());
        if *stems_wanted != stems {
            return Err(DataError::Field {
                place: Place::new(&root.dir().join(&folder), camera.as_str()),
                value: format!(
                    "{} frames that are not named as the {} of the first camera",
                    stems.len(),
                    stems_wanted.len()
                ),
                why: "frames of one number have one timestamp",
                fix: "extract all videos again with the same command",
            });
        }
        for (frame, name) in names.iter().enumerate() {
            all.push(listed(root, &folder, name, ImageAt { row, frame })?);
        }
    }
    let frames = first.map_or(0, |names| names.len());
    notes.push(format!("{} cameras with {frames} frames each", cameras.len()));
    Ok((all, frames))
}

/// Folder and names of a camera's frames, if there are any.
fn frames_of(root: &Root, camera: &str, options: &DataOptions) -> Result<Option<(String, Vec<String>)>, DataError> {
    let folders = match &options.images {
        Some(asked) => vec![format!("{camera}/{asked}")],
        None => vec![format!("{camera}/images"), camera.to_string()],
    };
    for folder in folders {
        let dir = root.resolve(&folder, &Place::new(root.dir(), folder.as_str()))?;
        let names = if dir.is_dir() { images(&dir)? } else { Vec::new() };
        if !names.is_empty() {
            return Ok(Some((folder, names)));
        }
    }
    if let Some(value) = options.images.clone() {
        let rule = format!("there are no images in {camera}/{value}");
        return Err(DataError::Option { name: "data.images", value, rule });
    }
    Ok(None)
}

fn unextracted(root: &Root, videos: usize, rows: &[Row]) -> DataError {
    let half = rows.first().map_or(DVec2::ONE, |r| (r.intrinsics.size * 0.5).round());
    let command = format!(
        "for v in cam*.mp4; do mkdir -p \"${{v%.mp4}}/images\" && ffmpeg -i \"$v\" -vf scale={}:{} -start_number 0 \
         \"${{v%.mp4}}/images/%04d.png\"; done",
        half.x, half.y
    );
    DataError::Video { folder: root.dir().to_path_buf(), videos, command }
}

/// Views whose times are frame numbers over `fps`; without a rate they have none.
fn drafts(
    listed: Vec<(Listed<ImageAt>, ImageHeader)>,
    rows: &[Row],
    fps: Option<f64>,
    notes: &mut Vec<String>,
) -> Result<Vec<Draft>, DataError> {
    let shown: Vec<PathBuf> = listed.iter().map(|(l, _)| l.shown.clone()).collect();
    let mut adjusted = Adjusted::default();
    let mut drafts = Vec::with_capacity(listed.len());
    for (listed, header) in listed {
        let (shot, row) = (&listed.rest, &rows[listed.rest.row]);
        let (camera, _) = adjusted.fit(&row.intrinsics, &header, &listed.path, &row.pose, &row.place, true)?;
        let view = View::new("", camera, Time::default(), ImageSource::File(listed.path), cast::to_u32(shot.row));
        drafts.push(Draft { view, stated: fps.map(|rate| shot.frame as f64 / rate), place: row.place.clone() });
    }
    notes.extend(adjusted.notes());
    name_views(&mut drafts, &shown);
    Ok(drafts)
}

/// Holds out the first camera.
fn split_rig(drafts: Vec<Draft>, notes: &mut Vec<String>) -> Drafts {
    if drafts.iter().all(|d| d.view.camera_id == 0) {
        notes.push("there is one camera: it trains, none is held out".into());
        return Drafts { train: drafts, ..Drafts::default() };
    }
    notes.push("the first camera is held out, the others train".into());
    let (test, train) = drafts.into_iter().partition(|d| d.view.camera_id == 0);
    Drafts { train, val: Vec::new(), test }
}

fn split_by_name(drafts: Vec<Draft>, options: &DataOptions, notes: &mut Vec<String>) -> Drafts {
    let names: Vec<String> = drafts.iter().map(|d| d.view.name.clone()).collect();
    let (_, held) = hold_out(&names, options.hold_out);
    notes.push(hold_out_note(options.hold_out, held.len()));
    let mut split = Drafts::default();
    for (i, draft) in drafts.into_iter().enumerate() {
        if held.contains(&i) { split.test.push(draft) } else { split.train.push(draft) }
    }
    split
}

/// The options that put frame `k` of `n` at time `k/n`, unless the user asks for another mapping.
fn clock(options: &DataOptions, frames: usize, fps: f64, notes: &mut Vec<String>) -> DataOptions {
    if frames <= 1 || options.time_from == TimeFrom::Name {
        return options.clone();
    }
    if options.time_range.is_none() {
        notes.push(format!("frame k of {frames} is at time k/{frames}; data.time_range sets another span"));
    }
    let whole = TimeRange { start: 0.0, end: frames as f64 / fps };
    let time_range = options.time_range.or(Some(whole));
    // Frames are numbered by the order of their names already.
    DataOptions { time_from: TimeFrom::File, time_range, ..options.clone() }
}
