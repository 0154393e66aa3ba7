//! The box around the view frusta of cameras between two depths.

use glam::{DVec3, Vec3};
use gs_core::Camera;

/// Lower and upper corner around the corners of every camera's frustum from `near` to `far` (camera-space z). None without
/// cameras, or unless `0 ≤ near < far` for all of them and the box is finite.
pub(crate) fn bounds<'a>(cameras: impl Iterator<Item = (&'a Camera, [f64; 2])>) -> Option<[Vec3; 2]> {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for (c, [near, far]) in cameras {
        if !(near >= 0.0 && near < far) {
            return None;
        }
        let (w, h) = (f64::from(c.width), f64::from(c.height));
        for (u, v) in [(0.0, 0.0), (w, 0.0), (0.0, h), (w, h)] {
            let ray = c.rotation.transpose() * DVec3::new((u - c.cx) / c.fx, (v - c.cy) / c.fy, 1.0);
            for p in [near, far].map(|z| c.position() + ray * z) {
                (low, high) = (low.min(p), high.max(p));
            }
        }
    }
    let corners = [low.as_vec3(), high.as_vec3()];
    corners.iter().all(|c| c.is_finite()).then_some(corners)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_box_holds_the_frustum() {
        let c = Camera::look_at(40, 20, 1.0, DVec3::new(0.0, -3.0, 0.0), DVec3::ZERO, DVec3::Z).unwrap();
        let [low, high] = bounds([(&c, [1.0, 5.0])].into_iter()).unwrap();
        let side = 5.0 * 0.5f32.tan();
        assert!((low - Vec3::new(-side, -2.0, -0.5 * side)).length() < 1e-5, "{low}");
        assert!((high - Vec3::new(side, 2.0, 0.5 * side)).length() < 1e-5, "{high}");
        for wrong in [[2.0, 1.0], [-1.0, 1.0], [0.0, f64::INFINITY], [f64::NAN, 1.0]] {
            assert_eq!(bounds([(&c, wrong)].into_iter()), None, "{wrong:?}");
        }
        assert_eq!(bounds([].into_iter()), None);
    }
}
