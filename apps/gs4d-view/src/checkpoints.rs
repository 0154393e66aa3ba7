//! Earlier states of a run, from the checkpoints in its folder.

use crate::scene::Scene;
use gs_train::checkpoint::{file_name, steps_in};
use gs_train::registry::Registry;
use gs4d_run::OpenRun;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

/// Opened checkpoints kept in memory.
const OPEN: usize = 2;

/// The folder of a run's checkpoints.
pub struct Checkpoints {
    registry: Registry,
    folder: PathBuf,
    /// Steps and scenes, the last used at the end.
    open: Mutex<Vec<(u32, Arc<Scene>)>>,
}

impl Checkpoints {
    /// Those in a folder.
    pub fn of(registry: Registry, folder: PathBuf) -> Self {
        Self { registry, folder, open: Mutex::default() }
    }

    /// Steps there are now, newest first; none if the folder cannot be read.
    pub fn steps(&self) -> Vec<u32> {
        steps_in(&self.folder).unwrap_or_default()
    }

    /// The scene at a step.
    ///
    /// # Errors
    /// In words, if there is no such checkpoint or it does not verify.
    pub fn at(&self, step: u32) -> Result<Arc<Scene>, String> {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let scene = match open.iter().position(|(s, _)| *s == step) {
            Some(at) => open.remove(at).1,
            None => {
                let run =
                    OpenRun::open(&self.registry, &self.folder.join(file_name(step))).map_err(|e| e.to_string())?;
                Arc::new(Scene::method(run.loaded.model))
            }
        };
        open.push((step, scene.clone()));
        if open.len() > OPEN {
            open.remove(0);
        }
        Ok(scene)
    }
}
