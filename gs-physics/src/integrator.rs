//! Integration rules along a twist.

use serde::{Deserialize, Serialize};

/// How a particle is integrated over one step of length `h`; orders of position / orientation. `m` is the twist at the
/// midpoint of the step, `a` the one at its start. Formulas: [`step`](crate::step).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Integrator {
    /// `x + h (v_a + w_a × x)`, 1 / 1.
    Euler,
    /// `x + h (v_m + w_m × x)`, 1 / 2: as TRACE prints it.
    MidParams,
    /// Midpoint rule, 2 / 2: as the authors' code does it. Not rigid: radii grow.
    Rk2,
    /// Classical Runge–Kutta for positions, 4 / 2.
    Rk4,
    /// `exp(h m)` on SE(3), 2 / 2: exactly rigid, exact for a constant twist.
    Se3Mid,
    /// Fourth-order Magnus series on SE(3), 4 / 4: for long steps and references.
    Se3Magnus4,
}

impl Integrator {
    /// Every integrator.
    pub const ALL: [Self; 6] = [Self::Euler, Self::MidParams, Self::Rk2, Self::Rk4, Self::Se3Mid, Self::Se3Magnus4];
}
