//! Temporary files and folders: their names, and the removal of those that a killed process left.
//!
//! A temporary file of process PID is `.NAME.PID.COUNTER.gs4d.tmp`, beside NAME.

use super::disk;
use std::fs::{self, DirEntry, File};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

const SUFFIX: &str = ".gs4d.tmp";
/// Age at which a file without a living writer counts as left, where processes cannot be looked up.
const OLD: Duration = Duration::from_secs(3600);

/// A name for a temporary file or folder beside `path`: `.NAME.PID.COUNTER.gs4d.tmp`, never given twice by a process.
pub fn temporary_beside(path: &Path) -> PathBuf {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let number = COUNTER.fetch_add(1, Ordering::Relaxed);
    path.with_file_name(format!(".{name}.{}.{number}{SUFFIX}", std::process::id()))
}

/// The folder that holds `path`.
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// Removes the temporary files and folders in `folder` whose process is gone. `step-N.gs4d.tmp`, a name without a process,
/// goes when it is an hour old. What cannot be removed stays.
pub fn remove_abandoned(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten().filter(is_abandoned) {
        let folder = entry.file_type().is_ok_and(|t| t.is_dir());
        // Best effort: the next write tries again.
        let _ = if folder { disk::remove_folder(&entry.path()) } else { disk::remove_file(&entry.path()) };
    }
}

/// Whether a name is that of a temporary file or folder.
pub fn is_temporary(name: &str) -> bool {
    writer(name).is_some() || is_step(name)
}

fn is_abandoned(entry: &DirEntry) -> bool {
    let name = entry.file_name();
    let Some(name) = name.to_str().filter(|n| is_temporary(n)) else { return false };
    let path = entry.path();
    let left = match writer(name) {
        Some(process) => is_gone(process, &path),
        None => is_old(&path),
    };
    // A writer that cannot be seen from here, in another container for example, still holds its lock.
    let unlocked = || match entry.file_type() {
        Ok(t) if t.is_file() => File::open(&path).is_ok_and(|file| file.try_lock().is_ok()),
        Ok(t) => t.is_dir() || t.is_symlink(),
        Err(_) => false,
    };
    left && unlocked()
}

/// The process in `.NAME.PID.COUNTER.gs4d.tmp`.
fn writer(name: &str) -> Option<u32> {
    let mut parts = name.strip_prefix('.')?.strip_suffix(SUFFIX)?.rsplitn(3, '.');
    let (counter, process) = (parts.next()?, parts.next()?);
    let target = parts.next()?;
    (!target.is_empty() && is_number(counter) && is_number(process)).then(|| process.parse().ok())?
}

fn is_step(name: &str) -> bool {
    name.strip_prefix("step-").and_then(|rest| rest.strip_suffix(SUFFIX)).is_some_and(is_number)
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit())
}

fn is_gone(process: u32, path: &Path) -> bool {
    if Path::new("/proc/self").exists() { !Path::new(&format!("/proc/{process}")).exists() } else { is_old(path) }
}

fn is_old(path: &Path) -> bool {
    let changed = path.symlink_metadata().and_then(|m| m.modified());
    changed.is_ok_and(|at| at.elapsed().is_ok_and(|age| age >= OLD))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_of_exactly_this_form_are_temporary() {
        let path = temporary_beside(Path::new("a/scene.ply"));
        let name = path.file_name().unwrap().to_str().unwrap();
        assert_eq!((path.parent(), writer(name)), (Some(Path::new("a")), Some(std::process::id())));
        assert_ne!(path, temporary_beside(Path::new("a/scene.ply")));
        for name in [".x.12.0.gs4d.tmp", ".a.b.ply.12.345.gs4d.tmp", "step-000120.gs4d.tmp"] {
            assert!(is_temporary(name), "{name}");
        }
        for name in [
            "x.12.0.gs4d.tmp",
            ".x.12.gs4d.tmp",
            "..12.0.gs4d.tmp",
            ".x.12.0.tmp",
            ".x.12.0.gs4d.tmp~",
            ".x.+1.0.gs4d.tmp",
            ".x.12..gs4d.tmp",
            ".x.99999999999.0.gs4d.tmp",
            "step-.gs4d.tmp",
            "step-1.gs4d",
            "my-step-1.gs4d.tmp",
        ] {
            assert!(!is_temporary(name), "{name}");
        }
        assert_eq!((folder_of(Path::new("x")), folder_of(Path::new("a/x"))), (Path::new("."), Path::new("a")));
    }

    #[test]
    fn what_a_gone_process_left_is_removed_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let mut child = std::process::Command::new("true").spawn().unwrap();
        let gone = child.id();
        child.wait().unwrap();
        let alive = std::process::id();
        let make = |name: String| fs::write(dir.path().join(name), "x").unwrap();
        make(format!(".a.{gone}.0.gs4d.tmp"));
        make(format!(".a.{alive}.0.gs4d.tmp"));
        make(format!(".locked.{gone}.0.gs4d.tmp"));
        make(format!("{gone}.0.gs4d.tmp"));
        fs::create_dir_all(dir.path().join(format!(".run.{gone}.1.gs4d.tmp/checkpoints"))).unwrap();
        let locked = File::open(dir.path().join(format!(".locked.{gone}.0.gs4d.tmp"))).unwrap();
        locked.lock().unwrap();
        make("step-000001.gs4d.tmp".into());
        make("step-000002.gs4d.tmp".into());
        let old = File::options().write(true).open(dir.path().join("step-000001.gs4d.tmp")).unwrap();
        old.set_modified(std::time::SystemTime::now() - OLD).unwrap();
        drop(old);
        remove_abandoned(dir.path());
        let mut left: Vec<_> =
            fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        left.sort();
        let mut expected = [
            format!(".a.{alive}.0.gs4d.tmp"),
            format!(".locked.{gone}.0.gs4d.tmp"),
            format!("{gone}.0.gs4d.tmp"),
            "step-000002.gs4d.tmp".into(),
        ];
        expected.sort();
        assert_eq!(left, expected);
    }
}
