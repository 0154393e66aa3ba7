//! SPZ versions 2 and 3 (Niantic): quantised splats in one gzip stream, about a tenth of the `.ply`.
//!
//! Source: README and `load-spz.cc` of nianticlabs/spz (MIT), facts only. A 16-byte header (magic `NGSP`, version, count,
//! SH degree, fraction bits `b`, flags, 0), then one array per attribute, in this order:
//!
//! ```text
//! positions  3 × i24   p · 2^b                       alphas     u8       255 · opacity
//! colours    3 × u8    (0.15 f_dc + 0.5) · 255       scales     3 × u8   16 (log-scale + 10)
//! rotations  3 bytes (v2) or 4 bytes (v3), see [`super::spz_quat`]
//! SH         3 (K − 1) × u8, colour fastest          128 f_rest + 128
//! ```
//! **Axes**: SPZ stores right-up-back, `.ply` holds right-down-front, so y and z change sign on the way in and out: in
//! positions, in the quaternion's y and z, and in the SH functions odd under that half turn about x.
//! **Losses** (half a step): position 2^−(b+1), log-scale 1/32, opacity 1/510, colour coefficient 0.0131, SH 1/32
//! (degree 1) or 1/16 clamped to [−1, 1). Versions 1 and 4, uncompressed payloads and extensions are refused by name.
//!
//! ```
//! use gs_core::io::{Limits, RawSplats, spz};
//!
//! let mut splats = RawSplats::default();
//! splats.means.push(glam::Vec3::new(1.0, -0.5, 0.25)); // a multiple of 2⁻¹² is exact
//! splats.quats.push([1.0, 0.0, 0.0, 0.0]);
//! splats.log_scales.push(glam::Vec3::splat(-4.0));
//! splats.logit_opacities.push(0.0);
//! splats.sh = vec![0.0; 3];
//! let mut bytes = Vec::new();
//! spz::write(&splats, &spz::SpzOptions::default(), &mut bytes)?;
//! let (header, again) = spz::read(&bytes, "scene.spz", &Limits::default())?;
//! assert_eq!((header.fraction_bits, &again.means, &again.log_scales), (12, &splats.means, &splats.log_scales));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use super::error::{At, Source};
use super::raw::finite_logit;
use super::spz_quat::{decode_first_three, decode_smallest_three, encode_first_three, encode_smallest_three};
use super::{IoError, Limits, RawSplats, sigmoid};
use crate::{rot, sh};
use flate2::{Compression, bufread::GzDecoder, write::GzEncoder};
use glam::Vec3;
use std::io::{Read, Write};

const MAGIC: &[u8; 4] = b"NGSP";
const HEADER: usize = 16;
const COLOR_SCALE: f32 = 0.15;
/// Largest magnitude of a 24-bit position.
const FIXED_MAX: f32 = 8_388_607.0;
/// Sign of each SH function (index k − 1) when y and z change sign.
const SH_SIGN: [f32; 15] = [-1., -1., 1., -1., 1., 1., -1., 1., -1., 1., -1., -1., 1., -1., 1.];

/// Version of the SPZ format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Version {
    /// Version 2: rotations in three bytes.
    V2,
    /// Version 3: rotations in four bytes, ten times more exact.
    #[default]
    V3,
}

/// Settings of [`write()`]; the default is version 3, 12 fraction bits, SH in 5 and 4 bits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpzOptions {
    /// Version of the format to write.
    pub version: Version,
    /// Largest number of fraction bits of positions (0 to 23); fewer are used where the cloud would not fit.
    pub fraction_bits: u8,
    /// Bits kept of degree-1 and of higher SH coefficients (1 to 8).
    pub sh_bits: [u8; 2],
    /// Flag in the header: the cloud was trained with the antialiased projection.
    pub antialiased: bool,
}

impl Default for SpzOptions {
    fn default() -> Self {
        Self { version: Version::V3, fraction_bits: 12, sh_bits: [5, 4], antialiased: false }
    }
}

/// The header of an SPZ payload.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpzHeader {
    /// Version of the format, 2 or 3.
    pub version: Version,
    /// Number of splats in the file.
    pub count: usize,
    /// SH degree, 0 to 3.
    pub degree: u8,
    /// Number of fraction bits of positions.
    pub fraction_bits: u8,
    /// Whether the cloud was trained with the antialiased projection.
    pub antialiased: bool,
}

