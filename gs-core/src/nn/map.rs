//! Feature maps, `[height, width, channels]` with a border of zeros, and their active sites.
//!
//! The border is stored, so a convolution reads its zero padding like any other value and edges need no code of their
//! own. [`Sites`] lists active pixels row by row, as in sparse convolutions: a map that is used only in part (a texture
//! atlas with empty space between its charts) is computed at its sites alone, by the same code and in the same order.
//!
//! ```
//! use gs_core::nn::{Map, Sites};
//!
//! let mut map = Map::zeros(2, 2, 1, 1);
//! map.load(&[1.0, 2.0, 3.0, 4.0]);
//! let diagonal = Sites::from_fn(2, 2, |y, x| y == x);
//! map.clear_outside(&diagonal);
//! let mut values = [0.0; 4];
//! map.store(&mut values);
//! assert_eq!(values, [1.0, 0.0, 0.0, 4.0]);
//! ```

use rayon::prelude::*;

/// A map of `f32`, channels last, with `border` pixels of zeros on every side. Only the inside can be written.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Map {
    height: usize,
    width: usize,
    channels: usize,
    border: usize,
    data: Vec<f32>,
}

impl Map {
    /// A map whose values are all 0; `border` in pixels.
    pub fn zeros(height: usize, width: usize, channels: usize, border: usize) -> Self {
        let data = vec![0.0; (height + 2 * border) * (width + 2 * border) * channels];
        Self { height, width, channels, border, data }
    }

    /// A map of zeros of the shape and border of `other`.
    pub fn like(other: &Self) -> Self {
        Self::zeros(other.height, other.width, other.channels, other.border)
    }

    /// Number of pixel rows, without the border.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Number of pixels per row, without the border.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of values per pixel.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Width of the border of zeros, pixels.
    pub fn border(&self) -> usize {
        self.border
    }

    /// Memory of the values, bytes, border included.
    pub fn bytes(&self) -> usize {
        self.data.len() * size_of::<f32>()
    }

    /// All values row by row, border included.
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// Distance in [`Map::data`] between a value and the one below it.
    pub(super) fn row_stride(&self) -> usize {
        (self.width + 2 * self.border) * self.channels
    }

    /// Index in [`Map::data`] of the first value of pixel `(y, x)`.
    pub(super) fn offset(&self, y: usize, x: usize) -> usize {
        (y + self.border) * self.row_stride() + (x + self.border) * self.channels
    }

    /// The `channels` values of pixel `(y, x)`: row `y`, column `x`.
    pub fn pixel(&self, y: usize, x: usize) -> &[f32] {
        &self.data[self.offset(y, x)..][..self.channels]
    }

    /// As [`Map::pixel`], for writing the values.
    pub fn pixel_mut(&mut self, y: usize, x: usize) -> &mut [f32] {
        let at = self.offset(y, x);
        &mut self.data[at..at + self.channels]
    }

    /// The values of row `y`, without the border.
    pub fn row(&self, y: usize) -> &[f32] {
        &self.data[self.offset(y, 0)..][..self.width * self.channels]
    }

    /// Pieces of at most `rows` whole rows, without the border above and below, to write in parallel. Value `(y, x, c)`
    /// of a piece that begins at row `y0` has the index `offset(y, x) + c - offset(y0, 0) + border · channels`.
    pub(super) fn par_rows_mut(&mut self, rows: usize) -> impl IndexedParallelIterator<Item = &mut [f32]> {
        let stride = self.row_stride();
        let inside = self.border * stride..(self.border + self.height) * stride;
        self.data[inside].par_chunks_mut((rows * stride).max(1))
    }

    /// Overwrites the map with `values`, row-major, without a border.
    ///
    /// # Panics
    /// If there are not `height · width · channels` of them.
    pub fn load(&mut self, values: &[f32]) {
        assert_eq!(values.len(), self.height * self.width * self.channels, "values of a whole map");
        let (line, at) = (self.width * self.channels, self.border * self.channels);
        self.par_rows_mut(1).zip(values.par_chunks(line.max(1))).for_each(|(row, v)| {
            row[at..at + line].copy_from_slice(v);
        });
    }

