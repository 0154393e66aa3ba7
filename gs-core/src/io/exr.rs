//! OpenEXR in `f32` (the `exr` crate): flat images with channels R, G, B(, A), or a single one.
//!
//! Values are not converted. EXR usually holds linear light, while colours elsewhere in this crate are display-encoded:
//! the caller converts. Reading takes the first layer at its largest resolution; the
//! image is the **display window**, zero outside the data window. Half floats become `f32`. Deep, luminance-
//! chroma and subsampled images are refused by name; values that are not finite are refused with their count.
//! Writing stores `f32` with ZIP compression (lossless). [`save_channels`] and [`read_channels`] take any number of named
//! channels.
//!
//! ```
//! use gs_core::{Image, io::{Limits, exr}};
//!
//! let image = Image::from_data(2, 1, 1, vec![-0.5, 1e6])?;
//! let mut bytes = Vec::new();
//! exr::write(&image, &mut bytes)?;
//! assert_eq!(exr::read(&bytes, "depth.exr", &Limits::default())?, image);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use super::error::{At, Source};
use super::{IoError, Limits, read_file, write_file};
use crate::image::Image;
use ::exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image as ExrImage, Layer};
use ::exr::meta::MetaData;
use ::exr::meta::attribute::{LineOrder, SampleType};
use ::exr::meta::header::{Header, LayerAttributes};
use ::exr::prelude::{Blocks, Compression, ReadChannels, ReadLayers, WritableImage, f16};
use std::io::{Cursor, Write};
use std::path::Path;

/// Reads an EXR file of 1, 3 or 4 channels.
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
    let image = assemble(&decode(bytes, src)?, header, names);
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

/// The first layer, at its largest resolution.
fn decode(bytes: &[u8], src: Source<'_>) -> Result<Flat, IoError> {
    let reader = ::exr::prelude::read().no_deep_data().largest_resolution_level().all_channels();
    let reader = reader.first_valid_layer().all_attributes().non_parallel();
    reader.from_buffered(Cursor::new(bytes)).map_err(|e| broken(&e, src))
}

fn broken(error: &::exr::error::Error, src: Source<'_>) -> IoError {
    src.malformed(
        At::Byte(0),
        error.to_string(),
        "the file is damaged, cut short or of a kind not read: export it again",
    )
}

/// Checks the header against the limits; returns the names of the channels to read.
fn check_header<'a>(
    header: &Header,
    layers: usize,
    file_len: usize,
    limits: &Limits,
    src: Source<'_>,
) -> Result<&'a [&'a str], IoError> {
    check_kind(header, src)?;
    let channels = &header.channels.list;
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

/// Refuses deep and subsampled images.
fn check_kind(header: &Header, src: Source<'_>) -> Result<(), IoError> {
    if header.deep {
        return Err(src.unsupported("deep EXR", "flatten it"));
    }
    match header.channels.list.iter().find(|c| c.sampling.x() != 1 || c.sampling.y() != 1) {
        Some(c) => Err(src.unsupported(format!("EXR with subsampled channel {}", c.name), "export it as RGB")),
        None => Ok(()),
    }
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
    encode((image.width, image.height), names.iter().enumerate().map(channel).collect(), out)
}

fn encode(size: (usize, usize), channels: Vec<AnyChannel<FlatSamples>>, out: &mut dyn Write) -> std::io::Result<()> {
    let encoding =
        Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let layer = Layer::new(size, LayerAttributes::default(), encoding, AnyChannels::sort(channels.into()));
    let mut bytes = Cursor::new(Vec::new());
    ExrImage::from_layer(layer).write().non_parallel().to_buffered(&mut bytes).map_err(std::io::Error::other)?;
    out.write_all(bytes.get_ref())
}

/// Writes an image as an EXR file, completely or not at all.
///
/// # Errors
/// As [`write()`] and [`write_file`].
pub fn save(path: &Path, image: &Image, overwrite: bool) -> Result<(), IoError> {
    write_file(path, overwrite, |out| write(image, out))
}

/// One named channel of a file: a value per pixel, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Name of the channel; `layer.component` puts it into a layer.
    pub name: String,
    /// Whether the file stores half floats.
    pub half: bool,
    /// The `width · height` values, row-major.
    pub values: Vec<f32>,
}

/// Writes channels of one size `(width, height)` as an EXR file, completely or not at all; as half floats where
/// [`Channel::half`] is set.
///
/// # Errors
/// No channel or pixel, another number of values, repeated names or names with an empty part, values beyond the range of
/// half floats (as `InvalidInput`), and those of [`write_file`].
pub fn save_channels(
    path: &Path,
    (width, height): (usize, usize),
    channels: &[Channel],
    overwrite: bool,
) -> Result<(), IoError> {
    let sample = |c: &Channel| {
        let half = || FlatSamples::F16(c.values.iter().map(|&v| f16::from_f32(v)).collect());
        AnyChannel::new(c.name.as_str(), if c.half { half() } else { FlatSamples::F32(c.values.clone()) })
    };
    write_file(path, overwrite, |out| {
        check_channels(width, height, channels)
            .map_err(|text| std::io::Error::new(std::io::ErrorKind::InvalidInput, text))?;
        encode((width, height), channels.iter().map(sample).collect(), out)
    })
}

