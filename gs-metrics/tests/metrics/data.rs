//! Public images, where a copy is at hand.

use gs_core::Image;
use gs_core::io::{Limits, images};
use gs_core::testkit::shared;

/// Reads one of those for quality assessment, or prints why not and gives `None`, on which a test returns.
pub fn iqa_image(name: &str) -> Option<Image> {
    let path = shared(&format!("data/iqa_public/{name}"))?;
    let decoded = image::open(&path).expect("a readable image").to_rgb8();
    let data = decoded.as_raw().iter().map(|v| f32::from(*v) / 255.0).collect();
    Some(Image { width: decoded.width() as usize, height: decoded.height() as usize, channels: 3, data })
}

/// A pair of frames by the names of their files, likewise. Linear images (EXR) are clamped to `[0, 1]`
/// and shown by their square root.
pub fn captured(first: &str, second: &str) -> Option<[Image; 2]> {
    let read = |name: &str| {
        let path = shared(&format!("data/{name}"))?;
        let image = images::load_image(&path, &Limits::default()).expect("a readable image");
        let linear = name.ends_with("exr");
        let shown = |v: f32| if linear { v.clamp(0.0, 1.0).sqrt() } else { v };
        let data = image.data.chunks_exact(image.channels).flat_map(|p| [shown(p[0]), shown(p[1]), shown(p[2])]);
        Some(Image { width: image.width, height: image.height, channels: 3, data: data.collect() })
    };
    Some([read(first)?, read(second)?])
}
