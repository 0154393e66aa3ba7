//! Projection of one splat and its backward (reference form).

use super::blend::SplatSums;
use super::{Scalar, Scene};
use crate::camera_grad::CameraGrad;
use crate::options::{FRUSTUM_MARGIN, MIN_COMPENSATION, RasterOptions};
use gs_core::kernel::Profile;
use gs_core::{Camera, rot, sh};

/// A splat projected to the screen.
#[derive(Clone, Debug)]
pub(super) struct Projected<T> {
    /// Projected mean, pixels.
    pub mean2d: [T; 2],
    /// Dilated covariance `Σ'` as `xx, xy, yy`, pixels².
    pub cov2d: [T; 3],
    /// Inverse of `cov2d`: `xx, xy, yy`.
    pub conic: [T; 3],
    /// Camera depth of the mean, world units.
    pub depth: T,
    /// `o'`: opacity after anti-aliasing compensation.
    pub opacity: T,
    /// Colour seen from this camera.
    pub rgb: [T; 3],
    /// Kernel constants; `None` for the Gaussian.
    pub bend: Option<Profile<T>>,
}

/// Intermediates of the projection that backward needs.
struct Steps<T> {
    rotation: [[T; 3]; 3],
    camera_point: [T; 3],
    /// `x/z`, `y/z` clamped, and whether the clamp changed nothing.
    clamped: [T; 2],
    unclamped: [bool; 2],
    unit: rot::UnitQuat<T>,
    /// `F = J R_v R diag(s)`, 2×3.
    factor: [[T; 3]; 2],
    /// `R_v R`: columns are the splat's axes in camera space.
    cam_axes: [[T; 3]; 3],
    jacobian: [[T; 3]; 2],
    det0: T,
    det: T,
    compensation: T,
    projected: Projected<T>,
}

fn dot<T: Scalar>(a: [T; 3], b: [T; 3]) -> T {
    gs_core::real::dot3(a, b)
}

fn extrinsics<T: Scalar>(camera: &Camera) -> ([[T; 3]; 3], [T; 3], [T; 3]) {
    let rows = camera.rotation.transpose().to_cols_array_2d();
    // The inverse instead of the transpose, so that the entries of the rotation can be varied one by one.
    let position = -(camera.rotation.inverse() * camera.translation);
    (
        rows.map(|r| r.map(T::from_f64)),
        camera.translation.to_array().map(T::from_f64),
        position.to_array().map(T::from_f64),
    )
}

