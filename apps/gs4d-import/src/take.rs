//! Frames of all cameras: what the cameras do, how their clocks differ, which frames are taken, and taking them.

use crate::error::ImportError;
use crate::frames::{self, Extraction, scaled};
use crate::look::{self, Rig};
use crate::masks;
use crate::probe::probe;
use crate::program::{FFMPEG, FFPROBE};
use crate::rates::{self, Cut};
use crate::settings::Settings;
use crate::{CameraSource, Event, Job, clock};
use std::path::{Path, PathBuf};

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

/// Fails, before anything is written, where settings do not fit the cameras, or images of one camera differ in size.
pub(crate) fn check(sources: &[CameraSource], settings: &Settings) -> Result<(), ImportError> {
    let count = sources.len();
    if let Some(given) = settings.offsets.as_ref().filter(|given| given.len() != count) {
        return Err(ImportError::Cameras {
            what: format!("{} offsets are given for {count} videos", given.len()),
            fix: "give one for each video, in their order: --offsets 0,0.25,-0.1".to_owned(),
        });
    }
    settings.rig.map_or(Ok(()), |rig| check_places(rig, count))?;
    sources.iter().try_for_each(|(_, files)| frames::check_sizes(files))
}

/// Fails where one camera stands still.
fn check_places(rig: Rig, cameras: usize) -> Result<(), ImportError> {
    if rig != Rig::Fixed || cameras > 1 {
        return Ok(());
    }
    Err(ImportError::Cameras {
        what: "one camera that stands still sees everything from one place".to_owned(),
        fix: "give videos, or folders of images, of more cameras, or of one that moves (--rig moving if this one does)"
            .to_owned(),
    })
}

