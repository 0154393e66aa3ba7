//! Ranks that train together: the first leads, the others follow.

use super::{TrainError, Trainer, image_cache};
use crate::checkpoint::Checkpoint;
use crate::error::RanksError;
use crate::evaluate::{EvalError, EvalReport, Scoring, evaluate_with_future};
use crate::ranks::{Ranks, Share, ShareError, all_gather, alone};
use crate::registry::Registry;
use gs_data::{Dataset, ImageCache, Split};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::ops::Deref;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Steps between two comparisons of the parameters of all ranks.
const COMPARED_EVERY: u32 = 100;

/// What the first rank asks of the others.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) enum Command {
    /// Make the next step.
    Step,
    /// Make the rows of all ranks whole.
    Gather,
    /// Score views ([`Trainer::evaluate`]).
    Evaluate,
    /// There is nothing more to do.
    End,
}

/// The ranks of a trainer. When the first rank drops it, the others are told that nothing more is to be done, if they wait for that.
pub(super) struct Team {
    ranks: Counted,
    leads: bool,
    /// Whether the others were asked for something and may not be done with it.
    busy: AtomicBool,
}

/// Ranks, and the bytes that this one sent to others.
struct Counted {
    ranks: Arc<dyn Ranks>,
    sent: AtomicU64,
}

impl Ranks for Counted {
    fn rank(&self) -> usize {
        self.ranks.rank()
    }

    fn size(&self) -> usize {
        self.ranks.size()
    }

    fn all_to_all(&self, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>, RanksError> {
        let others = to.iter().enumerate().filter(|(rank, _)| *rank != self.rank());
        self.sent.fetch_add(others.map(|(_, bytes)| bytes.len() as u64).sum(), Ordering::Relaxed);
        self.ranks.all_to_all(to)
    }
}

impl Default for Team {
    fn default() -> Self {
        Self::new(alone(), false)
    }
}

impl Team {
    fn new(ranks: Arc<dyn Ranks>, leads: bool) -> Self {
        Self { ranks: Counted { ranks, sent: AtomicU64::new(0) }, leads, busy: AtomicBool::new(false) }
    }

    /// Passes on what all ranks did together. The others wait for a command again, unless it ended because `lost` says that ranks could not talk
    /// to each other.
    pub(super) fn done<T, E>(&self, done: Result<T, E>, lost: impl FnOnce(&E) -> bool) -> Result<T, E> {
        self.busy.store(done.as_ref().is_err_and(lost), Ordering::Relaxed);
        done
    }

    /// The same ranks, for work without steps.
    fn share(&self) -> Share {
        Share::new(self.ranks.ranks.clone())
    }

    /// Bytes that this rank sent to others since the last call.
    pub(super) fn take_sent(&self) -> u64 {
        self.ranks.sent.swap(0, Ordering::Relaxed)
    }
}

impl Deref for Team {
    type Target = dyn Ranks;

    fn deref(&self) -> &Self::Target {
        &self.ranks
    }
}

impl Drop for Team {
    fn drop(&mut self) {
        if self.leads && !self.busy.load(Ordering::Relaxed) {
            // Ranks that cannot be told have noticed.
            let _ = all_gather(&**self, &Some(Command::End));
        }
    }
}

/// Whether ranks could not talk to each other.
pub(super) fn lost(error: &TrainError) -> bool {
    matches!(error, TrainError::Ranks(_))
}

/// What all ranks found, in the order of ranks, and what this one keeps. If one failed, all do.
pub(super) fn all_gather_results<T, U>(
    ranks: &dyn Ranks,
    mine: Result<(T, U), TrainError>,
) -> Result<(Vec<T>, U), TrainError>
where
    T: Serialize + DeserializeOwned + Clone,
{
    let sent = mine.as_ref().map(|(fact, _)| fact.clone()).map_err(|e| (e.exit_code(), e.to_string()));
    let received: Vec<Result<T, (u8, String)>> = all_gather(ranks, &sent)?;
    let (_, kept) = mine?;
    let received = received.into_iter().enumerate();
    let all = received.map(|(rank, result)| result.map_err(|(code, what)| TrainError::Rank { rank, what, code }));
    Ok((all.collect::<Result<_, _>>()?, kept))
}

impl Trainer {
    /// The same run, made by several ranks together; to be called on the first. Every other calls [`Self::join`], then
    /// [`Self::follow`]. Parameters are the same bits as those of one rank.
    ///
    /// # Errors
    /// If this rank cannot begin, or another one cannot join.
    pub fn lead(mut self, ranks: Arc<dyn Ranks>) -> Result<Self, TrainError> {
        if ranks.size() > 1 {
            let left = self.leave_device();
            let state = left.and_then(|()| self.state().to_bytes().map_err(|e| TrainError::State(e.to_string())));
            // The others wait for a state, whatever it is, and for the result.
            let (bytes, ready) = match state {
                Ok(bytes) => (bytes, Ok(((), ()))),
                Err(e) => (Vec::new(), Err(e)),
            };
            ranks.all_gather(bytes)?;
            all_gather_results(&*ranks, ready)?;
            self.ranks = Team::new(ranks, true);
        }
        Ok(self)
    }