fn steps<T: Scalar>(scene: &Scene<T>, i: usize, camera: &Camera, options: &RasterOptions) -> Option<Steps<T>> {
    let (rotation, translation, _) = extrinsics::<T>(camera);
    let m = scene.means[i];
    let t: [T; 3] = std::array::from_fn(|r| dot(rotation[r], m) + translation[r]);
    if !(t[2].to_f64() > options.near && t[2].to_f64() < options.far) {
        return None;
    }
    let lit = T::from_f64;
    let (fx, fy) = (lit(camera.fx), lit(camera.fy));
    let sides = [(f64::from(camera.width), camera.fx, camera.cx), (f64::from(camera.height), camera.fy, camera.cy)];
    let mut clamped = [lit(0.0); 2];
    let mut unclamped = [true; 2];
    for (axis, (side, f, c)) in sides.into_iter().enumerate() {
        let margin = FRUSTUM_MARGIN * 0.5 * side / f;
        let (lo, hi) = (-(c / f + margin), (side - c) / f + margin);
        let ratio = t[axis] / t[2];
        unclamped[axis] = (lo..=hi).contains(&ratio.to_f64());
        clamped[axis] = ratio.max(lit(lo)).min(lit(hi));
    }
    let inv_z = lit(1.0) / t[2];
    let jacobian =
        [[fx * inv_z, lit(0.0), -(fx * clamped[0] * inv_z)], [lit(0.0), fy * inv_z, -(fy * clamped[1] * inv_z)]];
    let unit = rot::normalise(scene.quats[i]);
    let splat_rotation = rot::matrix(unit.wxyz);
    let column = |k: usize| [splat_rotation[0][k], splat_rotation[1][k], splat_rotation[2][k]];
    let cam_axes: [[T; 3]; 3] = std::array::from_fn(|r| std::array::from_fn(|k| dot(rotation[r], column(k))));
    let s = scene.scales[i];
    let factor: [[T; 3]; 2] = std::array::from_fn(|r| {
        std::array::from_fn(|k| dot(jacobian[r], [cam_axes[0][k], cam_axes[1][k], cam_axes[2][k]]) * s[k])
    });
    let dilation = lit(options.dilation);
    let (xx0, xy, yy0) = (dot(factor[0], factor[0]), dot(factor[0], factor[1]), dot(factor[1], factor[1]));
    let (xx, yy) = (xx0 + dilation, yy0 + dilation);
    // The determinant of F Fᵀ as a sum of squares (Cauchy–Binet) does not cancel for needles.
    let cross = gs_core::real::cross3(factor[0], factor[1]);
    let det0 = dot(cross, cross);
    let det = det0 + dilation * (xx0 + yy0) + dilation * dilation;
    if !(det.to_f64() > 0.0 && det.to_f64().is_finite()) {
        return None;
    }
    let floor = MIN_COMPENSATION.powi(2);
    let compensation = if options.antialias { (det0 / det).max(lit(floor)).sqrt() } else { lit(1.0) };
    let projected = Projected {
        mean2d: [fx * t[0] * inv_z + lit(camera.cx), fy * t[1] * inv_z + lit(camera.cy)],
        cov2d: [xx, xy, yy],
        conic: [yy / det, -(xy / det), xx / det],
        depth: t[2],
        opacity: scene.opacities[i] * compensation,
        rgb: [lit(0.0); 3],
        bend: scene.kernel_consts(i),
    };
    Some(Steps {
        rotation,
        camera_point: t,
        clamped,
        unclamped,
        unit,
        factor,
        cam_axes,
        jacobian,
        det0,
        det,
        compensation,
        projected,
    })
}

/// SH basis at the view direction, that direction, and the reciprocal distance.
fn view_basis<T: Scalar>(scene: &Scene<T>, i: usize, camera: &Camera, degree: u8) -> ([T; 16], [T; 3], T) {
    let (_, _, position) = extrinsics::<T>(camera);
    let (d, inv) = sh::direction(scene.means[i], position);
    (sh::basis(d, degree), d, inv)
}

/// Colour before the clamp at zero.
fn raw_color<T: Scalar>(scene: &Scene<T>, i: usize, camera: &Camera) -> [T; 3] {
    let row = &scene.color[i * scene.color_width()..][..scene.color_width()];
    match scene.degree {
        None => [row[0], row[1], row[2]],
        Some(degree) => {
            let (basis, _, _) = view_basis(scene, i, camera, degree);
            std::array::from_fn(|c| {
                (0..sh::coeffs(degree)).fold(T::from_f64(0.5), |sum, k| sum + basis[k] * row[3 * k + c])
            })
        }
    }
}

/// Projects splat `i`; `None` if it lies outside the depth range.
pub(super) fn project<T: Scalar>(
    scene: &Scene<T>,
    i: usize,
    camera: &Camera,
    options: &RasterOptions,
) -> Option<Projected<T>> {
    let mut projected = steps(scene, i, camera, options)?.projected;
    let raw = raw_color(scene, i, camera);
    projected.rgb = if scene.degree.is_some() { raw.map(|v| v.max(T::from_f64(0.0))) } else { raw };
    Some(projected)
}

