//! `gs4d resume`: goes on with a run exactly where its newest good checkpoint stands.

use super::train::carry_on;
use crate::answer::Answer;
use crate::failure::Failure;
use crate::{Global, interrupt};
use gs_train::run::Training;
use std::path::PathBuf;

/// Continue a run exactly, or lengthen a finished one
///
/// The result is bit for bit that of a run never interrupted, on any number of threads. --steps changes the length of
/// the last stage alone, so nothing that was done would have been done otherwise.
#[derive(clap::Args)]
pub struct Resume {
    /// Folder of the run.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Steps in all, to lengthen (or shorten) the last stage.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    steps: Option<u32>,
}

impl Resume {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let stop = interrupt::flag()?;
        let mut training = Training::resume(&self.run, self.steps, None)?;
        global.say(format!("going on from step {}", training.trainer().steps_done()));
        carry_on(&mut training, &stop, global)
    }
}