impl SpzHeader {
    /// Bytes per splat of each array, in file order.
    fn widths(&self) -> [usize; 6] {
        let rotation = if self.version == Version::V2 { 3 } else { 4 };
        [9, 1, 3, 3, rotation, 3 * (sh::coeffs(self.degree) - 1)]
    }
}

fn parse_header(h: &[u8; HEADER], limits: &Limits, src: Source<'_>) -> Result<SpzHeader, IoError> {
    let [magic @ .., v0, v1, v2, v3, n0, n1, n2, n3, degree, fraction_bits, flags, reserved] = h;
    if magic != MAGIC {
        return Err(src.malformed(At::Byte(0), "the payload does not start with NGSP", "give an SPZ file"));
    }
    let version = match u32::from_le_bytes([*v0, *v1, *v2, *v3]) {
        2 => Version::V2,
        3 => Version::V3,
        other => return Err(unsupported_version(other, src)),
    };
    let count = limits.splats(src, u32::from_le_bytes([*n0, *n1, *n2, *n3]).into(), RawSplats::row_bytes(*degree))?;
    if *degree > sh::MAX_DEGREE {
        return Err(src.unsupported(format!("SPZ with SH degree {degree}"), "export it with degree 3 or less"));
    }
    if *fraction_bits > 23 {
        let what = format!("{fraction_bits} fraction bits in 24-bit positions");
        return Err(src.malformed(At::Byte(13), what, "the header is damaged"));
    }
    if flags & !1 != 0 {
        let what = format!("SPZ with flags {flags:#04x} (extensions)");
        return Err(src.unsupported(what, "export it without extensions"));
    }
    if *reserved != 0 {
        return Err(src.malformed(At::Byte(15), "the reserved byte is not 0", "the header is damaged"));
    }
    Ok(SpzHeader { version, count, degree: *degree, fraction_bits: *fraction_bits, antialiased: flags & 1 == 1 })
}

fn unsupported_version(version: u32, src: Source<'_>) -> IoError {
    src.unsupported(format!("SPZ version {version}"), "export it as SPZ version 2 or 3, or as PLY")
}

/// Reads an SPZ file held in memory. `file` is the name used in errors.
///
/// # Errors
/// Not gzip, damaged stream, unsupported version, degree or extension, wrong size, more than the limits allow.
pub fn read(bytes: &[u8], file: &str, limits: &Limits) -> Result<(SpzHeader, RawSplats), IoError> {
    let src = Source { file, format: "SPZ" };
    if let Some([v0, v1, v2, v3]) = bytes.strip_prefix(MAGIC).and_then(<[u8]>::first_chunk) {
        return Err(match u32::from_le_bytes([*v0, *v1, *v2, *v3]) {
            v @ (2 | 3) => {
                let what = format!("an SPZ version {v} payload that is not compressed");
                src.unsupported(what, "compress the file with gzip")
            }
            v => unsupported_version(v, src),
        });
    }
    let mut stream = GzDecoder::new(bytes);
    let mut head = [0u8; HEADER];
    fill(&mut stream, &mut head, "header", 0, src)?;
    let header = parse_header(&head, limits, src)?;
    let row: usize = header.widths().iter().sum();
    let row_decoded = row + 4 * (11 + 3 * sh::coeffs(header.degree));
    limits.expansion(src, (header.count as u64).saturating_mul(row_decoded as u64), bytes.len())?;
    let mut payload = vec![0u8; header.count * row];
    fill(&mut stream, &mut payload, "splats", HEADER, src)?;
    let end = stream.read(&mut [0u8]).map_err(|e| damaged(&e, HEADER + payload.len(), src))?;
    if end != 0 || !stream.into_inner().is_empty() {
        let at = At::Byte((HEADER + payload.len()) as u64);
        return Err(src.malformed(at, "bytes follow the last array", "the count or the degree in the header is wrong"));
    }
    let splats = decode(&payload, &header);
    splats.refuse_non_finite(src, limits)?;
    Ok((header, splats))
}

