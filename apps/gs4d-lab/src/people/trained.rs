//! What was learnt, to be put on other films and under other settings.

use super::{LabError, Setup, Tell, registry};
use gs_core::Params;
use gs_data::{Dataset, ImageCache, Split};
use gs_method_texel::{Config, Dut, ENTRY};
use gs_metrics::Mean;
use gs_train::checkpoint::Checkpoint;
use gs_train::evaluate::{EvalReport, ViewScores, evaluate};
use gs_train::method::{Buffers, InitConfig, Method, MethodError, SceneInfo, overlay, parse_config, section};
use gs_train::model::Model;
use gs_train::saved::{RunState, save};
use gs_train::trainer::{TrainOptions, Trainer};
use gs4d_run::OpenRun;
use gs4d_run::settings::{Request, resolve};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Bytes of decoded pictures kept.
const IMAGE_BYTES: usize = 256 << 20;

/// How to train.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recipe {
    /// Preset of the method `dut`.
    pub preset: String,
    /// Steps that the preset's recipe is stretched or compressed to.
    pub steps: u32,
    /// Settings beside, `KEY=VALUE`.
    pub sets: Vec<String>,
    /// Seed of every random number.
    pub seed: u64,
}

/// A method `dut` that has learnt.
pub struct Trained {
    config: toml::Table,
    values: BTreeMap<String, Vec<f32>>,
    step: u32,
}

impl Trained {
    /// The method of the run; of the recipe if there is none; nothing without both.
    ///
    /// # Errors
    /// If the run is of another method, or training fails.
    pub fn of(setup: &Setup, film: &Dataset, tell: &mut Tell<'_>) -> Result<Option<Self>, LabError> {
        match (&setup.run, &setup.recipe) {
            (Some(path), _) => Self::of_run(&OpenRun::open(&registry(), path)?).map(Some),
            (None, Some(recipe)) => Self::learn(film, recipe, &[], tell).map(Some),
            (None, None) => Ok(None),
        }
    }

    /// The method of a run.
    ///
    /// # Errors
    /// If it is another.
    pub fn of_run(run: &OpenRun) -> Result<Self, LabError> {
        let method = &run.loaded.model;
        if method.name() != ENTRY.name {
            let name = method.name();
            return Err(LabError::Unfit(format!("the run is of the method {name}; a run of {} is needed", ENTRY.name)));
        }
        Ok(Self::keep(method, run.loaded.config.clone(), run.loaded.step))
    }

    fn keep(method: &Model, config: toml::Table, step: u32) -> Self {
        let mut values = BTreeMap::new();
        method.visit(&mut |p| {
            values.insert(p.name.clone(), p.value.clone());
        });
        method.buffers(&mut |b| {
            values.insert(b.name.to_owned(), b.values.clone());
        });
        Self { config, values, step }
    }

    /// Trains on a film.
    ///
    /// # Errors
    /// If settings are refused or training fails.
    pub fn learn(film: &Dataset, recipe: &Recipe, sets: &[&str], tell: &mut Tell<'_>) -> Result<Self, LabError> {
        let request = Request {
            method: ENTRY.name.into(),
            preset: recipe.preset.clone(),
            steps: Some(recipe.steps),
            seed: Some(recipe.seed),
            sets: recipe.sets.iter().cloned().chain(sets.iter().map(|s| (*s).to_owned())).collect(),
            ..Request::default()
        };
        let resolved = resolve(&registry(), &request)?;
        let options = TrainOptions { seed: recipe.seed, image_bytes: IMAGE_BYTES };
        let trainer = Trainer::new(&registry(), Arc::new(film.clone()), ENTRY.name, &resolved.method, options)?;
        let what = if sets.is_empty() { "the preset".to_owned() } else { sets.join(" ") };
        Self::train(trainer, resolved.method, &what, tell)
    }

    fn train(mut trainer: Trainer, config: toml::Table, what: &str, tell: &mut Tell<'_>) -> Result<Self, LabError> {
        tell(&format!("training {what}: {} steps", trainer.steps()));
        while trainer.steps_done() < trainer.steps() {
            trainer.step()?;
        }
        let seconds = trainer.train_seconds();
        tell(&format!("trained for {seconds:.0} s"));
        Ok(Self::keep(trainer.model(), config, trainer.steps()))
    }

