//! The run folder on disk.
//!
//! ```text
//! RUN/config.resolved.toml   every setting with its source
//! RUN/provenance.json        version, CPU, device, threads, seed, digests of data and weight files, layout, time source, split sizes
//! RUN/data.json              timestamps, splits and a few cameras of the data, for where the data are not
//! RUN/log.jsonl              one JSON object per line: step, seconds, loss terms, counts, milliseconds, memory
//! RUN/histograms.jsonl       histograms of attributes of the splats, where the method has any
//! RUN/journal.jsonl          events of the method (moves of interval boundaries, growth of anchors)
//! RUN/checkpoints/           step-012000.gs4d …, latest
//! RUN/continual.json         scores of each round, if the run is trained in rounds
//! RUN/metrics.json           scores per view and their means
//! RUN/refined-cameras.json   the corrected training cameras, where they were learnt
//! RUN/renders/               images; names carry step, time and camera
//! RUN/report.html            the report
//! ```
//! A writer holds a lock, which the system releases when the process ends.

mod begin;

use super::RunError;
use super::log::Log;
use super::provenance;
use gs_core::io::{Limits, disk, read_text, write_file};
use gs_data::Dataset;
use serde_json::{Value, json};
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

/// File of the resolved settings.
pub const CONFIG: &str = "config.resolved.toml";
/// File of the provenance: machine, method, data.
pub const PROVENANCE: &str = "provenance.json";
/// File of the training log, one JSON object per line.
pub const LOG: &str = "log.jsonl";
/// File of histograms logged while training, one JSON object per line.
pub const HISTOGRAMS: &str = "histograms.jsonl";
/// File of the method's events (moves of interval boundaries, for example), one JSON object per line.
pub const JOURNAL: &str = "journal.jsonl";
/// File of the scores of a training in rounds, after each round.
pub const ROUNDS: &str = "continual.json";
/// File of the scores of the finished run.
pub const METRICS: &str = "metrics.json";
/// File of the corrected training cameras, in runs that learn them.
pub const REFINED_CAMERAS: &str = "refined-cameras.json";
/// File of the HTML report.
pub const REPORT: &str = "report.html";
/// File of what is kept of the data: timestamps, splits, a few cameras.
pub const DATA: &str = "data.json";
/// File of a few training cameras, in runs that have no [`DATA`].
pub const CAMERAS: &str = "cameras.json";
/// Key in [`METRICS`] of the digest of the data that were scored.
pub(crate) const DATA_DIGEST: &str = "data_digest";
const LOCK: &str = ".lock";
const CHECKPOINTS: &str = "checkpoints";
const RENDERS: &str = "renders";

/// Limits of the texts of a run. A line of a log has about 500 bytes.
const LIMITS: Limits = Limits { max_bytes: 1 << 30, ..Limits::DEFAULT };

/// A run folder, open for reading or for writing.
#[derive(Debug)]
pub struct RunFolder {
    root: PathBuf,
    /// Held while this value lives, if it is open for writing.
    _lock: Option<File>,
}

/// The files that a run begins with.
#[derive(Clone, Copy, Debug, Default)]
pub struct Beginning<'a> {
    /// Content of [`CONFIG`].
    pub config: &'a str,
    /// Content of [`PROVENANCE`].
    pub provenance: &'a str,
    /// Content of [`DATA`].
    pub data: &'a str,
}

impl RunFolder {
    /// Creates a run folder with its [`CONFIG`], [`PROVENANCE`] and [`DATA`]. With `overwrite`, the files of an older run in it are
    /// removed first, by name; anything else stays.
    ///
    /// A folder that is missing or empty is made beside its place and renamed, so that it is there whole or not at all. Any
    /// other, or one that cannot be renamed to (a mount point, a link, a folder in one that is not writable), is filled in
    /// place, and the configuration is replaced last: killed before that, an older run keeps its configuration but has lost
    /// its results, and a folder without an older run holds nothing but empty folders, [`PROVENANCE`], [`DATA`], the lock
    /// and temporary files, which counts as empty.
    ///
    /// # Errors
    /// If it holds files already (without `overwrite`, or files that are not a run's), or the system refuses.
    pub fn create(root: &Path, overwrite: bool, beginning: &Beginning<'_>) -> Result<Self, RunError> {
        let lock = begin::begin(root, overwrite, beginning)?;
        Ok(Self { root: root.to_owned(), _lock: Some(lock) })
    }

