//! A scene that another code has trained, as a finished run: it is rendered, scored, exported and lengthened as any other.

use crate::RunError;
use crate::config::Source;
use crate::folder::{Beginning, RunFolder};
use crate::kept::Kept;
use crate::provenance;
use crate::settings::{self, Resolved};
use glam::Vec3;
use gs_train::checkpoint::Checkpoint;
use gs_train::registry::Registry;
use gs_train::saved::{self, RunState};
use gs_train::scene::{InitConfig, InitFrom, SceneInfo};
use gs_train::trainer::TrainError;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// What there is of such a scene.
#[derive(Clone, Debug)]
pub struct Elsewhere {
    /// The method that has its parameters.
    pub method: &'static str,
    /// Settings that differ from the preset `paper` of the method, by dotted key.
    pub settings: Vec<(String, toml::Value)>,
    /// Every parameter of the method by its name.
    pub tensors: Vec<(String, Vec<f32>)>,
    /// Lower and upper corner of the box that the field covers, world units.
    pub bounds: [Vec3; 2],
    /// Where it comes from, for the provenance: code, iteration, file.
    pub origin: Value,
}

impl Elsewhere {
    /// The settings of the run on the data in a folder; `sets` are assignments `key=value`, which win.
    ///
    /// # Errors
    /// If a setting is unknown or outside its domain.
    pub fn resolve(&self, registry: &Registry, data: &Path, sets: &[String]) -> Result<Resolved, RunError> {
        let mut config = settings::with_preset(registry, self.method, "paper")?;
        let file = Source::File(self.origin["file"].as_str().unwrap_or("checkpoint").to_owned());
        for (key, value) in &self.settings {
            config.put(key, value.clone(), file.clone())?;
        }
        let full = std::fs::canonicalize(data).unwrap_or_else(|_| data.to_owned());
        config.put("run.data", full.display().to_string(), Source::Flag("--data".into()))?;
        sets.iter().try_for_each(|assignment| config.set(assignment))?;
        Resolved::of(registry, config)
    }

    /// Writes the run folder, with one checkpoint of the last step of the schedule; moments of the optimiser are zero.
    ///
    /// # Errors
    /// If the data cannot be read, the parameters do not fit the method or are not finite, the folder is taken, or the system refuses.
    pub fn write(self, root: &Path, overwrite: bool, resolved: &Resolved) -> Result<RunFolder, RunError> {
        let dataset = resolved.open_data()?;
        let one = InitConfig { from: InitFrom::Random, points: 1, bound: 1.0, first_moment: false };
        let scene = SceneInfo::of(&dataset, &one, resolved.run.seed)?;
        let scene = SceneInfo { bounds: self.bounds, ..scene };
        let model = resolved.registry.find(self.method)?.model(&resolved.method, &scene)?;
        let step = model.schedule().steps();
        let none = BTreeMap::new();
        let state = RunState { config: &resolved.method, scene: &scene, step, adam_updates: &none, train_seconds: 0.0 };
        let meta = saved::save_for_rendering(&model, &state).meta;
        let checkpoint = Checkpoint { meta, tensors: self.tensors };
        saved::load(&resolved.registry, &checkpoint, None).map_err(TrainError::State)?;
        let config = resolved.to_toml()?;
        let mut provenance = provenance::begun(resolved, &config, &dataset, step);
        provenance["trained_elsewhere"] = self.origin;
        let beginning = Beginning {
            config: &config,
            provenance: &format!("{provenance:#}\n"),
            data: &format!("{}\n", Kept::of(&dataset).to_json()?),
        };
        let folder = RunFolder::create(root, overwrite, &beginning)?;
        checkpoint.save_step(&folder.checkpoints(), step)?;
        Ok(folder)
    }
}
