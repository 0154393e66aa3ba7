//! Small good files of every format, and the readers they are for.

use flate2::{Compression, write::GzEncoder};
use glam::{DVec3, Vec3};
use gs_core::io::cameras::{NamedCamera, write_cameras};
use gs_core::io::{IoError, Limits, RawSplats, npy, parse_cameras, parse_splats, ply, splat, spz};
use gs_core::{Camera, Rng};
use std::io::{Read, Write};

/// A reader under test: takes bytes and verifies the value that it returns.
pub struct Parser {
    pub name: &'static str,
    /// Valid files.
    pub seeds: Vec<Vec<u8>>,
    pub read: fn(&[u8]) -> Result<(), IoError>,
    /// Bytes at the end whose loss may go unnoticed (the last digits of a text, an end chunk).
    pub soft_tail: usize,
    /// Whether bytes after the end are an error.
    pub strict_end: bool,
    /// Makes a mutated inner payload a file again (compression, checksums).
    pub wrap: fn(&[u8]) -> Vec<u8>,
}

pub fn cloud(n: usize, degree: u8) -> RawSplats {
    let mut out = RawSplats { degree, ..RawSplats::default() };
    for row in 0..n {
        let mut r = Rng::new(1, "hostile cloud", 0, row as u64);
        out.means.push(Vec3::new(r.normal(), r.normal(), r.normal()));
        out.quats.push([r.normal(), r.normal(), r.normal(), r.normal()]);
        out.log_scales.push(Vec3::new(r.range(-6.0, 0.0), r.range(-6.0, 0.0), r.range(-6.0, 0.0)));
        out.logit_opacities.push(r.normal());
        out.sh.extend((0..out.sh_width()).map(|_| r.normal()));
    }
    out
}

fn written(write: impl FnOnce(&mut Vec<u8>) -> std::io::Result<()>) -> Vec<u8> {
    let mut out = Vec::new();
    write(&mut out).expect("writing to memory");
    out
}

pub fn ply_binary(n: usize, degree: u8) -> Vec<u8> {
    written(|out| ply::write(&cloud(n, degree), out))
}

/// The same file as text.
pub fn ply_ascii(n: usize, degree: u8) -> Vec<u8> {
    let bytes = ply_binary(n, degree);
    let end = bytes.windows(11).position(|w| w == b"end_header\n").expect("header end") + 11;
    let header = String::from_utf8_lossy(&bytes[..end]).replace("binary_little_endian", "ascii");
    let width = header.matches("property").count();
    let values: Vec<f32> = bytes[end..].as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    let rows = values.chunks(width).map(|row| row.iter().map(f32::to_string).collect::<Vec<_>>().join(" ") + "\n");
    (header + &rows.collect::<String>()).into_bytes()
}

pub fn gzip(payload: &[u8]) -> Vec<u8> {
    let mut gz = GzEncoder::new(Vec::new(), Compression::fast());
    gz.write_all(payload).expect("memory");
    gz.finish().expect("memory")
}

fn gunzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    flate2::read::GzDecoder::new(bytes).read_to_end(&mut out).expect("a good file");
    out
}

fn cameras_json() -> Vec<u8> {
    let camera = Camera::look_at(64, 48, 0.7, DVec3::new(1.0, -2.0, 0.5), DVec3::ZERO, DVec3::Z).expect("a camera");
    let named = |name: &str, time| NamedCamera { name: name.into(), camera: camera.clone(), time };
    written(|out| write_cameras(&[named("a", None), named("b", Some(0.5))], out))
}

const TRANSFORMS: &str = r#"{"camera_angle_x":0.69,"w":8,"h":4,"frames":[{"file_path":"./r_0","rotation":0.1,"time":0.5,
"transform_matrix":[[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]},{"transform_matrix":[[1,0,0,1],[0,1,0,2],[0,0,1,3]]}]}"#;

fn verify(splats: &RawSplats) {
    splats.check_shape().expect("columns of one length");
    assert!(splats.non_finite_rows().is_empty(), "a non-finite value passed");
}

fn read_splats(bytes: &[u8], file: &str) -> Result<(), IoError> {
    parse_splats(bytes, file, &Limits::default()).map(|s| verify(&s))
}

fn read_cameras(bytes: &[u8]) -> Result<(), IoError> {
    for c in parse_cameras(bytes, "c.json", &Limits::default())? {
        c.camera.check().expect("a valid camera");
        assert!(c.time.is_none_or(f32::is_finite));
    }
    Ok(())
}

fn read_npy(bytes: &[u8]) -> Result<(), IoError> {
    let array = npy::read(bytes, "a.npy", &Limits::default())?;
    assert_eq!(array.shape.iter().product::<usize>(), array.to_f32().len());
    assert!(array.to_f64().iter().all(|v| v.is_finite()));
    Ok(())
}

