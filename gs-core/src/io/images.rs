//! PNG and JPEG in, PNG out (the `image` crate), within [`Limits`].
//!
//! Values are kept as stored: display-encoded, straight alpha. ICC profiles, `gAMA` chunks and EXIF orientation are not
//! applied. 16-bit PNG keeps its precision in [`decode_image`] and is rounded to 8 bits in [`decode_rgba8`]. Writing maps
//! `[0, 1]` to `round(255 v)`, ties away from zero, values outside clamped; an 8-bit image round-trips exactly.
//!
//! ```
//! use gs_core::{Image, io::{Limits, images}};
//!
//! let image = Image::from_data(2, 1, 1, vec![0.0, 128.0 / 255.0])?;
//! let mut png = Vec::new();
//! images::write_png(&image, &mut png)?;
//! assert_eq!(images::image_size(&png, "grey.png", &Limits::default())?, (2, 1));
//! assert_eq!(images::decode_image(&png, "grey.png", &Limits::default())?, image);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use super::error::{At, Source};
use super::{IoError, Limits, read_file, write_file};
use crate::image::Image;
use ::image::codecs::png::PngEncoder;
use ::image::{DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageFormat, ImageReader};
use std::io::{BufRead, Cursor, Write};
use std::path::Path;

/// The first bytes of every EXR file.
#[cfg(feature = "exr")]
const EXR_MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// An 8-bit image, row-major RGBA with straight alpha.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct Rgba8 {
    /// Number of pixels per row.
    pub width: usize,
    /// Number of rows of pixels.
    pub height: usize,
    /// `height × width × 4` bytes.
    pub data: Vec<u8>,
}

impl Rgba8 {
    /// The same image as `f32` in `[0, 1]`, four channels.
    pub fn to_image(&self) -> Image {
        let data = self.data.iter().map(|&v| f32::from(v) / 255.0).collect();
        Image { width: self.width, height: self.height, channels: 4, data }
    }
}

/// Reads a PNG or JPEG file as 8-bit RGBA.
///
/// # Errors
/// As [`read_file`] and [`decode_rgba8`].
pub fn load_rgba8(path: &Path, limits: &Limits) -> Result<Rgba8, IoError> {
    decode_rgba8(&read_file(path, limits)?, &path.display().to_string(), limits)
}

/// Reads an image file as `f32`: PNG and JPEG in `[0, 1]`, and EXR as stored where that feature is on.
///
/// # Errors
/// As [`read_file`] and [`decode_image`].
pub fn load_image(path: &Path, limits: &Limits) -> Result<Image, IoError> {
    decode_image(&read_file(path, limits)?, &path.display().to_string(), limits)
}

/// `(width, height)` from the header of a PNG or JPEG held in memory.
///
/// # Errors
/// Not such an image, or a side above the limits.
pub fn image_size(bytes: &[u8], file: &str, limits: &Limits) -> Result<(u32, u32), IoError> {
    let src = Source { file, format: "image" };
    let size = open(CAPTURES, bytes, limits, src)?.into_dimensions().map_err(|e| broken(&e, src))?;
    limits.image(src, (size.0.into(), size.1.into()), 1, bytes.len())?;
    Ok(size)
}

/// Decodes PNG or JPEG bytes to 8-bit RGBA. `file` is the name used in errors.
///
/// # Errors
/// Unknown format, damaged or truncated data, more pixels than the limits allow.
pub fn decode_rgba8(bytes: &[u8], file: &str, limits: &Limits) -> Result<Rgba8, IoError> {
    let src = Source { file, format: "image" };
    let image = decode(bytes, 4, limits, src)?.into_rgba8();
    let (width, height) = (image.width() as usize, image.height() as usize);
    Ok(Rgba8 { width, height, data: image.into_raw() })
}