/// Writes the cotangents of one splat's parameters, except the kernel's, from its sums over all pixels, and adds those of
/// the camera.
pub(super) fn backward<T: Scalar>(
    scene: &Scene<T>,
    i: usize,
    camera: &Camera,
    options: &RasterOptions,
    sums: &SplatSums<T>,
    grad: &mut Scene<T>,
    camera_grad: &mut CameraGrad,
) {
    let Some(st) = steps(scene, i, camera, options) else { return };
    let lit = T::from_f64;
    let two = lit(2.0);
    grad.opacities[i] = sums.opacity * st.compensation;

    let d_view = color_backward(scene, i, camera, sums.rgb, grad);
    let d_cov = covariance2d_backward(scene.opacities[i], options, &st, sums);

    // Σ2 = F Fᵀ  →  d_F = 2 d_Σ F (d_Σ symmetric, off-diagonal halves).
    let half = lit(0.5);
    let full = [[d_cov[0], d_cov[1] * half], [d_cov[1] * half, d_cov[2]]];
    let d_factor: [[T; 3]; 2] = std::array::from_fn(|r| {
        std::array::from_fn(|k| two * (full[r][0] * st.factor[0][k] + full[r][1] * st.factor[1][k]))
    });
    let s = scene.scales[i];
    // F = J W S with W = R_v R.
    let jw = |r: usize, k: usize| dot(st.jacobian[r], [st.cam_axes[0][k], st.cam_axes[1][k], st.cam_axes[2][k]]);
    grad.scales[i] = std::array::from_fn(|k| d_factor[0][k] * jw(0, k) + d_factor[1][k] * jw(1, k));
    let d_jw: [[T; 3]; 2] = std::array::from_fn(|r| std::array::from_fn(|k| d_factor[r][k] * s[k]));
    let d_jacobian: [[T; 3]; 2] = std::array::from_fn(|r| std::array::from_fn(|c| dot(d_jw[r], st.cam_axes[c])));
    let d_turned: [[T; 3]; 3] = std::array::from_fn(|c| {
        std::array::from_fn(|k| st.jacobian[0][c] * d_jw[0][k] + st.jacobian[1][c] * d_jw[1][k])
    });
    let d_rotation: [[T; 3]; 3] = std::array::from_fn(|r| {
        std::array::from_fn(|k| (0..3).fold(lit(0.0), |sum, c| sum + st.rotation[c][r] * d_turned[c][k]))
    });

    grad.quats[i] = rot::normalise_backward(&st.unit, rot::matrix_backward(st.unit.wxyz, &d_rotation));

    let d_point = point_backward(camera, &st, &d_jacobian, sums);
    grad.means[i] = std::array::from_fn(|k| (0..3).fold(d_view[k], |sum, r| sum + st.rotation[r][k] * d_point[r]));

    let wide = |v: [T; 3]| v.map(T::to_f64);
    camera_grad.add_point(wide(d_point), wide(scene.means[i]));
    camera_grad.add_axes(&d_turned.map(wide), &rot::matrix(st.unit.wxyz).map(wide));
    let (_, _, position) = extrinsics::<T>(camera);
    camera_grad.add_point(wide(st.rotation.map(|row| dot(row, d_view))), wide(position));
    intrinsics_backward(&st, &d_jacobian, sums, camera_grad);
}

/// Adds the cotangents of focal lengths and principal point, from the screen centre and the Jacobian. Where the clamp acts,
/// `J_a2 = (c − const)/z`.
fn intrinsics_backward<T: Scalar>(st: &Steps<T>, d_j: &[[T; 3]; 2], sums: &SplatSums<T>, camera_grad: &mut CameraGrad) {
    let [x, y, z] = st.camera_point;
    let (mut focal, mut center) = ([0.0; 2], [0.0; 2]);
    for (axis, t) in [x, y].into_iter().enumerate() {
        let (d_u, d_aa, d_a2) = (sums.mean2d[axis], d_j[axis][axis], d_j[axis][2]);
        let (mut d_f, mut d_c) = (d_u * t / z + d_aa / z, d_u);
        if st.unclamped[axis] {
            d_f = d_f - d_a2 * t / (z * z);
        } else {
            d_c = d_c + d_a2 / z;
        }
        (focal[axis], center[axis]) = (d_f.to_f64(), d_c.to_f64());
    }
    camera_grad.add_intrinsics(focal, center);
}

