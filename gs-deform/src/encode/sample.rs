//! The inner loops of the HexPlane: sixteen channels of one point at a time, forward and backward.
//!
//! With `A B C` the bilinear samples of the planes xy, xz, yz and `X Y Z` the linear samples of the lines that the
//! planes xt, yt, zt become at a fixed time, a feature is the product of the six. Its cotangent `g` reaches each factor
//! as `g` times the other five, built from the pairs `AB`, `CX`, `YZ`: no division, so texels may be zero.
//!
//! Everything here is a function marked `inline(always)`, never a closure: only then does the instruction set chosen at
//! run time reach it.

use fearless_simd::{Simd, SimdBase, SimdFloat, f32x16};
use glam::Vec3;

/// Sixteen channels of one grid node: one vector register.
pub(super) type Texel = [f32; LANES];

/// Channels per texel and values per vector register.
pub(crate) const LANES: usize = 16;

/// Where a coordinate falls between two nodes of an axis: `(1 − weight) · node[index] + weight · node[index + 1]`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Cell {
    pub index: u32,
    pub weight: f32,
    /// Nodes per world unit; 0 where the coordinate was clamped, since the sample is constant there.
    pub slope: f32,
}

impl Cell {
    /// The cell of `offset` world units from the first of `nodes` nodes that lie `1 / nodes_per_unit` apart; clamped to
    /// the ends (as `grid_sample` with border padding), where the gradient is zero, at the very end too. NaN counts as
    /// the first node.
    #[inline(always)]
    pub(super) fn new(offset: f32, nodes_per_unit: f32, nodes: usize) -> Self {
        let last = (nodes - 1) as f32;
        let position = offset * nodes_per_unit;
        let inside = position > 0.0 && position < last;
        let position = position.max(0.0).min(last);
        let index = (position as u32).min(nodes as u32 - 2);
        Self { index, weight: position - index as f32, slope: if inside { nodes_per_unit } else { 0.0 } }
    }
}

/// A plane sampled at a point: the value and its derivatives along the two axes, per node spacing.
struct Sample<S: Simd> {
    value: f32x16<S>,
    along_a: f32x16<S>,
    along_b: f32x16<S>,
}

#[inline(always)]
fn load<S: Simd>(simd: S, texel: &Texel) -> f32x16<S> {
    f32x16::load_array_ref(simd, texel)
}

/// `from + weight · (to − from)`.
#[inline(always)]
fn lerp<S: Simd>(simd: S, from: f32x16<S>, difference: f32x16<S>, weight: f32) -> f32x16<S> {
    f32x16::splat(simd, weight).mul_add(difference, from)
}

/// Bilinear sample of `plane: [_, width]` at cell `a` of the fast axis and `b` of the slow one.
#[inline(always)]
fn sample_plane<S: Simd>(simd: S, plane: &[Texel], width: usize, a: Cell, b: Cell) -> Sample<S> {
    let at = b.index as usize * width + a.index as usize;
    let (low, high) = (&plane[at..at + 2], &plane[at + width..at + width + 2]);
    let (p00, p01) = (load(simd, &low[0]), load(simd, &high[0]));
    let (d0, d1) = (load(simd, &low[1]) - p00, load(simd, &high[1]) - p01);
    let (row0, row1) = (lerp(simd, p00, d0, a.weight), lerp(simd, p01, d1, a.weight));
    let along_b = row1 - row0;
    Sample { value: lerp(simd, row0, along_b, b.weight), along_a: lerp(simd, d0, d1 - d0, b.weight), along_b }
}

/// Linear sample of a line and its derivative per node spacing.
#[inline(always)]
fn sample_line<S: Simd>(simd: S, line: &[Texel], a: Cell) -> (f32x16<S>, f32x16<S>) {
    let at = a.index as usize;
    let pair = &line[at..at + 2];
    let first = load(simd, &pair[0]);
    let along = load(simd, &pair[1]) - first;
    (lerp(simd, first, along, a.weight), along)
}

