//! What ranks tell each other: rows that they own, and small facts.

use super::coding::{decode, encode};
use super::render_pass::{Phases, Stopwatch};
use super::sums::{owned, unit};
use super::{TrainError, Trainer};
use crate::adam::{Refused, RefusedRows};
use crate::method::Merge;
use crate::model::Model;
use crate::ranks::all_gather;
use gs_core::Param;

/// Columns that every rank holds, and of which one run is right on each.
#[derive(Clone, Copy)]
enum Held<'a> {
    /// Buffers without rows that views change.
    Statistics,
    /// Gradients of blocks that learn.
    Gradients(&'a dyn Fn(&str) -> bool),
    /// Values of blocks that learn.
    Values(&'a dyn Fn(&str) -> bool),
    /// Moments of all blocks, and buffers of rows that views change.
    Rows,
}

impl Held<'_> {
    /// Calls `f` with the unit and the values of every column.
    fn each(self, model: &mut Model, f: &mut dyn FnMut(usize, &mut Vec<f32>)) {
        model.visit_mut(&mut |p| match self {
            Held::Gradients(learns) if learns(&p.name) => f(unit(p.row_width), &mut p.grad),
            Held::Values(learns) if learns(&p.name) => f(unit(p.row_width), &mut p.value),
            Held::Rows => {
                f(unit(p.row_width), &mut p.moment1);
                f(unit(p.row_width), &mut p.moment2);
            }
            _ => {}
        });
        model.buffers_mut(&mut |b| match self {
            Held::Statistics if b.merge != Merge::Keep && b.row_width.is_none() => f(unit(None), b.values),
            Held::Rows if b.merge != Merge::Keep && b.row_width.is_some() => f(unit(b.row_width), b.values),
            _ => {}
        });
    }
}

impl Trainer {
    /// Makes statistics without rows whole on every rank.
    pub(super) fn share_statistics(&mut self) -> Result<(), TrainError> {
        self.share(Held::Statistics, None)
    }

    /// Makes the gradients of blocks that learn whole on every rank.
    pub(super) fn share_gradients(&mut self, learns: &dyn Fn(&str) -> bool) -> Result<(), TrainError> {
        self.share(Held::Gradients(learns), None)
    }

    /// Makes moments and statistics of rows whole on every rank: before rows are edited, or the state is saved.
    pub(super) fn share_rows(&mut self) -> Result<(), TrainError> {
        self.share(Held::Rows, None)
    }

    /// Tells the values of the runs that this rank owns. What others know already, `known`, does not travel; without it, they
    /// know zeros.
    fn share(&mut self, held: Held<'_>, known: Option<&[Vec<f32>]>) -> Result<(), TrainError> {
        let (me, ranks) = (self.ranks.rank(), self.ranks.size());
        if ranks == 1 {
            return Ok(());
        }
        let (mut bytes, mut column) = (Vec::new(), 0);
        held.each(&mut self.model, &mut |unit, values| {
            let known = known.map_or(&[][..], |k| &k[column]);
            encode(&values[owned(values.len(), unit, me, ranks)], known, unit, &mut bytes);
            column += 1;
        });
        for (rank, bytes) in self.ranks.all_gather(bytes)?.iter().enumerate().filter(|(rank, _)| *rank != me) {
            let (mut rest, mut result) = (&bytes[..], Ok(()));
            held.each(&mut self.model, &mut |unit, values| {
                let len = values.len();
                let run = &mut values[owned(len, unit, rank, ranks)];
                if known.is_none() {
                    run.fill(0.0);
                }
                result = result.and_then(|()| decode(&mut rest, run, unit));
            });
            result.map_err(|_| TrainError::short(rank))?;
        }
        Ok(())
    }

    /// Adam on every block that learns in this step, in the rows that this rank owns; then all ranks have all rows.
    pub(super) fn update(&mut self, ms: &mut Phases) -> Result<Refused, TrainError> {
        let (me, ranks, mut clock) = (self.ranks.rank(), self.ranks.size(), Stopwatch::new());
        let updates = std::mem::take(&mut self.updates);
        let learns = |name: &str| updates.get(name).is_some_and(Option::is_some);
        let (adam, mut before, mut rows) = (&mut self.adam, Vec::new(), Vec::new());
        self.model.visit_mut(&mut |p| {
            if let Some(update) = updates.get(&p.name).copied().flatten() {
                let run = owned(p.len(), unit(p.row_width), me, ranks);
                if ranks > 1 {
                    before.push(p.value[run.clone()].to_vec());
                }
                rows.push(adam.update_run(p, update, run));
            }
            if ranks > 1 || !learns(&p.name) {
                p.clear_grad();
            }
        });
        ms.adam = clock.lap();
        self.share(Held::Values(&learns), Some(&before))?;
        let refused = self.refused(&rows, &learns);
        ms.exchange += clock.lap();
        self.updates = updates;
        refused
    }

    /// The rows that all ranks refused, of those of each block that learns.
    fn refused(&self, mine: &[RefusedRows], learns: &dyn Fn(&str) -> bool) -> Result<Refused, TrainError> {
        let received = match self.ranks.size() {
            1 => vec![mine.to_vec()],
            _ => all_gather(&*self.ranks, &mine.to_vec())?,
        };
        let (mut refused, mut block) = (Refused::default(), 0);
        self.model.visit(&mut |p: &Param| {
            if learns(&p.name) {
                let of_ranks = received.iter().filter_map(|rank| rank.get(block));
                refused.add(p, &of_ranks.fold(RefusedRows::default(), |all, rows| all.and(rows)));
                block += 1;
            }
        });
        Ok(refused)
    }
}
