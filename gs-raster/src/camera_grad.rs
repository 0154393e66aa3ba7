//! Gradient of a loss with respect to the camera: the sums over splats of what projection and colour pull back.
//!
//! ```text
//! t = R m + T                     d_R += d_t mᵀ            d_T += d_t
//! A = R R_s                       d_R += d_A R_sᵀ                         axes of the splat in camera space
//! c = c(m − p),  p = −R⁻¹ T       d_R += R d_(m−p) pᵀ      d_T += R d_(m−p)
//! u = f t_x/t_z + c_x             d_f += d_u t_x/t_z       d_c += d_u
//! J = (f/t_z, −f x̃/t_z)           d_f += d_J0/t_z − x̃/t_z d_J1            where x̃ = t_x/t_z is not clamped
//!                                 d_f += d_J0/t_z          d_c += d_J1/t_z where it is: f x̃ is a constant minus c
//! ```

use crate::lanes::{LANES, Lanes};
use crate::project::{Footprint, GeometryGrad, SplatGeometry, View};
use fearless_simd::Simd;
use glam::Vec3;
use gs_core::real::dot3;
use gs_core::{Camera, rot};

/// Gradient of a loss with respect to a [`Camera`].
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct CameraGrad {
    /// `dL/d viewmat`, rows of `[R | T]`: the nine entries of the rotation as independent numbers, and the translation. The
    /// camera centre, from which spherical harmonics are seen, counts as `−R⁻¹ T`, as in gsplat and in
    /// [`mod@crate::reference`]; frames are drawn from [`Camera::position`], `−Rᵀ T`. On rotations the two are the same. Where `R` is
    /// off by as much as [`Camera::check`] accepts, 1e-3, they differ by some thousandths of `|T|`.
    pub viewmat: [[f64; 4]; 3],
    /// `dL/d fx`, per pixel.
    pub fx: f64,
    /// `dL/d fy`, per pixel.
    pub fy: f64,
    /// `dL/d cx`, per pixel.
    pub cx: f64,
    /// `dL/d cy`, per pixel.
    pub cy: f64,
}

impl CameraGrad {
    /// Gradient with respect to the motion `(turn, shift)` of [`Camera::moved`] at zero: three entries per radian, three
    /// per world unit. `camera` is the one that the gradient was taken at.
    ///
    /// ```
    /// use gs_raster::CameraGrad;
    ///
    /// // A loss that grows with T_x alone. A turn about y moves T = (0, 0, 1.5) by 1.5 units per radian along x.
    /// let camera = gs_raster::measure::camera(8);
    /// let grad = CameraGrad { viewmat: [[0.0, 0.0, 0.0, 1.0], [0.0; 4], [0.0; 4]], ..CameraGrad::default() };
    /// assert_eq!(grad.twist(&camera), [0.0, 1.5, 0.0, 1.0, 0.0, 0.0]);
    /// ```
    pub fn twist(&self, camera: &Camera) -> [f64; 6] {
        let rows = camera.rotation.transpose().to_cols_array_2d();
        let at: [[f64; 4]; 3] = [0, 1, 2].map(|r| [rows[r][0], rows[r][1], rows[r][2], camera.translation[r]]);
        // d viewmat = [turn]× viewmat: the turn meets the skew part of `d_viewmat viewmatᵀ`.
        let m = |r: usize, c: usize| (0..4).map(|k| self.viewmat[r][k] * at[c][k]).sum::<f64>();
        let [x, y, z] = self.viewmat.map(|row| row[3]);
        [m(2, 1) - m(1, 2), m(0, 2) - m(2, 0), m(1, 0) - m(0, 1), x, y, z]
    }

    /// All entries: the twelve of `viewmat` row by row, then `fx, fy, cx, cy`.
    pub fn to_array(&self) -> [f64; 16] {
        let mut all = [0.0; 16];
        all[..12].copy_from_slice(self.viewmat.as_flattened());
        all[12..].copy_from_slice(&[self.fx, self.fy, self.cx, self.cy]);
        all
    }

    /// Adds the cotangent `d` of the camera-space point `R m + T`.
    #[inline(always)]
    pub(crate) fn add_point(&mut self, d: [f64; 3], m: [f64; 3]) {
        for (row, d) in self.viewmat.iter_mut().zip(d) {
            for k in 0..3 {
                row[k] += d * m[k];
            }
            row[3] += d;
        }
    }

