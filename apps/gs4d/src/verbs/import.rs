//! `gs4d import`: from videos to a data set.

use super::{doctor::Doctor, init::Init};
use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::interrupt;
use crate::parse;
use crate::progress::Progress;
use clap::ValueEnum;
use gs_data::{DataError, shell_quoted};
use gs4d_import::{CameraModel, Event, Imported, Rig, Settings, Source, Taking, import};
use serde_json::json;
use std::path::PathBuf;

/// Make a data set from videos: frames by ffmpeg, cameras by COLMAP (both installed), clocks, then doctor and init
#[derive(clap::Args)]
pub struct ImportVerb {
    /// The videos, one per camera.
    #[arg(value_name = "VIDEO", required_unless_present = "images", conflicts_with = "images")]
    videos: Vec<PathBuf>,
    /// The data set: a new folder.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// In place of videos: a folder with the images of one camera in order of names, or with one such folder per camera.
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// What the cameras do.
    #[arg(long, value_enum, default_value = "auto")]
    rig: RigChoice,
    /// The images are of a scene at rest, in any order: they get no times.
    #[arg(long, requires = "images")]
    unordered: bool,
    /// Frames per second [default: those of the slowest video; of images 30].
    #[arg(long, value_parser = positive)]
    fps: Option<f64>,
    /// Most frames per camera; of more, every second, third ... is taken.
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u32).range(2..=100_000), conflicts_with = "images")]
    max_frames: u32,
    /// Seconds left out at the beginning.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, value_parser = parse::not_negative, conflicts_with = "images")]
    start: f64,
    /// Seconds taken [default: to the end].
    #[arg(long, value_name = "SECONDS", value_parser = positive, conflicts_with = "images")]
    duration: Option<f64>,
    /// Factor on the size of the frames, above 0, at most 1.
    #[arg(long, default_value_t = 1.0, value_parser = parse::share, conflicts_with = "images")]
    scale: f64,
    /// Longest side of the frames, pixels.
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(16..=32_768), conflicts_with = "images")]
    size: Option<u32>,
    /// Seconds by which each video shows later what the first one shows, in their order: 0,0.25,-0.1 [default: found where it is clear].
    #[arg(long, value_name = "S,S", value_delimiter = ',', value_parser = seconds, allow_hyphen_values = true, conflicts_with_all = ["images", "no_sync"])]
    offsets: Option<Vec<f64>>,
    /// The videos began at one moment: look for no offsets of clocks.
    #[arg(long, conflicts_with = "images")]
    no_sync: bool,
    /// Masks, white counts: for a.mp4 the video DIR/a.mp4 (any ending), for images DIR/NAME.png (one folder per camera where the images have).
    #[arg(long, value_name = "DIR")]
    masks: Option<PathBuf>,
    /// COLMAP's camera model [default: SIMPLE_RADIAL of cameras at rest, OPENCV of moving ones].
    #[arg(long, value_enum, value_name = "MODEL")]
    lens: Option<LensChoice>,
    /// All cameras have the same lens and zoom.
    #[arg(long)]
    same_lens: bool,
    /// The horizontal field of view of the cameras, degrees, where it is known; two cameras need it.
    #[arg(long, value_name = "DEGREES", value_parser = parse::field_of_view)]
    fov: Option<f64>,
    /// Moments of cameras at rest that COLMAP gets [default: so many that there are some 60 images, at most 4].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    moments: Option<u32>,
    /// Frames of moving cameras that are reconstructed together; the others are placed afterwards [default: 100, with --unordered 300].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(3..=100_000))]
    keyframes: Option<u32>,
    /// Keep blurred and duplicate frames.
    #[arg(long)]
    keep_all: bool,
    /// Number of the camera at rest, from 0, that is held out for scores [default: the most central of at least five].
    #[arg(long, value_name = "K")]
    held_out: Option<u32>,
    /// Let COLMAP use the graphics card (needs one that it supports).
    #[arg(long)]
    gpu: bool,
    /// Most memory for decoding one image [default: 64 MiB and eight times the size of its file].
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u32).range(1..=1_048_576))]
    max_image_mib: Option<u32>,
    /// Start over in a folder that an import made, and remove what that one made.
    #[arg(short, long)]
    force: bool,
}