/// Decodes image bytes to `f32`: one channel for grey, three for RGB, four where there is alpha.
///
/// # Errors
/// As [`decode_rgba8`].
pub fn decode_image(bytes: &[u8], file: &str, limits: &Limits) -> Result<Image, IoError> {
    #[cfg(feature = "exr")]
    if bytes.starts_with(&EXR_MAGIC) {
        return super::exr::read(bytes, file, limits);
    }
    let src = Source { file, format: "image" };
    let image = decode(bytes, 16, limits, src)?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    let grey = !image.color().has_color() && !image.color().has_alpha();
    let (channels, data) = match &image {
        DynamicImage::ImageLuma8(i) => (1, unit8(i.as_raw())),
        DynamicImage::ImageLuma16(i) => (1, unit16(i.as_raw())),
        DynamicImage::ImageRgb8(i) => (3, unit8(i.as_raw())),
        DynamicImage::ImageRgb16(i) => (3, unit16(i.as_raw())),
        DynamicImage::ImageRgba8(i) => (4, unit8(i.as_raw())),
        _ if grey => (1, unit16(image.into_luma16().as_raw())),
        _ => (4, unit16(image.into_rgba16().as_raw())),
    };
    Ok(Image { width, height, channels, data })
}

fn unit8(values: &[u8]) -> Vec<f32> {
    values.iter().map(|&v| f32::from(v) / 255.0).collect()
}

fn unit16(values: &[u16]) -> Vec<f32> {
    values.iter().map(|&v| f32::from(v) / 65_535.0).collect()
}

/// Decodes WebP or PNG bytes to 8-bit RGBA.
///
/// # Errors
/// As [`decode_rgba8`].
pub(super) fn decode_webp(bytes: &[u8], file: &str, limits: &Limits) -> Result<Rgba8, IoError> {
    let src = Source { file, format: "image" };
    let formats = (&[ImageFormat::WebP, ImageFormat::Png][..], "give a WebP or PNG file");
    let image = decode_one_of(formats, bytes, 4, limits, src)?.into_rgba8();
    let (width, height) = (image.width() as usize, image.height() as usize);
    Ok(Rgba8 { width, height, data: image.into_raw() })
}

/// The formats of captures, and what to say to others.
const CAPTURES: (&[ImageFormat], &str) =
    (&[ImageFormat::Png, ImageFormat::Jpeg], "give a PNG or JPEG file (EXR needs the feature `exr`)");

/// A reader of the format the bytes show, if it is one of these, with the limits set.
fn open<'a>(
    (formats, advice): (&[ImageFormat], &'static str),
    bytes: &'a [u8],
    limits: &Limits,
    src: Source<'_>,
) -> Result<ImageReader<Cursor<&'a [u8]>>, IoError> {
    let guess = ImageReader::new(Cursor::new(bytes)).with_guessed_format();
    let mut reader = guess.map_err(|e| src.malformed(At::Byte(0), e.to_string(), advice))?;
    if !reader.format().is_some_and(|f| formats.contains(&f)) {
        return Err(src.unsupported("this image format", advice));
    }
    let mut bounds = ::image::Limits::default();
    bounds.max_image_width = Some(limits.max_side);
    bounds.max_image_height = Some(limits.max_side);
    bounds.max_alloc = Some(limits.max_image_bytes);
    reader.limits(bounds);
    Ok(reader)
}

fn broken(error: &::image::ImageError, src: Source<'_>) -> IoError {
    src.malformed(
        At::Byte(0),
        error.to_string(),
        "the file is damaged, cut short or beyond the limits: export it again",
    )
}

/// Checks the header against the limits, then decodes. The caller's copy takes `extra` bytes per pixel.
fn decode(bytes: &[u8], extra: u64, limits: &Limits, src: Source<'_>) -> Result<DynamicImage, IoError> {
    decode_one_of(CAPTURES, bytes, extra, limits, src)
}

