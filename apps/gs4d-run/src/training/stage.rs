//! How far the run of given settings has come in its folder, and going on with it.

use super::{ResumeRequest, Training};
use crate::folder::{CONFIG, DATA_DIGEST, METRICS, RunFolder};
use crate::{Resolved, RunError, provenance};
use gs_train::checkpoint;
use gs_train::evaluate::EvalReport;
use serde_json::Value;
use std::path::Path;

/// How far a run has come.
#[derive(Clone, Debug, PartialEq)]
pub enum Stage {
    /// There is no run in the folder.
    Missing,
    /// It is begun; its newest checkpoint is of this step, 0 if there is none.
    Begun(u32),
    /// It is trained to the end of its schedule or of its time budget, and scored.
    Finished(Box<Scored>),
}

/// The result of a finished run.
#[derive(Clone, Debug, PartialEq)]
pub struct Scored {
    /// What [`Training::score`] gave.
    pub scores: EvalReport,
    /// Optimizer steps made.
    pub step: u32,
}

impl Stage {
    /// How far the run in a folder has come that has these settings.
    ///
    /// # Errors
    /// [`RunError::OtherSettings`] if its settings are others or it is trained in rounds, [`RunError::DataChanged`] if it is finished
    /// on other data than those of the settings are now; if its settings cannot be read.
    pub fn of(root: &Path, resolved: &Resolved) -> Result<Self, RunError> {
        let folder = match RunFolder::open(root) {
            Err(RunError::NotARun { .. }) => return Ok(Stage::Missing),
            folder => folder?,
        };
        let found = Resolved::read(&resolved.registry, &folder.read(CONFIG)?, CONFIG)?;
        let same = found.trains_as(resolved) || found.trains_as(&on_start_points(resolved));
        if !same || folder.rounds().is_some() {
            return Err(RunError::OtherSettings { path: root.to_owned() });
        }
        match scored(&folder, resolved) {
            // Data that are gone cannot be compared.
            Some(scored) => match resolved.open_data().ok() {
                Some(data) if provenance::trained_on(&folder, &data) == Some(false) => {
                    Err(RunError::DataChanged { path: data.root, run: root.to_owned() })
                }
                _ => Ok(Stage::Finished(Box::new(scored))),
            },
            None => Ok(Stage::Begun(checkpoint::steps_in(&folder.checkpoints())?.first().copied().unwrap_or(0))),
        }
    }
}

/// The settings as a run with them begins on their data ([`Resolved::with_start_points`]); as they are where the data are gone.
fn on_start_points(resolved: &Resolved) -> Resolved {
    let on = |data| resolved.clone().with_start_points(&data).ok();
    resolved.open_data().ok().and_then(on).unwrap_or_else(|| resolved.clone())
}

/// The scores of a run at the end of its training; they stand without its checkpoints. `gs4d eval` may have scored an earlier step;
/// scores of other data than the run was trained on last do not count.
fn scored(folder: &RunFolder, resolved: &Resolved) -> Option<Scored> {
    let json: Value = serde_json::from_str(&folder.read(METRICS).ok()?).ok()?;
    let step = u32::try_from(json["step"].as_u64()?).ok()?;
    // Older runs do not say which data were scored.
    if json[DATA_DIGEST].as_str().is_some_and(|scored| provenance::known_digest(folder).is_some_and(|d| d != scored)) {
        return None;
    }
    let scores: EvalReport = serde_json::from_value(json).ok()?;
    let (budget, seconds) = (resolved.run.time_budget, scores.train_seconds.unwrap_or(0.0));
    let ended = u64::from(step) >= resolved.steps() || budget > 0.0 && seconds >= budget;
    ended.then_some(Scored { scores, step })
}

impl Training {
    /// Goes on with the run of these settings in a folder, up to its own time budget if it has one; begins it if there is
    /// none, or none with a checkpoint or scores. A finished run has nothing left to train.
    ///
    /// # Errors
    /// Those of [`Stage::of`], [`Training::begin`] and [`Training::resume`].
    pub fn go_on(root: &Path, resolved: Resolved) -> Result<Self, RunError> {
        match Stage::of(root, &resolved)? {
            Stage::Missing => Self::begin(root, false, resolved),
            Stage::Begun(0) if !root.join(METRICS).exists() => {
                let mut training = Self::begin(root, true, resolved)?;
                training.warnings.push("the run in this folder had no checkpoint: it is begun anew".to_owned());
                Ok(training)
            }
            _ => {
                let found = RunFolder::open(root)?.read(CONFIG)?;
                let known = Resolved::read(&resolved.registry, &found, CONFIG)?.run.image_mib;
                // Settings that stay as they are keep their sources.
                let image_mib = Some(resolved.run.image_mib).filter(|mib| *mib != known);
                let request = ResumeRequest { image_mib, ..ResumeRequest::default() };
                let resumed = Self::resume(&resolved.registry, root, &request)?;
                Ok(Self { stop_at: resolved.run.time_budget, ..resumed })
            }
        }
    }
}
