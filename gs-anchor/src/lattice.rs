//! The lattice of anchor positions, with integer cells, so that equality of positions is exact.
//!
//! ```text
//! cell(p) = round_half_even(p / size) per axis,   position(cell) = cell · size
//! ```
//! Quotient and product are formed in `f64`; a position rounded to `f32` gives its cell back as long as no coordinate
//! is beyond [`MAX_CELL`] cells from the origin.

use glam::Vec3;
use gs_core::cast;

/// A lattice point: integers along x, y, z. Ordered by x, then y, then z.
pub(crate) type Cell = [i32; 3];

/// Largest coordinate of a cell: beyond it `f32` positions do not separate neighbouring cells.
pub(crate) const MAX_CELL: i32 = 1 << 22;

/// The cell of a point for cells of side `size` (both world units); `None` if a coordinate is not finite or beyond
/// [`MAX_CELL`].
pub(crate) fn cell_of(point: Vec3, size: f32) -> Option<Cell> {
    let mut cell = [0; 3];
    for (c, p) in cell.iter_mut().zip(point.to_array()) {
        let rounded = (f64::from(p) / f64::from(size)).round_ties_even();
        if rounded.is_nan() || rounded.abs() > f64::from(MAX_CELL) {
            return None;
        }
        #[expect(clippy::cast_possible_truncation, reason = "a whole number up to `MAX_CELL`")]
        let whole = rounded as i32;
        *c = whole;
    }
    Some(cell)
}

/// The position of a cell for cells of side `size`, world units.
pub(crate) fn position_of(cell: Cell, size: f64) -> Vec3 {
    Vec3::from_array(cell.map(|c| cast::to_f32(f64::from(c) * size)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    #[test]
    fn halves_go_to_the_even_cell() {
        let cells: Vec<Cell> =
            [0.5, 1.5, 2.5, -0.5, -1.5].map(|x| cell_of(Vec3::splat(x), 1.0).unwrap()).into_iter().collect();
        assert_eq!(cells, [[0; 3], [2; 3], [2; 3], [0; 3], [-2; 3]]);
    }

    #[test]
    fn a_position_gives_its_cell_back() {
        for size in [0.01f32, 0.16, 1.0 / 3.0, 7.3e-5, 123.4] {
            let mut rng = Rng::new(1, "lattice", 0, u64::from(size.to_bits()));
            for _ in 0..5000 {
                let cell: Cell = std::array::from_fn(|_| rng.below(2 * MAX_CELL as u32 + 1) as i32 - MAX_CELL);
                assert_eq!(cell_of(position_of(cell, size.into()), size), Some(cell), "{size}");
            }
        }
    }

    #[test]
    fn points_without_a_cell_are_none() {
        for x in [f32::NAN, f32::INFINITY, 1e9, -1e9] {
            assert_eq!(cell_of(Vec3::new(0.0, x, 0.0), 0.01), None, "{x}");
        }
        assert_eq!(cell_of(Vec3::X, 0.0), None);
    }
}
