//! Parameters: a named block with its gradient and Adam's moments in one place, so that clone, split, prune and grow edit
//! all of them at once or none of them.
//!
//! ```
//! use gs_core::{Param, RowEdit};
//!
//! let mut scales = Param::rows("scales", 1, vec![0.1, 0.2, 0.3]);
//! scales.moment1 = vec![1.0, 2.0, 3.0];
//! // Prune row 1, clone row 2: kept rows carry their moments, new rows start at zero.
//! RowEdit { keep: vec![0, 2], append_from: vec![2] }.apply(&mut [&mut scales])?;
//! assert_eq!(scales.value, [0.1, 0.3, 0.3]);
//! assert_eq!(scales.moment1, [1.0, 3.0, 0.0]);
//! # Ok::<(), gs_core::param::RowEditError>(())
//! ```

/// A named block of parameters with its gradient and Adam's moments, all of one length.
#[derive(Clone, Debug, PartialEq)]
pub struct Param {
    /// Dotted name, unique within a method: `cloud.means`, `field.planes.xy.0`, `deform.layer0.weight`.
    pub name: String,
    /// `Some(w)`: one row of `w` values per Gaussian (or anchor), edited by [`RowEdit`]. `None`: shared by all.
    pub row_width: Option<usize>,
    /// Current values, row-major where there are rows.
    pub value: Vec<f32>,
    /// `dL/d value`; added to by backward passes, cleared by the optimiser.
    pub grad: Vec<f32>,
    /// First moment of Adam: running mean of the gradient.
    pub moment1: Vec<f32>,
    /// Second moment of Adam: running mean of the squared gradient.
    pub moment2: Vec<f32>,
}

impl Param {
    /// A block without rows, such as the weight of a network.
    pub fn shared(name: impl Into<String>, value: Vec<f32>) -> Self {
        Self::new(name.into(), None, value)
    }

    /// A block of `value.len() / width` rows of `width` values.
    pub fn rows(name: impl Into<String>, width: usize, value: Vec<f32>) -> Self {
        debug_assert!(width > 0 && value.len().is_multiple_of(width), "whole rows only");
        Self::new(name.into(), Some(width), value)
    }

    fn new(name: String, row_width: Option<usize>, value: Vec<f32>) -> Self {
        let zeros = vec![0.0; value.len()];
        Self { name, row_width, grad: zeros.clone(), moment1: zeros.clone(), moment2: zeros, value }
    }

    /// Number of values, `rows · width`.
    pub fn len(&self) -> usize {
        self.value.len()
    }

    /// Whether the block has no values.
    pub fn is_empty(&self) -> bool {
        self.value.is_empty()
    }

    /// Number of rows; `None` for a shared block.
    pub fn row_count(&self) -> Option<usize> {
        self.row_width.map(|w| self.value.len() / w)
    }

    /// Sets every entry of `grad` to zero.
    pub fn clear_grad(&mut self) {
        self.grad.fill(0.0);
    }

    /// Sets both of Adam's moments to zero.
    pub fn clear_moments(&mut self) {
        self.moment1.fill(0.0);
        self.moment2.fill(0.0);
    }
}

/// An owner of parameters. Checkpoints, the optimiser and storage tables visit them, always in the same order.
pub trait Params {
    /// Calls `f` on every block, in a fixed order.
    fn visit(&self, f: &mut dyn FnMut(&Param));
    /// As [`Params::visit`], in the same order, to change the blocks.
    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param));

    /// Total number of parameter values.
    fn param_count(&self) -> usize {
        let mut n = 0;
        self.visit(&mut |p| n += p.len());
        n
    }

    /// Sets the gradient of every block to zero.
    fn clear_grads(&mut self) {
        self.visit_mut(&mut Param::clear_grad);
    }
}

/// One structural change (clone, split, prune, grow) of all row blocks that belong together.
///
/// The new rows are `keep` in the given order, then copies of `append_from` (indices into the **old** rows). Kept rows
/// carry their moments; appended rows start with zero moments and zero gradient.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct RowEdit {
    /// Indices of the old rows that stay, in their new order.
    pub keep: Vec<u32>,
    /// Indices of the old rows to copy behind them.
    pub append_from: Vec<u32>,
}

