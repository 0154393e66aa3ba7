//! The process that runs inputs of one target until its time is over. It may abort or hang: its parent watches.

use crate::case::Case;
use crate::coverage::Coverage;
use crate::guard::{self, Outcome};
use crate::mutate::mutate;
use crate::state::{self, Counts, StateFile};
use crate::targets::{Error, Target};
use crate::{WorkFolder, findings};
use gs_core::Rng;
use std::time::Duration;

/// Inputs kept because they took new edges; beyond it none is added.
const MAX_CORPUS: usize = 4096;

/// When a child ends.
pub struct Until {
    pub time: Duration,
    pub inputs: u64,
}

struct Child<'a> {
    target: &'a Target,
    work: &'a WorkFolder,
    coverage: Coverage,
    counts: Counts,
    file: StateFile,
}

impl Child<'_> {
    /// Runs one input and counts it; says whether it took new edges, and how it ended.
    fn step(&mut self, case: &Case) -> Result<(bool, Outcome), Error> {
        self.counts.inputs += 1;
        self.file.put(self.counts, case)?;
        self.coverage.reset();
        let outcome = guard::run(self.target, case, &self.work.data());
        let new = self.coverage.is_new();
        let c = &mut self.counts;
        if new {
            c.edges = self.coverage.edges().max(c.edges);
        }
        c.accepted += u64::from(outcome.accepted.is_ok());
        c.peak = c.peak.max(outcome.peak as u64);
        let took = outcome.took.as_micros() as u64;
        c.slowest_us = c.slowest_us.max(took);
        c.spent_us += took;
        if let Some(fault) = &outcome.fault {
            c.faults += 1;
            c.over += u64::from(fault.kind == "memory");
            findings::keep(self.target.name, fault, case)?;
        }
        Ok((new, outcome))
    }
}

/// Runs the seeds, then mutations of them and of what took new edges; goes on with the input behind the last one of an
/// earlier child. A program without counters mutates the seeds alone.
///
/// # Errors
/// If a seed is not accepted, or the system refuses.
pub fn run(target: &Target, seed: u64, until: Until, work: &WorkFolder) -> Result<(), Error> {
    guard::prepare()?;
    let counts = state::read(&work.state()).0;
    let mut child = Child { target, work, coverage: Coverage::new(), counts, file: StateFile::open(&work.state())? };
    let mut corpus = (target.seeds)(&work.data())?;
    for (k, case) in corpus.iter().enumerate() {
        let (_, outcome) = child.step(case)?;
        outcome.accepted.map_err(|e| format!("seed {k} of {} is not accepted: {e}", target.name))?;
    }
    let start = std::time::Instant::now();
    while start.elapsed() < until.time && child.counts.inputs < until.inputs {
        let mut rng = Rng::new(seed, target.name, 0, child.counts.inputs);
        let other = choose(&corpus, &mut rng);
        let mut case = choose(&corpus, &mut rng).clone();
        mutate(&mut case, other, &mut rng);
        (target.repair)(&mut case, &mut rng);
        let (new, outcome) = child.step(&case)?;
        if new && outcome.fault.is_none() && corpus.len() < MAX_CORPUS {
            corpus.push(case);
        }
    }
    child.file.put(child.counts, &Case::default())?;
    Ok(())
}

/// An input to go on from: half of the time one of the newest.
fn choose<'a>(corpus: &'a [Case], rng: &mut Rng) -> &'a Case {
    let n = corpus.len() as u32;
    let from = if rng.below(2) == 0 { n - n.div_ceil(8) } else { 0 };
    &corpus[(from + rng.below(n - from)) as usize]
}
