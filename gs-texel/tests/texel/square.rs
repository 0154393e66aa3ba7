//! The unit square as a map of texels.

use glam::{Affine3A, Vec2, Vec3};
use gs_texel::gaussians::{Channels, TexelBase};
use gs_texel::texels::{TexelOptions, TexelTable};

/// Channels at degree 1.
pub const WIDTH: usize = 23;

pub fn channels() -> Channels {
    Channels::new(1).unwrap()
}

/// The unit square as two triangles: every texel of a `size × size` map is valid.
pub fn square(size: usize) -> (Vec<Vec3>, Vec<[u32; 3]>, TexelTable) {
    let corners = [Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE];
    let faces = vec![[0, 1, 2], [1, 3, 2]];
    let table = TexelTable::build(&faces, &corners, &faces, size, &TexelOptions::default()).unwrap();
    (corners.map(|p| p.extend(0.0)).to_vec(), faces, table)
}

/// The square at rest, as base maps.
pub fn at_rest(size: usize) -> (TexelTable, TexelBase) {
    let (points, faces, table) = square(size);
    let (still, rotations) = (vec![Affine3A::IDENTITY; 4], vec![[1.0, 0.0, 0.0, 0.0]; 4]);
    let base = TexelBase::new(&table, &faces, &points, &still, &rotations, &[1.0; 4]).unwrap();
    (table, base)
}
