//! The text form: one record per line, blanks between fields, `#` starts a comment line. In `images.txt` every image has
//! a second line of observations, which may be empty and is skipped.

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;

use super::super::error::{DataError, Place};
use super::super::files::read_text;
use super::super::intrinsics::Intrinsics;
use super::points::SparsePoints;
use super::{ImageRow, intrinsics};

/// Largest file read.
const MAX_BYTES: u64 = 1 << 30;
/// Most parameters any camera model has.
const MAX_PARAMS: usize = 16;

/// A line with its number, for errors.
struct Line<'a> {
    file: &'a Path,
    number: usize,
    fields: std::str::SplitAsciiWhitespace<'a>,
}

impl<'a> Line<'a> {
    fn place(&self, field: &str) -> Place {
        Place::new(self.file, format!("line {}, {field}", self.number))
    }

    fn word(&mut self, field: &str) -> Result<&'a str, DataError> {
        self.fields.next().ok_or_else(|| DataError::Field {
            place: self.place(field),
            value: "missing".into(),
            why: "the line has too few fields",
            fix: "export the model again",
        })
    }

    fn parse<T: std::str::FromStr>(&mut self, field: &str) -> Result<T, DataError> {
        let word = self.word(field)?;
        word.parse().map_err(|_| DataError::Field {
            place: self.place(field),
            value: word.chars().take(40).collect(),
            why: "it is not the number that belongs here",
            fix: "export the model again",
        })
    }

    fn f64s<const N: usize>(&mut self, names: [&str; N]) -> Result<[f64; N], DataError> {
        let mut out = [0.0; N];
        for (v, name) in out.iter_mut().zip(names) {
            *v = self.parse(name)?;
        }
        Ok(out)
    }
}

/// Lines that are no comments, numbered from 1. Empty lines are kept.
fn lines<'a>(file: &'a Path, text: &'a str) -> impl Iterator<Item = Line<'a>> {
    text.lines().enumerate().filter(|(_, l)| !l.starts_with('#')).map(move |(k, l)| Line {
        file,
        number: k + 1,
        fields: l.split_ascii_whitespace(),
    })
}

/// Lines that are neither comments nor empty.
fn records<'a>(file: &'a Path, text: &'a str) -> impl Iterator<Item = Line<'a>> {
    lines(file, text).filter(|l| l.fields.clone().next().is_some())
}

/// `cameras.txt`: id, model, width, height, parameters.
pub(super) fn cameras(file: &Path) -> Result<BTreeMap<u32, Intrinsics>, DataError> {
    let text = read_text(file, MAX_BYTES)?;
    let mut cameras = BTreeMap::new();
    for mut line in records(file, &text) {
        let (id, model) = (line.parse("camera id")?, line.word("model")?);
        let size = [line.parse("width")?, line.parse("height")?];
        let mut params = Vec::new();
        while line.fields.clone().next().is_some() && params.len() < MAX_PARAMS {
            params.push(line.parse(&format!("params[{}]", params.len()))?);
        }
        let place = Place::new(file, format!("line {}", line.number));
        cameras.insert(id, intrinsics(model, size, &params, &place)?);
    }
    Ok(cameras)
}

/// `images.txt`: id, quaternion, translation, camera, name; then a line of observations.
pub(super) fn images(file: &Path) -> Result<Vec<ImageRow>, DataError> {
    let text = read_text(file, MAX_BYTES)?;
    let mut rows = Vec::with_capacity(lines(file, &text).count() / 2 + 1);
    let mut lines = lines(file, &text);
    while let Some(mut line) = lines.next() {
        if line.fields.clone().next().is_none() {
            continue;
        }
        let id = line.parse("image id")?;
        let quat = line.f64s(["qw", "qx", "qy", "qz"])?;
        let translation = DVec3::from(line.f64s(["tx", "ty", "tz"])?);
        let camera = line.parse("camera id")?;
        let name = line.fields.by_ref().collect::<Vec<_>>().join(" ");
        if name.is_empty() {
            line.word("name")?;
        }
        rows.push(ImageRow { row: rows.len(), id, name, quat, translation, camera });
        lines.next();
    }
    Ok(rows)
}

/// `points3D.txt`: id, position, colour, error, track of pairs: image and its observation.
pub(super) fn points(file: &Path) -> Result<SparsePoints, DataError> {
    let text = read_text(file, MAX_BYTES)?;
    let mut points = SparsePoints::with_capacity(records(file, &text).count());
    for mut line in records(file, &text) {
        let _id: u64 = line.parse("point id")?;
        let p = line.f64s(["x", "y", "z"])?;
        points.push(p, [line.parse("red")?, line.parse("green")?, line.parse("blue")?], file)?;
        let _error = line.fields.next();
        while line.fields.clone().next().is_some() {
            points.seen(line.parse("image of the track")?);
            let _observation = line.fields.next();
        }
    }
    Ok(points)
}
