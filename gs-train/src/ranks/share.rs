//! Work without steps (images to render, views to score, files to write) that ranks share item by item.

use super::{Ranks, alone, packed, tree, unpacked};
use crate::error::RanksError;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Why shared work ended on this rank, if not by its own fault.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ShareError {
    /// A rank cannot be reached.
    #[error("ranks cannot talk to each other: {}", .0.what)]
    Ranks(#[from] RanksError),
    /// Another rank failed.
    #[error("rank {rank}: {what}")]
    Rank {
        /// Its number.
        rank: usize,
        /// What it said.
        what: String,
        /// Its exit code.
        code: u8,
    },
}

/// The ranks of shared work, one by default. All of them make the same calls in the same order; each does a contiguous run of the items.
///
/// A rank that fails by itself leaves its work; the others hear of it at their next call ([`Share::finish`]).
///
/// ```
/// use gs_train::ranks::{Share, ShareError};
///
/// let work = |share: &Share| share.each(3, |k| Ok::<_, ShareError>(k * k));
/// assert_eq!(Share::default().finish(work, |e| (1, e.to_string()))?, [0, 1, 4]);
/// # Ok::<_, ShareError>(())
/// ```
pub struct Share {
    ranks: Arc<dyn Ranks>,
    /// Whether the ranks know that one of them failed.
    failed: AtomicBool,
}

impl Share {
    /// Work of these ranks.
    pub fn new(ranks: Arc<dyn Ranks>) -> Self {
        Self { ranks, failed: AtomicBool::new(false) }
    }

    /// Number of this rank, from 0.
    pub fn rank(&self) -> usize {
        self.ranks.rank()
    }

    /// Whether this is the first rank, which writes what is written once.
    pub fn leads(&self) -> bool {
        self.rank() == 0
    }

    /// Number of ranks.
    pub fn size(&self) -> usize {
        self.ranks.size()
    }

    /// The items of this rank, of `count`.
    pub fn run(&self, count: usize) -> Range<usize> {
        tree::run_of(count, self.rank(), self.size())
    }

    /// Does the items `0..count`, each on one rank; gives the results of all, numbers that are not finite too, in their order, on every
    /// rank.
    ///
    /// # Errors
    /// Those of `item`, and if another rank failed or cannot be reached.
    pub fn each<T, E>(&self, count: usize, item: impl FnMut(usize) -> Result<T, E>) -> Result<Vec<T>, E>
    where
        T: Serialize + DeserializeOwned,
        E: From<ShareError>,
    {
        let mine: Vec<T> = self.run(count).map(item).collect::<Result<_, E>>()?;
        if self.size() == 1 {
            return Ok(mine);
        }
        let bytes = packed(&mine).map_err(ShareError::from)?;
        let received = self.meet(Ok(bytes), |_| true)?.into_iter().enumerate();
        let of = |(rank, bytes): (usize, Vec<u8>)| unpacked::<Vec<T>>(rank, &bytes).map_err(|e| self.over(e));
        Ok(received.map(of).collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect())
    }

    /// Waits until all ranks have come so far.
    ///
    /// # Errors
    /// If another rank failed or cannot be reached.
    pub fn barrier(&self) -> Result<(), ShareError> {
        self.meet(Ok(Vec::new()), |_| false).map(drop)
    }

    /// Sends bytes to the first rank; gives it those of all ranks, in their order, and the others as many empty ones.
    ///
    /// # Errors
    /// If another rank failed or cannot be reached.
    pub fn gather(&self, bytes: Vec<u8>) -> Result<Vec<Vec<u8>>, ShareError> {
        self.meet(Ok(bytes), |rank| rank == 0)
    }

    /// Does `work` on all ranks, and waits for its end on all. `failure` makes exit code and message of an error, for the others.
    ///
    /// # Errors
    /// Those of `work`, and if another rank failed or cannot be reached.
    pub fn finish<T, E: From<ShareError>>(
        &self,
        work: impl FnOnce(&Self) -> Result<T, E>,
        failure: impl FnOnce(&E) -> (u8, String),
    ) -> Result<T, E> {
        let done = work(self);
        let ended = self.end(done.as_ref().map(drop).map_err(failure));
        let done = done?;
        ended?;
        Ok(done)
    }

    fn end(&self, mine: Result<(), (u8, String)>) -> Result<(), ShareError> {
        let failed = mine.is_err();
        if self.failed.load(Ordering::Relaxed) {
            return Ok(());
        }
        let met = self.meet(mine.map(|()| Vec::new()), |_| false).map(drop);
        if failed { Ok(()) } else { met }
    }

    /// Tells every rank whether this one goes on, and those that `receives` names some bytes.
    fn meet(
        &self,
        mine: Result<Vec<u8>, (u8, String)>,
        receives: impl Fn(usize) -> bool,
    ) -> Result<Vec<Vec<u8>>, ShareError> {
        let message = |rank: usize| match &mine {
            Ok(bytes) if receives(rank) => [&[0], &bytes[..]].concat(),
            Ok(_) => vec![0],
            Err((code, what)) => [&[1, *code], what.as_bytes()].concat(),
        };
        let received = self.ranks.all_to_all((0..self.size()).map(message).collect()).map_err(|e| self.over(e))?;
        let read = |(rank, mut bytes): (usize, Vec<u8>)| match bytes.first() {
            Some(0) => Ok(bytes.split_off(1)),
            Some(_) if bytes.len() > 1 => {
                let what = String::from_utf8_lossy(&bytes[2..]).into_owned();
                Err(self.over(ShareError::Rank { rank, what, code: bytes[1] }))
            }
            _ => Err(self.over(RanksError::short(rank))),
        };
        received.into_iter().enumerate().map(read).collect()
    }

    /// The error, after which no rank is told of another.
    fn over(&self, e: impl Into<ShareError>) -> ShareError {
        self.failed.store(true, Ordering::Relaxed);
        e.into()
    }
}

impl Default for Share {
    fn default() -> Self {
        Self::new(alone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testkit::threads_as_ranks;

    /// What each of so many ranks made of some work.
    fn on<T: Send>(
        count: usize,
        work: impl Fn(&Share, usize) -> Result<T, ShareError> + Sync,
    ) -> Vec<Result<T, ShareError>> {
        std::thread::scope(|scope| {
            let work = &work;
            let rank = |(rank, ranks)| {
                scope.spawn(move || Share::new(ranks).finish(|share| work(share, rank), |e| (3, e.to_string())))
            };
            let threads: Vec<_> = threads_as_ranks(count).into_iter().enumerate().map(rank).collect();
            threads.into_iter().map(|t| t.join().expect("rank")).collect()
        })
    }

    fn fault() -> ShareError {
        RanksError { what: "a fault".to_owned() }.into()
    }

    #[test]
    fn every_rank_has_the_results_of_all_in_order() {
        for ranks in 1..=5 {
            for items in [0, 1, 3, 7] {
                for done in on(ranks, |share, _| share.each(items, |k| Ok(0.1 * k as f64))) {
                    assert_eq!(done.unwrap(), (0..items).map(|k| 0.1 * k as f64).collect::<Vec<_>>());
                }
            }
        }
    }

    #[test]
    fn results_that_are_not_finite_arrive() {
        for done in on(2, |share, _| share.each(2, |k| Ok([f64::INFINITY, f64::NEG_INFINITY][k]))) {
            assert_eq!(done.unwrap(), [f64::INFINITY, f64::NEG_INFINITY]);
        }
    }

    #[test]
    fn the_first_rank_alone_receives_what_is_sent_to_it() {
        let sent = on(3, |share, rank| share.gather(vec![rank as u8; rank]));
        let received: Vec<_> = sent.into_iter().map(Result::unwrap).collect();
        assert_eq!(received[0], [vec![], vec![1], vec![2, 2]]);
        assert_eq!(received[1..], [vec![Vec::<u8>::new(); 3], vec![Vec::new(); 3]]);
    }

    #[test]
    fn a_rank_that_fails_ends_all_wherever_they_are() {
        // Before the first meeting, in an item, after the last meeting.
        for place in 0..3 {
            for failing in 0..3 {
                let ends = on(3, |share, rank| {
                    let here = |at| if at == place && rank == failing { Err(fault()) } else { Ok(()) };
                    here(0)?;
                    share.barrier()?;
                    share.each(6, |_| here(1))?;
                    here(2)
                });
                for (rank, end) in ends.into_iter().enumerate() {
                    let error = end.expect_err("every rank ends with an error");
                    let other = matches!(&error, ShareError::Rank { rank: r, code: 3, what } if *r == failing && what.contains("a fault"));
                    assert!(
                        if rank == failing { error == fault() } else { other },
                        "{place} {failing} {rank}: {error}"
                    );
                }
            }
        }
    }
}
