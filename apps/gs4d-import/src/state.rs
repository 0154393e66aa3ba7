//! `import.json`: what was imported, how, and how far it came, so that an interrupted import goes on and a finished one is recognised
//! from a folder of somebody's own.

use crate::clock::Clocks;
use crate::error::ImportError;
use crate::frames;
use crate::look::Rig;
use crate::own::{check_outside, entries};
use crate::probe::Video;
use crate::rates::Cut;
use crate::settings::{Settings, Source};
use gs_core::io::write_file;
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::Path;
use std::time::UNIX_EPOCH;

/// Name of the file.
pub(crate) const NAME: &str = "import.json";
const MADE_BY: &str = "gs4d import";
const VERSION: u32 = 1;
/// Folder of the database, models and the log.
pub(crate) const WORK: &str = "import";

/// A file or folder that was imported.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Input {
    /// Its path.
    pub path: String,
    /// Bytes in it, of a folder in all its images.
    pub bytes: u64,
    /// When it was changed last, seconds since 1970.
    pub changed: u64,
}

impl Input {
    fn of(path: &Path) -> Result<Self, ImportError> {
        let meta = fs::metadata(path).map_err(ImportError::os("read", path))?;
        let changed = meta.modified().ok().and_then(|t| t.duration_since(UNIX_EPOCH).ok()).map_or(0, |d| d.as_secs());
        let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
        Ok(Self { path: absolute.display().to_string(), bytes: meta.len(), changed })
    }

    fn of_source(source: &Source) -> Result<Vec<Self>, ImportError> {
        match source {
            Source::Videos(files) => files.iter().map(|f| Self::of(f)).collect(),
            Source::Images(folder) => {
                let files = frames::cameras_of(folder)?.into_iter().flat_map(|c| c.1);
                let each = files.map(|f| Self::of(&f)).collect::<Result<Vec<_>, _>>()?;
                let changed = each.iter().map(|i| i.changed).max().unwrap_or(0);
                Ok(vec![Self { bytes: each.iter().map(|i| i.bytes).sum(), changed, ..Self::of(folder)? }])
            }
        }
    }
}

/// How far the search for cameras came.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Solving {
    /// Which attempt, from 0.
    pub(crate) attempt: usize,
    pub(crate) extracted: bool,
    pub(crate) matched: bool,
    /// Folder of the model.
    pub(crate) model: Option<String>,
    /// Whether the other frames have features and matches.
    pub(crate) rest_matched: bool,
}

/// The file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct State {
    made_by: String,
    version: u32,
    pub(crate) inputs: Vec<Input>,
    pub(crate) settings: Settings,
    #[serde(default)]
    pub(crate) videos: Vec<Video>,
    #[serde(default)]
    pub(crate) rig: Option<Rig>,
    #[serde(default)]
    pub(crate) why: String,
    #[serde(default)]
    pub(crate) clocks: Option<Clocks>,
    #[serde(default)]
    pub(crate) cut: Option<Cut>,
    /// Images of each camera of a folder, all of which are copied; none of videos.
    #[serde(default)]
    pub(crate) images: Vec<usize>,
    /// Frames of the cameras that have them.
    #[serde(default)]
    pub(crate) frames: Vec<usize>,
    /// Numbers of frames that are left out, by reason: blurred, duplicate, of no known place.
    #[serde(default)]
    pub(crate) left_out: Option<LeftOut>,
    #[serde(default)]
    pub(crate) solving: Solving,
    #[serde(default)]
    pub(crate) finished: Option<serde_json::Value>,
}

/// Frames that are not used, `[camera, frame]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Much less sharp than those around them.
    pub blurred: Vec<[usize; 2]>,
    /// The same as the one before.
    pub duplicate: Vec<[usize; 2]>,
    /// Not placed by COLMAP.
    pub unplaced: Vec<[usize; 2]>,
}

impl LeftOut {
    /// Whether a frame is left out for what it shows.
    pub(crate) fn has(&self, frame: [usize; 2]) -> bool {
        self.blurred.contains(&frame) || self.duplicate.contains(&frame)
    }
}

