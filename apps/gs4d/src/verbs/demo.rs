//! `gs4d demo`: generates a moving scene, trains on it, and reports the result.

use super::train::{drive, resume_command, time_text};
use crate::answer::{Answer, number};
use crate::device::DeviceFlag;
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::interrupt;
use crate::output::{check_free, create_folder};
use gs_core::io::images::save_png;
use gs_core::io::{RawSplats, save_splats};
use gs_synth::{self as synth, SynthOptions};
use gs_train::evaluate::EvalReport;
use gs_train::renderer::Renderer;
use gs_train::timestamp::Timestamp;
use gs4d_report::inspect::bytes_text;
use gs4d_run::opened::metrics_json;
use gs4d_run::settings::{Request, resolve};
use gs4d_run::{Outcome, Training};
use serde_json::json;
use std::path::PathBuf;
use std::time::Instant;

/// Rendered frames over time 0..1, and their folder.
const FRAMES: usize = 24;
const FOLDER: &str = "frames";
/// Settings over the preset: as many splats as two cores train in a minute.
const SETS: [&str; 3] = ["init.points=6000", "schedule.density.max_splats=12000", "run.eval_every=500"];
/// Further settings of the default method: a deformation field with the resolution that a waving cloth needs.
const FIELD_SETS: [&str; 5] = [
    "field.width=32",
    "field.hexplane.resolution=[16, 16, 16, 33]",
    "field.hexplane.time_smoothness=0.01",
    "schedule.lr.field.all.start=8e-4",
    "schedule.lr.field.all.end=8e-6",
];
const METHOD: &str = "fourdgs";

/// Generate a moving scene, train on it in under two minutes, and write a report, images and a splat file
#[derive(clap::Args)]
pub struct Demo {
    /// Folder for everything.
    #[arg(short, long, value_name = "DIR", default_value = "gs4d-demo")]
    out: PathBuf,
    /// Generated scene; gs4d synth lists them.
    #[arg(long, default_value = "sheet")]
    scene: String,
    /// Method; gs4d methods lists them.
    #[arg(short, long, default_value = METHOD)]
    method: String,
    /// Preset of the method.
    #[arg(long, default_value = "tiny")]
    preset: String,
    /// Steps; the schedule is stretched or compressed to them.
    #[arg(long, default_value_t = 5000, value_parser = clap::value_parser!(u32).range(1..))]
    steps: u32,
    /// Side of the images, pixels.
    #[arg(long, default_value_t = 200)]
    size: u32,
    /// Seed of scene and training.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Overwrite an older demo in that folder.
    #[arg(short, long)]
    force: bool,
    #[command(flatten)]
    device: DeviceFlag,
}

impl Demo {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let begun = Instant::now();
        let stop = interrupt::flag()?;
        let mut training = self.begin(global)?;
        if let Outcome::Interrupted(saved) = drive(&mut training, &stop, global, None)? {
            return Err(Failure::new(Class::Interrupted, "interrupted", format!("saved {}", saved.display()))
                .remedy(resume_command(training.folder().root())));
        }
        let scores = training.score()?;
        training.report(&scores)?;
        let files = self.write(&training)?;
        Ok(answer(&scores, &files, training.trainer().steps_done(), begun.elapsed().as_secs_f64()))
    }

    /// Generates the data and starts a run.
    fn begin(&self, global: &Global) -> Result<Training, Failure> {
        let device = self.device.open_to_train(global)?;
        let (root, data_folder) = (self.out.join("run"), self.out.join("data"));
        if root.exists() && !self.force {
            return Err(Failure::new(Class::Io, "io.exists", "an older demo is in that folder")
                .place(self.out.display())
                .why("nothing is overwritten unless asked")
                .remedy("choose another folder with -o, or pass -f"));
        }
        let written = (0..FRAMES).map(|k| self.frame(k)).chain([self.splats()]);
        check_free(self.force, "file", "folder", written)?;
        let options = SynthOptions { size: self.size, seed: self.seed, ..SynthOptions::default() };
        global.say(format!("making the scene `{}` with {} training views", self.scene, options.train_views));
        synth::write(&data_folder, &self.scene, &options, self.force)?;
        let field_sets = if self.method == METHOD { &FIELD_SETS[..] } else { &[] };
        let request = Request {
            method: self.method.clone(),
            preset: self.preset.clone(),
            data: Some(data_folder),
            steps: Some(self.steps),
            seed: Some(self.seed),
            sets: SETS.iter().chain(field_sets).map(|s| (*s).to_owned()).collect(),
            ..Request::default()
        };
        Ok(Training::begin(&root, self.force, resolve(gs_methods::registry(), &request)?)?.on(&device)?)
    }

    /// Where a frame is written.
    fn frame(&self, k: usize) -> PathBuf {
        self.out.join(FOLDER).join(format!("frame-{k:02}.png"))
    }

    /// Where the splats at time 0.5 are written.
    fn splats(&self) -> PathBuf {
        self.out.join("scene-t0.50.ply")
    }

    /// Writes frames over time and the splats at time 0.5; returns the paths of the results.
    fn write(&self, training: &Training) -> Result<Vec<PathBuf>, Failure> {
        let method = training.trainer().model();
        let dataset = training.trainer().dataset();
        let view = dataset.test.first().or(dataset.train.first());
        let Some(view) = view else { return Ok(Vec::new()) };
        let background = method.background();
        let mut renderer = Renderer::on(training.trainer().device(), method.raster_options(background))?;
        let (frames, ply) = (self.out.join(FOLDER), self.splats());
        create_folder(&frames)?;
        for k in 0..FRAMES {
            let time = k as f32 / (FRAMES - 1) as f32;
            save_png(&self.frame(k), &renderer.at(method, time, &view.camera)?, self.force)?;
        }
        let splats = method.splats(&Timestamp::normalised(0.5), &view.camera)?;
        let raw = RawSplats::from_splats(&splats);
        let raw = raw.map_err(|e| Failure::new(Class::Internal, "splats", e.to_string()))?;
        save_splats(&ply, &raw, self.force)?;
        Ok(vec![training.folder().root().join("report.html"), frames, ply])
    }
}

/// The table of results and the list of files.
fn answer(scores: &EvalReport, files: &[PathBuf], step: u32, seconds: f64) -> Answer {
    let mut json = metrics_json(scores, step);
    json["seconds"] = json!(seconds);
    json["files"] = json!(files.iter().map(|f| f.display().to_string()).collect::<Vec<_>>());
    let table = [
        ("PSNR", format!("{} dB", number(scores.mean.psnr, 2)), "mean of the held-out views"),
        ("SSIM", number(scores.mean.ssim, 4), "the same views"),
        ("training", time_text(scores.train_seconds.unwrap_or(0.0)), "in steps"),
        ("in all", time_text(seconds), "with scene, scores, report and images"),
        ("splats", scores.gaussians.to_string(), "in the canonical cloud"),
        ("scene", bytes_text(scores.parameter_bytes as usize), "all parameters as f32"),
    ];
    let mut text: String = table.iter().map(|(name, value, note)| format!("{name:10}{value:>12}  {note}\n")).collect();
    text.push('\n');
    for file in files {
        text.push_str(&format!("{}\n", file.display()));
    }
    Answer::new(text, json)
}
