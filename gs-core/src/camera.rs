//! Pinhole cameras with OpenCV axes: +x right, +y down, +z forward.
//!
//! A world point `m` becomes `t = R m + T` in camera space and lands on pixel coordinates
//! `u = fx·t_x/t_z + cx`, `v = fy·t_y/t_z + cy`. Pixel `(i, j)` covers `[i, i+1) × [j, j+1)`; its centre is at `+½`.
//! Kept in `f64`: a camera is one row, and every splat depends on its precision.
//!
//! ```
//! use glam::{DVec2, DVec3};
//! use gs_core::Camera;
//!
//! let camera = Camera::look_at(64, 48, 0.7, DVec3::new(0.0, 0.0, -2.0), DVec3::ZERO, DVec3::NEG_Y)?;
//! let target = camera.to_camera(DVec3::ZERO);
//! assert_eq!(target, DVec3::new(0.0, 0.0, 2.0)); // two units in front of the camera
//! assert_eq!(camera.to_pixel(target), DVec2::new(32.0, 24.0)); // the middle of the image
//! # Ok::<(), gs_core::camera::CameraError>(())
//! ```

use glam::{DMat3, DMat4, DQuat, DVec2, DVec3};

/// A pinhole camera without distortion: image size, intrinsics in pixels, and the world→camera transform.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Width of the image, 1 to [`MAX_SIDE`] pixels.
    pub width: u32,
    /// Height of the image, 1 to [`MAX_SIDE`] pixels.
    pub height: u32,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point x, pixels (`width / 2` when centred).
    pub cx: f64,
    /// Principal point y, pixels (`height / 2` when centred).
    pub cy: f64,
    /// Rotation of the world→camera transform (`viewmat`).
    pub rotation: DMat3,
    /// Translation of the world→camera transform, world units.
    pub translation: DVec3,
}

/// An invalid camera: the field and its value.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// A field that is not finite or outside its domain.
    #[error("camera {field} = {value} is out of range: {rule}")]
    Range {
        /// Name of the field of [`Camera`].
        field: &'static str,
        /// Value that the field has.
        value: f64,
        /// The domain of the field, in words.
        rule: &'static str,
    },
    /// The 3×3 block is not a rotation.
    #[error(
        "camera rotation is not orthonormal with determinant 1 (worst deviation {deviation:.3e}, limit {limit:.0e})"
    )]
    NotRotation {
        /// Largest entry of `|RRᵀ − I|`, or `|det − 1|` if that is larger.
        deviation: f64,
        /// Largest deviation that is accepted, 1e-3.
        limit: f64,
    },
}

/// Rotations may deviate this much from orthonormal (files print few digits).
const ROTATION_TOLERANCE: f64 = 1e-3;
/// Smallest focal length, as a share of the longer side: a field of view of 179.98°.
pub const MIN_FOCAL: f64 = 1e-4;

/// Largest image side accepted, pixels.
pub const MAX_SIDE: u32 = 1 << 15;

impl Camera {
    /// A camera from its `viewmat` (world→camera, acting on column vectors); `focal` and `principal` in pixels.
    ///
    /// # Errors
    /// As [`Camera::check`].
    pub fn from_viewmat(
        width: u32,
        height: u32,
        focal: DVec2,
        principal: DVec2,
        viewmat: DMat4,
    ) -> Result<Self, CameraError> {
        let camera = Self {
            width,
            height,
            fx: focal.x,
            fy: focal.y,
            cx: principal.x,
            cy: principal.y,
            rotation: DMat3::from_mat4(viewmat),
            translation: viewmat.w_axis.truncate(),
        };
        camera.check()?;
        Ok(camera)
    }

