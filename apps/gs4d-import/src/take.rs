//! Frames of all cameras: what the cameras do, how their clocks differ, which frames are taken, and taking them.

use crate::error::ImportError;
use crate::frames::{self, Extraction, scaled};
use crate::look::{self, Rig};
use crate::probe::probe;
use crate::program::{FFMPEG, FFPROBE};
use crate::rates::{self, Cut};
use crate::state::Settings;
use crate::{Event, Job, clock};
use std::path::PathBuf;

/// Offsets of clocks that are looked for: at most this share of the shortest video, and so many seconds.
const MAX_OFFSET_SHARE: f64 = 0.5;
const MAX_OFFSET: f64 = 20.0;
/// What is said of several cameras that move: all of their picture changes, whatever moves in it.
const MOVING_CLOCKS: &str = "clocks of moving cameras cannot be seen and are taken as they are: --offsets gives them, and training with \
    --set cameras.time=true learns what is left of a frame or two";
/// Frames per second of images, where none is given.
const IMAGE_FPS: f64 = 30.0;
/// A rate below this is worth a word, frames per second.
const SLOW: f64 = 5.0;

impl Job<'_> {
    /// Takes the frames of videos.
    pub(crate) fn videos(&mut self, files: &[PathBuf]) -> Result<(), ImportError> {
        self.runner.find(FFMPEG, "-version")?;
        if self.state.videos.is_empty() {
            self.runner.find(FFPROBE, "-version")?;
            self.state.videos = files.iter().map(|f| probe(self.runner, f)).collect::<Result<_, _>>()?;
            self.save()?;
        }
        self.watch(files)?;
        if self.state.cut.is_none() {
            let offsets = self.offsets(files)?;
            let cut = rates::cut(&self.state.videos, &offsets, &self.settings().taking)?;
            self.say_cut(&cut);
            self.state.cut = Some(cut);
            self.save()?;
        }
        self.extract(files)
    }

    /// Finds out what the cameras do, and how their clocks differ.
    fn watch(&mut self, files: &[PathBuf]) -> Result<(), ImportError> {
        if self.state.rig.is_some() {
            return Ok(());
        }
        let settings = self.settings().clone();
        let needs_clock = files.len() > 1 && settings.sync && settings.offsets.is_none();
        let asked = settings.rig.map(|rig| (rig, "as --rig says".to_owned()));
        let looks = match &asked {
            Some((rig, _)) if *rig == Rig::Moving || !needs_clock => Vec::new(),
            _ => self.looks(files)?,
        };
        let (rig, why) = asked.map_or_else(|| look::decide(&looks), Ok)?;
        let count = files.len();
        self.say(match rig {
            Rig::Fixed => format!("{count} cameras that stand still ({why})"),
            Rig::Moving => format!("{count} moving camera{} ({why})", if count == 1 { "" } else { "s" }),
        });
        if rig == Rig::Fixed && count == 1 {
            return Err(ImportError::Cameras {
                what: "one camera that stands still sees everything from one place".to_owned(),
                fix: "give videos of more cameras, or one of a camera that moves (--rig moving if this one does)"
                    .to_owned(),
            });
        }
        if rig == Rig::Fixed && needs_clock {
            self.state.clocks = Some(self.clocks(&looks));
        }
        (self.state.rig, self.state.why) = (Some(rig), why);
        self.save()
    }

    fn looks(&mut self, files: &[PathBuf]) -> Result<Vec<look::Look>, ImportError> {
        let fps = self.state.videos.iter().map(|v| v.fps).fold(f64::INFINITY, f64::min);
        let mut looks = Vec::new();
        for (file, video) in files.iter().zip(&self.state.videos) {
            let what = format!("looking at {}", file.display());
            let tell = &mut *self.tell;
            let of = Some(gs_core::cast::to_usize(video.seconds * fps));
            let mut each = |done| tell(Event::Progress { what: &what, done, of });
            looks.push(look::look(self.runner, file, video, fps, &mut each)?);
        }
        Ok(looks)
    }

    fn clocks(&mut self, looks: &[look::Look]) -> clock::Clocks {
        let videos = &self.state.videos;
        let fps = videos.iter().map(|v| v.fps).fold(f64::INFINITY, f64::min);
        let shortest = videos.iter().map(|v| v.seconds).fold(f64::INFINITY, f64::min);
        let curves: Vec<Vec<f64>> = looks.iter().map(|l| l.changes.clone()).collect();
        clock::offsets(&curves, fps, (MAX_OFFSET_SHARE * shortest).min(MAX_OFFSET))
    }

    /// The offsets that frames are taken with.
    fn offsets(&mut self, files: &[PathBuf]) -> Result<Vec<f64>, ImportError> {
        if let Some(given) = self.settings().offsets.clone() {
            if given.len() == files.len() {
                return Ok(given);
            }
            return Err(ImportError::Cameras {
                what: format!("{} offsets are given for {} videos", given.len(), files.len()),
                fix: "give one for each video, in their order: --offsets 0,0.25,-0.1".to_owned(),
            });
        }
        let Some(clocks) = self.state.clocks.clone() else {
            if files.len() > 1 && self.settings().sync {
                self.say(MOVING_CLOCKS);
            }
            return Ok(vec![0.0; files.len()]);
        };
        for (k, (offset, known)) in clocks.offsets.iter().zip(&clocks.known).enumerate() {
            let name = files[k].display();
            self.say(match known {
                true => format!("clock of {name}: {offset:+.3} s"),
                false => {
                    format!("clock of {name}: cannot be seen in what moves in it; taken as it is (--offsets gives it)")
                }
            });
        }
        if let Some(apart) = clocks.disagreement.filter(|d| *d > 0.05) {
            self.say(format!("warning: pairs of cameras disagree about their clocks by up to {apart:.3} s"));
        }
        Ok(clocks.offsets)
    }

    fn say_cut(&mut self, cut: &Cut) {
        let spans = cut.frames as f64 / cut.fps;
        self.say(format!("{} frames per camera at {:.3} per second, {spans:.2} s", cut.frames, cut.fps));
        if cut.fps < SLOW {
            self.say(format!(
                "warning: {:.2} frames per second are few for what moves: take a part with --start and --duration, or more with --max-frames",
                cut.fps
            ));
        }
    }

    /// Takes the frames, and masks, of the cameras that have none yet.
    fn extract(&mut self, files: &[PathBuf]) -> Result<(), ImportError> {
        let Some(cut) = self.state.cut.clone() else { return Ok(()) };
        let Settings { scale, longest, masks, .. } = self.settings().clone();
        for (camera, file) in files.iter().enumerate().skip(self.state.frames.len()) {
            let video = &self.state.videos[camera];
            let size = scaled(video.size, scale, longest);
            let mut taken = Vec::new();
            for is_mask in [false, true] {
                let path = match (&masks, is_mask) {
                    (None, true) => continue,
                    (Some(folder), true) => {
                        let path = frames::mask_video(folder, file)?;
                        frames::check_masks(video, &probe(self.runner, &path)?, &path)?;
                        path
                    }
                    _ => file.clone(),
                };
                // A folder that an interruption left complete, but not written down.
                self.state.clear_next(self.data, is_mask)?;
                let what = format!("frames of {}", path.display());
                let tell = &mut *self.tell;
                let mut each = |done| tell(Event::Progress { what: &what, done, of: Some(cut.frames) });
                let extraction = Extraction { video: &path, size, cut: &cut, camera, is_mask };
                taken.push(extraction.run(self.runner, self.data, &self.work, &mut each)?);
            }
            self.state.frames.push(taken.into_iter().min().unwrap_or(0));
            self.save()?;
        }
        self.check_counts()
    }

    fn check_counts(&self) -> Result<(), ImportError> {
        match self.state.frames.iter().position(|n| *n < 2) {
            None => Ok(()),
            Some(camera) => Err(ImportError::Input {
                what: format!("{} frames of it were taken", self.state.frames[camera]),
                path: self.sources[camera].0.clone(),
                why: "motion is learnt from several",
                fix: "see import/log.txt; a video that ends early may be damaged".to_owned(),
            }),
        }
    }

    /// Copies the images of a folder.
    pub(crate) fn images(&mut self) -> Result<(), ImportError> {
        let settings = self.settings().clone();
        self.state.images = self.sources.iter().map(|(_, files)| files.len()).collect();
        if self.state.rig.is_none() {
            let many = self.sources.len() > 1;
            let found = if many && !settings.unordered { Rig::Fixed } else { Rig::Moving };
            self.state.why = match (settings.rig, many) {
                (Some(_), _) => "as --rig says",
                (None, true) if settings.unordered => "each took pictures in any order, in a folder of its own",
                (None, true) => "one folder of images for each",
                (None, false) => "one folder of images",
            }
            .to_owned();
            let rig = settings.rig.unwrap_or(found);
            self.state.rig = Some(rig);
            self.say(format!("{} cameras ({})", self.sources.len(), self.state.why.clone()));
            let fps = settings.taking.fps.unwrap_or(IMAGE_FPS);
            self.state.cut = Some(Cut { fps, frames: 0, begins: vec![0.0; self.sources.len()], every: 1 });
            self.save()?;
        }
        for camera in self.state.frames.len()..self.sources.len() {
            let (path, files) = self.sources[camera].clone();
            for is_mask in [false, true] {
                self.state.clear_next(self.data, is_mask)?;
            }
            let own = settings.masks.as_ref().map(|m| match self.sources.len() {
                1 => m.clone(),
                _ => m.join(path.file_name().unwrap_or_default()),
            });
            frames::copy(&files, own.as_deref(), self.data, &self.work, camera)?;
            self.state.frames.push(files.len());
            self.save()?;
        }
        self.check_counts()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::program::Runner;
    use crate::state::{Source, State, WORK};
    use std::fs;
    use std::sync::atomic::AtomicBool;

    #[test]
    fn of_the_next_camera_only_as_many_images_as_its_folder_has_are_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let (pictures, data) = (dir.path().join("pictures"), dir.path().join("data"));
        for file in ["a/1.png", "a/2.png", "b/1.png", "b/2.png", "b/3.png"].map(|file| pictures.join(file)) {
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            fs::write(file, "x").unwrap();
        }
        let source = Source::Images(pictures);
        let begin = |force| State::begin(&data, &source, &Settings::default(), force);
        let (stop, log) = (AtomicBool::new(false), dir.path().join("log"));
        let runner = Runner { stop: &stop, log };
        let go_on = || {
            let (work, state, sources) = (data.join(WORK), begin(false)?, crate::sources(&source)?);
            let tell: &mut dyn FnMut(Event<'_>) = &mut |_| {};
            Job { data: &data, work, state, runner: &runner, sources, threads: None, tell }.images()
        };
        // Stopped after the second camera was copied, before that was written down.
        let stopped = || {
            let mut state = begin(false).unwrap();
            assert_eq!(state.frames, [2, 3]);
            state.frames.pop();
            state.save(&data).unwrap();
        };
        go_on().unwrap();
        stopped();
        go_on().unwrap();
        stopped();
        let mine = data.join("images/cam01/00003.png");
        fs::write(&mine, "mine").unwrap();
        for e in [go_on().unwrap_err(), begin(true).unwrap_err()] {
            assert!(matches!(&e, ImportError::Input { path, .. } if *path == mine), "{e}");
        }
        assert_eq!(fs::read_to_string(&mine).unwrap(), "mine");
        fs::remove_file(&mine).unwrap();
        begin(true).unwrap();
        assert!(!data.join("images").exists());
    }
}