/// The same of other formats.
fn decode_one_of(
    formats: (&[ImageFormat], &'static str),
    bytes: &[u8],
    extra: u64,
    limits: &Limits,
    src: Source<'_>,
) -> Result<DynamicImage, IoError> {
    let reader = open(formats, bytes, limits, src)?;
    if reader.format() == Some(ImageFormat::Jpeg) && !jpeg_ends(&mut &*bytes).unwrap_or(false) {
        return Err(src.truncated("JPEG end marker", bytes.len(), 2, 0));
    }
    let decoder = reader.into_decoder().map_err(|e| broken(&e, src))?;
    let (width, height) = decoder.dimensions();
    let native = u64::from(decoder.color_type().bytes_per_pixel());
    limits.image(src, (width.into(), height.into()), native + extra, bytes.len())?;
    DynamicImage::from_decoder(decoder).map_err(|e| broken(&e, src))
}

/// Markers of a JPEG: the beginning and the end of an image, a scan, and one without a segment (ITU T.81, table B.1).
const START: u8 = 0xd8;
const END: u8 = 0xd9;
const SCAN: u8 = 0xda;
const ALONE: u8 = 0x01;

/// Whether the image that begins a JPEG is whole: its end marker follows its scans. A decoder fills what is missing of an
/// image that was cut with grey, silently. What follows the end marker, such as the video of a motion photo, is not read.
///
/// ```
/// let image: &[u8] = &[0xff, 0xd8, 0xff, 0xda, 0, 3, 7, 0x12, 0xff, 0, 0x34, 0xff, 0xd9];
/// assert!(gs_core::io::images::jpeg_ends(&mut &*image)?);
/// assert!(!gs_core::io::images::jpeg_ends(&mut &image[..11])?);
/// # Ok::<(), std::io::Error>(())
/// ```
///
/// # Errors
/// Those of `jpeg`; that it ends early is none.
pub fn jpeg_ends(jpeg: &mut impl BufRead) -> std::io::Result<bool> {
    if next_marker(jpeg)? != Some(START) {
        return Ok(false);
    }
    let mut scanned = false;
    while let Some(marker) = next_marker(jpeg)? {
        match marker {
            END => return Ok(scanned),
            START => return Ok(false),
            ALONE => {}
            _ => {
                if !skip_segment(jpeg)? {
                    return Ok(false);
                }
                scanned |= marker == SCAN;
            }
        }
    }
    Ok(false)
}

/// The second byte of the next marker, none at the end. In scans FF is followed by 00, or by a restart marker (D0 to D7);
/// before a marker it may be repeated.
fn next_marker(jpeg: &mut impl BufRead) -> std::io::Result<Option<u8>> {
    loop {
        jpeg.skip_until(0xff)?;
        let mut byte = next_byte(jpeg)?;
        while byte == Some(0xff) {
            byte = next_byte(jpeg)?;
        }
        if !matches!(byte, Some(0x00 | 0xd0..=0xd7)) {
            return Ok(byte);
        }
    }
}

/// Skips a segment, which begins with its length in two bytes that count themselves; whether it is whole.
fn skip_segment(jpeg: &mut impl BufRead) -> std::io::Result<bool> {
    let (Some(high), Some(low)) = (next_byte(jpeg)?, next_byte(jpeg)?) else { return Ok(false) };
    let Some(mut left) = usize::from(u16::from_be_bytes([high, low])).checked_sub(2) else { return Ok(false) };
    while left > 0 {
        let there = jpeg.fill_buf()?.len().min(left);
        if there == 0 {
            return Ok(false);
        }
        jpeg.consume(there);
        left -= there;
    }
    Ok(true)
}

fn next_byte(jpeg: &mut impl BufRead) -> std::io::Result<Option<u8>> {
    let byte = jpeg.fill_buf()?.first().copied();
    jpeg.consume(usize::from(byte.is_some()));
    Ok(byte)
}

/// Writes an image of 1, 3 or 4 channels as an 8-bit PNG.
///
/// # Errors
/// Another number of channels, a shape that does not fit, a value that is not finite (as `InvalidInput`), or the writer's.
pub fn write_png(image: &Image, out: &mut dyn Write) -> std::io::Result<()> {
    if let Some(at) = image.first_non_finite() {
        let (pixel, channel) = (at / image.channels.max(1), at % image.channels.max(1));
        return Err(invalid(format!("pixel {pixel}, channel {channel} is not finite")));
    }
    write_png8(image.width, image.height, image.channels, &bytes8(image), out)
}

/// The values of an image, 0 to 1, as bytes: clamped and rounded; what is not a number is 0.
pub fn bytes8(image: &Image) -> Vec<u8> {
    image.data.iter().map(|v| (v * 255.0).round().clamp(0.0, 255.0) as u8).collect()
}

fn invalid(text: String) -> std::io::Error {
    std::io::Error::new(std::io::ErrorKind::InvalidInput, text)
}

/// Writes bytes of 1 (grey), 3 (RGB) or 4 (RGBA) channels as PNG.
///
/// # Errors
/// As [`write_png`].
pub fn write_png8(
    width: usize,
    height: usize,
    channels: usize,
    bytes: &[u8],
    out: &mut dyn Write,
) -> std::io::Result<()> {
    let color = match channels {
        1 => ExtendedColorType::L8,
        3 => ExtendedColorType::Rgb8,
        4 => ExtendedColorType::Rgba8,
        other => return Err(invalid(format!("{other} channels; a PNG holds 1, 3 or 4"))),
    };
    let product = width.checked_mul(height).and_then(|p| p.checked_mul(channels));
    let (Ok(w), Ok(h), true) = (u32::try_from(width), u32::try_from(height), product == Some(bytes.len())) else {
        return Err(invalid(format!("{width}x{height}x{channels} does not hold {} bytes", bytes.len())));
    };
    PngEncoder::new(out).write_image(bytes, w, h, color).map_err(std::io::Error::other)
}

/// Writes an image as an 8-bit PNG file, completely or not at all.
///
/// # Errors
/// As [`write_png`] and [`write_file`].
pub fn save_png(path: &Path, image: &Image, overwrite: bool) -> Result<(), IoError> {
    write_file(path, overwrite, |out| write_png(image, out))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(channels: usize) -> Image {
        let data = (0..5 * 4 * channels).map(|i| (i % 256) as f32 / 255.0).collect();
        Image::from_data(5, 4, channels, data).unwrap()
    }

    fn png(image: &Image) -> Vec<u8> {
        let mut out = Vec::new();
        write_png(image, &mut out).unwrap();
        out
    }

    fn jpeg() -> Vec<u8> {
        let mut out = Vec::new();
        let bytes: Vec<u8> = (0..16 * 16 * 3).map(|i| (i / 3) as u8).collect();
        let encoder = ::image::codecs::jpeg::JpegEncoder::new_with_quality(&mut out, 95);
        encoder.write_image(&bytes, 16, 16, ExtendedColorType::Rgb8).unwrap();
        out
    }

    #[test]
    fn eight_bit_images_round_trip() {
        for channels in [1, 3, 4] {
            let image = ramp(channels);
            let bytes = png(&image);
            assert_eq!(decode_image(&bytes, "t.png", &Limits::default()).unwrap(), image);
            assert_eq!(image_size(&bytes, "t.png", &Limits::default()).unwrap(), (5, 4));
            let rgba = decode_rgba8(&bytes, "t.png", &Limits::default()).unwrap();
            assert_eq!((rgba.width, rgba.height, rgba.data.len()), (5, 4, 80));
            if channels == 4 {
                assert_eq!(rgba.to_image(), image);
            }
        }
        let rounding = Image::from_data(4, 1, 1, vec![-0.5, 0.5, 2.0, 0.49 / 255.0]).unwrap();
        assert_eq!(
            decode_rgba8(&png(&rounding), "t", &Limits::default()).unwrap().data[..8],
            [0, 0, 0, 255, 128, 128, 128, 255]
        );
    }

    #[test]
    fn sixteen_bits_keep_their_precision() {
        let mut out = Vec::new();
        let raw: Vec<u8> = [1000u16, 65_535].iter().flat_map(|v| v.to_ne_bytes()).collect();
        PngEncoder::new(&mut out).write_image(&raw, 2, 1, ExtendedColorType::L16).unwrap();
        let image = decode_image(&out, "t.png", &Limits::default()).unwrap();
        assert_eq!(image.data, [1000.0 / 65_535.0, 1.0]);
    }

    #[test]
    fn jpeg_is_read_and_a_cut_one_refused_at_every_byte() {
        let bytes = jpeg();
        let image = decode_image(&bytes, "t.jpg", &Limits::default()).unwrap();
        assert_eq!(image.shape(), (16, 16, 3));
        let worst =
            image.data.chunks(3).enumerate().map(|(i, p)| (p[1] - (i % 256) as f32 / 255.0).abs()).fold(0.0, f32::max);
        assert!(worst < 0.05, "{worst}");
        for cut in 0..bytes.len() {
            assert!(decode_rgba8(&bytes[..cut], "t.jpg", &Limits::default()).is_err(), "{cut}");
        }
        // A video behind the image, with what would be a scan of a JPEG.
        let more = [&bytes[..], &[0, 0, 0, 24, 0xff, 0xda, 0xff, 0x00]].concat();
        assert_eq!(decode_image(&more, "t.jpg", &Limits::default()).unwrap(), image);
    }

    /// A progressive file of 8x8 grey pixels in six scans, with tables between them.
    const PROGRESSIVE: &str = "ffd8ffe000104a46494600010100000100010000ffdb0043001b12141714111b1716171e1c1b2028422b28\
        252528513a3d3042605565645f555d5b6a7899816a7190735b5d85b586909ea3abadab6780bcc9baa6c799a8aba4ffc2000b08000800080\
        1011100ffc40014000100000000000000000000000000000002ffda00080101000000011fffc40015100101000000000000000000000000\
        00000003ffda000801010001050283ffc40014100100000000000000000000000000000000ffda0008010100063f027fffc400161000030\
        000000000000000000000000000000131ffda0008010100013f21587fffda0008010100000010ff00ffc400141001000000000000000000\
        00000000000000ffda0008010100013f100fffd9";

    #[test]
    fn a_jpeg_of_several_scans_ends_after_the_last() {
        let byte = |k: usize| u8::from_str_radix(&PROGRESSIVE[2 * k..2 * k + 2], 16).unwrap();
        let bytes: Vec<u8> = (0..PROGRESSIVE.len() / 2).map(byte).collect();
        let image = decode_rgba8(&bytes, "t.jpg", &Limits::default()).unwrap();
        assert!((image.width, image.height) == (8, 8) && image.data[0] < 30 && image.data[7 * 4] > 180);
        for cut in 0..bytes.len() {
            assert!(decode_rgba8(&bytes[..cut], "t.jpg", &Limits::default()).is_err(), "{cut}");
        }
        // Restart markers and repeated FF in a scan end nothing, nor does the end of a thumbnail in a segment.
        let scan = [&[0xff, 0xd8, 0xff, 0xe1, 0, 4, 0xff, 0xd9, 0xff, 0xda, 0, 2][..], &[7, 0xff, 0xd0, 8, 0xff, 0xff]]
            .concat();
        let ends = |bytes: &[u8]| jpeg_ends(&mut &*bytes).unwrap();
        assert!(ends(&[&scan[..], &[0xd9]].concat()));
        assert!(!ends(&scan) && !ends(&[&scan[..], &[0xd8, 0xff, 0xd9]].concat()), "another image is not its end");
        assert!(!ends(&[0xff, 0xd8, 0xff, 0xd9]), "no scan");
    }

    #[test]
    fn errors_are_named() {
        let error = |bytes: &[u8], limits: &Limits| decode_rgba8(bytes, "t", limits).unwrap_err().to_string();
        let bytes = png(&ramp(4));
        assert!(error(b"GIF89a", &Limits::default()).contains("not supported"));
        assert!(error(&bytes, &Limits { max_side: 4, ..Limits::default() }).contains("limits"));
        let tight = Limits { max_image_bytes: 100, ..Limits::default() };
        assert!(error(&bytes, &tight).contains("limit"));
        for cut in 0..bytes.len() - 12 {
            assert!(decode_rgba8(&bytes[..cut], "t.png", &Limits::default()).is_err(), "{cut}");
        }
        let mut nan = ramp(3);
        nan.data[7] = f32::NAN;
        assert!(write_png(&nan, &mut Vec::new()).unwrap_err().to_string().contains("pixel 2, channel 1"));
        assert!(write_png(&ramp(2), &mut Vec::new()).unwrap_err().to_string().contains("2 channels"));
        assert!(write_png8(2, 2, 1, &[0], &mut Vec::new()).unwrap_err().to_string().contains("2x2x1"));
    }

    #[test]
    fn files_round_trip() {
        let path = tempfile::tempdir().unwrap().keep().join("a.png");
        save_png(&path, &ramp(3), false).unwrap();
        assert_eq!(load_image(&path, &Limits::default()).unwrap(), ramp(3));
        assert_eq!(load_rgba8(&path, &Limits::default()).unwrap().width, 5);
        std::fs::remove_dir_all(path.parent().unwrap()).unwrap();
    }
}
