//! From videos to a data set that gs4d trains on.
//!
//! [`import`] takes frames by ffmpeg, finds clocks, leaves out blurred and duplicate frames, finds cameras by COLMAP and writes
//! nerfstudio's layout: `transforms.json`, `points.ply`, `images/camNN/`, `masks/camNN/`. Both programs are those of the user, run as child
//! processes. `import.json` records inputs, settings and what is done, so that an interrupted import goes on.
//!
//! | module | what it does |
//! |---|---|
//! | `program` | child processes |
//! | `probe`, `look` | size, rate and length of videos; whether a background stands still, how much changes |
//! | [`clock`] | offsets between the clocks of a rig |
//! | `rates`, `frames`, `take` | which frames; taking them |
//! | `masks` | which mask belongs to which video or image |
//! | `sharp` | blurred and duplicate frames |
//! | `colmap`, `solve` | calls of COLMAP; cameras of a rig and of moving cameras |
//! | `poses`, `write` | one pose per camera at rest, an upright world; the files |
//! | `settings`, `state` | what is imported, and how; `import.json` |
//! | `own` | which files an import made, and their removal |
//!
//! ```no_run
//! use gs4d_import::{Event, Settings, Source, import};
//! use std::path::Path;
//! use std::sync::atomic::AtomicBool;
//!
//! let source = Source::Videos(["left.mp4", "middle.mp4", "right.mp4"].map(Into::into).to_vec());
//! let tell = &mut |event: Event<'_>| if let Event::Say(text) = event { println!("{text}") };
//! let done = import(Path::new("data"), &source, &Settings::default(), false, None, &AtomicBool::new(false), tell)?;
//! println!("{} frames of {} cameras", done.frames, done.cameras.len());
//! # Ok::<(), gs4d_import::ImportError>(())
//! ```
#![warn(unreachable_pub)]
#![cfg_attr(not(test), warn(clippy::cast_possible_truncation))]

pub mod clock;
mod colmap;
mod error;
mod frames;
mod look;
mod masks;
mod own;
mod poses;
mod probe;
mod program;
mod rates;
mod settings;
mod sharp;
mod solve;
mod state;
mod take;
#[cfg(feature = "testkit")]
pub mod testkit;
mod write;

pub use colmap::CameraModel;
pub use error::ImportError;
pub use look::Rig;
pub use probe::Video;
pub use rates::{Cut, Taking};
pub use settings::{Settings, Source};
pub use state::LeftOut;

use frames::camera_name;
use program::Runner;
use serde::{Deserialize, Serialize};
use state::{State, WORK};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// What an import tells while it goes on.
#[derive(Clone, Copy, Debug)]
pub enum Event<'a> {
    /// A sentence.
    Say(&'a str),
    /// Progress of a stage.
    Progress {
        /// What is done.
        what: &'a str,
        /// How many of it.
        done: usize,
        /// Of how many; none if that is not known.
        of: Option<usize>,
    },
}

/// A camera of the data set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImportedCamera {
    /// Name of its folder of images.
    pub name: String,
    /// The video or folder.
    pub source: String,
    /// Frames in the data set.
    pub frames: usize,
    /// Seconds by which its clock was found, or said, to be later than that of the first; none of cameras whose clock is not known.
    pub offset: Option<f64>,
}

/// What an import made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Imported {
    /// What the cameras do.
    pub rig: Rig,
    /// Why that is known.
    pub why: String,
    /// The cameras.
    pub cameras: Vec<ImportedCamera>,
    /// Frames in all.
    pub frames: usize,
    /// Frames per second; none of unordered images.
    pub fps: Option<f64>,
    /// Points of the reconstruction.
    pub points: usize,
    /// Mean reprojection error, pixels, where COLMAP says it.
    pub reprojection: Option<f64>,
    /// Largest distance between two poses that were found of one camera of a rig, as a share of the rig's width.
    pub spread: Option<f64>,
    /// Name of the camera that is held out.
    pub held_out: Option<String>,
    /// Frames that are left out.
    pub left_out: LeftOut,
}

/// Imports a source into the folder `data`, which must be new, empty, or an unfinished import of the same source with the same
/// settings; with `force` also an import of something else, whose files are removed first, unless those of somebody else lie between them.
/// `threads` bounds those of COLMAP. Setting `stop` ends the child process and returns [`ImportError::Stopped`]; the next call goes on.
///
/// # Errors
/// See [`ImportError`]. What was done is kept.
pub fn import(
    data: &Path,
    source: &Source,
    settings: &Settings,
    force: bool,
    threads: Option<usize>,
    stop: &AtomicBool,
    tell: &mut dyn FnMut(Event<'_>),
) -> Result<Imported, ImportError> {
    let sources = sources(source)?;
    take::check(&sources, settings)?;
    let state = State::begin(data, source, settings, force)?;
    if let Some(done) = state.finished.clone().and_then(|f| serde_json::from_value(f).ok()) {
        tell(Event::Say("that import is done already"));
        return Ok(done);
    }
    let work = data.join(WORK);
    let runner = Runner { stop, log: work.join("log.txt") };
    let mut job = Job { data, work, state, runner: &runner, sources, threads, tell };
    job.check_held_out()?;
    job.runner.find(program::COLMAP, "help")?;
    match source {
        Source::Videos(files) => job.videos(files)?,
        Source::Images(folder) => job.images(folder)?,
    }
    job.leave_out()?;
    job.finish()
}

/// A camera's video or folder, and its image files if it is a folder.
type CameraSource = (PathBuf, Vec<PathBuf>);

fn sources(source: &Source) -> Result<Vec<CameraSource>, ImportError> {
    match source {
        Source::Videos(files) => Ok(files.iter().map(|f| (f.clone(), Vec::new())).collect()),
        Source::Images(folder) => Ok(frames::cameras_of(folder)?.into_iter().map(|(n, f)| (n.into(), f)).collect()),
    }
}

/// An import on its way.
struct Job<'a> {
    data: &'a Path,
    work: PathBuf,
    state: State,
    runner: &'a Runner<'a>,
    sources: Vec<CameraSource>,
    threads: Option<usize>,
    tell: &'a mut dyn FnMut(Event<'_>),
}

