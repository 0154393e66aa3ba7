//! Tables from `.npy` files: rows of fixed width, points with and without colours.

use std::path::Path;

use glam::{DVec3, Vec3};
use gs_core::cast;
use gs_core::io::{IoError, Limits, npy, zip};

use super::PointCloud;
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
        positions.push(finite_point(file, i, place_in_world(DVec3::from_slice(row)))?);
    }
    Ok(positions)
}

/// Reads points from rows that begin with x, y, z, r, g, b, colours in 0..1 (others are clamped); what follows is left out.
///
/// # Errors
/// As [`read_rows`]; `data.field` if a point lies beyond the range of `f32`.
pub(crate) fn read_coloured(file: &Path, width: usize) -> Result<PointCloud, DataError> {
    let rows = read_rows(file, width)?;
    let mut cloud = PointCloud::default();
    for (i, row) in rows.chunks_exact(width).enumerate() {
        cloud.positions.push(finite_point(file, i, DVec3::from_slice(row))?);
        cloud.colors.push([3, 4, 5].map(|c| cast::to_f32(row[c].clamp(0.0, 1.0))));
    }
    Ok(cloud)
}

fn finite_point(file: &Path, row: usize, p: DVec3) -> Result<Vec3, DataError> {
    let point = p.as_vec3();
    if point.is_finite() {
        return Ok(point);
    }
    Err(DataError::Field {
        place: Place::new(file, format!("row {row}")),
        value: format!("{:?}, which is no finite point of the scene", p.to_array()),
        why: "it must be a finite number",
        fix: "remove the point",
    })
}

/// Reads an array of shape `[n, width]`, row by row: an `.npy` file, or the table `data` of an `.npz`.
///
/// # Errors
/// `io.read`, `limits.file`, `data.syntax` with the error of the array's reader, `data.field` for another shape.
pub(crate) fn read_rows(file: &Path, width: usize) -> Result<Vec<f64>, DataError> {
    let mut bytes = read_bytes(file, MAX_BYTES)?;
    if file.extension().is_some_and(|e| e == "npz") {
        bytes =
            zip::member(&bytes, &file.display().to_string(), "data.npy", &Limits::default()).map_err(|e| match e {
                IoError::Limit { value, limit, .. } => {
                    DataError::TooLarge { place: Place::new(file, "data.npy"), bytes: value, limit }
                }
                e => DataError::syntax(file, "", e.to_string()),
            })?;
    }
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
