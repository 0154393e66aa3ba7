//! Encoding of images.

use gs_core::Image;
use gs_core::io::images::{bytes8, write_png8};

/// JPEG's quality, 1 to 100.
const QUALITY: u8 = 80;

/// Format of images sent to the browser.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    /// PNG: lossless, for a browser on this machine.
    Png,
    /// JPEG at quality 80: about a tenth of the bytes, for a remote browser.
    Jpeg,
}

/// Encodes an RGB image; values are clamped to 0..1.
///
/// # Errors
/// A message, if the image is too large for the format.
pub(crate) fn pack(image: &Image, packing: Packing) -> Result<Vec<u8>, String> {
    let bytes = bytes8(image);
    let mut out = Vec::new();
    let (width, height) = (image.width, image.height);
    match packing {
        Packing::Png => {
            write_png8(width, height, 3, &bytes, &mut out).map_err(|e| e.to_string())?;
            Ok(out)
        }
        Packing::Jpeg => {
            let side = |n: usize| u16::try_from(n).map_err(|_| "the image is too wide".to_owned());
            let encoder = jpeg_encoder::Encoder::new(&mut out, QUALITY);
            let written = encoder.encode(&bytes, side(width)?, side(height)?, jpeg_encoder::ColorType::Rgb);
            written.map_err(|e| e.to_string()).map(|()| out)
        }
    }
}