    /// A camera at `eye` that looks at `target`; `up` is the world direction that points up in the image.
    /// Centred principal point, square pixels, horizontal field of view `fov_x` in radians.
    ///
    /// # Errors
    /// As [`Camera::check`]; also when `eye`, `target` and `up` do not span a frame.
    pub fn look_at(
        width: u32,
        height: u32,
        fov_x: f64,
        eye: DVec3,
        target: DVec3,
        up: DVec3,
    ) -> Result<Self, CameraError> {
        let forward = (target - eye).normalize_or_zero();
        let right = forward.cross(up).normalize_or_zero();
        let down = forward.cross(right);
        let rotation = DMat3::from_cols(right, down, forward).transpose();
        let f = 0.5 * f64::from(width) / (0.5 * fov_x).tan();
        let camera = Self {
            width,
            height,
            fx: f,
            fy: f,
            cx: 0.5 * f64::from(width),
            cy: 0.5 * f64::from(height),
            rotation,
            translation: -(rotation * eye),
        };
        camera.check()?;
        Ok(camera)
    }

    /// The world→camera transform as a 4×4 matrix.
    pub fn viewmat(&self) -> DMat4 {
        let r = self.rotation;
        DMat4::from_cols(r.x_axis.extend(0.0), r.y_axis.extend(0.0), r.z_axis.extend(0.0), self.translation.extend(1.0))
    }

    /// Camera centre in world space, `−Rᵀ T`.
    pub fn position(&self) -> DVec3 {
        -(self.rotation.transpose() * self.translation)
    }

    /// The view direction (+z) in world space.
    pub fn forward(&self) -> DVec3 {
        self.rotation.transpose() * DVec3::Z
    }

    /// A world point in camera space.
    #[inline]
    pub fn to_camera(&self, world: DVec3) -> DVec3 {
        self.rotation * world + self.translation
    }

    /// Pixel coordinates of a camera-space point. Not finite at `z = 0`.
    #[inline]
    pub fn to_pixel(&self, camera_point: DVec3) -> DVec2 {
        DVec2::new(
            self.fx * camera_point.x / camera_point.z + self.cx,
            self.fy * camera_point.y / camera_point.z + self.cy,
        )
    }

    /// World-space direction (unit) through pixel coordinates `(u, v)`.
    pub fn ray(&self, u: f64, v: f64) -> DVec3 {
        let d = DVec3::new((u - self.cx) / self.fx, (v - self.cy) / self.fy, 1.0);
        (self.rotation.transpose() * d).normalize_or_zero()
    }

    /// The camera turned and shifted in its own axes, a perturbation on the left of the world→camera transform:
    /// `R' = E R` and `T' = E T + shift` with `E = exp([turn]×)`. `turn` is a rotation vector (axis times angle, radians),
    /// `shift` in world units. A turn alone leaves [`Camera::position`] where it is.
    ///
    /// ```
    /// use glam::DVec3;
    /// use gs_core::Camera;
    ///
    /// let camera = Camera::look_at(64, 48, 0.7, DVec3::new(0.0, 0.0, -2.0), DVec3::ZERO, DVec3::NEG_Y)?;
    /// // Moved by +x in its own axes, the world comes to lie one unit further right; the camera itself goes left.
    /// let moved = camera.moved(DVec3::ZERO, DVec3::X);
    /// assert_eq!(moved.to_camera(DVec3::ZERO), DVec3::new(1.0, 0.0, 2.0));
    /// let turned = camera.moved(DVec3::Y * 0.1, DVec3::ZERO);
    /// assert!((turned.position() - camera.position()).length() < 1e-12);
    /// # Ok::<(), gs_core::camera::CameraError>(())
    /// ```
    pub fn moved(&self, turn: DVec3, shift: DVec3) -> Self {
        let turn = DMat3::from_quat(DQuat::from_scaled_axis(turn));
        Self { rotation: turn * self.rotation, translation: turn * self.translation + shift, ..self.clone() }
    }

    /// The same camera for an image resized by `factor` on both sides (rounded to whole pixels).
    pub fn scaled(&self, factor: f64) -> Self {
        let width = ((f64::from(self.width) * factor).round() as u32).max(1);
        let height = ((f64::from(self.height) * factor).round() as u32).max(1);
        let (sx, sy) = (f64::from(width) / f64::from(self.width), f64::from(height) / f64::from(self.height));
        Self { width, height, fx: self.fx * sx, fy: self.fy * sy, cx: self.cx * sx, cy: self.cy * sy, ..self.clone() }
    }

