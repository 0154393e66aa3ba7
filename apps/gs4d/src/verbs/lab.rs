//! `gs4d lab`: experiments on avatars.

use super::synth::avatar::light;
use super::train::time_text;
use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use gs_synth::avatar::{AvatarOptions, Light};
use gs4d_lab::people::{EXPERIMENTS, Experiment, Findings, LabError, Recipe, Setup, Training, WriteError};
use serde_json::json;
use std::path::PathBuf;
use std::time::Instant;

/// Experiments on avatars (method dut): textures, wrong poses, views, visibility, clothing, contact, unseen motion, light
#[derive(clap::Args)]
pub struct Lab {
    /// Name of the experiment; without it, they are listed.
    experiment: Option<String>,
    /// Folder for the table (.json, .csv, .md) and its charts (.svg).
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// A run of the method dut: its data and parameters are used.
    #[arg(long, value_name = "RUN", conflicts_with_all = ["steps", "preset", "sets", "template", "clip", "film_frames", "size"])]
    run: Option<PathBuf>,
    /// Train for so many steps where there is no run; the preset's schedule is stretched or compressed to them.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    steps: Option<u32>,
    /// Preset to train.
    #[arg(long, default_value = "fast", requires = "steps")]
    preset: String,
    /// A setting to train with (repeatable).
    #[arg(long = "set", value_name = "KEY=VALUE", requires = "steps")]
    sets: Vec<String>,
    /// The character to film: builtin, builtin:NAME, or a glTF or GLB file [default: builtin; loose: builtin:gown].
    #[arg(long, value_name = "builtin|FILE")]
    template: Option<String>,
    /// Its motion [default: the first; topo: touch].
    #[arg(long, value_name = "NAME")]
    clip: Option<String>,
    /// Frames filmed.
    #[arg(long, value_name = "N", default_value_t = Setup::default().film.frames, value_parser = clap::value_parser!(u32).range(1..))]
    film_frames: u32,
    /// Side of the images filmed, pixels.
    #[arg(long, default_value_t = Setup::default().film.size)]
    size: u32,
    /// Frames evaluated, evenly spread over the film.
    #[arg(long, value_name = "N", default_value_t = Setup::default().frames as u32, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Texels per side of the textures unprojected.
    #[arg(long, value_name = "S", default_value_t = Setup::default().texels as u32, value_parser = clap::value_parser!(u32).range(8..=4096))]
    texels: u32,
    /// tex: texels per side that are compared.
    #[arg(long, value_name = "S,S", value_delimiter = ',', default_values_t = Setup::default().sizes.into_iter().map(|s| s as u32), value_parser = clap::value_parser!(u32).range(8..=4096))]
    sizes: Vec<u32>,
    /// motion, topo: the joint that is turned, or whose fore arm touches the body [default: the left fore arm by its name].
    #[arg(long, value_name = "NAME")]
    joint: Option<String>,
    /// ood: the motion that is tested on [default: the first other one].
    #[arg(long, value_name = "NAME")]
    other_clip: Option<String>,
    /// light: the light tested under, towards X,Y,Z; AMBIENT is what a point that faces away gets.
    #[arg(long, value_name = "X,Y,Z[,AMBIENT]", value_parser = light, allow_hyphen_values = true)]
    other_light: Option<Light>,
    /// light: steps of training under it.
    #[arg(long, value_name = "N", default_value_t = Setup::default().tuning)]
    tuning: u32,
    /// Seed of noise and training.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Overwrite older results of the experiment in the folder.
    #[arg(short, long)]
    force: bool,
}

impl Lab {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let Some(name) = &self.experiment else { return Ok(list()) };
        let Some(experiment) = Experiment::find(name) else {
            let names: Vec<&str> = EXPERIMENTS.iter().map(|e| e.name).collect();
            let what = format!("there is no experiment `{name}`");
            return Err(Failure::usage(what).remedy(format!("choose one of {}", names.join(", "))));
        };
        let Some(out) = self.out.clone() else {
            return Err(Failure::usage("no folder to write to").remedy(format!("gs4d lab {name} -o DIR")));
        };
        if !self.force {
            Findings::vacant(experiment.name, &out).map_err(|e| {
                Failure::from(e).why("nothing is overwritten unless asked").remedy("pass -f, or another -o")
            })?;
        }
        let (force, begun) = (self.force, Instant::now());
        let findings = experiment.run(&self.setup(experiment), &mut |line| global.say(line))?;
        findings.write(&out, force)?;
        let seconds = begun.elapsed().as_secs_f64();
        let text = format!("{}{} -> {}\n", findings.text(), time_text(seconds), out.display());
        let mut json = findings.json();
        (json["path"], json["seconds"]) = (json!(out), json!(seconds));
        Ok(Answer::new(text, json))
    }

    fn setup(self, experiment: &Experiment) -> Setup {
        let default = Setup::default();
        let template = self.template.filter(|name| name != "builtin").unwrap_or_else(|| experiment.template.to_owned());
        let film = AvatarOptions {
            template,
            clip: self.clip,
            frames: self.film_frames,
            size: self.size,
            seed: self.seed,
            ..default.film
        };
        let (preset, sets, seed) = (self.preset, self.sets, self.seed);
        Setup {
            film,
            run: self.run,
            recipe: self.steps.map(|steps| Recipe { preset, steps, sets, seed }),
            frames: self.frames as usize,
            texels: self.texels as usize,
            sizes: self.sizes.into_iter().map(|s| s as usize).collect(),
            joint: self.joint,
            other_clip: self.other_clip,
            other_light: self.other_light.unwrap_or(default.other_light),
            tuning: self.tuning,
        }
    }
}

fn list() -> Answer {
    let needs = |t| match t {
        Training::None => "",
        Training::Optional => " (more with --run or --steps)",
        Training::Required => " (needs --run or --steps)",
    };
    let line = |e: &Experiment| format!("{:10} {}{}\n", e.name, e.about, needs(e.training));
    let json: Vec<_> = EXPERIMENTS.iter().map(|e| json!({"name": e.name, "about": e.about})).collect();
    Answer::new(EXPERIMENTS.iter().map(line).collect::<String>(), json!(json))
}

impl From<WriteError> for Failure {
    fn from(e: WriteError) -> Self {
        match e {
            WriteError::Io(e) => e.into(),
            WriteError::Chart(e) => gs4d_run::RunError::from(e).into(),
        }
    }
}

impl From<LabError> for Failure {
    fn from(e: LabError) -> Self {
        let text = e.to_string();
        match e {
            LabError::NeedsTraining(_) => {
                Self::usage(text).remedy("pass --run RUN, or --steps N to train for the experiment")
            }
            LabError::Unknown { .. } => Self::usage(text).remedy("choose one of them by name"),
            LabError::Unfit(_) => {
                Self::usage(text).remedy("choose another --template, --clip or --joint, or a run of this person")
            }
            LabError::Data(e) => e.into(),
            LabError::Run(e) => (*e).into(),
            LabError::Method(e) => e.into(),
            LabError::Train(e) => e.into(),
            LabError::Eval(e) => e.into(),
            LabError::Frame(_) | LabError::Texels(_) | LabError::Mesh(_) | LabError::Unproject(_) => {
                Self::new(Class::Data, "data.film", text).remedy("look at the film with gs4d pose and gs4d eval")
            }
        }
    }
}
