//! The public quality-assessment images, where a copy is at hand.

use gs_core::Image;
use gs_core::testkit::shared;

/// Reads one of them, or prints why not and gives `None`, on which a test returns.
pub fn iqa_image(name: &str) -> Option<Image> {
    let path = shared(&format!("data/iqa_public/{name}"))?;
    let decoded = image::open(&path).expect("a readable image").to_rgb8();
    let data = decoded.as_raw().iter().map(|v| f32::from(*v) / 255.0).collect();
    Some(Image { width: decoded.width() as usize, height: decoded.height() as usize, channels: 3, data })
}
