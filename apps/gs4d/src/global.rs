//! Flags of every verb.

use clap::Args;
use gs_core::io::Limits;
use gs_train::ranks::{Ranks, Share, alone};
use gs4d_run::memory::MemoryLimit;
use std::io::Write;
use std::sync::Arc;

/// Writes a line to stderr. That nobody reads it any more is no reason to stop.
pub fn to_stderr(line: impl std::fmt::Display) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Flags every verb takes.
#[derive(Args, Clone)]
pub struct Global {
    /// Print the result as one JSON value on stdout.
    #[arg(long, global = true)]
    pub json: bool,
    /// No progress and no messages on stderr but errors.
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
    /// More detail on stderr.
    #[arg(short, long, global = true)]
    pub verbose: bool,
    /// Threads to use; results are the same for any number [default: all cores].
    #[arg(long, global = true, value_name = "T", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Memory that splats and pictures may take, MiB [default: three quarters of what is free].
    #[arg(long, global = true, value_name = "MIB", value_parser = clap::value_parser!(u64).range(1..))]
    pub max_mem: Option<u64>,
    /// The processes that train together.
    #[arg(skip = alone())]
    pub ranks: Arc<dyn Ranks>,
    /// Those that render, score and export together.
    #[arg(skip)]
    pub share: Arc<Share>,
}

impl Global {
    /// The memory that may be taken.
    pub fn memory(&self) -> MemoryLimit {
        MemoryLimit::new(self.max_mem)
    }

    /// Limits of readers of splat files.
    pub fn limits(&self) -> Limits {
        Limits { max_memory: self.memory().bytes(), ..Limits::default() }
    }

    /// A message on stderr, unless quiet.
    pub fn say(&self, message: impl std::fmt::Display) {
        if !self.quiet {
            to_stderr(message);
        }
    }

    /// A message on stderr for those who asked for detail.
    pub fn detail(&self, message: impl std::fmt::Display) {
        if self.verbose {
            to_stderr(message);
        }
    }
}
