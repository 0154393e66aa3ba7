//! What a training run would take: a few steps of each stage are made, at two numbers of splats.
//!
//! A step of a stage takes `a + b N` for `N` splats. Growth is taken to be even, from the first points to the most the settings
//! allow, over the steps at which it may happen; so a scene that needs fewer splats takes less than this. Memory is counted:
//! ```text
//! 16 B per parameter (value, gradient, two moments) + 3000 B per splat (projected, tile lists, tapes, cotangents)
//! + 130 B per pixel (frame, cotangents, loss) + 24 MiB (the program)
//! + decoded images of training at every scale that stages ask for, and of tests, as far as the cache keeps them
//! ```
//! The constants are fitted to measured peaks of `fourdgs`, `grid4d` and `modec`.

use super::{Finding, Verdict, median};
use glam::Vec3;
use gs_core::{Params, Rng};
use gs_data::{Dataset, View};
use gs_train::capabilities::GrowthLimits;
use gs_train::registry::Registry;
use gs_train::schedule::Schedule;
use gs_train::trainer::{TrainOptions, Trainer};
use gs4d_run::settings::{Request, Resolved, resolve};
use serde::Serialize;
use std::sync::Arc;
use toml::{Table, Value};

/// Steps made before times count, and those that count.
const WARM_UP: u32 = 3;
const COUNTED: u32 = 10;
/// The first points are multiplied by at most this, to see what more of them cost.
const MORE: usize = 8;
/// Points that are added for it lie this far from the scene's own, as a part of its diagonal.
const NEAR: f32 = 0.005;
/// Bytes per parameter, splat, pixel, and of the program itself.
const PER_VALUE: f64 = 16.0;
const PER_SPLAT: f64 = 3000.0;
const PER_PIXEL: f64 = 130.0;
const PROGRAM: f64 = 24.0 * MIB;
const MIB: f64 = 1024.0 * 1024.0;

/// The run that is tried.
#[derive(Clone, Debug)]
pub struct CostOptions {
    /// The methods there are.
    pub registry: Registry,
    /// Name of the method.
    pub method: String,
    /// Name of the preset.
    pub preset: String,
    /// Settings, as for training.
    pub sets: Vec<String>,
    /// Memory the run may take, MiB; what the machine has, if absent.
    pub limit_mib: Option<f64>,
}

/// What a stage takes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageCost {
    /// Its name.
    pub name: String,
    /// Its steps.
    pub steps: u32,
    /// Milliseconds of a step with the first points, and with as many splats as settings allow.
    pub ms: [f64; 2],
}

/// What a run takes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Cost {
    /// Method and preset.
    pub run: String,
    /// Threads it was tried on.
    pub threads: usize,
    /// Stages in their order.
    pub stages: Vec<StageCost>,
    /// Splats at first, and at most.
    pub splats: [usize; 2],
    /// Seconds if the scene never grows, and if it grows to the most.
    pub seconds: [f64; 2],
    /// MiB with the first splats, and with the most.
    pub memory_mib: [f64; 2],
    /// MiB of decoded images, all of them.
    pub images_mib: f64,
}

/// Tries a run.
pub(super) fn look(data: &Dataset, options: &CostOptions) -> (Vec<Finding>, Option<Cost>) {
    match measure(data, options) {
        Ok(cost) => (findings(&cost, options), Some(cost)),
        Err(why) => {
            let what = format!("a run of {} with preset {} cannot begin: {why}", options.method, options.preset);
            (vec![Finding::new("duration", "cost.begin", Verdict::Problem, what)], None)
        }
    }
}