/// Fills `out` from the stream; a short stream is an error with the bytes read.
fn fill(stream: &mut impl Read, out: &mut [u8], field: &str, start: usize, src: Source<'_>) -> Result<(), IoError> {
    let mut have = 0;
    while let Some(rest) = out.get_mut(have..).filter(|r| !r.is_empty()) {
        match stream.read(rest) {
            Ok(0) => return Err(src.truncated(field, start, out.len() as u64, have)),
            Ok(n) => have += n,
            Err(e) => return Err(damaged(&e, start + have, src)),
        }
    }
    Ok(())
}

fn damaged(error: &std::io::Error, at: usize, src: Source<'_>) -> IoError {
    let what = format!("the gzip stream is damaged: {error}");
    src.malformed(At::Byte(at as u64), what, "copy or export the file again")
}

fn decode(payload: &[u8], header: &SpzHeader) -> RawSplats {
    let mut out = RawSplats::with_capacity(header.count, header.degree);
    let mut rest = payload;
    let mut array = |width: usize| {
        let (head, tail) = rest.split_at_checked(width * header.count).unwrap_or_default();
        rest = tail;
        head
    };
    let [positions, alphas, colors, scales, rotations, sh] = header.widths().map(&mut array);
    let step = 1.0 / (1u32 << header.fraction_bits) as f32;
    for row in positions.as_chunks::<3>().0.as_chunks::<3>().0 {
        let [x, y, z] = row.map(|[a, b, c]| (i32::from_le_bytes([0, a, b, c]) >> 8) as f32 * step);
        out.means.push(Vec3::new(x, -y, -z));
    }
    out.logit_opacities.extend(alphas.iter().map(|&a| finite_logit(f32::from(a) / 255.0)));
    for &[a, b, c] in scales.as_chunks::<3>().0 {
        out.log_scales.push(Vec3::from_array([a, b, c].map(|v| f32::from(v) / 16.0 - 10.0)));
    }
    let flip_yz = |[w, x, y, z]: [f32; 4]| [w, x, -y, -z];
    match header.version {
        Version::V2 => out.quats.extend(rotations.as_chunks::<3>().0.iter().map(|&q| flip_yz(decode_first_three(q)))),
        Version::V3 => {
            out.quats.extend(rotations.as_chunks::<4>().0.iter().map(|&q| flip_yz(decode_smallest_three(q))))
        }
    }
    let width = 3 * (sh::coeffs(header.degree) - 1);
    for (row, color) in colors.as_chunks::<3>().0.iter().enumerate() {
        out.sh.extend(color.map(|v| (f32::from(v) / 255.0 - 0.5) / COLOR_SCALE));
        let coefficients = sh.get(row * width..(row + 1) * width).unwrap_or_default();
        for (rgb, sign) in coefficients.as_chunks::<3>().0.iter().zip(SH_SIGN) {
            out.sh.extend(rgb.map(|v| sign * (f32::from(v) - 128.0) / 128.0));
        }
    }
    out
}

/// Fraction bits with which every coordinate fits in 24 bits: at most `max_bits`.
fn fraction_bits(splats: &RawSplats, max_bits: u8) -> std::io::Result<u8> {
    let largest = splats.means.iter().fold(0.0f32, |m, v| m.max(v.abs().max_element()));
    (0..=max_bits.min(23)).rev().find(|&b| largest * (1u32 << b) as f32 <= FIXED_MAX).ok_or_else(|| {
        let text = format!("a coordinate of {largest} does not fit SPZ's 24 bits; scale the scene down");
        std::io::Error::new(std::io::ErrorKind::InvalidInput, text)
    })
}

/// An SH coefficient in `bits` bits of a byte; zero is represented exactly.
fn quantise_sh(v: f32, bits: u8) -> u8 {
    let bucket = (1u32 << (8 - bits.clamp(1, 8))) as f32;
    byte((v * 128.0 / bucket).round() * bucket + 128.0)
}

/// A number as a byte, rounded to nearest.
fn byte(v: f32) -> u8 {
    v.round().clamp(0.0, 255.0) as u8
}

/// Gzip level: three times as fast as the default 6 for 2 % more bytes (measured on 100 000 splats of degree 3).
const LEVEL: u32 = 4;

