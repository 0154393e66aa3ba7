//! Shared by the tests.

use glam::DVec3;
use gs_anchor::reference::{AnchorRef, GaussianRef};
use gs_core::{Rng, Splats, SplatsGrad};

/// Camera centre of the tests.
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

/// Cotangents that do not depend on which Gaussians exist: one per `anchor · k + j`.
pub fn cotangent(row: usize) -> GaussianRef {
    let mut rng = Rng::new(6, "cotangent", 0, row as u64);
    let mut v = || f64::from(rng.normal());
    GaussianRef {
        activation: v(),
        mean: [v(), v(), v()],
        scale: [v(), v(), v()],
        quat: [v(), v(), v(), v()],
        color: [v(), v(), v()],
    }
}

/// The same for splats of the given rows.
pub fn cotangents(rows: &[u32], splats: &Splats) -> SplatsGrad {
    let mut d = SplatsGrad::zeros_like(splats);
    for (n, &row) in rows.iter().enumerate() {
        let g = cotangent(row as usize);
        d.means[n] = DVec3::from_array(g.mean).as_vec3();
        d.scales[n] = DVec3::from_array(g.scale).as_vec3();
        d.quats[n] = g.quat.map(|v| v as f32);
        d.opacities[n] = g.activation as f32;
        d.color[3 * n..][..3].copy_from_slice(&g.color.map(|v| v as f32));
    }
    d
}

/// Position, offsets, features, scales.
pub fn flat_anchor(a: &AnchorRef) -> Vec<f64> {
    [&a.position[..], &a.offsets, &a.features, &a.scales].concat()
}
