//! What a verb found, as text for people and as JSON for programs.

use crate::failure::Failure;
use serde_json::Value;
use std::io::{self, Write};
use std::path::Path;

/// The result of a verb.
pub struct Answer {
    /// For people; ends with a line break.
    pub text: String,
    /// For programs: one value.
    pub json: Value,
}

impl Answer {
    /// An answer in both forms.
    pub fn new(text: impl Into<String>, json: Value) -> Self {
        Self { text: text.into(), json }
    }

    /// Writes it to stdout. A reader that has gone (`| head`) is no failure.
    pub fn print(&self, json: bool) -> Result<(), Failure> {
        let mut out = io::stdout().lock();
        let written = if json {
            serde_json::to_writer_pretty(&mut out, &self.json).map_err(io::Error::from).and_then(|()| writeln!(out))
        } else {
            out.write_all(self.text.as_bytes())
        };
        match written.and_then(|()| out.flush()) {
            Err(e) if e.kind() != io::ErrorKind::BrokenPipe => {
                Err(Failure::io("write the result", Path::new("stdout"), &e))
            }
            _ => Ok(()),
        }
    }
}
