//! NumPy's `.npy`: one array of `f32`, `f64` or whole numbers, little-endian, C order.
//!
//! Source: numpy.lib.format, versions 1 to 3: `\x93NUMPY`, two version bytes, header length (u16, or u32 from version
//! 2), then a Python dict `{'descr': '<f4', 'fortran_order': False, 'shape': (4, 3), }` padded with spaces to a multiple
//! of 64 bytes and ended by a newline, then the values. Zero-dimensional arrays have shape `()`.
//!
//! ```
//! use gs_core::io::{Limits, npy};
//!
//! let mut bytes = Vec::new();
//! npy::write(&[2, 1], &[0.5, -1.0], &mut bytes)?;
//! let array = npy::read(&bytes, "a.npy", &Limits::default())?;
//! assert_eq!((array.shape.as_slice(), array.to_f32()), ([2, 1].as_slice(), vec![0.5, -1.0]));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use super::error::{At, Source};
use super::ply_header::clip;
use super::{IoError, Limits};
use crate::image::Image;
use std::io::Write;

const MAGIC: &[u8; 6] = b"\x93NUMPY";

/// The values of an array, by precision.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Single precision, NumPy type `<f4`.
    F32(Vec<f32>),
    /// Double precision, NumPy type `<f8`, and integers of any width (exact up to 2⁵³).
    F64(Vec<f64>),
}

/// An array: shape (slowest first) and values in C order.
#[derive(Clone, Debug, PartialEq)]
pub struct NpyArray {
    /// Lengths of the axes, slowest first.
    pub shape: Vec<usize>,
    /// The values; their number is the product of `shape`.
    pub values: Values,
}

impl NpyArray {
    /// The values converted to `f64`, exactly.
    pub fn to_f64(&self) -> Vec<f64> {
        match &self.values {
            Values::F32(v) => v.iter().map(|&x| f64::from(x)).collect(),
            Values::F64(v) => v.clone(),
        }
    }

    /// The values converted to `f32`, rounded.
    pub fn to_f32(&self) -> Vec<f32> {
        match &self.values {
            Values::F32(v) => v.clone(),
            Values::F64(v) => v.iter().map(|&x| x as f32).collect(),
        }
    }
}

/// Reads a `.npy` file held in memory. `file` is the name used in errors.
///
/// # Errors
/// Not NPY, another type or order, truncation, trailing bytes, a value that is not finite (names the flat index).
pub fn read(bytes: &[u8], file: &str, limits: &Limits) -> Result<NpyArray, IoError> {
    let src = Source { file, format: "NPY" };
    let (dict, start) = header(bytes, src)?;
    let at = At::Byte(10);
    let descr = field(dict, "descr", src)?.trim_matches(['\'', '"']);
    let Some(item) = width(descr) else {
        let what = format!("NPY of type `{}`", clip(descr));
        return Err(src.unsupported(what, "save it as little-endian float32, float64 or whole numbers"));
    };
    if field(dict, "fortran_order", src)? != "False" {
        return Err(src.unsupported("NPY in Fortran order", "save numpy.ascontiguousarray(x)"));
    }
    let mut shape: Vec<usize> = Vec::new();
    // Also of an empty array, the product of the other sides must be a number.
    let (mut need, mut empty) = (item, false);
    for side in field(dict, "shape", src)?.split(',').map(str::trim).filter(|s| !s.is_empty()) {
        let Ok(side) = side.trim_end_matches('L').parse::<u64>() else {
            let what = format!("side `{}` of the shape", clip(side));
            return Err(src.malformed(at, what, "a side must be a whole number"));
        };
        shape.push(limits.rows(src, side)?);
        empty |= side == 0;
        need = need.saturating_mul(side.max(1));
    }
    if need == u64::MAX {
        return Err(src.malformed(at, format!("shape {shape:?}"), "an array has less than 2^64 bytes"));
    }
    let need = if empty { 0 } else { need };
    let data = bytes.get(start..).unwrap_or_default();
    if need > data.len() as u64 {
        return Err(src.truncated("values", start, need, data.len()));
    }
    if need < data.len() as u64 {
        let what = format!("{} bytes follow the last value", data.len() as u64 - need);
        return Err(src.malformed(At::Byte(start as u64 + need), what, "the shape in the header is wrong"));
    }
    let values = match descr {
        "<f4" => Values::F32(data.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect()),
        "<f8" => Values::F64(data.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect()),
        _ => Values::F64(data.chunks_exact(item as usize).map(|b| integer(descr, b)).collect()),
    };
    let bad = match &values {
        Values::F32(v) => v.iter().position(|x| !x.is_finite()),
        Values::F64(v) => v.iter().position(|x| !x.is_finite()),
    };
    match bad {
        Some(row) if !limits.allow_non_finite => Err(src.value(row, "value", f64::NAN, "must be finite")),
        _ => Ok(NpyArray { shape, values }),
    }
}

