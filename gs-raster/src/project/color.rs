//! Colour of SH coefficients seen from a camera, and its backward, one splat at a time.
//!
//! `rgb = max(0, ½ + Σ_k Y_k(d) c_k)` with the basis `Y` of [`gs_core::sh`] in the direction `d` from the camera to the mean.

use glam::Vec3;
use gs_core::sh;

/// Largest colour of SH coefficients: finite, with room for sums over splats.
const MAX_COLOR: f32 = 1e37;

/// Colour of SH coefficients `row` (`[K, 3]`) seen from `position`, clamped at zero and at [`MAX_COLOR`].
#[inline(always)]
#[expect(clippy::manual_clamp, reason = "a sum of opposite infinities is no number, and becomes 0")]
pub(crate) fn sh_color(mean: Vec3, position: [f64; 3], degree: u8, row: &[f32]) -> [f32; 3] {
    let (basis, ..) = view_basis(mean, position, degree);
    sh_color_unclamped(&basis, row).map(|v| v.max(0.0).min(MAX_COLOR))
}

#[inline(always)]
fn view_basis(mean: Vec3, position: [f64; 3], degree: u8) -> ([f32; 16], [f32; 3], f32) {
    let (d, inv) = sh::direction(mean.to_array().map(f64::from), position);
    let d = d.map(|v| v as f32);
    (sh::basis(d, degree), d, inv as f32)
}

/// Cotangents of SH coefficients (written to `d_row`) and of the mean through the view direction (returned).
#[inline(always)]
pub(crate) fn sh_color_backward(
    mean: Vec3,
    position: [f64; 3],
    degree: u8,
    row: &[f32],
    d_rgb: [f32; 3],
    d_row: &mut [f32],
) -> [f32; 3] {
    let (basis, dir, inv) = view_basis(mean, position, degree);
    let rgb = sh_color_unclamped(&basis, row);
    let d: [f32; 3] = std::array::from_fn(|k| if rgb[k] > 0.0 { d_rgb[k] } else { 0.0 });
    let mut d_basis = [0.0f32; 16];
    let rows = row.as_chunks::<3>().0.iter().zip(d_row.as_chunks_mut::<3>().0);
    for ((c, to), (y, d_y)) in rows.zip(basis.iter().zip(&mut d_basis)) {
        *to = d.map(|v| v * y);
        *d_y = c[0] * d[0] + c[1] * d[1] + c[2] * d[2];
    }
    sh::direction_backward(dir, inv, sh::basis_backward(dir, degree, &d_basis))
}

#[inline(always)]
fn sh_color_unclamped(basis: &[f32; 16], row: &[f32]) -> [f32; 3] {
    let mut rgb = [0.5f32; 3];
    for (y, c) in basis.iter().zip(row.as_chunks::<3>().0) {
        for k in 0..3 {
            rgb[k] += y * c[k];
        }
    }
    rgb
}
