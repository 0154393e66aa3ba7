//! Writing a file whole or not at all.
//!
//! The content goes to a temporary file in the same folder, which is flushed to the disk and renamed; then the folder is
//! flushed. A process killed at any moment leaves the older file or the newer one, and perhaps a temporary file, which the
//! next write into the folder removes.

use super::IoError;
use super::disk::{self, DiskFile};
use super::error::os;
use super::temporary::{folder_of, remove_abandoned, temporary_beside};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// How long the bytes of a file are still counted after the disk is full.
const COUNTED_ON: Duration = Duration::from_secs(2);

/// Writes a file completely or not at all, and returns what `content` returned. Without `overwrite` an existing target is kept
/// (checked before and after the content is written). Any number of writers of one file may run at once.
///
/// # Errors
/// [`IoError::Exists`], [`IoError::Full`], or the system's. The older file is as it was then, unless only the folder could not
/// be flushed; the temporary file is removed.
pub fn write_file<T>(
    path: &Path,
    overwrite: bool,
    content: impl FnOnce(&mut dyn Write) -> io::Result<T>,
) -> Result<T, IoError> {
    let free = || match path.symlink_metadata() {
        Ok(_) if !overwrite => Err(IoError::Exists { file: path.display().to_string().into() }),
        _ => Ok(()),
    };
    free()?;
    let folder = folder_of(path);
    remove_abandoned(folder);
    let (temporary, file) = create_beside(path).map_err(|e| os(path, "create a temporary file beside it", e))?;
    // The file stays open, and with it its lock, until it has its name.
    let mut file = Measured { file, bytes: 0, full: None };
    let written = fill(&mut file, path, content).and_then(|made| {
        free()?;
        disk::rename(&temporary, path).map_err(|e| os(path, "rename the finished file to it", e))?;
        Ok(made)
    });
    if written.is_err() {
        // Best effort: the first error is the one that is returned.
        let _ = disk::remove_file(&temporary);
    }
    let made = written?;
    disk::sync_folder(folder).map_err(|e| os(path, "flush the folder of", e))?;
    Ok(made)
}

fn create_beside(path: &Path) -> io::Result<(PathBuf, DiskFile)> {
    loop {
        let temporary = temporary_beside(path);
        match DiskFile::create_new(&temporary) {
            // Left by a process that had this one's number.
            Err(e) if e.kind() == ErrorKind::AlreadyExists => {}
            created => return Ok((temporary, created?)),
        }
    }
}

fn fill<T>(
    file: &mut Measured,
    path: &Path,
    content: impl FnOnce(&mut dyn Write) -> io::Result<T>,
) -> Result<T, IoError> {
    let mut out = BufWriter::with_capacity(1 << 18, &mut *file);
    let made = content(&mut out).and_then(|made| out.flush().map(|()| made));
    // What is still in the buffer belongs to a file that failed.
    let _ = out.into_parts();
    let whole = made.is_ok();
    let made = made.and_then(|made| file.sync().map(|()| made));
    match file.full.take() {
        Some((source, _)) => {
            Err(IoError::Full { file: path.display().to_string().into(), source, needed: file.bytes, whole })
        }
        None => made.map_err(|e| os(path, "write", e)),
    }
}

/// Passes bytes on to a file. Once the disk is full it counts the rest for a while, so that the error can say how many bytes
/// the file needs.
struct Measured {
    file: DiskFile,
    bytes: u64,
    full: Option<(io::Error, Instant)>,
}

impl Measured {
    fn sync(&mut self) -> io::Result<()> {
        match self.full {
            Some(_) => Ok(()),
            None => self.file.sync().or_else(|e| self.stop_if_full(e)),
        }
    }

    /// Remembers that the disk is full; any other error is returned.
    fn stop_if_full(&mut self, e: io::Error) -> io::Result<()> {
        if !matches!(e.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded) {
            return Err(e);
        }
        self.full = Some((e, Instant::now()));
        Ok(())
    }
}

impl Write for Measured {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = match &self.full {
            Some((_, since)) if since.elapsed() > COUNTED_ON => return Err(ErrorKind::StorageFull.into()),
            Some(_) => bytes.len(),
            None => self.file.write(bytes).or_else(|e| self.stop_if_full(e).map(|()| bytes.len()))?,
        };
        self.bytes += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testkit::faults::{Fault, Faults, with_faults};
    use std::fs;