/// What the cameras do.
#[derive(Clone, Copy, ValueEnum)]
enum RigChoice {
    /// Found out from the videos.
    Auto,
    /// They stand still: one pose each.
    Fixed,
    /// They move: one pose per frame.
    Moving,
}

/// COLMAP's models that gs4d undistorts.
#[derive(Clone, Copy, ValueEnum)]
#[value(rename_all = "SCREAMING_SNAKE_CASE")]
enum LensChoice {
    SimplePinhole,
    Pinhole,
    SimpleRadial,
    Radial,
    Opencv,
    RadialFisheye,
    OpencvFisheye,
}

fn seconds(text: &str) -> Result<f64, String> {
    let value = text.trim().parse::<f64>().ok().filter(|v| v.is_finite());
    value.ok_or_else(|| "give seconds, for example 0.25".to_owned())
}

fn positive(text: &str) -> Result<f64, String> {
    parse::not_negative(text).and_then(|v| if v > 0.0 { Ok(v) } else { Err("give a number above 0".to_owned()) })
}

impl ImportVerb {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let stop = interrupt::flag()?;
        let source = match &self.images {
            Some(folder) => Source::Images(folder.clone()),
            None => Source::Videos(self.videos.clone()),
        };
        let threads = global.threads.map(usize::from);
        // What is done, its line, how much was done when it was printed last.
        let mut line: Option<(String, Progress, usize)> = None;
        let mut tell = |event: Event<'_>| match event {
            Event::Say(text) => {
                line.take().into_iter().for_each(|l| l.1.finish());
                global.say(text);
            }
            Event::Progress { what, done, of } => {
                if line.as_ref().is_none_or(|l| l.0 != what) {
                    line.take().into_iter().for_each(|l| l.1.finish());
                    line = Some((what.to_owned(), Progress::new(of.unwrap_or(0) as u64, what, global.quiet), 0));
                }
                if let Some((_, progress, printed)) = line.as_mut().filter(|l| l.2 != done) {
                    *printed = done;
                    progress.at(done as u64, || what.to_owned());
                }
            }
        };
        let had_points = !self.force && self.out.is_dir() && gs_data::has_start_points(&self.out).unwrap_or(false);
        let done = import(&self.out, &source, &self.settings(), self.force, threads, &stop, &mut tell);
        line.into_iter().for_each(|l| l.1.finish());
        let done = done.map_err(|e| Failure::import(e, &self.out))?;
        global.say(format!("{} frames of {} cameras; now the doctor", done.frames, done.cameras.len()));
        // Problems are printed at the end: points are made all the same.
        let page = self.out.join("doctor.html");
        let sets: Vec<String> = self.max_image_mib.map(|mib| format!("data.max_image_mib={mib}")).into_iter().collect();
        let checked = Doctor::of(self.out.clone(), page, sets.clone()).look(global)?;
        // Points that a finished import has already may be the user's own choice.
        let points = if had_points {
            Answer::new(String::new(), json!(null))
        } else {
            Init::of(self.out.clone(), sets.clone()).run(global)?
        };
        let method = if self.unordered { "static3d" } else { "fourdgs" };
        let sets: String = sets.iter().map(|set| format!(" --set {set}")).collect();
        let next = format!("gs4d train {} -m {method} -o run{sets}", shell_quoted(self.out.display().to_string()));
        let text = format!("{}{}{}now: {next}\n", summary(&done, &self.out), checked.0.text, points.text);
        let json = json!({"import": done, "doctor": checked.0.json, "init": points.json, "next": next});
        let answer = Answer::new(text, json);
        match checked.1 {
            None => Ok(answer),
            Some(problems) => {
                answer.print(global.json)?;
                Err(problems)
            }
        }
    }

    fn settings(&self) -> Settings {
        Settings {
            rig: match self.rig {
                RigChoice::Auto => None,
                RigChoice::Fixed => Some(Rig::Fixed),
                RigChoice::Moving => Some(Rig::Moving),
            },
            unordered: self.unordered,
            taking: Taking { fps: self.fps, max_frames: self.max_frames, start: self.start, duration: self.duration },
            scale: self.scale,
            longest: self.size,
            offsets: self.offsets.clone(),
            sync: !self.no_sync,
            masks: self.masks.clone(),
            model: self.lens.map(|lens| match lens {
                LensChoice::SimplePinhole => CameraModel::SimplePinhole,
                LensChoice::Pinhole => CameraModel::Pinhole,
                LensChoice::SimpleRadial => CameraModel::SimpleRadial,
                LensChoice::Radial => CameraModel::Radial,
                LensChoice::Opencv => CameraModel::Opencv,
                LensChoice::RadialFisheye => CameraModel::RadialFisheye,
                LensChoice::OpencvFisheye => CameraModel::OpencvFisheye,
            }),
            same_lens: self.same_lens,
            fov: self.fov,
            moments: self.moments,
            keyframes: self.keyframes.unwrap_or(if self.unordered { 300 } else { 100 }),
            keep_all: self.keep_all,
            held_out: self.held_out,
            gpu: self.gpu,
            max_image_mib: self.max_image_mib,
        }
    }
}