/// Writes splats as SPZ, compressed with gzip.
///
/// # Errors
/// Columns of unequal length, a value that is not finite or a coordinate above 2^23 (as `InvalidInput`), or the
/// writer's own.
pub fn write(splats: &RawSplats, options: &SpzOptions, out: &mut dyn Write) -> std::io::Result<()> {
    let invalid = |text: String| std::io::Error::new(std::io::ErrorKind::InvalidInput, text);
    splats.check_shape().map_err(|e| invalid(e.to_string()))?;
    splats.refuse_kernel("the SPZ format")?;
    if let Some((row, column)) = splats.non_finite_rows().first() {
        return Err(invalid(format!("row {row}, `{column}` is not finite")));
    }
    let count = u32::try_from(splats.len()).map_err(|_| invalid("more than 2^32 − 1 splats".into()))?;
    let bits = fraction_bits(splats, options.fraction_bits)?;
    let mut payload: Vec<u8> = MAGIC.to_vec();
    payload.extend((if options.version == Version::V2 { 2u32 } else { 3 }).to_le_bytes());
    payload.extend(count.to_le_bytes());
    payload.extend([splats.degree, bits, u8::from(options.antialiased), 0]);
    quantise(splats, options, bits, &mut payload);
    let mut gz = GzEncoder::new(out, Compression::new(LEVEL));
    gz.write_all(&payload)?;
    gz.finish().map(|_| ())
}

