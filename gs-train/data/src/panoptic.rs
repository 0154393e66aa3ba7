//! PanopticSports as Dynamic 3D Gaussians prepared it (Luiten et al. 2024; Joo et al. 2015): a dome of static cameras.
//!
//! `train_meta.json` and `test_meta.json` hold `w`, `h` and four tables indexed `[frame][camera]`: `k`, the calibration
//! matrix; `w2c`, world to camera with OpenCV axes; `fn`, the image below `ims/`; `cam_id`. The world's unit is the metre,
//! its y axis points down. `seg/`, optional, holds masks of the same names (people and ball) as PNG:
//! [`View::mask`](super::View::mask).
//!
//! # Geometry
//! `u = k₀₀ x + k₀₁ y + k₀₂`, `v = k₁₁ y + k₁₂` of the point `(x, y)` of the plane `z = 1`, principal point off the centre,
//! pixel centres at +½: a test on the real clip compares the projected positions of a ball with its pixels.
//!
//! # Time and splits
//! Frame `n` is at `n / data.fps` seconds, 30 frames a second by default; the training span is mapped to 0..1. Cameras of
//! `train_meta.json` train, those of `test_meta.json` are held out; `data.test_cameras` holds out others.
//!
//! # Initial points
//! `init_pt_cld.npz` (table `data`, `.npy` or a `.ply` of the same name): x, y, z, r, g, b in 0..1, and a flag. Without
//! it the scene box is the dome: a cube around the point nearest to all optical axes, as large as the distance of the cameras.

use std::path::{Path, PathBuf};

use glam::{DVec2, Vec3};
use gs_core::{Time, cast};
use serde::Deserialize;
use serde_json::value::RawValue;
use serde_json::{Map, Value};

use super::error::{DataError, Place};
use super::files::{Root, read_text};
use super::frames::{Listed, locate, with_headers};
use super::geometry::focus;
use super::header::ImageHeader;
use super::intrinsics::{Adjusted, Intrinsics};
use super::json::{Fields, quote_non_finite, slices, whole};
use super::lens::Lens;
use super::options::DataOptions;
use super::pose::{Pose, from_world_to_camera};
use super::times::{Draft, Drafts, settle};
use super::{Confidence, Dataset, ImageSource, Layout, PointCloud, View, mask, ply, table};

/// The entry in [`super::LAYOUTS`].
pub(crate) const LAYOUT: Layout = Layout {
    name: "panoptic",
    about: "PanopticSports: train_meta.json and test_meta.json with ims/CAMERA/FRAME.jpg, masks in seg/",
    probe,
    open,
};

/// Frames per second of the clips.
const FPS: f64 = 30.0;
/// Largest list of cameras; 150 frames of 31 cameras have 2 MB.
const MAX_META_BYTES: u64 = 32 << 20;
/// Largest row of one table: all cameras of one frame.
const MAX_ROW_BYTES: usize = 256 << 10;
/// Shortest possible frame: its matrices alone have 67 characters.
const MIN_FRAME_BYTES: usize = 67;
/// Half side of the dome over the median distance of the cameras.
const DOME: f64 = 1.1;

fn probe(dir: &Path) -> Option<Confidence> {
    (dir.join("train_meta.json").is_file() && dir.join("ims").is_dir()).then_some(Confidence::Certain)
}

/// Reads a clip.
///
/// # Errors
/// See [`DataError`]; every error names file and field.
fn open(dir: &Path, options: &DataOptions) -> Result<Dataset, DataError> {
    options.without_images(LAYOUT.name)?;
    let root = Root::new(dir)?;
    let file = dir.join("train_meta.json");
    let mut notes = vec![
        "the background is black: the masks cut out people, but all pixels train unless data.cut_out is set".to_owned(),
    ];
    let train = drafts(&root, &file, options, &mut notes)?;
    if train.is_empty() {
        return Err(DataError::Empty { file });
    }
    let held = dir.join("test_meta.json");
    let test = if held.is_file() { drafts(&root, &held, options, &mut notes)? } else { Vec::new() };
    let masked = train.iter().chain(&test).filter(|d| d.view.mask.is_some()).count();
    notes.push(format!("{masked} of {} views have a mask in seg/", train.len() + test.len()));
    notes.push(format!("frame n is at n / {} seconds; data.fps sets another rate", options.fps.unwrap_or(FPS)));
    let settled = settle(Drafts { train, val: Vec::new(), test }, options, None)?;
    let points = points(&root, &mut notes)?;
    let bounds = if points.is_none() { Some(dome(&settled.train)) } else { None };
    Ok(Dataset { points, bounds, ..settled.dataset(dir, LAYOUT.name, false, notes) })
}

