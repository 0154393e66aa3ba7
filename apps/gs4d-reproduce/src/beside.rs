//! Scores that training does not give: LPIPS with the user's weights, tOF. A run keeps them in its `metrics.json`, under `columns`; who scores it again keeps
//! those of the same images ([`carry_columns`]).

use crate::column::{Column, Measure};
use crate::network::Network;
use crate::reproduction::{Chosen, Reproduction};
use crate::table::Table;
use gs_data::{Dataset, Split};
use gs_metrics::{Lpips, TofOptions};
use gs_train::evaluate::EvalReport;
use gs_train::registry::Registry;
use gs4d_eval::folders::tof_protocol;
use gs4d_eval::spread::Spread;
use gs4d_eval::temporal::{TemporalError, tof_by_camera};
use gs4d_lab::contest::{Results, Trial};
use gs4d_run::folder::METRICS;
use gs4d_run::{OpenRun, RunError, RunFolder};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Key in the `metrics.json` of a run.
const COLUMNS: &str = "columns";

/// Scores of trials beside those of training.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Beside {
    /// By run folder and column.
    scores: BTreeMap<PathBuf, BTreeMap<&'static str, f64>>,
    /// Weights or protocol of each column that was asked for, by column.
    pub(crate) how: BTreeMap<&'static str, String>,
    /// What could not be measured, a column of a scene each once.
    pub(crate) left_out: Vec<LeftOut>,
}

/// A column of a scene without a score.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct LeftOut {
    /// Name of the column.
    pub(crate) column: &'static str,
    /// Name of the scene.
    pub(crate) scene: String,
    /// The cause.
    pub(crate) why: String,
}

/// Why a column of a run has no score.
#[derive(Debug, thiserror::Error)]
enum Unmeasured {
    #[error(transparent)]
    Run(#[from] RunError),
    #[error(transparent)]
    Temporal(#[from] TemporalError),
    #[error("its data have changed since it was trained")]
    OtherData,
}

/// A score as a run keeps it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Kept {
    /// Absent where the data have no such score.
    value: Option<f64>,
    /// Weights or protocol.
    how: String,
}

/// A column to measure.
struct Task {
    column: Column,
    /// Weights or protocol.
    how: String,
    lpips: Option<Arc<Lpips>>,
}

impl Beside {
    /// Measures the columns of the table that need it, of every trial that does not keep them; LPIPS where weights of the column's network are
    /// given. What cannot be measured is left out by name. `on_trial` is called for every run that is scored.
    ///
    /// # Errors
    /// If scores cannot be kept.
    pub fn measure(
        reproduction: &Reproduction,
        results: &[Results],
        registry: &Registry,
        weights: &[Lpips],
        on_trial: &mut dyn FnMut(&Path),
    ) -> Result<Self, RunError> {
        let mut beside = Self::default();
        let table = &reproduction.table;
        let networks = networks(table, weights);
        for (chosen, results) in reproduction.scenes.iter().zip(results) {
            let mut tasks = tasks(table, chosen, &networks);
            beside.how.extend(tasks.iter().map(|t| (t.column.name, t.how.clone())));
            for trial in results.standings.iter().flat_map(|s| &s.trials) {
                let is_video = beside.trial(chosen.name(), trial, registry, &tasks, on_trial)?;
                // Views that are no video are none for any trial.
                tasks.retain(|t| is_video || !matches!(t.column.measure, Measure::Tof));
            }
        }
        Ok(beside)
    }

    /// The score of a trial in a column.
    pub(crate) fn score(&self, column: &Column, trial: &Trial) -> Option<f64> {
        match column.measure {
            Measure::Scores(of) => of(&trial.scores),
            Measure::Lpips(_) | Measure::Tof => self.scores.get(&trial.run)?.get(column.name).copied(),
        }
    }

    fn leave_out(&mut self, column: &'static str, scene: &str, why: &dyn std::error::Error) {
        if !self.left_out.iter().any(|l| l.column == column && l.scene == scene) {
            self.left_out.push(LeftOut { column, scene: scene.to_owned(), why: why.to_string() });
        }
    }

