//! SPZ (Niantic): quantised splats, compressed, about a tenth of the `.ply`. Versions 2, 3 and 4 are read, 2 and 3 written.
//!
//! Source: README and `load-spz.cc` of nianticlabs/spz (MIT), facts only. A header (magic `NGSP`, version, count, SH degree,
//! fraction bits `b`, flags), then one array per attribute, in this order:
//!
//! ```text
//! positions  3 × i24   p · 2^b                       alphas     u8       255 · opacity
//! colours    3 × u8    (0.15 f_dc + 0.5) · 255       scales     3 × u8   16 (log-scale + 10)
//! rotations  3 bytes (v2) or 4 bytes (v3, v4), see [`super::spz_quat`]
//! SH         3 (K − 1) × u8, colour fastest          128 f_rest + 128
//! ```
//! Versions 2 and 3 are one gzip stream with a header of 16 bytes; version 4 has a header of 32 bytes and one Zstandard stream
//! per array.
//!
//! **Axes**: SPZ stores right-up-back, `.ply` holds right-down-front ([`RawSplats::flipped`] in y and z), unless the extension
//! `SPZ_ADOBE_coordinate_system` names others. Other extensions are skipped.
//!
//! **Losses** (half a step): position 2^−(b+1), log-scale 1/32 clamped to −10 … 5.94, opacity 1/510, colour coefficient 0.0131
//! clamped to ±3.33, SH 1/32 (degree 1) or 1/16 clamped to [−1, 1). [`Clamped`] counts what was clamped.
//! Version 1, uncompressed payloads and SH degree 4 are refused by name.
//!
//! **Positions** have 12 fraction bits (as the reference writer has), more where half a step would be more than an eighth of the standard
//! deviation of a splat (along its longest axis; a hundredth of the splats may be smaller), fewer where the scene would not fit in 24 bits. A
//! scene where half a step is more than the standard deviation of half of the splats is refused: it lies too far from its origin.
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

use super::error::Source;
use super::raw::finite_logit;
use super::spz_container::unpack;
use super::spz_quat::{decode_first_three, decode_smallest_three, encode_first_three, encode_smallest_three};
use super::{IoError, Limits, RawSplats, sigmoid};
use crate::{rot, sh};
use flate2::{Compression, write::GzEncoder};
use glam::{DMat3, DVec3, Vec3};
use std::io::Write;

pub(super) const MAGIC: &[u8; 4] = b"NGSP";
/// Axes whose signs differ between `.ply` and `.spz`.
const FLIPPED: [bool; 3] = [false, true, true];
const COLOR_SCALE: f32 = 0.15;
/// Largest magnitude of a 24-bit position.
const FIXED_MAX: f32 = 8_388_607.0;
/// Most fraction bits of one.
const MAX_BITS: u8 = 23;
/// How far a mean may be moved along an axis where there are bits for it, as a share of its splat's longest standard deviation.
const MOVED: f32 = 0.125;

/// Version of the SPZ format to write.
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
    /// Fraction bits of positions (0 to 23): more are used where splats are small, fewer where the cloud would not fit.
    pub fraction_bits: u8,
    /// Bits kept of degree-1 and of higher SH coefficients (1 to 8).
    pub sh_bits: [u8; 2],
}

impl Default for SpzOptions {
    fn default() -> Self {
        Self { version: Version::V3, fraction_bits: 12, sh_bits: [5, 4] }
    }
}

/// How many values [`write()`] moves to an end of their range: those that lose more than half a step by it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Clamped {
    /// SH coefficients of degree 0.
    pub colors: usize,
    /// Logarithms of standard deviations.
    pub log_scales: usize,
    /// SH coefficients above degree 0.
    pub sh: usize,
}

