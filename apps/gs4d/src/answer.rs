//! The result of a verb, as text and as JSON.

use crate::failure::Failure;
use serde_json::Value;
use std::io::{self, Write};
use std::path::Path;

/// The result of a verb.
pub struct Answer {
    /// Text, ending with a line break unless empty.
    pub text: String,
    /// The same as one JSON value, for `--json`.
    pub json: Value,
}

impl Answer {
    /// A result in both forms.
    pub fn new(text: impl Into<String>, json: Value) -> Self {
        Self { text: text.into(), json }
    }

    /// Writes text or JSON to stdout. A closed pipe (`| head`) is no failure.
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

/// A number with fixed digits, or `-`.
pub fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".to_owned(), |v| format!("{v:.digits$}"))
}
