//! Regularisers of a HexPlane: planes are smooth, and time changes little.
//!
//! With `S(P)` the mean of the squared second difference along the slow axis and the published weights `w`
//! (4DGaussians, Eq. 8 and its code; the "total variation" of the spatial planes is this one-axis difference there
//! too):
//!
//! ```text
//! S(P) = mean (P[y+2] − 2 P[y+1] + P[y])²         0 with fewer than three rows
//! w_tv Σ_{xy,xz,yz} S  +  w_smooth Σ_{xt,yt,zt} S  +  w_l1 Σ_{xt,yt,zt} mean |1 − P|
//! ```

use super::sample::Texel;
use fearless_simd::{Simd, SimdBase, SimdFloat, f32x16};

/// Value of `Σ (second difference)² / count` over the rows of one plane; adds `weight` times its gradient.
/// `width` texels per row. A weight of zero costs nothing and counts as the value zero.
#[inline(always)]
pub(crate) fn second_difference<S: Simd>(
    simd: S,
    value: &[Texel],
    grad: &mut [Texel],
    width: usize,
    count: usize,
    weight: f32,
) -> f64 {
    let rows = value.len() / width.max(1);
    if rows < 3 || count == 0 || weight == 0.0 {
        return 0.0;
    }
    let scale = f32x16::splat(simd, 2.0 * weight / count as f32);
    let minus_two = f32x16::splat(simd, -2.0);
    let mut total = 0.0f64;
    for y in 0..rows - 2 {
        let (first, rest) = value[y * width..(y + 3) * width].split_at(width);
        let (second, third) = rest.split_at(width);
        let (d_first, d_rest) = grad[y * width..(y + 3) * width].split_at_mut(width);
        let (d_second, d_third) = d_rest.split_at_mut(width);
        let mut sum = f32x16::splat(simd, 0.0);
        for x in 0..width {
            let outer = f32x16::load_array_ref(simd, &first[x]) + f32x16::load_array_ref(simd, &third[x]);
            let e = minus_two.mul_add(f32x16::load_array_ref(simd, &second[x]), outer);
            sum = e.mul_add(e, sum);
            let g = scale * e;
            (f32x16::load_array_ref(simd, &d_first[x]) + g).store_array(&mut d_first[x]);
            minus_two.mul_add(g, f32x16::load_array_ref(simd, &d_second[x])).store_array(&mut d_second[x]);
            (f32x16::load_array_ref(simd, &d_third[x]) + g).store_array(&mut d_third[x]);
        }
        total += f64::from(simd.reduce_sum_f32x16(sum));
    }
    total / count as f64
}

/// Value of `Σ |1 − P| / count`; adds `weight` times its gradient (0 at 1). `width` texels are summed at a time.
#[inline(always)]
pub(crate) fn distance_to_one<S: Simd>(
    simd: S,
    value: &[Texel],
    grad: &mut [Texel],
    width: usize,
    count: usize,
    weight: f32,
) -> f64 {
    if weight == 0.0 {
        return 0.0;
    }
    let (zero, one) = (f32x16::splat(simd, 0.0), f32x16::splat(simd, 1.0));
    let scale = f32x16::splat(simd, weight / count.max(1) as f32);
    let mut total = 0.0f64;
    for (value, grad) in value.chunks(width.max(1)).zip(grad.chunks_mut(width.max(1))) {
        let mut sum = zero;
        for (v, g) in value.iter().zip(grad) {
            let e = f32x16::load_array_ref(simd, v) - one;
            sum += e.abs();
            let slope = simd.select_f32x16(e.simd_eq(zero), zero, scale.copysign(e));
            (f32x16::load_array_ref(simd, g) + slope).store_array(g);
        }
        total += f64::from(simd.reduce_sum_f32x16(sum));
    }
    total / count.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::{Level, dispatch};

    #[test]
    fn ramps_cost_nothing_and_second_differences_their_square() {
        let run = |value: &[Texel], width, count, weight| {
            let mut grad = vec![[0.0; 16]; value.len()];
            let level = Level::new();
            let total = dispatch!(level, simd => second_difference(simd, value, &mut grad, width, count, weight));
            (total, grad.iter().map(|g| g[5]).collect::<Vec<f32>>())
        };
        let ramp: Vec<Texel> = (0..12).map(|i| [(i / 3) as f32; 16]).collect();
        assert_eq!(run(&ramp, 3, 6, 1.0), (0.0, vec![0.0; 12]));
        // One column 0, 1, 0 per channel: e = −2, S = 4, dS/dP = 2 e (1, −2, 1) / count.
        assert_eq!(run(&[[0.0; 16], [1.0; 16], [0.0; 16]], 1, 16, 8.0), (4.0, vec![-2.0, 4.0, -2.0]));
        assert_eq!(run(&[[0.0; 16], [1.0; 16]], 1, 16, 8.0).0, 0.0, "two rows have no second difference");
    }

    #[test]
    fn distance_to_one_has_its_kink_there() {
        let (value, mut grad) = ([[1.0; 16], [2.0; 16], [0.5; 16], [1.0; 16]], [[0.0; 16]; 4]);
        let level = Level::new();
        let total = dispatch!(level, simd => distance_to_one(simd, &value, &mut grad, 3, 64, 32.0));
        assert_eq!((total, grad.map(|g| g[7])), (0.375, [0.0, 0.5, -0.5, 0.0]));
    }
}
