//! The axis-aligned box that a field covers.

use crate::DeformError;
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// An axis-aligned box in world units. A HexPlane spans it with its whole resolution; points outside are clamped to the
/// nearest face.
///
/// ```
/// use glam::Vec3;
/// use gs_deform::Aabb;
///
/// let b = Aabb::around(&[Vec3::ZERO, Vec3::new(2.0, 4.0, 0.0)], 0.5)?;
/// assert_eq!((b.min, b.max), (Vec3::new(-1.0, -2.0, 0.0), Vec3::new(3.0, 6.0, 0.0)));
/// assert!(Aabb::around(&[], 0.5).is_err(), "no points, no box");
/// # Ok::<(), gs_deform::DeformError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Aabb {
    /// Lowest corner of the box, world units.
    pub min: Vec3,
    /// Highest corner, world units; equal to `min` along an axis without extent (coordinates there have no gradient).
    pub max: Vec3,
}

impl Aabb {
    /// The box from `min` to `max`, world units.
    ///
    /// # Errors
    /// If a corner is not finite or `max < min` along an axis.
    pub fn new(min: Vec3, max: Vec3) -> Result<Self, DeformError> {
        if min.is_finite() && max.is_finite() && min.cmple(max).all() {
            Ok(Self { min, max })
        } else {
            Err(DeformError::Aabb { min, max })
        }
    }

    /// The cube of ±`half` around the origin (4DGaussians starts from ±1.6). The sign of `half` does not matter.
    pub fn cube(half: f32) -> Self {
        Self { min: Vec3::splat(-half.abs()), max: Vec3::splat(half.abs()) }
    }

    /// The bounding box of `points`, widened on every side by `margin` times its extent along that axis.
    ///
    /// # Errors
    /// If there is no point or one is not finite.
    pub fn around(points: &[Vec3], margin: f32) -> Result<Self, DeformError> {
        let min = points.iter().copied().fold(Vec3::INFINITY, Vec3::min);
        let max = points.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
        let widen = (max - min) * margin;
        if points.iter().all(|p| p.is_finite()) {
            Self::new(min - widen, max + widen)
        } else {
            Err(DeformError::Aabb { min, max })
        }
    }

    /// `1 / size` per axis; 0 along an axis without extent.
    pub fn inverse_size(&self) -> Vec3 {
        Vec3::from_array((self.max - self.min).to_array().map(|v| if v > 0.0 { v.recip() } else { 0.0 }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_are_ordered_and_finite() {
        let b = Aabb::around(&[Vec3::new(0.0, 1.0, 2.0), Vec3::new(2.0, -1.0, 2.0)], 0.5).unwrap();
        assert_eq!((b.min, b.max), (Vec3::new(-1.0, -2.0, 2.0), Vec3::new(3.0, 2.0, 2.0)));
        assert_eq!(b.inverse_size(), Vec3::new(0.25, 0.25, 0.0));
        assert!(Aabb::around(&[], 0.1).is_err(), "no points, no box");
        assert!(Aabb::around(&[Vec3::NAN], 0.1).is_err());
        assert!(Aabb::around(&[Vec3::ZERO, Vec3::new(0.0, f32::NAN, 0.0)], 0.1).is_err());
        assert!(Aabb::new(Vec3::ONE, Vec3::ZERO).is_err());
    }
}
