//! What a training run would take: a few steps of each stage are made, at two numbers of splats.
//!
//! A step of a stage takes `a + b N` for `N` splats. Growth is taken to be even, from the first points to the most the settings
//! allow, between the steps that bound it; so a scene that needs fewer splats takes less than this. Memory is counted:
//! ```text
//! 16 B per parameter (value, gradient, two moments) + 3000 B per splat (projected, tile lists, tapes, cotangents)
//! + 130 B per pixel (frame, cotangents, loss) + 24 MiB (the program)
//! + decoded images of training at every scale that stages ask for, and of tests, as far as the cache keeps them
//! ```
//! The constants are fitted to measured peaks of `fourdgs`, `grid4d` and `modec`.

use super::{Finding, Verdict};
use crate::data::{Dataset, View};
use crate::run::settings::{Request, Resolved, resolve};
use crate::schedule::Schedule;
use crate::trainer::{TrainOptions, Trainer};
use gs_core::Params;
use serde::Serialize;
use std::sync::Arc;
use toml::{Table, Value};

/// Steps made before times count, and those that count.
const WARM_UP: u32 = 3;
const COUNTED: u32 = 10;
/// Bytes per parameter, splat, pixel, and of the program itself.
const PER_VALUE: f64 = 16.0;
const PER_SPLAT: f64 = 3000.0;
const PER_PIXEL: f64 = 130.0;
const PROGRAM: f64 = 24.0 * MIB;
const MIB: f64 = 1024.0 * 1024.0;

