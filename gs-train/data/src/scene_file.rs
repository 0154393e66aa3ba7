//! `scene.toml` in a data folder: settings of the capture that its layout has no field for.
//!
//! ```toml
//! [time]
//! boundary = 0.75      # data.time_boundary
//! range = "0..4.67"    # data.time_range
//!
//! [start]
//! points = "start.ply"                      # initial points, instead of the layout's own
//! bounds = [[-1, -1, -1], [1, 1, 1]]        # corners of the scene box
//! ```
//! Settings of the user win. Unknown keys are refused: a misspelt boundary would train on held-out times.

use std::path::Path;

use glam::Vec3;
use serde::Deserialize;

use super::error::{DataError, Place};
use super::files::{Root, read_text};
use super::options::{DataOptions, TimeRange};
use super::{Dataset, ply};

/// Name of the file.
pub(crate) const NAME: &str = "scene.toml";
/// Largest file read; a usual one has a few lines.
pub(crate) const MAX_BYTES: u64 = 64 << 10;

/// The parsed file; every section is optional.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct SceneFile {
    pub(crate) time: TimeSection,
    pub(crate) start: StartSection,
}

/// The section `[start]`.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct StartSection {
    pub(crate) points: Option<String>,
    pub(crate) bounds: Option<[[f32; 3]; 2]>,
}

/// The section `[time]`.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct TimeSection {
    pub(crate) boundary: Option<f64>,
    pub(crate) range: Option<TimeRange>,
}

/// Reads the file of a folder; empty where there is none.
///
/// # Errors
/// `limits.file`, `io.read`, `data.syntax`.
pub(crate) fn read(dir: &Path) -> Result<SceneFile, DataError> {
    let file = dir.join(NAME);
    if !file.exists() {
        return Ok(SceneFile::default());
    }
    let text = read_text(&file, MAX_BYTES)?;
    toml::from_str(&text).map_err(|e| {
        let before = e.span().and_then(|s| text.get(..s.start));
        let at = before.map_or(String::new(), |b| format!("line {}", b.matches('\n').count() + 1));
        DataError::syntax(&file, at, e.message())
    })
}

impl SceneFile {
    /// The options; those that are not set are taken from the file.
    pub(crate) fn under(&self, options: &DataOptions) -> DataOptions {
        DataOptions {
            time_boundary: options.time_boundary.or(self.time.boundary),
            time_range: options.time_range.or(self.time.range),
            ..options.clone()
        }
    }

    /// Sets the points and the box of a data set to those that the file names.
    ///
    /// # Errors
    /// `data.escape`, `data.points`; `data.field` for a box without an inside.
    pub(crate) fn apply_start(&self, data: &mut Dataset) -> Result<(), DataError> {
        let file = data.root.join(NAME);
        if let Some(written) = &self.start.points {
            let path = Root::new(&data.root)?.resolve(written, &Place::new(&file, "start.points"))?;
            let points = ply::read_points(&path)?;
            data.notes.push(format!("{} initial points from {written}, as {NAME} says", points.positions.len()));
            data.points = Some(points);
        }
        if let Some([low, high]) = self.start.bounds {
            if !(0..3).all(|k| low[k] < high[k] && low[k].is_finite() && high[k].is_finite()) {
                return Err(DataError::Field {
                    place: Place::new(&file, "start.bounds"),
                    value: format!("{low:?} to {high:?}"),
                    why: "the first corner must lie below the second on every axis",
                    fix: "correct the corners, or remove the line",
                });
            }
            data.bounds = Some([low, high].map(Vec3::from));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_from(text: &[u8]) -> Result<SceneFile, DataError> {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join(NAME), text).unwrap();
        read(dir.path())
    }

    #[test]
    fn the_user_wins() {
        let file = read_from(b"[time]\nboundary = 0.75\nrange = \"0..2\"\n").unwrap();
        let o = file.under(&DataOptions::default());
        assert_eq!((o.time_boundary, o.time_range.unwrap().end), (Some(0.75), 2.0));
        let asked = DataOptions { time_boundary: Some(0.5), ..DataOptions::default() };
        assert_eq!(file.under(&asked).time_boundary, Some(0.5));
        assert_eq!(SceneFile::default().under(&asked), asked);
    }

    #[test]
    fn whatever_is_not_understood_is_named() {
        for (text, part) in [
            (&b"[time]\nboundry = 0.75"[..], "boundry"),
            (b"[thyme]", "thyme"),
            (b"[time]\nboundary = \"0.75\"", "invalid type"),
            (b"[time]\nrange = \"2..1\"", "no time range"),
            (b"[time\n", "line 1"),
            (b"[start]\npiont = 1", "piont"),
            (b"\xff", "UTF-8"),
        ] {
            let e = read_from(text).unwrap_err();
            assert!(e.code() == "data.syntax" && e.report().contains(part), "{part}: {}", e.report());
        }
        assert_eq!(read_from(&vec![b'#'; 1 << 17]).unwrap_err().code(), "limits.file");
    }
}