impl Clamped {
    /// Of splats that are written with these options.
    pub fn of(splats: &RawSplats, options: &SpzOptions) -> Self {
        let outside = |v: f32, half: f32| !(-half..=255.0 + half).contains(&v);
        let stored = splats.clone().flipped(FLIPPED);
        let values = || stored.sh.chunks_exact(stored.sh_width()).flat_map(|row| row.iter().copied().enumerate());
        let [first, later] = options.sh_bits.map(|bits| 0.5 * bucket(bits));
        let half = |k: usize| if k < 3 * sh::coeffs(1) { first } else { later };
        let log_scales = stored.log_scales.iter().flat_map(|s| s.to_array());
        Self {
            colors: values().filter(|(k, v)| *k < 3 && outside(color_steps(*v), 0.5)).count(),
            log_scales: log_scales.filter(|v| outside(scale_steps(*v), 0.5)).count(),
            sh: values().filter(|(k, v)| *k >= 3 && outside(128.0 * v + 128.0, half(*k))).count(),
        }
    }

    /// All of them.
    pub fn total(&self) -> usize {
        self.colors + self.log_scales + self.sh
    }
}

/// The header of an SPZ payload.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpzHeader {
    /// Version of the format, 2, 3 or 4.
    pub version: u32,
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
    pub(super) fn widths(&self) -> [usize; 6] {
        let rotation = if self.version == 2 { 3 } else { 4 };
        [9, 1, 3, 3, rotation, 3 * (sh::coeffs(self.degree) - 1)]
    }

    /// Bytes per splat in all arrays.
    pub(super) fn row(&self) -> usize {
        self.widths().iter().sum()
    }
}

/// Reads an SPZ file held in memory. `file` is the name used in errors.
///
/// # Errors
/// Neither gzip nor version 4, a damaged stream, unsupported version, degree or axes, wrong size, more than the limits allow.
pub fn read(bytes: &[u8], file: &str, limits: &Limits) -> Result<(SpzHeader, RawSplats), IoError> {
    let src = Source { file, format: "SPZ" };
    let (header, arrays, axes) = unpack(bytes, limits, src)?;
    let stored = decode(&arrays, &header);
    let own = DMat3::from_diagonal(DVec3::from_array(FLIPPED.map(|f| if f { -1.0 } else { 1.0 })));
    let splats = if axes == own.to_cols_array_2d() { stored.flipped(FLIPPED) } else { stored.mapped(&axes) };
    splats.refuse_non_finite(src, limits)?;
    Ok((header, splats))
}

/// The splats in the axes of the file.
fn decode(payload: &[u8], header: &SpzHeader) -> RawSplats {
    let mut out = RawSplats::with_capacity(header.count, header.degree);
    out.antialiased = header.antialiased;
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
        out.means.push(Vec3::new(x, y, z));
    }
    out.logit_opacities.extend(alphas.iter().map(|&a| finite_logit(f32::from(a) / 255.0)));
    for &[a, b, c] in scales.as_chunks::<3>().0 {
        out.log_scales.push(Vec3::from_array([a, b, c].map(|v| f32::from(v) / 16.0 - 10.0)));
    }
    match header.version {
        2 => out.quats.extend(rotations.as_chunks::<3>().0.iter().map(|&q| decode_first_three(q))),
        _ => out.quats.extend(rotations.as_chunks::<4>().0.iter().map(|&q| decode_smallest_three(q))),
    }
    let width = 3 * (sh::coeffs(header.degree) - 1);
    for (row, color) in colors.as_chunks::<3>().0.iter().enumerate() {
        out.sh.extend(color.map(|v| (f32::from(v) / 255.0 - 0.5) / COLOR_SCALE));
        let coefficients = sh.get(row * width..(row + 1) * width).unwrap_or_default();
        out.sh.extend(coefficients.iter().map(|&v| (f32::from(v) - 128.0) / 128.0));
    }
    out
}

