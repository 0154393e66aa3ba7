//! Backward of the projection: from sums over the pixels of splats to the gradients of their parameters.
//!
//! The sums arrive in the whitened coordinates `e = (a, b)` of [`crate::project`], where they are of order one:
//! `v_u = Wᵀ Σ s e` and `v_Σ' = ½ Wᵀ (Σ s e eᵀ) W`.

use super::{Footprint, SplatGeometry, View};
use crate::options::{MIN_COMPENSATION, RasterOptions};
use crate::tiles::LOG2_SCALE;
use crate::workspace::RECORD;
use gs_core::real::Real;
use gs_core::rot;

/// Gradient sums over the pixels of splats, in whitened coordinates; `s = dL/d ln g` of each sample.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PixelSums<T> {
    /// `dL/d ln o'`, the logarithm of the compensated opacity.
    pub opacity: T,
    /// `Σ s a`, `Σ s b`.
    pub first: [T; 2],
    /// `Σ s a²`, `Σ s ab`, `Σ s b²`.
    pub second: [T; 3],
    /// `dL/d rgb` of the splat's colour.
    pub rgb: [T; 3],
    /// `dL/d depth` of the splat's mean.
    pub depth: T,
    /// `Σ v outer`, `Σ v inner` with `v = dL/dψ` ([`gs_core::kernel::Partials`]).
    pub kernel: [T; 2],
}

impl<T: Real> PixelSums<T> {
    /// From sums of [records](crate::workspace::Record), whose offsets are scaled such that `log₂ g = −(a² + b²)`.
    #[inline(always)]
    pub(crate) fn new(sum: [T; RECORD]) -> Self {
        let one = sum[0].lit(1.0 / LOG2_SCALE);
        let two = sum[0].lit(1.0 / (LOG2_SCALE * LOG2_SCALE));
        Self {
            opacity: sum[0],
            first: [sum[1] * one, sum[2] * one],
            second: [sum[3] * two, sum[4] * two, sum[5] * two],
            rgb: [sum[6], sum[7], sum[8]],
            depth: sum[9],
            kernel: [sum[10], sum[11]],
        }
    }
}

/// Cotangents of the geometry and opacity of splats.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GeometryGrad<T> {
    /// `dL/d mean`, world space, without the path through the view direction.
    pub mean: [T; 3],
    /// `dL/d quat` of the unnormalised quaternion.
    pub quat: [T; 4],
    /// `dL/d scale` of the standard deviations.
    pub scale: [T; 3],
    /// `dL/d opacity` of the opacity before compensation.
    pub opacity: T,
    /// `dL/d mean2d`, per pixel.
    pub mean2d: [T; 2],
    /// What reaches the camera.
    pub in_camera: CameraSpaceGrad<T>,
}

/// Cotangents of splats in camera space.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CameraSpaceGrad<T> {
    /// Of the mean `R_v m + t_v`.
    pub point: [T; 3],
    /// Of the axes `R_v R`.
    pub axes: [[T; 3]; 3],
    /// Of `f/z` and of `−f·clamp/z`, per axis.
    pub jacobian: [[T; 2]; 2],
}

impl<T: Real> Footprint<T> {
    /// `dL/dΣ2`, full symmetric: `xx, xy, yy` with one `xy` for each of the two off-diagonal entries.
    #[inline(always)]
    fn covariance_backward(&self, sums: &PixelSums<T>, options: &RasterOptions) -> [T; 3] {
        let k = sums.opacity;
        let [w0, w1, w2] = self.whitening;
        let [aa, ab, bb] = sums.second;
        // ½ Wᵀ M W with W = [[w0, w1], [0, w2]].
        let (p, q) = (aa * w0, aa * w1 + ab * w2);
        let r = ab * w1 + bb * w2;
        let half = k.lit(0.5);
        let d = [half * w0 * p, half * w0 * q, half * (w1 * q + w2 * r)];
        if !options.antialias {
            return d;
        }
        // ln comp = ½ (ln |Σ2| − ln |Σ'|), and `sums.opacity` its cotangent; adj/det avoids dividing by |Σ2| alone.
        let dilation = k.lit(options.dilation);
        let [xx, xy, yy] = self.covariance;
        let (by_det0, by_det) = (half * sums.opacity / self.det0, half * sums.opacity / self.det);
        let (floor, ratio) = (k.lit(MIN_COMPENSATION.powi(2)), self.det0 / self.det);
        [
            floor.select_lt(ratio, d[0] + (by_det0 * (yy - dilation) - by_det * yy), d[0]),
            floor.select_lt(ratio, d[1] - (by_det0 * xy - by_det * xy), d[1]),
            floor.select_lt(ratio, d[2] + (by_det0 * (xx - dilation) - by_det * xx), d[2]),
        ]
    }
}

