//! The truth of a generated scene as maps: depth, masks and labels of every view, and flow of a camera that stands still.
//!
//! ```text
//! maps/{train,val,test}/r_000.depth.npy             [H, W] camera-space z; NaN where nothing is seen
//! maps/{train,val,test}/r_000.{global,local}.png    255 where a body moves rigidly, where one deforms
//! maps/labels/SPLIT/r_000.png                       8 bits: 0 where nothing is seen, k for the k-th body of truth.json;
//!                                                   SPLIT: train, val, test, extrapolate
//! maps/fixed/camera.json                            the first test view's camera, once for each of the times k / (n − 1)
//! maps/fixed/frames/t_000.png                       what it sees, with alpha
//! maps/fixed/t_000.{depth.npy,global.png,local.png} depth and masks from there
//! maps/fixed/t_000.flow.npy                         [H, W, 2] pixels from time k to time k + 1; NaN where nothing is seen
//! ```
//! Names are those of the pictures, and below `maps` folders, too: with cameras at rest, those of the future are in `train` and
//! `test`.

use std::path::{Path, PathBuf};

use gs_core::io::cameras::{NamedCamera, save_cameras};
use gs_core::io::{IoError, npy, write_file};
use gs_core::{Camera, Image};
use rayon::prelude::*;

use super::body::MotionClass;
use super::write::{save_png, splits};
use super::{SynthData, Truth};
use gs_core::io::images::write_png;
use gs_data::DataError;

/// Folder of the maps in that of the data set.
pub const FOLDER: &str = "maps";
/// Folder of the labels in that of the maps.
pub const LABELS: &str = "labels";

/// Writes the maps of a generated scene below its folder `dir`, with `moments` (at least 2) times of the camera that stands
/// still. Maps that exist are written anew only if `overwrite` is set.
///
/// # Errors
/// `io.exists` or `io.write`.
pub fn write_maps(dir: &Path, data: &SynthData, moments: u32, overwrite: bool) -> Result<(), DataError> {
    let root = dir.join(FOLDER);
    let (truth, sets) = (&data.truth, &data.dataset);
    for (split, views) in splits(data) {
        let folder = made(root.join(split))?;
        views.par_iter().try_for_each(|v| still(truth, &v.camera, v.time.seconds, &folder.join(&v.name), overwrite))?;
    }
    let all = [("train", &sets.train), ("val", &sets.val), ("test", &sets.test), ("extrapolate", &sets.extrapolate)];
    for (split, views) in all {
        let folder = made(root.join(LABELS).join(split))?;
        views.par_iter().try_for_each(|v| {
            let map = truth.labels(&v.camera, v.time.seconds);
            save_mask(&folder.join(format!("{}.png", v.name)), &map, overwrite)
        })?;
    }
    let Some(view) = sets.test.first().or(sets.train.first()) else { return Ok(()) };
    let (camera, folder) = (&view.camera, made(root.join("fixed"))?);
    let frames = made(folder.join("frames"))?;
    let last = moments.max(2) - 1;
    let time = |k: u32| f64::from(k) / f64::from(last);
    let named = |k: u32| NamedCamera { camera: camera.clone(), name: format!("t_{k:03}"), time: Some(time(k) as f32) };
    let cameras: Vec<NamedCamera> = (0..=last).map(named).collect();
    saved(save_cameras(&folder.join("camera.json"), &cameras, overwrite), &folder)?;
    (0..=last).into_par_iter().try_for_each(|k| {
        let stem = folder.join(format!("t_{k:03}"));
        still(truth, camera, time(k), &stem, overwrite)?;
        save_png(&frames.join(format!("t_{k:03}.png")), &truth.picture(camera, time(k)))?;
        if k == last {
            return Ok(());
        }
        let mut map = truth.flow(camera, time(k), camera, time(k + 1));
        hide(&mut map.flow, &map.seen);
        save_npy(&stem.with_extension("flow.npy"), &map.flow, overwrite)
    })
}

/// Depth and masks of one camera at one time.
fn still(truth: &Truth, camera: &Camera, t: f64, stem: &Path, overwrite: bool) -> Result<(), DataError> {
    let mut depth = truth.depth(camera, t);
    let seen: Vec<bool> = depth.data.iter().map(|&z| z > 0.0).collect();
    hide(&mut depth, &seen);
    save_npy(&stem.with_extension("depth.npy"), &depth, overwrite)?;
    for (class, name) in [(MotionClass::Global, "global.png"), (MotionClass::Local, "local.png")] {
        save_mask(&stem.with_extension(name), &truth.mask(camera, t, class), overwrite)?;
    }
    Ok(())
}

/// One channel, 0 to 1, as 8 bits.
fn save_mask(file: &Path, mask: &Image, overwrite: bool) -> Result<(), DataError> {
    let mut bytes = Vec::new();
    write_png(mask, &mut bytes).map_err(|e| DataError::write(file, e))?;
    saved(write_file(file, overwrite, |out| out.write_all(&bytes)), file)
}

/// NaN where nothing is seen.
fn hide(map: &mut Image, seen: &[bool]) {
    for (values, _) in map.data.chunks_exact_mut(map.channels).zip(seen).filter(|(_, seen)| !**seen) {
        values.fill(f32::NAN);
    }
}

fn made(folder: PathBuf) -> Result<PathBuf, DataError> {
    std::fs::create_dir_all(&folder).map_err(|e| DataError::write(&folder, e))?;
    Ok(folder)
}

fn save_npy(file: &Path, map: &Image, overwrite: bool) -> Result<(), DataError> {
    let shape = [map.height, map.width, map.channels];
    let shape = if map.channels == 1 { &shape[..2] } else { &shape };
    saved(write_file(file, overwrite, |out| npy::write(shape, &map.data, out)), file)
}

fn saved(result: Result<(), IoError>, place: &Path) -> Result<(), DataError> {
    result.map_err(|e| match e {
        IoError::Exists { .. } => DataError::Occupied { path: place.to_owned() },
        other => DataError::write(place, std::io::Error::other(other)),
    })
}
