//! Operations that change the file system. All that is written for a user passes through them, so that a test can make the
//! k-th of them fail (`testkit::faults`, feature `testkit`).
//!
//! Errors are the system's, without a path.

#[cfg(feature = "testkit")]
use crate::testkit::faults::before;
use std::fs;
use std::io::{self, Write};
use std::path::Path;

/// Kinds of operations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operation {
    /// Creating or opening a file, folder or link for writing.
    Create,
    /// Handing bytes to the system.
    Write,
    /// Flushing a file or folder to the disk.
    Flush,
    /// Renaming.
    Rename,
    /// Removing.
    Remove,
}

#[cfg(not(feature = "testkit"))]
fn before(_: Operation) -> io::Result<()> {
    Ok(())
}

/// A file open for writing, without a buffer.
#[derive(Debug)]
pub struct DiskFile(fs::File);

impl DiskFile {
    /// Creates a file that does not exist, and locks it for other processes where the file system can.
    ///
    /// # Errors
    /// The system's; `AlreadyExists` if the file exists.
    pub fn create_new(path: &Path) -> io::Result<Self> {
        before(Operation::Create)?;
        let file = fs::File::create_new(path)?;
        // Without a lock the writer is still known by the number of its process.
        let _ = file.try_lock();
        Ok(Self(file))
    }

    /// Opens a file to add to its end, and creates it if it is missing.
    ///
    /// # Errors
    /// The system's.
    pub fn append(path: &Path) -> io::Result<Self> {
        before(Operation::Create)?;
        fs::OpenOptions::new().append(true).create(true).open(path).map(Self)
    }

    /// Bytes in the file.
    ///
    /// # Errors
    /// The system's.
    pub fn length(&self) -> io::Result<u64> {
        Ok(self.0.metadata()?.len())
    }

    /// Removes all bytes after the first `length`.
    ///
    /// # Errors
    /// The system's.
    pub fn cut(&self, length: u64) -> io::Result<()> {
        before(Operation::Remove)?;
        self.0.set_len(length)
    }

    /// Flushes the bytes to the disk.
    ///
    /// # Errors
    /// The system's.
    pub fn sync(&self) -> io::Result<()> {
        before(Operation::Flush)?;
        self.0.sync_all()
    }
}

impl Write for DiskFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let allowed = before(Operation::Write);
        // A disk that fills up takes a part first.
        let taken = if allowed.is_ok() { bytes } else { bytes.get(..bytes.len() / 2).unwrap_or_default() };
        let written = self.0.write(taken)?;
        allowed.map(|()| written)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Opens a file that holds nothing, to be locked, and creates it if it is missing.
///
/// # Errors
/// The system's.
pub fn open_lock(path: &Path) -> io::Result<fs::File> {
    before(Operation::Create)?;
    fs::OpenOptions::new().write(true).create(true).truncate(false).open(path)
}

/// Creates a folder and those above it.
///
/// # Errors
/// The system's.
pub fn create_folder(path: &Path) -> io::Result<()> {
    before(Operation::Create)?;
    fs::create_dir_all(path)
}

/// Creates a symbolic link at `path`.
///
/// # Errors
/// The system's.
#[cfg(unix)]
pub fn link(target: &str, path: &Path) -> io::Result<()> {
    before(Operation::Create)?;
    std::os::unix::fs::symlink(target, path)
}

/// Renames a file or folder. A file replaces a file, a folder an empty folder.
///
/// # Errors
/// The system's.
pub fn rename(from: &Path, to: &Path) -> io::Result<()> {
    before(Operation::Rename)?;
    fs::rename(from, to)
}

/// Flushes the names in a folder to the disk, which makes a rename last. Nothing is done where the system cannot.
///
/// # Errors
/// The system's.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    before(Operation::Flush)?;
    if !cfg!(unix) {
        return Ok(());
    }
    match fs::File::open(folder).and_then(|f| f.sync_all()) {
        // Some file systems cannot flush a folder, and some folders may be written to but not opened.
        Err(e)
            if matches!(
                e.kind(),
                io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported | io::ErrorKind::PermissionDenied
            ) =>
        {
            Ok(())
        }
        flushed => flushed,
    }
}

/// Removes a file or link; a missing one is no error.
///
/// # Errors
/// The system's.
pub fn remove_file(path: &Path) -> io::Result<()> {
    before(Operation::Remove)?;
    missing_is_removed(fs::remove_file(path))
}

/// Removes a folder with all that is in it; a missing one is no error.
///
/// # Errors
/// The system's.
pub fn remove_folder(path: &Path) -> io::Result<()> {
    before(Operation::Remove)?;
    missing_is_removed(fs::remove_dir_all(path))
}

fn missing_is_removed(removed: io::Result<()>) -> io::Result<()> {
    match removed {
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
        removed => removed,
    }
}
