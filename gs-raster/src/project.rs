//! Projection of splats, eight at a time: the production form.
//!
//! Same mathematics as [`crate::reference`], in lanes of `f64` ([`crate::lanes`]), but the screen ellipse is kept as a **whitening** `W` instead of
//! a conic: `K = WᵀW`, so that the Mahalanobis distance is a sum of two squares that cannot cancel, even for needles:
//! ```text
//! (dx, dy) = pixel − u
//! b = dy / √Σ'yy           a = (dx − Σ'xy/Σ'yy · dy) · √(Σ'yy / |Σ'|)          q = a² + b²
//! ```
//! `|Σ2| = |f₀ × f₁|²` (Cauchy–Binet on the 2×3 factor `F = J R_v R diag(s)`) and `|Σ'| = |Σ2| + δ tr Σ2 + δ²` are sums
//! of non-negative terms.

mod backward;
mod color;

pub(crate) use backward::{GeometryGrad, PixelSums, backward};
pub(crate) use color::{sh_color, sh_color_backward};

use crate::lanes::{LANES, Lanes};
use crate::options::{FRUSTUM_MARGIN, MIN_COMPENSATION, RasterOptions};
use fearless_simd::Simd;
use glam::Vec3;
use gs_core::real::{Real, cross3, dot3};
use gs_core::{Camera, SplatsRef, rot};

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
}
