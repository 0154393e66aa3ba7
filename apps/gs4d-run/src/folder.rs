//! The run folder on disk.
//!
//! ```text
//! RUN/config.resolved.toml   every setting with its source
//! RUN/provenance.json        version, CPU, threads, seed, digest of the data, layout, time source, split sizes
//! RUN/cameras.json           a few of the training cameras, for where the data are not
//! RUN/log.jsonl              one JSON object per line: step, seconds, loss terms, counts, milliseconds, memory
//! RUN/histograms.jsonl       histograms of attributes of the splats, where the method has any
//! RUN/journal.jsonl          events of the method (moves of interval boundaries, growth of anchors)
//! RUN/checkpoints/           step-012000.gs4d …, latest
//! RUN/metrics.json           scores per view and their means
//! RUN/renders/               images; names carry step, time and camera
//! RUN/report.html            the report
//! ```
//! A writer holds a lock, which the system releases when the process ends.

use super::RunError;
use gs_core::io::{Limits, read_text, write_file};
use serde_json::Value;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::Write;
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
/// File of the scores of the finished run.
pub const METRICS: &str = "metrics.json";
/// File of the HTML report.
pub const REPORT: &str = "report.html";
/// File of a few of the training cameras.
pub const CAMERAS: &str = "cameras.json";
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

impl RunFolder {
    /// Creates a run folder. With `overwrite`, the files of an older run in it are removed first; anything else stays.
    ///
    /// # Errors
    /// If it holds files already (without `overwrite`, or files that are not a run's), or the system refuses.
    pub fn create(root: &Path, overwrite: bool) -> Result<Self, RunError> {
        fs::create_dir_all(root).map_err(|e| RunError::io("create", root, e))?;
        let mut entries = fs::read_dir(root).map_err(|e| RunError::io("list", root, e))?;
        let occupied = entries.any(|e| e.is_ok_and(|e| e.file_name() != LOCK));
        if occupied && !(overwrite && is_run(root)) {
            return Err(RunError::Occupied { path: root.to_owned(), is_run: is_run(root) });
        }
        let lock = lock(root)?;
        if occupied {
            remove_older(root)?;
        }
        for folder in [CHECKPOINTS, RENDERS] {
            let path = root.join(folder);
            fs::create_dir_all(&path).map_err(|e| RunError::io("create", &path, e))?;
        }
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

    /// Reads a text file of the run.
    ///
    /// # Errors
    /// If the system refuses or it is not UTF-8.
    pub fn read(&self, name: &str) -> Result<String, RunError> {
        Ok(read_text(&self.root.join(name), &LIMITS)?)
    }

    /// Opens [`LOG`], [`HISTOGRAMS`] or [`JOURNAL`] to add lines.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn log(&self, name: &str) -> Result<Log, RunError> {
        let path = self.root.join(name);
        let file = OpenOptions::new().append(true).create(true).open(&path);
        Ok(Log { file: file.map_err(|e| RunError::io("open", &path, e))?, path })
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

/// A JSON-lines file, open for appending.
#[derive(Debug)]
pub struct Log {
    file: File,
    path: PathBuf,
}

impl Log {
    /// Adds one line in one write.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn add(&mut self, line: &Value) -> Result<(), RunError> {
        self.file.write_all(format!("{line}\n").as_bytes()).map_err(|e| RunError::io("write", &self.path, e))
    }
}

fn is_run(root: &Path) -> bool {
    root.join(CONFIG).is_file()
}

fn lock(root: &Path) -> Result<File, RunError> {
    let path = root.join(LOCK);
    let file = OpenOptions::new().write(true).create(true).truncate(false).open(&path);
    let file = file.map_err(|e| RunError::io("open", &path, e))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(RunError::Busy { path: root.to_owned() }),
        Err(TryLockError::Error(e)) => Err(RunError::io("lock", &path, e)),
    }
}

/// Removes the files of an older run, by name.
fn remove_older(root: &Path) -> Result<(), RunError> {
    let gone = |path: &Path, result: std::io::Result<()>| match result {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(RunError::io("remove", path, e)),
        _ => Ok(()),
    };
    for folder in [CHECKPOINTS, RENDERS] {
        let path = root.join(folder);
        gone(&path, fs::remove_dir_all(&path))?;
    }
    // The configuration goes last: until then the folder is still known as a run.
    for file in [PROVENANCE, CAMERAS, LOG, HISTOGRAMS, JOURNAL, METRICS, REPORT, CONFIG] {
        let path = root.join(file);
        gone(&path, fs::remove_file(&path))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn nothing_is_overwritten_unasked_and_foreign_files_never() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("a/run");
        let run = RunFolder::create(&root, false).unwrap();
        run.write(CONFIG, "x = 1\n").unwrap();
        run.write(METRICS, "{}").unwrap();
        fs::write(run.checkpoints().join("step-000001.gs4d"), "x").unwrap();
        fs::write(root.join("notes.txt"), "mine").unwrap();
        drop(run);
        assert!(matches!(RunFolder::create(&root, false), Err(RunError::Occupied { is_run: true, .. })));
        let run = RunFolder::create(&root, true).unwrap();
        assert!(!root.join(METRICS).exists() && fs::read_dir(run.checkpoints()).unwrap().next().is_none());
        assert_eq!(fs::read_to_string(root.join("notes.txt")).unwrap(), "mine");
        drop(run);
        let foreign = dir.path().join("photos");
        fs::create_dir(&foreign).unwrap();
        fs::write(foreign.join("cat.png"), "x").unwrap();
        assert!(matches!(RunFolder::create(&foreign, true), Err(RunError::Occupied { is_run: false, .. })));
        assert!(matches!(RunFolder::open(&foreign), Err(RunError::NotARun { .. })));
    }

    #[test]
    fn one_writer_at_a_time() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunFolder::create(dir.path(), false).unwrap();
        run.write(CONFIG, "").unwrap();
        assert!(matches!(RunFolder::open_to_write(dir.path()), Err(RunError::Busy { .. })));
        assert!(RunFolder::open(dir.path()).is_ok());
        drop(run);
        assert!(RunFolder::open_to_write(dir.path()).is_ok());
    }

    #[test]
    fn the_log_survives_a_torn_line_and_is_cut_at_a_step() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunFolder::create(dir.path(), false).unwrap();
        assert!(run.log_lines(LOG).unwrap().is_empty());
        let mut log = run.log(LOG).unwrap();
        for step in [10, 20, 30] {
            log.add(&json!({"step": step, "loss": 0.5})).unwrap();
        }
        log.file.write_all(b"{\"step\": 40, \"lo").unwrap();
        assert_eq!(run.log_lines(LOG).unwrap().len(), 3);
        assert_eq!(run.cut_log(LOG, 20).unwrap().len(), 2);
        run.log(LOG).unwrap().add(&json!({"step": 21})).unwrap();
        let steps: Vec<_> = run.log_lines(LOG).unwrap().iter().map(|l| l["step"].as_u64().unwrap()).collect();
        assert_eq!(steps, [10, 20, 21]);
        assert!(run.cut_log(HISTOGRAMS, 20).unwrap().is_empty() && !dir.path().join(HISTOGRAMS).exists());
    }
}
