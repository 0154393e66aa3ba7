//! The public quality-assessment images, where a copy is at hand.

use std::path::PathBuf;

use gs_core::Image;

/// Reads one of them, or prints why not and gives `None`, on which a test returns.
pub fn iqa_image(name: &str) -> Option<Image> {
    let beside = || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared");
    let root = std::env::var_os("GS4D_SHARED").map_or_else(beside, PathBuf::from);
    let path = root.join("data/iqa_public").join(name);
    if !path.exists() {
        println!("SKIPPED: {} is not there (set GS4D_SHARED to the folder that holds data/)", path.display());
        return None;
    }
    let decoded = image::open(&path).expect("a readable image").to_rgb8();
    let data = decoded.as_raw().iter().map(|v| f32::from(*v) / 255.0).collect();
    Some(Image { width: decoded.width() as usize, height: decoded.height() as usize, channels: 3, data })
}
