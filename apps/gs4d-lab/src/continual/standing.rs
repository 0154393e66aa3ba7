//! How far a training in rounds has come.

use super::{FILE, RoundScores};
use gs_train::checkpoint::{self, CheckpointError, Newest};
use gs4d_run::{RunError, RunFolder};
use serde_json::Value;
use std::path::Path;

/// A run that goes on.
pub(super) struct Standing {
    pub(super) folder: RunFolder,
    /// The checkpoint it goes on from.
    pub(super) newest: Newest,
    /// The round that comes next or was cut off, from 0.
    pub(super) round: usize,
    /// Scores of the rounds before it.
    pub(super) done: Vec<RoundScores>,
}

/// How far a run with this identity has come whose rounds end at these steps; `None` if there is no run or no checkpoint yet.
///
/// # Errors
/// If the run is another, is being written to, or its checkpoints or scores are damaged.
pub(super) fn standing(root: &Path, identity: &Value, ends: &[u32]) -> Result<Option<Standing>, RunError> {
    let folder = match RunFolder::open_to_write(root) {
        Err(RunError::NotARun { .. }) => return Ok(None),
        folder => folder?,
    };
    if folder.rounds().is_none_or(|rounds| rounds["plan"] != *identity) {
        return Err(RunError::OtherSettings { path: root.to_owned() });
    }
    let newest = match checkpoint::load_newest(&folder.checkpoints()) {
        Err(CheckpointError::NoneUsable { skipped, .. }) if skipped.is_empty() => return Ok(None),
        newest => newest?,
    };
    let mut done = scores(&folder);
    let round = next_round(newest.checkpoint.meta["step"].as_u64().unwrap_or(0), ends, done.len());
    if done.len() < round {
        let why =
            format!("{} lacks the scores of round {}: begin again with -f", root.join(FILE).display(), done.len() + 1);
        return Err(RunError::Rounds(why));
    }
    done.truncate(round);
    Ok(Some(Standing { folder, newest, round, done }))
}

/// The round of a checkpoint, from 0. One at the end of a round belongs to the next round if the round is scored; the last
/// round is scored again.
fn next_round(step: u64, ends: &[u32], scored: usize) -> usize {
    let passed = ends.iter().take_while(|&&end| u64::from(end) <= step).count();
    let at_an_end = ends.iter().any(|&end| u64::from(end) == step);
    let unscored = at_an_end && scored < passed;
    (passed - usize::from(unscored)).min(ends.len().saturating_sub(1))
}

fn scores(folder: &RunFolder) -> Vec<RoundScores> {
    let json = folder.read(FILE).ok().and_then(|text| serde_json::from_str::<Value>(&text).ok());
    json.and_then(|mut json| serde_json::from_value(json["rounds"].take()).ok()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkpoint_belongs_to_the_round_it_was_made_in() {
        let ends = [12, 17, 22];
        for (step, scored, round) in [
            (0, 0, 0),
            (11, 0, 0),
            (12, 0, 0),
            (12, 1, 1),
            (13, 1, 1),
            (17, 1, 1),
            (17, 2, 2),
            (21, 2, 2),
            (22, 2, 2),
            (22, 3, 2),
            // The newest checkpoint is damaged, the older one is of a round that is scored.
            (13, 2, 1),
            (11, 1, 0),
        ] {
            assert_eq!(next_round(step, &ends, scored), round, "step {step}, {scored} scored");
        }
    }
}