impl State {
    /// Begins an import in a folder, or goes on with the one that is there.
    ///
    /// # Errors
    /// [`ImportError::Occupied`] if the folder holds something else, [`ImportError::Changed`] if it holds an import of other inputs or
    /// settings; with `force` that one's files are removed. [`ImportError::Input`], before anything is removed, if others' files lie where
    /// frames are, or images or masks inside the folder.
    pub(crate) fn begin(data: &Path, source: &Source, settings: &Settings, force: bool) -> Result<Self, ImportError> {
        check_outside(data, source, settings)?;
        let fresh = Self {
            made_by: MADE_BY.to_owned(),
            version: VERSION,
            inputs: Input::of_source(source)?,
            settings: settings.clone(),
            videos: Vec::new(),
            rig: None,
            why: String::new(),
            clocks: None,
            cut: None,
            images: Vec::new(),
            frames: Vec::new(),
            left_out: None,
            solving: Solving::default(),
            finished: None,
        };
        match Self::read(data)? {
            Some(old) if force => old.remove(&fresh, data)?,
            Some(old) => return old.agree(fresh, data),
            None if !entries(data)?.is_empty() => return Err(ImportError::Occupied { folder: data.to_path_buf() }),
            None => {}
        }
        frames::create(&data.join(WORK))?;
        fresh.save(data)?;
        Ok(fresh)
    }

    fn read(data: &Path) -> Result<Option<Self>, ImportError> {
        let file = data.join(NAME);
        if !file.is_file() {
            return Ok(None);
        }
        let bytes = fs::read(&file).map_err(ImportError::os("read", &file))?;
        let state: Option<Self> = serde_json::from_slice(&bytes).ok();
        match state.filter(|s| s.made_by == MADE_BY && s.version == VERSION) {
            Some(state) => Ok(Some(state)),
            None => Err(ImportError::Occupied { folder: data.to_path_buf() }),
        }
    }

    /// This import, if another call asks for the same. Until it is done it may hold out another camera.
    fn agree(mut self, asked: Self, data: &Path) -> Result<Self, ImportError> {
        let changed = |what: String| Err(ImportError::Changed { folder: data.to_path_buf(), what });
        if self.inputs != asked.inputs {
            return changed("inputs".to_owned());
        }
        if self.finished.is_none() {
            self.settings.held_out = asked.settings.held_out;
        }
        self.settings.max_image_mib = asked.settings.max_image_mib;
        let [old, new] = [&self.settings, &asked.settings].map(|s| serde_json::to_value(s).unwrap_or_default());
        let differs = old.as_object().into_iter().flatten().find(|(key, value)| new.get(key) != Some(value));
        match differs {
            Some((key, value)) => changed(format!("settings ({key} was {value})")),
            None => Ok(self),
        }
    }

    /// Writes the file.
    pub(crate) fn save(&self, data: &Path) -> Result<(), ImportError> {
        let write = |out: &mut dyn std::io::Write| {
            serde_json::to_writer_pretty(&mut *out, self)?;
            out.write_all(b"\n")
        };
        Ok(write_file(&data.join(NAME), true, write)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_import_goes_on_with_the_same_and_with_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let (video, data) = (dir.path().join("a.mp4"), dir.path().join("data"));
        fs::write(&video, "x").unwrap();
        let source = Source::Videos(vec![video.clone()]);
        let settings = Settings::default();
        let mut state = State::begin(&data, &source, &settings, false).unwrap();
        state.frames = vec![7];
        state.save(&data).unwrap();
        assert_eq!(State::begin(&data, &source, &settings, false).unwrap().frames, [7]);
        let larger = Settings { max_image_mib: Some(500), ..settings.clone() };
        let again = State::begin(&data, &source, &larger, false).unwrap();
        assert_eq!((again.frames, again.settings.max_image_mib), (vec![7], Some(500)), "memory makes no other import");
        let other = Settings { keyframes: 9, ..settings.clone() };
        let e = State::begin(&data, &source, &other, false).unwrap_err().to_string();
        assert!(e.contains("keyframes was 100"), "{e}");
        fs::write(&video, "xy").unwrap();
        let e = State::begin(&data, &source, &settings, false).unwrap_err().to_string();
        assert!(e.contains("other inputs"), "{e}");
    }

    #[test]
    fn folders_of_others_are_left_alone() {
        let dir = tempfile::tempdir().unwrap();
        let (video, data) = (dir.path().join("a.mp4"), dir.path().join("data"));
        fs::write(&video, "x").unwrap();
        fs::create_dir(&data).unwrap();
        let source = Source::Videos(vec![video]);
        for (file, text) in [("transforms.json", "{}"), ("import.json", "{\"made_by\": \"somebody\"}")] {
            fs::write(data.join(file), text).unwrap();
            for force in [false, true] {
                let e = State::begin(&data, &source, &Settings::default(), force).unwrap_err();
                assert!(matches!(e, ImportError::Occupied { .. }), "{e}");
            }
        }
        assert_eq!(fs::read_dir(&data).unwrap().count(), 2);
    }
}
