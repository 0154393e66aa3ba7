//! Gradients that are not finite, counted and named.

use gs_core::Param;
use serde::{Deserialize, Serialize};

/// Gradients met that were not finite.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct Refused {
    /// Rows of row blocks (the largest count of any block), which were skipped.
    pub rows: u32,
    /// Rows in the block of that count.
    pub of: u32,
    /// The block of that count, and the first of these rows.
    pub first: Option<(String, u32)>,
    /// The first shared block with such a gradient, if any: the run cannot go on.
    pub shared: Option<String>,
}

/// Rows of one block whose gradient was not finite, and which were left as they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(crate) struct RefusedRows {
    /// Number of such rows.
    pub rows: u32,
    /// The first of them.
    pub first: Option<u32>,
}

impl RefusedRows {
    /// These and those of later rows of the same block.
    pub(crate) fn and(self, later: &Self) -> Self {
        Self { rows: self.rows + later.rows, first: self.first.or(later.first) }
    }
}

impl Refused {
    /// Adds the rows refused of all of a block.
    pub(crate) fn add(&mut self, p: &Param, block: &RefusedRows) {
        if block.rows == 0 {
            return;
        }
        match p.row_count() {
            None => self.shared = self.shared.take().or_else(|| Some(p.name.clone())),
            Some(count) if block.rows > self.rows => {
                (self.rows, self.of) = (block.rows, count as u32);
                self.first = block.first.map(|row| (p.name.clone(), row));
            }
            Some(_) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_refused_by_several_ranks_are_summed() {
        let of = |rows, first| RefusedRows { rows, first };
        assert_eq!(of(0, None).and(&of(1, Some(7))).and(&of(2, Some(700))), of(3, Some(7)));
    }
}
