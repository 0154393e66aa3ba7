//! Pictures inside a text file.

use super::ReportError;
use gs_core::Image;
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};

/// An image of 1, 3 or 4 channels as 8-bit PNG; values are clamped to 0..1, NaN becomes 0.
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
    let bytes: Vec<u8> = image.data.iter().map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect();
    let side = |n: usize| u32::try_from(n).map_err(|_| ReportError::Png(format!("{n} pixels on one side")));
    let (width, height) = (side(image.width)?, side(image.height)?);
    if bytes.is_empty() || bytes.len() != image.width * image.height * image.channels {
        return Err(ReportError::Png(format!("{width}x{height} with {} values", bytes.len())));
    }
    let mut out = Vec::new();
    let encoder = PngEncoder::new(&mut out);
    encoder.write_image(&bytes, width, height, color).map_err(|e| ReportError::Png(e.to_string()))?;
    Ok(out)
}

/// Base64 (RFC 4648, with padding).
pub fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let mut word = 0u32;
        for k in 0..3 {
            word = word << 8 | u32::from(group.get(k).copied().unwrap_or(0));
        }
        for k in 0..4 {
            let digit = DIGITS[(word >> (18 - 6 * k)) as usize & 63] as char;
            out.push(if k <= group.len() { digit } else { '=' });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The test vectors of RFC 4648, section 10.
    #[test]
    fn base64_vectors() {
        let cases =
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foob", "Zm9vYg=="), ("foobar", "Zm9vYmFy")];
        for (text, want) in cases {
            assert_eq!(base64(text.as_bytes()), want);
        }
        assert_eq!(base64(&[255, 254, 253]), "//79");
    }

    #[test]
    fn png_reads_back_clamped() {
        let im = Image { width: 2, height: 1, channels: 3, data: vec![0.0, 0.5, 1.0, 7.0, -1.0, f32::NAN] };
        let back = image::load_from_memory(&png(&im).unwrap()).unwrap().to_rgb8();
        assert_eq!(back.as_raw(), &[0, 128, 255, 255, 0, 0]);
        assert!(png(&Image::zeros(0, 4, 3)).is_err() && png(&Image::zeros(2, 2, 2)).is_err());
    }
}
