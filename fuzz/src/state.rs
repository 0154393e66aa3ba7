//! What a child has done and what it is about to do, in a file that its parent can read at any time.

use crate::case::{Case, File};
use std::fs;
use std::io::{self, Seek, Write};
use std::path::Path;

const FIELDS: usize = 8;

/// Counts of the inputs of a target.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counts {
    /// Inputs begun: also the number of the next one.
    pub inputs: u64,
    pub accepted: u64,
    pub edges: u64,
    pub peak: u64,
    /// Inputs that held more than they may.
    pub over: u64,
    /// Inputs that broke any rule.
    pub faults: u64,
    pub slowest_us: u64,
    /// Microseconds spent on inputs.
    pub spent_us: u64,
}

impl Counts {
    fn to_array(self) -> [u64; FIELDS] {
        let Self { inputs, accepted, edges, peak, over, faults, slowest_us, spent_us } = self;
        [inputs, accepted, edges, peak, over, faults, slowest_us, spent_us]
    }

    fn of_array(a: [u64; FIELDS]) -> Self {
        let [inputs, accepted, edges, peak, over, faults, slowest_us, spent_us] = a;
        Self { inputs, accepted, edges, peak, over, faults, slowest_us, spent_us }
    }
}

/// The file, open for writing.
pub struct StateFile {
    file: fs::File,
    buffer: Vec<u8>,
}

impl StateFile {
    pub fn open(path: &Path) -> io::Result<Self> {
        let file = fs::OpenOptions::new().write(true).create(true).truncate(false).open(path)?;
        Ok(Self { file, buffer: Vec::new() })
    }

    /// Writes the counts, then the input that is about to run.
    pub fn put(&mut self, counts: Counts, case: &Case) -> io::Result<()> {
        self.buffer.clear();
        self.buffer.extend(counts.to_array().iter().flat_map(|v| v.to_le_bytes()));
        for file in &case.0 {
            for part in [file.name.as_bytes(), &file.bytes] {
                self.buffer.extend((part.len() as u64).to_le_bytes());
                self.buffer.extend_from_slice(part);
            }
        }
        // A length of 2^64 − 1 ends the list: an older, longer input may lie behind.
        self.buffer.extend(u64::MAX.to_le_bytes());
        self.file.rewind()?;
        self.file.write_all(&self.buffer)
    }
}

/// Reads the file; counts of zero and no input where there is none.
pub fn read(path: &Path) -> (Counts, Case) {
    let bytes = fs::read(path).unwrap_or_default();
    let mut rest = bytes.as_slice();
    let mut fields = [0; FIELDS];
    for field in &mut fields {
        *field = number(&mut rest).unwrap_or(0);
    }
    let mut case = Case::default();
    while let Some((name, bytes)) = part(&mut rest).and_then(|name| Some((name, part(&mut rest)?))) {
        case.0.push(File { name: String::from_utf8_lossy(name).into_owned(), bytes: bytes.to_vec() });
    }
    (Counts::of_array(fields), case)
}

fn number(rest: &mut &[u8]) -> Option<u64> {
    let (head, tail) = rest.split_first_chunk()?;
    *rest = tail;
    Some(u64::from_le_bytes(*head))
}

fn part<'a>(rest: &mut &'a [u8]) -> Option<&'a [u8]> {
    let length = usize::try_from(number(rest)?).ok()?;
    let (head, tail) = rest.split_at_checked(length)?;
    *rest = tail;
    Some(head)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_is_read_as_it_was_written() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("state");
        let mut file = StateFile::open(&path).unwrap();
        let long = Case::one("a/b", vec![7; 1000]).with("c", b"");
        let short = Case::one("a/b", b"xy");
        for (inputs, case) in [(3, &long), (4, &short)] {
            let counts = Counts { inputs, spent_us: 9, ..Counts::default() };
            file.put(counts, case).unwrap();
            assert_eq!(read(&path), (counts, case.clone()));
        }
        assert_eq!(read(&dir.path().join("none")), Default::default());
    }
}
