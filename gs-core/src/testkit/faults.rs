//! A disk that fails: errors, or the end of the process, at chosen operations of [`disk`](crate::io::disk).
//!
//! In a test, [`with_faults`] counts the operations of the calling thread. In a child process the environment variable
//! `GS4D_FAIL_WRITE`, read once, counts those of all threads; its value is that of [`Faults`] as text.

use crate::io::disk::Operation;
use std::cell::Cell;
use std::io;
use std::str::FromStr;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU64, Ordering};

/// The environment variable of a child process.
pub const VARIABLE: &str = "GS4D_FAIL_WRITE";

/// How an operation fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The disk is full (ENOSPC). Removing succeeds.
    Full,
    /// Too many files are open (EMFILE). Writing, renaming and removing succeed.
    Files,
    /// The device fails (EIO).
    Device,
    /// The process is killed (SIGKILL) before the operation.
    Kill,
}

/// Operations that fail. As text `K`, `K:KIND` or `K:KIND:COUNT`; KIND is `full` (default), `files`, `device` or `kill`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Faults {
    /// The first operation that fails, from 1.
    pub first: u64,
    /// How many fail in succession.
    pub count: u64,
    /// How they fail.
    pub kind: Fault,
}

impl FromStr for Faults {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("{VARIABLE}={text}: give K, K:KIND or K:KIND:COUNT");
        let mut parts = text.split(':');
        let number = |part: Option<&str>| part.map_or(Ok(1), |p| p.parse().map_err(|_| wrong()));
        let first = number(parts.next())?;
        let kind = match parts.next() {
            None | Some("full") => Fault::Full,
            Some("files") => Fault::Files,
            Some("device") => Fault::Device,
            Some("kill") => Fault::Kill,
            Some(_) => return Err(wrong()),
        };
        Ok(Self { first, count: number(parts.next())?, kind })
    }
}

thread_local! {
    /// Faults of this thread and the operations seen.
    static HERE: Cell<Option<(Faults, u64)>> = const { Cell::new(None) };
}

/// Runs `work` while the operations of this thread fail as `faults` says (none: they are only counted). Returns also how many
/// operations there were.
pub fn with_faults<T>(faults: Option<Faults>, work: impl FnOnce() -> T) -> (T, u64) {
    let none = Faults { first: 0, count: 0, kind: Fault::Device };
    HERE.set(Some((faults.unwrap_or(none), 0)));
    let made = work();
    (made, HERE.take().map_or(0, |(_, seen)| seen))
}

/// Fails if this operation is to fail.
///
/// # Panics
/// If `GS4D_FAIL_WRITE` cannot be understood.
pub(crate) fn before(operation: Operation) -> io::Result<()> {
    static PROCESS: LazyLock<Option<Faults>> =
        LazyLock::new(|| Some(std::env::var(VARIABLE).ok()?.parse().unwrap_or_else(|e| panic!("{e}"))));
    static SEEN: AtomicU64 = AtomicU64::new(0);
    if let Some((faults, seen)) = HERE.get() {
        HERE.set(Some((faults, seen + 1)));
        return faults.at(seen + 1, operation);
    }
    let Some(faults) = *PROCESS else { return Ok(()) };
    let number = SEEN.fetch_add(1, Ordering::Relaxed) + 1;
    faults.at(number, operation).inspect_err(|e| eprintln!("{VARIABLE}: operation {number}, {operation:?}: {e}"))
}

impl Faults {
    fn at(self, number: u64, operation: Operation) -> io::Result<()> {
        if number < self.first || number - self.first >= self.count {
            return Ok(());
        }
        let refused = match self.kind {
            Fault::Full => operation != Operation::Remove,
            Fault::Files => operation == Operation::Create,
            Fault::Device | Fault::Kill => true,
        };
        if !refused {
            return Ok(());
        }
        Err(io::Error::from_raw_os_error(match self.kind {
            Fault::Full => 28,
            Fault::Files => 24,
            Fault::Device => 5,
            Fault::Kill => kill(),
        }))
    }
}

/// Ends this process as `kill -9` does.
fn kill() -> ! {
    let pid = std::process::id().to_string();
    let _ = std::process::Command::new("sh").args(["-c", "kill -KILL $0", &pid]).status();
    std::process::abort()
}
