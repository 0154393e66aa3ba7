//! A method under training as a [`Checkpoint`], and back.
//!
//! `meta` holds the method's name, its resolved configuration, the scene it was built for (without the first points),
//! the step and the optimiser's counters; tensors are every parameter `NAME`, its moments `NAME#m1`, `NAME#m2`, and the
//! growth statistics.

use crate::cameras::KnownCamera;
use crate::checkpoint::Checkpoint;
use crate::loss::Exposures;
use crate::method::{BufferMut, MethodError};
use crate::model::Model;
use crate::registry::Registry;
use crate::scene::{MAX_PARAMETERS, SceneInfo};
use glam::Vec3;
use gs_core::Param;
use gs_data::PointCloud;
use gs_data::avatar::AvatarScene;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Name of the maps to the colours of training images.
const EXPOSURES: &str = "exposures#";
/// Name of their offsets, where they have any.
const OFFSETS: &str = "exposures#offsets";

/// Largest number of steps of a run.
const MAX_STEPS: u32 = 1 << 31;

/// What a checkpoint says of a run beside its tensors.
#[derive(Clone, Copy, Debug)]
pub struct RunState<'a> {
    /// Resolved configuration of the method.
    pub config: &'a toml::Table,
    /// What it was built from.
    pub scene: &'a SceneInfo,
    /// Optimizer steps made so far.
    pub step: u32,
    /// Updates of each block by the optimiser.
    pub adam_updates: &'a BTreeMap<String, u32>,
    /// Seconds spent in training so far.
    pub train_seconds: f64,
}

/// A method read from a checkpoint.
pub struct Loaded {
    /// The model, at the step of the checkpoint.
    pub model: Model,
    /// Resolved configuration it was built from.
    pub config: toml::Table,
    /// What it was built from; the first points are not kept.
    pub scene: SceneInfo,
    /// Optimizer steps made when it was saved.
    pub step: u32,
    /// Updates of each block by the optimiser.
    pub adam_updates: BTreeMap<String, u32>,
    /// Seconds spent in training when it was saved.
    pub train_seconds: f64,
}

#[derive(Serialize, Deserialize)]
struct Meta {
    method: String,
    config: toml::Table,
    extent: f32,
    bounds: [[f32; 3]; 2],
    views: u32,
    moments: u32,
    last_time: f32,
    frame_interval: f32,
    /// 0 where an older file does not say, as the next.
    #[serde(default)]
    first_interval: f32,
    /// 0 where an older file does not say.
    #[serde(default)]
    view_spacing: f32,
    /// As text: JSON numbers do not hold every 64-bit integer in every reader.
    seed: String,
    step: u32,
    adam_updates: BTreeMap<String, u32>,
    train_seconds: f64,
    /// Training cameras that have corrections.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    corrected_cameras: Vec<KnownCamera>,
}

/// The state of a method and its run.
pub fn save(model: &Model, run: &RunState) -> Checkpoint {
    Checkpoint { meta: meta(model, run), tensors: tensors(model, true) }
}

/// The same without moments of the optimiser, a third of the bytes: enough to render.
pub fn save_for_rendering(model: &Model, run: &RunState) -> Checkpoint {
    Checkpoint { meta: meta(model, run), tensors: tensors(model, false) }
}

fn meta(model: &Model, run: &RunState) -> serde_json::Value {
    let meta = Meta {
        method: model.name().to_owned(),
        config: run.config.clone(),
        extent: run.scene.extent,
        bounds: run.scene.bounds.map(|b| b.to_array()),
        views: run.scene.views,
        moments: run.scene.timestamps,
        last_time: run.scene.last_time,
        frame_interval: run.scene.frame_interval,
        first_interval: run.scene.first_interval,
        view_spacing: run.scene.view_spacing,
        seed: run.scene.seed.to_string(),
        step: run.step,
        adam_updates: run.adam_updates.clone(),
        train_seconds: run.train_seconds,
        corrected_cameras: model.cameras().known().to_vec(),
    };
    // A structure of names and finite numbers always has a JSON form.
    serde_json::to_value(meta).unwrap_or_default()
}