    /// Opens a run for reading.
    ///
    /// # Errors
    /// If the folder is no run.
    pub fn open(root: &Path) -> Result<Self, RunError> {
        if is_run(root) {
            Ok(Self { root: root.to_owned(), _lock: None })
        } else {
            Err(RunError::NotARun { path: root.to_owned() })
        }
    }

    /// Opens the run of a checkpoint for reading.
    ///
    /// # Errors
    /// If the checkpoint lies in no run folder.
    pub fn around(checkpoint: &Path) -> Result<Self, RunError> {
        match checkpoint.parent().and_then(Path::parent) {
            Some(root) if checkpoint.parent() == Some(&root.join(CHECKPOINTS)) => Self::open(root),
            _ => Err(RunError::NoSettings { path: checkpoint.to_owned() }),
        }
    }

    /// Opens a run for writing, to continue it.
    ///
    /// # Errors
    /// If the folder is no run or another process is writing to it.
    pub fn open_to_write(root: &Path) -> Result<Self, RunError> {
        let folder = Self::open(root)?;
        Ok(Self { _lock: Some(lock(root)?), ..folder })
    }

    /// Path of the folder, as it was opened.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Path of the folder of checkpoints.
    pub fn checkpoints(&self) -> PathBuf {
        self.root.join(CHECKPOINTS)
    }

    /// Path of the folder of images.
    pub fn renders(&self) -> PathBuf {
        self.root.join(RENDERS)
    }

    /// Writes a file of the run, whole or not at all.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn write(&self, name: &str, content: &str) -> Result<(), RunError> {
        Ok(write_file(&self.root.join(name), true, |out| out.write_all(content.as_bytes()))?)
    }

    /// Writes [`METRICS`]: scores, with the digest of the data they were made on.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn write_scores(&self, mut scores: Value, dataset: &Dataset) -> Result<(), RunError> {
        scores[DATA_DIGEST] = json!(provenance::digest(dataset));
        self.write(METRICS, &format!("{scores:#}\n"))
    }

    /// Reads a text file of the run.
    ///
    /// # Errors
    /// If the system refuses or it is not UTF-8.
    pub fn read(&self, name: &str) -> Result<String, RunError> {
        Ok(read_text(&self.root.join(name), &LIMITS)?)
    }

    /// [`LOG`], [`HISTOGRAMS`] or [`JOURNAL`], to add lines.
    pub(crate) fn log(&self, name: &str) -> Log {
        Log::new(self.root.join(name))
    }

    /// The lines of [`LOG`], [`HISTOGRAMS`] or [`JOURNAL`]. A line cut short by a kill is left out.
    ///
    /// # Errors
    /// If the system refuses; a missing file is empty.
    pub fn log_lines(&self, name: &str) -> Result<Vec<Value>, RunError> {
        let path = self.root.join(name);
        let text = if path.exists() { read_text(&path, &LIMITS)? } else { String::new() };
        Ok(text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect())
    }

    /// What [`Training::begin_on`](crate::Training::begin_on) was given for a training in rounds: an object with the `command`
    /// that goes on with it. `None` for any other run.
    pub fn rounds(&self) -> Option<Value> {
        let mut provenance: Value = serde_json::from_str(&self.read(PROVENANCE).ok()?).ok()?;
        Some(provenance.get_mut("rounds")?.take()).filter(|rounds| !rounds.is_null())
    }

    /// Removes the lines of all logs of steps after `step`, which will be made again.
    ///
    /// # Errors
    /// If the system refuses.
    pub(crate) fn cut_logs(&self, step: u32) -> Result<(), RunError> {
        [LOG, HISTOGRAMS, JOURNAL].into_iter().try_for_each(|name| self.cut_log(name, step).map(drop))
    }

    /// Removes lines of [`LOG`], [`HISTOGRAMS`] or [`JOURNAL`] of steps after `step`, which will be made again; returns the rest.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn cut_log(&self, name: &str, step: u32) -> Result<Vec<Value>, RunError> {
        let mut lines = self.log_lines(name)?;
        lines.retain(|line| line["step"].as_u64().is_some_and(|s| s <= u64::from(step)));
        let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
        if self.root.join(name).exists() {
            self.write(name, &text)?;
        }
        Ok(lines)
    }
}

