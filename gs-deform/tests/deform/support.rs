//! What tests of fields share.

use glam::Vec3;
use gs_core::{Geometry, Rng, Time};

pub fn time(t: f32) -> Time {
    Time::new(t).unwrap()
}

/// Random cotangents of `n` rows.
pub fn cotangents(n: usize, seed: u64) -> Geometry {
    let mut g = Geometry::zeros(n);
    let mut rng = Rng::new(seed, "cotangents", 0, 0);
    g.means.iter_mut().chain(&mut g.scales).for_each(|v| *v = Vec3::new(rng.normal(), rng.normal(), rng.normal()));
    g.quats.as_flattened_mut().iter_mut().for_each(|v| *v = rng.normal());
    g
}

/// The ten moving values of a row.
pub fn row(means: &[Vec3], quats: &[[f32; 4]], scales: &[Vec3], r: usize) -> [f64; 10] {
    let flat: Vec<f32> = means[r].to_array().into_iter().chain(quats[r]).chain(scales[r].to_array()).collect();
    std::array::from_fn(|k| f64::from(flat[k]))
}
