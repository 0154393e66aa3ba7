//! The runs of a contest as a list of command lines, for any scheduler.

use super::{Contest, ContestError, Job};
use gs4d_run::Stage;

/// The runs that come next; they do not depend on one another.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Whether these are pilots: the trials of a time budget can be planned when they are done.
    pub pilots: bool,
    /// The runs, finished ones too, in the order of the entries.
    pub jobs: Vec<Job>,
}

impl Contest {
    /// The trials; under a time budget the pilots that are not finished, if there are any. Nothing is trained.
    ///
    /// # Errors
    /// Invalid settings, data that are here and that an entry cannot learn from, or another run in the folder of a pilot.
    pub fn plan(&self) -> Result<Plan, ContestError> {
        self.check()?;
        self.check_data()?;
        let (mut pilots, mut trials) = (Vec::new(), Vec::new());
        for entry in &self.entries {
            match self.pilot(entry)? {
                Some(pilot) if !matches!(pilot.stage()?, Stage::Finished(_)) => add(&mut pilots, pilot),
                _ => {
                    let length = self.length_of(entry, &mut |pilot| pilot.read())?;
                    for &seed in &self.seeds {
                        add(&mut trials, self.trial(entry, seed, length)?);
                    }
                }
            }
        }
        let later = pilots.is_empty();
        Ok(Plan { pilots: !later, jobs: if later { trials } else { pilots } })
    }
}

/// Adds a run, unless an equal entry has it.
fn add(jobs: &mut Vec<Job>, job: Job) {
    if !jobs.iter().any(|j| j.run == job.run && j.resolved.trains_as(&job.resolved)) {
        jobs.push(job);
    }
}