    /// Verifies every field: sides 1 to [`MAX_SIDE`], focal lengths of at least [`MIN_FOCAL`] of the longer side, a rotation
    /// that is orthonormal to 1e-3.
    ///
    /// # Errors
    /// Names the first field that is not finite or out of its domain.
    pub fn check(&self) -> Result<(), CameraError> {
        let range = |field, value: f64, good: bool, rule| {
            if value.is_finite() && good { Ok(()) } else { Err(CameraError::Range { field, value, rule }) }
        };
        for (field, v) in [("width", self.width), ("height", self.height)] {
            range(field, f64::from(v), (1..=MAX_SIDE).contains(&v), "1 to 32768 pixels")?;
        }
        let side = f64::from(self.width.max(self.height));
        for (field, v) in [("fx", self.fx), ("fy", self.fy)] {
            let good = v >= MIN_FOCAL * side && v < 1e9;
            range(field, v, good, "at least a ten-thousandth of the longer side, and below 1e9 pixels")?;
        }
        for (field, v) in [("cx", self.cx), ("cy", self.cy)] {
            range(field, v, v.abs() < 1e9, "finite, magnitude below 1e9 pixels")?;
        }
        for v in self.translation.to_array() {
            range("translation", v, v.abs() < 1e12, "finite, magnitude below 1e12")?;
        }
        let gram = self.rotation * self.rotation.transpose() - DMat3::IDENTITY;
        let off =
            gram.to_cols_array().iter().fold(0.0f64, |m, v| if v.is_finite() { m.max(v.abs()) } else { f64::INFINITY });
        let deviation = off.max((self.rotation.determinant() - 1.0).abs());
        if deviation.is_nan() || deviation > ROTATION_TOLERANCE {
            return Err(CameraError::NotRotation { deviation, limit: ROTATION_TOLERANCE });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera::look_at(64, 48, 0.7, DVec3::new(1.0, -2.0, 0.5), DVec3::ZERO, DVec3::Z).unwrap()
    }

    #[test]
    fn look_at_sees_its_target_in_the_middle_and_up_is_up() {
        let c = camera();
        let mid = c.to_pixel(c.to_camera(DVec3::ZERO));
        assert!((mid - DVec2::new(32.0, 24.0)).length() < 1e-9);
        let above = c.to_pixel(c.to_camera(DVec3::Z * 0.1));
        assert!(above.y < mid.y, "a point above lies higher in the image (smaller row)");
        assert!((c.position() - DVec3::new(1.0, -2.0, 0.5)).length() < 1e-12);
    }

    #[test]
    fn viewmat_and_rays_agree_with_projection() {
        let c = camera();
        let again = Camera::from_viewmat(64, 48, DVec2::new(c.fx, c.fy), DVec2::new(c.cx, c.cy), c.viewmat()).unwrap();
        assert_eq!(again, c);
        let p = c.position() + c.ray(10.25, 40.5) * 3.0;
        assert!((c.to_pixel(c.to_camera(p)) - DVec2::new(10.25, 40.5)).length() < 1e-9);
    }

    #[test]
    fn bad_fields_are_named() {
        let wrong = |f: &dyn Fn(&mut Camera)| {
            let mut c = camera();
            f(&mut c);
            c.check().unwrap_err().to_string()
        };
        assert!(wrong(&|c| c.fx = f64::NAN).contains("fx"));
        assert!(wrong(&|c| c.width = 0).contains("width"));
        assert!(wrong(&|c| c.cy = f64::INFINITY).contains("cy"));
        assert!(wrong(&|c| c.translation.x = f64::NAN).contains("translation"));
        assert!(wrong(&|c| c.rotation = DMat3::ZERO).contains("rotation"));
        assert!(wrong(&|c| c.rotation.x_axis.x = f64::NAN).contains("rotation"));
    }
}