    /// A run that the first rank leads, on the same data; `image_bytes` as in [`TrainOptions`](super::TrainOptions). Where the
    /// data cannot be read, all ranks are told.
    ///
    /// # Errors
    /// If there are no data, the run does not fit them, or another rank cannot join.
    pub fn join(
        registry: &Registry,
        data: Result<Arc<Dataset>, TrainError>,
        image_bytes: usize,
        ranks: Arc<dyn Ranks>,
    ) -> Result<Self, TrainError> {
        let state = ranks.all_gather(Vec::new())?.into_iter().next().unwrap_or_default();
        let state = Checkpoint::from_bytes(&state).map_err(|e| TrainError::State(e.to_string()));
        let joined = data.and_then(|data| Self::resume(registry, data, &state?, None, image_bytes));
        let (_, mut trainer) = all_gather_results(&*ranks, joined.map(|trainer| ((), trainer)))?;
        trainer.ranks = Team::new(ranks, false);
        Ok(trainer)
    }

    /// Does what the first rank does, until that has ended.
    ///
    /// # Errors
    /// If ranks cannot talk to each other. Anything else that goes wrong is the first rank's to report.
    pub fn follow(&mut self) -> Result<(), TrainError> {
        loop {
            let command = all_gather::<Option<Command>>(&*self.ranks, &None)?.into_iter().next().flatten();
            let done = match command {
                Some(Command::Step) => self.step_with_ranks().map(drop),
                Some(Command::Gather) => self.gather_rows(),
                Some(Command::Evaluate) => {
                    match self.evaluate_with_ranks(&image_cache(&self.dataset, &self.options, 1.0)) {
                        Err(EvalError::Rank(ShareError::Ranks(e))) => Err(e.into()),
                        _ => Ok(()),
                    }
                }
                Some(Command::End) | None => return Ok(()),
            };
            if done.as_ref().is_err_and(lost) {
                return done;
            }
        }
    }

    /// Makes this rank hold the whole state, of which others or a device hold a part: to be called before [`Self::state`].
    ///
    /// # Errors
    /// If ranks cannot talk to each other or have different parameters, or the device fails.
    pub fn gather(&mut self) -> Result<(), TrainError> {
        self.fetch()?;
        self.ask(Command::Gather)?;
        let gathered = self.gather_rows();
        self.ranks.done(gathered, lost)
    }

    /// What is saved is the same on all ranks.
    fn gather_rows(&mut self) -> Result<(), TrainError> {
        self.share_rows()?;
        self.compare_ranks()
    }

    /// Scores the test views, or the training views where there are none, and beside them the views beyond the last training time
    /// where there are any; the other ranks score theirs. `images` has them at full size. [`Self::fetch`] is called first.
    ///
    /// # Errors
    /// If an image cannot be read, a frame is not finite, or a rank cannot be reached.
    pub fn evaluate(&self, images: &ImageCache) -> Result<EvalReport, EvalError> {
        self.ask(Command::Evaluate).map_err(ShareError::from)?;
        let scored = self.evaluate_with_ranks(images);
        self.ranks.done(scored, |e| matches!(e, EvalError::Rank(ShareError::Ranks(_))))
    }

    fn evaluate_with_ranks(&self, images: &ImageCache) -> Result<EvalReport, EvalError> {
        let (data, background) = (&self.dataset, self.model.background());
        let split = if data.test.is_empty() { Split::Train } else { Split::Test };
        self.ranks.share().finish(
            |share| {
                let scoring = Scoring::new(background, images, share, &self.device);
                evaluate_with_future(&self.model, data, split, &scoring)
            },
            |e| (3, e.to_string()),
        )
    }

    /// Asks the other ranks to do the same; [`Team::done`] is called after it.
    pub(super) fn ask(&self, command: Command) -> Result<(), RanksError> {
        if self.ranks.leads {
            if self.ranks.busy.swap(true, Ordering::Relaxed) {
                return Err(RanksError { what: "an earlier error left them at different places".into() });
            }
            all_gather(&*self.ranks, &Some(command))?;
        }
        Ok(())
    }

    /// Compares the parameters of all ranks every [`COMPARED_EVERY`] steps.
    pub(super) fn compare_ranks_at_times(&self) -> Result<(), TrainError> {
        if self.step.is_multiple_of(COMPARED_EVERY) { self.compare_ranks() } else { Ok(()) }
    }

    /// Whether all ranks hold the same parameters.
    fn compare_ranks(&self) -> Result<(), TrainError> {
        if self.ranks.size() == 1 {
            return Ok(());
        }
        let mut sum = crc32fast::Hasher::new();
        self.model.visit(&mut |p| p.value.iter().for_each(|v| sum.update(&v.to_le_bytes())));
        let sums = all_gather(&*self.ranks, &sum.finalize())?;
        let ranks: Vec<usize> = (0..sums.len()).filter(|r| sums[*r] != sums[0]).collect();
        if ranks.is_empty() { Ok(()) } else { Err(TrainError::Diverged { step: self.step, ranks }) }
    }
}
