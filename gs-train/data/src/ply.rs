//! Initial points as `.ply`: `x y z` and, where present, `red green blue` (0 to 255).

use std::io::Write;
use std::path::Path;

use glam::Vec3;
use gs_core::cast;
use gs_core::io::{self, Limits};

use super::error::{DataError, Place};
use super::files::Root;
use super::view::PointCloud;

/// The initial points in a file of the data folder, with a note; none if it is not there.
///
/// # Errors
/// `data.escape`, and as [`read_points`].
pub(crate) fn initial_points(
    root: &Root,
    name: &str,
    notes: &mut Vec<String>,
) -> Result<Option<PointCloud>, DataError> {
    let file = root.resolve(name, &Place::new(root.dir(), name))?;
    if !file.is_file() {
        return Ok(None);
    }
    notes.push(format!("initial points come from {name}"));
    read_points(&file).map(Some)
}

/// Reads the points of a file; those without colours are grey.
///
/// # Errors
/// `data.points` with the error of the PLY reader.
pub(crate) fn read_points(file: &Path) -> Result<PointCloud, DataError> {
    let (positions, colors) = read_measured(file)?;
    let colors = colors.unwrap_or_else(|| vec![[0.5; 3]; positions.len()]);
    Ok(PointCloud { positions, colors })
}

/// Positions and, where the file has them, colours in 0..1.
type Measured = (Vec<Vec3>, Option<Vec<[f32; 3]>>);

/// Reads the points of a file.
///
/// # Errors
/// As [`read_points`].
pub(crate) fn read_measured(file: &Path) -> Result<Measured, DataError> {
    let failed = |source| DataError::Points { file: file.to_path_buf(), source: Box::new(source) };
    let limits = Limits::default();
    let bytes = io::read_file(file, &limits).map_err(failed)?;
    let name = file.display().to_string();
    let columns = |names: &[&str]| io::ply::read_columns(&bytes, &name, &limits, names).map_err(failed);
    let triples = |flat: Vec<f32>| flat.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect::<Vec<_>>();
    let positions: Vec<Vec3> = triples(columns(&["x", "y", "z"])?).into_iter().map(Vec3::from).collect();
    let properties = io::ply::property_names(&bytes, &name).map_err(failed)?;
    let colored = ["red", "green", "blue"].iter().all(|c| properties.iter().any(|p| p == c));
    if !colored {
        return Ok((positions, None));
    }
    let bytes = triples(columns(&["red", "green", "blue"])?);
    Ok((positions, Some(bytes.into_iter().map(|c| c.map(|v| (v / 255.0).clamp(0.0, 1.0))).collect())))
}

/// Writes points as binary PLY: `x y z` as `f32`, `red green blue` as `u8`.
///
/// ```
/// let cloud = gs_data::PointCloud { positions: vec![glam::Vec3::ONE], colors: vec![[1.0, 0.5, 0.0]] };
/// let mut bytes = Vec::new();
/// gs_data::ply::write_points(&cloud, &mut bytes)?;
/// assert!(bytes.ends_with(&[255, 128, 0]));
/// # Ok::<(), std::io::Error>(())
/// ```
///
/// # Errors
/// Those of `out`.
pub fn write_points(cloud: &PointCloud, out: &mut dyn Write) -> std::io::Result<()> {
    writeln!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}", cloud.positions.len())?;
    ["x", "y", "z"].iter().try_for_each(|c| writeln!(out, "property float {c}"))?;
    ["red", "green", "blue"].iter().try_for_each(|c| writeln!(out, "property uchar {c}"))?;
    writeln!(out, "end_header")?;
    for (p, c) in cloud.positions.iter().zip(&cloud.colors) {
        p.to_array().iter().try_for_each(|v| out.write_all(&v.to_le_bytes()))?;
        out.write_all(&c.map(|v| cast::to_u8((v.clamp(0.0, 1.0) * 255.0).round())))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_with_and_without_colours_are_read() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("points.ply");
        let head = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n";
        let color = "property uchar red\nproperty uchar green\nproperty uchar blue\n";
        std::fs::write(&file, format!("{head}{color}end_header\n1 2 3 255 0 51\n4 5 6 0 0 0\n")).unwrap();
        let cloud = read_points(&file).unwrap();
        assert_eq!((cloud.positions[1], cloud.colors[0]), (Vec3::new(4.0, 5.0, 6.0), [1.0, 0.0, 0.2]));
        std::fs::write(&file, format!("{head}end_header\n1 2 3\n4 5 6\n")).unwrap();
        assert_eq!(read_points(&file).unwrap().colors, vec![[0.5; 3]; 2]);
        std::fs::write(&file, format!("{head}end_header\n1 2 nan\n4 5 6\n")).unwrap();
        let e = read_points(&file).unwrap_err();
        assert!(e.code() == "data.points" && e.to_string().contains('z'), "{e}");
    }

    #[test]
    fn what_is_written_is_read() {
        let cloud = PointCloud {
            positions: vec![Vec3::new(1.5, -2.0, 3e-7), Vec3::ZERO],
            colors: vec![[0.0, 1.0, 0.2], [1.0, 0.4, 0.6]],
        };
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("points.ply");
        write_points(&cloud, &mut std::fs::File::create(&file).unwrap()).unwrap();
        assert_eq!(read_points(&file).unwrap(), cloud);
    }
}
