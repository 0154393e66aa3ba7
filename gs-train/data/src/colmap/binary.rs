//! The binary form: little-endian records after a 64-bit count. A count is accepted only if the bytes present
//! can hold that many of the smallest records.

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;

use super::super::error::{DataError, Place};
use super::super::files::read_bytes;
use super::super::intrinsics::Intrinsics;
use super::points::SparsePoints;
use super::{ImageRow, intrinsics};

/// Largest file read.
const MAX_BYTES: u64 = 4 << 30;
/// Longest file name.
const MAX_NAME: usize = 4096;
/// Models by their number, with the number of parameters. Some are not read, and are listed for error texts.
const MODELS: [(&str, usize); 11] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
];

/// A position in the bytes of a file.
struct Cursor<'a> {
    file: &'a Path,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    fn left(&self) -> usize {
        self.bytes.len() - self.at
    }

    fn truncated(&self, needed: u64) -> DataError {
        let place = Place::new(self.file, format!("byte {}", self.at));
        DataError::Truncated { place, needed, present: self.left() as u64 }
    }

    fn take(&mut self, n: usize) -> Result<&'a [u8], DataError> {
        let taken = self.bytes.get(self.at..).and_then(|rest| rest.get(..n));
        let taken = taken.ok_or_else(|| self.truncated(n as u64))?;
        self.at += n;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], DataError> {
        let mut out = [0; N];
        out.copy_from_slice(self.take(N)?);
        Ok(out)
    }

    fn u32(&mut self) -> Result<u32, DataError> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, DataError> {
        self.array().map(u64::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64, DataError> {
        self.array().map(f64::from_le_bytes)
    }

    fn f64s<const N: usize>(&mut self) -> Result<[f64; N], DataError> {
        let mut out = [0.0; N];
        for v in &mut out {
            *v = self.f64()?;
        }
        Ok(out)
    }

    /// A count of records of at least `least` bytes each.
    fn count(&mut self, least: usize) -> Result<usize, DataError> {
        let n = self.u64()?;
        let fits = usize::try_from(n).ok().filter(|&n| n <= self.left() / least);
        fits.ok_or_else(|| self.truncated(n.saturating_mul(least as u64)))
    }

    /// Text up to a zero byte.
    fn name(&mut self) -> Result<String, DataError> {
        let rest = &self.bytes[self.at..];
        let fault = |message| DataError::syntax(self.file, format!("byte {}", self.at), message);
        let Some(end) = rest.iter().take(MAX_NAME).position(|&b| b == 0) else {
            return Err(if rest.len() < MAX_NAME { self.truncated(1) } else { fault("a file name does not end") });
        };
        let name = std::str::from_utf8(&rest[..end]).map_err(|_| fault("a file name is not UTF-8"))?.to_string();
        self.at += end + 1;
        Ok(name)
    }

    /// Nothing may follow the last record.
    fn end(&self) -> Result<(), DataError> {
        if self.left() == 0 {
            return Ok(());
        }
        Err(DataError::syntax(self.file, format!("byte {}", self.at), format!("{} bytes too many", self.left())))
    }
}

/// `cameras.bin`: id, model, width, height, parameters.
pub(super) fn cameras(file: &Path) -> Result<BTreeMap<u32, Intrinsics>, DataError> {
    const MIN_BYTES: usize = 4 + 4 + 8 + 8 + 3 * 8;
    let bytes = read_bytes(file, MAX_BYTES)?;
    let mut c = Cursor { file, bytes: &bytes, at: 0 };
    let mut cameras = BTreeMap::new();
    for row in 0..c.count(MIN_BYTES)? {
        let (id, model) = (c.u32()?, c.u32()?);
        let size = [c.u64()?, c.u64()?];
        let place = Place::new(file, format!("cameras[{row}]"));
        let Some(&(name, params)) = MODELS.get(model as usize) else {
            return Err(DataError::CameraModel { place, model: format!("number {model}") });
        };
        let params = (0..params).map(|_| c.f64()).collect::<Result<Vec<_>, _>>()?;
        cameras.insert(id, intrinsics(name, size, &params, &place)?);
    }
    c.end()?;
    Ok(cameras)
}

/// `images.bin`: id, quaternion, translation, camera, name, observations (skipped).
pub(super) fn images(file: &Path) -> Result<Vec<ImageRow>, DataError> {
    const MIN_BYTES: usize = 4 + 7 * 8 + 4 + 1 + 8;
    const OBSERVATION: usize = 24;
    let bytes = read_bytes(file, MAX_BYTES)?;
    let mut c = Cursor { file, bytes: &bytes, at: 0 };
    let count = c.count(MIN_BYTES)?;
    let mut rows = Vec::with_capacity(count);
    for row in 0..count {
        let id = c.u32()?;
        let (quat, translation) = (c.f64s()?, DVec3::from(c.f64s::<3>()?));
        let (camera, name) = (c.u32()?, c.name()?);
        let observations = c.count(OBSERVATION)?;
        c.take(observations * OBSERVATION)?;
        rows.push(ImageRow { row, id, name, quat, translation, camera });
    }
    c.end()?;
    Ok(rows)
}

/// `points3D.bin`: id, position, colour, error, track of pairs: image and its observation.
pub(super) fn points(file: &Path) -> Result<SparsePoints, DataError> {
    const MIN_BYTES: usize = 8 + 3 * 8 + 3 + 8 + 8;
    const TRACK: usize = 8;
    let bytes = read_bytes(file, MAX_BYTES)?;
    let mut c = Cursor { file, bytes: &bytes, at: 0 };
    let count = c.count(MIN_BYTES)?;
    let mut points = SparsePoints::with_capacity(count);
    for _ in 0..count {
        let _id = c.u64()?;
        let (p, rgb, _error) = (c.f64s()?, c.array()?, c.f64()?);
        points.push(p, rgb, file)?;
        for _ in 0..c.count(TRACK)? {
            let (image, _observation) = (c.u32()?, c.u32()?);
            points.seen(image);
        }
    }
    c.end()?;
    Ok(points)
}
