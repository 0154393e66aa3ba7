//! Positional encoding of low-dimensional inputs (Mildenhall et al. 2020, NeRF, Eq. 4; without the factor π, with the
//! raw input kept, as in Deformable 3D Gaussians):
//!
//! ```text
//! γ(p) = (p, sin 2⁰p, cos 2⁰p, …, sin 2^(B−1)p, cos 2^(B−1)p)      each entry is `dims` values wide
//! ```
//! Sines are computed by angle doubling in `f64` (`sin 2a = 2 sin a cos a`, `cos 2a = (cos a − sin a)(cos a + sin a)`):
//! one library call per input value, and the error at band `k`, about `2^k · 1e-16`, stays far below `f32`.
//!
//! ```
//! use gs_core::nn::encoding::{encode, width};
//!
//! let mut out = vec![0.0; width(1, 2)];
//! encode(&[0.5], 1, 2, &mut out);
//! assert_eq!(out, [0.5, 0.5f32.sin(), 0.5f32.cos(), 1.0f32.sin(), 1.0f32.cos()]);
//! ```

/// Number of values in an encoded row: `dims · (1 + 2 bands)`.
pub fn width(dims: usize, bands: usize) -> usize {
    dims.saturating_mul(bands.saturating_mul(2).saturating_add(1))
}

/// Encodes rows of `dims` values into rows of [`width`] values.
pub fn encode(p: &[f32], dims: usize, bands: usize, out: &mut [f32]) {
    for (p, out) in p.chunks_exact(dims).zip(out.chunks_exact_mut(width(dims, bands))) {
        out[..dims].copy_from_slice(p);
        for (d, &v) in p.iter().enumerate() {
            let (mut sin, mut cos) = f64::from(v).sin_cos();
            for pair in out[dims..].chunks_exact_mut(2 * dims) {
                pair[d] = sin as f32;
                pair[dims + d] = cos as f32;
                (sin, cos) = (2.0 * sin * cos, (cos - sin) * (cos + sin));
            }
        }
    }
}

/// Backward of [`encode`], from its output `encoded`: adds to `d_p`.
pub fn encode_backward(encoded: &[f32], d_encoded: &[f32], dims: usize, bands: usize, d_p: &mut [f32]) {
    let width = width(dims, bands);
    for ((row, d_row), d_p) in
        encoded.chunks_exact(width).zip(d_encoded.chunks_exact(width)).zip(d_p.chunks_exact_mut(dims))
    {
        for (d, d_p) in d_p.iter_mut().enumerate() {
            let mut sum = d_row[d];
            let mut frequency = 1.0;
            for (pair, d_pair) in row[dims..].chunks_exact(2 * dims).zip(d_row[dims..].chunks_exact(2 * dims)) {
                sum += frequency * (d_pair[d] * pair[dims + d] - d_pair[dims + d] * pair[d]);
                frequency *= 2.0;
            }
            *d_p += sum;
        }
    }
}

/// Derivative of one encoded row along coordinate `axis`, from the row: 1, then `2ᵏ cos`, `−2ᵏ sin`; 0 in the entries of
/// other coordinates.
pub fn tangent(encoded: &[f32], dims: usize, axis: usize, out: &mut [f32]) {
    out.fill(0.0);
    out[axis] = 1.0;
    let mut frequency = 1.0;
    for (pair, out) in encoded[dims..].chunks_exact(2 * dims).zip(out[dims..].chunks_exact_mut(2 * dims)) {
        out[axis] = frequency * pair[dims + axis];
        out[dims + axis] = -frequency * pair[axis];
        frequency *= 2.0;
    }
}

