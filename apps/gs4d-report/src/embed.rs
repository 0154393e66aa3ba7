//! Images embedded in HTML, of bounded size.

use super::ReportError;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use gs_core::Image;
use gs_core::io::images::bytes8;
use image::codecs::{jpeg::JpegEncoder, png::PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use std::borrow::Cow;

/// Longest side of an image in a page, pixels.
pub const IMAGE_SIDE: usize = 640;
/// An RGB image of more bytes than this as PNG is embedded as JPEG.
const MAX_PNG_BYTES: usize = 96 << 10;
/// JPEG qualities, tried until one gives at most [`MAX_PNG_BYTES`] bytes; the last one is used in any case.
const QUALITIES: [u8; 4] = [90, 80, 65, 45];

/// An encoded image: width, height and a `data:` URL.
pub(super) struct Inline {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) address: String,
}

impl Inline {
    /// Encodes an image of 1, 3 or 4 channels; large ones are downsampled, and encoded as JPEG where PNG takes too much.
    pub(super) fn of(image: &Image) -> Result<Self, ReportError> {
        let image = reduced(image, IMAGE_SIDE);
        let (width, height, channels) = image.shape();
        let mut bytes = png(&image)?;
        let mut kind = "png";
        if bytes.len() > MAX_PNG_BYTES && channels == 3 {
            (bytes, kind) = (jpeg(&image)?, "jpeg");
        }
        Ok(Self { width, height, address: format!("data:image/{kind};base64,{}", STANDARD.encode(&bytes)) })
    }
}

/// The image, box-filtered so that its longer side has at most `most` pixels.
pub(super) fn reduced(image: &Image, most: usize) -> Cow<'_, Image> {
    let longest = image.width.max(image.height);
    if longest <= most {
        return Cow::Borrowed(image);
    }
    let side = |n: usize| (n * most / longest).max(1);
    let mut small = Image::zeros(side(image.width), side(image.height), image.channels);
    let span = |k: usize, from: usize, to: usize| k * from / to..(k + 1) * from / to;
    for y in 0..small.height {
        for x in 0..small.width {
            let (rows, columns) = (span(y, image.height, small.height), span(x, image.width, small.width));
            let part = 1.0 / (rows.len() * columns.len()) as f32;
            for (row, column) in rows.flat_map(|row| columns.clone().map(move |column| (row, column))) {
                let sum = small.pixel_mut(x, y).iter_mut().zip(image.pixel(column, row));
                sum.for_each(|(sum, v)| *sum += part * v);
            }
        }
    }
    Cow::Owned(small)
}

/// The image as a page shows it at a longest side of `most` pixels: box-filtered if it is larger. A report that waits for its page holds
/// no more of it.
pub fn within(image: Image, most: usize) -> Image {
    let small = match reduced(&image, most) {
        Cow::Owned(small) => Some(small),
        Cow::Borrowed(_) => None,
    };
    small.unwrap_or(image)
}

/// Encodes an RGB image as JPEG of the best quality that is small enough.
fn jpeg(image: &Image) -> Result<Vec<u8>, ReportError> {
    let (bytes, width, height) = bytes_of(image)?;
    let mut out = Vec::new();
    for quality in QUALITIES {
        out.clear();
        let encoder = JpegEncoder::new_with_quality(&mut out, quality);
        let written = encoder.write_image(&bytes, width, height, ExtendedColorType::Rgb8);
        written.map_err(|e| ReportError::Png(e.to_string()))?;
        if out.len() <= MAX_PNG_BYTES {
            break;
        }
    }
    Ok(out)
}

/// Encodes an image of 1, 3 or 4 channels as 8-bit PNG; values are clamped to `[0, 1]`, NaN becomes 0.
///
/// # Errors
/// If the image has no pixels or another number of channels.
pub fn png(image: &Image) -> Result<Vec<u8>, ReportError> {
    let color = match image.channels {
        1 => ExtendedColorType::L8,
        3 => ExtendedColorType::Rgb8,
        4 => ExtendedColorType::Rgba8,
        n => return Err(ReportError::Png(format!("{n} channels"))),
    };
    let (bytes, width, height) = bytes_of(image)?;
    let mut out = Vec::new();
    let encoder = PngEncoder::new(&mut out);
    encoder.write_image(&bytes, width, height, color).map_err(|e| ReportError::Png(e.to_string()))?;
    Ok(out)
}

/// The values in 8 bit, width and height.
fn bytes_of(image: &Image) -> Result<(Vec<u8>, u32, u32), ReportError> {
    let bytes = bytes8(image);
    let side = |n: usize| u32::try_from(n).map_err(|_| ReportError::Png(format!("{n} pixels on one side")));
    let (width, height) = (side(image.width)?, side(image.height)?);
    if bytes.is_empty() || bytes.len() != image.width * image.height * image.channels {
        return Err(ReportError::Png(format!("{width}x{height} with {} values", bytes.len())));
    }
    Ok((bytes, width, height))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn png_reads_back_clamped() {
        let im = Image { width: 2, height: 1, channels: 3, data: vec![0.0, 0.5, 1.0, 7.0, -1.0, f32::NAN] };
        let back = image::load_from_memory(&png(&im).unwrap()).unwrap().to_rgb8();
        assert_eq!(back.as_raw(), &[0, 128, 255, 255, 0, 0]);
        assert!(png(&Image::zeros(0, 4, 3)).is_err() && png(&Image::zeros(2, 2, 2)).is_err());
    }

    #[test]
    fn large_pictures_are_reduced_to_means_and_kept_small() {
        let mut seed = 1u32;
        let mut noise = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 8) as f32 / (1 << 24) as f32
        };
        let large =
            Image { width: 1280, height: 700, channels: 3, data: (0..1280 * 700 * 3).map(|_| noise()).collect() };
        let inline = Inline::of(&large).unwrap();
        assert_eq!((inline.width, inline.height), (640, 350));
        assert!(inline.address.starts_with("data:image/jpeg;base64,"));
        assert!(inline.address.len() < 160 << 10, "{} bytes of noise", inline.address.len());
        let stripes = (0..1280 * 2).flat_map(|i| [(i % 2) as f32; 3]).collect();
        let small = reduced(&Image { width: 1280, height: 2, channels: 3, data: stripes }, 640).into_owned();
        assert_eq!(small.shape(), (640, 1, 3));
        assert!(small.data.iter().all(|v| (v - 0.5).abs() < 1e-6), "means over areas");
        let held = within(large.clone(), IMAGE_SIDE);
        assert_eq!((held.width, Inline::of(&held).unwrap().address), (640, inline.address), "the same on the page");
        let flat = Inline::of(&Image { width: 2, height: 3, channels: 1, data: vec![0.5; 6] }).unwrap();
        assert!((flat.width, flat.height) == (2, 3) && flat.address.starts_with("data:image/png;base64,"));
    }
}
