//! From the heads' outputs of a block of anchors to its splats, forward and backward.
//!
//! With `u = x' − eye`, `δ = |u|`, `d = u / δ` and the heads' outputs `z` (opacity), `c̃` (colour), `q` (covariance):
//!
//! ```text
//! a = tanh z     kept iff a > 0                                                  α = a
//! μ = x' + O' ⊙ l'[0:3]     rgb = σ(c̃)     s = |l'[3:6]| ⊙ σ(q[0:3])     r = q[3:7], raw
//!
//! g_z = g_α (1 − a²)     g_c̃ = g_rgb rgb (1 − rgb)     g_q = [g_s s (1 − σ), g_r]
//! g_O' = g_μ ⊙ l'[0:3]     g_l' = [Σ g_μ ⊙ O', sign(l') Σ g_s ⊙ σ]     g_x' = Σ g_μ + (g_d − d (d·g_d)) / δ + d g_δ
//! ```
//! Dropped Gaussians have cotangents of zero; the test `a > 0` has no gradient.

use crate::{LocalAnchors, LocalAnchorsGrad};
use glam::{DVec3, Vec3};
use gs_core::cloud::sigmoid;
use gs_core::{Color, Splats, SplatsGrad, cast};

/// Direction and distance of an anchor from the camera centre.
#[derive(Clone, Copy, Debug)]
pub(super) struct ViewRay {
    /// Unit vector `d` from the camera centre to the anchor.
    pub(super) direction: Vec3,
    /// Distance `δ`, world units.
    pub(super) distance: f32,
}

impl ViewRay {
    pub(super) fn new(position: Vec3, eye: DVec3) -> Self {
        let u = position.as_dvec3() - eye;
        let distance = u.length();
        Self { direction: (u / distance).as_vec3(), distance: cast::to_f32(distance) }
    }

    /// Backward of [`ViewRay::new`]: the cotangent of the position.
    pub(super) fn backward(&self, d_direction: Vec3, d_distance: f32) -> Vec3 {
        let d = self.direction;
        (d_direction - d * d.dot(d_direction)) / self.distance + d * d_distance
    }
}

/// The rows of splats that one block writes.
pub(super) struct SplatRows<'a> {
    means: &'a mut [Vec3],
    quats: &'a mut [[f32; 4]],
    scales: &'a mut [Vec3],
    opacities: &'a mut [f32],
    rgb: &'a mut [[f32; 3]],
    rows: &'a mut [u32],
}

impl<'a> SplatRows<'a> {
    /// All rows of `splats` and of the index list `rows`, both resized to `n`.
    pub(super) fn all(splats: &'a mut Splats, rows: &'a mut Vec<u32>, n: usize) -> Self {
        let Splats { means, quats, scales, opacities, color, kernel } = splats;
        *kernel = gs_core::Kernel::Gaussian;
        if !matches!(color, Color::Rgb(_)) {
            *color = Color::default();
        }
        let rgb: &mut [[f32; 3]] = match color {
            Color::Rgb(rgb) => {
                rgb.resize(n, [0.0; 3]);
                rgb
            }
            Color::Sh { .. } => &mut [],
        };
        means.resize(n, Vec3::ZERO);
        quats.resize(n, [0.0; 4]);
        scales.resize(n, Vec3::ZERO);
        opacities.resize(n, 0.0);
        rows.resize(n, 0);
        Self { means, quats, scales, opacities, rgb, rows }
    }

    /// Splits off the first `n` rows.
    pub(super) fn take(&mut self, n: usize) -> Self {
        Self {
            means: self.means.split_off_mut(..n).unwrap_or_default(),
            quats: self.quats.split_off_mut(..n).unwrap_or_default(),
            scales: self.scales.split_off_mut(..n).unwrap_or_default(),
            opacities: self.opacities.split_off_mut(..n).unwrap_or_default(),
            rgb: self.rgb.split_off_mut(..n).unwrap_or_default(),
            rows: self.rows.split_off_mut(..n).unwrap_or_default(),
        }
    }
}

/// Outputs of the heads for a block, `k` Gaussians per anchor.
pub(super) struct HeadOutputs<'a> {
    /// `tanh` of the opacity head, `[anchors, k]`.
    pub(super) activations: &'a [f32],
    /// Colour head, `[anchors, 3k]`; becomes `rgb` where a Gaussian is kept.
    pub(super) color: &'a mut [f32],
    /// Covariance head, `[anchors, 7k]`; the first three of each 7 become `σ` where a Gaussian is kept.
    pub(super) covariance: &'a mut [f32],
}

