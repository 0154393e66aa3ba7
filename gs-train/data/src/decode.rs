//! PNG and JPEG to 8-bit RGBA under a memory limit, in one buffer.

use std::fs::File;
use std::io::{BufReader, Seek};
use std::path::Path;

use gs_core::camera::MAX_SIDE;
use gs_core::cast;
use gs_core::io::images::jpeg_ends;
use image::codecs::{jpeg::JpegDecoder, png::PngDecoder};
use image::metadata::Orientation;
use image::{ColorType, ImageDecoder, Limits};

use super::error::{DataError, Place};
use super::files::open_regular;
use super::header::{self, Format, ImageHeader};
use super::pixels::ImageU8;

/// Memory that every image may take, whatever the size of its file.
const BASE_BYTES: u64 = 64 << 20;
/// Additional bytes in memory per byte of file.
const BYTES_PER_FILE_BYTE: u64 = 8;

/// Decodes a PNG (1 to 16 bit) or JPEG file to 8-bit RGBA; grey is repeated, missing alpha is 255. `max_bytes` bounds the memory
/// of decoding; none: 64 MiB plus eight times the size of the file.
///
/// ```
/// # let folder = tempfile::tempdir()?;
/// let file = folder.path().join("grey.png");
/// image::GrayImage::from_pixel(3, 2, image::Luma([7])).save(&file)?;
/// let image = gs_data::decode::decode(&file, None)?;
/// assert_eq!((image.width, image.height, image.pixel(2, 1)), (3, 2, [7, 7, 7, 255]));
/// assert_eq!(gs_data::decode::decode(&file, Some(4)).unwrap_err().code(), "limits.file");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// `data.image` if the file is damaged, cut or neither PNG nor JPEG, `limits.file` beyond the limit, `io.read` if it cannot be read.
pub fn decode(file: &Path, max_bytes: Option<u64>) -> Result<ImageU8, DataError> {
    let header = header::read(file)?;
    let (mut reader, limits, limit) = limited(file, &header, max_bytes)?;
    let failed = |e: image::ImageError| DataError::decode(file, e);
    match header.format {
        Format::Png => rgba(file, PngDecoder::with_limits(reader, limits).map_err(failed)?, limit),
        Format::Jpeg => {
            check_end(file, &mut reader)?;
            let mut decoder = JpegDecoder::new(reader).map_err(failed)?;
            decoder.set_limits(limits).map_err(failed)?;
            rgba(file, decoder, limit)
        }
    }
}

/// Width and height of a PNG or JPEG file as it is stored, by its header alone: an image of any size is read.
///
/// ```
/// # let folder = tempfile::tempdir()?;
/// let file = folder.path().join("grey.png");
/// image::GrayImage::new(3, 2).save(&file)?;
/// assert_eq!(gs_data::decode::stored_size(&file)?, [3, 2]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// `data.image` if it is neither PNG nor JPEG or ends before its size is known, `io.read` if it cannot be read.
pub fn stored_size(file: &Path) -> Result<[u32; 2], DataError> {
    header::read(file).map(|h| [h.width, h.height])
}

/// Refuses a JPEG that was cut: its decoder would fill what is missing with grey. Leaves the reader at the beginning.
fn check_end(file: &Path, reader: &mut BufReader<File>) -> Result<(), DataError> {
    let failed = |e| DataError::read(file, e);
    if !jpeg_ends(reader).map_err(failed)? {
        return Err(DataError::decode(file, "it was cut: there is no end marker after its last scan"));
    }
    reader.rewind().map_err(failed)
}

/// The EXIF orientation of an image whose sides change places by it; none where there is none, or it keeps them.
pub(crate) fn quarter_turn(file: &Path) -> Option<Orientation> {
    use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    let format = header::read(file).ok()?.format;
    // No pixel is decoded here: how many there are does not matter.
    let (reader, limits, _) = opened(file, None).ok()?;
    let orientation = match format {
        Format::Png => PngDecoder::with_limits(reader, limits).ok()?.orientation(),
        Format::Jpeg => JpegDecoder::new(reader).ok()?.orientation(),
    };
    orientation.ok().filter(|o| matches!(o, Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH))
}

/// An image as an orientation says that it is looked at.
pub(crate) fn turned(image: ImageU8, orientation: Orientation) -> ImageU8 {
    let [width, height] = [image.width, image.height].map(cast::to_u32);
    let Some(pixels) = image::RgbaImage::from_raw(width, height, image.data) else { return ImageU8::default() };
    let mut whole = image::DynamicImage::ImageRgba8(pixels);
    whole.apply_orientation(orientation);
    let pixels = whole.into_rgba8();
    ImageU8 { width: pixels.width() as usize, height: pixels.height() as usize, data: pixels.into_raw() }
}

