//! Making a run folder so that it is there whole or not at all.

use super::{
    Beginning, CAMERAS, CHECKPOINTS, CONFIG, DATA, HISTOGRAMS, JOURNAL, LOCK, LOG, METRICS, PROVENANCE,
    REFINED_CAMERAS, RENDERS, REPORT, ROUNDS, RunError, is_run, lock,
};
use gs_core::io::{disk, folder_of, is_temporary, remove_abandoned, temporary_beside, write_file};
use std::fs::{self, File};
use std::io::ErrorKind;
use std::path::Path;

/// Begins a run in a folder ([`RunFolder::create`](super::RunFolder::create)); returns its lock.
pub(super) fn begin(root: &Path, overwrite: bool, beginning: &Beginning<'_>) -> Result<File, RunError> {
    if let Some(lock) = begin_beside(root, beginning)? {
        return Ok(lock);
    }
    disk::create_folder(root).map_err(|e| RunError::io("create", root, e))?;
    check_vacant(root, overwrite)?;
    let lock = lock(root)?;
    // Another process may have begun a run since.
    check_vacant(root, overwrite)?;
    fill(root, beginning)?;
    Ok(lock)
}

fn is_empty(folder: &Path) -> std::io::Result<bool> {
    Ok(fs::read_dir(folder)?.next().is_none())
}

/// Whether nothing is lost by beginning a run in a folder: it is empty, or the beginning of a run was cut off.
fn is_vacant(root: &Path) -> std::io::Result<bool> {
    for entry in fs::read_dir(root)? {
        let entry = entry?;
        let vacant = match entry.file_name().to_str() {
            Some(LOCK | PROVENANCE | CAMERAS | DATA) => true,
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
/// already, an empty folder has nowhere to make another beside it, or the system cannot rename to it.
fn begin_beside(root: &Path, beginning: &Beginning<'_>) -> Result<Option<File>, RunError> {
    if !is_empty(root).unwrap_or_else(|e| e.kind() == ErrorKind::NotFound) || root.file_name().is_none() {
        return Ok(None);
    }
    remove_abandoned(folder_of(root));
    let stage = temporary_beside(root);
    match disk::create_folder(&stage) {
        Err(_) if root.exists() => return Ok(None),
        created => created.map_err(|e| RunError::io("create", root, e))?,
    }
    let made = lock(&stage).and_then(|lock| fill(&stage, beginning).map(|()| lock));
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
    let Beginning { config, provenance, data } = beginning;
    for (name, content) in [(DATA, data), (PROVENANCE, provenance), (CONFIG, config)] {
        write_file(&folder.join(name), true, |out| out.write_all(content.as_bytes()))?;
    }
    Ok(())
}

/// Removes the results of an older run, by name.
fn remove_results(root: &Path) -> Result<(), RunError> {
    for name in [CAMERAS, METRICS, REFINED_CAMERAS, REPORT, ROUNDS, LOG, HISTOGRAMS, JOURNAL] {
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
    use super::super::RunFolder;
    use super::*;
    use gs_core::testkit::faults::{Fault, Faults, with_faults};

    fn create(root: &Path, overwrite: bool) -> Result<RunFolder, RunError> {
        let beginning = Beginning { config: "x = 1\n", provenance: "{}\n", data: "{}\n" };
        RunFolder::create(root, overwrite, &beginning)
    }

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    const WHOLE: [&str; 6] = [LOCK, CHECKPOINTS, CONFIG, DATA, PROVENANCE, RENDERS];

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

    #[test]
    fn an_empty_folder_in_one_that_cannot_be_written_is_filled_in_place() {
        let dir = tempfile::tempdir().unwrap();
        let faults = Faults { first: 1, count: 1, kind: Fault::Device };
        with_faults(Some(faults), || create(dir.path(), false)).0.unwrap();
        assert_eq!(names(dir.path()), WHOLE);
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
}