/// The file as slices of its text.
#[derive(Deserialize)]
struct Meta<'a> {
    #[serde(borrow)]
    w: Option<&'a RawValue>,
    h: Option<&'a RawValue>,
    k: Option<&'a RawValue>,
    w2c: Option<&'a RawValue>,
    #[serde(rename = "fn")]
    names: Option<&'a RawValue>,
    cam_id: Option<&'a RawValue>,
}

/// Fields of an image beside its file.
struct ImageAt {
    pose: Pose,
    intrinsics: Intrinsics,
    mask: Option<PathBuf>,
    camera: u32,
    frame: usize,
    place: Place,
}

/// The views of one file.
fn drafts(root: &Root, file: &Path, options: &DataOptions, notes: &mut Vec<String>) -> Result<Vec<Draft>, DataError> {
    let listed = with_headers(file, read(root, file)?, options, notes)?;
    let fps = options.fps.unwrap_or(FPS);
    let mut adjusted = Adjusted::default();
    let mut drafts = Vec::with_capacity(listed.len());
    for (listed, header) in listed {
        drafts.push(draft(listed, &header, fps, options, &mut adjusted)?);
    }
    notes.extend(adjusted.notes());
    Ok(drafts)
}

fn draft(
    listed: Listed<ImageAt>,
    header: &ImageHeader,
    fps: f64,
    options: &DataOptions,
    adjusted: &mut Adjusted,
) -> Result<Draft, DataError> {
    let shot = listed.rest;
    let (camera, lens) =
        adjusted.fit(&shot.intrinsics, header, &listed.path, &shot.pose, &shot.place, options.undistort)?;
    if let Some(mask) = &shot.mask {
        mask::check(mask, [header.width, header.height])?;
    }
    let name = listed.shown.strip_prefix("ims").unwrap_or(&listed.shown).with_extension("");
    let name = name.to_string_lossy().replace(['/', '\\'], "_");
    let mut view = View::new(name, camera, Time::default(), ImageSource::File(listed.path), shot.camera);
    (view.lens, view.mask) = (lens, shot.mask.map(ImageSource::File));
    Ok(Draft { view, stated: Some(shot.frame as f64 / fps), place: shot.place })
}

/// Every image of a file.
fn read(root: &Root, file: &Path) -> Result<Vec<Listed<ImageAt>>, DataError> {
    let text = read_text(file, MAX_META_BYTES)?;
    let text = quote_non_finite(&text);
    let broken = |e: serde_json::Error| {
        DataError::syntax(file, format!("line {}, column {}", e.line(), e.column()), e.to_string())
    };
    let meta: Meta = serde_json::from_str(&text).map_err(broken)?;
    let size = [side(file, "w", meta.w)?, side(file, "h", meta.h)?];
    let tables = [("k", meta.k), ("w2c", meta.w2c), ("fn", meta.names), ("cam_id", meta.cam_id)];
    let mut rows = Vec::with_capacity(tables.len());
    for (name, table) in tables {
        let table =
            table.ok_or_else(|| DataError::unexpected(file, name, "missing", "it is one of the four tables"))?;
        let frames = slices(table, text.len() / MIN_FRAME_BYTES + 1);
        rows.push(
            frames.map_err(|e| {
                DataError::unexpected(file, name, &e.to_string(), "it is a list with one entry per frame")
            })?,
        );
    }
    let frames = rows[0].len();
    for ((name, _), row) in tables.iter().zip(&rows) {
        same_length(file, name, row.len(), frames, "frames")?;
    }
    let mut listed = Vec::new();
    let columns = rows[0].iter().zip(&rows[1]).zip(rows[2].iter().zip(&rows[3]));
    for (t, ((k, w2c), (names, ids))) in columns.enumerate() {
        let (k, w2c) = (row(file, "k", t, k)?, row(file, "w2c", t, w2c)?);
        let (names, ids) = (row(file, "fn", t, names)?, row(file, "cam_id", t, ids)?);
        for (at, list) in [("w2c", &w2c), ("fn", &names), ("cam_id", &ids)] {
            same_length(file, &format!("{at}[{t}]"), list.len(), k.len(), "cameras")?;
        }
        for (c, (((k, w2c), name), id)) in k.into_iter().zip(w2c).zip(names).zip(ids).enumerate() {
            let cells = [("k", k), ("w2c", w2c), ("fn", name), ("cam_id", id)];
            listed.push(image_at(root, file, size, [t, c], cells)?);
        }
    }
    Ok(listed)
}

fn same_length(file: &Path, at: &str, got: usize, want: usize, what: &str) -> Result<(), DataError> {
    if got == want {
        return Ok(());
    }
    let value = format!("{got} {what} long, k is {want}");
    Err(DataError::unexpected(file, at, &value, "the four tables have an entry for every camera of every frame"))
}