/// Fraction bits with which every coordinate fits in 24 bits and small splats keep their places; `usual` if these need no more.
fn fraction_bits(splats: &RawSplats, usual: u8) -> std::io::Result<u8> {
    let usual = usual.min(MAX_BITS);
    let mut sizes: Vec<f32> = splats.log_scales.iter().map(|s| s.max_element()).collect();
    if sizes.is_empty() {
        return Ok(usual);
    }
    let places = [sizes.len() / 100, sizes.len() / 2];
    let [small, half_of_them] = places.map(|k| sizes.select_nth_unstable_by(k, f32::total_cmp).1.exp());
    let largest = splats.means.iter().fold(0.0f32, |m, v| m.max(v.abs().max_element()));
    let invalid = |text: String| std::io::Error::new(std::io::ErrorKind::InvalidInput, text);
    let most = (0..=MAX_BITS).rev().find(|&b| largest * (1u32 << b) as f32 <= FIXED_MAX);
    let most = most.ok_or_else(|| {
        invalid(format!("a coordinate of {largest} does not fit SPZ's 24 bits; scale the scene down, or write a .ply"))
    })?;
    let half_step = |b: u8| 0.5 / (1u32 << b) as f32;
    let wanted = (usual..=MAX_BITS).find(|&b| half_step(b) <= MOVED * small).unwrap_or(MAX_BITS);
    let bits = wanted.min(most);
    if half_step(bits) > half_of_them {
        return Err(invalid(format!(
            "SPZ's 24 bits would move means by up to {}, more than the standard deviation of half of the splats ({half_of_them}), because a \
             coordinate is {largest}; move the scene to the origin, or write a .ply",
            half_step(bits)
        )));
    }
    Ok(bits)
}

/// Steps of a byte between two values of an SH coefficient of `bits` bits.
fn bucket(bits: u8) -> f32 {
    (1u32 << (8 - bits.clamp(1, 8))) as f32
}

/// An SH coefficient in `bits` bits of a byte; zero is represented exactly.
fn quantise_sh(v: f32, bits: u8) -> u8 {
    let bucket = bucket(bits);
    byte((v * 128.0 / bucket).round() * bucket + 128.0)
}

/// A coefficient of degree 0 in steps of a byte.
fn color_steps(v: f32) -> f32 {
    (COLOR_SCALE * v + 0.5) * 255.0
}

/// The logarithm of a standard deviation in steps of a byte.
fn scale_steps(v: f32) -> f32 {
    (v + 10.0) * 16.0
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
/// Columns of unequal length, a value that is not finite, coordinates too large for 24 bits or for the size of the splats (as
/// `InvalidInput`), or the writer's own.
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
    payload.extend([splats.degree, bits, u8::from(splats.antialiased), 0]);
    quantise(&splats.clone().flipped(FLIPPED), options, bits, &mut payload);
    let mut gz = GzEncoder::new(out, Compression::new(LEVEL));
    gz.write_all(&payload)?;
    gz.finish().map(|_| ())
}

