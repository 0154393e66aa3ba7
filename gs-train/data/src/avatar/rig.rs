//! Cameras of a rig from files of other programs, written as `cameras.json` of the layout `avatar`.
//!
//! * OpenCV's YAML in two files, as EasyMocap writes them: `intri.yml` with `names`, `K_NAME` and `dist_NAME` (or `D_NAME`; also
//!   `H_NAME`, `W_NAME`), and beside it `extri.yml` with `Rot_NAME` (3×3) or `R_NAME` (Rodrigues) and `T_NAME`: world to camera, OpenCV
//!   axes. The centre of the first pixel is at 0.
//! * A COLMAP model with one image per camera; its scale is arbitrary.

use super::layout::Role;
use crate::colmap;
use crate::error::{DataError, Place};
use crate::header;
use glam::{DMat3, DQuat, DVec3};
use gs_core::cast;
use gs_core::io::write_file;
use serde_json::json;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

mod opencv;

use opencv::Storage;

/// Conditioning cameras where none are named.
const CONDITIONING: usize = 4;

/// A camera of a rig.
#[derive(Clone, Debug, PartialEq)]
pub struct RigCamera {
    /// Its name in the file.
    pub name: String,
    /// Width and height of its images, pixels; none where the file does not say.
    pub size: Option<[u32; 2]>,
    /// Calibration matrix, row by row, pixels.
    pub k: [f64; 9],
    /// OpenCV's `k1 k2 p1 p2 k3`.
    pub dist: [f64; 5],
    /// World to camera, OpenCV axes.
    pub rotation: DMat3,
    /// The same, in units of the file.
    pub translation: DVec3,
    /// Whether the centre of the first pixel is at 0 rather than at one half.
    pub integer_centres: bool,
}

impl RigCamera {
    /// Centre of the camera, units of the file.
    pub fn position(&self) -> DVec3 {
        -(self.rotation.transpose() * self.translation)
    }
}

/// What [`write_rig`] is asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct RigOptions {
    /// Metres per unit of the file.
    pub unit: f64,
    /// Numbers of the conditioning cameras; empty: four, each as far from the others as can be.
    pub conditioning: Vec<u32>,
    /// Numbers of the cameras that are held out.
    pub held_out: Vec<u32>,
    /// Whether an existing `cameras.json` may be replaced.
    pub overwrite: bool,
}

impl Default for RigOptions {
    fn default() -> Self {
        Self { unit: 1.0, conditioning: Vec::new(), held_out: Vec::new(), overwrite: false }
    }
}

/// A camera as it was written.
#[derive(Clone, Debug, PartialEq)]
pub struct WrittenCamera {
    /// Its number, which names its folder: `images/007` for 7.
    pub id: u32,
    /// Its name in the file it came from.
    pub name: String,
    /// What it is for.
    pub role: Role,
    /// Width and height of its images, pixels.
    pub size: [u32; 2],
    /// Centre, metres.
    pub position: DVec3,
}

/// Reads a rig: `intri.yml`, a folder that has it, or a COLMAP model (its folder, or one above).
///
/// # Errors
/// `data.layout` if it is neither, `io.read` if a file is missing; `data.syntax`, `data.field` and `data.pose` name what is wrong in it; `data.camera_model` for a lens that is
/// not OpenCV's with five coefficients.
pub fn read_rig(source: &Path) -> Result<Vec<RigCamera>, DataError> {
    let intrinsics = if source.is_dir() { source.join("intri.yml") } else { source.to_owned() };
    if source.is_dir() && !intrinsics.is_file() { colmap::rig(source) } else { easymocap(&intrinsics) }
}

fn easymocap(file: &Path) -> Result<Vec<RigCamera>, DataError> {
    let poses_file = file.with_file_name("extri.yml");
    let (intrinsics, poses) = (Storage::read(file)?, Storage::read(&poses_file)?);
    let names = intrinsics.texts("names").unwrap_or_else(|| intrinsics.endings("K_"));
    if names.is_empty() {
        return Err(DataError::Empty { file: file.to_path_buf() });
    }
    names.into_iter().map(|name| camera(name, [file, &poses_file], [&intrinsics, &poses])).collect()
}