/// Every block of a method, with its moments if wanted, then the buffers.
fn tensors(model: &Model, moments: bool) -> Vec<(String, Vec<f32>)> {
    let mut tensors = Vec::new();
    model.visit(&mut |p: &Param| {
        tensors.push((p.name.clone(), p.value.clone()));
        if moments {
            tensors.push((format!("{}#m1", p.name), p.moment1.clone()));
            tensors.push((format!("{}#m2", p.name), p.moment2.clone()));
        }
    });
    model.buffers(&mut |b| tensors.push((b.name.to_owned(), b.values.clone())));
    let maps = [EXPOSURES, OFFSETS].into_iter().zip(model.exposures().values());
    let kept = maps.filter(|(_, values)| moments && !values.is_empty());
    tensors.extend(kept.map(|(name, values)| (name.to_owned(), values.to_vec())));
    tensors
}

/// The method of a checkpoint, ready to render or to train on; with another configuration if one is given.
///
/// # Errors
/// Says what is missing or does not fit.
pub fn load(registry: &Registry, checkpoint: &Checkpoint, config: Option<&toml::Table>) -> Result<Loaded, String> {
    load_with(registry, checkpoint, config, None)
}

/// As [`load`], for a method that needs the filmed person of the data it was trained on.
///
/// # Errors
/// As [`load`].
pub fn load_with(
    registry: &Registry,
    checkpoint: &Checkpoint,
    config: Option<&toml::Table>,
    avatar: Option<Arc<AvatarScene>>,
) -> Result<Loaded, String> {
    let meta = Meta::deserialize(&checkpoint.meta).map_err(|e| format!("meta: {e}"))?;
    let entry = registry.find(&meta.method).map_err(|e| e.to_string())?;
    if entry.needs_avatar && avatar.is_none() {
        let folder = Default::default();
        return Err(MethodError::NoAvatar { method: entry.name, folder }.to_string());
    }
    let seed = meta.seed.parse().map_err(|_| format!("meta.seed `{}` is not a whole number", meta.seed))?;
    let bounds = meta.bounds.map(Vec3::from_array);
    if !(meta.extent > 0.0 && meta.extent.is_finite() && bounds.iter().all(|b| b.is_finite())) {
        return Err("meta: extent or bounds are not finite".into());
    }
    if meta.step > MAX_STEPS {
        return Err(format!("meta.step = {}: no run has more than {MAX_STEPS} steps", meta.step));
    }
    // The blocks are given their rows below; one point stands in for the first cloud.
    let points = PointCloud { positions: vec![0.5 * (bounds[0] + bounds[1])], colors: vec![[0.5; 3]] };
    let Meta { extent, views, moments: timestamps, last_time, frame_interval, first_interval, view_spacing, .. } = meta;
    let max_parameters = parameters(&checkpoint.tensors).min(MAX_PARAMETERS);
    let scene = SceneInfo {
        points,
        extent,
        bounds,
        views,
        timestamps,
        last_time,
        frame_interval,
        first_interval,
        view_spacing,
        seed,
        avatar,
        max_parameters,
    };
    let config = config.unwrap_or(&meta.config).clone();
    let model = entry.model(&config, &scene).map_err(|e| e.to_string())?;
    let cameras = *model.cameras().config();
    let mut model = model.with_cameras(cameras, meta.corrected_cameras);
    if let Ok(maps) = checkpoint.tensor(EXPOSURES) {
        let offsets = checkpoint.tensor(OFFSETS).unwrap_or_default();
        check_finite(EXPOSURES, maps)?;
        check_finite(OFFSETS, offsets)?;
        if !offsets.is_empty() && 3 * offsets.len() != maps.len() {
            let (held, wanted) = (offsets.len(), maps.len() / 3);
            return Err(format!("tensor `{OFFSETS}` has {held} values, the maps of `{EXPOSURES}` need {wanted}"));
        }
        *model.exposures_mut() = Exposures::of(maps, offsets);
    }
    restore(&mut model, &checkpoint.tensors)?;
    model.begin_step(meta.step);
    let (adam_updates, train_seconds) = (meta.adam_updates, meta.train_seconds);
    Ok(Loaded { model, config, scene, step: meta.step, adam_updates, train_seconds })
}

