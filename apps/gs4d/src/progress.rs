//! Progress on stderr: an updating line on a terminal, a plain line every ten seconds elsewhere, nothing with `--quiet`.

use crate::global::to_stderr;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

/// Time between two plain lines.
const PLAIN_EVERY: Duration = Duration::from_secs(10);

/// Says every ten seconds how long something has taken, until it is dropped; nothing with `--quiet`.
pub struct Waiting {
    _ends: Sender<()>,
}

impl Waiting {
    /// Says `what` at once.
    pub fn new(what: String, quiet: bool) -> Self {
        let (sender, ended) = channel();
        if !quiet {
            to_stderr(&what);
            let start = Instant::now();
            std::thread::spawn(move || {
                while ended.recv_timeout(PLAIN_EVERY) == Err(RecvTimeoutError::Timeout) {
                    to_stderr(format_args!("{what}, {:.0} s", start.elapsed().as_secs_f64()));
                }
            });
        }
        Self { _ends: sender }
    }
}

/// A line of progress towards `total`.
pub struct Progress {
    bar: ProgressBar,
    /// If stderr is no terminal: when the last line was printed.
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

    /// Updates position and message.
    pub fn at(&mut self, position: u64, message: impl FnOnce() -> String) {
        self.bar.set_position(position);
        let due = |last: Option<Instant>| last.is_none_or(|t| t.elapsed() >= PLAIN_EVERY) || position >= self.total;
        match self.plain {
            Some(last) if due(last) => {
                to_stderr(format_args!("{position}/{}  {}", self.total, message()));
                self.plain = Some(Some(Instant::now()));
            }
            Some(_) => {}
            None if !self.bar.is_hidden() => self.bar.set_message(message()),
            None => {}
        }
    }

    /// Shows a training step on `line`, which is created at the first step.
    pub fn step(line: &mut Option<Self>, p: gs4d_run::Progress, quiet: bool) {
        let line = line.get_or_insert_with(|| Self::new(u64::from(p.steps), "steps", quiet));
        line.at(u64::from(p.step), || format!("{:.2} dB  {} splats", p.psnr, p.splats));
    }

    /// Removes the line.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}
