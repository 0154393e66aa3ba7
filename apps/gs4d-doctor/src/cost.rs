//! Estimates the time and memory of a training run from a few steps of each stage, at two numbers of splats.
//!
//! A step of a stage takes `a + b N` for `N` splats. Growth is assumed to be linear, from the initial points to the limit of the
//! settings, over the steps at which density control runs; a scene that needs fewer splats takes less. Memory is the sum of
//! ```text
//! 16 B per parameter (value, gradient, two moments) + 3000 B per splat (projected, tile lists, tapes, cotangents)
//! + 130 B per pixel (frame, cotangents, loss) + 24 MiB (the program)
//! + 13 B per pixel and image of the report, of which most are reduced
//! + decoded training images at the scale of each stage, and test images, as far as the cache keeps them
//! ```
//! The constants are fitted to measured peaks of `fourdgs`, `grid4d` and `modec`.

use super::{Finding, Verdict, median};
use glam::Vec3;
use gs_core::Rng;
use gs_data::{Dataset, View};
use gs_train::densify::GrowthLimits;
use gs_train::registry::Registry;
use gs_train::scene::SceneInfo;
use gs_train::schedule::Schedule;
use gs_train::trainer::{TrainOptions, Trainer};
use gs4d_report::IMAGE_SIDE;
use gs4d_run::RunError;
use gs4d_run::memory;
use gs4d_run::settings::{Request, Resolved, RunSettings, resolve};
use gs4d_run::summary::images_held;
use serde::Serialize;
use std::sync::Arc;
use toml::{Table, Value};

/// Warm-up steps, and timed steps.
const WARM_UP: u32 = 3;
const TIMED: u32 = 10;
/// Largest factor on the initial points for the second measurement.
const MAX_POINT_FACTOR: usize = 8;
/// Standard deviation of the points added for it around the original ones, as a share of the scene's diagonal.
const JITTER: f32 = 0.005;
/// The settings of the most splats, or anchors, of a method.
const MOST_SETTINGS: [&str; 2] = ["schedule.density.max_splats", "adapt.max_anchors"];
/// The constants of the memory estimate.
const BYTES_PER_VALUE: f64 = 16.0;
const BYTES_PER_SPLAT: f64 = 3000.0;
const BYTES_PER_PIXEL: f64 = 130.0;
/// An image of the report: RGB in `f32`, and its share of the page as PNG.
const BYTES_PER_HELD_PIXEL: f64 = 13.0;
const PROGRAM_BYTES: f64 = 24.0 * MIB;
const MIB: f64 = 1024.0 * 1024.0;

/// The run whose cost is estimated.
#[derive(Clone, Debug)]
pub struct CostOptions {
    /// Registry that the method is looked up in.
    pub registry: Registry,
    /// Name of the method, as for `gs4d train -m`.
    pub method: String,
    /// Name of the preset, as for `--preset`.
    pub preset: String,
    /// Assignments `key=value`, as for `--set`.
    pub sets: Vec<String>,
    /// Memory limit, MiB; `None`: what is available on this machine.
    pub limit_mib: Option<f64>,
}

/// The cost of one stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageCost {
    /// Name of the stage in the schedule.
    pub name: String,
    /// Optimizer steps of the stage.
    pub steps: u32,
    /// Milliseconds of a step with the initial points, and with the most splats the settings allow.
    pub ms: [f64; 2],
}

/// The estimated cost of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Cost {
    /// For example `fourdgs --preset fast`.
    pub run: String,
    /// Number of threads of the measurement.
    pub threads: usize,
    /// Costs of the stages, in the order of the schedule.
    pub stages: Vec<StageCost>,
    /// Number of splats at the start, and the most the settings allow.
    pub splats: [usize; 2],
    /// Seconds without growth, and with growth to the most splats.
    pub seconds: [f64; 2],
    /// Peak MiB with the initial splats, and with the most.
    pub memory_mib: [f64; 2],
    /// MiB of decoded images that the cache keeps.
    pub images_mib: f64,
    /// The setting of the most splats, if the method has one.
    #[serde(skip)]
    most_setting: Option<&'static str>,
}