    /// Measures what a trial does not keep. Returns whether its test views are, as far as was asked, videos.
    fn trial(
        &mut self,
        scene: &str,
        trial: &Trial,
        registry: &Registry,
        tasks: &[Task],
        on_trial: &mut dyn FnMut(&Path),
    ) -> Result<bool, RunError> {
        let folder = RunFolder::open(&trial.run)?;
        let mut kept = kept(&folder);
        let stands = |t: &Task| kept.get(t.column.name).is_some_and(|k| k.how == t.how);
        let missing: Vec<&Task> = tasks.iter().filter(|t| !stands(t)).collect();
        let mut is_video = true;
        if !missing.is_empty() {
            on_trial(&trial.run);
            match measured(registry, &trial.run, &missing) {
                Ok((values, dataset)) => {
                    for (task, value) in missing.iter().zip(values) {
                        let (column, how) = (task.column.name, task.how.clone());
                        match value {
                            Ok(value) => drop(kept.insert(column.to_owned(), Kept { value, how })),
                            Err(e) => {
                                is_video &= !e.is_no_video();
                                self.leave_out(column, scene, &e);
                            }
                        }
                    }
                    keep(&folder, &kept, &dataset)?;
                }
                Err(e) => missing.iter().for_each(|t| self.leave_out(t.column.name, scene, &e)),
            }
        }
        let of = |t: &Task| Some((t.column.name, kept.get(t.column.name).filter(|k| k.how == t.how)?.value?));
        self.scores.insert(trial.run.clone(), tasks.iter().filter_map(of).collect());
        Ok(is_video)
    }
}

/// The networks of the table that there are weights of, each once.
fn networks(table: &Table, weights: &[Lpips]) -> Vec<(Network, Arc<Lpips>)> {
    let mut all: Vec<(Network, Arc<Lpips>)> = Vec::new();
    for network in table.networks.values() {
        if !all.iter().any(|(known, _)| known == network) {
            all.extend(network.among(weights).map(|lpips| (*network, Arc::new(lpips))));
        }
    }
    all
}

/// What is to be measured on a scene.
fn tasks(table: &Table, chosen: &Chosen, networks: &[(Network, Arc<Lpips>)]) -> Vec<Task> {
    let task = |column: Column| match column.measure {
        Measure::Scores(_) => None,
        Measure::Tof => Some(Task { column, how: tof_protocol(TofOptions::default()), lpips: None }),
        Measure::Lpips(_) => {
            let network = table.networks.get(column.name)?;
            let lpips = networks.iter().find(|(known, _)| known == network).map(|(_, lpips)| lpips.clone())?;
            Some(Task { column, how: format!("{}: {}", column.name, lpips.weights()), lpips: Some(lpips) })
        }
    };
    table.measured_columns(chosen.is_generated()).into_iter().filter_map(task).collect()
}

/// The score of each column of a run, `None` where the data have none, and the data.
type Measured = (Vec<Result<Option<f64>, Unmeasured>>, Dataset);

/// Measures columns of a run.
fn measured(registry: &Registry, root: &Path, tasks: &[&Task]) -> Result<Measured, Unmeasured> {
    let mut run = OpenRun::open(registry, root)?;
    let dataset = run.open_data()?;
    if !run.trained_on(&dataset) {
        return Err(Unmeasured::OtherData);
    }
    let mut reports = BTreeMap::new();
    let values = tasks.iter().map(|t| value(&mut run, &dataset, t, &mut reports)).collect();
    Ok((values, dataset))
}

/// Measures a column of a run. `reports` holds what was scored with the same weights before.
fn value(
    run: &mut OpenRun,
    dataset: &Dataset,
    task: &Task,
    reports: &mut BTreeMap<String, EvalReport>,
) -> Result<Option<f64>, Unmeasured> {
    match (task.column.measure, &task.lpips) {
        (Measure::Lpips(of), Some(lpips)) => {
            let weights = lpips.weights();
            if let Some(report) = reports.get(&weights) {
                return Ok(of(report));
            }
            run.lpips = Some(lpips.clone());
            let report = run.score_for_folder(dataset)?;
            let value = of(&report);
            reports.insert(weights, report);
            Ok(value)
        }
        (Measure::Tof, _) => {
            let images = run.images();
            let scoring = run.scoring(run.background(), &images);
            let videos = tof_by_camera(&run.loaded.model, dataset, Split::Test, &scoring, TofOptions::default())?;
            Ok(Spread::of(&videos.iter().map(|v| v.mean).collect::<Vec<_>>()).map(|s| s.mean))
        }
        _ => Ok(None),
    }
}

impl Unmeasured {
    /// Whether the views have no tOF, whatever the run.
    fn is_no_video(&self) -> bool {
        matches!(self, Self::Temporal(e) if e.is_of_the_video())
    }
}

/// Adds to new scores of a run the columns that the run keeps, where both are scores of the same images: PSNR and SSIM of every view, and those
/// under its mask, are the same bits. Columns of other images are left out, and the next collection measures them anew.
pub fn carry_columns(folder: &RunFolder, scores: &mut Value) {
    let Some(mut old) = written(folder).filter(|old| images(old) == images(scores)) else { return };
    if let Some(columns) = old.get_mut(COLUMNS) {
        scores[COLUMNS] = columns.take();
    }
}

/// What tells the images of scores apart, of every view.
fn images(scores: &Value) -> Vec<Value> {
    let views = ["/views", "/extrapolate/views"].map(|at| scores.pointer(at).and_then(Value::as_array));
    let of = |v: &Value| json!([v["name"], v["psnr"], v["ssim"], v["masked"]["psnr"], v["masked"]["ssim"]]);
    views.into_iter().flatten().flatten().map(of).collect()
}

/// The scores in the folder of a run; none if they cannot be read.
fn written(folder: &RunFolder) -> Option<Value> {
    serde_json::from_str(&folder.read(METRICS).ok()?).ok()
}

/// The columns that a run keeps; none if they cannot be read.
fn kept(folder: &RunFolder) -> BTreeMap<String, Kept> {
    let read = || serde_json::from_value(written(folder)?.get_mut(COLUMNS)?.take()).ok();
    read().unwrap_or_default()
}

/// Adds scores to those that a run has.
fn keep(folder: &RunFolder, kept: &BTreeMap<String, Kept>, dataset: &Dataset) -> Result<(), RunError> {
    let Ok(Value::Object(mut scores)) = serde_json::from_str(&folder.read(METRICS)?) else { return Ok(()) };
    scores.insert(COLUMNS.to_owned(), json!(kept));
    folder.write_scores(Value::Object(scores), dataset)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reproduction::Conditions;
    use gs_synth::SynthOptions;
    use gs4d_lab::contest::Length;
    use gs4d_run::opened::metrics_json;
    use std::fs;
    use std::sync::atomic::AtomicBool;

    /// The folder of the only scene.
    fn data(root: &Path) -> PathBuf {
        root.join("data/reach-g")
    }

    /// A table with tOF on a scene that a held-out camera filmed, run with one entry and seed.
    fn trained(root: &Path) -> (Reproduction, Vec<Results>) {
        let film = SynthOptions { size: 48, cameras: 2, held_out: 1, moments: 9, ..SynthOptions::default() };
        gs_synth::write(&data(root), "balls", &film, true).unwrap();
        let conditions = Conditions {
            data: Vec::new(),
            scenes: vec!["reach-g".into()],
            entries: vec!["4DGS".into()],
            seeds: vec![0],
            preset: Some("tiny".into()),
            length: Length::Steps(2),
            scale: None,
            sets: Vec::new(),
            root: root.to_owned(),
        };
        let reproduction = Reproduction::new(Table::find("modec", "nvidia").unwrap(), conditions).unwrap();
        let contests = reproduction.contests(gs_methods::registry()).unwrap();
        let results = contests.iter().map(|c| c.run(&AtomicBool::new(false), &mut |_| {}).unwrap()).collect();
        (reproduction, results)
    }

    /// What is measured without weights, and the number of runs that are scored for it.
    fn measured((reproduction, results): &(Reproduction, Vec<Results>)) -> (Beside, usize) {
        let mut scored = 0;
        let beside = Beside::measure(reproduction, results, gs_methods::registry(), &[], &mut |_| scored += 1);
        (beside.unwrap(), scored)
    }

    fn run_of((_, results): &(Reproduction, Vec<Results>)) -> &Path {
        &results[0].standings[0].trials[0].run
    }

    #[test]
    fn a_run_whose_data_have_changed_is_not_measured() {
        let dir = tempfile::tempdir().unwrap();
        let trained = trained(dir.path());
        let metrics = run_of(&trained).join(METRICS);
        let before = fs::read_to_string(&metrics).unwrap();
        let images = fs::read_dir(data(dir.path()).join("test")).unwrap();
        let mut images: Vec<PathBuf> = images.map(|f| f.unwrap().path()).collect();
        images.sort();
        fs::copy(images.last().unwrap(), &images[0]).unwrap();
        let (beside, _) = measured(&trained);
        let why = Unmeasured::OtherData.to_string();
        assert_eq!(beside.left_out, [LeftOut { column: "tof", scene: "reach-g".into(), why }]);
        assert!(beside.scores[run_of(&trained)].is_empty(), "{:?}", beside.scores);
        assert_eq!(fs::read_to_string(&metrics).unwrap(), before);
    }

    #[test]
    fn columns_stay_with_scores_of_the_same_images_alone() {
        let dir = tempfile::tempdir().unwrap();
        let trained = trained(dir.path());
        let (first, scored) = measured(&trained);
        assert!(scored == 1 && first.scores[run_of(&trained)]["tof"] > 0.0, "{first:?}");

        // As `gs4d eval` scores a run.
        let run = OpenRun::open(gs_methods::registry(), run_of(&trained)).unwrap();
        let (folder, dataset) = (run.folder().unwrap(), run.open_data().unwrap());
        let again = metrics_json(&run.score_for_folder(&dataset).unwrap(), run.loaded.step);
        let carried = |mut scores: Value| {
            carry_columns(folder, &mut scores);
            scores
        };
        for (view, score) in [
            ("/views/0", json!({"psnr": 1.0})),
            ("/views/1", json!({"ssim": 0.5})),
            ("/views/0", json!({"masked": {"psnr": 1.0}})),
            ("/extrapolate/views/0", json!({"psnr": 1.0})),
        ] {
            let mut other = again.clone();
            let Value::Object(score) = score else { unreachable!() };
            other.pointer_mut(view).unwrap().as_object_mut().unwrap().extend(score.clone());
            assert_eq!(carried(other).get(COLUMNS), None, "{view}: {score:?}");
        }
        folder.write_scores(carried(again.clone()), &dataset).unwrap();
        assert_eq!(measured(&trained), (first.clone(), 0));
        folder.write_scores(again, &dataset).unwrap();
        assert_eq!(measured(&trained), (first, 1), "measured anew without them");
    }
}