/// Cotangents of the geometry of splats from their pixel sums.
#[inline(always)]
pub(crate) fn backward<T: Real>(
    view: &View,
    geometry: &SplatGeometry<T>,
    fp: &Footprint<T>,
    opacity: T,
    sums: &PixelSums<T>,
    options: &RasterOptions,
) -> GeometryGrad<T> {
    let zero = opacity.lit(0.0);
    let [w0, w1, w2] = fp.whitening;
    let mean2d = [w0 * sums.first[0], w1 * sums.first[0] + w2 * sums.first[1]];
    let d_cov = fp.covariance_backward(sums, options);
    let s = geometry.scale;
    let inv_z = opacity.lit(1.0) / fp.point[2];
    let two = opacity.lit(2.0);
    // d_F = 2 d_Σ F; F = diag(f/z) (rows 0, 1 of W_t − clamp ⊗ row 2) diag(s).
    let mut scale = [zero; 3];
    let mut d_turned = [[zero; 3]; 3];
    let mut d_j = [[zero; 2]; 2]; // cotangents of f/z and −f·clamp/z, per axis
    for k in 0..3 {
        let f = [fp.factor[0][k], fp.factor[1][k]];
        let d_f = [two * (d_cov[0] * f[0] + d_cov[1] * f[1]), two * (d_cov[1] * f[0] + d_cov[2] * f[1])];
        for r in 0..2 {
            let j = opacity.lit(view.focal[r]) * inv_z;
            let unscaled = j * (fp.cam_axes[r][k] - fp.clamped[r] * fp.cam_axes[2][k]);
            scale[k] = scale[k] + d_f[r] * unscaled;
            let d_jw = d_f[r] * s[k];
            d_turned[r][k] = j * d_jw;
            d_turned[2][k] = d_turned[2][k] - j * fp.clamped[r] * d_jw;
            d_j[r][0] = d_j[r][0] + d_jw * fp.cam_axes[r][k];
            d_j[r][1] = d_j[r][1] + d_jw * fp.cam_axes[2][k];
        }
    }
    let mut d_rotation = d_turned;
    for k in 0..3 {
        let column = view.turned_back([d_turned[0][k], d_turned[1][k], d_turned[2][k]]);
        for r in 0..3 {
            d_rotation[r][k] = column[r];
        }
    }
    let quat = rot::normalise_backward(&fp.unit, rot::matrix_backward(fp.unit.wxyz, &d_rotation));
    let d_point = point_backward(view, fp, mean2d, &d_j, sums.depth);
    GeometryGrad {
        mean: view.turned_back(d_point),
        quat,
        scale,
        opacity: zero.select_lt(opacity, sums.opacity / opacity, zero),
        mean2d,
        in_camera: CameraSpaceGrad { point: d_point, axes: d_turned, jacobian: d_j },
    }
}

#[inline(always)]
fn point_backward<T: Real>(view: &View, fp: &Footprint<T>, mean2d: [T; 2], d_j: &[[T; 2]; 2], d_depth: T) -> [T; 3] {
    let t = fp.point;
    let inv_z = d_depth.lit(1.0) / t[2];
    let mut d = [d_depth.lit(0.0), d_depth.lit(0.0), d_depth];
    for axis in 0..2 {
        let j = d_depth.lit(view.focal[axis]) * inv_z;
        let ratio = t[axis] * inv_z;
        d[axis] = d[axis] + j * mean2d[axis];
        d[2] = d[2] - j * ratio * mean2d[axis];
        d[2] = d[2] - j * inv_z * (d_j[axis][0] - fp.clamped[axis] * d_j[axis][1]);
        let through = fp.unclamped[axis] * j * inv_z * d_j[axis][1];
        d[axis] = d[axis] - through;
        d[2] = d[2] + through * ratio;
    }
    d
}
