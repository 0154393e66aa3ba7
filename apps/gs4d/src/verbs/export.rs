//! `gs4d export`: a trained scene, or a splat file, as files of plain splats.

mod loss;
mod motion;
mod page;
mod rigid;
mod spans;

use self::loss::{Loss, verdict};
use self::motion::Motion;
use super::compact::{BitsName, Compact};
use super::eval::SplitName;
use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::opening::{RunData, note_extrapolated};
use crate::output::{check_free, create_folder, prepare_file};
use crate::parse;
use crate::progress::Progress;
use glam::DVec3;
use gs_core::io::{RawSplats, SplatFormat, load_splats, save_splats, upright, write_file};
use gs_core::rot::Mat3;
use gs_data::{Dataset, ImageCache};
use gs_train::evaluate::{evaluate_with, split_name};
use gs_train::timestamp::Timestamp;
use gs4d_eval::export::{AsExported, Baker, ExportError, cut, mean_up};
use gs4d_player::Tolerance;
use gs4d_run::OpenRun;
use serde_json::{Value, json};
use std::path::PathBuf;

/// Write a trained scene at one or many times as .ply, .splat, .spz or .glb, in motion as .4dgs, whole as .gs4d, or as a page that plays it
/// (.html), and report the loss in PSNR
#[derive(clap::Args)]
pub struct Export {
    /// A run folder or .gs4d file, or a splat file to convert (.ply, .splat, .spz, .glb, .sog).
    #[arg(value_name = "RUN|SCENE")]
    scene: PathBuf,
    /// The file to write, named by its format; with several times the folder for time-0000.EXT and times.json. NAME.gs4d keeps the
    /// moving scene whole in one small file that the other verbs open. NAME.html is one page that plays it in any browser, without a server,
    /// NAME.4dgs a file for programs that read that format.
    #[arg(short, long, value_name = "FILE|DIR")]
    out: PathBuf,
    /// Normalised times, A..B:N or one: 0 is the first training image, 1 the last, or the end of the sequence where data.time_boundary keeps that out of training [default: 0].
    #[arg(long, value_name = "TIMES", allow_hyphen_values = true, value_parser = parse::times)]
    times: Option<parse::Times>,
    /// Format of the files in a folder [default: ply].
    #[arg(long, value_enum)]
    format: Option<FormatName>,
    /// Keep spherical harmonics up to this degree [default: all; colours that a network decodes per camera are fitted with degree 2].
    #[arg(long, value_parser = clap::value_parser!(u8).range(0..=3))]
    sh_degree: Option<u8>,
    /// Turn the files so that they stand upright in viewers: the direction of the data that is up, or auto for what is up in the training
    /// images [default: as the data lie; see docs/guide/axes.md].
    #[arg(long, value_enum, value_name = "AXIS", allow_hyphen_values = true)]
    up: Option<Up>,
    /// Of a .gs4d file: bits per value, 32 exact, 16 half precision, 8 quantised; positions keep 16 [default: 8].
    #[arg(long, value_enum)]
    bits: Option<BitsName>,
    /// Of a page or a .4dgs file: how far a coordinate of a splat may be off, as a share of its standard deviation in the image of the nearest camera [default: 0.1].
    #[arg(long, value_name = "SHARE", value_parser = parse::positive)]
    tolerance: Option<f32>,
    /// Of a .glb: keep the motion. The rigid parts that `gs4d segment` finds lie under animated nodes, with key frames at the training
    /// times (at most 60) or at --times; what is not rigid in them is lost, and measured.
    #[arg(long)]
    rigid: bool,
    /// Views whose PSNR is measured before and after.
    #[arg(long, value_enum, default_value_t = SplitName::Test, conflicts_with = "no_eval")]
    split: SplitName,
    /// Do not measure.
    #[arg(long, conflicts_with = "max_error")]
    no_eval: bool,
    /// Exit with code 7 if the mean PSNR falls by more decibels than this.
    #[arg(long, value_name = "DB", value_parser = parse::not_negative)]
    max_error: Option<f64>,
    /// Overwrite existing files.
    #[arg(short, long)]
    force: bool,
    #[command(flatten)]
    place: RunData,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum FormatName {
    Ply,
    Splat,
    Spz,
    Glb,
}

/// The direction of a scene that is up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Up {
    X,
    #[value(name = "-x")]
    MinusX,
    Y,
    #[value(name = "-y")]
    MinusY,
    Z,
    #[value(name = "-z")]
    MinusZ,
    Auto,
}