/// A reader of a file, and the limits it is decoded under: the last is of memory, bytes.
pub(crate) fn limited(
    file: &Path,
    header: &ImageHeader,
    max_bytes: Option<u64>,
) -> Result<(BufReader<File>, Limits, u64), DataError> {
    let (reader, limits, limit) = opened(file, max_bytes)?;
    check_size(file, header, limit)?;
    Ok((reader, limits, limit))
}

/// The same, however many pixels the file has.
fn opened(file: &Path, max_bytes: Option<u64>) -> Result<(BufReader<File>, Limits, u64), DataError> {
    let open = open_regular(file)?;
    let file_bytes = open.metadata().map_err(|e| DataError::read(file, e))?.len();
    let limit = max_bytes.unwrap_or(BASE_BYTES.saturating_add(file_bytes.saturating_mul(BYTES_PER_FILE_BYTE)));
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(limit);
    Ok((BufReader::new(open), limits, limit))
}

fn check_size(file: &Path, header: &ImageHeader, limit: u64) -> Result<(), DataError> {
    let pixels = u64::from(header.width) * u64::from(header.height);
    let bytes = pixels.saturating_mul(header.bytes_per_pixel);
    if header.width > MAX_SIDE || header.height > MAX_SIDE || bytes > limit {
        let place = Place::new(file, format!("image of {}x{}", header.width, header.height));
        return Err(DataError::TooLarge { place, bytes, limit });
    }
    Ok(())
}

fn rgba(file: &Path, decoder: impl ImageDecoder, limit: u64) -> Result<ImageU8, DataError> {
    let (width, height) = decoder.dimensions();
    let color = decoder.color_type();
    let bytes_per_pixel = usize::from(color.bytes_per_pixel());
    let header = ImageHeader {
        width,
        height,
        has_alpha: false,
        format: Format::Png,
        bytes_per_pixel: bytes_per_pixel.max(4) as u64,
    };
    check_size(file, &header, limit)?;
    let pixels = width as usize * height as usize;
    let mut data = Vec::new();
    let bytes = pixels * bytes_per_pixel.max(4);
    data.try_reserve_exact(bytes).map_err(|e| DataError::decode(file, e))?;
    data.resize(bytes, 0);
    decoder.read_image(&mut data[..pixels * bytes_per_pixel]).map_err(|e| DataError::decode(file, e))?;
    to_rgba8(&mut data, pixels, color).map_err(|m| DataError::decode(file, m))?;
    Ok(ImageU8 { width: width as usize, height: height as usize, data })
}

/// Widens or narrows the pixels in place, in the direction in which no pixel is overwritten before it is read.
fn to_rgba8(data: &mut Vec<u8>, pixels: usize, color: ColorType) -> Result<(), String> {
    let step = usize::from(color.bytes_per_pixel());
    let mut convert = |i: usize| {
        let p = &data[i * step..(i + 1) * step];
        let wide = |k: usize| narrow(u16::from_ne_bytes([p[2 * k], p[2 * k + 1]]));
        let q = match color {
            ColorType::L8 => [p[0], p[0], p[0], 255],
            ColorType::La8 => [p[0], p[0], p[0], p[1]],
            ColorType::Rgb8 => [p[0], p[1], p[2], 255],
            ColorType::Rgba8 => [p[0], p[1], p[2], p[3]],
            ColorType::L16 => [wide(0), wide(0), wide(0), 255],
            ColorType::La16 => [wide(0), wide(0), wide(0), wide(1)],
            ColorType::Rgb16 => [wide(0), wide(1), wide(2), 255],
            ColorType::Rgba16 => [wide(0), wide(1), wide(2), wide(3)],
            other => return Err(format!("pixels of kind {other:?} are not supported")),
        };
        data[i * 4..i * 4 + 4].copy_from_slice(&q);
        Ok(())
    };
    if step <= 4 {
        (0..pixels).rev().try_for_each(&mut convert)?;
    } else {
        (0..pixels).try_for_each(&mut convert)?;
    }
    data.truncate(pixels * 4);
    data.shrink_to_fit();
    Ok(())
}