/// Width or height.
fn side(file: &Path, name: &str, value: Option<&RawValue>) -> Result<f64, DataError> {
    let text = value.map_or("missing", RawValue::get);
    let side = text.parse::<f64>().ok().filter(|s| (1.0..=f64::from(gs_core::camera::MAX_SIDE)).contains(s));
    side.ok_or_else(|| {
        DataError::unexpected(file, name, text, "the calibration is for images of this size, 1 to 32768 pixels")
    })
}

/// One frame of a table: an entry per camera.
fn row(file: &Path, name: &str, t: usize, raw: &RawValue) -> Result<Vec<Value>, DataError> {
    let at = format!("{name}[{t}]");
    if raw.get().len() > MAX_ROW_BYTES {
        let place = Place::new(file, at);
        return Err(DataError::TooLarge { place, bytes: raw.get().len() as u64, limit: MAX_ROW_BYTES as u64 });
    }
    serde_json::from_str(raw.get())
        .map_err(|_| DataError::unexpected(file, &at, raw.get(), "it is a list with one entry per camera"))
}

/// Camera `c` of frame `t`. Its cells have their JSON paths as names, for error texts.
fn image_at(
    root: &Root,
    file: &Path,
    size: [f64; 2],
    [t, c]: [usize; 2],
    cells: [(&str, Value); 4],
) -> Result<Listed<ImageAt>, DataError> {
    let path = |table: &str| format!("{table}[{t}][{c}]");
    let map: Map<String, Value> = cells.into_iter().map(|(table, value)| (path(table), value)).collect();
    let fields = Fields::new(file, "", &map);
    let name = path("fn");
    let written = format!("ims/{}", fields.required_text(&name)?);
    let (shown, image) = locate(root, &written, &fields.place(&name))?;
    let id = path("cam_id");
    let camera = fields.required_number(&id)?;
    let why = "cameras have whole numbers from 0 on";
    let camera =
        whole(camera, 0..=u32::MAX).ok_or_else(|| fields.fault(&id, &camera.to_string(), why, "correct the number"))?;
    let pose = from_world_to_camera(&fields.matrix(&path("w2c"))?, &fields.place(&path("w2c")))?;
    let rest = ImageAt {
        pose,
        intrinsics: intrinsics(&fields, &path("k"), size)?,
        mask: mask_of(root, &shown)?,
        camera,
        frame: t,
        place: fields.place(&path("k")),
    };
    Ok(Listed { shown, path: image, rest })
}

fn intrinsics(fields: &Fields, key: &str, size: [f64; 2]) -> Result<Intrinsics, DataError> {
    let k = fields.rows3(key)?;
    let bottom = [k[1][0], k[2][0], k[2][1], k[2][2]];
    if bottom != [0.0, 0.0, 0.0, 1.0] || k[0][0] <= 0.0 || k[1][1] <= 0.0 {
        let why = "a calibration matrix is [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with positive focal lengths";
        return Err(fields.fault(key, &format!("{k:?}"), why, "export the calibration again"));
    }
    // The skew acts on the distorted y of the plane z = 1: s y = fx · skew · y.
    let lens = Lens { skew: k[0][1] / k[0][0], ..Lens::default() };
    Ok(Intrinsics {
        size: size.into(),
        focal: DVec2::new(k[0][0], k[1][1]),
        principal: DVec2::new(k[0][2], k[1][2]),
        lens,
    })
}

/// The mask of the same name below `seg/`, if the file exists.
fn mask_of(root: &Root, shown: &Path) -> Result<Option<PathBuf>, DataError> {
    let Ok(name) = shown.strip_prefix("ims") else { return Ok(None) };
    let written = Path::new("seg").join(name).with_extension("png");
    let file = root.resolve(&written.to_string_lossy(), &Place::new(root.dir(), written.to_string_lossy()))?;
    Ok(file.is_file().then_some(file))
}

/// The scene box around the dome.
fn dome(train: &[View]) -> [Vec3; 2] {
    let centre = focus(train);
    let mut away: Vec<f64> = train.iter().map(|v| (v.camera.position() - centre).length()).collect();
    away.sort_by(f64::total_cmp);
    let half = Vec3::splat(cast::to_f32((DOME * away[away.len() / 2]).max(f64::from(f32::MIN_POSITIVE))));
    [centre.as_vec3() - half, centre.as_vec3() + half]
}

/// The initial points of the capture, if it has them.
fn points(root: &Root, notes: &mut Vec<String>) -> Result<Option<PointCloud>, DataError> {
    for name in ["init_pt_cld.npz", "init_pt_cld.npy", "init_pt_cld.ply"] {
        let file = root.resolve(name, &Place::new(root.dir(), name))?;
        if file.is_file() {
            let points = if name.ends_with("ply") { ply::read_points(&file)? } else { table::read_coloured(&file, 7)? };
            notes.push(format!("initial points come from {name}: {}", points.positions.len()));
            return Ok(Some(points));
        }
    }
    notes.push("there is no init_pt_cld: training starts from points in the dome of cameras".into());
    Ok(None)
}
