//! What the tests share: random anchors, comparisons.

use glam::{DVec3, Vec3};
use gs_anchor::Local;
use gs_core::Rng;

/// Where the eye of the tests stands.
pub const EYE: DVec3 = DVec3::new(0.3, -0.2, -2.5);

/// `n` random anchors around the origin; every fourth has a negative extent, every fifth a negative spread.
pub fn anchors(n: usize, k: usize, c: usize) -> Local {
    let mut local = Local::default();
    for v in 0..n {
        let mut rng = Rng::new(11, "anchors", 0, v as u64);
        let mut values = |n: usize, scale: f32| (0..n).map(|_| scale * rng.normal()).collect::<Vec<f32>>();
        local.positions.push(Vec3::from_slice(&values(3, 0.5)));
        local.offsets.extend(values(3 * k, 1.0));
        local.features.extend(values(c, 1.0));
        let mut scales: Vec<f32> = values(6, 0.5).iter().map(|s| 0.1 * s.exp()).collect();
        scales[3 + v % 3] *= if v % 4 == 1 { -1.0 } else { 1.0 };
        scales[v % 3] *= if v % 5 == 2 { -1.0 } else { 1.0 };
        local.scales.extend(scales);
    }
    local
}

/// Asserts that the largest difference, relative to the largest wanted value, is within `bound`; returns it.
pub fn assert_close(got: &[f64], want: &[f64], bound: f64, what: &str) -> f64 {
    assert_eq!(got.len(), want.len(), "{what}");
    let largest = want.iter().fold(1e-30f64, |m, v| m.max(v.abs()));
    let worst =
        got.iter().zip(want).fold(0.0f64, |m, (g, w)| if (g - w).is_nan() { f64::NAN } else { m.max((g - w).abs()) });
    assert!(worst / largest <= bound, "{what}: off by {worst:.3e} of {largest:.3e}, bound {bound:.0e}");
    worst / largest
}

/// Single precision as double.
pub fn wide(v: &[f32]) -> Vec<f64> {
    v.iter().map(|&v| f64::from(v)).collect()
}