/// What one group of sixteen channels of one level is sampled from.
pub(crate) struct Group<'a> {
    /// Nodes along x, y, z.
    pub nodes: [usize; 3],
    /// Planes xy, xz, yz: `[nodes_b, nodes_a]`.
    pub planes: [&'a [Texel]; 3],
    /// Lines of xt, yt, zt at the frame's time.
    pub lines: [&'a [Texel]; 3],
}

impl<'a> Group<'a> {
    /// A group whose lines lie one after the other.
    pub(super) fn new(nodes: [usize; 3], planes: [&'a [Texel]; 3], lines: &'a [Texel]) -> Self {
        let (x, rest) = lines.split_at(nodes[0]);
        let (y, z) = rest.split_at(nodes[1]);
        Self { nodes, planes, lines: [x, y, z] }
    }

    /// Sample of spatial plane `P`.
    #[inline(always)]
    fn plane<S: Simd, const P: usize>(&self, simd: S, cell: &[Cell; 3]) -> Sample<S> {
        let (a, b) = AXES[P];
        sample_plane(simd, self.planes[P], self.nodes[a], cell[a], cell[b])
    }

    /// Value and derivative of the line along axis `A`.
    #[inline(always)]
    fn line<S: Simd, const A: usize>(&self, simd: S, cell: &[Cell; 3]) -> (f32x16<S>, f32x16<S>) {
        sample_line(simd, self.lines[A], cell[A])
    }
}

/// The axes of the three spatial planes, fast axis first.
const AXES: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// Features of one group for the points of a block: row `r` goes to `out[r · stride + at ..][..16]`.
#[inline(always)]
pub(crate) fn forward<S: Simd>(
    simd: S,
    group: &Group<'_>,
    cells: &[[Cell; 3]],
    out: &mut [f32],
    stride: usize,
    at: usize,
) {
    for (cell, row) in cells.iter().zip(out.chunks_exact_mut(stride)) {
        let (xy, xz, yz) =
            (group.plane::<_, 0>(simd, cell), group.plane::<_, 1>(simd, cell), group.plane::<_, 2>(simd, cell));
        let (x, y, z) =
            (group.line::<_, 0>(simd, cell).0, group.line::<_, 1>(simd, cell).0, group.line::<_, 2>(simd, cell).0);
        let product = (xy.value * xz.value) * (yz.value * x) * (y * z);
        product.store_slice(&mut row[at..at + LANES]);
    }
}

/// Gradients of one group, added to.
pub(crate) struct GroupGrad<'a> {
    /// Gradients of the planes xy, xz, yz.
    pub planes: [&'a mut [Texel]; 3],
    /// Gradients of the lines of xt, yt, zt.
    pub lines: [&'a mut [Texel]; 3],
}

/// `grad += weight · d`, one texel.
#[inline(always)]
fn scatter<S: Simd>(simd: S, grad: &mut Texel, weight: f32, d: f32x16<S>) {
    f32x16::splat(simd, weight).mul_add(d, load(simd, grad)).store_array(grad);
}

#[inline(always)]
fn scatter_plane<S: Simd>(simd: S, grad: &mut [Texel], width: usize, a: Cell, b: Cell, d: f32x16<S>) {
    let at = b.index as usize * width + a.index as usize;
    for (start, weight) in [(at, 1.0 - b.weight), (at + width, b.weight)] {
        let pair = &mut grad[start..start + 2];
        scatter(simd, &mut pair[0], (1.0 - a.weight) * weight, d);
        scatter(simd, &mut pair[1], a.weight * weight, d);
    }
}

#[inline(always)]
fn scatter_line<S: Simd>(simd: S, grad: &mut [Texel], a: Cell, d: f32x16<S>) {
    let pair = &mut grad[a.index as usize..a.index as usize + 2];
    scatter(simd, &mut pair[0], 1.0 - a.weight, d);
    scatter(simd, &mut pair[1], a.weight, d);
}

/// Backward of [`forward`] for the points of a block, in order: adds to the texels and, if given, to the points'
/// cotangents `d_means` (world units).
#[inline(always)]
pub(crate) fn backward<S: Simd>(
    simd: S,
    group: &Group<'_>,
    cells: &[[Cell; 3]],
    d_out: &[f32],
    (stride, at): (usize, usize),
    grad: &mut GroupGrad<'_>,
    mut d_means: Option<&mut [Vec3]>,
) {
    for (r, (cell, row)) in cells.iter().zip(d_out.chunks_exact(stride)).enumerate() {
        let (xy, xz, yz) =
            (group.plane::<_, 0>(simd, cell), group.plane::<_, 1>(simd, cell), group.plane::<_, 2>(simd, cell));
        let ((x, along_x), (y, along_y)) = (group.line::<_, 0>(simd, cell), group.line::<_, 1>(simd, cell));
        let (z, along_z) = group.line::<_, 2>(simd, cell);

        let g = f32x16::from_slice(simd, &row[at..at + LANES]);
        let (first, second, third) = (xy.value * xz.value, yz.value * x, y * z);
        let (g1, g2, g3) = (g * (second * third), g * (first * third), g * (first * second));
        let d_planes = [g1 * xz.value, g1 * xy.value, g2 * x];
        let d_lines = [g2 * yz.value, g3 * z, g3 * y];

        for (p, d) in d_planes.into_iter().enumerate() {
            let (a, b) = AXES[p];
            scatter_plane(simd, grad.planes[p], group.nodes[a], cell[a], cell[b], d);
        }
        for (axis, d) in d_lines.into_iter().enumerate() {
            scatter_line(simd, grad.lines[axis], cell[axis], d);
        }
        if let Some(d_means) = d_means.as_deref_mut() {
            let dx = d_lines[0].mul_add(along_x, d_planes[0].mul_add(xy.along_a, d_planes[1] * xz.along_a));
            let dy = d_lines[1].mul_add(along_y, d_planes[0].mul_add(xy.along_b, d_planes[2] * yz.along_a));
            let dz = d_lines[2].mul_add(along_z, d_planes[1].mul_add(xz.along_b, d_planes[2] * yz.along_b));
            let sums = (simd.reduce_sum_f32x16(dx), simd.reduce_sum_f32x16(dy), simd.reduce_sum_f32x16(dz));
            let per_node = Vec3::from(sums);
            d_means[r] += per_node * Vec3::from_array(cell.map(|c| c.slope));
        }
    }
}

/// Blends the two rows of a time plane `[rows, width]` around `time` into a line of `width` texels.
pub(crate) fn blend_rows(plane: &[Texel], width: usize, time: Cell, line: &mut [Texel]) {
    let start = time.index as usize * width;
    let (low, high) = (&plane[start..start + width], &plane[start + width..start + 2 * width]);
    for ((out, low), high) in line.as_flattened_mut().iter_mut().zip(low.as_flattened()).zip(high.as_flattened()) {
        *out = low + time.weight * (high - low);
    }
}

/// Backward of [`blend_rows`]: adds to the two rows.
pub(crate) fn blend_rows_backward(d_line: &[Texel], width: usize, time: Cell, d_plane: &mut [Texel]) {
    let start = time.index as usize * width;
    let (low, high) = d_plane[start..start + 2 * width].split_at_mut(width);
    for (rows, weight) in [(low, 1.0 - time.weight), (high, time.weight)] {
        rows.as_flattened_mut().iter_mut().zip(d_line.as_flattened()).for_each(|(g, d)| *g += weight * d);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_clamp_and_stay_inside() {
        let cell = |offset| Cell::new(offset, 2.0, 5);
        assert_eq!(cell(0.75), Cell { index: 1, weight: 0.5, slope: 2.0 });
        assert_eq!(cell(0.0), Cell { index: 0, weight: 0.0, slope: 0.0 }, "no gradient on the border itself");
        assert_eq!(cell(2.0), Cell { index: 3, weight: 1.0, slope: 0.0 });
        assert_eq!(cell(1e30), cell(2.0));
        assert_eq!(cell(f32::NEG_INFINITY), cell(0.0));
        assert_eq!(cell(f32::NAN), cell(0.0));
        assert_eq!(Cell::new(3.0, 0.0, 5), cell(0.0), "an axis without extent has one cell");
    }
}