impl Up {
    /// The rotation that puts it up in files, by rows; `cameras` gives what is up in the training images.
    fn turn(self, cameras: impl FnOnce() -> Option<DVec3>) -> Result<Mat3<f64>, Failure> {
        let direction = match self {
            Self::X => Some(DVec3::X),
            Self::MinusX => Some(DVec3::NEG_X),
            Self::Y => Some(DVec3::Y),
            Self::MinusY => Some(DVec3::NEG_Y),
            Self::Z => Some(DVec3::Z),
            Self::MinusZ => Some(DVec3::NEG_Z),
            Self::Auto => cameras(),
        };
        direction.and_then(upright).ok_or_else(|| {
            Failure::usage("no direction is up in most training images: name it, --up x, -x, y, -y, z or -z")
        })
    }
}

impl From<FormatName> for SplatFormat {
    fn from(name: FormatName) -> Self {
        match name {
            FormatName::Ply => SplatFormat::Ply,
            FormatName::Splat => SplatFormat::Splat,
            FormatName::Spz => SplatFormat::Spz,
            FormatName::Glb => SplatFormat::Glb,
        }
    }
}

/// Output file of each time.
struct Plan {
    format: SplatFormat,
    files: Vec<(f32, PathBuf)>,
    /// The output folder of a sequence.
    folder: Option<PathBuf>,
}