impl Job<'_> {
    /// Takes the frames of videos.
    pub(crate) fn videos(&mut self, files: &[PathBuf]) -> Result<(), ImportError> {
        self.runner.find(FFMPEG, "-version")?;
        if self.state.videos.is_empty() {
            self.runner.find(FFPROBE, "-version")?;
            self.state.videos = files.iter().map(|f| probe(self.runner, f)).collect::<Result<_, _>>()?;
            self.save()?;
        }
        let masks = match &self.settings().masks {
            Some(folder) if self.state.frames.len() < files.len() => masks::of_videos(files, folder)?,
            _ => Vec::new(),
        };
        self.watch(files)?;
        if self.state.cut.is_none() {
            let offsets = self.offsets(files)?;
            let cut = rates::cut(&self.state.videos, &offsets, &self.settings().taking)?;
            self.say_cut(&cut);
            self.state.cut = Some(cut);
            self.save()?;
        }
        self.extract(files, &masks)
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
        check_places(rig, count)?;
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
            return Ok(given);
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
    fn extract(&mut self, files: &[PathBuf], masks: &[PathBuf]) -> Result<(), ImportError> {
        let Some(cut) = self.state.cut.clone() else { return Ok(()) };
        let Settings { scale, longest, .. } = *self.settings();
        let done = self.state.frames.len();
        for (camera, file) in files.iter().enumerate().skip(done) {
            let size = scaled(self.state.videos[camera].size, scale, longest);
            let mut taken = Vec::new();
            for (path, is_mask) in [(Some(file), false), (masks.get(camera), true)] {
                let Some(path) = path else { continue };
                if is_mask {
                    masks::check_length(&self.state.videos[camera], &probe(self.runner, path)?, path)?;
                }
                // A folder that an interruption left complete, but not written down.
                self.state.clear_next(self.data, is_mask)?;
                let what = format!("frames of {}", path.display());
                let tell = &mut *self.tell;
                let mut each = |done| tell(Event::Progress { what: &what, done, of: Some(cut.frames) });
                let extraction = Extraction { video: path, size, cut: &cut, camera, is_mask };
                taken.push(extraction.run(self.runner, self.data, &self.work, &mut each)?);
            }
            self.state.frames.push(taken.into_iter().min().unwrap_or(0));
            self.save()?;
        }
        self.check_counts(done)
    }

    /// Fails where a camera has too few frames to learn a motion from. Says where a rig's cameras have not equally many, unless the
    /// frames of all cameras were there before this call; those of `done` cameras were.
    fn check_counts(&mut self, done: usize) -> Result<(), ImportError> {
        let counts = self.state.frames.iter().copied();
        if let (Some(Rig::Fixed), Some(least), Some(most)) = (self.state.rig, counts.clone().min(), counts.max())
            && least < most
            && done < self.state.frames.len()
        {
            self.say(format!(
                "warning: the cameras have {least} to {most} frames: those of one number are of one moment, and from number {least} on they are left out"
            ));
        }
        let few = self.state.frames.iter().position(|n| *n < 2).filter(|_| !self.settings().unordered);
        let Some(camera) = few else { return Ok(()) };
        let fix = match self.state.videos.is_empty() {
            true => "give at least two images of each camera; of a scene at rest (--unordered) one is enough",
            false => "see import/log.txt; a video that ends early may be damaged",
        };
        Err(ImportError::Input {
            what: format!("the number of its frames is {}", self.state.frames[camera]),
            path: self.sources[camera].0.clone(),
            why: "motion is learnt from several",
            fix: fix.to_owned(),
        })
    }

    /// Copies the images of a folder.
    pub(crate) fn images(&mut self, folder: &Path) -> Result<(), ImportError> {
        let settings = self.settings().clone();
        self.state.images = self.sources.iter().map(|(_, files)| files.len()).collect();
        if self.state.rig.is_none() {
            self.arrange(&settings)?;
        }
        let done = self.state.frames.len();
        let left: Vec<Vec<PathBuf>> = self.sources.iter().skip(done).map(|(_, files)| files.clone()).collect();
        let masks = match &settings.masks {
            None => Vec::new(),
            Some(m) => left.iter().map(|files| masks::of_images(files, folder, m)).collect::<Result<Vec<_>, _>>()?,
        };
        for (k, files) in left.iter().enumerate() {
            for is_mask in [false, true] {
                self.state.clear_next(self.data, is_mask)?;
            }
            let own = masks.get(k).map(Vec::as_slice);
            frames::copy(files, own, self.data, &self.work, done + k, self.runner.stop)?;
            self.state.frames.push(files.len());
            self.save()?;
        }
        self.check_counts(done)
    }

    /// Finds out what the cameras of images do.
    fn arrange(&mut self, settings: &Settings) -> Result<(), ImportError> {
        let count = self.sources.len();
        let many = count > 1;
        let found = if many && !settings.unordered { Rig::Fixed } else { Rig::Moving };
        let why = match (settings.rig, many) {
            (Some(_), _) => "as --rig says",
            (None, true) if settings.unordered => "each took pictures in any order, in a folder of its own",
            (None, true) => "one folder of images for each",
            (None, false) => "one folder of images",
        };
        (self.state.rig, self.state.why) = (Some(settings.rig.unwrap_or(found)), why.to_owned());
        self.say(format!("{count} camera{} ({why})", if many { "s" } else { "" }));
        let fps = settings.taking.fps.unwrap_or(IMAGE_FPS);
        self.state.cut = Some(Cut { fps, frames: 0, begins: vec![0.0; count], every: 1 });
        self.save()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::program::Runner;
    use crate::settings::Source;
    use crate::state::{State, WORK};
    use std::fs;
    use std::sync::atomic::AtomicBool;

    /// Writes grey images of a width; their height is 6.
    fn save(pictures: &Path, images: &[(&str, u32)]) {
        for (name, width) in images {
            let file = pictures.join(name);
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            image::GrayImage::new(*width, 6).save(file).unwrap();
        }
    }

    /// Copies images as an import does.
    fn copied(data: &Path, pictures: &Path, settings: &Settings) -> Result<State, ImportError> {
        copied_and_told(data, pictures, settings, &mut |_| {})
    }

    fn copied_and_told(
        data: &Path,
        pictures: &Path,
        settings: &Settings,
        tell: &mut dyn FnMut(Event<'_>),
    ) -> Result<State, ImportError> {
        let (stop, log) = (AtomicBool::new(false), pictures.join("log"));
        let runner = Runner { stop: &stop, log };
        let source = Source::Images(pictures.to_path_buf());
        let sources = crate::sources(&source)?;
        check(&sources, settings)?;
        let (work, state) = (data.join(WORK), State::begin(data, &source, settings, false)?);
        let mut job = Job { data, work, state, runner: &runner, sources, threads: None, tell };
        job.images(pictures)?;
        Ok(job.state)
    }

    #[test]
    fn of_the_next_camera_only_as_many_images_as_its_folder_has_are_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let (pictures, data) = (dir.path().join("pictures"), dir.path().join("data"));
        save(&pictures, &["a/1.png", "a/2.png", "b/1.png", "b/2.png", "b/3.png"].map(|name| (name, 8)));
        let settings = Settings::default();
        let go_on = || copied(&data, &pictures, &settings);
        // Stopped after the second camera was copied, before that was written down.
        let stopped = |mut state: State| {
            assert_eq!(state.frames, [2, 3]);
            state.frames.pop();
            state.save(&data).unwrap();
        };
        stopped(go_on().unwrap());
        stopped(go_on().unwrap());
        let mine = data.join("images/cam01/00003.png");
        fs::write(&mine, "mine").unwrap();
        let begin = || State::begin(&data, &Source::Images(pictures.clone()), &settings, true);
        for e in [go_on().unwrap_err(), begin().unwrap_err()] {
            assert!(matches!(&e, ImportError::Input { path, .. } if *path == mine), "{e}");
        }
        assert_eq!(fs::read_to_string(&mine).unwrap(), "mine");
        fs::remove_file(&mine).unwrap();
        begin().unwrap();
        assert!(!data.join("images").exists());
    }

    #[test]
    fn that_cameras_have_unequally_many_frames_is_said_once() {
        let dir = tempfile::tempdir().unwrap();
        let (pictures, data) = (dir.path().join("pictures"), dir.path().join("data"));
        save(&pictures, &["a/1.png", "a/2.png", "b/1.png", "b/2.png", "b/3.png"].map(|name| (name, 8)));
        let mut warnings = 0;
        for _ in 0..3 {
            let mut count = |event: Event<'_>| {
                warnings += usize::from(matches!(event, Event::Say(text) if text.contains("2 to 3 frames")));
            };
            copied_and_told(&data, &pictures, &Settings::default(), &mut count).unwrap();
        }
        assert_eq!(warnings, 1);
    }

    #[test]
    fn what_cannot_be_imported_is_refused_before_anything_is_copied() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let usual = Settings::default();
        save(&at("sizes"), &[("1.png", 8), ("2.png", 8), ("3.png", 9)]);
        save(&at("one"), &[("1.png", 8), ("2.png", 8)]);
        save(&at("few"), &[("a/1.png", 8), ("b/1.png", 9)]);
        let fixed = Settings { rig: Some(Rig::Fixed), ..usual.clone() };
        let masked = Settings { masks: Some(at("one")), ..usual.clone() };
        let data = at("data");
        for (pictures, settings, word) in [
            ("sizes", &usual, "8x6 (2, the first is 1.png), 9x6 (1, the first is 3.png)"),
            ("one", &fixed, "one place"),
            ("one", &Settings { offsets: Some(vec![0.0, 0.2]), ..usual.clone() }, "2 offsets are given for 1 videos"),
        ] {
            let e = copied(&data, &at(pictures), settings).unwrap_err().to_string();
            assert!(e.contains(word) && !data.exists(), "{e}");
        }
        let e = copied(&data, &at("one"), &masked).unwrap_err().to_string();
        assert!(e.contains("no mask for") && !data.join("images").exists(), "{e}");
        // Cameras may have sizes of their own, and of a scene at rest one image each.
        let e = copied(&at("rig"), &at("few"), &usual).unwrap_err().to_string();
        assert!(e.contains("number of its frames is 1"), "{e}");
        let unordered = Settings { unordered: true, ..usual };
        assert_eq!(copied(&at("room"), &at("few"), &unordered).unwrap().frames, [1, 1]);
    }
}