/// Estimates the cost; a run that cannot start is a problem, or a warning where only the method is the wrong one for data in which
/// nothing moves.
pub(super) fn check(data: &Dataset, options: &CostOptions) -> (Vec<Finding>, Option<Cost>) {
    if let Some(warning) = still(data, options) {
        return (vec![warning], None);
    }
    match measure(data, options) {
        Ok(cost) => (findings(&cost, options), Some(cost)),
        Err(why) => {
            let what = format!("a run of {} with preset {} cannot begin: {why}", options.method, options.preset);
            (vec![Finding::new("duration", "cost.begin", Verdict::Problem, what)], None)
        }
    }
}

/// The warning that nothing moves in the data of a method that learns motion.
fn still(data: &Dataset, options: &CostOptions) -> Option<Finding> {
    match resolved(data, options).ok()?.fits(data) {
        Err(e @ RunError::Static { .. }) => {
            let fix = "give -m static3d, or, if names tell times, --set data.time_from=name";
            Some(Finding::new("duration", "cost.begin", Verdict::Warning, e.to_string()).fix(fix))
        }
        _ => None,
    }
}

/// The settings of the run that is priced.
fn resolved(data: &Dataset, options: &CostOptions) -> Result<Resolved, RunError> {
    let request = Request {
        method: options.method.clone(),
        preset: options.preset.clone(),
        data: Some(data.root.clone()),
        sets: options.sets.clone(),
        ..Request::default()
    };
    resolve(&options.registry, &request)?.with_start_points(data)
}

/// Whether a table has a value under a key with dots.
fn has_setting(table: &toml::Table, key: &str) -> bool {
    let mut parts = key.split('.');
    let first = parts.next().and_then(|part| table.get(part));
    parts.fold(first, |value, part| value?.get(part)).is_some()
}

fn findings(cost: &Cost, options: &CostOptions) -> Vec<Finding> {
    let [few, most] = cost.splats;
    let [least, whole] = cost.memory_mib;
    let text = format!("about {whole:.0} MiB with {most} splats ({:.0} MiB of images)", cost.images_mib);
    let memory = match options.limit_mib.or_else(|| memory::free().map(|bytes| bytes as f64 / MIB)) {
        Some(limit) if whole > limit => {
            let verdict = if least > limit { Verdict::Problem } else { Verdict::Warning };
            let what = format!("{text}, {least:.0} with {few}; there are {limit:.0} MiB");
            let fewer = cost.most_setting.map_or(String::new(), |key| format!(", or fewer splats: --set {key}=N"));
            let fix = format!("--set data.scale=0.5, or --image-cache 256{fewer}");
            Finding::new("memory", "memory.limit", verdict, what).fix(fix)
        }
        Some(limit) => Finding::ok("memory", format!("{text} of {limit:.0}")),
        None => Finding::ok("memory", text),
    };
    let [least, whole] = cost.seconds.map(duration);
    let steps: u32 = cost.stages.iter().map(|s| s.steps).sum();
    let first = cost.stages.first().map_or(0.0, |s| s.ms[0]);
    let text = format!(
        "{}: {steps} steps on {} threads take about {whole} if the scene grows to {most} splats, {least} if it stays at {few}; a first step {first:.1} ms",
        cost.run, cost.threads
    );
    vec![memory, Finding::ok("duration", text)]
}

fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 100.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