/// Backward of [`tangent`]: the cotangent of the coordinate.
pub fn tangent_backward(encoded: &[f32], d_tangent: &[f32], dims: usize, axis: usize) -> f32 {
    let (mut sum, mut square) = (0.0, 1.0);
    for (pair, d) in encoded[dims..].chunks_exact(2 * dims).zip(d_tangent[dims..].chunks_exact(2 * dims)) {
        sum -= square * (d[axis] * pair[axis] + d[dims + axis] * pair[dims + axis]);
        square *= 4.0;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;

    fn reference(p: f64, bands: usize) -> Vec<f64> {
        let mut out = vec![p];
        for k in 0..bands {
            let a = p * f64::from(1u32 << k);
            out.extend([a.sin(), a.cos()]);
        }
        out
    }

    #[test]
    fn values_match_library_sines() {
        let (dims, bands) = (3, 10);
        let p = [0.0, -1.3, 1.7, 12.0, 0.001, -700.0];
        let mut out = vec![0.0; 2 * width(dims, bands)];
        encode(&p, dims, bands, &mut out);
        for (i, &v) in p.iter().enumerate() {
            let row = &out[i / dims * width(dims, bands)..];
            for (k, want) in reference(f64::from(v), bands).iter().enumerate() {
                let got = f64::from(row[k * dims + i % dims]);
                assert!((got - want).abs() <= 6e-8 * want.abs().max(1.0), "p = {v}, entry {k}: {got} {want}");
            }
        }
    }

    /// Tolerance: band 7 scales f32 rounding (6e-8 on a sum of 17 terms) by up to 2⁷.
    #[test]
    fn gradient_matches_finite_differences() {
        let (dims, bands) = (2, 8);
        let mut rng = Rng::new(1, "encoding", 0, 0);
        let p: Vec<f32> = (0..10).map(|_| rng.normal()).collect();
        let d: Vec<f32> = (0..5 * width(dims, bands)).map(|_| rng.normal()).collect();
        let (mut encoded, mut d_p) = (vec![0.0; d.len()], vec![0.0; p.len()]);
        encode(&p, dims, bands, &mut encoded);
        encode_backward(&encoded, &d, dims, bands, &mut d_p);
        for (i, &v) in p.iter().enumerate() {
            let weights = &d[i / dims * width(dims, bands)..];
            let loss = |v: f64| -> f64 {
                reference(v, bands).iter().enumerate().map(|(k, e)| e * f64::from(weights[k * dims + i % dims])).sum()
            };
            let h = 1e-6;
            let want = (loss(f64::from(v) + h) - loss(f64::from(v) - h)) / (2.0 * h);
            assert!((f64::from(d_p[i]) - want).abs() < 1e-4 * (1.0 + want.abs()), "{}: {} {want}", i, d_p[i]);
        }
    }

    /// Tolerance: differences of waves of frequency 8 with this step, and their rounding.
    #[test]
    fn tangents_are_derivatives_along_an_axis() {
        let (dims, bands, p) = (2, 4, [0.7f32, -1.2]);
        let mut rng = Rng::new(3, "encoding", 0, 0);
        let d: Vec<f32> = (0..width(dims, bands)).map(|_| rng.normal()).collect();
        let (mut encoded, mut along) = (vec![0.0; d.len()], vec![7.0; d.len()]);
        encode(&p, dims, bands, &mut encoded);
        for (axis, &at) in p.iter().enumerate() {
            tangent(&encoded, dims, axis, &mut along);
            let (v, h) = (f64::from(at), 1e-4);
            let [lo, at, hi] = [v - h, v, v + h].map(|v| reference(v, bands));
            let mut second = 0.0;
            for e in 0..d.len() {
                let on_axis = e % dims == axis;
                let k = e / dims;
                let want = if on_axis { (hi[k] - lo[k]) / (2.0 * h) } else { 0.0 };
                assert!((f64::from(along[e]) - want).abs() < 1e-5, "{axis} {e}: {} {want}", along[e]);
                second += if on_axis { f64::from(d[e]) * (hi[k] - 2.0 * at[k] + lo[k]) / (h * h) } else { 0.0 };
            }
            let got = f64::from(tangent_backward(&encoded, &d, dims, axis));
            assert!((got - second).abs() < 1e-5 * (1.0 + second.abs()), "{axis}: {got} {second}");
        }
    }
}