/// Appends the six arrays of splats in the axes of the file, quantised.
fn quantise(splats: &RawSplats, options: &SpzOptions, bits: u8, out: &mut Vec<u8>) {
    let step = (1u32 << bits) as f32;
    for mean in &splats.means {
        for v in mean.to_array() {
            let [a, b, c, _] = ((v * step).round() as i32).to_le_bytes();
            out.extend([a, b, c]);
        }
    }
    out.extend(splats.logit_opacities.iter().map(|&o| byte(sigmoid(o) * 255.0)));
    let rows = || splats.sh.chunks_exact(splats.sh_width());
    out.extend(rows().flat_map(|r| r.iter().take(3)).map(|v| byte(color_steps(*v))));
    out.extend(splats.log_scales.iter().flat_map(|s| s.to_array()).map(|v| byte(scale_steps(v))));
    for quat in &splats.quats {
        let unit = match rot::normalise(*quat).wxyz {
            [0.0, 0.0, 0.0, 0.0] => [1.0, 0.0, 0.0, 0.0],
            q => q,
        };
        match options.version {
            Version::V2 => out.extend(encode_first_three(unit)),
            Version::V3 => out.extend(encode_smallest_three(unit)),
        }
    }
    let [first, later] = options.sh_bits;
    for row in rows() {
        let higher = row.get(3..).unwrap_or_default().as_chunks::<3>().0;
        for (k, rgb) in higher.iter().enumerate() {
            out.extend(rgb.map(|v| quantise_sh(v, if k < 3 { first } else { later })));
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
    fn round_trip_stays_within_the_declared_bounds() {
        for version in [Version::V2, Version::V3] {
            for degree in 0..=3 {
                let splats = RawSplats { antialiased: degree == 1, ..cloud(300, degree, 21) };
                let options = SpzOptions { version, ..SpzOptions::default() };
                let (header, again) = read_all(&encode(&splats, &options)).unwrap();
                let number = if version == Version::V2 { 2 } else { 3 };
                assert_eq!((header.version, header.fraction_bits, header.antialiased), (number, 12, degree == 1));
                assert_eq!((again.len(), again.degree, again.antialiased), (300, degree, degree == 1));
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
        let error = |splats: &RawSplats| {
            write(splats, &SpzOptions::default(), &mut Vec::new()).expect_err("out of range").to_string()
        };
        splats.means[1].z = 1e7;
        assert!(error(&splats).contains("a coordinate of 10000000 does not fit"));
        // Four fraction bits: half a step is 1/32.
        splats.means[1].z = 5e5;
        splats.log_scales.fill(Vec3::splat(0.03f32.ln()));
        assert!(error(&splats).contains("up to 0.03125, more than"), "{}", error(&splats));
        splats.log_scales.fill(Vec3::splat(0.04f32.ln()));
        assert_eq!(read_all(&encode(&splats, &SpzOptions::default())).unwrap().0.fraction_bits, 4);
        splats.means[1].z = f32::NAN;
        assert!(error(&splats).contains("row 1, `means`"));
    }

    #[test]
    fn small_splats_keep_their_places() {
        let mut splats = cloud(200, 0, 24);
        splats.means.iter_mut().for_each(|m| *m *= 0.01);
        splats.log_scales.iter_mut().for_each(|s| *s -= 100f32.ln());
        let (header, again) = read_all(&encode(&splats, &SpzOptions::default())).unwrap();
        assert!((13..23).contains(&header.fraction_bits), "{}", header.fraction_bits);
        let half = 0.5 / (1u32 << header.fraction_bits) as f32;
        let moved =
            again.means.iter().zip(&splats.means).map(|(a, b)| (*a - *b).abs().max_element()).fold(0.0, f32::max);
        assert!(moved <= 1.01 * half, "{moved} {half}");
        let near = splats.log_scales.iter().filter(|s| moved <= MOVED * s.max_element().exp()).count();
        assert!(near >= 198, "{near}");
    }

    #[test]
    fn clamped_values_are_counted() {
        let count = |splats: &RawSplats| Clamped::of(splats, &SpzOptions::default());
        let mut splats = cloud(3, 2, 25);
        splats.sh.fill(0.5);
        assert_eq!(count(&splats).total(), 0);
        // Column, the last value that loses no more than half a step, and one beyond it.
        splats.log_scales[0] = Vec3::new(-10.03, -10.04, 6.0);
        splats.sh[27] = 3.34;
        splats.sh[28] = 3.36;
        (splats.sh[30], splats.sh[31], splats.sh[39], splats.sh[40]) = (1.02, -1.05, -1.05, 1.3);
        assert_eq!(count(&splats), Clamped { colors: 1, log_scales: 2, sh: 2 });
        assert_eq!(count(&splats).total(), 5);
        let again = read_all(&encode(&splats, &SpzOptions::default())).unwrap().1;
        assert_eq!(again.log_scales[0], Vec3::new(-10.0, -10.0, 5.9375));
    }

    #[test]
    fn errors_are_named() {
        let header = |version: u32, count: u32, tail: [u8; 4]| {
            [MAGIC.as_slice(), &version.to_le_bytes(), &count.to_le_bytes(), &tail].concat()
        };
        let error = |payload: &[u8]| read_all(payload).unwrap_err().to_string();
        for version in [0, 1, 9] {
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
        assert!(error(&gzip(&header(4, 0, [0, 12, 0, 0]))).contains("version 4 in a gzip"));
        assert!(error(&gzip(&header(3, 0, [0, 12, 4, 0]))).contains("flags 0x04"));
        assert!(error(&gzip(&header(3, 0, [0, 12, 0, 1]))).contains("reserved"));
        assert!(error(&gzip(b"NGSP\x02")).contains("`header` needs 16 bytes, only 5"));
        assert!(error(&gzip(b"GIFxxxxxxxxxxxxxxxxx")).contains("NGSP"));
        let good = encode(&cloud(3, 1, 23), &SpzOptions::default());
        assert!(error(&[good.as_slice(), &[0]].concat()).contains("bytes follow"));
        assert!(read_all(&good[..good.len() - 1]).is_err());
        assert!(error(b"").contains("SPZ"));
    }
}