fn camera(name: String, files: [&Path; 2], [intrinsics, poses]: [&Storage; 2]) -> Result<RigCamera, DataError> {
    let fault = |file: &Path, key: String, why, value: String| {
        Err(DataError::Field { place: Place::new(file, key), value, why, fix: "export the calibration again" })
    };
    let finite = |values: Option<Vec<f64>>| values.filter(|v| v.iter().all(|x| x.is_finite()));
    let k = finite(intrinsics.numbers(&format!("K_{name}"))).and_then(|k| <[f64; 9]>::try_from(k).ok());
    let good = |k: &[f64; 9]| [k[3], k[6], k[7], k[8]] == [0.0, 0.0, 0.0, 1.0] && k[0] > 0.0 && k[4] > 0.0;
    let Some(k) = k.filter(good) else {
        let why = "a calibration matrix is [fx, s, cx, 0, fy, cy, 0, 0, 1] with positive focal lengths";
        return fault(files[0], format!("K_{name}"), why, "missing or something else".into());
    };
    let dist =
        ["dist_", "D_"].iter().find_map(|prefix| intrinsics.numbers(&format!("{prefix}{name}"))).unwrap_or_default();
    if dist.len() > 5 && dist[5..].iter().any(|d| *d != 0.0) || dist.iter().any(|d| !d.is_finite()) {
        let model = format!("with {} distortion coefficients", dist.len());
        return Err(DataError::CameraModel { place: Place::new(files[0], format!("dist_{name}")), model });
    }
    let dist = std::array::from_fn(|i| dist.get(i).copied().unwrap_or(0.0));
    let matrix = |v: &[f64]| DMat3::from_cols_slice(v).transpose();
    let turn = ["Rot_", "R_"].iter().find_map(|prefix| finite(poses.numbers(&format!("{prefix}{name}"))));
    let rotation = match turn.as_deref() {
        Some(rows @ [_, _, _, _, _, _, _, _, _]) => matrix(rows),
        Some(&[x, y, z]) => DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(x, y, z))),
        _ => {
            let why = "a rotation is 3x3 (Rot_) or three numbers of Rodrigues (R_), world to camera";
            return fault(files[1], format!("R_{name}"), why, "missing or something else".into());
        }
    };
    let translation = finite(poses.numbers(&format!("T_{name}"))).and_then(|t| <[f64; 3]>::try_from(t).ok());
    let Some(translation) = translation else {
        let why = "a translation is three numbers, world to camera";
        return fault(files[1], format!("T_{name}"), why, "missing or something else".into());
    };
    let side = |letter: char| intrinsics.whole(&format!("{letter}_{name}")).filter(|s| *s > 0);
    let size = side('W').zip(side('H')).map(|(w, h)| [w, h]);
    let translation = translation.into();
    Ok(RigCamera { name, size, k, dist, rotation, translation, integer_centres: true })
}

/// Writes `cameras.json` into the folder of a film. A camera's number is the one at the end of its name, or its place in the file where these
/// are not all different. Where the file does not say how large images are, the first image of the camera's folder does.
///
/// # Errors
/// `io.exists` if there is a `cameras.json`; `data.field` if a size is not known or a number names no camera; `io.write`.
pub fn write_rig(dir: &Path, source: &Path, options: &RigOptions) -> Result<Vec<WrittenCamera>, DataError> {
    let file = dir.join("cameras.json");
    if file.exists() && !options.overwrite {
        return Err(DataError::Occupied { path: file });
    }
    let rig = read_rig(source)?;
    let ids = numbers(&rig);
    if let Some(unknown) = options.conditioning.iter().chain(&options.held_out).find(|id| !ids.contains(id)) {
        return Err(DataError::Field {
            place: Place::new(source, "cameras"),
            value: unknown.to_string(),
            why: "no camera has this number",
            fix: "name cameras by the numbers they are given",
        });
    }
    let chosen = match &options.conditioning[..] {
        [] => far_apart(&rig, &ids, &options.held_out),
        named => named.to_vec(),
    };
    let role = |id: &u32| match (chosen.contains(id), options.held_out.contains(id)) {
        (true, _) => Role::Cond,
        (_, true) => Role::Test,
        _ => Role::Train,
    };
    let written = |(camera, id): (&RigCamera, &u32)| {
        let size = camera
            .size
            .map_or_else(|| size_of_images(&dir.join(format!("images/{id:03}")), source, &camera.name), Ok)?;
        let position = camera.position() * options.unit;
        Ok(WrittenCamera { id: *id, name: camera.name.clone(), role: role(id), size, position })
    };
    let all: Vec<WrittenCamera> = rig.iter().zip(&ids).map(written).collect::<Result<_, DataError>>()?;
    let entries: Vec<_> = rig.iter().zip(&all).map(|(camera, to)| entry(camera, to, options.unit)).collect();
    let text = serde_json::to_string_pretty(&entries).unwrap_or_default() + "\n";
    write_file(&file, options.overwrite, |out| out.write_all(text.as_bytes()))
        .map_err(|e| DataError::unwritten(&file, e))?;
    Ok(all)
}