impl Export {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        if self.is_named("gs4d") {
            return self.whole(global);
        }
        if self.is_named("html") || self.is_named("4dgs") {
            return self.play(global);
        }
        if self.rigid {
            return self.rigid_parts(global);
        }
        if self.tolerance.is_some() {
            return Err(Failure::usage("--tolerance is of .html and .4dgs files"));
        }
        if self.bits.is_some() {
            return Err(Failure::usage("--bits is of .gs4d files"));
        }
        let plan = self.plan()?;
        self.check_free(&plan)?;
        if self.is_of_file() { self.convert(&plan, global) } else { self.bake(&plan, global) }
    }

    /// Whether a splat file is converted, not a run.
    pub fn is_of_file(&self) -> bool {
        self.scene.is_file() && self.scene.extension().is_none_or(|e| e != "gs4d")
    }

    /// Fails if the scene is a splat file.
    fn needs_run(&self) -> Result<(), Failure> {
        if !self.is_of_file() {
            return Ok(());
        }
        let (scene, out) = (self.scene.display(), self.out.display());
        Err(Failure::usage(format!("{scene} is a splat file: {out} can only be made of a run"))
            .why("a splat file has one moment and no method")
            .remedy("give a run or a .gs4d file, or write .ply, .splat, .spz or .glb, without --rigid"))
    }

    /// Whether the file to write has that extension.
    fn is_named(&self, extension: &str) -> bool {
        self.out.extension().is_some_and(|e| e == extension)
    }

    /// A page that plays the scene, or a `.4dgs` file of it.
    fn play(self, global: &Global) -> Result<Answer, Failure> {
        self.needs_run()?;
        if self.format.is_some() || self.bits.is_some() || self.up.is_some() || self.rigid {
            return Err(Failure::usage(
                ".html and .4dgs files are written of a run, in the axes of its data: without --format, --bits, --up and --rigid",
            ));
        }
        let tolerance = self.tolerance.map_or_else(Tolerance::default, Tolerance);
        let (spans, max_error) = (self.is_named("4dgs"), self.max_error);
        let motion = self.motion()?;
        let (answer, loss) =
            if spans { spans::run(&motion, tolerance, global) } else { page::run(&motion, tolerance, global) }?;
        verdict(max_error, loss.as_ref(), &motion.out, "a smaller --tolerance, a higher --sh-degree, more --times")?;
        Ok(answer)
    }

    /// Rigid parts in motion.
    fn rigid_parts(self, global: &Global) -> Result<Answer, Failure> {
        self.needs_run()?;
        if !self.is_named("glb") || self.format.is_some() || self.tolerance.is_some() || self.bits.is_some() {
            let of = Failure::usage("--rigid writes one .glb file of a run: without --format, --tolerance and --bits");
            return Err(of.remedy("give a run and -o NAME.glb"));
        }
        let (up, max_error) = (self.up, self.max_error);
        let motion = self.motion()?;
        let turn = |views: &[gs_data::View]| up.map(|up| up.turn(|| mean_up(views))).transpose();
        let (answer, loss) = rigid::run(&motion, turn, global)?;
        verdict(max_error, loss.as_ref(), &motion.out, "-o NAME.html, which keeps every motion")?;
        Ok(answer)
    }

    /// What every file in motion is made from; fails if the file exists, and creates the folder for it.
    fn motion(self) -> Result<Motion, Failure> {
        prepare_file(self.force, &self.out)?;
        let Self { scene: run, out, times, sh_degree, split, no_eval, max_error, force, place, .. } = self;
        Ok(Motion { run, out, times: times.map(|t| t.0), sh_degree, split, no_eval, max_error, force, place })
    }

    fn whole(self, global: &Global) -> Result<Answer, Failure> {
        let of_files = [
            self.times.is_some(),
            self.format.is_some(),
            self.sh_degree.is_some(),
            self.max_error.is_some(),
            self.up.is_some(),
            self.tolerance.is_some(),
            self.rigid,
        ];
        self.needs_run()?;
        if of_files.contains(&true) {
            return Err(Failure::usage(
                "a .gs4d file keeps a run whole: without --times, --format, --sh-degree, --up, --tolerance, --rigid and --max-error",
            ));
        }
        let Self { scene: run, out, bits, split, no_eval, force, place, .. } = self;
        let bits = bits.unwrap_or(BitsName::Eight);
        Compact { run, out, bits, no_deflate: false, split, no_eval, force, place }.run(global)
    }

    fn plan(&self) -> Result<Plan, Failure> {
        let unknown = self.out.extension().filter(|_| SplatFormat::of_path(&self.out).is_none() && !self.out.is_dir());
        if let (Some(extension), None) = (unknown, self.format) {
            return Err(Failure::usage(format!(
                "no file is written as .{}: -o FILE.ply, .splat, .spz, .glb, .4dgs, .gs4d or .html, or -o DIR with --format",
                extension.display()
            )));
        }
        let times = self.times.as_ref().map_or_else(|| vec![0.0], |t| t.0.clone());
        let of_name = SplatFormat::of_path(&self.out);
        let asked = self.format.map(SplatFormat::from);
        match (&times[..], of_name) {
            (&[time], Some(format)) if asked.is_none_or(|f| f == format) => {
                Ok(Plan { format, files: vec![(time, self.out.clone())], folder: None })
            }
            (_, Some(_)) if times.len() > 1 => Err(Failure::usage(
                "several times make a folder of files: give -o DIR without an extension, and --format",
            )),
            (_, Some(_)) => Err(Failure::usage("--format and the extension of -o disagree")),
            (_, None) => {
                let format = asked.unwrap_or(SplatFormat::Ply);
                let path = |k: usize| self.out.join(format!("time-{k:04}.{}", format.extension()));
                let files = times.iter().enumerate().map(|(k, &t)| (t, path(k))).collect();
                Ok(Plan { format, files, folder: Some(self.out.clone()) })
            }
        }
    }

    /// Fails if an output exists, before anything is written; creates the folder for a single file.
    fn check_free(&self, plan: &Plan) -> Result<(), Failure> {
        let Some(folder) = &plan.folder else { return prepare_file(self.force, &self.out) };
        let table = folder.join(TABLE);
        check_free(self.force, "file", "name", plan.files.iter().map(|f| &f.1).chain([&table]))
    }

    /// One splat file as another.
    fn convert(&self, plan: &Plan, global: &Global) -> Result<Answer, Failure> {
        if self.times.is_some() || self.max_error.is_some() {
            return Err(Failure::usage(
                "a splat file has one moment and no ground truth: --times and --max-error need a run",
            ));
        }
        let raw = load_splats(&self.scene, &global.limits())?;
        // Gaussian kernels are kept bit for bit.
        let plain = if raw.kernel.is_neutral() { raw } else { with_plain_kernel(&raw)? };
        let before = plain.degree;
        let reduced = cut(plain, self.sh_degree.unwrap_or(before));
        let turn = self.up.map(|up| up.turn(|| None)).transpose()?;
        let reduced = match &turn {
            Some(turn) => reduced.mapped(turn),
            None => reduced,
        };
        let Some((_, path)) = plan.files.first() else { return Err(Failure::usage("no time to write")) };
        plan.folder.as_deref().map_or(Ok(()), create_folder)?;
        save_splats(path, &reduced, self.force)?;
        if let Some(note) = plan.format.note(&reduced) {
            global.say(format!("note: {note}"));
        }
        let again = load_splats(path, &global.limits())?;
        let lost = if again.degree < before { format!(" (of {before})") } else { String::new() };
        let text = format!(
            "{} splats, SH degree {}{lost}; read back whole\n-> {}\n",
            again.len(),
            again.degree,
            path.display()
        );
        Ok(Answer::new(
            text,
            json!({"files": [path.display().to_string()], "splats": again.len(), "rotation": turn, "psnr": Value::Null}),
        ))
    }

    fn bake(&self, plan: &Plan, global: &Global) -> Result<Answer, Failure> {
        let run = self.place.open(&self.scene, global)?;
        let dataset = if self.no_eval { None } else { to_score(&run, self.split, self.max_error, global)? };
        note_extrapolated(plan.files.iter().map(|f| f.0), &run, global);
        let (method, views) = (&run.loaded.model, run.training_views()?);
        let turn = self.up.map(|up| up.turn(|| mean_up(&views))).transpose()?;
        let baker = || Baker::new(method, &views, self.sh_degree).turned(turn);
        let share = &run.share;
        // Every rank finds its outputs free before one writes.
        share.barrier()?;
        plan.folder.as_deref().map_or(Ok(()), create_folder)?;
        let mine = share.run(plan.files.len());
        let mut progress = Progress::new(mine.len() as u64, "times", global.quiet);
        let written = share.each(plan.files.len(), |k| {
            let (time, path) = &plan.files[k];
            let raw = baker().bake(&Timestamp::normalised(*time))?;
            save_splats(path, &raw, self.force)?;
            if let Some(note) = plan.format.note(&raw).filter(|_| k == mine.start) {
                // Of several files, the first stands for all.
                global.say(format!("note: {note}"));
            }
            let again = load_splats(path, &global.limits())?;
            progress.at((k - mine.start) as u64 + 1, || format!("{} splats", again.len()));
            // The table lies beside the files and moves with them.
            let file = path.file_name().map(|f| f.to_string_lossy().into_owned());
            Ok::<_, Failure>(json!({"time": time, "file": file, "splats": again.len()}))
        })?;
        progress.finish();
        if let Some(folder) = &plan.folder {
            let table = serde_json::to_vec_pretty(&written).unwrap_or_default();
            if share.leads() {
                write_file(&folder.join(TABLE), self.force, |out| out.write_all(&table))?;
            }
        }
        let loss = dataset.map(|data| self.measure(&run, &data, baker(), plan)).transpose()?;
        let bytes: u64 = plan.files.iter().filter_map(|f| f.1.metadata().ok()).map(|m| m.len()).sum();
        let (number, mb) = (plan.files.len(), bytes as f64 / 1e6);
        let mut text = format!("{number} file{}, {mb:.2} MB, read back whole\n", if number == 1 { "" } else { "s" });
        if let Some(loss) = &loss {
            text.push_str(&loss.to_text());
        }
        text.push_str(&format!("-> {}\n", self.out.display()));
        let answer =
            json!({"files": written, "bytes": bytes, "rotation": turn, "psnr": loss.as_ref().map(Loss::to_json)});
        let try_this = "--format ply or glb, a higher --sh-degree, or -o NAME.gs4d, which keeps the method";
        verdict(self.max_error, loss.as_ref(), &self.out, try_this)?;
        Ok(Answer::new(text, answer))
    }

    fn measure(&self, run: &OpenRun, data: &Dataset, baker: Baker<'_>, plan: &Plan) -> Result<Loss, Failure> {
        let images: ImageCache = run.images();
        let (split, background) = (self.split.into(), run.background());
        let scoring = run.scoring(background, &images);
        let before = evaluate_with(&run.loaded.model, data, split, &scoring)?;
        let files = AsExported::new(baker, plan.format).with_files(plan.files.clone());
        let after = files.evaluate(data, split, &scoring)?;
        let read = after.views.iter().filter(|v| files.file_at(v.time).is_some()).count();
        Ok(Loss::of(&before, &after, read))
    }
}

