//! Files and folders of a data set.

use std::path::{Path, PathBuf};

use gs_core::io::images::write_png8;
use gs_core::io::{disk, write_file};
use gs_data::{DataError, ImageU8};
use serde_json::Value;

/// Creates a folder and those above it; returns it.
pub(super) fn create_dir(folder: PathBuf) -> Result<PathBuf, DataError> {
    disk::create_folder(&folder).map_err(|e| DataError::write(&folder, e))?;
    Ok(folder)
}

/// Writes a file whole, over an existing one.
pub(super) fn save(file: &Path, bytes: &[u8]) -> Result<(), DataError> {
    write_file(file, true, |out| out.write_all(bytes)).map_err(|e| DataError::unwritten(file, e))
}

pub(super) fn save_json(file: &Path, value: &Value) -> Result<(), DataError> {
    save(file, format!("{value:#}\n").as_bytes())
}

/// Writes an image with alpha.
pub(super) fn save_png(file: &Path, image: &ImageU8) -> Result<(), DataError> {
    save_channels(file, image, 4, &image.data)
}

/// Writes an image without its alpha.
pub(super) fn save_rgb(file: &Path, image: &ImageU8) -> Result<(), DataError> {
    let rgb: Vec<u8> = image.data.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    save_channels(file, image, 3, &rgb)
}

fn save_channels(file: &Path, image: &ImageU8, channels: usize, bytes: &[u8]) -> Result<(), DataError> {
    let mut png = Vec::new();
    write_png8(image.width, image.height, channels, bytes, &mut png).map_err(|e| DataError::write(file, e))?;
    save(file, &png)
}
