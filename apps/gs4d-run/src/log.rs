//! Logs of a run: files of JSON lines, to which lines are added while it trains.
//!
//! A log ends no training. Lines that cannot be written are kept, the newest [`KEPT_BYTES`] of them, and written before the
//! next line.

use gs_core::io::disk::DiskFile;
use serde_json::Value;
use std::io::{self, Write};
use std::path::PathBuf;

/// Bytes of lines kept while they cannot be written, at most.
const KEPT_BYTES: usize = 16 << 20;

/// A log, opened with its first line.
#[derive(Debug)]
pub(crate) struct Log {
    path: PathBuf,
    file: Option<DiskFile>,
    /// Bytes of the whole lines in the file.
    whole: u64,
    /// Whether a part of a line may follow them.
    torn: bool,
    waiting: String,
    warned: bool,
}

impl Log {
    pub(crate) fn new(path: PathBuf) -> Self {
        Self { path, file: None, whole: 0, torn: false, waiting: String::new(), warned: false }
    }

    /// Adds one line. The first time that lines cannot be written, `warn` is called.
    pub(crate) fn add(&mut self, line: &Value, warn: &dyn Fn(&str)) {
        self.waiting += &format!("{line}\n");
        let too_many = self.waiting.len().saturating_sub(KEPT_BYTES);
        if too_many > 0 {
            let end = self.waiting.bytes().skip(too_many - 1).position(|b| b == b'\n');
            self.waiting.drain(..end.map_or(self.waiting.len(), |n| too_many + n));
        }
        self.flush(warn);
    }

    /// Writes the lines that are kept, as [`Log::add`] does.
    pub(crate) fn flush(&mut self, warn: &dyn Fn(&str)) {
        if let Err(e) = self.write()
            && !std::mem::replace(&mut self.warned, true)
        {
            let file = self.path.display();
            warn(&format!("cannot write {file}: {e}; training goes on, and the lines are written once they can be"));
        }
    }

    fn write(&mut self) -> io::Result<()> {
        if self.waiting.is_empty() {
            return Ok(());
        }
        let file = match &mut self.file {
            Some(file) => file,
            None => {
                let file = DiskFile::append(&self.path)?;
                self.whole = file.length()?;
                self.file.insert(file)
            }
        };
        if self.torn {
            file.cut(self.whole)?;
        }
        self.torn = true;
        file.write_all(self.waiting.as_bytes())?;
        self.torn = false;
        self.whole += self.waiting.len() as u64;
        self.waiting.clear();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::testkit::faults::{Fault, Faults, with_faults};
    use serde_json::json;
    use std::cell::RefCell;
    use std::fs;

    #[test]
    fn lines_wait_until_the_disk_takes_them_and_the_warning_comes_once() {
        for first in 1..=6 {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("log.jsonl");
            let warnings = RefCell::new(Vec::new());
            let warn = |text: &str| warnings.borrow_mut().push(text.to_owned());
            let mut log = Log::new(path.clone());
            let faults = Faults { first, count: 3, kind: Fault::Full };
            with_faults(Some(faults), || (1..=10).for_each(|step| log.add(&json!({"step": step}), &warn)));
            let text: String = (1..=10).map(|step| format!("{{\"step\":{step}}}\n")).collect();
            assert_eq!(fs::read_to_string(&path).unwrap(), text, "{first}");
            let warnings = warnings.into_inner();
            assert_eq!(warnings.len(), 1, "{first}: {warnings:?}");
            assert!(warnings[0].contains("log.jsonl") && warnings[0].contains("training goes on"), "{warnings:?}");
        }
    }

    #[test]
    fn what_is_kept_has_a_bound() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("log.jsonl");
        let mut log = Log::new(path.clone());
        let line = json!({"text": "x".repeat(1 << 20)});
        let full = Faults { first: 1, count: 1000, kind: Fault::Full };
        with_faults(Some(full), || (0..20).for_each(|_| log.add(&line, &|_| {})));
        assert!(log.waiting.len() <= KEPT_BYTES && log.waiting.len() > KEPT_BYTES - (2 << 20));
        log.add(&json!({"step": 21}), &|_| {});
        let text = fs::read_to_string(&path).unwrap();
        assert_eq!(text.lines().count(), 16);
        assert!(text.lines().all(|line| serde_json::from_str::<Value>(line).is_ok()), "whole lines");
    }
}
