//! Means, quaternions and scales: the columns of splats that deformation fields read and write. The same shapes hold their
//! cotangents.
//!
//! ```
//! use glam::Vec3;
//! use gs_core::{Geometry, Splats};
//!
//! let rest = Splats { means: vec![Vec3::ZERO], quats: vec![[1.0, 0.0, 0.0, 0.0]], scales: vec![Vec3::ONE], ..Splats::default() };
//! let mut moved = Geometry::zeros(rest.len());
//! moved.view_mut().copy_from(rest.geometry());
//! moved.means[0] = Vec3::X;
//! assert_eq!(rest.with_geometry(moved.view()).means[0], Vec3::X, "all other columns are borrowed from `rest`");
//! ```

use glam::Vec3;
use rayon::prelude::*;
use std::ops::Range;

/// Owned means, quaternions and scales, one row per splat.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Geometry {
    /// `[n]`: centres of the Gaussians, world units.
    pub means: Vec<Vec3>,
    /// `[n]`: rotations `(w, x, y, z)` of any length.
    pub quats: Vec<[f32; 4]>,
    /// `[n]`: standard deviations along the three axes, linear, world units.
    pub scales: Vec<Vec3>,
}

/// Borrowed [`Geometry`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeometryRef<'a> {
    /// `[n]`, as [`Geometry::means`].
    pub means: &'a [Vec3],
    /// `[n]`, as [`Geometry::quats`].
    pub quats: &'a [[f32; 4]],
    /// `[n]`, as [`Geometry::scales`].
    pub scales: &'a [Vec3],
}

/// Borrowed [`Geometry`], to write to.
#[derive(Debug)]
pub struct GeometryMut<'a> {
    /// `[n]`, as [`Geometry::means`].
    pub means: &'a mut [Vec3],
    /// `[n]`, as [`Geometry::quats`].
    pub quats: &'a mut [[f32; 4]],
    /// `[n]`, as [`Geometry::scales`].
    pub scales: &'a mut [Vec3],
}

impl Geometry {
    /// `n` rows of zeros.
    pub fn zeros(n: usize) -> Self {
        Self { means: vec![Vec3::ZERO; n], quats: vec![[0.0; 4]; n], scales: vec![Vec3::ZERO; n] }
    }

    /// Sets this to `n` rows of zeros, reusing memory.
    pub fn reset(&mut self, n: usize) {
        let Self { means, quats, scales } = self;
        means.clear();
        quats.clear();
        scales.clear();
        self.resize(n);
    }

    /// Changes the number of rows to `n`, reusing memory; new rows are zero, the others keep their values.
    pub fn resize(&mut self, n: usize) {
        self.means.resize(n, Vec3::ZERO);
        self.quats.resize(n, [0.0; 4]);
        self.scales.resize(n, Vec3::ZERO);
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Borrows all columns.
    pub fn view(&self) -> GeometryRef<'_> {
        GeometryRef { means: &self.means, quats: &self.quats, scales: &self.scales }
    }

    /// Borrows all columns, to write to.
    pub fn view_mut(&mut self) -> GeometryMut<'_> {
        GeometryMut { means: &mut self.means, quats: &mut self.quats, scales: &mut self.scales }
    }

    /// Writes the rows of `from` to the rows `rows` of this, in order.
    pub fn scatter(&mut self, from: &Geometry, rows: &[u32]) {
        for (i, row) in rows.iter().map(|r| *r as usize).enumerate() {
            self.means[row] = from.means[i];
            self.quats[row] = from.quats[i];
            self.scales[row] = from.scales[i];
        }
    }
}

impl<'a> GeometryRef<'a> {
    /// Number of rows.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// A copy of the given rows.
    pub fn pick(&self, rows: &[u32]) -> Geometry {
        let row = |r: &u32| *r as usize;
        Geometry {
            means: rows.iter().map(|r| self.means[row(r)]).collect(),
            quats: rows.iter().map(|r| self.quats[row(r)]).collect(),
            scales: rows.iter().map(|r| self.scales[row(r)]).collect(),
        }
    }

    /// A range of rows.
    pub fn rows(&self, rows: Range<usize>) -> GeometryRef<'a> {
        GeometryRef { means: &self.means[rows.clone()], quats: &self.quats[rows.clone()], scales: &self.scales[rows] }
    }

    /// Block `index` of `size` rows; the last may be shorter.
    pub fn block(&self, index: usize, size: usize) -> GeometryRef<'a> {
        self.rows(index * size..((index + 1) * size).min(self.len()))
    }

    /// All rows in chunks of `rows`; the last may be shorter.
    pub fn chunks(self, rows: usize) -> impl IndexedParallelIterator<Item = GeometryRef<'a>> {
        let (means, quats) = (self.means.par_chunks(rows), self.quats.par_chunks(rows));
        let columns = means.zip(quats).zip(self.scales.par_chunks(rows));
        columns.map(|((means, quats), scales)| GeometryRef { means, quats, scales })
    }
}

impl<'a> GeometryMut<'a> {
    /// Copies all rows of `from`, which has as many.
    pub fn copy_from(&mut self, from: GeometryRef<'_>) {
        self.means.copy_from_slice(from.means);
        self.quats.copy_from_slice(from.quats);
        self.scales.copy_from_slice(from.scales);
    }

    /// A range of rows.
    pub fn rows(&mut self, rows: Range<usize>) -> GeometryMut<'_> {
        GeometryMut {
            means: &mut self.means[rows.clone()],
            quats: &mut self.quats[rows.clone()],
            scales: &mut self.scales[rows],
        }
    }

    /// Block `index` of `size` rows; the last may be shorter.
    pub fn block(&mut self, index: usize, size: usize) -> GeometryMut<'_> {
        self.rows(index * size..((index + 1) * size).min(self.means.len()))
    }

    /// All rows in chunks of `rows`; the last may be shorter.
    pub fn chunks(self, rows: usize) -> impl IndexedParallelIterator<Item = GeometryMut<'a>> {
        let (means, quats) = (self.means.par_chunks_mut(rows), self.quats.par_chunks_mut(rows));
        let columns = means.zip(quats).zip(self.scales.par_chunks_mut(rows));
        columns.map(|((means, quats), scales)| GeometryMut { means, quats, scales })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbered(n: usize) -> Geometry {
        let row = |i: usize| Vec3::splat(i as f32);
        Geometry {
            means: (0..n).map(row).collect(),
            quats: (0..n).map(|i| [i as f32; 4]).collect(),
            scales: (0..n).map(row).collect(),
        }
    }

    #[test]
    fn picked_rows_go_back_to_where_they_were() {
        let all = numbered(5);
        let picked = all.view().pick(&[4, 1]);
        assert_eq!((picked.means[0].x, picked.quats[1][3], picked.len()), (4.0, 1.0, 2));
        let mut zeros = Geometry::zeros(5);
        zeros.scatter(&picked, &[4, 1]);
        assert_eq!((zeros.means[4], zeros.scales[1], zeros.means[0]), (all.means[4], all.scales[1], Vec3::ZERO));
        zeros.reset(2);
        assert_eq!(zeros, Geometry::zeros(2));
    }

    #[test]
    fn chunks_and_blocks_hold_every_row_once() {
        let all = numbered(19);
        assert_eq!((all.view().block(0, 16).len(), all.view().block(1, 16).len()), (16, 3));
        assert_eq!(all.view().block(1, 16).means[0].x, 16.0);
        let mut copy = Geometry::zeros(all.len());
        copy.view_mut().chunks(7).zip(all.view().chunks(7)).for_each(|(mut to, from)| to.copy_from(from));
        assert_eq!(copy, all);
    }
}
