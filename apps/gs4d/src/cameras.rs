//! Cameras of a file, also of transforms files that leave the image size to their images (Blender, D-NeRF).

use crate::failure::Failure;
use gs_core::io::cameras::{NamedCamera, load_cameras, parse_cameras};
use gs_core::io::{IoError, Limits, images, read_file};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Reads cameras. Where a transforms file gives no `w` and `h`, those of its first image are taken for all frames.
pub fn load(path: &Path) -> Result<Vec<NamedCamera>, Failure> {
    let limits = Limits::default();
    match load_cameras(path, &limits) {
        Err(e @ IoError::Missing { .. }) => match with_image_size(path, &limits) {
            Some(text) => Ok(parse_cameras(text.as_bytes(), &path.display().to_string(), &limits)?),
            None => Err(Failure::from(e).remedy("add \"w\" and \"h\" in pixels, or keep the images beside the file")),
        },
        read => Ok(read?),
    }
}

/// The text of a transforms file with the size of its first image added, if it lacks one and the image is there.
fn with_image_size(path: &Path, limits: &Limits) -> Option<String> {
    let mut json: Value = serde_json::from_slice(&read_file(path, limits).ok()?).ok()?;
    if !json["w"].is_null() || !json["h"].is_null() {
        return None;
    }
    let image = image_of(path, json["frames"][0]["file_path"].as_str()?)?;
    let bytes = read_file(&image, limits).ok()?;
    let (width, height) = images::image_size(&bytes, &image.display().to_string(), limits).ok()?;
    json["w"] = width.into();
    json["h"] = height.into();
    Some(json.to_string())
}

/// The image a frame names, inside the folder of the file; Blender leaves out the extension.
fn image_of(path: &Path, named: &str) -> Option<PathBuf> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).canonicalize().ok()?;
    let candidates = ["", ".png", ".jpg", ".jpeg"].map(|extension| folder.join(format!("{named}{extension}")));
    let found = candidates.into_iter().find(|c| c.is_file())?.canonicalize().ok()?;
    found.starts_with(&folder).then_some(found)
}
