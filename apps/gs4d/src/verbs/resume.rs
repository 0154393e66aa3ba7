//! `gs4d resume`: continues a run exactly from its newest valid checkpoint.

use super::train::{ImageCacheSize, carry_on};
use super::view::Watch;
use crate::answer::Answer;
use crate::device::DeviceFlag;
use crate::failure::Failure;
use crate::global::Global;
use crate::opening::RunData;
use crate::{interrupt, parse};
use gs4d_run::{ResumeRequest, Training};
use std::path::PathBuf;
use std::time::Duration;

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
    /// Stop with a checkpoint after so much more training, for example 90s, 10m, 1.5h, wherever the schedule is then.
    #[arg(long, value_name = "TIME", value_parser = parse::duration)]
    time_budget: Option<Duration>,
    #[command(flatten)]
    place: RunData,
    #[command(flatten)]
    images: ImageCacheSize,
    /// Go on although the data are not those that the run began with; provenance.json keeps it.
    #[arg(long)]
    accept_changed_data: bool,
    #[command(flatten)]
    device: DeviceFlag,
    #[command(flatten)]
    watch: Watch,
}

impl Resume {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let (stop, device) = (interrupt::flag()?, self.device.open_to_train(global)?);
        let request = ResumeRequest {
            steps: self.steps,
            budget: self.time_budget.map(|d| d.as_secs_f64()),
            data: self.place.data,
            image_mib: self.images.image_cache,
            accept_changed_data: self.accept_changed_data,
        };
        let training = Training::resume(gs_methods::registry(), &self.run, &request)?;
        let mut training = training.on(&device)?.with_ranks(global.ranks.clone())?;
        global.say(format!("going on from step {}", training.trainer().steps_done()));
        carry_on(&mut training, &self.watch, &stop, global)
    }
}