/// Appends the six arrays, quantised.
fn quantise(splats: &RawSplats, options: &SpzOptions, bits: u8, out: &mut Vec<u8>) {
    let step = (1u32 << bits) as f32;
    for mean in &splats.means {
        for v in [mean.x, -mean.y, -mean.z] {
            let [a, b, c, _] = ((v * step).round() as i32).to_le_bytes();
            out.extend([a, b, c]);
        }
    }
    out.extend(splats.logit_opacities.iter().map(|&o| byte(sigmoid(o) * 255.0)));
    let rows = || splats.sh.chunks_exact(splats.sh_width());
    out.extend(rows().flat_map(|r| r.iter().take(3)).map(|v| byte((COLOR_SCALE * v + 0.5) * 255.0)));
    out.extend(splats.log_scales.iter().flat_map(|s| s.to_array()).map(|v| byte((v + 10.0) * 16.0)));
    for quat in &splats.quats {
        let [w, x, y, z] = match rot::normalise(*quat).wxyz {
            [0.0, 0.0, 0.0, 0.0] => [1.0, 0.0, 0.0, 0.0],
            q => q,
        };
        match options.version {
            Version::V2 => out.extend(encode_first_three([w, x, -y, -z])),
            Version::V3 => out.extend(encode_smallest_three([w, x, -y, -z])),
        }
    }
    let [first, later] = options.sh_bits;
    for row in rows() {
        let higher = row.get(3..).unwrap_or_default().as_chunks::<3>().0;
        for (k, (rgb, sign)) in higher.iter().zip(SH_SIGN).enumerate() {
            out.extend(rgb.map(|v| quantise_sh(sign * v, if k < 3 { first } else { later })));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::raw::tests::cloud;
    use super::*;

    fn encode(splats: &RawSplats, options: &SpzOptions) -> Vec<u8> {
        let mut out = Vec::new();
        write(splats, options, &mut out).unwrap();
        out
    }

    fn read_all(bytes: &[u8]) -> Result<(SpzHeader, RawSplats), IoError> {
        read(bytes, "t.spz", &Limits::default())
    }

    fn gzip(payload: &[u8]) -> Vec<u8> {
        let mut gz = GzEncoder::new(Vec::new(), Compression::fast());
        gz.write_all(payload).unwrap();
        gz.finish().unwrap()
    }

    #[test]
    fn signs_follow_from_the_basis() {
        let d = [0.3f64, -0.5, 0.8];
        let (plain, flipped) = (sh::basis(d, 3), sh::basis([d[0], -d[1], -d[2]], 3));
        for k in 1..16 {
            assert!((flipped[k] - f64::from(SH_SIGN[k - 1]) * plain[k]).abs() < 1e-12, "{k}");
        }
    }

    #[test]
    fn round_trip_stays_within_the_declared_bounds() {
        for version in [Version::V2, Version::V3] {
            for degree in 0..=3 {
                let splats = cloud(300, degree, 21);
                let options = SpzOptions { version, antialiased: degree == 1, ..SpzOptions::default() };
                let (header, again) = read_all(&encode(&splats, &options)).unwrap();
                assert_eq!((header.version, header.fraction_bits, header.antialiased), (version, 12, degree == 1));
                assert_eq!((again.len(), again.degree), (300, degree));
                for i in 0..splats.len() {
                    assert!((again.means[i] - splats.means[i]).abs().max_element() <= 1.01 / 8192.0);
                    assert!((again.log_scales[i] - splats.log_scales[i]).abs().max_element() <= 1.0 / 32.0 + 1e-5);
                    let opacity = |s: &RawSplats| sigmoid(s.logit_opacities[i]);
                    assert!((opacity(&again) - opacity(&splats)).abs() <= 0.5 / 255.0 + 1e-5);
                    let (p, q) = (rot::normalise(again.quats[i]).wxyz, rot::normalise(splats.quats[i]).wxyz);
                    let dot: f32 = p.iter().zip(q).map(|(a, b)| a * b).sum();
                    assert!(dot.abs() > if version == Version::V2 { 0.995 } else { 0.99999 }, "{dot}");
                    let width = splats.sh_width();
                    for (k, (a, b)) in again.sh[i * width..].iter().zip(&splats.sh[i * width..][..width]).enumerate() {
                        let bound = if k < 3 {
                            0.0132
                        } else if k < 12 {
                            1.0 / 32.0
                        } else {
                            1.0 / 16.0
                        };
                        let want = if k < 3 { *b } else { b.clamp(-1.0, 1.0) };
                        assert!((a - want).abs() <= bound + 1e-5, "{k}: {a} {b}");
                    }
                }
            }
        }
    }

    #[test]
    fn positions_use_the_bits_that_fit() {
        let mut splats = cloud(2, 0, 22);
        splats.means[1].z = 5000.0;
        let (header, again) = read_all(&encode(&splats, &SpzOptions::default())).unwrap();
        assert_eq!(header.fraction_bits, 10);
        assert!((again.means[1].z - 5000.0).abs() < 1e-3);
        splats.means[1].z = 1e7;
        let error = write(&splats, &SpzOptions::default(), &mut Vec::new()).unwrap_err();
        assert!(error.to_string().contains("24 bits"));
        splats.means[1].z = f32::NAN;
        let error = write(&splats, &SpzOptions::default(), &mut Vec::new()).unwrap_err();
        assert!(error.to_string().contains("row 1, `means`"));
    }

    #[test]
    fn errors_are_named() {
        let header = |version: u32, count: u32, tail: [u8; 4]| {
            [MAGIC.as_slice(), &version.to_le_bytes(), &count.to_le_bytes(), &tail].concat()
        };
        let error = |payload: &[u8]| read_all(payload).unwrap_err().to_string();
        for version in [0, 1, 4, 9] {
            let text = format!("SPZ version {version} is not supported");
            assert!(error(&gzip(&header(version, 0, [0; 4]))).contains(&text));
            assert!(error(&header(version, 0, [0; 4])).contains(&text));
        }
        assert!(error(&header(2, 0, [0; 4])).contains("not compressed"));
        assert!(error(&gzip(&header(3, u32::MAX, [3, 12, 0, 0]))).contains("`max_rows`"));
        assert!(error(&gzip(&header(3, 1 << 29, [3, 12, 0, 0]))).contains("`max_expansion`"));
        assert!(error(&gzip(&header(3, 5, [0, 12, 0, 0]))).contains("`splats` needs 100 bytes, only 0"));
        assert!(error(&gzip(&header(3, 0, [4, 12, 0, 0]))).contains("degree 4"));
        assert!(error(&gzip(&header(3, 0, [0, 24, 0, 0]))).contains("24 fraction bits"));
        assert!(error(&gzip(&header(3, 0, [0, 12, 2, 0]))).contains("extensions"));
        assert!(error(&gzip(&header(3, 0, [0, 12, 0, 1]))).contains("reserved"));
        assert!(error(&gzip(b"NGSP\x02")).contains("`header` needs 16 bytes, only 5"));
        assert!(error(&gzip(b"GIFxxxxxxxxxxxxxxxxx")).contains("NGSP"));
        let good = encode(&cloud(3, 1, 23), &SpzOptions::default());
        assert!(error(&[good.as_slice(), &[0]].concat()).contains("bytes follow"));
        assert!(read_all(&good[..good.len() - 1]).is_err());
        assert!(error(b"").contains("SPZ"));
    }
}