/// The data that an export is scored on, opened before anything is written; none, with a note, where the split has no views.
pub(super) fn to_score(
    run: &OpenRun,
    split: SplitName,
    max_error: Option<f64>,
    global: &Global,
) -> Result<Option<Dataset>, Failure> {
    let data = run.open_data()?;
    if !data.views(split.into()).is_empty() {
        return Ok(Some(data));
    }
    let name = split_name(split.into());
    if max_error.is_some() {
        return Err(Failure::new(
            Class::Data,
            "data.split",
            format!("the data have no {name} views to measure --max-error on"),
        )
        .remedy("choose another split with --split, for example train"));
    }
    global.say(format!("note: nothing is scored, the data have no {name} views; --split chooses others"));
    Ok(None)
}

/// The nearest Gaussians to splats with another kernel profile.
fn with_plain_kernel(raw: &RawSplats) -> Result<RawSplats, ExportError> {
    let plain = raw.to_splats().and_then(|s| RawSplats::from_splats(&s.with_plain_kernel()));
    let plain = plain.map_err(|source| ExportError::Splats { time: 0.0, source })?;
    Ok(RawSplats { antialiased: raw.antialiased, ..plain })
}

/// Table of times and files in an output folder.
const TABLE: &str = "times.json";

impl From<ExportError> for Failure {
    fn from(e: ExportError) -> Self {
        match e {
            ExportError::Io(e) => e.into(),
            other => Self::new(Class::Data, "export", other.to_string())
                .remedy("gs4d inspect shows what the scene holds; choose another time"),
        }
    }
}