fn measure(data: &Dataset, options: &CostOptions) -> Result<Cost, String> {
    let resolved = resolved(data, options).map_err(|e| e.to_string())?;
    resolved.fits(data).map_err(|e| e.to_string())?;
    let data = Arc::new(data.clone());
    let (begun, whole) = Trial::new(data.clone(), &resolved, 1)?;
    let (schedule, growth) = (whole.model().schedule().clone(), whole.model().capabilities().growth);
    let few = Size::of(&whole);
    let [compared, reduced] = images_held(whole.model(), &data).map_err(|e| e.to_string())?;
    let growth = growth.filter(|g| g.most > few.splats);
    let most = growth.map_or(few.splats, |g| g.most);
    drop(whole);
    let times = (most / few.splats.max(1)).clamp(2, MAX_POINT_FACTOR);
    let grown = match growth {
        Some(_) => Some(Trial::new(Arc::new(denser(&data, times)), &resolved, times)?.0),
        None => None,
    };
    let mut stages = Vec::new();
    let mut values = few.values as f64;
    for (name, stage) in schedule.ordered() {
        let (first, _) = begun.step_ms(name)?;
        let mut ms = [first; 2];
        if let Some(grown) = &grown {
            let (other, many) = grown.step_ms(name)?;
            if many.splats > few.splats {
                let more = (most - few.splats) as f64 / (many.splats - few.splats) as f64;
                ms[1] = first + more * (other - first).max(0.0);
                values = few.values as f64 + more * (many.values - few.values) as f64;
            }
        }
        stages.push(StageCost { name: name.to_owned(), steps: stage.steps, ms });
    }
    let (images, largest) = decoded(&data, &schedule);
    let kept = images.map(|i| i.min(f64::from(resolved.run.image_mib) * MIB)).iter().sum::<f64>();
    let held = compared as f64 * largest + reduced as f64 * largest.min((IMAGE_SIDE * IMAGE_SIDE) as f64);
    let pixels = BYTES_PER_PIXEL * largest + BYTES_PER_HELD_PIXEL * held;
    let memory = |values: f64, splats: usize| {
        (BYTES_PER_VALUE * values + BYTES_PER_SPLAT * splats as f64 + pixels + kept + PROGRAM_BYTES) / MIB
    };
    Ok(Cost {
        run: format!("{} --preset {}", options.method, options.preset),
        threads: rayon::current_num_threads(),
        splats: [few.splats, most],
        seconds: [0.0, 1.0].map(|share| seconds(&stages, &schedule, growth, share)),
        stages,
        memory_mib: [memory(few.values as f64, few.splats), memory(values, most)],
        images_mib: kept / MIB,
        most_setting: MOST_SETTINGS.into_iter().find(|key| has_setting(&resolved.method, key)),
    })
}

/// The size of a model.
#[derive(Clone, Copy)]
struct Size {
    splats: usize,
    /// Number of parameters.
    values: usize,
}

impl Size {
    fn of(trainer: &Trainer) -> Self {
        let mut values = 0;
        trainer.model().visit(&mut |p| values += p.value.len());
        Self { splats: trainer.model().splat_count(), values }
    }
}

/// Runs of single stages that begin with the same points: those of a visual hull take long to make.
struct Trial<'a> {
    data: Arc<Dataset>,
    resolved: &'a Resolved,
    /// Settings of the method.
    method: Table,
    scene: SceneInfo,
}

impl<'a> Trial<'a> {
    /// With the initial points of the settings multiplied by `times`; also the run of all stages.
    fn new(data: Arc<Dataset>, resolved: &'a Resolved, times: usize) -> Result<(Self, Trainer), String> {
        let (run, method) = (&resolved.run, with_points(&resolved.method, times));
        let whole = Trainer::new(&resolved.registry, data.clone(), &run.method, &method, train_options(run));
        let whole = whole.map_err(|e| e.to_string())?;
        Ok((Self { data, resolved, method, scene: whole.scene().clone() }, whole))
    }

    /// The run of one stage.
    fn trainer(&self, stage: &str) -> Result<Trainer, String> {
        let Self { data, resolved, method, scene } = self;
        let entry = resolved.registry.find(&resolved.run.method).map_err(|e| e.to_string())?;
        let model = entry.model(&only(method, stage), scene).map_err(|e| e.to_string())?;
        let options = train_options(&resolved.run);
        Trainer::with_method(model, data.clone(), scene.clone(), options).map_err(|e| e.to_string())
    }

    /// Median milliseconds of a step of a stage, and the model's size. Image decoding is subtracted where the cache keeps all images.
    fn step_ms(&self, stage: &str) -> Result<(f64, Size), String> {
        let mut trainer = self.trainer(stage)?;
        let size = Size::of(&trainer);
        let [training, _] = decoded(&self.data, trainer.model().schedule()).0;
        let kept = training <= f64::from(self.resolved.run.image_mib) * MIB;
        let mut counted = Vec::new();
        let steps = (WARM_UP + TIMED).min(trainer.steps());
        for k in 0..steps {
            let ms = trainer.step().map_err(|e| e.to_string())?.ms;
            // Of a stage of few steps the last one counts.
            if k >= WARM_UP || k + 1 == steps {
                counted.push(if kept { ms.total - ms.data } else { ms.total });
            }
        }
        Ok((median(&counted), size))
    }
}

