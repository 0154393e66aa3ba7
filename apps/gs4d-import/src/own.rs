//! Which files of a data set an import made, and their removal: those of somebody else stay.

use crate::error::ImportError;
use crate::frames::{self, EXTENSIONS, IMAGES, MASKS, camera_name, clear};
use crate::settings::{Settings, Source};
use crate::state::{NAME, State, WORK};
use std::collections::BTreeSet;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Files that an import, and the doctor and `init` after it, write.
const OWN_FILES: [&str; 6] = ["transforms.json", "points.ply", "start.ply", SCENE, "doctor.html", NAME];
/// Where `init` writes a section, and the user what is theirs.
const SCENE: &str = "scene.toml";

impl State {
    /// Removes what this import made, and nothing else.
    ///
    /// # Errors
    /// [`ImportError::Input`], before anything is removed, if there are files of others where the import `next` writes.
    pub(crate) fn remove(&self, next: &Self, data: &Path) -> Result<(), ImportError> {
        let with_masks = self.settings.masks.is_some() || next.settings.masks.is_some();
        let parents: &[(&str, bool)] = if with_masks { &[(IMAGES, false), (MASKS, true)] } else { &[(IMAGES, false)] };
        let mut own = Vec::new();
        for &(parent, is_mask) in parents {
            for camera in cameras_in(&data.join(parent))? {
                own.push(self.own(data, camera, is_mask)?);
            }
        }
        let scene = data.join(SCENE);
        if scene.is_file() && !is_only_start(&scene) {
            return Err(ImportError::Input {
                what: "it holds settings of yours, or of `gs4d doctor --fix`, beside the section [start]".to_owned(),
                path: scene,
                why: "only what an import made is removed",
                fix: "move it away, and copy the other sections back after the import".to_owned(),
            });
        }
        own.iter().try_for_each(Own::remove)?;
        // What somebody has put beside the cameras stays.
        parents.iter().for_each(|(parent, _)| drop(fs::remove_dir(data.join(parent))));
        clear(&data.join(WORK))?;
        for file in OWN_FILES.map(|f| data.join(f)) {
            match fs::remove_file(&file) {
                Err(e) if e.kind() != ErrorKind::NotFound => return Err(ImportError::os("remove", &file)(e)),
                _ => {}
            }
        }
        Ok(())
    }

    /// Removes what an interruption left of the images, or masks, of the camera that comes next.
    ///
    /// # Errors
    /// [`ImportError::Input`], before anything is removed, if there are files of others.
    pub(crate) fn clear_next(&self, data: &Path, is_mask: bool) -> Result<(), ImportError> {
        if is_mask && self.settings.masks.is_none() {
            return Ok(());
        }
        self.own(data, self.frames.len(), is_mask)?.remove()
    }

    /// What this import made of the images, or masks, of a camera.
    ///
    /// # Errors
    /// [`ImportError::Input`] if anything else is there.
    fn own(&self, data: &Path, camera: usize, is_mask: bool) -> Result<Own, ImportError> {
        let folder = data.join(if is_mask { MASKS } else { IMAGES }).join(camera_name(camera));
        if folder.symlink_metadata().is_ok_and(|m| !m.is_dir()) {
            return Err(of_others(&[], &folder));
        }
        let (made, endings) = (self.made(camera, is_mask), self.endings(is_mask));
        let mut numbers = BTreeSet::new();
        // Of two files with one number, one is of somebody else.
        let is_own = |file: &PathBuf| {
            let ending = file.extension().is_some_and(|e| endings.iter().any(|known| e == *known));
            ending && frames::number(file).is_some_and(|k| k < made && numbers.insert(k))
        };
        let (files, others): (Vec<_>, Vec<_>) = entries(&folder)?.into_iter().partition(is_own);
        if others.is_empty() { Ok(Own { folder, files }) } else { Err(of_others(&others, &folder)) }
    }

    /// Frames of a camera that this import made have numbers below this.
    fn made(&self, camera: usize, is_mask: bool) -> usize {
        let with_masks = self.settings.masks.is_some();
        let of_videos = self.cut.as_ref().filter(|c| camera < c.begins.len()).map_or(0, |c| c.frames);
        let taken = self.images.get(camera).copied().unwrap_or(of_videos);
        match self.frames.get(camera) {
            _ if is_mask && !with_masks => 0,
            // Images or masks may be more than those that count, which have both.
            Some(&n) if with_masks => n.max(taken),
            Some(&n) => n,
            // An interruption may have left the next camera whole, and no other.
            None if camera > self.frames.len() => 0,
            None => taken,
        }
    }

    /// How names of its images, or masks, end.
    fn endings(&self, is_mask: bool) -> &'static [&'static str] {
        match (is_mask, self.videos.is_empty()) {
            (true, _) => &["png"],
            (false, false) => &["jpg"],
            (false, true) => &EXTENSIONS,
        }
    }
}

