//! Public images from the shared folder, which a clone may lack. Without them a test checks nothing and reports that it was
//! skipped.

use gs_core::Image;
use gs_core::io::{Limits, images};
use gs_core::testkit::shared;

/// An image for quality assessment, `[H, W, 3]`; `None`, with a line of output, if it is absent.
pub fn iqa_image(name: &str) -> Option<Image> {
    let path = shared(&format!("data/iqa_public/{name}"))?;
    let decoded = image::open(&path).expect("a readable image").to_rgb8();
    let data = decoded.as_raw().iter().map(|v| f32::from(*v) / 255.0).collect();
    Some(Image { width: decoded.width() as usize, height: decoded.height() as usize, channels: 3, data })
}

/// Two captured frames by their paths, `[H, W, 3]`; `None`, with a line of output, if one is absent. Linear images (EXR) are
/// clamped to `[0, 1]`, and their square root is taken.
pub fn captured(first: &str, second: &str) -> Option<[Image; 2]> {
    let read = |name: &str| {
        let path = shared(&format!("data/{name}"))?;
        let image = images::load_image(&path, &Limits::default()).expect("a readable image");
        let linear = name.ends_with("exr");
        let encode = |v: f32| if linear { v.clamp(0.0, 1.0).sqrt() } else { v };
        let data = image.data.chunks_exact(image.channels).flat_map(|p| [encode(p[0]), encode(p[1]), encode(p[2])]);
        Some(Image { width: image.width, height: image.height, channels: 3, data: data.collect() })
    };
    Some([read(first)?, read(second)?])
}
