//! What the views of a step add up: gradients of the blocks that learn, and statistics.

use crate::method::Merge;
use crate::model::Model;
use rayon::prelude::*;
use std::ops::Range;

/// Values of a column without rows that one rank owns together.
const UNIT: usize = 16;
/// Values per parallel piece.
const PIECE: usize = 1 << 14;

/// One column of values each: those of all columns, or a run of each.
pub(super) type Columns = Vec<Vec<f32>>;

/// A column that views change.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Shape {
    /// Number of values.
    len: usize,
    /// Values that one rank owns together: a row.
    pub unit: usize,
    /// How views are put together.
    merge: Merge,
}

impl Shape {
    /// The values that a rank owns.
    pub(super) fn owned(&self, rank: usize, ranks: usize) -> Range<usize> {
        owned(self.len, self.unit, rank, ranks)
    }
}

/// The run of values that a rank owns of a column of `len` values, in whole units.
pub(super) fn owned(len: usize, unit: usize, rank: usize, ranks: usize) -> Range<usize> {
    let units = crate::ranks::tree::run_of(len.div_ceil(unit), rank, ranks);
    (units.start * unit).min(len)..(units.end * unit).min(len)
}

/// Values of a column that one rank owns together: a row, where it has rows.
pub(super) fn unit(row_width: Option<usize>) -> usize {
    row_width.unwrap_or(UNIT)
}

/// The sums of a step: takes what each view added out of the model, and puts what all added back.
pub(super) struct Sums {
    shapes: Vec<Shape>,
    /// What views begin with; empty for zeros.
    begin: Columns,
    /// Statistics of earlier steps, to which those of this step are added.
    before: Columns,
}

impl Sums {
    /// Prepares a model, whose gradients are zero, for the first view of a step: of the blocks that `learn`.
    pub(super) fn new(model: &mut Model, learns: &dyn Fn(&str) -> bool) -> Self {
        let mut sums = Self { shapes: Vec::new(), begin: Vec::new(), before: Vec::new() };
        each(model, learns, &mut |shape, gradient, values| {
            let (mut begin, mut before) = Default::default();
            match shape.merge {
                Merge::Max => Vec::clone_from(&mut begin, values),
                Merge::Sum if !gradient => before = std::mem::replace(values, vec![0.0; shape.len]),
                _ => {}
            }
            sums.shapes.push(shape);
            sums.begin.push(begin);
            sums.before.push(before);
        });
        sums
    }

    /// The columns, in the order of [`Columns`].
    pub(super) fn shapes(&self) -> &[Shape] {
        &self.shapes
    }

    /// What a view begins with in a column: zeros if empty.
    pub(super) fn begin(&self, column: usize) -> &[f32] {
        &self.begin[column]
    }

    /// Takes what a view added, and prepares the model for the next view.
    pub(super) fn take(&self, model: &mut Model, learns: &dyn Fn(&str) -> bool) -> Columns {
        let mut taken = Vec::with_capacity(self.shapes.len());
        each(model, learns, &mut |shape, _, values| {
            let begin = &self.begin[taken.len()];
            let fresh = if begin.is_empty() { vec![0.0; shape.len] } else { begin.clone() };
            taken.push(std::mem::replace(values, fresh));
        });
        taken
    }

    /// Puts what all views added into the model: whole columns, or the runs that a rank owns.
    pub(super) fn put(
        self,
        model: &mut Model,
        learns: &dyn Fn(&str) -> bool,
        sum: Columns,
        run: Option<(usize, usize)>,
    ) {
        let mut sum = sum.into_iter().zip(self.before);
        each(model, learns, &mut |shape, _, values| {
            let Some((added, mut before)) = sum.next() else { return };
            let run = run.map_or(0..shape.len, |(rank, ranks)| shape.owned(rank, ranks));
            if before.is_empty() {
                match added.len() == values.len() {
                    true => *values = added,
                    false => values[run].copy_from_slice(&added),
                }
            } else {
                before[run].iter_mut().zip(added).for_each(|(before, added)| *before += added);
                *values = before;
            }
        });
    }

    /// Puts what this rank knows into what others found, where the largest counts: theirs begins with older values.
    pub(super) fn merge_most(&self, into: &mut Columns, known: Columns) {
        for ((into, known), shape) in into.iter_mut().zip(known).zip(&self.shapes) {
            if shape.merge == Merge::Max {
                into.iter_mut().zip(known).for_each(|(a, b)| *a = a.max(b));
            }
        }
    }

    /// Puts the sums of further leaves together with those of earlier ones.
    pub(super) fn merge(&self, into: &mut Columns, other: Columns) {
        for ((into, other), shape) in into.iter_mut().zip(other).zip(&self.shapes) {
            let pieces = into.par_chunks_mut(PIECE).zip(other.par_chunks(PIECE));
            match shape.merge {
                Merge::Max => pieces.for_each(|(a, b)| a.iter_mut().zip(b).for_each(|(a, b)| *a = a.max(*b))),
                _ => pieces.for_each(|(a, b)| a.iter_mut().zip(b).for_each(|(a, b)| *a += b)),
            }
        }
    }
}

/// Calls `f` on every column that views change, always in the same order: shape, whether it is a gradient, values.
fn each(model: &mut Model, learns: &dyn Fn(&str) -> bool, f: &mut dyn FnMut(Shape, bool, &mut Vec<f32>)) {
    model.visit_mut(&mut |p| {
        if learns(&p.name) {
            let shape = Shape { len: p.len(), unit: unit(p.row_width), merge: Merge::Sum };
            f(shape, true, &mut p.grad);
        }
    });
    model.buffers_mut(&mut |b| {
        if b.merge != Merge::Keep {
            let shape = Shape { len: b.values.len(), unit: unit(b.row_width), merge: b.merge };
            f(shape, false, b.values);
        }
    });
}