/// The run that is tried.
#[derive(Clone, Debug)]
pub struct CostOptions {
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
    /// MiB with the most splats.
    pub memory_mib: f64,
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
    let text = format!("about {:.0} MiB with {most} splats ({:.0} MiB of images)", cost.memory_mib, cost.images_mib);
    let limit = options.limit_mib.or_else(machine_mib);
    let memory = match limit {
        Some(limit) if cost.memory_mib > limit => {
            let what = format!("{text}; there are {limit:.0} MiB");
            let fix = "--set data.scale=0.5, or --set run.image_mib=256, or fewer splats: --set schedule.density.max_splats=N";
            Finding::new("memory", "memory.limit", Verdict::Problem, what).fix(fix)
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
    let resolved = resolve(&request).map_err(|e| e.to_string())?;
    let data = Arc::new(data.clone());
    let whole = trainer(&data, &resolved, &resolved.method)?;
    let schedule = whole.method().schedule().clone();
    let few = whole.method().len();
    let values = |t: &Trainer| count(t.method());
    let (few_values, cap) = (values(&whole), cap(&resolved.method).filter(|c| *c > few));
    drop(whole);
    let order: Vec<(String, u32)> = {
        let mut stages: Vec<_> = schedule.stages.iter().filter(|(_, s)| s.steps > 0).collect();
        stages.sort_by_key(|(_, s)| s.order);
        stages.into_iter().map(|(name, s)| (name.clone(), s.steps)).collect()
    };
    let mut stages = Vec::new();
    let mut many = (few, few_values);
    for (name, steps) in &order {
        let alone = only(&resolved.method, name, None);
        let first = pace(&mut trainer(&data, &resolved, &alone)?, &data)?;
        let mut ms = [first; 2];
        if let Some(cap) = cap {
            let mut more = trainer(&data, &resolved, &only(&resolved.method, name, Some(cap)))?;
            many = (more.method().len(), values(&more));
            if many.0 > few {
                let other = pace(&mut more, &data)?;
                let slope = ((other - first) / (many.0 - few) as f64).max(0.0);
                ms[1] = first + slope * (cap - few) as f64;
            }
        }
        stages.push(StageCost { name: name.clone(), steps: *steps, ms });
    }
    let most = cap.unwrap_or(few);
    let per_splat = if many.0 > few {
        (many.1 - few_values) as f64 / (many.0 - few) as f64
    } else {
        few_values as f64 / few.max(1) as f64
    };
    let model = few_values as f64 + per_splat * (most - few) as f64;
    let (images, largest) = decoded(&data, &schedule);
    let cached = images.map(|i| i.min(f64::from(resolved.run.image_mib) * MIB)).iter().sum::<f64>();
    let bytes = PER_VALUE * model + PER_SPLAT * most as f64 + PER_PIXEL * largest + cached + PROGRAM;
    let growth = [schedule.density.from, schedule.density.until].map(f64::from);
    Ok(Cost {
        run: format!("{} --preset {}", options.method, options.preset),
        threads: rayon::current_num_threads(),
        splats: [few, most],
        seconds: [0.0, 1.0].map(|share| seconds(&stages, growth, share)),
        stages,
        memory_mib: bytes / MIB,
        images_mib: images.iter().sum::<f64>() / MIB,
    })
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

/// Seconds of all stages, if so much of the growth happens that is possible.
fn seconds(stages: &[StageCost], [from, until]: [f64; 2], share: f64) -> f64 {
    let (mut at, mut sum) = (0.0, 0.0);
    for s in stages {
        let steps = f64::from(s.steps);
        // The mean over the stage of a number of splats that rises evenly between two steps.
        let grown = |step: f64| ((step - from) / (until - from).max(1.0)).clamp(0.0, 1.0);
        let mean = (0..=20).map(|k| grown(at + steps * f64::from(k) / 20.0)).sum::<f64>() / 21.0;
        sum += steps * (s.ms[0] + share * mean * (s.ms[1] - s.ms[0]));
        at += steps;
    }
    1e-3 * sum
}

fn trainer(data: &Arc<Dataset>, resolved: &Resolved, method: &Table) -> Result<Trainer, String> {
    let options = TrainOptions { seed: resolved.run.seed, image_bytes: (resolved.run.image_mib as usize) << 20 };
    Trainer::new(data.clone(), &resolved.run.method, method, options).map_err(|e| e.to_string())
}

/// The median time of some steps, ms; decoding is left out where the cache keeps all images.
fn pace(trainer: &mut Trainer, data: &Dataset) -> Result<f64, String> {
    let all: usize = data.train.iter().map(|v| 4 * v.camera.width as usize * v.camera.height as usize).sum();
    let kept = all <= 512 << 20;
    let mut times = Vec::new();
    for k in 0..(WARM_UP + COUNTED).min(trainer.steps()) {
        let ms = trainer.step().map_err(|e| e.to_string())?.ms;
        if k >= WARM_UP {
            times.push(if kept { ms.total - ms.data } else { ms.total });
        }
    }
    Ok(super::silhouettes::median(&times))
}

/// The settings with one stage alone, and with so many first points.
fn only(method: &Table, stage: &str, points: Option<usize>) -> Table {
    let mut table = method.clone();
    if let Some(Value::Table(stages)) = table.get_mut("schedule").and_then(|s| s.get_mut("stages")) {
        for (name, s) in stages.iter_mut() {
            if let (Value::Table(s), false) = (s, name == stage) {
                s.insert("steps".into(), Value::Integer(0));
            }
        }
    }
    if let (Some(points), Some(Value::Table(init))) = (points, table.get_mut("init")) {
        init.insert("points".into(), Value::Integer(points as i64));
    }
    table
}

/// The most splats or anchors that settings allow.
fn cap(method: &Table) -> Option<usize> {
    let at = |path: [&str; 3]| {
        let mut v = method.get(path[0])?;
        for key in &path[1..] {
            if !key.is_empty() {
                v = v.get(key)?;
            }
        }
        v.as_integer().and_then(|n| usize::try_from(n).ok())
    };
    at(["schedule", "density", "max_splats"])
}

fn count(params: &dyn crate::methods::Method) -> usize {
    let mut sum = 0;
    Params::visit(params, &mut |p| sum += p.value.len());
    sum
}

/// Memory that is free on this machine, MiB.
fn machine_mib() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix("MemAvailable:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()? / 1024.0)
}