/// Bytes of a value of a supported type.
fn width(descr: &str) -> Option<u64> {
    match descr {
        "|u1" | "|i1" | "|b1" => Some(1),
        "<u2" | "<i2" => Some(2),
        "<f4" | "<u4" | "<i4" => Some(4),
        "<f8" | "<u8" | "<i8" => Some(8),
        _ => None,
    }
}

/// An integer, little-endian, of at most 8 bytes.
fn integer(descr: &str, bytes: &[u8]) -> f64 {
    let signed = descr.contains('i');
    let negative = signed && bytes.last().is_some_and(|b| b & 0x80 != 0);
    let mut wide = [if negative { 0xff } else { 0 }; 8];
    wide.iter_mut().zip(bytes).for_each(|(w, b)| *w = *b);
    if signed { i64::from_le_bytes(wide) as f64 } else { u64::from_le_bytes(wide) as f64 }
}

/// The header text and the offset of the data.
fn header<'a>(bytes: &'a [u8], src: Source<'_>) -> Result<(&'a str, usize), IoError> {
    let Some([major, _minor, rest @ ..]) = bytes.strip_prefix(MAGIC) else {
        return Err(src.malformed(At::Byte(0), "the file does not start with NPY's magic", "give a .npy file"));
    };
    let (len, start) = match (*major, rest) {
        (1, [a, b, ..]) => (usize::from(u16::from_le_bytes([*a, *b])), 10),
        (2 | 3, [a, b, c, d, ..]) => (u32::from_le_bytes([*a, *b, *c, *d]) as usize, 12),
        (1..=3, _) => return Err(src.truncated("header length", 8, 4, rest.len())),
        _ => return Err(src.unsupported(format!("NPY version {major}"), "save it as version 1")),
    };
    let Some(text) = bytes.get(start..).and_then(|r| r.get(..len)) else {
        return Err(src.truncated("header", start, len as u64, bytes.len().saturating_sub(start)));
    };
    match std::str::from_utf8(text) {
        Ok(text) if len <= 65_535 => Ok((text, start + len)),
        _ => Err(src.malformed(At::Byte(start as u64), "the header is not a short text", "give a .npy file")),
    }
}

/// The text of one entry of the header's dict: up to the next comma, or inside parentheses.
fn field<'a>(dict: &'a str, name: &str, src: Source<'_>) -> Result<&'a str, IoError> {
    let find = || {
        let quoted = [format!("'{name}'"), format!("\"{name}\"")];
        let after = quoted.iter().find_map(|q| dict.split_once(q.as_str()))?.1;
        let value = after.trim_start().strip_prefix(':')?.trim_start();
        match value.strip_prefix('(') {
            Some(tuple) => Some(tuple.split_once(')')?.0.trim()),
            None => Some(value.split_once([',', '}'])?.0.trim()),
        }
    };
    find().ok_or_else(|| src.missing(At::Byte(10), name, "the header must be a dict with descr, fortran_order, shape"))
}

/// Writes `f32` values of a shape, version 1, readable by `numpy.load`.
///
/// # Errors
/// If the shape does not fit the values (as `InvalidInput`), or the writer's own.
pub fn write(shape: &[usize], values: &[f32], out: &mut dyn Write) -> std::io::Result<()> {
    let product = shape.iter().try_fold(1usize, |p, &s| p.checked_mul(s));
    if product != Some(values.len()) {
        let text = format!("shape {shape:?} does not hold {} values", values.len());
        return Err(std::io::Error::new(std::io::ErrorKind::InvalidInput, text));
    }
    let sides: String = shape.iter().map(|s| format!("{s}, ")).collect();
    let sides = if shape.len() == 1 { sides.trim_end() } else { sides.trim_end_matches(", ") };
    let mut dict = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({sides}), }}");
    let total = (MAGIC.len() + 4 + dict.len() + 1).next_multiple_of(64);
    dict.extend(std::iter::repeat_n(' ', total - MAGIC.len() - 4 - dict.len() - 1));
    dict.push('\n');
    let len = u16::try_from(dict.len()).map_err(|e| std::io::Error::new(std::io::ErrorKind::InvalidInput, e))?;
    out.write_all(MAGIC)?;
    out.write_all(&[1, 0])?;
    out.write_all(&len.to_le_bytes())?;
    out.write_all(dict.as_bytes())?;
    let mut block: Vec<u8> = Vec::with_capacity(4 * 4096);
    for values in values.chunks(4096) {
        block.clear();
        values.iter().for_each(|v| block.extend_from_slice(&v.to_le_bytes()));
        out.write_all(&block)?;
    }
    Ok(())
}

