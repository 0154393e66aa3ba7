//! Reading files under a size limit, and keeping paths inside the data folder.

use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

use super::advice;
use super::error::{DataError, Place};

/// A data folder inside which every path that a file mentions is resolved.
///
/// ```
/// use gs_data::{Place, Root};
///
/// # let folder = tempfile::tempdir()?;
/// let root = Root::new(folder.path())?;
/// let place = Place::new("transforms.json".as_ref(), "frames[0].file_path");
/// assert!(root.resolve("./images/../r_000.png", &place)?.ends_with("r_000.png"));
/// assert_eq!(root.resolve("../r_000.png", &place).unwrap_err().code(), "data.escape");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Root {
    dir: PathBuf,
    canonical: PathBuf,
}

impl Root {
    /// The root at `dir`, an existing folder.
    ///
    /// # Errors
    /// `data.path` if it is no folder.
    pub fn new(dir: &Path) -> Result<Self, DataError> {
        match dir.canonicalize() {
            Ok(canonical) if canonical.is_dir() => Ok(Self { dir: dir.to_path_buf(), canonical }),
            _ => Err(DataError::NotFound { path: dir.to_path_buf() }),
        }
    }

    /// The folder, as it was given to [`Self::new`].
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// The path that `written`, found at `place` of a file, stands for: relative to the folder, with `/` or `\` between
    /// names. It need not exist; `..` may be used as long as it stays inside the folder.
    ///
    /// # Errors
    /// `data.escape` if it is absolute, leaves the folder, or leaves it through a symbolic link.
    pub fn resolve(&self, written: &str, place: &Place) -> Result<PathBuf, DataError> {
        let escape = || {
            let inside = advice::inside(&self.dir, written).map(String::into_boxed_str);
            DataError::Escape { place: place.clone(), path: written.to_string(), inside }
        };
        let unix = written.replace('\\', "/");
        let drive = unix.as_bytes().get(1) == Some(&b':');
        if drive || unix.contains("://") || unix.contains('\0') {
            return Err(escape());
        }
        let mut inside = PathBuf::new();
        for component in Path::new(&unix).components() {
            match component {
                Component::CurDir => {}
                Component::Normal(name) => inside.push(name),
                Component::ParentDir => {
                    if !inside.pop() {
                        return Err(escape());
                    }
                }
                Component::RootDir | Component::Prefix(_) => return Err(escape()),
            }
        }
        let path = self.dir.join(&inside);
        match path.canonicalize() {
            Ok(real) if !real.starts_with(&self.canonical) => Err(escape()),
            _ => Ok(path),
        }
    }
}

/// A regular file, opened. Opening a pipe would wait for somebody to write to it.
///
/// # Errors
/// `io.read` if it is a pipe, a device or a folder, or cannot be opened.
pub(crate) fn open_regular(file: &Path) -> Result<File, DataError> {
    let failed = |e| DataError::read(file, e);
    if !std::fs::metadata(file).map_err(failed)?.is_file() {
        return Err(failed(std::io::Error::other("it is no regular file")));
    }
    File::open(file).map_err(failed)
}

/// The bytes of a file, at most `limit` of them.
///
/// # Errors
/// `limits.file` if it is larger, `io.read` if it cannot be read.
pub(crate) fn read_bytes(file: &Path, limit: u64) -> Result<Vec<u8>, DataError> {
    let failed = |e| DataError::read(file, e);
    let open = open_regular(file)?;
    let meta = open.metadata().map_err(failed)?;
    let too_large = |bytes| DataError::TooLarge { place: Place::new(file, ""), bytes, limit };
    if meta.len() > limit {
        return Err(too_large(meta.len()));
    }
    let length = usize::try_from(meta.len()).map_err(|_| too_large(meta.len()))?;
    let mut bytes = Vec::with_capacity(length + 1);
    open.take(limit + 1).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 > limit { Err(too_large(bytes.len() as u64)) } else { Ok(bytes) }
}

/// The text of a file, at most `limit` bytes, without a byte order mark.
///
/// # Errors
/// As [`read_bytes`]; `data.syntax` if it is not UTF-8.
pub(crate) fn read_text(file: &Path, limit: u64) -> Result<String, DataError> {
    let mut text = String::from_utf8(read_bytes(file, limit)?).map_err(|e| {
        DataError::syntax(file, format!("byte {}", e.utf8_error().valid_up_to()), "it is not UTF-8 text")
    })?;
    if text.starts_with('\u{feff}') {
        text.drain(..'\u{feff}'.len_utf8());
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_stay_inside() {
        let dir = tempfile::tempdir().unwrap();
        let data = dir.path().join("data");
        std::fs::create_dir_all(data.join("images")).unwrap();
        std::fs::write(dir.path().join("secret.png"), "x").unwrap();
        let root = Root::new(&data).unwrap();
        let place = Place::new(Path::new("transforms.json"), "frames[0].file_path");
        for good in ["images/a.png", "./images/a.png", "images/../images/a.png", "images\\a.png", "./images/./a.png"] {
            assert_eq!(root.resolve(good, &place).unwrap(), data.join("images/a.png"), "{good}");
        }
        let up = ["../secret.png", "images/../../secret.png", "/etc/passwd", "C:\\a.png", "file:///etc/passwd", "a\0b"];
        for bad in up {
            let e = root.resolve(bad, &place).unwrap_err();
            assert_eq!(e.code(), "data.escape");
            assert!(e.to_string().contains(bad) && e.report().contains("frames[0].file_path"), "{e}");
        }
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(dir.path(), data.join("out")).unwrap();
            assert_eq!(root.resolve("out/secret.png", &place).unwrap_err().code(), "data.escape");
        }
        assert_eq!(Root::new(&data.join("nothing")).err().unwrap().code(), "data.path");
    }

    #[test]
    fn sizes_and_encodings_are_checked() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("a.json");
        std::fs::write(&file, b"\xef\xbb\xbf{}").unwrap();
        assert_eq!(read_text(&file, 100).unwrap(), "{}");
        assert_eq!(read_text(&file, 4).unwrap_err().code(), "limits.file");
        std::fs::write(&file, b"{\"a\": \xff}").unwrap();
        assert!(read_text(&file, 100).unwrap_err().report().contains("byte 6"));
        assert_eq!(read_text(dir.path(), 100).unwrap_err().code(), "io.read");
    }
}