    /// Copies the map to `values`, row-major, without its border.
    ///
    /// # Panics
    /// If there are not `height · width · channels` of them.
    pub fn store(&self, values: &mut [f32]) {
        assert_eq!(values.len(), self.height * self.width * self.channels, "values of a whole map");
        let line = (self.width * self.channels).max(1);
        values.par_chunks_mut(line).enumerate().for_each(|(y, v)| v.copy_from_slice(self.row(y)));
    }

    /// Sets every pixel that is not a site to zero.
    pub fn clear_outside(&mut self, sites: &Sites) {
        let (channels, border) = (self.channels, self.border);
        self.par_rows_mut(1).enumerate().for_each(|(y, row)| {
            let mut next = border * channels;
            for &x in sites.row(y) {
                let at = (x as usize + border) * channels;
                row[next..at].fill(0.0);
                next = at + channels;
            }
            row[next..].fill(0.0);
        });
    }
}

/// A set of pixels of a map, row by row, from left to right.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sites {
    height: usize,
    width: usize,
    /// Start of each row in `xs`, and the end of the last row.
    start: Vec<usize>,
    xs: Vec<u32>,
}

impl Sites {
    /// All pixels of the map.
    pub fn full(height: usize, width: usize) -> Self {
        Self::from_fn(height, width, |_, _| true)
    }

    /// The pixels `(y, x)` for which `inside` is true.
    pub fn from_fn(height: usize, width: usize, inside: impl Fn(usize, usize) -> bool) -> Self {
        let (mut start, mut xs) = (vec![0], Vec::new());
        for y in 0..height {
            xs.extend((0..width).filter(|&x| inside(y, x)).map(|x| x as u32));
            start.push(xs.len());
        }
        Self { height, width, start, xs }
    }

    /// The pixels of the map of half the size that have a site among their 2 × 2.
    pub fn halved(&self) -> Self {
        let (height, width) = (self.height / 2, self.width / 2);
        let mut any = vec![false; height * width];
        for y in 0..2 * height {
            for &x in self.row(y).iter().filter(|&&x| (x as usize) < 2 * width) {
                any[y / 2 * width + x as usize / 2] = true;
            }
        }
        Self::from_fn(height, width, |y, x| any[y * width + x])
    }

    /// Column indices of the sites in row `y`, ascending.
    pub fn row(&self, y: usize) -> &[u32] {
        &self.xs[self.start[y]..self.start[y + 1]]
    }

    /// Number of sites in all rows.
    pub fn len(&self) -> usize {
        self.xs.len()
    }

    /// Whether there are no sites.
    pub fn is_empty(&self) -> bool {
        self.xs.is_empty()
    }

    /// Number of pixel rows of the map.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Number of pixels per row of the map.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows with about `pixels` pixels of a full map, at least 1.
    pub(super) fn rows_for(&self, pixels: usize) -> usize {
        (pixels / self.width.max(1)).clamp(1, self.height.max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_border_stays_zero_and_values_round_trip() {
        let values: Vec<f32> = (0..2 * 3 * 2).map(|v| v as f32 + 1.0).collect();
        let mut map = Map::zeros(2, 3, 2, 1);
        map.load(&values);
        assert_eq!((map.pixel(1, 2), map.row(0)), (&values[10..], &values[..6]));
        assert_eq!(map.data().iter().filter(|v| **v != 0.0).count(), values.len());
        let mut back = vec![0.0; values.len()];
        map.store(&mut back);
        assert_eq!(back, values);
    }

    #[test]
    fn sites_halve_by_any_and_clear_the_rest() {
        let sites = Sites::from_fn(4, 6, |y, x| (y, x) == (1, 2) || (y, x) == (3, 5));
        assert_eq!((sites.len(), sites.row(1), sites.row(0)), (2, &[2][..], &[][..]));
        let half = sites.halved();
        assert_eq!((half.height(), half.width(), half.row(0), half.row(1)), (2, 3, &[1][..], &[2][..]));
        let mut map = Map::zeros(4, 6, 1, 1);
        map.load(&[3.0; 24]);
        map.clear_outside(&sites);
        assert_eq!(map.data().iter().sum::<f32>(), 6.0);
        assert_eq!((map.pixel(1, 2), map.pixel(3, 5)), (&[3.0][..], &[3.0][..]));
        map.clear_outside(&Sites::full(4, 6));
        assert_eq!(map.data().iter().sum::<f32>(), 6.0);
    }
}
