//! Measured points of a frame: PLY, OBJ (its `v` lines alone), or plain numbers.

use std::path::Path;

use glam::Vec3;

use crate::avatar::{MeasuredPoints, SurfacePoints};
use crate::error::{DataError, Place};
use crate::files::{Root, read_bytes, read_text};
use crate::ply::read_measured;

/// Extensions of a frame's points; the first that exists is read.
const EXTENSIONS: [&str; 3] = ["ply", "obj", "bin"];
/// Largest file: 20 million points as numbers.
const MAX_BYTES: u64 = 256 << 20;
/// Bytes of a point in a `.bin`: `x y z`, `f32`, little-endian.
const POINT: usize = 12;

/// The points of a frame, if there is a file.
pub(super) fn find(root: &Root, number: u32) -> Result<Option<SurfacePoints>, DataError> {
    for extension in EXTENSIONS {
        let name = format!("points/{number:06}.{extension}");
        let file = root.resolve(&name, &Place::new(root.dir(), name.as_str()))?;
        if file.is_file() {
            return Ok(Some(SurfacePoints::File(file)));
        }
    }
    Ok(None)
}

/// Reads a file of points, by its extension.
///
/// # Errors
/// `data.points`, `data.syntax`, `data.truncated` or `data.field` if the file is damaged; `io.read` if it cannot be read.
pub(crate) fn read(file: &Path) -> Result<MeasuredPoints, DataError> {
    match file.extension().and_then(|e| e.to_str()) {
        Some("obj") => of_obj(file).map(MeasuredPoints::uncoloured),
        Some("bin") => of_bin(file).map(MeasuredPoints::uncoloured),
        _ => read_measured(file).map(|(positions, colors)| MeasuredPoints { positions, colors }),
    }
}

fn of_obj(file: &Path) -> Result<Vec<Vec3>, DataError> {
    let text = read_text(file, MAX_BYTES)?;
    let mut points = Vec::new();
    for (k, line) in text.lines().enumerate() {
        let Some(rest) = line.trim_start().strip_prefix("v ") else { continue };
        let mut numbers = rest.split_ascii_whitespace().map(|w| w.parse::<f32>().ok().filter(|v| v.is_finite()));
        let point = match [numbers.next(), numbers.next(), numbers.next()] {
            [Some(Some(x)), Some(Some(y)), Some(Some(z))] => Vec3::new(x, y, z),
            _ => return Err(DataError::syntax(file, format!("line {}", k + 1), "a point has three finite numbers")),
        };
        points.push(point);
    }
    Ok(points)
}

fn of_bin(file: &Path) -> Result<Vec<Vec3>, DataError> {
    let bytes = read_bytes(file, MAX_BYTES)?;
    let (rows, rest) = bytes.as_chunks::<POINT>();
    if !rest.is_empty() {
        let place = Place::new(file, format!("byte {}", bytes.len() - rest.len()));
        return Err(DataError::Truncated { place, needed: POINT as u64, present: rest.len() as u64 });
    }
    let number = |row: &[u8; POINT], k: usize| f32::from_le_bytes([row[k], row[k + 1], row[k + 2], row[k + 3]]);
    let points: Vec<Vec3> = rows.iter().map(|r| Vec3::new(number(r, 0), number(r, 4), number(r, 8))).collect();
    match points.iter().position(|p| !p.is_finite()) {
        None => Ok(points),
        Some(at) => Err(DataError::syntax(file, format!("point {at}"), "a point has three finite numbers")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(name: &str, content: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join(name);
        std::fs::write(&file, content).unwrap();
        (dir, file)
    }

    #[test]
    fn points_of_every_kind_are_the_same() {
        let want = vec![Vec3::new(1.0, -2.5, 3.0), Vec3::new(0.0, 1e-3, 4.0)];
        let (_a, obj) = written("0.obj", b"# scan\nv 1 -2.5 3\nvn 0 0 1\n  v 0 1e-3 4 0.5 0.5 0.5\nf 1 1 1\n");
        assert_eq!(read(&obj).unwrap(), MeasuredPoints::uncoloured(want.clone()));
        let bytes: Vec<u8> = want.iter().flat_map(|p| p.to_array()).flat_map(f32::to_le_bytes).collect();
        let (_b, bin) = written("0.bin", &bytes);
        assert_eq!(read(&bin).unwrap(), MeasuredPoints::uncoloured(want.clone()));
        let (_c, cut) = written("0.bin", &bytes[..20]);
        assert_eq!(read(&cut).unwrap_err().code(), "data.truncated");
        let (_d, odd) = written("0.bin", &[0xff; 12]);
        assert!(read(&odd).unwrap_err().to_string().contains("point 0"));
        for bad in ["v 1 2\n", "v 1 2 nan\n", "v a b c\n"] {
            let (_e, file) = written("0.obj", bad.as_bytes());
            assert!(read(&file).unwrap_err().to_string().contains("line 1"), "{bad}");
        }
    }
}