    /// More than the buffer holds, so that a file is written in several operations.
    const LENGTH: usize = 600_000;

    fn save(path: &Path, byte: u8) -> Result<(), IoError> {
        write_file(path, true, |out| (0..LENGTH / 1000).try_for_each(|_| out.write_all(&[byte; 1000])))
    }

    #[test]
    fn a_failed_write_leaves_the_old_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("keep.txt");
        write_file(&path, false, |out| out.write_all(b"old")).unwrap();
        let fail = |out: &mut dyn Write| -> io::Result<()> {
            out.write_all(b"new")?;
            Err(io::Error::other("stop"))
        };
        assert!(write_file(&path, true, fail).unwrap_err().to_string().contains("stop"));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
        assert!(write_file(&dir.path().join("no/such/folder"), false, |_| Ok(())).is_err());
    }

    #[test]
    fn whichever_operation_fails_the_file_is_the_older_or_the_newer() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scene.ply");
        let (written, operations) = with_faults(None, || save(&path, b'o'));
        written.unwrap();
        assert_eq!(operations, 7, "create, three writes, flush, rename, flush of the folder");
        let mut newer = 0;
        for kind in [Fault::Full, Fault::Files, Fault::Device] {
            for first in 1..=operations {
                save(&path, b'o').unwrap();
                let (written, _) = with_faults(Some(Faults { first, count: 1, kind }), || save(&path, b'n'));
                let content = fs::read(&path).unwrap();
                let name = format!("{kind:?} at {first}");
                assert!(content.len() == LENGTH && content.iter().all(|&b| b == content[0]), "{name}: a mixture");
                assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "{name}: a temporary file stays");
                newer += u32::from(content[0] == b'n');
                match written {
                    Ok(()) => assert!(content[0] == b'n' && kind == Fault::Files, "{name}"),
                    Err(e) => {
                        let text = e.to_string();
                        assert!(text.contains("scene.ply") && text.contains("cannot "), "{name}: {text}");
                        assert_eq!(content[0] == b'n', first == operations, "{name}: only the folder was not flushed");
                    }
                }
            }
        }
        assert_eq!(newer, 1 + (1 + 5) + 1, "in the rest the older file stays");
    }

    #[test]
    fn a_full_disk_says_how_many_bytes_are_needed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scene.ply");
        // From the first write on, and when the bytes are flushed.
        for (first, count) in [(2, 100), (3, 1), (5, 1)] {
            let faults = Faults { first, count, kind: Fault::Full };
            let error = with_faults(Some(faults), || save(&path, b'n')).0.unwrap_err();
            assert!(matches!(error, IoError::Full { needed: 600_000, whole: true, .. }), "{error}");
            let text = error.to_string();
            let start = format!("cannot write {}: no space left on device", path.display());
            assert!(text.to_lowercase().starts_with(&start.to_lowercase()), "{text}");
            assert!(text.ends_with("; 600000 bytes are needed"), "{text}");
            assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
        }
    }

    #[test]
    fn content_that_takes_long_to_make_ends_soon_after_the_disk_is_full() {
        let dir = tempfile::tempdir().unwrap();
        let begun = Instant::now();
        let endless = |out: &mut dyn Write| -> io::Result<()> {
            loop {
                out.write_all(&[0; 1 << 18])?;
            }
        };
        let faults = Faults { first: 3, count: 1, kind: Fault::Full };
        let path = dir.path().join("video.y4m");
        let error = with_faults(Some(faults), || write_file(&path, false, endless)).0.unwrap_err();
        assert!(error.to_string().contains("; more than ") && begun.elapsed() < 10 * COUNTED_ON, "{error}");
    }

    #[test]
    fn threads_that_write_one_file_leave_one_of_their_contents() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scene.ply");
        for _ in 0..50 {
            std::thread::scope(|scope| {
                b"abcd".iter().for_each(|&byte| {
                    drop(scope.spawn({
                        let path = &path;
                        move || save(path, byte).unwrap()
                    }))
                });
            });
            let content = fs::read(&path).unwrap();
            assert!(content.len() == LENGTH && content.iter().all(|&b| b == content[0]));
            assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1);
        }
    }
}