/// Numbers of the cameras that have something in a folder of images or masks.
fn cameras_in(parent: &Path) -> Result<Vec<usize>, ImportError> {
    let number = |name: &str| -> Option<usize> {
        let digits = name.strip_prefix("cam")?;
        digits.parse::<usize>().ok().filter(|camera| camera_name(*camera) == name)
    };
    let names = entries(parent)?.into_iter().filter_map(|p| Some(p.file_name()?.to_string_lossy().into_owned()));
    Ok(names.filter_map(|name| number(&name)).collect())
}

/// What lies in a folder, in order of names; nothing in one that is not there.
pub(crate) fn entries(folder: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let mut found: Vec<PathBuf> = match fs::read_dir(folder) {
        Ok(list) => list.flatten().map(|e| e.path()).collect(),
        Err(e) if e.kind() == ErrorKind::NotFound => Vec::new(),
        Err(e) => return Err(ImportError::os("list the folder", folder)(e)),
    };
    found.sort();
    Ok(found)
}

/// Refuses images and masks that lie inside the data set: what is there may be removed.
pub(crate) fn check_outside(data: &Path, source: &Source, settings: &Settings) -> Result<(), ImportError> {
    // Nothing lies in a folder that is not there yet.
    let Ok(place) = data.canonicalize() else { return Ok(()) };
    let images = match source {
        Source::Videos(_) => None,
        Source::Images(folder) => Some(folder),
    };
    let inside = |folder: &&PathBuf| folder.canonicalize().is_ok_and(|f| f.starts_with(&place));
    match [images, settings.masks.as_ref()].into_iter().flatten().find(inside) {
        None => Ok(()),
        Some(folder) => Err(ImportError::Input {
            what: format!("the folder lies inside the data set that is made of it, {}", data.display()),
            path: folder.clone(),
            why: "an import writes there, and -f removes what an import wrote",
            fix: "move it out of there, or choose another folder with -o".to_owned(),
        }),
    }
}

/// The folder of a camera, and the frames in it that an import made.
struct Own {
    folder: PathBuf,
    files: Vec<PathBuf>,
}

impl Own {
    /// Removes the frames, and the folder.
    fn remove(&self) -> Result<(), ImportError> {
        for file in &self.files {
            fs::remove_file(file).map_err(ImportError::os("remove", file))?;
        }
        // It may not be there.
        let _ = fs::remove_dir(&self.folder);
        Ok(())
    }
}

/// Whether a settings file has the section `[start]` and nothing else.
fn is_only_start(scene: &Path) -> bool {
    let table = fs::read_to_string(scene).ok().and_then(|text| text.parse::<toml::Table>().ok());
    table.is_some_and(|table| table.keys().all(|key| key == "start"))
}

