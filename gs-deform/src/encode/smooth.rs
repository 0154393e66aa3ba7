//! What is known of a HexPlane before any image is seen: planes are smooth, and time changes little.
//!
//! With `S(P)` the mean of the squared second difference along the slow axis and the published weights `w`
//! (4DGaussians, Eq. 8 and its code; the "total variation" of the spatial planes is this one-axis difference there too):
//!
//! ```text
//! S(P) = mean (P[y+2] − 2 P[y+1] + P[y])²         0 with fewer than three rows
//! w_tv Σ_{xy,xz,yz} S  +  w_smooth Σ_{xt,yt,zt} S  +  w_l1 Σ_{xt,yt,zt} mean |1 − P|
//! ```

/// Value of `Σ (second difference)² / count` over the rows of one plane; adds `weight` times its gradient.
/// `row` values per row.
pub(crate) fn second_difference(value: &[f32], grad: &mut [f32], row: usize, count: usize, weight: f32) -> f64 {
    let rows = value.len() / row.max(1);
    if rows < 3 || count == 0 {
        return 0.0;
    }
    let scale = 2.0 * weight / count as f32;
    let mut total = 0.0f64;
    for y in 0..rows - 2 {
        let [a, b, c] = [0, 1, 2].map(|k| &value[(y + k) * row..][..row]);
        let (first, rest) = grad[y * row..(y + 3) * row].split_at_mut(row);
        let (second, third) = rest.split_at_mut(row);
        let mut sums = [0.0f32; 16];
        for i in 0..row {
            let e = c[i] - 2.0 * b[i] + a[i];
            sums[i % 16] += e * e;
            let g = scale * e;
            first[i] += g;
            second[i] -= 2.0 * g;
            third[i] += g;
        }
        total += sums.iter().map(|&s| f64::from(s)).sum::<f64>();
    }
    total / count as f64
}

/// Value of `Σ |1 − P| / count`; adds `weight` times its gradient (0 at 1).
pub(crate) fn distance_to_one(value: &[f32], grad: &mut [f32], count: usize, weight: f32) -> f64 {
    let scale = weight / count.max(1) as f32;
    let mut total = 0.0f64;
    for (value, grad) in value.chunks(1024).zip(grad.chunks_mut(1024)) {
        let mut sums = [0.0f32; 16];
        for (i, (v, g)) in value.iter().zip(grad).enumerate() {
            let e = v - 1.0;
            sums[i % 16] += e.abs();
            *g += if e > 0.0 {
                scale
            } else if e < 0.0 {
                -scale
            } else {
                0.0
            };
        }
        total += sums.iter().map(|&s| f64::from(s)).sum::<f64>();
    }
    total / count.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn straight_ramps_cost_nothing_and_bends_cost_their_square() {
        let ramp: Vec<f32> = (0..12).map(|i| (i / 3) as f32).collect();
        let mut grad = vec![0.0; 12];
        assert_eq!(second_difference(&ramp, &mut grad, 3, 6, 1.0), 0.0);
        assert_eq!(grad, [0.0; 12]);
        // One column 0, 1, 0: e = −2, S = 4, dS/dP = 2 e (1, −2, 1).
        let mut grad = vec![0.0; 3];
        assert_eq!(second_difference(&[0.0, 1.0, 0.0], &mut grad, 1, 1, 0.5), 4.0);
        assert_eq!(grad, [-2.0, 4.0, -2.0]);
        assert_eq!(second_difference(&[0.0, 1.0], &mut grad, 1, 1, 0.5), 0.0, "two rows have no second difference");
    }

    #[test]
    fn distance_to_one_has_its_kink_there() {
        let mut grad = vec![0.0; 4];
        assert_eq!(distance_to_one(&[1.0, 2.0, 0.5, 1.0], &mut grad, 4, 2.0), 0.375);
        assert_eq!(grad, [0.0, 0.5, -0.5, 0.0]);
    }
}