/// `dL/dΣ2` as `xx, xy, yy` (the `xy` entry stands for both off-diagonals), from the conic and the compensation.
fn covariance2d_backward<T: Scalar>(opacity: T, options: &RasterOptions, st: &Steps<T>, sums: &SplatSums<T>) -> [T; 3] {
    let [a, b, c] = st.projected.conic;
    let [ga, gb, gc] = sums.conic;
    let (two, half) = (T::from_f64(2.0), T::from_f64(0.5));
    // dL/dΣ' = −K G K with G the symmetric cotangent [[ga, gb/2], [gb/2, gc]].
    let (m00, m01) = (ga * a + half * gb * b, ga * b + half * gb * c);
    let (m10, m11) = (half * gb * a + gc * b, half * gb * b + gc * c);
    let mut out = [-(a * m00 + b * m10), -(two * (a * m01 + b * m11)), -(b * m01 + c * m11)];
    let ratio = st.det0 / st.det;
    if options.antialias && ratio.to_f64() > MIN_COMPENSATION.powi(2) {
        // comp² = det0/det: d ln comp = ½ (d det0/det0 − d det/det); det0·Σ2⁻¹ is the adjugate, free of division.
        let d_comp = opacity * sums.opacity;
        let scale = d_comp * half / (st.compensation * st.det);
        let dilation = T::from_f64(options.dilation);
        let [xx, xy, yy] = st.projected.cov2d;
        out[0] = out[0] + scale * ((yy - dilation) - ratio * yy);
        out[1] = out[1] - scale * two * (xy - ratio * xy);
        out[2] = out[2] + scale * ((xx - dilation) - ratio * xx);
    }
    out
}

/// Cotangent of the camera-space point, from the screen centre, the Jacobian and the depth.
fn point_backward<T: Scalar>(camera: &Camera, st: &Steps<T>, d_j: &[[T; 3]; 2], sums: &SplatSums<T>) -> [T; 3] {
    let t = st.camera_point;
    let inv_z = T::from_f64(1.0) / t[2];
    let mut d = [T::from_f64(0.0), T::from_f64(0.0), sums.depth];
    for (axis, f) in [camera.fx, camera.fy].into_iter().enumerate() {
        let f = T::from_f64(f);
        let d_u = sums.mean2d[axis];
        d[axis] = d[axis] + f * inv_z * d_u;
        d[2] = d[2] - f * t[axis] * inv_z * inv_z * d_u;
        // J_aa = f/z and J_a2 = −f·clamp(t_a/z)/z.
        d[2] = d[2] - f * inv_z * inv_z * d_j[axis][axis];
        let d_a2 = d_j[axis][2];
        d[2] = d[2] + f * st.clamped[axis] * inv_z * inv_z * d_a2;
        if st.unclamped[axis] {
            d[axis] = d[axis] - f * inv_z * inv_z * d_a2;
            d[2] = d[2] + f * t[axis] * inv_z * inv_z * inv_z * d_a2;
        }
    }
    d
}

/// Writes the cotangents of the colour row; returns that of the mean through the view direction.
fn color_backward<T: Scalar>(
    scene: &Scene<T>,
    i: usize,
    camera: &Camera,
    d_rgb: [T; 3],
    grad: &mut Scene<T>,
) -> [T; 3] {
    let width = scene.color_width();
    let zero = T::from_f64(0.0);
    let Some(degree) = scene.degree else {
        grad.color[i * 3..][..3].copy_from_slice(&d_rgb);
        return [zero; 3];
    };
    let raw = raw_color(scene, i, camera);
    let d_raw: [T; 3] = std::array::from_fn(|c| if raw[c] > zero { d_rgb[c] } else { zero });
    let (basis, dir, inv) = view_basis(scene, i, camera, degree);
    let mut d_basis = [zero; 16];
    for k in 0..sh::coeffs(degree) {
        let row = i * width + 3 * k;
        for (c, &d) in d_raw.iter().enumerate() {
            grad.color[row + c] = basis[k] * d;
            d_basis[k] = d_basis[k] + scene.color[row + c] * d;
        }
    }
    sh::direction_backward(dir, inv, sh::basis_backward(dir, degree, &d_basis))
}
