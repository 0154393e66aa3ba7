//! Ranks that train one run together: the first has the run folder and decides, the others follow.

use crate::provenance::origin;
use crate::{Resolved, RunError};
use gs_data::Dataset;
use gs_train::ranks::{Ranks, all_gather};
use gs_train::registry::Registry;
use gs_train::trainer::{TrainError, Trainer};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What the first rank asks of the others.
#[derive(Clone, Debug, Serialize, Deserialize)]
enum Work {
    /// Train the run of these settings, a TOML text, on data of these hashes ([`origin`]) with it.
    Train(String, [String; 2]),
    /// Do a share of what the command line asks for, which is the same on all.
    Share,
    /// End with this exit code.
    End(u8),
}

/// Asks the other ranks to train the run of these settings together with the first.
pub(crate) fn call(ranks: &dyn Ranks, resolved: &Resolved, dataset: &Dataset) -> Result<(), RunError> {
    let settings = resolved.to_toml()?;
    all_gather(ranks, &Some(Work::Train(settings, origin(dataset)))).map_err(TrainError::from)?;
    Ok(())
}

/// Asks the other ranks to do their shares of what the command line asks for ([`gs_train::ranks::Share`]).
///
/// # Errors
/// If ranks cannot talk to each other.
pub fn share(ranks: &dyn Ranks) -> Result<(), RunError> {
    all_gather(ranks, &Some(Work::Share)).map_err(TrainError::from)?;
    Ok(())
}

/// Does what the first rank asks for until that ends ([`dismiss`]); gives its exit code. `share` does this rank's share of what
/// the command line asks for. What fails is told to the first rank.
///
/// # Errors
/// If ranks cannot talk to each other.
pub fn follow(registry: &Registry, ranks: &Arc<dyn Ranks>, share: impl FnOnce()) -> Result<u8, RunError> {
    let mut share = Some(share);
    loop {
        let received = all_gather::<Option<Work>>(&**ranks, &None).map_err(TrainError::from)?;
        match received.into_iter().next().flatten() {
            Some(Work::Train(settings, data)) => train(registry, (&settings, &data), ranks)?,
            Some(Work::Share) => {
                if let Some(share) = share.take() {
                    share();
                }
            }
            Some(Work::End(code)) => return Ok(code),
            None => return Ok(0),
        }
    }
}

/// Lets the other ranks end with an exit code. Where ranks could not talk to each other, it is not called: they may wait for something
/// else ([`Ranks`]).
pub fn dismiss(ranks: &dyn Ranks, code: u8) {
    if ranks.size() > 1 {
        // Ranks that cannot be told have noticed.
        let _ = all_gather(ranks, &Some(Work::End(code)));
    }
}

fn train(
    registry: &Registry,
    (settings, of_first): (&str, &[String; 2]),
    ranks: &Arc<dyn Ranks>,
) -> Result<(), RunError> {
    let resolved = Resolved::read(registry, settings, "settings of the first rank");
    let image_bytes = resolved.as_ref().map_or(0, |r| r.run.image_bytes());
    let data = resolved.and_then(|r| r.reopen_data()).map_err(|e| match e {
        RunError::Data(e) => TrainError::Data(e),
        RunError::Train(e) => e,
        other => TrainError::State(other.to_string()),
    });
    let data = data.and_then(|data| {
        let same = origin(&data) == *of_first;
        same.then(|| Arc::new(data)).ok_or_else(|| {
            TrainError::State("the data here are not those of the first rank, or files of them cannot be read".into())
        })
    });
    match Trainer::join(registry, data, image_bytes, ranks.clone()).and_then(|mut trainer| trainer.follow()) {
        Err(e @ TrainError::Ranks(_)) => Err(e.into()),
        // The first rank knows it.
        _ => Ok(()),
    }
}
