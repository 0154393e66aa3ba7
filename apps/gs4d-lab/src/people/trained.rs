//! A trained method `dut`, evaluated on other data and under other settings.

use super::{LabError, Log, Setup, registry};
use glam::Vec3;
use gs_core::Params;
use gs_data::avatar::AvatarFrame;
use gs_data::{Dataset, ImageCache, Split};
use gs_method_texel::{Config, Dut, ENTRY};
use gs_metrics::Mean;
use gs_train::checkpoint::Checkpoint;
use gs_train::evaluate::{EvalReport, ViewScores, evaluate};
use gs_train::method::{Buffers, Method, MethodError};
use gs_train::model::Model;
use gs_train::registry::{overlay, own_settings, parse_config, section};
use gs_train::saved::{RunState, save};
use gs_train::scene::{InitConfig, SceneInfo};
use gs_train::trainer::{TrainOptions, Trainer};
use gs4d_run::OpenRun;
use gs4d_run::settings::{Request, resolve};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Size of the cache of decoded images, bytes.
const IMAGE_BYTES: usize = 256 << 20;

/// How to train the method `dut`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recipe {
    /// Name of the preset.
    pub preset: String,
    /// Training steps; the recipe of the preset is stretched or compressed to them.
    pub steps: u32,
    /// Further settings, `KEY=VALUE`.
    pub sets: Vec<String>,
    /// Seed of every random number.
    pub seed: u64,
}

/// Settings, parameters and buffers of a trained method `dut`.
pub struct Trained {
    config: toml::Table,
    values: BTreeMap<String, Vec<f32>>,
    step: u32,
}

impl Trained {
    /// Loads the run of the setup, else trains its recipe; `None` without both.
    ///
    /// # Errors
    /// If the run is of another method, or training fails.
    pub(super) fn of(setup: &Setup, film: &Dataset, log: &mut Log<'_>) -> Result<Option<Self>, LabError> {
        match (&setup.run, &setup.recipe) {
            (Some(path), _) => Self::of_run(&OpenRun::open(&registry(), path)?).map(Some),
            (None, Some(recipe)) => Self::learn(film, recipe, &[], log).map(Some),
            (None, None) => Ok(None),
        }
    }

    /// Trains the recipe of the setup with `sets` applied after its own; `None` with a run, without a recipe or without `sets`.
    ///
    /// # Errors
    /// As [`Self::learn`].
    pub(super) fn varied(
        setup: &Setup,
        film: &Dataset,
        sets: &[&str],
        log: &mut Log<'_>,
    ) -> Result<Option<Self>, LabError> {
        match (&setup.run, &setup.recipe) {
            (None, Some(recipe)) if !sets.is_empty() => Self::learn(film, recipe, sets, log).map(Some),
            _ => Ok(None),
        }
    }

    /// Whether it has learnt offsets from the template.
    pub(super) fn has_geonet(&self) -> bool {
        self.values.keys().any(|name| name.starts_with("geo."))
    }

    /// Its setting `input`, as `KEY=VALUE`.
    pub(super) fn input(&self) -> String {
        self.config.get("input").map(|value| format!("input={value}")).unwrap_or_default()
    }

    /// Takes the parameters of a run.
    ///
    /// # Errors
    /// [`LabError::Unfit`] if the run is of another method.
    pub fn of_run(run: &OpenRun) -> Result<Self, LabError> {
        let method = &run.loaded.model;
        if method.name() != ENTRY.name {
            let name = method.name();
            return Err(LabError::Unfit(format!("the run is of the method {name}; a run of {} is needed", ENTRY.name)));
        }
        Ok(Self::copy(method, run.loaded.config.clone(), run.loaded.step))
    }

    fn copy(method: &Model, config: toml::Table, step: u32) -> Self {
        let mut values = BTreeMap::new();
        method.visit(&mut |p| {
            values.insert(p.name.clone(), p.value.clone());
        });
        method.buffers(&mut |b| {
            values.insert(b.name.to_owned(), b.values.clone());
        });
        Self { config, values, step }
    }

    /// Trains on `film`, with `sets` applied after the settings of the recipe.
    ///
    /// # Errors
    /// If settings are invalid or training fails.
    pub(super) fn learn(film: &Dataset, recipe: &Recipe, sets: &[&str], log: &mut Log<'_>) -> Result<Self, LabError> {
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
        Self::train(trainer, resolved.method, &what, log)
    }

    fn train(mut trainer: Trainer, config: toml::Table, what: &str, log: &mut Log<'_>) -> Result<Self, LabError> {
        log(&format!("training {what}: {} steps", trainer.steps()));
        while trainer.steps_done() < trainer.steps() {
            trainer.step()?;
        }
        let seconds = trainer.train_seconds();
        log(&format!("trained for {seconds:.0} s"));
        Ok(Self::copy(trainer.model(), config, trainer.steps()))
    }

