//! Ground-truth maps of a generated scene: depth, masks and labels of every view, and optical flow of a static camera.
//!
//! ```text
//! maps/{train,val,test}/r_000.depth.npy             [H, W] camera-space z; NaN where nothing is visible
//! maps/{train,val,test}/r_000.{global,local}.png    255 where a body moves rigidly, where one deforms
//! maps/labels/SPLIT/r_000.png                       8 bits: 0 where nothing is visible, k for the k-th body of truth.json;
//!                                                   SPLIT: train, val, test, extrapolate
//! maps/fixed/camera.json                            the first test view's camera, once for each of the times k / (n − 1)
//! maps/fixed/frames/t_000.png                       its images, with alpha
//! maps/fixed/t_000.{depth.npy,global.png,local.png} its depth and masks
//! maps/fixed/t_000.flow.npy                         [H, W, 2] pixels from time k to time k + 1; NaN where nothing is visible
//! ```
//! Names and folders are those of the images: with static cameras, views of the extrapolation split are in `train` and
//! `test`, except below `labels`.

use std::io::Write;
use std::path::Path;

use gs_core::io::cameras::{NamedCamera, save_cameras};
use gs_core::io::{npy, write_file};
use gs_core::{Camera, Image, cast};
use rayon::prelude::*;

use super::body::MotionClass;
use super::save::{create_dir, save_png};
use super::write::splits;
use super::{SynthData, Truth};
use gs_core::io::images::write_png;
use gs_data::DataError;

/// Folder of the maps in that of the data set.
const FOLDER: &str = "maps";
/// Folder of the labels in that of the maps.
const LABELS: &str = "labels";

/// Writes the ground-truth maps ([`maps`](self)) of a generated scene below its folder `dir`, with `moments` (at least 2) timestamps
/// of the static camera. Existing files are overwritten only if `overwrite` is set.
///
/// # Errors
/// `io.exists` if a file exists and `overwrite` is not set, `io.write` if writing fails.
pub fn write_maps(dir: &Path, data: &SynthData, moments: u32, overwrite: bool) -> Result<(), DataError> {
    let root = dir.join(FOLDER);
    let (truth, sets) = (&data.truth, &data.dataset);
    for (split, views) in splits(data) {
        let folder = create_dir(root.join(split))?;
        views.par_iter().try_for_each(|v| {
            save_depth_and_masks(truth, &v.camera, v.time.seconds, &folder.join(&v.name), overwrite)
        })?;
    }
    let all = [("train", &sets.train), ("val", &sets.val), ("test", &sets.test), ("extrapolate", &sets.extrapolate)];
    for (split, views) in all {
        let folder = create_dir(root.join(LABELS).join(split))?;
        views.par_iter().try_for_each(|v| {
            let map = truth.labels(&v.camera, v.time.seconds);
            save_mask(&folder.join(format!("{}.png", v.name)), &map, overwrite)
        })?;
    }
    let Some(view) = sets.test.first().or(sets.train.first()) else { return Ok(()) };
    let (camera, folder) = (&view.camera, create_dir(root.join("fixed"))?);
    let frames = create_dir(folder.join("frames"))?;
    let last = moments.max(2) - 1;
    let time = |k: u32| f64::from(k) / f64::from(last);
    let named =
        |k: u32| NamedCamera { camera: camera.clone(), name: format!("t_{k:03}"), time: Some(cast::to_f32(time(k))) };
    let cameras: Vec<NamedCamera> = (0..=last).map(named).collect();
    let file = folder.join("camera.json");
    save_cameras(&file, &cameras, overwrite).map_err(|e| DataError::unwritten(&file, e))?;
    (0..=last).into_par_iter().try_for_each(|k| {
        let stem = folder.join(format!("t_{k:03}"));
        save_depth_and_masks(truth, camera, time(k), &stem, overwrite)?;
        save_png(&frames.join(format!("t_{k:03}.png")), &truth.picture(camera, time(k)))?;
        if k == last {
            return Ok(());
        }
        let mut map = truth.flow(camera, time(k), camera, time(k + 1));
        set_nan(&mut map.flow, &map.seen);
        save_npy(&stem.with_extension("flow.npy"), &map.flow, overwrite)
    })
}

/// Depth and masks of one camera at one time.
fn save_depth_and_masks(truth: &Truth, camera: &Camera, t: f64, stem: &Path, overwrite: bool) -> Result<(), DataError> {
    let mut depth = truth.depth(camera, t);
    let seen: Vec<bool> = depth.data.iter().map(|&z| z > 0.0).collect();
    set_nan(&mut depth, &seen);
    save_npy(&stem.with_extension("depth.npy"), &depth, overwrite)?;
    for (class, name) in [(MotionClass::Global, "global.png"), (MotionClass::Local, "local.png")] {
        save_mask(&stem.with_extension(name), &truth.mask(camera, t, class), overwrite)?;
    }
    Ok(())
}

/// Writes one channel in 0..1 as an 8-bit PNG.
fn save_mask(file: &Path, mask: &Image, overwrite: bool) -> Result<(), DataError> {
    let mut bytes = Vec::new();
    write_png(mask, &mut bytes).map_err(|e| DataError::write(file, e))?;
    write_file(file, overwrite, |out| out.write_all(&bytes)).map_err(|e| DataError::unwritten(file, e))
}

/// Sets pixels that are not `seen` to NaN.
fn set_nan(map: &mut Image, seen: &[bool]) {
    for (values, _) in map.data.chunks_exact_mut(map.channels).zip(seen).filter(|(_, seen)| !**seen) {
        values.fill(f32::NAN);
    }
}

fn save_npy(file: &Path, map: &Image, overwrite: bool) -> Result<(), DataError> {
    let shape = [map.height, map.width, map.channels];
    let shape = if map.channels == 1 { &shape[..2] } else { &shape };
    let content = |out: &mut dyn Write| npy::write(shape, &map.data, out);
    write_file(file, overwrite, content).map_err(|e| DataError::unwritten(file, e))
}
