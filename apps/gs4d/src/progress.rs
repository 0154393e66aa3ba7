//! Progress on stderr: one line that redraws itself on a terminal, plain lines now and then elsewhere, nothing if quiet.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Between two plain lines.
const PLAIN_EVERY: Duration = Duration::from_secs(10);

/// A line of progress towards `total`.
pub struct Progress {
    bar: ProgressBar,
    /// Set where stderr is no terminal: when the last line was printed.
    plain: Option<Option<Instant>>,
    total: u64,
}

impl Progress {
    /// A line that counts `what` (`steps`, `views`) up to `total`.
    pub fn new(total: u64, what: &str, quiet: bool) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::hidden());
        if terminal && !quiet {
            bar.set_draw_target(ProgressDrawTarget::stderr_with_hz(8));
        }
        let template = format!("{{bar:24.cyan}} {{pos}}/{{len}} {what}  {{msg}}");
        if let Ok(style) = ProgressStyle::with_template(&template) {
            bar.set_style(style.progress_chars("━╸─"));
        }
        Self { bar, plain: (!terminal && !quiet).then_some(None), total }
    }

    /// Shows how far it is, with figures worth seeing.
    pub fn at(&mut self, position: u64, message: impl FnOnce() -> String) {
        self.bar.set_position(position);
        let due = |last: Option<Instant>| last.is_none_or(|t| t.elapsed() >= PLAIN_EVERY) || position >= self.total;
        match self.plain {
            Some(last) if due(last) => {
                eprintln!("{position}/{}  {}", self.total, message());
                self.plain = Some(Some(Instant::now()));
            }
            Some(_) => {}
            None if !self.bar.is_hidden() => self.bar.set_message(message()),
            None => {}
        }
    }

    /// Removes the line.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}
