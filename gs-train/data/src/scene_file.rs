//! `scene.toml` in a data folder: settings of the capture that its layout has no field for.
//!
//! ```toml
//! [time]
//! boundary = 0.75      # data.time_boundary
//! range = "0..4.67"    # data.time_range
//! shift = "4:-2,17:1"  # data.time_shift
//!
//! [start]
//! points = "start.ply"                      # initial points, instead of the layout's own
//! bounds = [[-1, -1, -1], [1, 1, 1]]        # corners of the scene box
//! ```
//! Settings of the user win. Unknown keys are refused: a misspelt boundary would train on held-out times.

use std::path::{Path, PathBuf};

use glam::Vec3;
use gs_core::io::write_file;
use serde::Deserialize;

use super::error::{DataError, Place};
use super::files::{Root, read_text};
use super::options::{DataOptions, TimeRange, TimeShift};
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
#[derive(Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct TimeSection {
    pub(crate) boundary: Option<f64>,
    pub(crate) range: Option<TimeRange>,
    pub(crate) shift: Option<TimeShift>,
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

/// Writes a range or shifts of times into the section `[time]` of `scene.toml`: the range in place of what is there, shifts on top of
/// those that are there. Other lines are kept. The file's path.
///
/// # Errors
/// `limits.file`, `io.read`, `io.write`; `data.syntax` for a file that cannot be read already; `data.field`, with the file as it
/// was, if the section is written as dotted keys, in one line or with quoted names.
pub fn write_times(dir: &Path, range: Option<TimeRange>, shift: Option<&TimeShift>) -> Result<PathBuf, DataError> {
    let file = dir.join(NAME);
    let mut time = read(dir)?.time;
    time.range = range.or(time.range);
    if let Some(shift) = shift {
        let shifts = time.shift.get_or_insert_default();
        shift.0.iter().for_each(|(camera, n)| *shifts.0.entry(*camera).or_default() += n);
    }
    let old = if file.exists() { read_text(&file, MAX_BYTES)? } else { String::new() };
    let range = range.map(|r| format!("range = \"{r}\""));
    let shift = shift.and(time.shift.as_ref()).map(|s| format!("shift = \"{s}\""));
    let mut text = old.clone();
    for (key, line) in [("range", &range), ("shift", &shift)] {
        if let Some(line) = line {
            text = with_line(&text, "time", key, line);
        }
    }
    if toml::from_str::<SceneFile>(&text).ok().is_none_or(|new| new.time != time) {
        let lines: Vec<String> = [range, shift].into_iter().flatten().collect();
        return Err(no_place(&file, &old, &lines.join(" and ")));
    }
    write_file(&file, true, |out| out.write_all(text.as_bytes())).map_err(|e| DataError::unwritten(&file, e))?;
    Ok(file)
}

/// The error for a text beside whose settings of times `lines` cannot be written.
fn no_place(file: &Path, text: &str, lines: &str) -> DataError {
    let states_time = |line: &str| {
        let key = line.trim_start_matches([' ', '\t', '[', '"', '\'']);
        header(line).is_none() && ["time", "range", "shift"].iter().any(|name| key.starts_with(name))
    };
    let (at, found) = match text.lines().enumerate().find(|(_, line)| states_time(line)) {
        Some((k, line)) => (format!("line {}", k + 1), line.trim().chars().take(80).collect()),
        None => ("time".to_owned(), String::from("in another form")),
    };
    DataError::Field {
        place: Place::new(file, at),
        value: format!("{found}, beside which {lines} cannot be written"),
        why: "only a section [time] with one setting a line is added to",
        fix: "write it so, or add the setting there by hand",
    }
}

/// The name of the section that begins with a line; none where it begins none, as a row of an array does.
pub(crate) fn header(line: &str) -> Option<&str> {
    let line = line.split('#').next().unwrap_or("").trim();
    let name = line.strip_prefix('[')?.strip_suffix(']')?.trim_matches(['[', ']', ' ']);
    let bare = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    (name.chars().all(bare) && name.starts_with(|c: char| c.is_ascii_alphabetic())).then_some(name)
}

/// The text with a line of a section replaced, or added as its first; a missing section comes last.
fn with_line(text: &str, section: &str, key: &str, line: &str) -> String {
    let mut lines: Vec<&str> = text.lines().collect();
    let Some(head) = lines.iter().position(|l| header(l) == Some(section)) else {
        let gap = if text.trim().is_empty() { "" } else { "\n" };
        return format!("{}{gap}[{section}]\n{line}\n", lines.iter().map(|l| format!("{l}\n")).collect::<String>());
    };
    let end = lines[head + 1..].iter().position(|l| header(l).is_some()).map_or(lines.len(), |k| head + 1 + k);
    let is_key = |l: &&str| l.split_once('=').is_some_and(|(k, _)| k.trim() == key);
    match lines[head + 1..end].iter().position(is_key) {
        Some(k) => lines[head + 1 + k] = line,
        None => lines.insert(head + 1, line),
    }
    lines.iter().map(|l| format!("{l}\n")).collect()
}

