//! Random particles and cotangents, for tests and benches.

use glam::Vec3;
use gs_core::Rng;
use gs_physics::{ParticleState, Start};

/// A centroid that is not the origin.
pub const CENTROID: Vec3 = Vec3::new(0.2, -0.5, 0.4);

/// Particles at a time, with [`CENTROID`].
pub fn start(x: &[Vec3], t: f64) -> Start<'_> {
    Start { x, t, middle: CENTROID }
}

pub fn points(n: usize) -> Vec<Vec3> {
    let mut rng = Rng::new(1, "points", 0, 0);
    (0..n).map(|_| Vec3::new(rng.range(-1.0, 1.0), rng.range(-1.0, 1.0), rng.range(-1.0, 1.0))).collect()
}

pub fn cotangents(n: usize) -> ParticleState {
    let mut rng = Rng::new(1, "cotangents", 0, 0);
    let means = (0..n).map(|_| Vec3::new(rng.normal(), rng.normal(), rng.normal())).collect();
    ParticleState { means, rotations: (0..n).map(|_| std::array::from_fn(|_| rng.normal())).collect() }
}
