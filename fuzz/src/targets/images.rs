//! Images.

use super::{Error, Target, as_it_is, written};
use crate::case::Case;
use gs_core::io::{Limits, exr, images};
use gs_core::{Image, Rng};
use image::ImageEncoder;
use std::path::Path;

pub fn targets() -> Vec<Target> {
    vec![
        Target { name: "png", share: 1, seeds: png_seeds, repair: repair_png, run: |c, _| decode(c.first(), "i.png") },
        Target { name: "jpeg", share: 6, seeds: jpeg_seeds, repair: as_it_is, run: |c, _| decode(c.first(), "i.jpg") },
        Target { name: "exr", share: 3, seeds: exr_seeds, repair: as_it_is, run: |c, _| read_exr(c.first()) },
    ]
}

/// A picture without two equal pixels in a row.
pub fn picture(width: usize, height: usize, channels: usize) -> Result<Image, Error> {
    let data = (0..width * height * channels).map(|i| (i * 37 % 256) as f32 / 255.0).collect();
    Ok(Image::from_data(width, height, channels, data)?)
}

pub fn png(width: usize, height: usize, channels: usize) -> Result<Vec<u8>, Error> {
    let image = picture(width, height, channels)?;
    written(|out| images::write_png(&image, out))
}

pub fn jpeg(width: u32, height: u32) -> Result<Vec<u8>, Error> {
    let bytes: Vec<u8> = (0..width * height * 3).map(|i| (i * 7 % 251) as u8).collect();
    written(|out| {
        let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(out, 30);
        encoder.write_image(&bytes, width, height, image::ExtendedColorType::Rgb8)
    })
}

fn png_seeds(_: &Path) -> Result<Vec<Case>, Error> {
    let mut seeds = vec![Case::one("a", png(9, 7, 4)?), Case::one("a", png(5, 3, 3)?), Case::one("a", png(8, 8, 1)?)];
    let wide: Vec<u8> = (0..6 * 5 * 8).map(|i| (i * 11) as u8).collect();
    let sixteen = written(|out| {
        let encoder = image::codecs::png::PngEncoder::new(out);
        encoder.write_image(&wide, 6, 5, image::ExtendedColorType::Rgba16)
    })?;
    seeds.push(Case::one("a", sixteen));
    Ok(seeds)
}

fn jpeg_seeds(_: &Path) -> Result<Vec<Case>, Error> {
    Ok(vec![Case::one("a", jpeg(8, 8)?), Case::one("a", jpeg(24, 16)?)])
}

fn exr_seeds(_: &Path) -> Result<Vec<Case>, Error> {
    let of = |image: &Image| Ok::<_, Error>(Case::one("a", written(|out| exr::write(image, out))?));
    Ok(vec![of(&picture(9, 20, 3)?)?, of(&picture(4, 3, 4)?)?])
}

/// Makes the checksums of a PNG's chunks right.
pub fn repair_png(case: &mut Case, _: &mut Rng) {
    for file in &mut case.0 {
        if file.bytes.starts_with(b"\x89PNG") {
            png_checksums(&mut file.bytes);
        }
    }
}

fn png_checksums(bytes: &mut [u8]) {
    let mut at = 8;
    while let Some(length) = bytes.get(at..at + 4).and_then(|b| b.first_chunk()) {
        let end = at.saturating_add(8).saturating_add(u32::from_be_bytes(*length) as usize);
        let Some(crc) = bytes.get(at + 4..end).map(crc32fast::hash) else { return };
        let Some(slot) = bytes.get_mut(end..end + 4) else { return };
        slot.copy_from_slice(&crc.to_be_bytes());
        at = end + 4;
    }
}

fn decode(bytes: &[u8], name: &str) -> Result<(), String> {
    let limits = Limits::default();
    let size = images::image_size(bytes, name, &limits).map_err(|e| e.to_string())?;
    let image = images::decode_image(bytes, name, &limits).map_err(|e| e.to_string())?;
    assert_eq!(image.data.len(), image.width * image.height * image.channels);
    assert_eq!(size, (image.width as u32, image.height as u32), "the header and the image");
    images::decode_rgba8(bytes, name, &limits).map(|_| ()).map_err(|e| e.to_string())
}

fn read_exr(bytes: &[u8]) -> Result<(), String> {
    let limits = Limits::default();
    let channels = exr::read_channels(bytes, "i.exr", &limits).map(|_| ()).map_err(|e| e.to_string());
    let image = exr::read(bytes, "i.exr", &limits).map_err(|e| e.to_string())?;
    assert!(image.first_non_finite().is_none(), "a value that is not finite");
    channels
}
