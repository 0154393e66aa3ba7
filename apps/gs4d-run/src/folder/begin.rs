//! Making a run folder so that it is there whole or not at all.

use super::{
    Beginning, CAMERAS, CHECKPOINTS, CONFIG, DATA, HISTOGRAMS, JOURNAL, LIMITS, LOCK, LOG, METRICS, PROVENANCE,
    REFINED_CAMERAS, RENDERS, REPORT, ROUNDS, RunError, is_run, lock,
};
use gs_core::io::{disk, folder_of, is_temporary, read_text, remove_abandoned, temporary_beside, write_file};
use serde_json::Value;
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
            Some(LOCK) => true,
            Some(PROVENANCE) => is_json_with(&entry.path(), &["machine", "started", "method"]),
            Some(DATA) => is_json_with(&entry.path(), &["times", "splits", "held_out"]),
            Some(CHECKPOINTS | RENDERS) => is_empty(&entry.path())?,
            name => name.is_some_and(is_temporary),
        };
        if !vacant {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Whether a file is a JSON object with these keys, as gs4d writes it.
fn is_json_with(path: &Path, keys: &[&str]) -> bool {
    let json = read_text(path, &LIMITS).ok().and_then(|text| serde_json::from_str::<Value>(&text).ok());
    json.is_some_and(|json| keys.iter().all(|key| json.get(key).is_some()))
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
    remove_own(&root.join(CHECKPOINTS), |name| name == "latest" || after_step(name) == Some(".gs4d"))?;
    remove_own(&root.join(RENDERS), |name| after_step(name).is_some_and(|r| r.starts_with('_') && r.ends_with(".png")))
}

/// Removes the files of a folder, if there is one, that gs4d wrote there: temporary ones, and those with such names.
fn remove_own(folder: &Path, is_own: impl Fn(&str) -> bool) -> Result<(), RunError> {
    let failed = |e| RunError::io("list", folder, e);
    let entries = match fs::read_dir(folder) {
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(()),
        entries => entries.map_err(failed)?,
    };
    for entry in entries {
        let entry = entry.map_err(failed)?;
        let is_file = !entry.file_type().map_err(failed)?.is_dir();
        if is_file && entry.file_name().to_str().is_some_and(|name| is_temporary(name) || is_own(name)) {
            disk::remove_file(&entry.path()).map_err(|e| RunError::io("remove", &entry.path(), e))?;
        }
    }
    Ok(())
}

/// What follows a step of at least six digits in the name of a file that is of one, such as `step-000040_view.png`.
fn after_step(name: &str) -> Option<&str> {
    let number = name.strip_prefix("step-")?;
    let rest = number.trim_start_matches(|c: char| c.is_ascii_digit());
    (number.len() - rest.len() >= 6).then_some(rest)
}

#[cfg(test)]
mod tests {
    use super::super::{BEGINNING, RunFolder};
    use super::*;
    use gs_core::testkit::faults::{Fault, Faults, with_faults};

    fn create(root: &Path, overwrite: bool) -> Result<RunFolder, RunError> {
        RunFolder::create(root, overwrite, &BEGINNING)
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
            for name in [LOCK, ".config.resolved.toml.4194999.0.gs4d.tmp"] {
                fs::write(root.join(name), "").unwrap();
            }
            fs::write(root.join(PROVENANCE), BEGINNING.provenance).unwrap();
            fs::write(root.join(DATA), BEGINNING.data).unwrap();
            create(&root, overwrite).unwrap();
            assert_eq!(names(&root), WHOLE);
        }
        let root = dir.path().join("kept");
        fs::create_dir_all(root.join(CHECKPOINTS)).unwrap();
        fs::write(root.join(CHECKPOINTS).join("step-000001.gs4d"), "x").unwrap();
        assert!(matches!(create(&root, true), Err(RunError::Occupied { is_run: false, .. })), "results are not lost");
    }

    #[test]
    fn files_of_a_user_with_the_names_of_ours_are_not_replaced() {
        let dir = tempfile::tempdir().unwrap();
        for (k, (name, content)) in
            [(PROVENANCE, "{\"machine\": \"mine\"}"), (DATA, "[1, 2]"), (DATA, ""), (CAMERAS, BEGINNING.data)]
                .into_iter()
                .enumerate()
        {
            let root = dir.path().join(k.to_string());
            fs::create_dir(&root).unwrap();
            fs::write(root.join(name), content).unwrap();
            for overwrite in [false, true] {
                assert!(matches!(create(&root, overwrite), Err(RunError::Occupied { is_run: false, .. })), "{name}");
            }
            assert_eq!(fs::read_to_string(root.join(name)).unwrap(), content);
            assert_eq!(names(&root), [name]);
        }
    }

    #[test]
    fn an_older_run_loses_what_we_wrote_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        drop(create(dir.path(), false).unwrap());
        let own = ["step-000040.gs4d", "step-1000000.gs4d", "latest", ".step-000041.gs4d.4194999.0.gs4d.tmp"]
            .map(|name| dir.path().join(CHECKPOINTS).join(name))
            .into_iter()
            .chain(["step-000040_r_001.png", "step-000040_.png"].map(|name| dir.path().join(RENDERS).join(name)));
        let own: Vec<_> = own.collect();
        let foreign = ["checkpoints/best.gs4d", "checkpoints/step-1.gs4d", "renders/step-000040.png", "renders/me.png"]
            .map(|name| dir.path().join(name));
        own.iter().chain(&foreign).for_each(|path| fs::write(path, "x").unwrap());
        fs::create_dir(dir.path().join("renders/orbit")).unwrap();
        drop(create(dir.path(), true).unwrap());
        assert!(own.iter().all(|path| !path.exists()) && foreign.iter().all(|path| path.exists()));
        assert!(dir.path().join("renders/orbit").is_dir());
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
