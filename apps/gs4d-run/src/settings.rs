//! The settings of a run: `[run]` and `[data]` for all methods, then those of the method.
//!
//! Resolution: defaults ← preset ← file ← `--steps` ← `--set`. Lengths in steps (learning-rate decays, the times of density
//! control and SH degrees: [`Scaling::Length`]) are shares of the run: where the run gets another length than the preset or file
//! that states them, they are scaled with it, so a short run goes through all phases of a long one. `--steps N` scales the stages;
//! what `--set` says is taken as it stands. A finished run is lengthened instead ([`lengthen()`]).

mod lengthen;
#[cfg(test)]
mod tests;

pub use lengthen::lengthen;

use super::RunError;
use crate::config::{Config, ConfigError, Source};
use gs_core::io::{Limits, read_text};
use gs_data::{DataError, DataOptions, Dataset, ImageCache};
use gs_train::domains::{self, Domain, STEPS, Scaling, within};
use gs_train::registry::Registry;
use gs_train::schedule::rate_fields;
use gs_train::timeline::Timeline;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use toml::{Table, Value};

const RUN_DEFAULTS: &str = include_str!("defaults.toml");
/// What the options of the data are; the values are examples of those that have no default.
const DATA_ABOUT: &str = include_str!("data.toml");

/// How the keys of stages begin.
const STAGES: &str = "schedule.stages.";

/// Domains of the settings of `[run]` and `[data]`.
const DOMAINS: &[Domain] = &[
    within("run.seed", 0.0, i64::MAX as f64),
    within("run.log_every", 1.0, STEPS),
    within("run.checkpoint_every", 1.0, STEPS),
    within("run.histogram_every", 0.0, STEPS),
    within("run.eval_every", 0.0, STEPS),
    within("run.eval_views", 0.0, 1e6),
    within("run.time_budget", 0.0, 1e9),
    within("run.image_mib", 0.0, 1_048_576.0),
    within("data.hold_out", 0.0, 1e6),
    within("data.first_frame", 0.0, 1e9),
    within("data.frame_count", 0.0, 1e9),
    within("data.frame_step", 1.0, 1e9),
    within("data.cameras", 0.0, 1e9),
    within("data.test_cameras", 0.0, 1e9),
    within("data.scale", 1e-6, 1.0),
    within("data.fps", 1e-6, 1e9),
    within("data.max_image_mib", 1.0, 1_048_576.0),
];

/// Section `[run]`: what is trained, and what is written when.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunSettings {
    /// Name of the method, one of the registry.
    pub method: String,
    /// Name of a preset of the method.
    pub preset: String,
    /// Folder of the data set.
    pub data: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Steps between lines of the log.
    pub log_every: u32,
    /// Steps between two checkpoints.
    pub checkpoint_every: u32,
    /// Steps between histograms of the splats' quantities; 0: none.
    pub histogram_every: u32,
    /// Steps between evaluations while training; 0: none.
    pub eval_every: u32,
    /// At most so many views in such an evaluation.
    pub eval_views: u32,
    /// Seconds of training after which the run stops with a checkpoint; 0: no limit.
    pub time_budget: f64,
    /// Decoded images kept in memory, at most, MiB.
    pub image_mib: u32,
}

impl RunSettings {
    /// Bytes of decoded images kept in memory, at most.
    pub fn image_bytes(&self) -> usize {
        (self.image_mib as usize) << 20
    }
}

/// A request for settings, as given on the command line.
#[derive(Clone, Debug, Default)]
pub struct Request {
    /// Name of the method, one of the registry.
    pub method: String,
    /// Name of a preset of the method.
    pub preset: String,
    /// Folder of the data; `None` to resolve settings only.
    pub data: Option<PathBuf>,
    /// A TOML file of settings.
    pub file: Option<PathBuf>,
    /// Total number of steps; stretches the whole recipe.
    pub steps: Option<u32>,
    /// Seconds of training after which the run stops.
    pub time_budget: Option<f64>,
    /// Seed of all random numbers.
    pub seed: Option<u64>,
    /// Assignments `key=value` that win over presets and defaults.
    pub sets: Vec<String>,
}

