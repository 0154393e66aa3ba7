//! Projection of one splat and its backward: the production form.
//!
//! Same mathematics as [`crate::reference`], in `f64`, but the screen ellipse is kept as a **whitening** `W` instead of
//! a conic: `K = WᵀW`, so that the Mahalanobis distance is a sum of two squares that cannot cancel, even for needles:
//! ```text
//! (dx, dy) = pixel − u
//! b = dy / √Σ'yy           a = (dx − Σ'xy/Σ'yy · dy) · √(Σ'yy / |Σ'|)          q = a² + b²
//! ```
//! `|Σ2| = |f₀ × f₁|²` (Cauchy–Binet on the 2×3 factor `F = J R_v R diag(s)`) and `|Σ'| = |Σ2| + δ tr Σ2 + δ²` are sums
//! of non-negative terms. Backward, the sums over pixels arrive in whitened coordinates `e = (a, b)`, where they are of
//! order one: `v_u = Wᵀ Σ s e` and `v_Σ' = ½ Wᵀ (Σ s e eᵀ) W`.

use crate::options::{FRUSTUM_MARGIN, MIN_COMPENSATION, RasterOptions};
use glam::Vec3;
use gs_core::real::{cross3, dot3};
use gs_core::{Camera, rot, sh};

/// A camera's constants in the form projection needs, computed once per frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    pub(crate) rotation: [[f64; 3]; 3],
    translation: [f64; 3],
    pub(crate) position: [f64; 3],
    focal: [f64; 2],
    center: [f64; 2],
    /// Bounds of `x/z` and of `y/z` in the Jacobian.
    limits: [[f64; 2]; 2],
}

impl View {
    /// From a camera that has passed its `check`.
    pub(crate) fn new(camera: &Camera) -> Self {
        let limit = |side: u32, f: f64, c: f64| {
            let margin = FRUSTUM_MARGIN * 0.5 * f64::from(side) / f;
            [-(c / f + margin), (f64::from(side) - c) / f + margin]
        };
        Self {
            rotation: camera.rotation.transpose().to_cols_array_2d(),
            translation: camera.translation.to_array(),
            position: camera.position().to_array(),
            focal: [camera.fx, camera.fy],
            center: [camera.cx, camera.cy],
            limits: [limit(camera.width, camera.fx, camera.cx), limit(camera.height, camera.fy, camera.cy)],
        }
    }

    /// Camera depth of a point, world units.
    #[inline(always)]
    pub(crate) fn depth(&self, mean: Vec3) -> f64 {
        dot3(self.rotation[2], mean.to_array().map(f64::from)) + self.translation[2]
    }
}

impl View {
    /// Centre in pixels, and an upper bound of the splat's radius out to `max_distance` standard deviations:
    /// `λ_max(Σ') ≤ ‖J‖² max(s)² + dilation` with `‖J‖² ≤ (f/z)² (1 + x̃² + ỹ²)`.
    #[inline(always)]
    pub(crate) fn bound(&self, geometry: &SplatGeometry, dilation: f64, max_distance: f64) -> ([f32; 2], f32) {
        let m = [f64::from(geometry.mean.x), f64::from(geometry.mean.y), f64::from(geometry.mean.z)];
        let t = |r: usize| dot3(self.rotation[r], m) + self.translation[r];
        let inv_z = 1.0 / t(2);
        let (x, y) = (t(0) * inv_z, t(1) * inv_z);
        let x_clamped = x.clamp(self.limits[0][0], self.limits[0][1]);
        let y_clamped = y.clamp(self.limits[1][0], self.limits[1][1]);
        let focal = self.focal[0].max(self.focal[1]) * inv_z;
        let size = f64::from(geometry.scale.abs().max_element()) * focal;
        let spread = size * size * (1.0 + x_clamped * x_clamped + y_clamped * y_clamped) + dilation;
        let radius = max_distance * spread.sqrt() * (1.0 + 1e-5) + 1e-2;
        let center = [self.focal[0] * x + self.center[0], self.focal[1] * y + self.center[1]];
        // Far centres lose absolute precision in f32; the radius is widened by that.
        let rounding = 1e-6 * (center[0].abs() + center[1].abs());
        ([center[0] as f32, center[1] as f32], (radius + rounding) as f32)
    }
}

