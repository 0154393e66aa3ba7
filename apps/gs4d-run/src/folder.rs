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
use gs_core::io::{Limits, disk, folder_of, is_temporary, read_text, remove_abandoned, temporary_beside, write_file};
use serde_json::Value;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Write};
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

/// The files that a run begins with.
#[derive(Clone, Copy, Debug, Default)]
pub struct Beginning<'a> {
    /// Content of [`CONFIG`].
    pub config: &'a str,
    /// Content of [`PROVENANCE`].
    pub provenance: &'a str,
    /// Content of [`CAMERAS`].
    pub cameras: &'a str,
}

impl RunFolder {
    /// Creates a run folder with its [`CONFIG`], [`PROVENANCE`] and [`CAMERAS`]. With `overwrite`, the files of an older run in it are
    /// removed first; anything else stays.
    ///
    /// A folder that is missing or empty is made beside its place and renamed, so that it is there whole or not at all. Any
    /// other, or one that cannot be renamed to (a mount point, a link), is filled in place, and the configuration is replaced
    /// last: killed before that, an older run keeps its configuration but has lost its results, and a folder without an older
    /// run holds nothing but empty folders, [`PROVENANCE`], [`CAMERAS`], the lock and temporary files, which counts as empty.
    ///
    /// # Errors
    /// If it holds files already (without `overwrite`, or files that are not a run's), or the system refuses.
    pub fn create(root: &Path, overwrite: bool, beginning: &Beginning<'_>) -> Result<Self, RunError> {
        let lock = match begin_beside(root, beginning)? {
            Some(lock) => lock,
            None => {
                disk::create_folder(root).map_err(|e| RunError::io("create", root, e))?;
                check_vacant(root, overwrite)?;
                let lock = lock(root)?;
                // Another process may have begun a run since.
                check_vacant(root, overwrite)?;
                fill(root, beginning)?;
                lock
            }
        };
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

fn is_empty(folder: &Path) -> std::io::Result<bool> {
    Ok(fs::read_dir(folder)?.next().is_none())
}

/// Whether nothing is lost by beginning a run in a folder: it is empty, or the beginning of a run was cut off.
fn is_vacant(root: &Path) -> std::io::Result<bool> {
    for entry in fs::read_dir(root)? {
        let entry = entry?;
        let vacant = match entry.file_name().to_str() {
            Some(LOCK | PROVENANCE | CAMERAS) => true,
            Some(CHECKPOINTS | RENDERS) => is_empty(&entry.path())?,
            name => name.is_some_and(is_temporary),
        };
        if !vacant {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Refuses a folder that a run may not begin in.
fn check_vacant(root: &Path, overwrite: bool) -> Result<(), RunError> {
    let vacant = is_vacant(root).map_err(|e| RunError::io("list", root, e))?;
    let is_run = is_run(root);
    if vacant || (overwrite && is_run) { Ok(()) } else { Err(RunError::Occupied { path: root.to_owned(), is_run }) }
}

/// Makes a whole run folder beside a missing or empty one and renames it; returns its lock. `None` if there is something
/// already, or the system cannot rename to it.
fn begin_beside(root: &Path, beginning: &Beginning<'_>) -> Result<Option<File>, RunError> {
    if !is_empty(root).unwrap_or_else(|e| e.kind() == ErrorKind::NotFound) || root.file_name().is_none() {
        return Ok(None);
    }
    remove_abandoned(folder_of(root));
    let stage = temporary_beside(root);
    let made = disk::create_folder(&stage).map_err(|e| RunError::io("create", &stage, e)).and_then(|()| {
        let lock = lock(&stage)?;
        fill(&stage, beginning)?;
        Ok(lock)
    });
    let renamed = made.map(|lock| disk::rename(&stage, root).ok().map(|()| lock));
    match &renamed {
        Ok(Some(_)) => disk::sync_folder(folder_of(root)).map_err(|e| RunError::io("flush the folder of", root, e))?,
        // Best effort: the next run beside it tries again.
        _ => drop(disk::remove_folder(&stage)),
    }
    renamed
}

/// Makes what a run begins with, in place of an older run; the configuration last, as it makes the folder a run.
fn fill(folder: &Path, beginning: &Beginning<'_>) -> Result<(), RunError> {
    if is_run(folder) {
        remove_results(folder)?;
    }
    for name in [CHECKPOINTS, RENDERS] {
        let path = folder.join(name);
        disk::create_folder(&path).map_err(|e| RunError::io("create", &path, e))?;
    }
    let Beginning { config, provenance, cameras } = beginning;
    for (name, content) in [(CAMERAS, cameras), (PROVENANCE, provenance), (CONFIG, config)] {
        write_file(&folder.join(name), true, |out| out.write_all(content.as_bytes()))?;
    }
    Ok(())
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

/// Removes the results of an older run, by name.
fn remove_results(root: &Path) -> Result<(), RunError> {
    for name in [METRICS, REPORT, LOG, HISTOGRAMS, JOURNAL] {
        let path = root.join(name);
        disk::remove_file(&path).map_err(|e| RunError::io("remove", &path, e))?;
    }
    for name in [CHECKPOINTS, RENDERS] {
        let path = root.join(name);
        disk::remove_folder(&path).map_err(|e| RunError::io("remove", &path, e))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::testkit::faults::{Fault, Faults, with_faults};
    use serde_json::json;

    fn create(root: &Path, overwrite: bool) -> Result<RunFolder, RunError> {
        let beginning = Beginning { config: "x = 1\n", provenance: "{}\n", cameras: "[]\n" };
        RunFolder::create(root, overwrite, &beginning)
    }

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    const WHOLE: [&str; 6] = [LOCK, CAMERAS, CHECKPOINTS, CONFIG, PROVENANCE, RENDERS];

    #[test]
    fn whichever_operation_fails_a_new_folder_is_whole_or_not_there() {
        for prepared in [false, true] {
            for first in 1.. {
                let dir = tempfile::tempdir().unwrap();
                let root = dir.path().join("run");
                if prepared {
                    fs::create_dir(&root).unwrap();
                }
                let faults = Faults { first, count: 100, kind: Fault::Full };
                let (made, operations) = with_faults(Some(faults), || create(&root, false).map(drop));
                if operations < first {
                    assert_eq!(operations, 21);
                    break;
                }
                assert!(made.unwrap_err().to_string().contains("cannot "), "{first}");
                let left = names(dir.path());
                assert!(left.is_empty() || left == ["run"], "{first}: {left:?}");
                let left = if root.exists() { names(&root) } else { Vec::new() };
                assert!(left.is_empty() || left == WHOLE, "{first}: {left:?}");
                create(&root, true).unwrap();
                assert_eq!(names(&root), WHOLE);
            }
        }
    }

    #[test]
    fn the_beginning_of_a_run_counts_as_empty_and_is_made_whole() {
        let dir = tempfile::tempdir().unwrap();
        for overwrite in [false, true] {
            let root = dir.path().join(format!("{overwrite}"));
            fs::create_dir_all(root.join(CHECKPOINTS)).unwrap();
            fs::create_dir_all(root.join(RENDERS)).unwrap();
            for name in [LOCK, PROVENANCE, ".config.resolved.toml.4194999.0.gs4d.tmp"] {
                fs::write(root.join(name), "").unwrap();
            }
            create(&root, overwrite).unwrap();
            assert_eq!(names(&root), WHOLE);
        }
        let root = dir.path().join("kept");
        fs::create_dir_all(root.join(CHECKPOINTS)).unwrap();
        fs::write(root.join(CHECKPOINTS).join("step-000001.gs4d"), "x").unwrap();
        assert!(matches!(create(&root, true), Err(RunError::Occupied { is_run: false, .. })), "results are not lost");
    }

    #[test]
    fn whichever_operation_fails_an_older_run_stays_a_run() {
        for first in 1.. {
            let dir = tempfile::tempdir().unwrap();
            let run = create(dir.path(), false).unwrap();
            run.write(METRICS, "{}").unwrap();
            fs::write(dir.path().join("notes.txt"), "mine").unwrap();
            drop(run);
            let faults = Faults { first, count: 1, kind: Fault::Device };
            let (made, operations) = with_faults(Some(faults), || create(dir.path(), true).map(drop));
            if operations < first {
                break;
            }
            assert!(made.unwrap_err().to_string().contains("cannot "), "{first}");
            assert!(RunFolder::open(dir.path()).is_ok(), "{first}");
            create(dir.path(), true).unwrap();
            assert!(!dir.path().join(METRICS).exists() && dir.path().join("notes.txt").exists(), "{first}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn what_cannot_be_renamed_to_is_filled_in_place() {
        let dir = tempfile::tempdir().unwrap();
        let (target, root) = (dir.path().join("volume"), dir.path().join("run"));
        fs::create_dir(&target).unwrap();
        std::os::unix::fs::symlink(&target, &root).unwrap();
        create(&root, false).unwrap();
        assert_eq!(
            (names(&root), names(dir.path())),
            (WHOLE.map(String::from).to_vec(), vec!["run".into(), "volume".into()])
        );
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
