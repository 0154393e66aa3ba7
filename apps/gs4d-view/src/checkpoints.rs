//! Checkpoints of a run as scenes, with a small cache.

use crate::scene::Scene;
use gs_train::checkpoint::{file_name, steps_in};
use gs_train::registry::Registry;
use gs4d_run::OpenRun;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

/// Loaded checkpoints kept in memory.
const CACHE_SIZE: usize = 2;

/// The checkpoint folder of a run.
pub(crate) struct Checkpoints {
    registry: Registry,
    folder: PathBuf,
    /// Steps and loaded scenes, the last used at the end.
    cache: Mutex<Vec<(u32, Arc<Scene>)>>,
}

impl Checkpoints {
    /// Opens a checkpoint folder; methods are looked up in `registry`.
    pub(crate) fn of(registry: Registry, folder: PathBuf) -> Self {
        Self { registry, folder, cache: Mutex::default() }
    }

    /// Steps with a checkpoint, newest first; empty if the folder cannot be read.
    pub(crate) fn steps(&self) -> Vec<u32> {
        steps_in(&self.folder).unwrap_or_default()
    }

    /// The scene at a step.
    ///
    /// # Errors
    /// A message, if there is no such checkpoint or it is damaged.
    pub(crate) fn at(&self, step: u32) -> Result<Arc<Scene>, String> {
        let mut cache = self.cache.lock().unwrap_or_else(PoisonError::into_inner);
        let scene = match cache.iter().position(|(s, _)| *s == step) {
            Some(at) => cache.remove(at).1,
            None => {
                let run =
                    OpenRun::open(&self.registry, &self.folder.join(file_name(step))).map_err(|e| e.to_string())?;
                Arc::new(Scene::method(run.loaded.model))
            }
        };
        cache.push((step, scene.clone()));
        if cache.len() > CACHE_SIZE {
            cache.remove(0);
        }
        Ok(scene)
    }
}
