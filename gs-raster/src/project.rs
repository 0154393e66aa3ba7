//! Projection of splats and its backward, eight at a time: the production form.
//!
//! Same mathematics as [`crate::reference`], in lanes of `f64` ([`crate::lanes`]), but the screen ellipse is kept as a **whitening** `W` instead of
//! a conic: `K = WᵀW`, so that the Mahalanobis distance is a sum of two squares that cannot cancel, even for needles:
//! ```text
//! (dx, dy) = pixel − u
//! b = dy / √Σ'yy           a = (dx − Σ'xy/Σ'yy · dy) · √(Σ'yy / |Σ'|)          q = a² + b²
//! ```
//! `|Σ2| = |f₀ × f₁|²` (Cauchy–Binet on the 2×3 factor `F = J R_v R diag(s)`) and `|Σ'| = |Σ2| + δ tr Σ2 + δ²` are sums
//! of non-negative terms. Backward, the sums over pixels arrive in whitened coordinates `e = (a, b)`, where they are of
//! order one: `v_u = Wᵀ Σ s e` and `v_Σ' = ½ Wᵀ (Σ s e eᵀ) W`.

use crate::lanes::{LANES, Lanes};
use crate::options::{FRUSTUM_MARGIN, MIN_COMPENSATION, RasterOptions};
use crate::tiles::LOG2_SCALE;
use crate::workspace::RECORD;
use fearless_simd::Simd;
use glam::Vec3;
use gs_core::real::{Real, cross3, dot3};
use gs_core::{Camera, SplatsRef, rot, sh};

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
    /// Points in camera space, world units.
    #[inline(always)]
    fn point<T: Real>(&self, mean: [T; 3]) -> [T; 3] {
        let k = mean[0];
        let ([r0, r1, r2], [t0, t1, t2]) = (self.rotation, self.translation);
        [dot3(lits(k, r0), mean) + k.lit(t0), dot3(lits(k, r1), mean) + k.lit(t1), dot3(lits(k, r2), mean) + k.lit(t2)]
    }

    /// `R_vᵀ d`.
    #[inline(always)]
    fn turned_back<T: Real>(&self, d: [T; 3]) -> [T; 3] {
        let (k, [a, b, c]) = (d[0], self.rotation);
        [
            k.lit(a[0]) * d[0] + k.lit(b[0]) * d[1] + k.lit(c[0]) * d[2],
            k.lit(a[1]) * d[0] + k.lit(b[1]) * d[1] + k.lit(c[1]) * d[2],
            k.lit(a[2]) * d[0] + k.lit(b[2]) * d[1] + k.lit(c[2]) * d[2],
        ]
    }

    /// Bounds of `x/z` or `y/z`: the ratio within them, and 1 where that changed nothing, else 0.
    #[inline(always)]
    fn clamp<T: Real>(&self, axis: usize, ratio: T) -> [T; 2] {
        let [lo, hi] = self.limits[axis];
        let (lo, hi, zero, one) = (ratio.lit(lo), ratio.lit(hi), ratio.lit(0.0), ratio.lit(1.0));
        [ratio.max(lo).min(hi), ratio.select_lt(lo, zero, hi.select_lt(ratio, zero, one))]
    }

    /// Centre in pixels, and an upper bound of the splat's radius out to `max_distance` standard deviations, where
    /// `largest` is the largest of its three:
    /// `λ_max(Σ') ≤ ‖J‖² max(s)² + dilation` with `‖J‖² ≤ (f/z)² (1 + x̃² + ỹ²)`.
    #[inline(always)]
    pub(crate) fn bound<T: Real>(&self, mean: [T; 3], largest: T, dilation: f64, max_distance: T) -> ([T; 2], T) {
        let k = largest;
        let t = self.point(mean);
        let inv_z = k.lit(1.0) / t[2];
        let (across, down) = (t[0] * inv_z, t[1] * inv_z);
        let ([x, _], [y, _]) = (self.clamp(0, across), self.clamp(1, down));
        let size = largest * (k.lit(self.focal[0].max(self.focal[1])) * inv_z);
        let spread = size * size * (k.lit(1.0) + x * x + y * y) + k.lit(dilation);
        let radius = max_distance * spread.sqrt() * k.lit(1.0 + 1e-5) + k.lit(1e-2);
        let u = k.lit(self.focal[0]) * across + k.lit(self.center[0]);
        let v = k.lit(self.focal[1]) * down + k.lit(self.center[1]);
        // Far centres lose absolute precision in f32; the radius is widened by that.
        let rounding = k.lit(1e-6) * (u.max(-u) + v.max(-v));
        ([u, v], radius + rounding)
    }
}

