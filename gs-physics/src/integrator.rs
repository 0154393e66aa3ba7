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

    /// Whether a step moves a body without bending it.
    pub fn is_rigid(self) -> bool {
        matches!(self, Self::Se3Mid | Self::Se3Magnus4)
    }

    /// The share by which a particle's distance from its axis grows in a step that turns it by `turn` radians at a constant rate;
    /// below 0 where it shrinks.
    ///
    /// ```
    /// use gs_physics::Integrator;
    /// assert!((Integrator::Euler.growth(0.2) - 0.0198).abs() < 1e-4);
    /// assert_eq!(Integrator::Se3Mid.growth(0.2), 0.0);
    /// ```
    pub fn growth(self, turn: f64) -> f64 {
        let z = turn * turn;
        // Of the squared distance.
        let square = match self {
            Self::Euler | Self::MidParams => z,
            Self::Rk2 => z * z / 4.0,
            Self::Rk4 => z * z * z * (z / 576.0 - 1.0 / 72.0),
            Self::Se3Mid | Self::Se3Magnus4 => 0.0,
        };
        (1.0 + square).sqrt() - 1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Motion, Twist, step_map};

    #[test]
    fn radii_grow_as_stated() {
        for rule in Integrator::ALL {
            for turn in [0.1, 0.3, 0.8, 2.0] {
                let twist = Twist { v: [0.0; 3], w: [0.0, 0.0, turn] };
                let x = step_map(&Motion { twist, ..Motion::default() }, 0.0, 1.0, rule).0.apply([1.0, 0.0, 0.5]);
                let grown = x[0].hypot(x[1]) - 1.0;
                assert!((grown - rule.growth(turn)).abs() < 1e-12, "{rule:?} {turn}: {grown}");
                assert_eq!(rule.is_rigid(), rule.growth(turn) == 0.0, "{rule:?} {turn}");
            }
        }
    }
}