/// A splat's geometry on the screen, with the intermediates that backward needs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Footprint {
    /// Projected mean, pixels.
    pub center: [f64; 2],
    /// Mean in camera space, world units.
    pub point: [f64; 3],
    /// Whitening: `a = w[0] dx + w[1] dy`, `b = w[2] dy`.
    pub whitening: [f64; 3],
    /// Dilated covariance `Σ'` as `xx, xy, yy`, pixels².
    pub covariance: [f64; 3],
    /// `|Σ2|`, before dilation.
    det0: f64,
    /// `|Σ'|`, after dilation.
    det: f64,
    /// Anti-aliasing factor on the opacity (1 when off).
    pub compensation: f64,
    /// The quaternion, normalised.
    pub unit: rot::UnitQuat<f64>,
    /// `R_v R`: columns are the splat's axes in camera space.
    cam_axes: [[f64; 3]; 3],
    /// `F = J R_v R diag(s)`.
    factor: [[f64; 3]; 2],
    /// `x/z`, `y/z` clamped to the bounds.
    pub clamped: [f64; 2],
    /// 1 where the clamp changed nothing, else 0.
    pub unclamped: [f64; 2],
}

/// Geometry parameters of one splat.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SplatGeometry {
    /// World-space mean, world units.
    pub mean: Vec3,
    /// Quaternion `(w, x, y, z)` of any length.
    pub quat: [f32; 4],
    /// Standard deviations, world units.
    pub scale: Vec3,
}

/// Projects one splat whose depth lies within the range. `None` if its ellipse is not finite.
#[inline(always)]
pub(crate) fn project(view: &View, geometry: &SplatGeometry, options: &RasterOptions) -> Option<Footprint> {
    let m = geometry.mean.to_array().map(f64::from);
    let t: [f64; 3] = std::array::from_fn(|r| dot3(view.rotation[r], m) + view.translation[r]);
    let inv_z = 1.0 / t[2];
    let mut clamped = [0.0; 2];
    let mut unclamped = [0.0; 2];
    for axis in 0..2 {
        let [lo, hi] = view.limits[axis];
        let ratio = t[axis] * inv_z;
        clamped[axis] = ratio.clamp(lo, hi);
        unclamped[axis] = if ratio >= lo && ratio <= hi { 1.0 } else { 0.0 };
    }
    let unit = rot::normalise(geometry.quat.map(f64::from));
    let cam_axes = multiply(&view.rotation, &rot::matrix(unit.wxyz));
    let s = geometry.scale.to_array().map(f64::from);
    let factor: [[f64; 3]; 2] = std::array::from_fn(|r| {
        let f = view.focal[r] * inv_z;
        std::array::from_fn(|k| f * (cam_axes[r][k] - clamped[r] * cam_axes[2][k]) * s[k])
    });
    let dilation = options.dilation;
    let (xx0, xy, yy0) = (dot3(factor[0], factor[0]), dot3(factor[0], factor[1]), dot3(factor[1], factor[1]));
    let cross = cross3(factor[0], factor[1]);
    let det0 = dot3(cross, cross);
    let det = det0 + dilation * (xx0 + yy0) + dilation * dilation;
    let (xx, yy) = (xx0 + dilation, yy0 + dilation);
    if !(det.is_finite() && det > 0.0) {
        return None;
    }
    let along = (yy / det).sqrt();
    let floor = MIN_COMPENSATION.powi(2);
    Some(Footprint {
        center: [view.focal[0] * t[0] * inv_z + view.center[0], view.focal[1] * t[1] * inv_z + view.center[1]],
        point: t,
        whitening: [along, -(xy / yy) * along, 1.0 / yy.sqrt()],
        covariance: [xx, xy, yy],
        det0,
        det,
        compensation: if options.antialias { (det0 / det).max(floor).sqrt() } else { 1.0 },
        unit,
        cam_axes,
        factor,
        clamped,
        unclamped,
    })
}