/// Complete and validated settings of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Resolved {
    /// The available methods; `run.method` is one of them.
    pub registry: Registry,
    /// Every value with its source.
    pub config: Config,
    /// Section `[run]`, with every default filled in.
    pub run: RunSettings,
    /// Section `[data]`: options of the reader.
    pub data: DataOptions,
    /// All other sections, those of the method.
    pub method: Table,
}

/// All settings of a method with their defaults, before any preset.
///
/// # Errors
/// If there is no such method.
pub fn defaults(registry: &Registry, method: &str) -> Result<Config, RunError> {
    let entry = registry.find(method)?;
    let data = toml::to_string(&DataOptions::default()).map_err(|e| ConfigError::Invalid(e.to_string()))?;
    let own = format!("{RUN_DEFAULTS}\n[data]\n{data}");
    let mut table = entry.published()?;
    table.extend(own.parse::<Table>().map_err(|e| ConfigError::Invalid(e.to_string()))?);
    let mut config = Config::of_table(&table);
    entry.defaults.iter().chain([&own.as_str()]).for_each(|layer| config.describe(layer));
    let about: Table = DATA_ABOUT.parse().map_err(|e: toml::de::Error| ConfigError::Invalid(e.to_string()))?;
    for (key, example) in about.get("data").and_then(Value::as_table).into_iter().flatten() {
        config.allow(&format!("data.{key}"), example.clone());
    }
    config.describe(DATA_ABOUT);
    for (key, neutral) in rate_fields(&table).map_err(|e| ConfigError::Invalid(e.to_string()))? {
        config.allow(&key, neutral);
    }
    config.put("run.method", method, Source::Default)?;
    Ok(config)
}

/// The settings of a method with a preset.
///
/// # Errors
/// If there is no such method or preset.
pub fn with_preset(registry: &Registry, method: &str, preset: &str) -> Result<Config, RunError> {
    let entry = registry.find(method)?;
    let mut config = defaults(registry, method)?;
    config.overlay(&entry.preset(preset)?, &Source::Preset(preset.to_owned()))?;
    config.put("run.preset", preset, Source::Default)?;
    Ok(config)
}

/// Resolves the settings of a request.
///
/// # Errors
/// Unknown method, preset or setting; a value of the wrong kind or outside its domain; an unreadable file.
pub fn resolve(registry: &Registry, request: &Request) -> Result<Resolved, RunError> {
    let mut config = with_preset(registry, &request.method, &request.preset)?;
    let recipe = longest_clock(&config);
    if let Some(path) = &request.file {
        let text = read_text(path, &Limits::default())?;
        config.overlay_toml(&text, &Source::File(path.display().to_string()))?;
    }
    let filed = longest_clock(&config);
    let flag = |text: String| Source::Flag(text);
    config.put("run.method", request.method.as_str(), flag(format!("-m {}", request.method)))?;
    config.put("run.preset", request.preset.as_str(), flag(format!("--preset {}", request.preset)))?;
    if let Some(data) = &request.data {
        let full = std::fs::canonicalize(data).unwrap_or_else(|_| data.clone());
        config.put("run.data", full.display().to_string(), flag("DATA".into()))?;
    }
    if let Some(seed) = request.seed {
        let seed = i64::try_from(seed).map_err(|_| ConfigError::Invalid("the seed must be below 2^63".into()))?;
        config.put("run.seed", seed, flag(format!("--seed {seed}")))?;
    }
    if let Some(seconds) = request.time_budget {
        config.put("run.time_budget", seconds, flag(format!("--time-budget {seconds}s")))?;
    }
    if let Some(steps) = request.steps {
        stretch(&mut config, steps)?;
    }
    for assignment in &request.sets {
        const FLAGS: [(&str, &str); 3] =
            [("run.method", "-m"), ("run.preset", "--preset"), ("run.data", "the folder DATA")];
        if let Some((key, flag)) = FLAGS.iter().find(|(key, _)| assigns(assignment, key)) {
            return Err(ConfigError::Invalid(format!("{key} is set by {flag}, not by --set")).into());
        }
        config.set(assignment)?;
    }
    scale_settings(&mut config, registry.find(&request.method)?.domains, recipe, filed)?;
    Resolved::of(registry, config)
}