/// Writes the kept Gaussians of a block.
pub(super) fn write(local: &LocalAnchors, anchors: &[u32], heads: HeadOutputs<'_>, to: SplatRows<'_>) {
    let k = heads.activations.len() / anchors.len().max(1);
    for (n, (i, &a)) in heads.activations.iter().enumerate().filter(|(_, a)| **a > 0.0).enumerate() {
        let v = anchors[i / k] as usize;
        let row = v * k + i % k;
        let (rgb, q) = (&mut heads.color[3 * i..][..3], &mut heads.covariance[7 * i..][..7]);
        rgb.iter_mut().chain(&mut q[..3]).for_each(|z| *z = sigmoid(*z));
        let (spread, extent) = scales(local, v);
        to.means[n] = local.positions[v] + Vec3::from_slice(&local.offsets[3 * row..]) * spread;
        to.scales[n] = extent.abs() * Vec3::from_slice(q);
        to.quats[n] = [q[3], q[4], q[5], q[6]];
        to.opacities[n] = a;
        to.rgb[n] = [rgb[0], rgb[1], rgb[2]];
        to.rows[n] = cast::to_u32(row);
    }
}

/// `l'[0:3]` and `l'[3:6]` of anchor `v`.
fn scales(local: &LocalAnchors, v: usize) -> (Vec3, Vec3) {
    let l = &local.scales[6 * v..][..6];
    (Vec3::from_slice(l), Vec3::from_slice(&l[3..]))
}

/// Cotangents of consecutive anchors from `first` on, which one chunk of blocks adds to.
pub(super) struct AnchorGradRows<'a> {
    first: usize,
    /// Cotangents of `x'`.
    pub(super) positions: &'a mut [Vec3],
    offsets: &'a mut [f32],
    features: &'a mut [f32],
    scales: &'a mut [f32],
}

impl<'a> AnchorGradRows<'a> {
    /// The cotangents of all anchors.
    pub(super) fn all(d: &'a mut LocalAnchorsGrad) -> Self {
        let LocalAnchorsGrad { positions, offsets, features, scales } = d;
        Self { first: 0, positions, offsets, features, scales }
    }

    /// Splits off the anchors before `end`.
    pub(super) fn take(&mut self, end: usize) -> Self {
        let (first, n, rest) = (self.first, end - self.first, self.positions.len().max(1));
        let cut = |column: &mut &'a mut [f32]| {
            let width = column.len() / rest;
            column.split_off_mut(..n * width).unwrap_or_default()
        };
        let (offsets, features, scales) = (cut(&mut self.offsets), cut(&mut self.features), cut(&mut self.scales));
        self.first = end;
        Self { first, positions: self.positions.split_off_mut(..n).unwrap_or_default(), offsets, features, scales }
    }

    /// Row of anchor `v` within these columns.
    pub(super) fn row(&self, v: u32) -> usize {
        v as usize - self.first
    }

    /// Cotangent of the feature of row `row`, of the given width.
    pub(super) fn feature(&mut self, row: usize, width: usize) -> &mut [f32] {
        &mut self.features[row * width..][..width]
    }
}

/// Backward of [`write`]: adds to the anchors' cotangents, sets those of the heads' outputs before their activations.
/// `first` is the row of the block's first splat in `d_out`.
pub(super) fn backward(
    local: &LocalAnchors,
    anchors: &[u32],
    heads: HeadOutputs<'_>,
    (d_out, first): (&SplatsGrad, usize),
    d: &mut AnchorGradRows<'_>,
    d_heads: &mut [Vec<f32>; 3],
) {
    let k = heads.activations.len() / anchors.len().max(1);
    let [d_opacity, d_color, d_covariance] = d_heads;
    for (d, width) in [(&mut *d_opacity, 1), (&mut *d_color, 3), (&mut *d_covariance, 7)] {
        d.clear();
        d.resize(width * heads.activations.len(), 0.0);
    }
    let kept = heads.activations.iter().enumerate().filter(|(_, a)| **a > 0.0);
    for (n, (i, &a)) in (first..).zip(kept) {
        let v = anchors[i / k] as usize;
        let (rgb, q) = (&heads.color[3 * i..][..3], &heads.covariance[7 * i..][..7]);
        d_opacity[i] = d_out.opacities[n] * (1.0 - a * a);
        for c in 0..3 {
            d_color[3 * i + c] = d_out.color[3 * n + c] * rgb[c] * (1.0 - rgb[c]);
        }
        let (spread, extent) = scales(local, v);
        let (d_mean, d_scale, sigma) = (d_out.means[n], d_out.scales[n], Vec3::from_slice(q));
        let d_q = &mut d_covariance[7 * i..][..7];
        (d_scale * extent.abs() * sigma * (1.0 - sigma)).write_to_slice(d_q);
        d_q[3..].copy_from_slice(&d_out.quats[n]);
        let row = d.row(anchors[i / k]);
        d.positions[row] += d_mean;
        let offset = Vec3::from_slice(&local.offsets[3 * (v * k + i % k)..]);
        add(&mut d.offsets[3 * (row * k + i % k)..], d_mean * spread);
        add(&mut d.scales[6 * row..], d_mean * offset);
        add(&mut d.scales[6 * row + 3..], d_scale * sigma * extent.signum());
    }
}

fn add(to: &mut [f32], v: Vec3) {
    to.iter_mut().zip(v.to_array()).for_each(|(to, v)| *to += v);
}