/// Number of parameters that a checkpoint holds, moments of the optimiser left out.
fn parameters(tensors: &[(String, Vec<f32>)]) -> u64 {
    tensors.iter().filter(|(name, _)| !name.contains('#')).map(|(_, values)| values.len() as u64).sum()
}

/// Fills a method's blocks and buffers. Row blocks take the number of rows of the tensors; moments and buffers of rows that
/// are absent become zero, other buffers stay as the method was built. Names the first tensor that is missing or does not fit; the method is then unusable.
fn restore(model: &mut Model, tensors: &[(String, Vec<f32>)]) -> Result<(), String> {
    let tensors: BTreeMap<&str, &Vec<f32>> = tensors.iter().map(|(name, t)| (name.as_str(), t)).collect();
    let mut rows = None;
    let mut result = Ok(());
    model.visit_mut(&mut |p| {
        if result.is_ok() {
            result = restore_block(p, &tensors, &mut rows);
        }
    });
    std::mem::replace(&mut result, Ok(()))?;
    let rows = rows.unwrap_or(0);
    model.buffers_mut(&mut |b| {
        if result.is_ok() {
            result = restore_buffer(b, &tensors, rows);
        }
    });
    result
}

fn check_finite(name: &str, values: &[f32]) -> Result<(), String> {
    match values.iter().position(|v| !v.is_finite()) {
        Some(at) => Err(format!("tensor `{name}` has a value that is not finite at {at}")),
        None => Ok(()),
    }
}

fn restore_buffer(buffer: BufferMut, tensors: &BTreeMap<&str, &Vec<f32>>, rows: usize) -> Result<(), String> {
    let BufferMut { name, row_width, values, .. } = buffer;
    let needed = row_width.map_or(values.len(), |width| rows * width);
    match tensors.get(name) {
        Some(stored) if stored.len() == needed => {
            check_finite(name, stored)?;
            values.clone_from(stored);
        }
        Some(stored) => return Err(format!("tensor `{name}` has {} values, {needed} are needed", stored.len())),
        None if row_width.is_some() => *values = vec![0.0; rows * row_width.unwrap_or(1)],
        None => {}
    }
    Ok(())
}

fn restore_block(p: &mut Param, tensors: &BTreeMap<&str, &Vec<f32>>, rows: &mut Option<usize>) -> Result<(), String> {
    let name = &p.name;
    let value = tensors.get(name.as_str()).ok_or_else(|| format!("tensor `{name}` is missing"))?;
    match p.row_width {
        None if value.len() != p.len() => {
            return Err(format!("tensor `{name}` has {} values, {} are needed", value.len(), p.len()));
        }
        Some(w) if value.len() != w * *rows.get_or_insert(value.len() / w) => {
            return Err(format!(
                "tensor `{name}` has {} values; rows of {w}, as many as elsewhere, are needed",
                value.len()
            ));
        }
        _ => {}
    }
    check_finite(name, value)?;
    for (suffix, moment) in [("#m1", &mut p.moment1), ("#m2", &mut p.moment2)] {
        *moment = match tensors.get(format!("{name}{suffix}").as_str()) {
            Some(m) if m.len() == value.len() => {
                check_finite(&format!("{name}{suffix}"), m)?;
                m.to_vec()
            }
            Some(m) => {
                return Err(format!("tensor `{name}{suffix}` has {} values, {} are needed", m.len(), value.len()));
            }
            None => vec![0.0; value.len()],
        };
    }
    p.value = value.to_vec();
    p.grad = vec![0.0; p.value.len()];
    Ok(())
}
