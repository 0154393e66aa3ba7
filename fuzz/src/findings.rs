//! Inputs that broke a rule, on disk.
//!
//! `findings/TARGET/KIND-NUMBER/` holds the files of the input, `findings/TARGET/KIND-NUMBER.txt` says what happened.

use crate::case::Case;
use crate::guard::Fault;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Inputs kept of one target and kind; a fault met often is still one fault.
const KEPT: usize = 8;

/// The folder of findings.
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("findings")
}

/// The folder of inputs that once broke a rule.
pub fn regressions() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("regressions")
}

/// Keeps an input, unless there is one for the same reason or there are enough.
pub fn keep(target: &str, fault: &Fault, case: &Case) -> io::Result<()> {
    let dir = folder().join(target);
    fs::create_dir_all(&dir)?;
    let number = fault.place.as_ref().map_or_else(|| case.hash(), |place| crc32fast::hash(place.as_bytes()));
    let name = dir.join(format!("{}-{number:08x}", fault.kind));
    if name.exists() || folders(&dir)?.len() >= KEPT {
        return Ok(());
    }
    fs::create_dir(&name)?;
    fs::write(name.with_extension("txt"), format!("{}\n", fault.why))?;
    case.write(&name)
}

/// The folders in a folder, in order; none if it does not exist.
pub fn folders(dir: &Path) -> io::Result<Vec<PathBuf>> {
    if !dir.is_dir() {
        return Ok(Vec::new());
    }
    let entries = fs::read_dir(dir)?.map(|e| e.map(|e| e.path())).collect::<io::Result<Vec<_>>>()?;
    let mut folders: Vec<PathBuf> = entries.into_iter().filter(|p| p.is_dir()).collect();
    folders.sort();
    Ok(folders)
}