fn entry(camera: &RigCamera, to: &WrittenCamera, unit: f64) -> serde_json::Value {
    let (r, t) = (camera.rotation.transpose().to_cols_array(), camera.translation * unit);
    let e = [r[0], r[1], r[2], t.x, r[3], r[4], r[5], t.y, r[6], r[7], r[8], t.z, 0.0, 0.0, 0.0, 1.0];
    let role = Role::NAMES.iter().find(|(_, role)| *role == to.role).map(|(name, _)| *name);
    let dist = camera.dist.iter().any(|d| *d != 0.0).then_some(camera.dist);
    let centre = if camera.integer_centres { "integer" } else { "half" };
    json!({"id": to.id, "w": to.size[0], "h": to.size[1], "K": camera.k, "E": e, "dist": dist, "role": role, "pixel_center": centre})
}

/// The numbers at the ends of the names, or the places in the rig.
fn numbers(rig: &[RigCamera]) -> Vec<u32> {
    let of = |name: &str| {
        let stem = Path::new(name).with_extension("").to_string_lossy().into_owned();
        let digits = stem.len() - stem.trim_end_matches(|c: char| c.is_ascii_digit()).len();
        stem[stem.len() - digits..].parse::<u32>().ok()
    };
    let named: Option<Vec<u32>> = rig.iter().map(|c| of(&c.name)).collect();
    let all = |ids: &Vec<u32>| ids.iter().collect::<BTreeSet<_>>().len() == ids.len();
    named.filter(all).unwrap_or_else(|| (0..cast::to_u32(rig.len())).collect())
}

/// Four cameras, each the one farthest from those before it, of those that are not held out.
fn far_apart(rig: &[RigCamera], ids: &[u32], held_out: &[u32]) -> Vec<u32> {
    let mut left: Vec<(u32, DVec3)> =
        ids.iter().zip(rig).map(|(id, c)| (*id, c.position())).filter(|(id, _)| !held_out.contains(id)).collect();
    left.sort_by_key(|(id, _)| *id);
    let mut chosen: Vec<(u32, DVec3)> = left.first().copied().into_iter().collect();
    while chosen.len() < CONDITIONING.min(left.len()) {
        let gap = |at: DVec3| chosen.iter().map(|(_, c)| c.distance(at)).fold(f64::INFINITY, f64::min);
        // Of equal ones the first.
        let next = left.iter().rev().max_by(|a, b| gap(a.1).total_cmp(&gap(b.1)));
        chosen.extend(next.copied());
    }
    chosen.into_iter().map(|(id, _)| id).collect()
}

/// The size of the first image in a folder.
fn size_of_images(folder: &Path, source: &Path, name: &str) -> Result<[u32; 2], DataError> {
    let first = || {
        let mut files: Vec<PathBuf> = std::fs::read_dir(folder).ok()?.flatten().map(|e| e.path()).collect();
        files.sort();
        files.into_iter().find_map(|file| header::read(&file).ok())
    };
    first().map(|h| [h.width, h.height]).ok_or_else(|| DataError::Field {
        place: Place::new(source, format!("H_{name}, W_{name}")),
        value: format!("missing, and {} has no image", folder.display()),
        why: "a camera has the size of its images",
        fix: "put the images into that folder first",
    })
}
