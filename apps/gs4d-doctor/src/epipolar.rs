//! The epipolar error of a match under two cameras.
//!
//! With `E = [t]× R` from one camera to the other and `F = K₂⁻ᵀ E K₁⁻¹`, the error is Sampson's,
//! `(x₂ᵀ F x₁)² / (|F x₁|² + |Fᵀ x₂|²)` with the first two entries of the lines (Hartley and Zisserman, 11.4.3).

use glam::{DMat3, DVec2, DVec3};
use gs_core::Camera;

/// Least sine of the angle between two rays for a test of the side on which they meet.
const MIN_PARALLAX: f64 = 0.005;

/// The epipolar geometry of two cameras.
pub(super) struct Pair {
    fundamental: DMat3,
    rays: [DMat3; 2],
    turn: DMat3,
    shift: DVec3,
}

impl Pair {
    pub(super) fn new(a: &Camera, b: &Camera) -> Self {
        let turn = b.rotation * a.rotation.transpose();
        let t = b.translation - turn * a.translation;
        let cross =
            DMat3::from_cols(DVec3::new(0.0, t.z, -t.y), DVec3::new(-t.z, 0.0, t.x), DVec3::new(t.y, -t.x, 0.0));
        let ray = |c: &Camera| {
            DMat3::from_cols(DVec3::X / c.fx, DVec3::Y / c.fy, DVec3::new(-c.cx / c.fx, -c.cy / c.fy, 1.0))
        };
        let rays = [ray(a), ray(b)];
        Self { fundamental: rays[1].transpose() * cross * turn * rays[0], rays, turn, shift: t }
    }

    /// Sampson distance, pixels; infinite if the point is behind a camera.
    pub(super) fn error(&self, [a, b]: [DVec2; 2]) -> f64 {
        if self.behind(a.extend(1.0), b.extend(1.0)) { f64::INFINITY } else { self.signed([a, b]).abs() }
    }

    /// Sampson distance with its sign, pixels, wherever the point is; infinite if the cameras stand in one place.
    pub(super) fn signed(&self, [a, b]: [DVec2; 2]) -> f64 {
        let (x, y) = (a.extend(1.0), b.extend(1.0));
        let (forth, back) = (self.fundamental * x, self.fundamental.transpose() * y);
        let lines = forth.truncate().length_squared() + back.truncate().length_squared();
        if lines < 1e-24 { f64::INFINITY } else { y.dot(forth) / lines.sqrt() }
    }

    /// Whether the rays of two pixels meet behind a camera, as far as they meet at all: `z₂ r₂ = z₁ R r₁ + t`.
    fn behind(&self, x: DVec3, y: DVec3) -> bool {
        let (p, q) = (self.turn * (self.rays[0] * x), self.rays[1] * y);
        let across = p.cross(q);
        if across.length() < MIN_PARALLAX * p.length() * q.length() {
            return false;
        }
        let depth = |other: DVec3| self.shift.cross(other).dot(across) / across.length_squared();
        // From z₁ p + t = z₂ q, crossed with q and with p.
        -depth(q) < 0.0 || -depth(p) < 0.0
    }
}
