//! `gs4d glmd`: the motion added by each stage of a run's model, seen by a fixed camera.

use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::opening::{RunData, note_extrapolated};
use crate::output::{check_free, create_folder};
use crate::parse;
use crate::progress::Progress;
use gs_core::Camera;
use gs_core::io::cameras::load_cameras;
use gs_core::io::images::save_png;
use gs_core::io::{Limits, write_file};
use gs_data::Split;
use gs_synth as synth;
use gs4d_eval::forecast::Clock;
use gs4d_lab::glmd::{self, Anchor, GlmdError, Masks, Mean, Options, Reference, Still, Study, Switches};
use gs4d_run::OpenRun;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Show what each stage of a model moves: flows between its stages, in images and numbers
#[derive(clap::Args)]
pub struct Glmd {
    /// Folder of the run.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Normalised times: A..B:N for N times from A to B, or one time.
    #[arg(long, default_value = "0..1:9", allow_hyphen_values = true, value_parser = parse::times)]
    times: parse::Times,
    /// The camera that stands still: train:K, val:K or test:K of the run's data, or FILE or FILE#K as for render.
    #[arg(long, default_value = "test:0", value_name = "SPLIT:K|FILE#K")]
    camera: String,
    /// The model's own flow, Farneback's between the 8-bit renders, or both.
    #[arg(long, value_enum, default_value_t = By::Both)]
    flow: By,
    /// Whether flows are anchored in the later render, where masks of that time fit, or in the earlier.
    #[arg(long, value_enum, default_value_t = At::Later)]
    anchor: At,
    /// Compare lengths with this quantile of each flow map instead of its longest displacement (0 < Q <= 1).
    #[arg(long, value_name = "Q", value_parser = parse::share)]
    quantile: Option<f64>,
    /// Folder of PNG masks by name, one for all times or one for each, bright where the object is
    /// [default: rigid bodies of a generated scene, else a threshold of the flow].
    #[arg(long, value_name = "DIR")]
    mask: Option<PathBuf>,
    /// Folder for glmd.html, glmd.json and one PNG per time; made if missing.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Overwrite existing files.
    #[arg(short, long)]
    force: bool,
    #[command(flatten)]
    place: RunData,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum By {
    Model,
    Farneback,
    Both,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum At {
    Later,
    Earlier,
}

impl From<GlmdError> for Failure {
    fn from(e: GlmdError) -> Self {
        let text = e.to_string();
        match e {
            GlmdError::OneStage(_) => Self::new(Class::Data, "glmd.stages", text)
                .remedy("give a run of a method that deforms its scene, such as fourdgs"),
            GlmdError::Method(e) => e.into(),
            GlmdError::Mask(_) => Self::new(Class::Data, "data.mask", text),
            GlmdError::Metric(_) => Self::new(Class::Data, "data.metric", text),
            GlmdError::Report(_) => Self::new(Class::Internal, "report", text),
        }
    }
}

impl Glmd {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let run = self.place.open(&self.run, global)?;
        note_extrapolated(self.times.0.iter().copied(), &run, global);
        let method = &run.loaded.model;
        let camera = self.camera(&run)?;
        let masks = self.masks(&run)?;
        let names: Vec<String> = (0..self.times.0.len()).map(|k| format!("t_{k:03}.png")).collect();
        self.prepare(&names)?;
        let options = self.options();
        let mut progress = Progress::new(names.len() as u64, "times", global.quiet);
        let mut stills = Vec::new();
        glmd::study(method, &camera, run.background(), &masks, &options, |still| {
            let time = still.time;
            let strip = glmd::strip(&still).map_err(GlmdError::from)?;
            save_png(&self.out.join(&names[stills.len()]), &strip, self.force)?;
            stills.push(still);
            progress.at(stills.len() as u64, || format!("time {time}"));
            Ok::<(), Failure>(())
        })?;
        progress.finish();
        let means = glmd::means(stills.iter().flat_map(|s| s.steps.iter().map(|step| &step.scores)));
        let switches = glmd::switches(method, self.times.0[0])?;
        let title = format!("{} · {}", self.run.display(), method.name());
        let subtitle = format!(
            "Camera {}; flows anchored in the {:?} render; masks: {}",
            self.camera,
            self.anchor,
            masks.source()
        );
        let study = Study { title: &title, subtitle: &subtitle, stills: &stills, means: &means, switches: &switches };
        let page = glmd::html(&study)?;
        let json = self.json(&run, &masks, &options, (&stills, &means, &switches));
        self.write("glmd.html", &page)?;
        self.write("glmd.json", &format!("{json:#}\n"))?;
        Ok(Answer::new(text(&means, &switches, &masks, &self.out), json))
    }

    fn options(&self) -> Options {
        Options {
            times: self.times.0.clone(),
            anchor: if self.anchor == At::Later { Anchor::Later } else { Anchor::Earlier },
            model: self.flow != By::Farneback,
            farneback: self.flow != By::Model,
            reference: self.quantile.map_or(Reference::Longest, Reference::Quantile),
        }
    }

    /// The camera `split:index` of the dataset, or of a camera file.
    fn camera(&self, run: &OpenRun) -> Result<Camera, Failure> {
        let wrong =
            |what: String| Failure::usage(what).remedy("give train:K, val:K or test:K, a camera file or FILE#K");
        let split = |name: &str| match name {
            "train" => Some(Split::Train),
            "val" => Some(Split::Val),
            "test" => Some(Split::Test),
            _ => None,
        };
        if let Some((split, k)) = self.camera.split_once(':').and_then(|(name, k)| Some((split(name)?, k))) {
            let dataset = run.open_data()?;
            let views = dataset.views(split);
            let view = k.parse::<usize>().ok().and_then(|k| views.get(k));
            let view =
                view.ok_or_else(|| wrong(format!("there is no view `{}`: {} views", self.camera, views.len())))?;
            let placed = run.placed();
            let view = if split == Split::Train { placed.view(view) } else { placed.held_out(view) };
            return Ok(run.images().camera(&view));
        }
        let (file, k) = self.camera.rsplit_once('#').unwrap_or((&self.camera, "0"));
        let mut cameras = load_cameras(Path::new(file), &Limits::default())?;
        match k.parse::<usize>() {
            Ok(k) if k < cameras.len() => Ok(cameras.swap_remove(k).camera),
            _ => Err(wrong(format!("there is no camera #{k} in {file}: {} cameras", cameras.len()))),
        }
    }

    fn masks(&self, run: &OpenRun) -> Result<Masks, Failure> {
        if let Some(folder) = &self.mask {
            return Ok(Masks::of_folder(folder)?);
        }
        let truth = synth::truth_of(Path::new(&run.resolved.run.data));
        let clock = run.open_data().ok().as_ref().and_then(Clock::of);
        Ok(truth.map_or(Masks::Threshold, |t| Masks::Truth(Box::new(t), clock)))
    }

    /// Creates the output folder; fails if an output exists, unless forced.
    fn prepare(&self, names: &[String]) -> Result<(), Failure> {
        let files = names.iter().map(String::as_str).chain(["glmd.html", "glmd.json"]).map(|n| self.out.join(n));
        check_free(self.force, "file", "folder", files)?;
        create_folder(&self.out)
    }

    fn write(&self, name: &str, content: &str) -> Result<(), Failure> {
        Ok(write_file(&self.out.join(name), self.force, |out| out.write_all(content.as_bytes()))?)
    }

    fn json(
        &self,
        run: &OpenRun,
        masks: &Masks,
        options: &Options,
        (stills, means, switches): (&[Still], &[Mean], &Switches),
    ) -> Value {
        let reference = self.quantile.map_or("longest".to_owned(), |q| format!("quantile {q}"));
        let time = |s: &Still| {
            let flows: Vec<_> = s.steps.iter().map(|step| &step.scores).collect();
            json!({"time": s.time, "flows": flows, "farneback_against_model_px": s.disagreement})
        };
        json!({
            "run": self.run.display().to_string(),
            "method": run.loaded.model.name(),
            "step": run.loaded.step,
            "camera": self.camera,
            "anchor": options.anchor,
            "reference": reference,
            "masks": masks.source(),
            "pixels": "those at least half covered by splats",
            "moments": stills.iter().map(time).collect::<Vec<_>>(),
            "means": means,
            "anchors": switches,
        })
    }
}

fn text(means: &[Mean], switches: &Switches, masks: &Masks, out: &Path) -> String {
    let mut text = format!("{:18}{:11}{:26}{:>10}{:>9}\n", "stages", "flow", "number", "mean", "moments");
    for m in means {
        text.push_str(&format!("{:18}{:11}{:26}{:>10.4}{:>9}\n", m.step, m.by, m.name, m.mean, m.moments));
    }
    if let Some(share) = switches.global {
        text.push_str(&format!("anchors that move with their scaffold: {:.1} %\n", 100.0 * share));
    }
    text.push_str(&format!("masks: {}\n-> {}\n", masks.source(), out.join("glmd.html").display()));
    text
}