/// Cameras and what is known of them.
fn summary(done: &Imported, out: &std::path::Path) -> String {
    let mut text = String::new();
    for c in &done.cameras {
        let clock = c.offset.map_or(String::new(), |o| format!("  clock {o:+.3} s"));
        let test = if done.held_out.as_ref() == Some(&c.name) { "  held out" } else { "" };
        text.push_str(&format!("{}  {} frames  {}{clock}{test}\n", c.name, c.frames, c.source));
    }
    let error = done.reprojection.map_or(String::new(), |e| format!(", mean reprojection error {e:.2} pixels"));
    let spread = done.spread.map_or(String::new(), |s| {
        format!(", places of one camera agree within {:.2} % of the rig's width", 100.0 * s)
    });
    text + &format!("{}  {} frames, {} points{error}{spread}\n", out.display(), done.frames, done.points)
}

impl Failure {
    /// A failed import into a folder.
    fn import(e: gs4d_import::ImportError, out: &std::path::Path) -> Self {
        use gs4d_import::ImportError as E;
        let text = e.to_string();
        match e {
            E::Missing { install, .. } => Failure::new(Class::Usage, "import.program", text)
                .why("frames and cameras are found by other people's programs")
                .remedy(format!("{install}; then the same command again: it goes on where it stopped")),
            E::Failed { install, log, .. } => Failure::new(Class::Io, "import.program", text)
                .place(log.display())
                .remedy(format!("fix what it says; if the program itself is at fault, install it anew: {install}; then the same command again: it goes on where it stopped")),
            E::Stopped { .. } => Failure::new(Class::Interrupted, "interrupted", text)
                .remedy("the same command again goes on where it stopped"),
            E::Input { path, why, fix, .. } => {
                Failure::new(Class::Data, "import.input", text).place(path.display()).why(why).remedy(fix)
            }
            E::Cameras { fix, .. } => {
                Failure::new(Class::Data, "import.cameras", text).place(out.display()).remedy(fix)
            }
            E::Occupied { folder } => Failure::new(Class::Io, "io.exists", text)
                .place(folder.display())
                .why("nothing is overwritten")
                .remedy("choose another folder with -o"),
            E::Changed { folder, .. } => Failure::new(Class::Io, "io.exists", text)
                .place(folder.display())
                .why("frames of two imports would be mixed")
                .remedy("choose another folder with -o, pass -f to start over, or call it as before to go on"),
            E::Data(e @ DataError::TooLarge { .. }) => Failure::from(e)
                .remedy("make the file smaller, or allow more for images with --max-image-mib; the same command goes on where it stopped"),
            E::Data(e) => e.into(),
            E::Write(e) => e.into(),
            E::Os { action, path, source } => Failure::io(action, &path, &source),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_data::Place;
    use std::path::Path;

    #[test]
    fn an_image_that_takes_too_much_memory_comes_with_the_flag_that_allows_it() {
        let place = Place::new(Path::new("data/images/cam00/00000.jpg"), "image of 8000x6000");
        let e = DataError::TooLarge { place, bytes: 192_000_000, limit: 128 << 20 };
        let text = Failure::import(e.into(), Path::new("data")).to_string();
        assert!(text.contains("limits.file") && text.contains("--max-image-mib"), "{text}");
        assert!(!text.contains("--set data."), "{text}");
    }
}