/// An edit that cannot be applied. Nothing was changed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RowEditError {
    /// The block of this name has no rows.
    #[error("parameter `{0}` has no rows and cannot take a row edit")]
    NotRows(String),
    /// An index lies beyond the last row.
    #[error("row edit names row {row}, parameter `{name}` has {rows}")]
    OutOfRange {
        /// Name of the parameter block.
        name: String,
        /// The index that is out of range.
        row: u32,
        /// Number of rows of the block.
        rows: usize,
    },
}

impl RowEdit {
    /// Prunes: keeps the rows for which `keep` is true, appends nothing. `rows` is the number of old rows.
    pub fn retain(rows: usize, keep: impl Fn(usize) -> bool) -> Self {
        Self { keep: (0..rows).filter(|&r| keep(r)).map(|r| r as u32).collect(), append_from: Vec::new() }
    }

    /// Number of rows after the edit.
    pub fn new_rows(&self) -> usize {
        self.keep.len() + self.append_from.len()
    }

    /// Applies the edit to all of `params`, or to none of them.
    ///
    /// # Errors
    /// If a block has no rows or an index lies beyond its last row; nothing is changed then.
    pub fn apply(&self, params: &mut [&mut Param]) -> Result<(), RowEditError> {
        let highest = self.keep.iter().chain(&self.append_from).max().copied();
        for p in params.iter() {
            let rows = p.row_count().ok_or_else(|| RowEditError::NotRows(p.name.clone()))?;
            if let Some(row) = highest.filter(|&row| row as usize >= rows) {
                return Err(RowEditError::OutOfRange { name: p.name.clone(), row, rows });
            }
        }
        for p in params.iter_mut() {
            let width = p.row_width.unwrap_or(1);
            p.value = self.gather(&p.value, width, true);
            for column in [&mut p.grad, &mut p.moment1, &mut p.moment2] {
                *column = self.gather(column, width, false);
            }
        }
        Ok(())
    }

    /// The edited form of a per-row column outside a [`Param`], such as densification statistics; appended rows are zero.
    pub fn apply_to_column(&self, column: &[f32], width: usize) -> Vec<f32> {
        self.gather(column, width, false)
    }

    fn gather(&self, old: &[f32], width: usize, copy_appended: bool) -> Vec<f32> {
        let mut new = Vec::with_capacity(self.new_rows() * width);
        for &r in &self.keep {
            new.extend_from_slice(&old[r as usize * width..][..width]);
        }
        if copy_appended {
            for &r in &self.append_from {
                new.extend_from_slice(&old[r as usize * width..][..width]);
            }
        } else {
            new.resize(self.new_rows() * width, 0.0);
        }
        new
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block() -> Param {
        let mut p = Param::rows("p", 2, vec![0.0, 0.1, 1.0, 1.1, 2.0, 2.1]);
        p.moment1 = vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        p.moment2 = p.moment1.clone();
        p
    }

    #[test]
    fn values_moments_and_gradients_move_together() {
        let (mut a, mut b) = (block(), Param::rows("q", 1, vec![7.0, 8.0, 9.0]));
        RowEdit { keep: vec![2, 0], append_from: vec![2, 2] }.apply(&mut [&mut a, &mut b]).unwrap();
        assert_eq!(a.value, [2.0, 2.1, 0.0, 0.1, 2.0, 2.1, 2.0, 2.1]);
        assert_eq!(a.moment1, [5.0, 6.0, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!((a.grad.len(), a.moment2.len()), (8, 8));
        assert_eq!(b.value, [9.0, 7.0, 9.0, 9.0]);
    }

    #[test]
    fn a_bad_edit_changes_nothing() {
        let (mut a, mut short) = (block(), Param::rows("short", 1, vec![1.0]));
        let before = a.clone();
        let edit = RowEdit { keep: vec![0, 2], append_from: vec![] };
        let e = edit.apply(&mut [&mut a, &mut short]).unwrap_err();
        assert_eq!(e, RowEditError::OutOfRange { name: "short".into(), row: 2, rows: 1 });
        assert_eq!(a, before);
        let mut shared = Param::shared("w", vec![0.0; 4]);
        assert!(matches!(edit.apply(&mut [&mut a, &mut shared]), Err(RowEditError::NotRows(_))));
        assert_eq!(a, before);
    }

    #[test]
    fn retain_lists_survivors() {
        assert_eq!(RowEdit::retain(4, |r| r % 2 == 1).keep, [1, 3]);
    }
}
