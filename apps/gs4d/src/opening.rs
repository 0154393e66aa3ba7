//! Opening runs, with what everybody should hear of it.

use crate::failure::{Class, Failure};
use crate::global::Global;
use gs_data::DataOptions;
use gs4d_run::OpenRun;
use gs4d_run::settings::{Request, resolve};
use std::path::{Path, PathBuf};

/// How a data set is read, where no run says it.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct Reading {
    /// Read the folder with this layout [default: the one that fits].
    #[arg(long)]
    layout: Option<String>,
    /// A setting of the data, data.KEY=VALUE (repeatable).
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
}

impl Reading {
    /// By these settings, with the layout that fits.
    pub fn of(sets: Vec<String>) -> Self {
        Self { layout: None, sets }
    }

    /// The options of the reader; settings that are not of the data are refused.
    pub fn options(&self) -> Result<DataOptions, Failure> {
        if let Some(other) = self.sets.iter().find(|s| !s.starts_with("data.")) {
            return Err(Failure::usage(format!("`{other}` is no setting of the data")));
        }
        // Every method reads its data by the same settings.
        let method = "static3d".to_owned();
        let request = Request { method, preset: "fast".into(), sets: self.sets.clone(), ..Request::default() };
        let options = resolve(gs_methods::registry(), &request)?.data;
        Ok(DataOptions { layout: self.layout.clone().or(options.layout.clone()), ..options })
    }
}

/// Where the data of a run are.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct RunData {
    /// Folder of the run's data, where they are not at the path that the run has kept. A compact file has kept none.
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
}

impl RunData {
    /// Opens a run, a checkpoint or a compact file; says which newer checkpoints were passed over.
    pub fn open(&self, path: &Path, global: &Global) -> Result<OpenRun, Failure> {
        let mut run = OpenRun::open_with(gs_methods::registry(), path, self.data.as_deref())?;
        run.share = global.share.clone();
        // A run that is training may have saved meanwhile.
        let steps = run.share.each(run.share.size(), |_| Ok::<_, Failure>(run.loaded.step))?;
        if steps.iter().any(|step| *step != steps[0]) {
            let what =
                format!("{}: ranks opened different checkpoints, of steps {steps:?}; start it again", path.display());
            return Err(Failure::new(Class::Data, "ranks.checkpoint", what));
        }
        say_skipped(path, &run.skipped, global);
        Ok(run)
    }
}

/// Normalised time of the last training image; 1 where a run does not say.
pub fn last_trained(run: &OpenRun) -> f32 {
    Some(run.loaded.scene.last_time).filter(|last| *last > 0.0).unwrap_or(1.0)
}

/// Says of the first time outside training that the method extrapolates there.
pub fn note_extrapolated(times: impl IntoIterator<Item = f32>, run: &OpenRun, global: &Global) {
    let last = last_trained(run);
    if let Some(time) = times.into_iter().find(|time| !(0.0..=last).contains(time)) {
        global.say(format!("note: time {time} lies outside training (0..{last}): what is there is extrapolated"));
    }
}

/// Says which checkpoints of a run were passed over.
pub fn say_skipped(run: &Path, skipped: &[gs_train::checkpoint::Skipped], global: &Global) {
    for skipped in skipped {
        global.say(format!("warning: {}: an older checkpoint is used; {}", run.display(), skipped.why));
    }
}
