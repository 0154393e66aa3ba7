//! Ranks: processes that make every step of a training together.
//!
//! The views of a step are the leaves of an aligned binary tree ([`tree`]); a rank computes a contiguous run of them. Whole
//! subtrees of its run it sums alone, the rest is summed by the rank that owns a row, in the order of the tree. So a sum
//! has the same bits for any number of ranks, where a reduction of MPI has others for each.
//!
//! [`Alone`] is one rank; other numbers come from a program that brings [`Ranks`] of its own. [`Share`] is for work without
//! steps.

mod share;
pub mod tree;

pub use share::{Share, ShareError};

use crate::error::RanksError;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::sync::Arc;

/// Processes, or threads, that call the same functions in the same order.
///
/// After a [`RanksError`] the other ranks may be at another place, where they would take what this one sends for something else, or wait
/// for it for ever. So this one sends nothing more, which [`Trainer`](crate::trainer::Trainer) and [`Share`] see to, and its process ends at
/// once: MPI ends a job of which one process goes without `MPI_Finalize`.
pub trait Ranks: Send + Sync {
    /// Number of this rank, from 0.
    fn rank(&self) -> usize;

    /// Number of ranks, at least 1.
    fn size(&self) -> usize;

    /// Sends `to[r]` to every rank `r`; gives what each rank sent here, in the order of ranks.
    ///
    /// # Errors
    /// If a rank cannot be reached.
    fn all_to_all(&self, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>, RanksError>;

    /// Sends the same to every rank; gives what each rank sent, in the order of ranks.
    ///
    /// # Errors
    /// If a rank cannot be reached.
    fn all_gather(&self, bytes: Vec<u8>) -> Result<Vec<Vec<u8>>, RanksError> {
        self.all_to_all(vec![bytes; self.size()])
    }
}

/// One rank.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alone;

impl Ranks for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn size(&self) -> usize {
        1
    }

    fn all_to_all(&self, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>, RanksError> {
        Ok(to)
    }
}

/// One rank, as programs pass it around.
pub fn alone() -> Arc<dyn Ranks> {
    Arc::new(Alone)
}

/// A fact of every rank, numbers that are not finite too, in the order of ranks, on every rank.
///
/// # Errors
/// If a rank cannot be reached, or sends something else.
pub fn all_gather<T: Serialize + DeserializeOwned>(ranks: &dyn Ranks, fact: &T) -> Result<Vec<T>, RanksError> {
    let received = ranks.all_gather(packed(fact)?)?.into_iter().enumerate();
    received.map(|(rank, bytes)| unpacked(rank, &bytes)).collect()
}

/// A fact as bytes, with numbers that are not finite (CBOR, where JSON has none).
fn packed<T: Serialize>(fact: &T) -> Result<Vec<u8>, RanksError> {
    let mut bytes = Vec::new();
    ciborium::into_writer(fact, &mut bytes).map_err(|e| RanksError { what: e.to_string() })?;
    Ok(bytes)
}

/// The fact that a rank has [`packed`].
fn unpacked<T: DeserializeOwned>(rank: usize, bytes: &[u8]) -> Result<T, RanksError> {
    ciborium::from_reader(bytes).map_err(|_| RanksError::short(rank))
}
