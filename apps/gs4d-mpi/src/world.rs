//! The ranks of MPI's world.

use gs_train::error::RanksError;
use gs_train::ranks::Ranks;
use mpi::Threading;
use mpi::datatype::{Partition, PartitionMut};
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, CommunicatorCollectives};
use std::io::Write;
use std::process::ExitCode;
use std::sync::Arc;

/// Bytes that a rank sends in one call: MPI counts in 31 bits, and what arrives from all ranks must fit too.
const MOST: usize = 1 << 30;

/// All processes of the job.
struct World {
    rank: usize,
    size: usize,
}

pub(crate) fn main() -> ExitCode {
    // Steps are made on a thread of rayon's pool; only one thread calls at a time.
    // Dropped last: it ends MPI.
    let Some((universe, threading)) = mpi::initialize_with_threading(Threading::Serialized) else {
        return refuse("MPI is initialised already");
    };
    if threading < Threading::Serialized {
        return refuse("this MPI lets one thread call it only; use one with MPI_THREAD_SERIALIZED");
    }
    let world = universe.world();
    gs4d::main(Arc::new(World { rank: world.rank() as usize, size: world.size() as usize }))
}

fn refuse(what: &str) -> ExitCode {
    // Nobody may be reading it.
    let _ = writeln!(std::io::stderr(), "error[ranks]: {what}");
    ExitCode::from(1)
}

impl World {
    /// One call: `to[r]` goes to rank `r`.
    fn all_to_all_bounded(to: &[&[u8]]) -> Vec<Vec<u8>> {
        let lengths: Vec<i32> = to.iter().map(|bytes| bytes.len() as i32).collect();
        let mut arriving = vec![0i32; to.len()];
        let world = SimpleCommunicator::world();
        world.all_to_all_into(&lengths[..], &mut arriving[..]);
        let starts = |lengths: &[i32]| -> Vec<i32> {
            lengths.iter().scan(0, |at, n| Some(std::mem::replace(at, *at + n))).collect()
        };
        // One byte more: of nothing, the address may be that which means MPI_IN_PLACE.
        let (sent, at) = ([&to.concat()[..], &[0]].concat(), starts(&lengths));
        let from = starts(&arriving);
        let mut received = vec![0u8; 1 + arriving.iter().map(|n| *n as usize).sum::<usize>()];
        let send = Partition::new(&sent[..], &lengths[..], &at[..]);
        let mut receive = PartitionMut::new(&mut received[..], &arriving[..], &from[..]);
        world.all_to_all_varcount_into(&send, &mut receive);
        let part = |(at, n): (&i32, &i32)| received[*at as usize..][..*n as usize].to_vec();
        from.iter().zip(&arriving).map(part).collect()
    }
}

impl Ranks for World {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.size
    }

    fn all_to_all(&self, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>, RanksError> {
        let most = MOST / self.size;
        let longest = to.iter().map(Vec::len).max().unwrap_or(0);
        let mut rounds = vec![0u64; self.size];
        SimpleCommunicator::world().all_gather_into(&(longest.div_ceil(most) as u64), &mut rounds[..]);
        let rounds = rounds.into_iter().max().unwrap_or(0) as usize;
        let mut all = vec![Vec::new(); self.size];
        for round in 0..rounds {
            let piece = |bytes: &Vec<u8>| (round * most).min(bytes.len())..((round + 1) * most).min(bytes.len());
            let pieces: Vec<&[u8]> = to.iter().map(|bytes| &bytes[piece(bytes)]).collect();
            all.iter_mut().zip(Self::all_to_all_bounded(&pieces)).for_each(|(all, piece)| all.extend(piece));
        }
        Ok(all)
    }
}
