//! Poses of files to world-to-camera rotations and translations with OpenCV axes.
//!
//! OpenGL and Blender cameras have +x right, +y up and −z forward; OpenCV cameras have +y down and +z forward. With
//! `F = diag(1, −1, −1)` the camera-to-world rotation becomes `R_c2w F`, the centre stays, and the inverse is
//! `R = F R_c2wᵀ`, `T = −R c`.

use glam::{DMat3, DQuat, DVec3};

use super::error::{DataError, Place};

/// Rotations may deviate this much from orthonormal and are then replaced by the nearest rotation.
pub(crate) const TOLERANCE: f64 = 1e-2;

/// World-to-camera transform, OpenCV axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pose {
    pub(crate) rotation: DMat3,
    pub(crate) translation: DVec3,
}

/// The pose of an OpenGL camera-to-world matrix (three rows of four).
///
/// # Errors
/// `data.pose` if its rotation is scaled, mirrored or sheared.
pub(crate) fn from_opengl(rows: &[[f64; 4]; 3], place: &Place) -> Result<Pose, DataError> {
    let c2w = DMat3::from_cols_array_2d(&[0, 1, 2].map(|j| [0, 1, 2].map(|i| rows[i][j])));
    let centre = DVec3::new(rows[0][3], rows[1][3], rows[2][3]);
    let flip = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let rotation = flip * nearest_rotation(c2w, place)?.transpose();
    Ok(Pose { rotation, translation: -(rotation * centre) })
}

/// The pose of a camera whose axes right, down and forward are the columns of `axes`, in the world, and whose centre is
/// `centre`.
///
/// # Errors
/// `data.pose` if the axes are scaled, mirrored or sheared.
pub(crate) fn from_axes(axes: DMat3, centre: DVec3, place: &Place) -> Result<Pose, DataError> {
    let rotation = nearest_rotation(axes, place)?.transpose();
    Ok(Pose { rotation, translation: -(rotation * centre) })
}

/// The pose of a world-to-camera matrix with OpenCV axes (three rows of four).
///
/// # Errors
/// `data.pose` if its rotation is scaled, mirrored or sheared.
pub(crate) fn from_world_to_camera(rows: &[[f64; 4]; 3], place: &Place) -> Result<Pose, DataError> {
    let rotation = DMat3::from_cols_array_2d(&[0, 1, 2].map(|j| [0, 1, 2].map(|i| rows[i][j])));
    let translation = DVec3::new(rows[0][3], rows[1][3], rows[2][3]);
    Ok(Pose { rotation: nearest_rotation(rotation, place)?, translation })
}

/// The pose of a world-to-camera quaternion `(w, x, y, z)` and translation, as COLMAP writes them.
///
/// # Errors
/// `data.pose` if the quaternion has not length 1 within the tolerance.
pub(crate) fn from_quaternion(q: [f64; 4], translation: DVec3, place: &Place) -> Result<Pose, DataError> {
    let quat = DQuat::from_xyzw(q[1], q[2], q[3], q[0]);
    let length = quat.length();
    if (length - 1.0).abs() > TOLERANCE || !length.is_finite() {
        return Err(DataError::Pose { place: place.clone(), what: format!("the quaternion has length {length:.4}") });
    }
    Ok(Pose { rotation: DMat3::from_quat(quat.normalize()), translation })
}

/// The nearest rotation, by Newton's iteration for the polar factor `X ← (X + X⁻ᵀ)/2` (Higham 1986).
fn nearest_rotation(m: DMat3, place: &Place) -> Result<DMat3, DataError> {
    let wrong = |what: String| Err(DataError::Pose { place: place.clone(), what });
    let lengths = [m.x_axis, m.y_axis, m.z_axis].map(DVec3::length);
    if lengths.iter().any(|l| (l - 1.0).abs() > TOLERANCE) {
        let [a, b, c] = lengths;
        return wrong(format!("its columns have lengths {a:.4}, {b:.4}, {c:.4} instead of 1"));
    }
    let det = m.determinant();
    if det < 0.0 {
        return wrong(format!("it is mirrored (determinant {det:.4})"));
    }
    let skew = [m.x_axis.dot(m.y_axis), m.y_axis.dot(m.z_axis), m.z_axis.dot(m.x_axis)];
    if let Some(dot) = skew.into_iter().find(|d| d.abs() > TOLERANCE) {
        return wrong(format!("two of its columns have dot product {dot:.4} instead of 0"));
    }
    let mut x = m;
    for _ in 0..6 {
        x = (x + x.inverse().transpose()) * 0.5;
    }
    Ok(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn rows(m: DMat3, c: DVec3) -> [[f64; 4]; 3] {
        [0, 1, 2].map(|i| [m.x_axis[i], m.y_axis[i], m.z_axis[i], c[i]])
    }

    fn place() -> Place {
        Place::new(Path::new("t.json"), "frames[0].transform_matrix")
    }

    #[test]
    fn blender_cameras_look_along_their_minus_z() {
        // A Blender camera at (0, -4, 0) that looks along +y, world z up: columns right, up, backwards.
        let c2w = DMat3::from_cols(DVec3::X, DVec3::Z, -DVec3::Y);
        let p = from_opengl(&rows(c2w, DVec3::new(0.0, -4.0, 0.0)), &place()).unwrap();
        let seen = |w: DVec3| p.rotation * w + p.translation;
        assert!((seen(DVec3::ZERO) - DVec3::new(0.0, 0.0, 4.0)).length() < 1e-12, "the origin is 4 in front");
        assert!(seen(DVec3::Z).y < 0.0, "above is smaller y");
        assert!(seen(DVec3::X).x > 0.0, "right is larger x");
    }

    #[test]
    fn small_errors_are_repaired_and_large_ones_named() {
        let r = DMat3::from_quat(DQuat::from_xyzw(0.1, -0.5, 0.3, 0.8).normalize());
        let noisy = r + DMat3::from_cols(DVec3::splat(1e-3), DVec3::new(-1e-3, 0.0, 2e-3), DVec3::X * 1e-3);
        let p = from_opengl(&rows(noisy, DVec3::ONE), &place()).unwrap();
        let gram = p.rotation * p.rotation.transpose() - DMat3::IDENTITY;
        assert!(gram.to_cols_array().iter().all(|v| v.abs() < 1e-12));
        let fault = |m: DMat3| from_opengl(&rows(m, DVec3::ONE), &place()).unwrap_err().to_string();
        assert!(fault(r * 2.0).contains("lengths 2.0000"));
        assert!(fault(r * DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0))).contains("mirrored"));
        let sheared = DMat3::from_cols(DVec3::X, DVec3::new(0.6, 0.8, 0.0), DVec3::Z);
        assert!(fault(sheared).contains("dot product 0.6000"));
        let q = from_quaternion([0.5, 0.0, 0.0, 0.0], DVec3::ZERO, &place()).unwrap_err();
        assert_eq!(q.code(), "data.pose");
    }
}