/// Three standard deviations along the larger axis of the covariance `xx, xy, yy`.
pub(crate) fn standard_radius([xx, xy, yy]: [f64; 3]) -> f64 {
    let (mid, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
    3.0 * (mid + (half * half + xy * xy).sqrt()).sqrt()
}

#[inline(always)]
fn multiply(a: &[[f64; 3]; 3], b: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    std::array::from_fn(|r| std::array::from_fn(|k| a[r][0] * b[0][k] + a[r][1] * b[1][k] + a[r][2] * b[2][k]))
}

/// Gradient sums over the pixels of one splat, in whitened coordinates; `s = dL/d ln g` of each sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct PixelSums {
    /// `dL/d ln o'`, the logarithm of the compensated opacity.
    pub opacity: f64,
    /// `Σ s a`, `Σ s b`.
    pub first: [f64; 2],
    /// `Σ s a²`, `Σ s ab`, `Σ s b²`.
    pub second: [f64; 3],
    /// `dL/d rgb` of the splat's colour.
    pub rgb: [f64; 3],
    /// `dL/d depth` of the splat's mean.
    pub depth: f64,
    /// `Σ v outer`, `Σ v inner` with `v = dL/dψ` ([`gs_core::kernel::Partials`]).
    pub kernel: [f64; 2],
}

/// Cotangents of one splat's geometry and opacity.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct GeometryGrad {
    /// `dL/d mean`, world space, without the path through the view direction.
    pub mean: [f64; 3],
    /// `dL/d quat` of the unnormalised quaternion.
    pub quat: [f64; 4],
    /// `dL/d scale` of the standard deviations.
    pub scale: [f64; 3],
    /// `dL/d opacity` of the opacity before compensation.
    pub opacity: f64,
    /// `dL/d mean2d`, per pixel.
    pub mean2d: [f64; 2],
    /// What reaches the camera.
    pub in_camera: CameraSpaceGrad,
}

/// Cotangents of one splat in camera space.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct CameraSpaceGrad {
    /// Of the mean `R_v m + t_v`.
    pub point: [f64; 3],
    /// Of the axes `R_v R`.
    pub axes: [[f64; 3]; 3],
    /// Of `f/z` and of `−f·clamp/z`, per axis.
    pub jacobian: [[f64; 2]; 2],
}

impl Footprint {
    /// Camera depth of the mean, world units.
    pub(crate) fn depth(&self) -> f64 {
        self.point[2]
    }

    /// Three standard deviations along the larger axis, pixels; see [`crate::ScreenStats::radii`].
    pub(crate) fn radius(&self) -> f64 {
        standard_radius(self.covariance)
    }

    /// `dL/dΣ2`, full symmetric: `xx, xy, yy` with one `xy` for each of the two off-diagonal entries.
    #[inline(always)]
    fn covariance_backward(&self, sums: &PixelSums, options: &RasterOptions) -> [f64; 3] {
        let [w0, w1, w2] = self.whitening;
        let [aa, ab, bb] = sums.second;
        // ½ Wᵀ M W with W = [[w0, w1], [0, w2]].
        let (p, q) = (aa * w0, aa * w1 + ab * w2);
        let r = ab * w1 + bb * w2;
        let mut d = [0.5 * w0 * p, 0.5 * w0 * q, 0.5 * (w1 * q + w2 * r)];
        let ratio = self.det0 / self.det;
        if options.antialias && ratio > MIN_COMPENSATION.powi(2) {
            // ln comp = ½ (ln |Σ2| − ln |Σ'|), and `sums.opacity` its cotangent; adj/det avoids dividing by |Σ2| alone.
            let dilation = options.dilation;
            let [xx, xy, yy] = self.covariance;
            let (k0, k) = (0.5 * sums.opacity / self.det0, 0.5 * sums.opacity / self.det);
            d[0] += k0 * (yy - dilation) - k * yy;
            d[1] -= k0 * xy - k * xy;
            d[2] += k0 * (xx - dilation) - k * xx;
        }
        d
    }
}

