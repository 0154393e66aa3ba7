//! What the tests share.

use glam::DVec3;

/// Where the eye of the tests stands.
pub const EYE: DVec3 = DVec3::new(0.3, -0.2, -2.5);

/// Asserts that the largest difference, relative to the largest wanted value, is within `bound`.
pub fn assert_close(got: &[f64], want: &[f64], bound: f64, what: &str) {
    assert_eq!(got.len(), want.len(), "{what}");
    let largest = want.iter().fold(1e-30f64, |m, v| m.max(v.abs()));
    let worst =
        got.iter().zip(want).fold(0.0f64, |m, (g, w)| if (g - w).is_nan() { f64::NAN } else { m.max((g - w).abs()) });
    assert!(worst / largest <= bound, "{what}: off by {worst:.3e} of {largest:.3e}, bound {bound:.0e}");
}

/// Single precision as double.
pub fn wide(v: &[f32]) -> Vec<f64> {
    v.iter().map(|&v| f64::from(v)).collect()
}