/// Bytes of decoded training images, at the scale of each stage, and of test images; pixels of the largest.
fn decoded(data: &Dataset, schedule: &Schedule) -> ([f64; 2], f64) {
    let pixels = |v: &View| f64::from(v.camera.width) * f64::from(v.camera.height);
    let mut scales: Vec<f64> = schedule.stages.values().filter(|s| s.steps > 0).map(|s| s.image_scale).collect();
    scales.sort_by(f64::total_cmp);
    scales.dedup();
    let share: f64 = scales.iter().map(|s| s * s).sum();
    let sum = |views: &[View]| 4.0 * views.iter().map(pixels).sum::<f64>();
    let largest = data.train.iter().map(pixels).fold(0.0, f64::max);
    ([share * sum(&data.train), sum(&data.test) + sum(&data.extrapolate)], largest)
}

/// Seconds of all stages if the model grows, linearly over the steps with density control, by this share of the possible
/// growth.
fn seconds(stages: &[StageCost], schedule: &Schedule, growth: Option<GrowthLimits>, share: f64) -> f64 {
    let clocks: Vec<_> = (1..=schedule.steps()).map(|step| schedule.position(step)).collect();
    let grows = |clock: u32| growth.is_some_and(|g| clock > g.from && clock < g.until);
    let all = clocks.iter().filter(|at| grows(at.clock)).count().max(1) as f64;
    let (mut grown, mut ms) = (0.0, 0.0);
    for at in clocks {
        grown += f64::from(u8::from(grows(at.clock)));
        let [few, many] = stages[at.stage].ms;
        ms += few + share * grown / all * (many - few);
    }
    1e-3 * ms
}

fn train_options(run: &RunSettings) -> TrainOptions {
    TrainOptions { seed: run.seed, image_bytes: run.image_bytes() }
}

/// The settings with one stage only.
fn only(method: &Table, stage: &str) -> Table {
    let mut table = method.clone();
    if let Some(Value::Table(stages)) = table.get_mut("schedule").and_then(|s| s.get_mut("stages")) {
        for (_, s) in stages.iter_mut().filter(|(name, _)| *name != stage) {
            if let Value::Table(s) = s {
                s.insert("steps".into(), Value::Integer(0));
            }
        }
    }
    table
}

/// The settings with the initial points multiplied by `times`.
fn with_points(method: &Table, times: usize) -> Table {
    let mut table = method.clone();
    // The limit on anchors holds for the initial ones, too.
    for (section, key) in [("init", "points"), ("adapt", "max_anchors")] {
        if let Some(Value::Integer(n)) = table.get_mut(section).and_then(|s| s.get_mut(key)) {
            *n *= times as i64;
        }
    }
    table
}

/// The data with `times` as many points, the new ones near the original ones.
fn denser(data: &Dataset, times: usize) -> Dataset {
    let mut more = data.clone();
    if let Some(points) = &mut more.points {
        let [low, high] = data.scene_bounds();
        let (near, mut rng) = (JITTER * low.distance(high), Rng::new(0, "denser points", 0, 0));
        let first = points.clone();
        for _ in 1..times {
            let beside = |p: &Vec3| *p + near * Vec3::from_array(std::array::from_fn(|_| rng.normal()));
            points.positions.extend(first.positions.iter().map(beside));
            points.colors.extend_from_slice(&first.colors);
        }
    }
    more
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_synth::SynthOptions;

    #[test]
    fn a_hull_is_carved_once_for_all_stages() {
        let dir = tempfile::tempdir().expect("folder");
        let root = dir.path().join("data");
        gs_synth::write(&root, "balls", &SynthOptions::of_views(32, 24, 2), false).expect("scene");
        let data = Dataset::open(&root, &Default::default()).expect("data");
        assert!(data.points.is_none() && data.has_alpha);
        let registry = gs_methods::registry().clone();
        let (method, preset, sets) = ("fourdgs".into(), "tiny".into(), Vec::new());
        let options = CostOptions { registry, method, preset, sets, limit_mib: None };
        let resolved = resolved(&data, &options).expect("settings");
        let (trial, whole) = Trial::new(Arc::new(data), &resolved, 1).expect("a run");
        // Carving would read the images.
        std::fs::remove_dir_all(root.join("train")).expect("removed");
        let of_stage = trial.trainer("coarse").expect("a run of one stage");
        assert_eq!(
            (of_stage.scene(), of_stage.steps()),
            (whole.scene(), whole.model().schedule().stages["coarse"].steps)
        );
    }
}