/// Cotangents of one splat's geometry from its pixel sums.
#[inline(always)]
pub(crate) fn backward(
    view: &View,
    geometry: &SplatGeometry,
    footprint: &Footprint,
    opacity: f64,
    sums: &PixelSums,
    options: &RasterOptions,
) -> GeometryGrad {
    let fp = footprint;
    let [w0, w1, w2] = fp.whitening;
    let mean2d = [w0 * sums.first[0], w1 * sums.first[0] + w2 * sums.first[1]];
    let d_cov = fp.covariance_backward(sums, options);
    let s = geometry.scale.to_array().map(f64::from);
    let inv_z = 1.0 / fp.point[2];
    // d_F = 2 d_Σ F; F = diag(f/z) (rows 0, 1 of W_t − clamp ⊗ row 2) diag(s).
    let mut scale = [0.0; 3];
    let mut d_turned = [[0.0; 3]; 3];
    let mut d_j = [[0.0; 2]; 2]; // cotangents of f/z and −f·clamp/z, per axis
    for k in 0..3 {
        let f = [fp.factor[0][k], fp.factor[1][k]];
        let d_f = [2.0 * (d_cov[0] * f[0] + d_cov[1] * f[1]), 2.0 * (d_cov[1] * f[0] + d_cov[2] * f[1])];
        for r in 0..2 {
            let j = view.focal[r] * inv_z;
            let unscaled = j * (fp.cam_axes[r][k] - fp.clamped[r] * fp.cam_axes[2][k]);
            scale[k] += d_f[r] * unscaled;
            let d_jw = d_f[r] * s[k];
            d_turned[r][k] = j * d_jw;
            d_turned[2][k] -= j * fp.clamped[r] * d_jw;
            d_j[r][0] += d_jw * fp.cam_axes[r][k];
            d_j[r][1] += d_jw * fp.cam_axes[2][k];
        }
    }
    let d_rotation =
        std::array::from_fn(|r| std::array::from_fn(|k| (0..3).map(|c| view.rotation[c][r] * d_turned[c][k]).sum()));
    let quat = rot::normalise_backward(&fp.unit, rot::matrix_backward(fp.unit.wxyz, &d_rotation));
    let d_point = point_backward(view, fp, mean2d, &d_j, sums.depth);
    GeometryGrad {
        mean: std::array::from_fn(|k| (0..3).map(|r| view.rotation[r][k] * d_point[r]).sum()),
        quat,
        scale,
        opacity: if opacity > 0.0 { sums.opacity / opacity } else { 0.0 },
        mean2d,
        in_camera: CameraSpaceGrad { point: d_point, axes: d_turned, jacobian: d_j },
    }
}

#[inline(always)]
fn point_backward(view: &View, fp: &Footprint, mean2d: [f64; 2], d_j: &[[f64; 2]; 2], d_depth: f64) -> [f64; 3] {
    let t = fp.point;
    let inv_z = 1.0 / t[2];
    let mut d = [0.0, 0.0, d_depth];
    for axis in 0..2 {
        let j = view.focal[axis] * inv_z;
        let ratio = t[axis] * inv_z;
        d[axis] += j * mean2d[axis];
        d[2] -= j * ratio * mean2d[axis];
        d[2] -= j * inv_z * (d_j[axis][0] - fp.clamped[axis] * d_j[axis][1]);
        let through = fp.unclamped[axis] * j * inv_z * d_j[axis][1];
        d[axis] -= through;
        d[2] += through * ratio;
    }
    d
}

/// Colour of SH coefficients `row` (`[K, 3]`) seen from `position`, clamped at zero.
#[inline(always)]
pub(crate) fn sh_color(mean: Vec3, position: [f64; 3], degree: u8, row: &[f32]) -> [f32; 3] {
    let basis = view_basis(mean, position, degree).0;
    sh_color_unclamped(&basis, row).map(|v| v.max(0.0))
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