fn check_channels(width: usize, height: usize, channels: &[Channel]) -> Result<(), String> {
    let pixels = width.saturating_mul(height);
    if channels.is_empty() || pixels == 0 {
        return Err(format!("{} channels of {width}x{height}; EXR needs at least one of each", channels.len()));
    }
    let mut names: Vec<&str> = channels.iter().map(|c| c.name.as_str()).collect();
    names.sort_unstable();
    if let Some(pair) = names.windows(2).find(|pair| pair.first() == pair.last()) {
        return Err(format!("channel {pair:?} appears twice"));
    }
    for c in channels {
        if c.name.split('.').any(str::is_empty) || !c.name.is_ascii() || c.name.len() > 31 {
            return Err(format!("channel name `{}` must be 1 to 31 ASCII letters without an empty part", c.name));
        }
        if c.values.len() != pixels {
            return Err(format!("channel {} has {} values for {width}x{height}", c.name, c.values.len()));
        }
        let bad = c.values.iter().find(|v| c.half && v.is_finite() && v.abs() > f16::MAX.to_f32());
        if let Some(v) = bad {
            return Err(format!("channel {} holds {v}, beyond half floats; store it as f32", c.name));
        }
    }
    Ok(())
}

/// Reads all channels of an EXR file's first layer, over its data window: `((width, height), channels)`, by name. `file` is
/// the name used in errors.
///
/// # Errors
/// Damaged or unsupported content, more than the limits allow, values that are not finite.
pub fn read_channels(bytes: &[u8], file: &str, limits: &Limits) -> Result<((usize, usize), Vec<Channel>), IoError> {
    let src = Source { file, format: "EXR" };
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(|e| broken(&e, src))?;
    let Some(header) = meta.headers.first() else {
        return Err(src.malformed(At::Byte(8), "no layer", "export the image again"));
    };
    check_kind(header, src)?;
    let (width, height) = (header.layer_size.x(), header.layer_size.y());
    if width == 0 || height == 0 {
        return Err(src.malformed(At::Byte(8), "the data window is empty", "export the image again"));
    }
    // As stored, in the block reader and as f32.
    let per_pixel = 12 * header.channels.list.len() as u64;
    limits.image(src, (width as u64, height as u64), per_pixel, bytes.len())?;
    let file = decode(bytes, src)?;
    let mut out = Vec::new();
    for channel in &file.layer_data.channel_data.list {
        let values: Vec<f32> = channel.sample_data.values_as_f32().collect();
        let bad = values.iter().position(|v| !v.is_finite());
        if let (Some(at), false) = (bad, limits.allow_non_finite) {
            let what = format!("channel {} is not finite at x {} y {}", channel.name, at % width, at / width);
            return Err(src.malformed(At::Row(at as u64), what, "repair the image"));
        }
        let half = matches!(channel.sample_data, FlatSamples::F16(_));
        out.push(Channel { name: channel.name.to_string(), half, values });
    }
    Ok(((width, height), out))
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

    #[test]
    fn named_channels_round_trip_and_invalid_ones_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("named.exr");
        let channel = |name: &str, half, scale: f32| {
            let values = (0..35).map(|i| i as f32 * scale).collect();
            Channel { name: name.into(), half, values }
        };
        let sorted = [channel("D.X", false, 0.37), channel("T1.G", true, 0.5), channel("T1.R", true, -2.0)];
        let given = [sorted[2].clone(), sorted[0].clone(), sorted[1].clone()];
        save_channels(&path, (7, 5), &given, false).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let (size, back) = read_channels(&bytes, "t.exr", &Limits::default()).unwrap();
        assert_eq!((size, back), ((7, 5), sorted.to_vec()));
        for cut in 0..bytes.len() {
            assert!(read_channels(&bytes[..cut], "t.exr", &Limits::default()).is_err(), "{cut}");
        }
        let tight = Limits { max_image_bytes: 300, ..Limits::default() };
        assert!(read_channels(&bytes, "t.exr", &tight).unwrap_err().to_string().contains("image memory"));
        let fails = |channels: &[Channel], part: &str| {
            let text = save_channels(&path, (7, 5), channels, true).unwrap_err().to_string();
            assert!(text.contains(part), "{text}");
        };
        fails(&[], "0 channels");
        fails(&[channel("a", false, 1.0), channel("a", true, 1.0)], "twice");
        fails(&[channel("a..b", false, 1.0)], "empty part");
        fails(&[channel("a", true, 1e4)], "beyond half floats");
        fails(&[Channel { name: "a".into(), half: false, values: vec![0.0; 34] }], "34 values");
        assert_eq!(std::fs::read(&path).unwrap(), bytes, "a refused write keeps the old file");
    }
}