#[cfg(feature = "images")]
fn read_image(bytes: &[u8]) -> Result<(), IoError> {
    let image = gs_core::io::images::decode_image(bytes, "i.png", &Limits::default())?;
    assert_eq!(image.data.len(), image.width * image.height * image.channels);
    gs_core::io::images::decode_rgba8(bytes, "i.png", &Limits::default()).map(|_| ())
}

/// A PNG whose chunk checksums fit its chunks again.
#[cfg(feature = "images")]
pub fn png_checksums(bytes: &[u8]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    let mut at = 8;
    while let Some(length) = out.get(at..at + 4).and_then(|b| b.first_chunk()) {
        let end = at.saturating_add(8).saturating_add(u32::from_be_bytes(*length) as usize);
        let Some(chunk) = out.get(at + 4..end) else { break };
        let mut crc = flate2::Crc::new();
        crc.update(chunk);
        match out.get_mut(end..end + 4) {
            Some(slot) => slot.copy_from_slice(&crc.sum().to_be_bytes()),
            None => break,
        }
        at = end + 4;
    }
    out
}

#[cfg(feature = "images")]
pub fn png() -> Vec<u8> {
    let data: Vec<f32> = (0..9 * 7 * 4).map(|i| (i * 37 % 256) as f32 / 255.0).collect();
    let image = gs_core::Image::from_data(9, 7, 4, data).expect("shape");
    written(|out| gs_core::io::images::write_png(&image, out))
}

#[cfg(feature = "images")]
fn jpeg() -> Vec<u8> {
    use image::ImageEncoder;
    let bytes: Vec<u8> = (0..24 * 16 * 3).map(|i| (i * 7 % 251) as u8).collect();
    let mut out = Vec::new();
    let encoder = image::codecs::jpeg::JpegEncoder::new(&mut out);
    encoder.write_image(&bytes, 24, 16, image::ExtendedColorType::Rgb8).expect("memory");
    out
}

#[cfg(feature = "exr")]
pub fn exr() -> Vec<u8> {
    let data: Vec<f32> = (0..9 * 20 * 3).map(|i| i as f32 * 0.1).collect();
    let image = gs_core::Image::from_data(9, 20, 3, data).expect("shape");
    written(|out| gs_core::io::exr::write(&image, out))
}

/// Every reader with its seeds.
pub fn parsers() -> Vec<Parser> {
    let plain = |name, seeds, read| Parser { name, seeds, read, soft_tail: 0, strict_end: true, wrap: <[u8]>::to_vec };
    let spz_file = |version, degree| {
        let options = spz::SpzOptions { version, ..spz::SpzOptions::default() };
        written(|out| spz::write(&cloud(6, degree), &options, out))
    };
    let spz_files = vec![spz_file(spz::Version::V2, 1), spz_file(spz::Version::V3, 3)];
    let arrays = vec![
        written(|out| npy::write(&[2, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], out)),
        written(|out| npy::write(&[], &[1.0], out)),
    ];
    #[allow(unused_mut, reason = "mutated only with the features `images` and `exr`")]
    let mut list = vec![
        plain("ply binary", vec![ply_binary(3, 0), ply_binary(2, 3)], |b| read_splats(b, "a.ply")),
        Parser {
            soft_tail: 24,
            ..plain("ply text", vec![ply_ascii(3, 0), ply_ascii(2, 1)], |b| read_splats(b, "a.ply"))
        },
        plain("splat", vec![written(|out| splat::write(&cloud(5, 0), out))], |b| read_splats(b, "a.splat")),
        plain("spz payload", spz_files.iter().map(|f| gunzip(f)).collect(), |b| read_splats(b, "a.spz")),
        plain("spz", spz_files, |b| read_splats(b, "a.spz")),
        plain("npy", arrays, read_npy),
        Parser { soft_tail: 1, ..plain("cameras", vec![cameras_json(), TRANSFORMS.into()], read_cameras) },
    ];
    list[3].wrap = gzip;
    #[cfg(feature = "images")]
    {
        let image = |name, seeds| Parser { strict_end: false, soft_tail: 12, ..plain(name, seeds, read_image) };
        list.push(image("png", vec![png()]));
        list.push(Parser { wrap: png_checksums, ..image("png chunks", vec![png()]) });
        list.push(Parser { soft_tail: 0, ..image("jpeg", vec![jpeg()]) });
    }
    #[cfg(feature = "exr")]
    list.push(Parser {
        strict_end: false,
        ..plain("exr", vec![exr()], |b| {
            let image = gs_core::io::exr::read(b, "i.exr", &Limits::default())?;
            assert!(image.first_non_finite().is_none());
            Ok(())
        })
    });
    list
}