    /// The trained method on the data `film`, with some settings changed (`KEY=VALUE`).
    ///
    /// # Errors
    /// If the template of `film` is a different one, or settings are invalid.
    pub fn on(&self, film: &Dataset, changes: &[&str]) -> Result<Dut, LabError> {
        let config = own_settings(self.config(changes)?);
        let init: InitConfig = section(ENTRY.name, &config, "init")?;
        let parsed: Config = parse_config(ENTRY.name, &config)?;
        let schedule = parsed.schedule.trainer.clone();
        let mut dut = Dut::new(parsed, &SceneInfo::of(film, &init, 0)?)?;
        let mut wrong = None;
        dut.visit_mut(&mut |p| match self.values.get(&p.name) {
            Some(values) if values.len() == p.len() => p.value.clone_from(values),
            _ => wrong = Some(p.name.clone()),
        });
        dut.buffers_mut(&mut |b| match self.values.get(b.name) {
            Some(values) if values.len() == b.values.len() => b.values.clone_from(values),
            // Added by the changed settings.
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

    /// [`Self::on`] as a [`Model`].
    fn model(&self, film: &Dataset, changes: &[&str]) -> Result<Model, LabError> {
        let schedule = parse_config::<Config>(ENTRY.name, &own_settings(self.config(changes)?))?.schedule.trainer;
        let mut model = Model::new(ENTRY.name, self.on(film, changes)?, schedule)?;
        model.begin_step(self.step);
        Ok(model)
    }

    fn config(&self, changes: &[&str]) -> Result<toml::Table, LabError> {
        let mut config = self.config.clone();
        for change in changes {
            let parsed = change.parse();
            let wrong = |e: toml::de::Error| MethodError::Config { method: ENTRY.name, why: e.to_string() };
            overlay(&mut config, parsed.map_err(wrong)?);
        }
        Ok(config)
    }

    /// Fine-tunes on the training views of `film`: the last stage of the schedule, for `steps` steps.
    ///
    /// # Errors
    /// If training fails.
    pub(super) fn fine_tune(&self, film: &Dataset, steps: u32, seed: u64, log: &mut Log<'_>) -> Result<Self, LabError> {
        let main = format!("schedule.stages.main.steps={steps}");
        let config =
            self.config(&["schedule.stages.geometry.steps=0", "schedule.stages.warm_up.steps=0", main.as_str()])?;
        let (dut, scene) = (self.model(film, &[])?, SceneInfo::of(film, &section(ENTRY.name, &config, "init")?, seed)?);
        let run =
            RunState { config: &config, scene: &scene, step: 0, adam_updates: &BTreeMap::new(), train_seconds: 0.0 };
        let start: Checkpoint = save(&dut, &run);
        let trainer = Trainer::resume(&registry(), Arc::new(film.clone()), &start, None, IMAGE_BYTES)?;
        Self::train(trainer, config, "under the other light", log)
    }

    /// Scores on the test views of `film`, over black, with some settings changed (`KEY=VALUE`).
    ///
    /// # Errors
    /// Those of [`Self::on`] and [`evaluate`].
    pub(super) fn scores(&self, film: &Dataset, changes: &[&str]) -> Result<EvalReport, LabError> {
        let dut = self.model(film, changes)?;
        let images = ImageCache::new(IMAGE_BYTES, 1.0).with_max_image_mib(film.max_image_mib);
        Ok(evaluate(&dut, film, Split::Test, [0.0; 3], &images)?)
    }
}

/// The surface of a frame as GeoNet deforms it, world units; the posed template without GeoNet.
///
/// # Errors
/// If the frame cannot be made.
pub(super) fn deformed(dut: &Dut, frame: &AvatarFrame) -> Result<Vec<Vec3>, LabError> {
    let first = dut.first(frame)?;
    let offsets = dut.offsets(&first)?.unwrap_or_else(|| vec![Vec3::ZERO; first.posed.canonical.len()]);
    Ok(dut.actor().surface(&first.posed, &offsets))
}

/// Heading and digits of the score columns.
pub(super) const SCORES: [(&str, usize); 4] = [("PSNR", 2), ("in-mask PSNR", 2), ("SSIM", 4), ("proxy", 4)];

/// Mean scores for the columns [`SCORES`]; all `None` without a report.
pub(super) fn scores(report: Option<&EvalReport>) -> [Option<f64>; 4] {
    let mean = report.map(|r| r.mean);
    [
        mean.and_then(|m| m.psnr),
        mean.and_then(|m| m.masked).and_then(|m| m.psnr),
        mean.and_then(|m| m.ssim),
        mean.and_then(|m| m.perceptual_proxy),
    ]
}

/// Scores for the columns [`SCORES`], over the views at one time.
pub(super) fn scores_at(report: Option<&EvalReport>, time: f32) -> [Option<f64>; 4] {
    let of = |value: fn(&ViewScores) -> Option<f64>| {
        let views = report.iter().flat_map(|r| &r.views).filter(|v| v.time == time);
        Mean::of(views.filter_map(value)).value
    };
    [of(|v| v.psnr), of(|v| v.masked.and_then(|m| m.psnr)), of(|v| Some(v.ssim)), of(|v| Some(v.perceptual_proxy))]
}