impl Job<'_> {
    fn say(&mut self, text: impl AsRef<str>) {
        (self.tell)(Event::Say(text.as_ref()));
    }

    fn settings(&self) -> &Settings {
        &self.state.settings
    }

    fn save(&self) -> Result<(), ImportError> {
        self.state.save(self.data)
    }

    /// Image files of a camera, in order: all that were taken.
    fn files(&self, camera: usize) -> Result<Vec<PathBuf>, ImportError> {
        frames::taken(&self.data.join(frames::IMAGES).join(camera_name(camera)), self.state.frames[camera])
    }

    /// Finds blurred and duplicate frames: those of a moving camera, and moments that all cameras of a rig saw twice.
    fn leave_out(&mut self) -> Result<(), ImportError> {
        if self.state.left_out.is_some() {
            return Ok(());
        }
        let mut left = LeftOut::default();
        if !self.settings().keep_all && !self.settings().unordered {
            let mut measures = Vec::new();
            let max_bytes = self.settings().max_image_mib.map(|mib| u64::from(mib) << 20);
            for camera in 0..self.sources.len() {
                let (files, what) = (self.files(camera)?, format!("sharpness of {}", camera_name(camera)));
                let tell = &mut *self.tell;
                let mut each = |done| tell(Event::Progress { what: &what, done, of: Some(files.len()) });
                measures.push(sharp::measure(&files, max_bytes, self.runner.stop, &mut each)?);
            }
            left = worthless(&measures, self.state.rig == Some(Rig::Moving));
        }
        for (list, word) in [(&left.blurred, "blurred"), (&left.duplicate, "duplicate")] {
            if !list.is_empty() {
                let text = format!("{} {word} frames are left out: {}", list.len(), named(list));
                (self.tell)(Event::Say(&text));
            }
        }
        self.state.left_out = Some(left);
        self.save()
    }
}

/// Frames that show nothing of their own.
fn worthless(measures: &[sharp::Measures], moving: bool) -> LeftOut {
    let marked = |marks: Vec<bool>, camera: usize| {
        marks.into_iter().enumerate().filter(|m| m.1).map(move |m| [camera, m.0]).collect::<Vec<_>>()
    };
    let twice: Vec<Vec<bool>> = measures.iter().map(|m| sharp::duplicates(&m.change)).collect();
    let mut left = LeftOut::default();
    if moving {
        for (camera, m) in measures.iter().enumerate() {
            left.blurred.extend(marked(sharp::blurred(&m.sharpness), camera));
            left.duplicate.extend(marked(twice[camera].clone(), camera));
        }
    } else {
        let moments = twice.iter().map(Vec::len).min().unwrap_or(0);
        let all: Vec<usize> = (0..moments).filter(|&k| twice.iter().all(|t| t[k])).collect();
        left.duplicate = all.into_iter().flat_map(|k| (0..twice.len()).map(move |c| [c, k])).collect();
    }
    left
}

/// Frames as words, the first few of them.
pub(crate) fn named(list: &[[usize; 2]]) -> String {
    const SHOWN: usize = 12;
    let words: Vec<String> = list.iter().take(SHOWN).map(|[c, k]| format!("{}/{k:05}", camera_name(*c))).collect();
    let more = list.len().saturating_sub(SHOWN);
    words.join(", ") + &if more > 0 { format!(" and {more} more (import.json lists them)") } else { String::new() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sharp::Measures;

    #[test]
    fn a_rig_loses_only_moments_that_all_cameras_saw_twice() {
        let change = |twice: &[usize]| (0..20).map(|k| if twice.contains(&k) { 0.0 } else { 3.0 }).collect::<Vec<_>>();
        let mut sharpness = vec![50.0; 20];
        sharpness[4] = 5.0;
        let of = |twice: &[usize]| Measures { sharpness: sharpness.clone(), change: change(twice) };
        let rig = worthless(&[of(&[7, 9]), of(&[9])], false);
        assert_eq!((rig.blurred.len(), rig.duplicate), (0, vec![[0, 9], [1, 9]]));
        let moving = worthless(&[of(&[7, 9])], true);
        assert_eq!((moving.blurred, moving.duplicate), (vec![[0, 4]], vec![[0, 7], [0, 9]]));
        assert_eq!(named(&[[0, 4], [11, 123]]), "cam00/00004, cam11/00123");
        assert!(named(&[[0, 1]; 14]).ends_with("and 2 more (import.json lists them)"));
    }
}