/// Whether `KEY=VALUE` sets this key.
pub fn assigns(assignment: &str, key: &str) -> bool {
    assignment.split('=').next().is_some_and(|name| name.trim() == key)
}

impl Resolved {
    /// Checks a complete configuration.
    ///
    /// # Errors
    /// If a value lies outside its domain.
    pub fn of(registry: &Registry, config: Config) -> Result<Self, RunError> {
        let mut table = config.table();
        let entry = registry.find(config.get("run.method").and_then(|s| s.value.as_str()).unwrap_or_default())?;
        domains::check(entry.name, &table, &[entry.domains, DOMAINS].concat())?;
        let mut section = |name: &str| match table.remove(name) {
            Some(Value::Table(t)) => t,
            _ => Table::new(),
        };
        let (run, data) = (section("run"), section("data"));
        let wrong = |e: toml::de::Error| ConfigError::Invalid(e.to_string().trim().to_owned());
        let run: RunSettings = run.try_into().map_err(wrong)?;
        let data: DataOptions = data.try_into().map_err(wrong)?;
        Ok(Self { registry: registry.clone(), config, run, data, method: table })
    }

    /// Reads the settings of a run folder. The source of every value is the file.
    ///
    /// # Errors
    /// If the text is not a resolved configuration of a method there is.
    pub fn read(registry: &Registry, text: &str, name: &str) -> Result<Self, RunError> {
        let source = Source::File(name.to_owned());
        let syntax = |why: String| ConfigError::Syntax { origin: source.clone(), why };
        let table: Table = text.parse().map_err(|e: toml::de::Error| syntax(e.to_string().trim().to_owned()))?;
        let method = table.get("run").and_then(|r| r.get("method")).and_then(Value::as_str);
        let method = method.ok_or_else(|| syntax("run.method is missing".into()))?;
        let mut config = defaults(registry, method)?;
        config.overlay(&table, &source)?;
        Self::of(registry, config)
    }

    /// The settings as TOML, each with its source, below the time-line of the run.
    ///
    /// # Errors
    /// If the schedule cannot be read.
    pub fn to_toml(&self) -> Result<String, RunError> {
        let timeline = Timeline::of(self.registry.find(&self.run.method)?, &self.method)?;
        let timeline: String = timeline.to_string().lines().map(|line| format!("# {line}\n")).collect();
        Ok(format!("# {} steps\n{timeline}\n{}", self.steps(), self.config.to_commented_toml()))
    }

    /// Whether training with the other settings gives the same run.
    pub fn trains_as(&self, other: &Self) -> bool {
        let run = RunSettings { image_mib: other.run.image_mib, ..self.run.clone() };
        self.method == other.method && run == other.run && self.data == other.data
    }

    /// The data set of these settings.
    ///
    /// # Errors
    /// Those of its reader; also if the settings name no folder.
    pub fn open_data(&self) -> Result<Dataset, RunError> {
        if self.run.data.is_empty() {
            return Err(ConfigError::Invalid("run.data names no folder".into()).into());
        }
        Ok(Dataset::open(Path::new(&self.run.data), &self.data)?)
    }

    /// The same settings with the data at another place.
    ///
    /// # Errors
    /// As [`Self::of`].
    pub fn with_data(&self, data: &Path) -> Result<Self, RunError> {
        let full = std::fs::canonicalize(data).unwrap_or_else(|_| data.to_owned());
        let mut config = self.config.clone();
        config.put("run.data", full.display().to_string(), Source::Flag("--data".into()))?;
        Self::of(&self.registry, config)
    }