/// 16 to 8 bit, rounded to nearest.
#[expect(clippy::cast_possible_truncation, reason = "65 535 becomes 255")]
fn narrow(v: u16) -> u8 {
    ((u32::from(v) * 255 + 32_767) / 65_535) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{DynamicImage, ImageBuffer};

    /// The same 5×3 picture in every kind of pixel a PNG can hold, read back as RGBA.
    #[test]
    fn every_kind_of_pixel_becomes_rgba() {
        let dir = tempfile::tempdir().unwrap();
        let source = ImageBuffer::from_fn(5, 3, |x, y| {
            image::Rgba([x as u16 * 9000, y as u16 * 20000, 700, 65535 - x as u16 * 5000])
        });
        let full = DynamicImage::ImageRgba16(source);
        let kinds = [
            full.to_rgba16().into(),
            full.to_rgba8().into(),
            full.to_rgb16().into(),
            full.to_rgb8().into(),
            full.to_luma16().into(),
            full.to_luma8().into(),
            full.to_luma_alpha16().into(),
            DynamicImage::from(full.to_luma_alpha8()),
        ];
        for (k, kind) in kinds.iter().enumerate() {
            let file = dir.path().join(format!("{k}.png"));
            kind.save(&file).unwrap();
            let got = decode(&file, None).unwrap();
            let want = kind.to_rgba8();
            for (a, b) in got.data.iter().zip(want.as_raw()) {
                assert!(a.abs_diff(*b) <= 1, "kind {k}: {a} against {b}");
            }
            let header = header::read(&file).unwrap();
            assert_eq!((header.width, header.height, header.has_alpha), (5, 3, kind.color().has_alpha()));
        }
    }

    #[test]
    fn jpeg_sizes_are_found_and_pixels_decoded() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("a.jpg");
        image::RgbImage::from_pixel(17, 9, image::Rgb([200, 100, 50])).save(&file).unwrap();
        let header = header::read(&file).unwrap();
        assert_eq!((header.width, header.height, header.format), (17, 9, Format::Jpeg));
        let got = decode(&file, None).unwrap();
        assert_eq!((got.width, got.height, got.data.len()), (17, 9, 17 * 9 * 4));
        assert!(got.pixel(8, 4)[0].abs_diff(200) < 4 && got.pixel(8, 4)[3] == 255);
    }

    #[test]
    fn a_jpeg_that_was_cut_is_refused_at_every_byte_and_more_behind_it_is_not() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("a.jpg");
        image::RgbImage::from_fn(16, 8, |x, _| image::Rgb([x as u8 * 15; 3])).save(&file).unwrap();
        let (whole, picture) = (std::fs::read(&file).unwrap(), decode(&file, None).unwrap());
        // A new file each time: truncating one in place makes some file systems wait for the disk.
        let written = |name: String, bytes: &[u8]| {
            let file = dir.path().join(name);
            std::fs::write(&file, bytes).unwrap();
            decode(&file, None)
        };
        for cut in 0..whole.len() {
            let e = written(format!("{cut}.jpg"), &whole[..cut]).unwrap_err();
            assert_eq!(e.code(), "data.image", "{cut} of {} bytes: {e}", whole.len());
        }
        let more = [&whole[..], &[0, 0xff, 0xda, 0xff, 0x00]].concat();
        assert_eq!(written("more.jpg".into(), &more).unwrap(), picture);
    }

    #[test]
    fn limits_come_before_allocation() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("a.png");
        image::RgbImage::new(64, 64).save(&file).unwrap();
        let e = decode(&file, Some(1000)).unwrap_err();
        assert!(matches!(e, DataError::TooLarge { bytes: 16384, limit: 1000, .. }), "{e}");
    }

    #[test]
    fn an_orientation_is_found_however_large_the_image_is() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("a.jpg");
        let mut jpeg = Vec::new();
        let mut encoder = image::codecs::jpeg::JpegEncoder::new(&mut jpeg);
        let exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
        image::ImageEncoder::set_exif_metadata(&mut encoder, exif.to_vec()).unwrap();
        encoder.encode_image(&image::RgbImage::new(16, 8)).unwrap();
        // Its frame header says 8000x4000: 128 MB of pixels.
        let frame = jpeg.windows(2).position(|marker| marker == [0xff, 0xc0]).unwrap();
        jpeg[frame + 5..frame + 9].copy_from_slice(&[4000u16, 8000].map(u16::to_be_bytes).concat());
        std::fs::write(&file, jpeg).unwrap();
        assert_eq!(decode(&file, None).unwrap_err().code(), "limits.file");
        assert_eq!(stored_size(&file).unwrap(), [8000, 4000]);
        assert_eq!(quarter_turn(&file), Some(Orientation::Rotate90));
    }
}
