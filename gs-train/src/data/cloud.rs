//! Tables from `.npy` files: rows of fixed width, and points without colours.

use std::path::Path;

use glam::{DVec3, Vec3};
use gs_core::io::{Limits, npy};

use super::error::{DataError, Place};
use super::files::read_bytes;

/// Largest file read: 40 million points in `f64`.
const MAX_BYTES: u64 = 1 << 30;

/// Reads the `P × 3` points of a file and moves each by `place_in_world`.
///
/// # Errors
/// As [`read_rows`]; `data.field` if a point ends up beyond the range of `f32`.
pub(crate) fn read_triples(file: &Path, place_in_world: impl Fn(DVec3) -> DVec3) -> Result<Vec<Vec3>, DataError> {
    let rows = read_rows(file, 3)?;
    let mut positions = Vec::with_capacity(rows.len() / 3);
    for (i, row) in rows.chunks_exact(3).enumerate() {
        let p = place_in_world(DVec3::from_slice(row)).as_vec3();
        if !p.is_finite() {
            return Err(DataError::Field {
                place: Place::new(file, format!("row {i}")),
                value: format!("{row:?}, which is no finite point of the scene"),
                why: "it must be a finite number",
                fix: "remove the point",
            });
        }
        positions.push(p);
    }
    Ok(positions)
}

/// Reads an array of shape `[n, width]`, row by row.
///
/// # Errors
/// `io.read`, `limits.file`, `data.syntax` with whatever the array's reader finds, `data.field` for another shape.
pub(crate) fn read_rows(file: &Path, width: usize) -> Result<Vec<f64>, DataError> {
    let bytes = read_bytes(file, MAX_BYTES)?;
    let array = npy::read(&bytes, &file.display().to_string(), &Limits::default())
        .map_err(|e| DataError::syntax(file, "", e.to_string()))?;
    if array.shape.len() != 2 || array.shape[1] != width {
        return Err(DataError::Field {
            place: Place::new(file, "shape"),
            value: format!("{:?}, not n rows of {width}", array.shape),
            why: "the meaning of its columns is fixed by the layout",
            fix: "export the array again",
        });
    }
    drop(bytes);
    Ok(match array.values {
        npy::Values::F64(v) => v,
        npy::Values::F32(v) => v.into_iter().map(f64::from).collect(),
    })
}