/// The error for files that an import did not make.
fn of_others(files: &[PathBuf], folder: &Path) -> ImportError {
    let what = match files.len() {
        0 | 1 => "it lies where frames do, and the import did not make it".to_owned(),
        n => format!("{n} files lie where frames do, and the import did not make them; this is the first"),
    };
    ImportError::Input {
        what,
        path: files.first().map_or(folder, PathBuf::as_path).to_path_buf(),
        why: "frames are written there, and only what an import made is removed",
        fix: "move them away, or choose another folder with -o".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::probe::Video;
    use crate::rates::Cut;

    /// A file in a folder, and the folders above it.
    fn put(data: &Path, file: &str) {
        fs::create_dir_all(data.join(file).parent().unwrap()).unwrap();
        fs::write(data.join(file), "x").unwrap();
    }

    /// An import of two videos, of which the second has no frames yet.
    fn begun(dir: &Path, settings: &Settings) -> (Source, State) {
        let videos = ["a.mp4", "b.mp4"].map(|name| dir.join(name));
        videos.iter().for_each(|file| fs::write(file, "x").unwrap());
        let source = Source::Videos(videos.to_vec());
        let mut state = State::begin(&dir.join("data"), &source, settings, true).unwrap();
        state.videos = vec![Video { size: [64, 48], fps: 10.0, seconds: 0.3 }; 2];
        state.cut = Some(Cut { fps: 10.0, frames: 3, begins: vec![0.0; 2], every: 1 });
        state.frames = vec![2];
        state.save(&dir.join("data")).unwrap();
        (source, state)
    }

    #[test]
    fn what_others_put_beside_frames_stays() {
        let dir = tempfile::tempdir().unwrap();
        let data = dir.path().join("data");
        let (source, _) = begun(dir.path(), &Settings::default());
        let files = ["images/cam00/00000.jpg", "images/cam00/mine.jpg", "notes.txt", "transforms.json"];
        files.iter().for_each(|file| put(&data, file));
        let other = Settings { keyframes: 9, ..Settings::default() };
        let e = State::begin(&data, &source, &other, true).unwrap_err();
        let named = |path: &Path, fix: &str| path.ends_with("cam00/mine.jpg") && fix.contains("move them away");
        assert!(matches!(&e, ImportError::Input { path, fix, .. } if named(path, fix)), "{e:?}");
        assert!(files.iter().all(|file| data.join(file).exists()));
        fs::rename(data.join("images/cam00/mine.jpg"), data.join("images/mine.jpg")).unwrap();
        assert!(State::begin(&data, &source, &other, true).unwrap().frames.is_empty());
        assert!(data.join("images/mine.jpg").exists() && data.join("notes.txt").exists());
        assert!(!data.join("images/cam00").exists() && !data.join("transforms.json").exists());
    }

    #[test]
    fn only_numbers_that_an_import_made_are_its_own() {
        let dir = tempfile::tempdir().unwrap();
        let data = dir.path().join("data");
        let settings = Settings::default();
        for (file, is_own) in [
            ("images/cam00/00001.jpg", true),
            ("images/cam00/00002.jpg", false),
            ("images/cam00/00001.png", false),
            ("images/cam00/000001.jpg", false),
            ("images/cam00/more/00000.jpg", false),
            // What an interruption left.
            ("images/cam01/00002.jpg", true),
            ("images/cam01/00003.jpg", false),
            ("images/cam02/00000.jpg", false),
            ("images/cam01", false),
        ] {
            let (source, _) = begun(dir.path(), &settings);
            put(&data, file);
            let again = State::begin(&data, &source, &settings, true);
            assert_eq!((again.is_ok(), data.join(file).exists()), (is_own, !is_own), "{file}");
            fs::remove_dir_all(&data).unwrap();
        }
    }

    #[test]
    fn masks_of_others_stay() {
        let dir = tempfile::tempdir().unwrap();
        let data = dir.path().join("data");
        let without = Settings::default();
        let with = Settings { masks: Some(dir.path().join("masks")), ..Settings::default() };
        let mask = data.join("masks/cam00/00000.png");
        let (source, state) = begun(dir.path(), &without);
        put(&data, "masks/cam00/00000.png");
        put(&data, "masks/cam01/00000.png");
        state.clear_next(&data, true).unwrap();
        State::begin(&data, &source, &without, true).unwrap();
        let e = State::begin(&data, &source, &with, true).unwrap_err();
        assert!(matches!(&e, ImportError::Input { path, .. } if *path == mask), "{e}");
        assert!(mask.exists() && data.join("masks/cam01/00000.png").exists() && data.join(NAME).exists());
        fs::remove_dir_all(data.join("masks")).unwrap();
        // Those of an import go with it, also one more than there were images.
        begun(dir.path(), &with);
        ["masks/cam00/00000.png", "masks/cam00/00002.png"].iter().for_each(|file| put(&data, file));
        State::begin(&data, &source, &without, true).unwrap();
        assert!(!data.join("masks").exists());
    }

    #[test]
    fn what_an_interruption_left_is_cleared_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let data = dir.path().join("data");
        let (_, state) = begun(dir.path(), &Settings::default());
        state.clear_next(&data, false).unwrap();
        ["images/cam00/00000.jpg", "images/cam01/00000.jpg"].iter().for_each(|file| put(&data, file));
        state.clear_next(&data, false).unwrap();
        assert!(data.join("images/cam00/00000.jpg").exists() && !data.join("images/cam01").exists());
        ["images/cam01/00000.jpg", "images/cam01/mine.jpg"].iter().for_each(|file| put(&data, file));
        let e = state.clear_next(&data, false).unwrap_err();
        assert!(matches!(&e, ImportError::Input { path, .. } if path.ends_with("cam01/mine.jpg")), "{e}");
        assert!(data.join("images/cam01/00000.jpg").exists());
    }

    #[test]
    fn a_source_inside_the_data_set_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let data = dir.path().join("data");
        let (videos, _) = begun(dir.path(), &Settings::default());
        ["images/cam00/00000.jpg", "mine/cam00/00000.png"].iter().for_each(|file| put(&data, file));
        ["pictures/0.jpg", "data-masks/a.mp4"].iter().for_each(|file| put(dir.path(), file));
        let masked = |masks: PathBuf| Settings { masks: Some(masks), ..Settings::default() };
        let aside = dir.path().join("pictures/../data/./images/cam00");
        for (source, settings) in [
            (Source::Images(aside), Settings::default()),
            (Source::Images(data.join("mine")), Settings::default()),
            (Source::Images(dir.path().join("pictures")), masked(data.join("mine"))),
            (videos.clone(), masked(data.clone())),
        ] {
            let e = State::begin(&data, &source, &settings, true).unwrap_err();
            assert!(e.to_string().contains("inside the data set"), "{e}");
        }
        assert!(data.join("images/cam00/00000.jpg").exists() && data.join(NAME).exists());
        // A folder that is not there yet holds no source, nor does one of a name that begins alike.
        let pictures = Source::Images(dir.path().join("pictures"));
        State::begin(&dir.path().join("new"), &pictures, &Settings::default(), true).unwrap();
        State::begin(&data, &videos, &masked(dir.path().join("data-masks")), true).unwrap();
    }
}
