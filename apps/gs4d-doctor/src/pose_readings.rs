//! Common mistakes in pose files: each [`PoseReading`] reads the same numbers by another convention.

use glam::{DMat3, DMat4, DVec3};
use gs_core::Camera;

/// A convention for poses other than the one they were read by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PoseReading {
    /// Camera axes y and z are negated: OpenCV for OpenGL, or the reverse.
    Flipped,
    /// The matrix is inverted; the flags say whether y and z are negated on its left and on its right.
    Inverted([bool; 2]),
    /// The rotation is transposed; the camera centre is right.
    Transposed,
}

impl PoseReading {
    /// Every reading that is tried.
    pub(super) const ALL: [Self; 6] = [
        Self::Flipped,
        Self::Inverted([false, false]),
        Self::Inverted([false, true]),
        Self::Inverted([true, false]),
        Self::Inverted([true, true]),
        Self::Transposed,
    ];

    /// The camera under this reading.
    pub(super) fn camera(self, c: &Camera) -> Camera {
        let flip = DMat4::from_mat3(FLIP);
        let maybe = |yes: bool| if yes { flip } else { DMat4::IDENTITY };
        let viewmat = match self {
            Self::Flipped => flip * c.viewmat(),
            Self::Inverted([before, behind]) => maybe(before) * c.viewmat().inverse() * maybe(behind),
            Self::Transposed => {
                let rotation = FLIP * c.rotation.transpose() * FLIP;
                return Camera { rotation, translation: -(rotation * c.position()), ..c.clone() };
            }
        };
        let rotation = DMat3::from_mat4(viewmat);
        Camera { rotation, translation: viewmat.w_axis.truncate(), ..c.clone() }
    }

    /// Describes the poses, after "with poses".
    pub(super) fn what(self) -> &'static str {
        match self {
            Self::Flipped => {
                "camera axes of the other convention (y and z point the other way: OpenCV where OpenGL is read, or the reverse)"
            }
            Self::Inverted(_) => "inverted (world-to-camera where camera-to-world is read, or the reverse)",
            Self::Transposed => "with transposed rotations",
        }
    }

    /// How to correct the file.
    pub(super) fn fix(self) -> &'static str {
        match self {
            Self::Flipped => {
                "negate the second and third column of every camera-to-world rotation (y and z axes) and write the file again"
            }
            Self::Inverted(_) => {
                "write the inverse of every matrix; then run gs4d doctor again, the axes may be those of another convention, too"
            }
            Self::Transposed => "transpose the 3x3 rotation of every matrix; keep the last column",
        }
    }
}

/// Converts between OpenGL and OpenCV camera axes.
const FLIP: DMat3 = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_mistake_has_a_reading_that_undoes_it() {
        let c = Camera::look_at(64, 48, 0.9, DVec3::new(1.0, -4.0, 2.0), DVec3::new(0.1, 0.3, 0.0), DVec3::Z).unwrap();
        for wrong in PoseReading::ALL {
            let mistaken = wrong.camera(&c);
            let undone = |s: &PoseReading| {
                let back = s.camera(&mistaken);
                (back.viewmat() - c.viewmat()).to_cols_array().iter().all(|v| v.abs() < 1e-12)
            };
            assert!(PoseReading::ALL.iter().any(undone), "{wrong:?}");
            assert!((mistaken.viewmat() - c.viewmat()).to_cols_array().iter().any(|v| v.abs() > 0.1), "{wrong:?}");
        }
    }
}