impl SceneFile {
    /// The options; those that are not set are taken from the file.
    pub(crate) fn under(&self, options: &DataOptions) -> DataOptions {
        DataOptions {
            time_boundary: options.time_boundary.or(self.time.boundary),
            time_range: options.time_range.or(self.time.range),
            time_shift: options.time_shift.clone().or_else(|| self.time.shift.clone()),
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
        let file = read_from(b"[time]\nboundary = 0.75\nrange = \"0..2\"\nshift = \"4:-2\"\n").unwrap();
        let o = file.under(&DataOptions::default());
        assert_eq!((o.time_boundary, o.time_range.unwrap().end), (Some(0.75), 2.0));
        assert_eq!(o.time_shift.unwrap().0[&4], -2);
        let asked = DataOptions { time_boundary: Some(0.5), ..DataOptions::default() };
        assert_eq!(file.under(&asked).time_boundary, Some(0.5));
        assert_eq!(SceneFile::default().under(&asked), asked);
    }

    #[test]
    fn times_are_written_beside_what_is_there() {
        let dir = tempfile::tempdir().unwrap();
        let text = || std::fs::read_to_string(dir.path().join(NAME)).unwrap();
        let (range, shift) = ("0..94".parse().unwrap(), "4:-2".parse().unwrap());
        write_times(dir.path(), Some(range), None).unwrap();
        assert_eq!(text(), "[time]\nrange = \"0..94\"\n");
        std::fs::write(
            dir.path().join(NAME),
            "# mine\n[time] # too\nboundary = 0.5\n shift = \"1:1,4:1\"\n\n[start]\n",
        )
        .unwrap();
        write_times(dir.path(), Some(range), Some(&shift)).unwrap();
        assert_eq!(
            text(),
            "# mine\n[time] # too\nrange = \"0..94\"\nboundary = 0.5\nshift = \"1:1,4:-1\"\n\n[start]\n"
        );
        let read = read(dir.path()).unwrap().time;
        assert_eq!((read.range, read.shift.unwrap().0[&4], read.boundary), (Some(range), -1, Some(0.5)));
        std::fs::write(dir.path().join(NAME), "[start]\n").unwrap();
        write_times(dir.path(), Some(range), None).unwrap();
        assert_eq!(text(), "[start]\n\n[time]\nrange = \"0..94\"\n");
        std::fs::write(dir.path().join(NAME), "[thyme]\n").unwrap();
        assert_eq!(write_times(dir.path(), Some(range), None).unwrap_err().code(), "data.syntax");
    }

    #[test]
    fn a_file_that_leaves_no_place_for_times_stays_as_it_was() {
        let range = "0..94".parse().unwrap();
        for (text, at) in [
            ("# mine\ntime.boundary = 0.5\n", "line 2 is time.boundary = 0.5, beside"),
            ("time = { boundary = 0.5 }\n", "line 1 is time = { boundary = 0.5 }, beside"),
            ("[\"time\"]\nboundary = 0.5\n", "line 1 is [\"time\"], beside"),
            ("[time]\n\"range\" = \"0..1\"\n", "line 2 is \"range\" = \"0..1\", beside"),
        ] {
            let dir = tempfile::tempdir().unwrap();
            let file = dir.path().join(NAME);
            std::fs::write(&file, text).unwrap();
            let e = write_times(dir.path(), Some(range), None).unwrap_err();
            assert!(e.code() == "data.field" && e.to_string().starts_with(at), "{e}");
            assert!(e.to_string().contains("range = \"0..94\""), "{e}");
            assert_eq!(std::fs::read_to_string(&file).unwrap(), text);
        }
    }

    #[test]
    fn whatever_is_not_understood_is_named() {
        for (text, part) in [
            (&b"[time]\nboundry = 0.75"[..], "boundry"),
            (b"[thyme]", "thyme"),
            (b"[time]\nboundary = \"0.75\"", "invalid type"),
            (b"[time]\nrange = \"2..1\"", "no time range"),
            (b"[time\n", "line 1"),
            (b"[time]\nshift = \"4\"", "4:-2,17:1"),
            (b"[start]\npiont = 1", "piont"),
            (b"\xff", "UTF-8"),
        ] {
            let e = read_from(text).unwrap_err();
            assert!(e.code() == "data.syntax" && e.report().contains(part), "{part}: {}", e.report());
        }
        assert_eq!(read_from(&vec![b'#'; 1 << 17]).unwrap_err().code(), "limits.file");
    }
}