    /// The same settings with another bound of the decoded images that are kept, MiB.
    ///
    /// # Errors
    /// As [`Self::of`].
    pub fn with_image_cache(&self, mib: u32) -> Result<Self, RunError> {
        let mut config = self.config.clone();
        config.put("run.image_mib", i64::from(mib), Source::Flag(format!("--image-cache {mib}")))?;
        Self::of(&self.registry, config)
    }

    /// The data set of a run that was made before. Options without effect on its data, which a new run may not have, are passed over.
    ///
    /// # Errors
    /// [`RunError::DataGone`] if there is no such folder; those of its reader.
    pub fn reopen_data(&self) -> Result<Dataset, RunError> {
        let path = Path::new(&self.run.data);
        if !path.is_dir() {
            return Err(RunError::DataGone { path: path.to_owned() });
        }
        let mut options = self.data.clone();
        loop {
            match Dataset::open(path, &options) {
                Err(DataError::Idle { name: "data.fps", .. }) if options.fps.is_some() => options.fps = None,
                Err(DataError::Idle { name: "data.images", .. }) if options.images.is_some() => options.images = None,
                dataset => return Ok(dataset?),
            }
        }
    }

    /// An image cache for the data set, at full size.
    pub fn images(&self) -> ImageCache {
        ImageCache::new(self.run.image_bytes(), 1.0).with_max_image_mib(self.data.max_image_mib)
    }

    /// The same settings with as many initial points as `scene.toml` of the data names, at most `schedule.density.max_splats`, unless
    /// `init.points` was asked for.
    ///
    /// # Errors
    /// As [`Self::of`]; those of reading the file.
    pub fn with_start_points(self, dataset: &Dataset) -> Result<Self, RunError> {
        const KEY: &str = "init.points";
        let given = self.config.get(KEY).is_none_or(|s| !matches!(s.source, Source::Default | Source::Preset(_)));
        match &dataset.points {
            Some(points) if !given && gs_data::has_start_points(&dataset.root)? => {
                let most = self.config.get("schedule.density.max_splats").and_then(|s| s.value.as_integer());
                let count = i64::try_from(points.positions.len()).unwrap_or(i64::MAX).min(most.unwrap_or(i64::MAX));
                let mut config = self.config.clone();
                config.put(KEY, count, Source::File("scene.toml of the data".into()))?;
                Self::of(&self.registry, config)
            }
            _ => Ok(self),
        }
    }

    /// Whether the method can learn from a data set.
    ///
    /// # Errors
    /// If it needs the template of a filmed person and there is none; [`RunError::Static`] if nothing can move and it learns motion.
    pub fn fits(&self, dataset: &Dataset) -> Result<(), RunError> {
        self.registry.find(&self.run.method)?.avatar(dataset)?;
        let still = !dataset.dynamic && dataset.avatar.is_none();
        if still && self.learns_motion() {
            return Err(RunError::Static { path: dataset.root.clone(), method: self.run.method.clone() });
        }
        Ok(())
    }

    /// Whether some stage of the schedule learns motion.
    pub fn learns_motion(&self) -> bool {
        let stages = self.method.get("schedule").and_then(|s| s.get("stages")).and_then(toml::Value::as_table);
        let moves = |stage: &toml::Value| {
            let steps = stage.get("steps").and_then(toml::Value::as_integer).unwrap_or(0);
            steps > 0 && stage.get("dynamic").and_then(toml::Value::as_bool) == Some(true)
        };
        stages.is_some_and(|s| s.values().any(moves))
    }

    /// Steps of the whole recipe.
    pub fn steps(&self) -> u64 {
        total(&self.config)
    }
}

/// A stage: the key of its steps, their number, and whether its clock is its own.
struct StageSteps {
    key: String,
    steps: u64,
    own_clock: bool,
}