    /// Adds the cotangent `d` of the axes `R R_s` in camera space.
    #[inline(always)]
    pub(crate) fn add_axes(&mut self, d: &[[f64; 3]; 3], splat_rotation: &[[f64; 3]; 3]) {
        for (row, d) in self.viewmat.iter_mut().zip(d) {
            for (entry, axis) in row.iter_mut().zip(splat_rotation) {
                *entry += dot3(*d, *axis);
            }
        }
    }

    /// Adds the cotangents of focal length and principal point, per axis.
    #[inline(always)]
    pub(crate) fn add_intrinsics(&mut self, focal: [f64; 2], center: [f64; 2]) {
        self.fx += focal[0];
        self.fy += focal[1];
        self.cx += center[0];
        self.cy += center[1];
    }
}

impl std::ops::AddAssign for CameraGrad {
    fn add_assign(&mut self, other: Self) {
        for (row, other) in self.viewmat.iter_mut().zip(other.viewmat) {
            row.iter_mut().zip(other).for_each(|(to, from)| *to += from);
        }
        self.add_intrinsics([other.fx, other.fy], [other.cx, other.cy]);
    }
}

/// What a backward pass sums of the camera's gradient: a [`CameraGrad`], or nothing at no cost.
pub(crate) trait CameraSum: Default + Send {
    /// Adds what the splats of the first lanes pull back, in order, where `valid`; `d_view` has the cotangents of their
    /// means through the view direction.
    fn add_splats<S: Simd>(
        &mut self,
        view: &View,
        geometry: &SplatGeometry<Lanes<S>>,
        fp: &Footprint<Lanes<S>>,
        g: &GeometryGrad<Lanes<S>>,
        d_view: &[Vec3],
        valid: [bool; LANES],
    );
    /// Adds the sum of other splats.
    fn add(&mut self, other: Self);
}

impl CameraSum for () {
    #[inline(always)]
    fn add_splats<S: Simd>(
        &mut self,
        _: &View,
        _: &SplatGeometry<Lanes<S>>,
        _: &Footprint<Lanes<S>>,
        _: &GeometryGrad<Lanes<S>>,
        _: &[Vec3],
        _: [bool; LANES],
    ) {
    }
    #[inline(always)]
    fn add(&mut self, (): Self) {}
}

impl CameraSum for CameraGrad {
    #[inline(always)]
    fn add_splats<S: Simd>(
        &mut self,
        view: &View,
        geometry: &SplatGeometry<Lanes<S>>,
        fp: &Footprint<Lanes<S>>,
        g: &GeometryGrad<Lanes<S>>,
        d_view: &[Vec3],
        valid: [bool; LANES],
    ) {
        let d = &g.in_camera;
        for (l, d_view) in d_view.iter().enumerate().filter(|(l, _)| valid[*l]) {
            let at = |v: Lanes<S>| v.to_array()[l];
            self.add_point(d.point.map(at), geometry.mean.map(at));
            self.add_axes(&d.axes.map(|row| row.map(at)), &rot::matrix(fp.unit.wxyz.map(at)));
            let d_view = d_view.to_array().map(f64::from);
            self.add_point(view.rotation.map(|row| dot3(row, d_view)), view.position);
            let (point, mean2d) = (fp.point.map(at), g.mean2d.map(at));
            let (clamped, unclamped) = (fp.clamped.map(at), fp.unclamped.map(at));
            let inv_z = 1.0 / point[2];
            let (mut focal, mut center) = ([0.0; 2], [0.0; 2]);
            for axis in 0..2 {
                let [d_scale, d_slope] = d.jacobian[axis].map(at);
                let free = unclamped[axis];
                focal[axis] = inv_z * (point[axis] * mean2d[axis] + d_scale - free * clamped[axis] * d_slope);
                center[axis] = mean2d[axis] + (1.0 - free) * inv_z * d_slope;
            }
            self.add_intrinsics(focal, center);
        }
    }

    #[inline(always)]
    fn add(&mut self, other: Self) {
        *self += other;
    }
}
