//! OpenEXR in `f32` (the `exr` crate): flat images with channels R, G, B(, A), or a single one.
//!
//! Values are passed as they are. By custom EXR holds linear light, while colours elsewhere in this crate are
//! display-encoded: the caller converts where that matters. Reading takes the first layer at its largest resolution; the
//! image is the **display window**, zero where the data window does not reach. Half floats become `f32`. Deep, luminance-
//! chroma and subsampled images are refused by name; values that are not finite are refused with their number.
//! Writing stores `f32` with ZIP compression (lossless).

use super::error::{At, Source};
use super::{IoError, Limits, read_file, write_file};
use crate::image::Image;
use ::exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image as ExrImage, Layer};
use ::exr::meta::MetaData;
use ::exr::meta::attribute::{LineOrder, SampleType};
use ::exr::meta::header::{Header, LayerAttributes};
use ::exr::prelude::{Blocks, Compression, ReadChannels, ReadLayers, WritableImage};
use std::io::{Cursor, Write};
use std::path::Path;

/// First bytes of every EXR file.
pub(super) const MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// Reads an EXR file.
///
/// # Errors
/// As [`read_file`] and [`read`].
pub fn load(path: &Path, limits: &Limits) -> Result<Image, IoError> {
    read(&read_file(path, limits)?, &path.display().to_string(), limits)
}

/// Reads EXR bytes: one channel, or three (R, G, B), or four (with A). `file` is the name used in errors.
///
/// # Errors
/// Damaged or unsupported content, more than the limits allow, values that are not finite.
pub fn read(bytes: &[u8], file: &str, limits: &Limits) -> Result<Image, IoError> {
    let src = Source { file, format: "EXR" };
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(|e| broken(&e, src))?;
    let Some(header) = meta.headers.first() else {
        return Err(src.malformed(At::Byte(8), "no layer", "export the image again"));
    };
    let names = check_header(header, meta.headers.len(), bytes.len(), limits, src)?;
    let reader = ::exr::prelude::read().no_deep_data().largest_resolution_level().all_channels();
    let reader = reader.first_valid_layer().all_attributes().non_parallel();
    let file = reader.from_buffered(Cursor::new(bytes)).map_err(|e| broken(&e, src))?;
    let image = assemble(&file, header, names);
    let bad = image.data.iter().filter(|v| !v.is_finite()).count();
    if let (Some(at), false) = (image.first_non_finite(), limits.allow_non_finite) {
        let (pixel, width) = (at / image.channels, image.width);
        let what = format!(
            "{bad} of {} values are not finite, the first at x {} y {} channel {}",
            image.data.len(),
            pixel % width,
            pixel / width,
            at % image.channels
        );
        return Err(src.malformed(At::Row(pixel as u64), what, "repair the image"));
    }
    Ok(image)
}

fn broken(error: &::exr::error::Error, src: Source<'_>) -> IoError {
    src.malformed(
        At::Byte(0),
        error.to_string(),
        "the file is damaged, cut short or of a kind not read: export it again",
    )
}

/// Holds the header against the limits and names the channels to take.
fn check_header<'a>(
    header: &Header,
    layers: usize,
    file_len: usize,
    limits: &Limits,
    src: Source<'_>,
) -> Result<&'a [&'a str], IoError> {
    if header.deep {
        return Err(src.unsupported("deep EXR", "flatten it"));
    }
    let channels = &header.channels.list;
    if let Some(c) = channels.iter().find(|c| c.sampling.x() != 1 || c.sampling.y() != 1) {
        return Err(src.unsupported(format!("EXR with subsampled channel {}", c.name), "export it as RGB"));
    }
    let has = |name: &str| channels.iter().any(|c| c.name.eq(name));
    let names: &[&str] = match (has("R") && has("G") && has("B"), has("A"), channels.len()) {
        (true, true, _) => &["R", "G", "B", "A"],
        (true, false, _) => &["R", "G", "B"],
        (false, _, 1) => &[""],
        _ => return Err(src.unsupported("EXR without R, G, B or a single channel", "export it as RGB")),
    };
    let stored: u64 = channels.iter().map(|c| if c.sample_type == SampleType::F16 { 2 } else { 4 }).sum();
    let (data, display) = (header.layer_size, header.shared_attributes.display_window.size);
    let wide = |v: usize| v as u64;
    if [data.x(), data.y(), display.x(), display.y()].contains(&0) {
        return Err(src.malformed(At::Byte(8), "the data or display window is empty", "export the image again"));
    }
    // Decoded channels, with one copy in the block reader.
    limits.image(src, (wide(data.x()), wide(data.y())), 2 * stored, file_len)?;
    limits.image(src, (wide(display.x()), wide(display.y())), 4 * names.len() as u64, file_len)?;
    if layers > 64 {
        return Err(src.unsupported(format!("EXR with {layers} layers"), "export the one to be read"));
    }
    Ok(names)
}

type Flat = ExrImage<Layer<AnyChannels<FlatSamples>>>;