/// The geometry of splats on the screen, with the intermediates that backward needs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Footprint<T> {
    /// Projected mean, pixels.
    pub center: [T; 2],
    /// Mean in camera space, world units.
    pub point: [T; 3],
    /// Whitening: `a = w[0] dx + w[1] dy`, `b = w[2] dy`.
    pub whitening: [T; 3],
    /// Dilated covariance `Σ'` as `xx, xy, yy`, pixels².
    pub covariance: [T; 3],
    /// `|Σ2|`, before dilation.
    det0: T,
    /// `|Σ'|`, after dilation.
    det: T,
    /// Anti-aliasing factor on the opacity (1 when off).
    pub compensation: T,
    /// The quaternion, normalised.
    pub unit: rot::UnitQuat<T>,
    /// `R_v R`: columns are the splat's axes in camera space.
    cam_axes: [[T; 3]; 3],
    /// `F = J R_v R diag(s)`.
    factor: [[T; 3]; 2],
    /// `x/z`, `y/z` clamped to the bounds.
    pub clamped: [T; 2],
    /// 1 where the clamp changed nothing, else 0.
    pub unclamped: [T; 2],
}

/// What tiles need of one splat's [`Footprint`].
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Outline {
    /// Projected mean, pixels.
    pub center: [f64; 2],
    /// As in [`Footprint`].
    pub whitening: [f64; 3],
    /// Camera depth of the mean, world units.
    pub depth: f64,
    /// Anti-aliasing factor on the opacity.
    pub compensation: f64,
}

/// Geometry parameters of splats.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SplatGeometry<T> {
    /// World-space mean, world units.
    pub mean: [T; 3],
    /// Quaternion `(w, x, y, z)` of any length.
    pub quat: [T; 4],
    /// Standard deviations, world units.
    pub scale: [T; 3],
}

impl<S: Simd> SplatGeometry<Lanes<S>> {
    /// Of the splats in eight rows.
    #[inline(always)]
    pub(crate) fn gather(simd: S, splats: SplatsRef<'_>, rows: &[usize; LANES]) -> Self {
        let (mut mean, mut quat, mut scale) = ([[0.0; LANES]; 3], [[0.0; LANES]; 4], [[0.0; LANES]; 3]);
        for (l, &row) in rows.iter().enumerate() {
            for k in 0..3 {
                mean[k][l] = f64::from(splats.means[row][k]);
                scale[k][l] = f64::from(splats.scales[row][k]);
            }
            for (k, quat) in quat.iter_mut().enumerate() {
                quat[l] = f64::from(splats.quats[row][k]);
            }
        }
        Self { mean: Lanes::all(simd, mean), quat: Lanes::all(simd, quat), scale: Lanes::all(simd, scale) }
    }
}

/// Projects splats whose depth lies within the range. An ellipse that is not finite has no [`Footprint::valid`] lane.
#[inline(always)]
pub(crate) fn project<T: Real>(view: &View, geometry: &SplatGeometry<T>, options: &RasterOptions) -> Footprint<T> {
    let k = geometry.mean[0];
    let t = view.point(geometry.mean);
    let inv_z = k.lit(1.0) / t[2];
    let ([x, x_free], [y, y_free]) = (view.clamp(0, t[0] * inv_z), view.clamp(1, t[1] * inv_z));
    let (clamped, unclamped) = ([x, y], [x_free, y_free]);
    let unit = rot::normalise(geometry.quat);
    let [r0, r1, r2] = view.rotation;
    let cam_axes = multiply(&[lits(k, r0), lits(k, r1), lits(k, r2)], &rot::matrix(unit.wxyz));
    let mut factor = [[k; 3]; 2];
    let mut center = [k; 2];
    for r in 0..2 {
        let f = k.lit(view.focal[r]) * inv_z;
        for c in 0..3 {
            factor[r][c] = f * (cam_axes[r][c] - clamped[r] * cam_axes[2][c]) * geometry.scale[c];
        }
        center[r] = k.lit(view.focal[r]) * t[r] * inv_z + k.lit(view.center[r]);
    }
    let dilation = k.lit(options.dilation);
    let (xx0, xy, yy0) = (dot3(factor[0], factor[0]), dot3(factor[0], factor[1]), dot3(factor[1], factor[1]));
    let cross = cross3(factor[0], factor[1]);
    let det0 = dot3(cross, cross);
    let det = det0 + dilation * (xx0 + yy0) + dilation * dilation;
    let (xx, yy) = (xx0 + dilation, yy0 + dilation);
    let along = (yy / det).sqrt();
    let floor = k.lit(MIN_COMPENSATION.powi(2));
    Footprint {
        center,
        point: t,
        whitening: [along, -(xy / yy) * along, k.lit(1.0) / yy.sqrt()],
        covariance: [xx, xy, yy],
        det0,
        det,
        compensation: if options.antialias { (det0 / det).max(floor).sqrt() } else { k.lit(1.0) },
        unit,
        cam_axes,
        factor,
        clamped,
        unclamped,
    }
}

/// Three standard deviations along the larger axis of the covariance `xx, xy, yy`.
#[inline(always)]
pub(crate) fn standard_radius<T: Real>([xx, xy, yy]: [T; 3]) -> T {
    let half = xx.lit(0.5);
    let (mid, half) = (half * (xx + yy), half * (xx - yy));
    xx.lit(3.0) * (mid + (half * half + xy * xy).sqrt()).sqrt()
}