fn is_run(root: &Path) -> bool {
    root.join(CONFIG).is_file()
}

fn lock(root: &Path) -> Result<File, RunError> {
    let path = root.join(LOCK);
    let file = disk::open_lock(&path).map_err(|e| RunError::io("open", &path, e))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(RunError::Busy { path: root.to_owned() }),
        Err(TryLockError::Error(e)) => Err(RunError::io("lock", &path, e)),
    }
}

/// What the runs of tests begin with.
#[cfg(test)]
const BEGINNING: Beginning<'static> = Beginning {
    config: "x = 1\n",
    provenance: r#"{"machine": {}, "started": "", "method": "static3d"}"#,
    data: r#"{"times": [], "splits": {}, "held_out": []}"#,
};

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn create(root: &Path, overwrite: bool) -> Result<RunFolder, RunError> {
        RunFolder::create(root, overwrite, &BEGINNING)
    }

    #[test]
    fn nothing_is_overwritten_unasked_and_foreign_files_never() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("a/run");
        let run = create(&root, false).unwrap();
        run.write(METRICS, "{}").unwrap();
        fs::write(run.checkpoints().join("step-000001.gs4d"), "x").unwrap();
        fs::write(root.join("notes.txt"), "mine").unwrap();
        drop(run);
        assert!(matches!(create(&root, false), Err(RunError::Occupied { is_run: true, .. })));
        let run = create(&root, true).unwrap();
        assert!(!root.join(METRICS).exists() && fs::read_dir(run.checkpoints()).unwrap().next().is_none());
        assert_eq!(fs::read_to_string(root.join("notes.txt")).unwrap(), "mine");
        drop(run);
        let foreign = dir.path().join("photos");
        fs::create_dir(&foreign).unwrap();
        fs::write(foreign.join("cat.png"), "x").unwrap();
        assert!(matches!(create(&foreign, true), Err(RunError::Occupied { is_run: false, .. })));
        assert!(matches!(RunFolder::open(&foreign), Err(RunError::NotARun { .. })));
    }

    #[test]
    fn one_writer_at_a_time() {
        let dir = tempfile::tempdir().unwrap();
        let run = create(dir.path(), false).unwrap();
        assert!(matches!(RunFolder::open_to_write(dir.path()), Err(RunError::Busy { .. })));
        assert!(RunFolder::open(dir.path()).is_ok());
        drop(run);
        assert!(RunFolder::open_to_write(dir.path()).is_ok());
    }

    #[test]
    fn the_log_survives_a_torn_line_and_is_cut_at_a_step() {
        let dir = tempfile::tempdir().unwrap();
        let run = create(dir.path(), false).unwrap();
        assert!(run.log_lines(LOG).unwrap().is_empty());
        let ignore = |_: &str| {};
        let mut log = run.log(LOG);
        for step in [10, 20, 30] {
            log.add(&json!({"step": step, "loss": 0.5}), &ignore);
        }
        let mut torn = fs::read_to_string(dir.path().join(LOG)).unwrap();
        torn.push_str("{\"step\": 40, \"lo");
        fs::write(dir.path().join(LOG), torn).unwrap();
        assert_eq!(run.log_lines(LOG).unwrap().len(), 3);
        assert_eq!(run.cut_log(LOG, 20).unwrap().len(), 2);
        run.log(LOG).add(&json!({"step": 21}), &ignore);
        let steps: Vec<_> = run.log_lines(LOG).unwrap().iter().map(|l| l["step"].as_u64().unwrap()).collect();
        assert_eq!(steps, [10, 20, 21]);
        assert!(run.cut_log(HISTOGRAMS, 20).unwrap().is_empty() && !dir.path().join(HISTOGRAMS).exists());
    }
}
