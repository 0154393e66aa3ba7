//! An input: one file, or a few that belong together.

use std::fs;
use std::io;
use std::path::Path;

/// A file of an input.
#[derive(Clone, Debug, PartialEq)]
pub struct File {
    /// Path below the folder of the data.
    pub name: String,
    pub bytes: Vec<u8>,
}

/// The files of an input that are mutated.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Case(pub Vec<File>);

impl Case {
    /// An input of one file.
    pub fn one(name: &str, bytes: impl Into<Vec<u8>>) -> Self {
        Self(Vec::new()).with(name, bytes)
    }

    /// The same and one more file.
    pub fn with(mut self, name: &str, bytes: impl Into<Vec<u8>>) -> Self {
        self.0.push(File { name: name.into(), bytes: bytes.into() });
        self
    }

    /// Files of a folder that is there already.
    pub fn of_folder(dir: &Path, names: &[&str]) -> io::Result<Self> {
        names.iter().try_fold(Self::default(), |case, name| Ok(case.with(name, fs::read(dir.join(name))?)))
    }

    /// The bytes of a file; none where the input lacks it.
    pub fn get(&self, name: &str) -> Option<&[u8]> {
        self.0.iter().find(|f| f.name == name).map(|f| f.bytes.as_slice())
    }

    /// The bytes of the first file.
    pub fn first(&self) -> &[u8] {
        self.0.first().map_or(&[], |f| f.bytes.as_slice())
    }

    /// Bytes of all files together.
    pub fn len(&self) -> usize {
        self.0.iter().map(|f| f.bytes.len()).sum()
    }

    /// Writes the files into a folder, each anew: truncating one in place makes some file systems wait for the disk.
    pub fn write(&self, dir: &Path) -> io::Result<()> {
        for file in &self.0 {
            let path = dir.join(&file.name);
            if fs::remove_file(&path).is_err() {
                path.parent().map_or(Ok(()), fs::create_dir_all)?;
            }
            fs::write(path, &file.bytes)?;
        }
        Ok(())
    }

    /// Reads every file below a folder, in the order of their names.
    pub fn read(dir: &Path) -> io::Result<Self> {
        fn below(dir: &Path, prefix: &str, case: &mut Case) -> io::Result<()> {
            let mut entries = fs::read_dir(dir)?.collect::<io::Result<Vec<_>>>()?;
            entries.sort_by_key(fs::DirEntry::file_name);
            for entry in entries {
                let name = format!("{prefix}{}", entry.file_name().display());
                match entry.file_type()?.is_dir() {
                    true => below(&entry.path(), &format!("{name}/"), case)?,
                    false => *case = std::mem::take(case).with(&name, fs::read(entry.path())?),
                }
            }
            Ok(())
        }
        let mut case = Self::default();
        below(dir, "", &mut case)?;
        Ok(case)
    }

    /// A number that differs between inputs.
    pub fn hash(&self) -> u32 {
        let mut hasher = crc32fast::Hasher::new();
        for file in &self.0 {
            hasher.update(file.name.as_bytes());
            hasher.update(&file.bytes);
        }
        hasher.finalize()
    }
}