/// Copies the named channels (an empty name: the only one) from the data window into the display window.
fn assemble(file: &Flat, header: &Header, names: &[&str]) -> Image {
    let display = header.shared_attributes.display_window;
    let mut image = Image::zeros(display.size.x(), display.size.y(), names.len());
    let origin = header.own_attributes.layer_position;
    let shift_x = i64::from(origin.x()) - i64::from(display.position.x());
    let shift_y = i64::from(origin.y()) - i64::from(display.position.y());
    let width = file.layer_data.size.x().max(1);
    for (slot, name) in names.iter().enumerate() {
        let list = &file.layer_data.channel_data.list;
        let Some(channel) = list.iter().find(|c| name.is_empty() || c.name.eq(name)) else { continue };
        for (i, value) in channel.sample_data.values_as_f32().enumerate() {
            let x = usize::try_from((i % width) as i64 + shift_x).ok().filter(|x| *x < image.width);
            let y = usize::try_from((i / width) as i64 + shift_y).ok().filter(|y| *y < image.height);
            if let (Some(x), Some(y)) = (x, y)
                && let Some(v) = image.data.get_mut((y * image.width + x) * names.len() + slot)
            {
                *v = value;
            }
        }
    }
    image
}

/// Writes an image of 1 (Y), 3 (R, G, B) or 4 (R, G, B, A) channels as `f32` EXR with ZIP compression.
///
/// # Errors
/// Another number of channels or a shape that does not fit (as `InvalidInput`), or the writer's own.
pub fn write(image: &Image, out: &mut dyn Write) -> std::io::Result<()> {
    let invalid = |text: String| std::io::Error::new(std::io::ErrorKind::InvalidInput, text);
    let names: &[&str] = match image.channels {
        1 => &["Y"],
        3 => &["R", "G", "B"],
        4 => &["R", "G", "B", "A"],
        other => return Err(invalid(format!("{other} channels; EXR is written with 1, 3 or 4"))),
    };
    let want = image.width.checked_mul(image.height).and_then(|p| p.checked_mul(image.channels));
    if want != Some(image.data.len()) || image.data.is_empty() {
        let (w, h, c) = image.shape();
        return Err(invalid(format!("{w}x{h}x{c} does not hold {} values, or is empty", image.data.len())));
    }
    let channel = |(slot, name): (usize, &&str)| {
        let values = image.data.iter().skip(slot).step_by(image.channels).copied().collect();
        AnyChannel::new(*name, FlatSamples::F32(values))
    };
    let channels = AnyChannels::sort(names.iter().enumerate().map(channel).collect());
    let encoding =
        Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let layer = Layer::new((image.width, image.height), LayerAttributes::default(), encoding, channels);
    let mut bytes = Cursor::new(Vec::new());
    ExrImage::from_layer(layer).write().non_parallel().to_buffered(&mut bytes).map_err(std::io::Error::other)?;
    out.write_all(bytes.get_ref())
}

/// Writes an image as an EXR file, whole or not at all.
///
/// # Errors
/// As [`write()`] and [`write_file`].
pub fn save(path: &Path, image: &Image, overwrite: bool) -> Result<(), IoError> {
    write_file(path, overwrite, |out| write(image, out))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(channels: usize) -> Image {
        let data = (0..7 * 5 * channels).map(|i| i as f32 * 0.37 - 3.0).collect();
        Image::from_data(7, 5, channels, data).unwrap()
    }

    fn bytes(image: &Image) -> Vec<u8> {
        let mut out = Vec::new();
        write(image, &mut out).unwrap();
        out
    }

    #[test]
    fn round_trip_is_exact() {
        for channels in [1, 3, 4] {
            assert_eq!(read(&bytes(&ramp(channels)), "t.exr", &Limits::default()).unwrap(), ramp(channels));
        }
        let dir = tempfile::tempdir().unwrap();
        save(&dir.path().join("a.exr"), &ramp(3), false).unwrap();
        assert_eq!(load(&dir.path().join("a.exr"), &Limits::default()).unwrap(), ramp(3));
    }

    #[test]
    fn non_finite_values_are_counted_and_limits_hold() {
        let mut image = ramp(3);
        image.data[3 * 9 + 1] = f32::NAN;
        image.data[100] = f32::INFINITY;
        let error = read(&bytes(&image), "t.exr", &Limits::default()).unwrap_err().to_string();
        assert!(error.contains("2 of 105 values are not finite, the first at x 2 y 1 channel 1"), "{error}");
        let lax = Limits { allow_non_finite: true, ..Limits::default() };
        assert!(read(&bytes(&image), "t.exr", &lax).unwrap().data[100].is_infinite());
        let tight = Limits { max_side: 6, ..Limits::default() };
        assert!(read(&bytes(&ramp(1)), "t.exr", &tight).unwrap_err().to_string().contains("image side = 7"));
        let tight = Limits { max_image_bytes: 300, ..Limits::default() };
        assert!(read(&bytes(&ramp(3)), "t.exr", &tight).unwrap_err().to_string().contains("image memory"));
        assert!(write(&ramp(2), &mut Vec::new()).unwrap_err().to_string().contains("2 channels"));
        assert!(write(&Image::zeros(0, 0, 3), &mut Vec::new()).is_err());
    }

    #[test]
    fn every_cut_is_an_error() {
        let whole = bytes(&ramp(3));
        for cut in 0..whole.len() {
            assert!(read(&whole[..cut], "t.exr", &Limits::default()).is_err(), "{cut}");
        }
    }
}
