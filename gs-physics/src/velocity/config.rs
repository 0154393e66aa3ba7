//! Settings of a velocity field.

use crate::error::{PhysicsError, check, within};
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// Settings of a [`VelocityField`](super::VelocityField); the defaults are NVFi's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VelocityConfig {
    /// Width of the hidden layers of both networks, 1 to 4096.
    pub hidden: usize,
    /// Number of hidden layers of both networks, 1 to 64: SiLU for the velocity, ReLU for the acceleration.
    pub depth: usize,
    /// Frequency bands of the positional encoding of position and time, 0 to 24.
    pub bands: usize,
    /// Factor on world coordinates before they are encoded; finite.
    pub coordinate_scale: f32,
    /// Rotations are about the centre of the scene instead of the world's origin.
    pub local_origin: bool,
    /// Weight of the mean squared divergence.
    pub divergence: f32,
    /// Weight of the mean squared residual of the equation of motion.
    pub transport: f32,
    /// Collocation points of these loss terms per step; 0 for no such terms.
    pub points: usize,
}

impl Default for VelocityConfig {
    fn default() -> Self {
        Self {
            hidden: 128,
            depth: 5,
            bands: 3,
            coordinate_scale: 1.0,
            local_origin: true,
            divergence: 5.0,
            transport: 0.1,
            points: 4096,
        }
    }
}

impl VelocityConfig {
    /// Three layers of 64 and fewer points.
    pub fn small() -> Self {
        Self { hidden: 64, depth: 3, points: 1024, ..Self::default() }
    }

    pub(super) fn check(&self, [min, max]: [Vec3; 2]) -> Result<(), PhysicsError> {
        within("hidden", self.hidden, 1, 4096, "1 to 4096")?;
        within("depth", self.depth, 1, 64, "1 to 64")?;
        within("bands", self.bands, 0, 24, "0 to 24")?;
        within("points", self.points, 0, 1 << 24, "at most 16777216")?;
        let scale = self.coordinate_scale;
        check("coordinate_scale", scale, scale.is_finite(), "finite")?;
        for (name, weight) in [("divergence", self.divergence), ("transport", self.transport)] {
            check(name, weight, weight.is_finite() && weight >= 0.0, "0 or more, finite")?;
        }
        let good = min.is_finite() && max.is_finite() && min.cmple(max).all();
        if good { Ok(()) } else { Err(PhysicsError::Bounds { min, max }) }
    }
}