fn findings(cost: &Cost, options: &CostOptions) -> Vec<Finding> {
    let [few, most] = cost.splats;
    let [least, whole] = cost.memory_mib;
    let text = format!("about {whole:.0} MiB with {most} splats ({:.0} MiB of images)", cost.images_mib);
    let memory = match options.limit_mib.or_else(machine_mib) {
        Some(limit) if whole > limit => {
            let verdict = if least > limit { Verdict::Problem } else { Verdict::Warning };
            let what = format!("{text}, {least:.0} with {few}; there are {limit:.0} MiB");
            let fix = "--set data.scale=0.5, or --set run.image_mib=256, or fewer splats: --set schedule.density.max_splats=N";
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
    let request = Request {
        method: options.method.clone(),
        preset: options.preset.clone(),
        data: Some(data.root.clone()),
        sets: options.sets.clone(),
        ..Request::default()
    };
    let resolved = resolve(&options.registry, &request).map_err(|e| e.to_string())?;
    let trial = Trial { data: Arc::new(data.clone()), resolved: &resolved };
    let whole = trial.trainer(trial.data.clone(), &resolved.method)?;
    let (schedule, growth) = (whole.model().schedule().clone(), whole.model().capabilities().growth);
    let few = Size::of(&whole);
    drop(whole);
    let growth = growth.filter(|g| g.most > few.splats);
    let most = growth.map_or(few.splats, |g| g.most);
    let mut stages = Vec::new();
    let mut values = few.values as f64;
    for (name, stage) in schedule.ordered() {
        let (first, _) = trial.pace(name, None)?;
        let mut ms = [first; 2];
        if growth.is_some() {
            let (other, many) = trial.pace(name, Some((most / few.splats.max(1)).clamp(2, MORE)))?;
            if many.splats > few.splats {
                let more = (most - few.splats) as f64 / (many.splats - few.splats) as f64;
                ms[1] = first + more * (other - first).max(0.0);
                values = few.values as f64 + more * (many.values - few.values) as f64;
            }
        }
        stages.push(StageCost { name: name.to_owned(), steps: stage.steps, ms });
    }
    let (images, largest) = decoded(data, &schedule);
    let kept = images.map(|i| i.min(f64::from(resolved.run.image_mib) * MIB)).iter().sum::<f64>();
    let memory = |values: f64, splats: usize| {
        (PER_VALUE * values + PER_SPLAT * splats as f64 + PER_PIXEL * largest + kept + PROGRAM) / MIB
    };
    Ok(Cost {
        run: format!("{} --preset {}", options.method, options.preset),
        threads: rayon::current_num_threads(),
        splats: [few.splats, most],
        seconds: [0.0, 1.0].map(|share| seconds(&stages, &schedule, growth, share)),
        stages,
        memory_mib: [memory(few.values as f64, few.splats), memory(values, most)],
        images_mib: images.iter().sum::<f64>() / MIB,
    })
}

/// How large a scene is.
#[derive(Clone, Copy)]
struct Size {
    splats: usize,
    /// Numbers that are learnt.
    values: usize,
}

impl Size {
    fn of(trainer: &Trainer) -> Self {
        let mut values = 0;
        Params::visit(trainer.model(), &mut |p| values += p.value.len());
        Self { splats: trainer.model().splat_count(), values }
    }
}

/// What runs are begun with.
struct Trial<'a> {
    data: Arc<Dataset>,
    resolved: &'a Resolved,
}

impl Trial<'_> {
    fn trainer(&self, data: Arc<Dataset>, method: &Table) -> Result<Trainer, String> {
        let run = &self.resolved.run;
        let options = TrainOptions { seed: run.seed, image_bytes: (run.image_mib as usize) << 20 };
        Trainer::new(&self.resolved.registry, data, &run.method, method, options).map_err(|e| e.to_string())
    }

    /// The median time of some steps of a stage, ms, with so many times the first points, and the size that was tried.
    /// Decoding is left out where the cache keeps all images.
    fn pace(&self, stage: &str, times: Option<usize>) -> Result<(f64, Size), String> {
        let data = times.map_or_else(|| self.data.clone(), |times| Arc::new(denser(&self.data, times)));
        let mut trainer = self.trainer(data, &only(&self.resolved.method, stage, times))?;
        let size = Size::of(&trainer);
        let [training, _] = decoded(&self.data, trainer.model().schedule()).0;
        let kept = training <= f64::from(self.resolved.run.image_mib) * MIB;
        let mut counted = Vec::new();
        for k in 0..(WARM_UP + COUNTED).min(trainer.steps()) {
            let ms = trainer.step().map_err(|e| e.to_string())?.ms;
            if k >= WARM_UP {
                counted.push(if kept { ms.total - ms.data } else { ms.total });
            }
        }
        Ok((median(&counted), size))
    }
}

/// Bytes of decoded images of training, at every scale that stages ask for, and of tests; pixels of the largest.
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

/// Seconds of all stages, if so much of the growth happens that is possible: evenly, over the steps at which it may.
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

/// The settings with one stage alone, and with so many times the first points.
fn only(method: &Table, stage: &str, times: Option<usize>) -> Table {
    let mut table = method.clone();
    if let Some(Value::Table(stages)) = table.get_mut("schedule").and_then(|s| s.get_mut("stages")) {
        for (_, s) in stages.iter_mut().filter(|(name, _)| *name != stage) {
            if let Value::Table(s) = s {
                s.insert("steps".into(), Value::Integer(0));
            }
        }
    }
    // Anchors are refused beyond their bound from the start.
    for (section, key) in [("init", "points"), ("adapt", "max_anchors")] {
        if let (Some(times), Some(Value::Integer(n))) = (times, table.get_mut(section).and_then(|s| s.get_mut(key))) {
            *n *= times as i64;
        }
    }
    table
}

/// The data with so many times its points, near the first ones.
fn denser(data: &Dataset, times: usize) -> Dataset {
    let mut more = data.clone();
    if let Some(points) = &mut more.points {
        let [low, high] = data.scene_bounds();
        let (near, mut rng) = (NEAR * low.distance(high), Rng::new(0, "denser points", 0, 0));
        let first = points.clone();
        for _ in 1..times {
            let beside = |p: &Vec3| *p + near * Vec3::from_array(std::array::from_fn(|_| rng.normal()));
            points.positions.extend(first.positions.iter().map(beside));
            points.colors.extend_from_slice(&first.colors);
        }
    }
    more
}

/// Memory that is free on this machine, MiB.
fn machine_mib() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix("MemAvailable:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()? / 1024.0)
}