/// Writes an image as an array `[height, width, channels]`.
///
/// # Errors
/// As [`write()`].
pub fn write_image(image: &Image, out: &mut dyn Write) -> std::io::Result<()> {
    write(&[image.height, image.width, image.channels], &image.data, out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_all(bytes: &[u8]) -> Result<NpyArray, IoError> {
        read(bytes, "t.npy", &Limits::default())
    }

    fn with_header(dict: &str, data: &[u8]) -> Vec<u8> {
        let len = (dict.len() as u16).to_le_bytes();
        [MAGIC.as_slice(), &[1, 0], &len, dict.as_bytes(), data].concat()
    }

    #[test]
    fn the_other_sides_of_an_empty_array_are_bounded() {
        let dict = "{'descr': '<f4', 'fortran_order': False, 'shape': (65536, 65536, 65536, 65536, 0), }";
        let error = read_all(&with_header(dict, &[])).unwrap_err();
        assert!(error.to_string().contains("65536"), "{error}");
    }

    #[test]
    fn round_trip_and_the_exact_header() {
        for shape in [vec![], vec![6], vec![2, 3], vec![1, 2, 3], vec![0, 4]] {
            let n: usize = shape.iter().product();
            let values: Vec<f32> = (0..n).map(|i| i as f32 - 1.5).collect();
            let mut out = Vec::new();
            write(&shape, &values, &mut out).unwrap();
            assert_eq!((out.len() - 4 * n) % 64, 0);
            assert_eq!(read_all(&out).unwrap(), NpyArray { shape, values: Values::F32(values) });
        }
        let mut out = Vec::new();
        write(&[2], &[1.0, 2.0], &mut out).unwrap();
        let text = b"\x93NUMPY\x01\x00\x76\x00{'descr': '<f4', 'fortran_order': False, 'shape': (2,), }   ";
        assert!(out.starts_with(text), "{}", String::from_utf8_lossy(&out));
        assert!(write(&[3], &[1.0], &mut out).is_err());
        let mut out = Vec::new();
        write_image(&Image::zeros(3, 2, 4), &mut out).unwrap();
        assert_eq!(read_all(&out).unwrap().shape, [2, 3, 4]);
    }

    #[test]
    fn doubles_and_other_versions() {
        let dict = "{\"descr\": \"<f8\", \"fortran_order\": False, \"shape\": (1,)}\n";
        let a = read_all(&with_header(dict, &2.5f64.to_le_bytes())).unwrap();
        assert_eq!((a.to_f64(), a.to_f32()), (vec![2.5], vec![2.5f32]));
        let v2 = [MAGIC.as_slice(), &[2, 0], &(dict.len() as u32).to_le_bytes(), dict.as_bytes(), &[0; 8]].concat();
        assert_eq!(read_all(&v2).unwrap().shape, [1]);
    }

    #[test]
    fn integers_of_every_width() {
        let two = |descr: &str, data: &[u8]| {
            let dict = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (2,), }}");
            read_all(&with_header(&dict, data)).unwrap().to_f64()
        };
        assert_eq!(two("|u1", &[3, 255]), [3.0, 255.0]);
        assert_eq!(two("|i1", &[3, 255]), [3.0, -1.0]);
        assert_eq!(two("|b1", &[1, 0]), [1.0, 0.0]);
        assert_eq!(two("<u2", &[1, 2, 255, 255]), [513.0, 65535.0]);
        assert_eq!(two("<i2", &[1, 2, 254, 255]), [513.0, -2.0]);
        assert_eq!(two("<i4", &[7, 0, 0, 0, 255, 255, 255, 255]), [7.0, -1.0]);
        let wide = [300i64.to_le_bytes(), (-(1i64 << 40)).to_le_bytes()].concat();
        assert_eq!(two("<i8", &wide), [300.0, -(2.0f64.powi(40))]);
    }

    #[test]
    fn errors_are_named() {
        let dict = |descr: &str, order: &str, shape: &str| {
            format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': ({shape}), }}")
        };
        let error = |dict: &str, data: &[u8]| read_all(&with_header(dict, data)).unwrap_err().to_string();
        assert!(error(&dict("<c8", "False", "1,"), &[0; 8]).contains("type `<c8`"));
        assert!(error(&dict(">i4", "False", "1,"), &[0; 4]).contains("type `>i4`"));
        assert!(error(&dict("<f4", "True", "1,"), &[0; 4]).contains("Fortran"));
        assert!(error(&dict("<f4", "False", "-1,"), &[0; 4]).contains("side `-1`"));
        assert!(error(&dict("<f4", "False", "2,"), &[0; 4]).contains("needs 8 bytes, only 4"));
        assert!(error(&dict("<f4", "False", "1,"), &[0; 5]).contains("1 bytes follow"));
        assert!(error(&dict("<f4", "False", "1000000000, 1000000000, 1000000000"), &[0; 4]).contains("bytes"));
        assert!(error(&dict("<f4", "False", "9223372036854775808"), &[0; 4]).contains("max_rows"));
        assert!(error(&dict("<f4", "False", "1,"), &f32::NAN.to_le_bytes()).contains("row 0, `value` = NaN"));
        assert!(error("{'descr': '<f4'", &[]).contains("`descr` is missing"));
        assert!(error("{'descr': '<f4', }", &[]).contains("`fortran_order` is missing"));
        assert!(read_all(b"\x93NUMPY\x01\x00\x76").unwrap_err().to_string().contains("header length"));
        assert!(read_all(b"\x93NUMPY\x09\x00\x76\x00").unwrap_err().to_string().contains("version 9"));
        assert!(read_all(b"PK").unwrap_err().to_string().contains("magic"));
    }
}
