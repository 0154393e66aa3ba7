//! Reference implementations of the two networks, plain loops over any [`Real`].
//!
//! Parameters are the values of the network's blocks in the order of [`gs_core::Params::visit`]. `masks` holds the valid
//! texels of every level, finest first (all `true` for [`super::NormOver::All`]).

use gs_core::Real;
use gs_core::nn::map_reference::{RefMap, add, concat, conv, conv_transpose, group_norm, max_pool, relu, upsample};

/// Parameter blocks, taken one after the other.
struct Blocks<'a, T>(std::slice::Iter<'a, Vec<T>>);

impl<'a, T: Real> Blocks<'a, T> {
    /// # Panics
    /// If the network has more blocks than were given.
    fn next(&mut self) -> &'a [T] {
        self.0.next().expect("one block of values per parameter of the network")
    }

    fn unit(
        &mut self,
        x: &RefMap<T>,
        [kernel, stride]: [usize; 2],
        bias: bool,
        groups: usize,
        mask: &[bool],
    ) -> RefMap<T> {
        let weight = self.next();
        let bias = if bias { self.next() } else { &[] };
        let z = conv(x, weight, bias, kernel, stride);
        let (scale, shift) = (self.next(), self.next());
        group_norm(&z, scale, shift, if groups == 0 { z.channels / 8 } else { groups }, mask)
    }

    fn residual(&mut self, x: &RefMap<T>, stride: usize, around: bool, mask: &[bool]) -> RefMap<T> {
        let y = relu(self.unit(x, [3, stride], true, 0, mask));
        let y = relu(self.unit(&y, [3, 1], true, 0, mask));
        let skip = if around { self.unit(x, [1, stride], true, 0, mask) } else { x.clone() };
        relu(add(&y, &skip))
    }

    fn stage(&mut self, x: &RefMap<T>, stride: usize, around: bool, mask: &[bool]) -> RefMap<T> {
        let y = self.residual(x, stride, around, mask);
        self.residual(&y, 1, false, mask)
    }

    fn double(&mut self, x: &RefMap<T>, mask: &[bool]) -> RefMap<T> {
        let y = relu(self.unit(x, [3, 1], false, 8, mask));
        relu(self.unit(&y, [3, 1], false, 8, mask))
    }
}

/// Offsets `[S, S, 3]` of a [`GeoNet`](crate::geonet::GeoNet) from `input: [S, S, C]`.
///
/// # Panics
/// If blocks or masks are missing.
pub fn geonet<T: Real>(params: &[Vec<T>], input: &RefMap<T>, masks: &[Vec<bool>]) -> RefMap<T> {
    let mut p = Blocks(params.iter());
    let input = input.clone().masked(&masks[0]);
    let stem = relu(p.unit(&input, [5, 2], true, 8, &masks[1]));
    let f1 = p.stage(&stem, 1, false, &masks[1]);
    let f2 = p.stage(&f1, 2, true, &masks[2]);
    let f3 = p.stage(&f2, 2, true, &masks[3]);
    let d3 = p.stage(&f3, 1, false, &masks[3]);
    let up = |x: &RefMap<T>, level: usize| upsample(x).masked(&masks[level]);
    let d2 = p.stage(&concat(&up(&d3, 2), &f2), 1, true, &masks[2]);
    let d1 = p.stage(&concat(&up(&d2, 1), &f1), 1, true, &masks[1]);
    let mut y = concat(&up(&d1, 0), &input);
    for kernel in [3, 3, 1] {
        y = conv(&y, p.next(), p.next(), kernel, 1).masked(&masks[0]);
        y = if kernel == 3 { relu(y) } else { y };
    }
    y
}

/// Output of a [`GauNet`](crate::gaunet::GauNet) with `masks.len() − 1` levels.
///
/// # Panics
/// If blocks or masks are missing.
pub fn gaunet<T: Real>(params: &[Vec<T>], input: &RefMap<T>, masks: &[Vec<bool>]) -> RefMap<T> {
    let mut p = Blocks(params.iter());
    let input = input.clone().masked(&masks[0]);
    let mut down = vec![p.double(&input, &masks[0])];
    for mask in &masks[1..] {
        let pooled = max_pool(&down[down.len() - 1]).masked(mask);
        down.push(p.double(&pooled, mask));
    }
    // Blocks of the decoder are stored finest first and used coarsest first.
    let per_level = 2 + 2 * 3;
    let rest: Vec<Vec<T>> = p.0.cloned().collect();
    let mut y = down[down.len() - 1].clone();
    for level in (0..masks.len() - 1).rev() {
        let mut p = Blocks(rest[level * per_level..][..per_level].iter());
        let grown = conv_transpose(&y, p.next(), p.next()).masked(&masks[level]);
        y = p.double(&concat(&down[level], &grown), &masks[level]);
    }
    let mut p = Blocks(rest[(masks.len() - 1) * per_level..].iter());
    conv(&y, p.next(), p.next(), 1, 1).masked(&masks[0])
}

/// The valid texels of every level, finest first: `halvings + 1` masks of `size² / 4^level` values. A texel of a coarser level
/// is valid if any of its 2 × 2 texels is.
///
/// ```
/// use gs_texel::net::reference::masks;
///
/// let finest = [true, false, false, false, false, false, false, false];
/// assert_eq!(masks(&[finest, [false; 8]].concat(), 4, 2)[1..], [vec![true, false, false, false], vec![true]]);
/// ```
pub fn masks(finest: &[bool], size: usize, halvings: u32) -> Vec<Vec<bool>> {
    let mut all = vec![finest.to_vec()];
    for level in 1..=halvings {
        let (fine, half) = (&all[all.len() - 1], size >> level);
        let any = |at: usize| {
            let corner = at / half * 2 * (2 * half) + at % half * 2;
            [0, 1, 2 * half, 2 * half + 1].iter().any(|step| fine[corner + step])
        };
        let coarse = (0..half * half).map(any).collect();
        all.push(coarse);
    }
    all
}