/// The stages, in the order they are followed.
fn stages(config: &Config) -> Vec<StageSteps> {
    let number = |key: &str| config.get(key).and_then(|s| s.value.as_integer()).and_then(|v| u64::try_from(v).ok());
    let is = |key: &str| config.get(key).is_some_and(|s| s.value.as_bool() == Some(true));
    let mut stages: Vec<(u64, StageSteps)> = config
        .iter()
        .filter_map(|(key, _)| {
            let name = key.strip_prefix(STAGES)?.strip_suffix(".steps")?;
            let order = number(&format!("{STAGES}{name}.order")).unwrap_or(0);
            let (steps, own_clock) = (number(key).unwrap_or(0), is(&format!("{STAGES}{name}.own_clock")));
            Some((order, StageSteps { key: key.to_owned(), steps, own_clock }))
        })
        .collect();
    stages.sort_by(|a, b| (a.0, &a.1.key).cmp(&(b.0, &b.1.key)));
    stages.into_iter().map(|(_, stage)| stage).collect()
}

/// Steps of all stages.
fn total(config: &Config) -> u64 {
    stages(config).iter().map(|s| s.steps).sum()
}

/// Steps of the longest clock: of consecutive stages of which the first alone may have a clock of its own.
fn longest_clock(config: &Config) -> u64 {
    let (mut longest, mut clock) = (0, 0);
    for stage in stages(config) {
        clock = if stage.own_clock { stage.steps } else { clock + stage.steps };
        longest = longest.max(clock);
    }
    longest
}

/// A number of steps of a run of `before` steps, in one of `after`.
fn scaled(steps: u64, before: u64, after: u64) -> i64 {
    let steps = (u128::from(steps) * u128::from(after)).div_ceil(u128::from(before));
    i64::try_from(steps).unwrap_or(i64::MAX)
}

/// Scales the stages so that the run has `total` steps.
fn stretch(config: &mut Config, total: u32) -> Result<(), RunError> {
    let source = Source::Flag(format!("--steps {total}"));
    let stages = stages(config);
    let before: u64 = stages.iter().map(|s| s.steps).sum();
    if total == 0 || before == 0 {
        return Err(RunError::Steps("--steps must be at least 1, and the recipe must have steps".into()));
    }
    // Borders of stages are rounded, so that the stages add up exactly.
    let (mut border, mut done) = (0u64, 0i64);
    for StageSteps { key, steps, .. } in &stages {
        border += steps;
        let end = scaled(border, before, total.into());
        config.put(key, end - done, source.clone())?;
        done = end;
    }
    Ok(())
}

/// Scales what the preset says for a clock of `recipe` steps, and a file for one of `filed`, to the length the clock has now.
fn scale_settings(config: &mut Config, domains: &[Domain], recipe: u64, filed: u64) -> Result<(), RunError> {
    let after = longest_clock(config);
    let changed: Vec<(String, Value, Source)> = config
        .iter()
        .filter_map(|(key, s)| {
            let before = match &s.source {
                Source::Default | Source::Preset(_) => recipe,
                Source::File(_) => filed,
                Source::Flag(_) | Source::Scaled(_) => after,
            };
            let said = Source::Scaled(format!("{}: {} of {before} steps", s.source, s.value));
            let scales = before != after && before > 0 && after > 0;
            let value = if scales { rescaled(scaling(key, domains), &s.value, before, after) } else { None };
            value.map(|value| (key.to_owned(), value, said))
        })
        .collect();
    changed.into_iter().try_for_each(|(key, value, said)| Ok(config.put(&key, value, said)?))
}

/// A setting of a clock of `before` steps, in one of `after`; `None` where it does not change.
fn rescaled(scaling: Scaling, value: &Value, before: u64, after: u64) -> Option<Value> {
    match scaling {
        Scaling::Fixed => None,
        Scaling::Length(least) => {
            let value = u64::try_from(value.as_integer()?).ok()?;
            let least = i64::try_from(value.min(least.into())).unwrap_or(0);
            Some(scaled(value, before, after).max(least).into())
        }
        Scaling::Rate(most) => {
            let value = value.as_float()?;
            Some((value * before as f64 / after as f64).min(most.max(value)).into())
        }
    }
}

/// How a setting follows the length of the run. Stages are the run.
fn scaling(key: &str, own: &[Domain]) -> Scaling {
    domains::domain(key, own).filter(|_| !key.starts_with(STAGES)).map_or(Scaling::Fixed, |d| d.scaling)
}