    /// The method on a film, under its settings with some changed (`KEY=VALUE`).
    ///
    /// # Errors
    /// If the film's template is another, or settings are refused.
    pub fn on(&self, film: &Dataset, changes: &[&str]) -> Result<Dut, LabError> {
        let config = self.changed(changes)?;
        let init: InitConfig = section(ENTRY.name, &config, "init")?;
        let parsed: Config = parse_config(ENTRY.name, &config)?;
        let schedule = parsed.schedule.clone();
        let mut dut = Dut::new(parsed, &SceneInfo::of(film, &init, 0)?)?;
        let mut wrong = None;
        dut.visit_mut(&mut |p| match self.values.get(&p.name) {
            Some(values) if values.len() == p.len() => p.value.clone_from(values),
            _ => wrong = Some(p.name.clone()),
        });
        dut.buffers_mut(&mut |b| match self.values.get(b.name) {
            Some(values) if values.len() == b.values.len() => b.values.clone_from(values),
            // Not asked for when it learnt.
            None => {}
            Some(_) => wrong = Some(b.name.to_owned()),
        });
        if let Some(name) = wrong {
            let what =
                format!("the values of `{name}` do not fit; film and settings must be of the person learnt from");
            return Err(LabError::Unfit(what));
        }
        dut.begin_step(&schedule.at(self.step));
        Ok(dut)
    }

    /// The same as a model.
    fn model(&self, film: &Dataset, changes: &[&str]) -> Result<Model, LabError> {
        let schedule = parse_config::<Config>(ENTRY.name, &self.changed(changes)?)?.schedule;
        let mut model = Model::new(ENTRY.name, self.on(film, changes)?, schedule)?;
        model.begin_step(self.step);
        Ok(model)
    }

    fn changed(&self, changes: &[&str]) -> Result<toml::Table, LabError> {
        let mut config = self.config.clone();
        for change in changes {
            let parsed = change.parse();
            let wrong = |e: toml::de::Error| MethodError::Config { method: ENTRY.name, why: e.to_string() };
            overlay(&mut config, parsed.map_err(wrong)?);
        }
        Ok(config)
    }

    /// Goes on learning the textures' Gaussians from the training views of a film, for so many steps.
    ///
    /// # Errors
    /// If training fails.
    pub fn go_on(&self, film: &Dataset, steps: u32, seed: u64, tell: &mut Tell<'_>) -> Result<Self, LabError> {
        let main = format!("schedule.stages.main.steps={steps}");
        let config =
            self.changed(&["schedule.stages.geometry.steps=0", "schedule.stages.warm_up.steps=0", main.as_str()])?;
        let (dut, scene) = (self.model(film, &[])?, SceneInfo::of(film, &section(ENTRY.name, &config, "init")?, seed)?);
        let run =
            RunState { config: &config, scene: &scene, step: 0, adam_updates: &BTreeMap::new(), train_seconds: 0.0 };
        let start: Checkpoint = save(&dut, &run);
        let trainer = Trainer::resume(&registry(), Arc::new(film.clone()), &start, None, IMAGE_BYTES)?;
        Self::train(trainer, config, "under the other light", tell)
    }

    /// Scores of the method on the test views of a film.
    ///
    /// # Errors
    /// As [`evaluate`].
    pub fn scores(&self, film: &Dataset, changes: &[&str]) -> Result<EvalReport, LabError> {
        let dut = self.model(film, changes)?;
        Ok(evaluate(&dut, film, Split::Test, [0.0; 3], &ImageCache::new(IMAGE_BYTES, 1.0))?)
    }
}

/// Headings of the scores of a method.
pub const SCORES: [(&str, usize); 4] = [("PSNR", 2), ("in-mask PSNR", 2), ("SSIM", 4), ("proxy", 4)];

/// The numbers under [`SCORES`]; nothing without a report.
pub fn scores(report: Option<&EvalReport>) -> [Option<f64>; 4] {
    let mean = report.map(|r| r.mean);
    [
        mean.and_then(|m| m.psnr),
        mean.and_then(|m| m.masked).and_then(|m| m.psnr),
        mean.and_then(|m| m.ssim),
        mean.and_then(|m| m.perceptual_proxy),
    ]
}

/// The same over the views of one moment.
pub fn scores_at(report: Option<&EvalReport>, time: f32) -> [Option<f64>; 4] {
    let of = |value: fn(&ViewScores) -> Option<f64>| {
        let views = report.iter().flat_map(|r| &r.views).filter(|v| v.time == time);
        Mean::of(views.filter_map(value)).value
    };
    [of(|v| v.psnr), of(|v| v.masked.and_then(|m| m.psnr)), of(|v| Some(v.ssim)), of(|v| Some(v.perceptual_proxy))]
}