/// The constants `v` as values of the type of `k`.
#[inline(always)]
fn lits<T: Real>(k: T, [a, b, c]: [f64; 3]) -> [T; 3] {
    [k.lit(a), k.lit(b), k.lit(c)]
}

#[inline(always)]
fn multiply<T: Real>(a: &[[T; 3]; 3], b: &[[T; 3]; 3]) -> [[T; 3]; 3] {
    let mut product = *a;
    for r in 0..3 {
        for k in 0..3 {
            product[r][k] = a[r][0] * b[0][k] + a[r][1] * b[1][k] + a[r][2] * b[2][k];
        }
    }
    product
}

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

impl<S: Simd> Footprint<Lanes<S>> {
    /// Whether the ellipse in each lane is finite.
    #[inline(always)]
    pub(crate) fn valid(&self) -> [bool; LANES] {
        let mut valid = [false; LANES];
        for (valid, det) in valid.iter_mut().zip(self.det.to_array()) {
            *valid = det.is_finite() && det > 0.0;
        }
        valid
    }

    /// Lane by lane.
    #[inline(always)]
    pub(crate) fn outlines(&self) -> [Outline; LANES] {
        let ([x, y], [w0, w1, w2]) = (Lanes::arrays(self.center), Lanes::arrays(self.whitening));
        let (depth, compensation) = (self.point[2].to_array(), self.compensation.to_array());
        let mut outlines = [Outline::default(); LANES];
        for (l, outline) in outlines.iter_mut().enumerate() {
            *outline = Outline {
                center: [x[l], y[l]],
                whitening: [w0[l], w1[l], w2[l]],
                depth: depth[l],
                compensation: compensation[l],
            };
        }
        outlines
    }
}

impl<T: Real> Footprint<T> {
    /// Three standard deviations along the larger axis, pixels; see [`crate::ScreenStats::radii`].
    #[inline(always)]
    pub(crate) fn radius(&self) -> T {
        standard_radius(self.covariance)
    }

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

/// Largest colour of SH coefficients: finite, with room for sums over splats.
const MAX_COLOR: f32 = 1e37;

/// Colour of SH coefficients `row` (`[K, 3]`) seen from `position`, clamped at zero and at [`MAX_COLOR`]. Upper bands of zeros are left
/// out: a sum that begins with ½ is the same bits without them.
#[inline(always)]
#[expect(clippy::manual_clamp, reason = "a sum of opposite infinities is no number, and becomes 0")]
pub(crate) fn sh_color(mean: Vec3, position: [f64; 3], degree: u8, row: &[f32]) -> [f32; 3] {
    let (degree, row) = without_zeros(degree, row);
    let basis = if degree == 0 { sh::basis([0.0; 3], 0) } else { view_basis(mean, position, degree).0 };
    sh_color_unclamped(&basis, row).map(|v| v.max(0.0).min(MAX_COLOR))
}

/// The coefficients up to the highest band that holds more than zeros, and its degree.
#[inline(always)]
fn without_zeros(mut degree: u8, mut row: &[f32]) -> (u8, &[f32]) {
    while degree > 0 {
        let (lower, band) = row.split_at(3 * sh::coeffs(degree - 1));
        if band.iter().any(|c| *c != 0.0) {
            break;
        }
        (degree, row) = (degree - 1, lower);
    }
    (degree, row)
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

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    #[test]
    fn bands_of_zeros_change_no_bit() {
        let mut rng = Rng::new(1, "bands", 0, 0);
        for (used, degree, zero) in (0..=3).flat_map(|d| (0..=d).flat_map(move |u| [(u, d, 0.0), (u, d, -0.0f32)])) {
            for _ in 0..50 {
                let kept = 3 * sh::coeffs(used);
                let row: Vec<f32> =
                    (0..3 * sh::coeffs(degree)).map(|k| if k < kept { rng.normal() } else { zero }).collect();
                let mean = Vec3::from_array(std::array::from_fn(|_| rng.normal()));
                assert_eq!(without_zeros(degree, &row), (used, &row[..kept]));
                let all =
                    sh_color_unclamped(&view_basis(mean, [0.5; 3], degree).0, &row).map(|v| v.clamp(0.0, MAX_COLOR));
                assert_eq!(sh_color(mean, [0.5; 3], degree, &row).map(f32::to_bits), all.map(f32::to_bits));
            }
        }
        // A sum that vanishes on the way has no sign to lose.
        let row: Vec<f32> = [[-0.5 / sh::C0 as f32; 3], [-0.0; 3], [-0.0; 3], [-0.0; 3]].concat();
        let all = sh_color_unclamped(&view_basis(Vec3::ONE, [0.0; 3], 1).0, &row);
        assert_eq!(sh_color(Vec3::ONE, [0.0; 3], 1, &row).map(f32::to_bits), all.map(|v| v.max(0.0).to_bits()));
    }
}
