//! Motions whose ends are known: circles, screws, wheels and throws, with their twists by [`crate::centre`].
//!
//! Tests, benches and examples share them. All start at `τ = 0` with an identity orientation; positions and twists refer
//! to the origin of the world.

use crate::centre::{Centre, Reduction};
use crate::step::Tick;
use crate::twist::{Motion, Twist};
use crate::{Integrator, step::step};
use gs_core::rot::{Mat3, matrix};
use std::f64::consts::PI;

/// A motion, a particle of it, and where that particle ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// What moves.
    pub name: &'static str,
    /// Exact wherever a constant rate is; see [`throw_with_spin`].
    pub motion: Motion<f64>,
    /// The particle at `τ = 0`.
    pub start: [f64; 3],
    /// How long it moves.
    pub span: f64,
    /// Where it ends.
    pub end: [f64; 3],
    /// Its turn, as rows of a matrix.
    pub turn: Mat3<f64>,
}

impl Truth {
    fn of_centre(name: &'static str, centre: &Centre, start: [f64; 3], span: f64) -> Self {
        let (end, q) = centre.exact_arc(span, start);
        Self { name, motion: centre.motion(Reduction::Exact), start, span, end, turn: matrix(q) }
    }

    /// Distance of a position from the end.
    pub fn miss(&self, x: [f64; 3]) -> f64 {
        crate::vec3::norm(crate::vec3::sub(x, self.end))
    }

    /// Distance of an orientation from the end's: `‖R − R'‖_F / √2`.
    pub fn misturn(&self, q: [f64; 4]) -> f64 {
        let got = matrix(q);
        let square: f64 = (0..9).map(|i| (got[i / 3][i % 3] - self.turn[i / 3][i % 3]).powi(2)).sum();
        (0.5 * square).sqrt()
    }
}

/// T1: one uniform turn about a resting axis.
pub fn circle() -> Truth {
    let centre = Centre { at: [0.5, 0.0, 0.0], w: [0.0, 0.0, 2.0 * PI], ..Centre::default() };
    Truth::of_centre("circle", &centre, [1.5, 0.0, 0.0], 1.0)
}

/// T2: the same, advancing along the axis.
pub fn screw() -> Truth {
    let velocity = [0.0, 0.0, 0.3];
    let centre = Centre { at: [0.5, 0.0, 0.0], velocity, w: [0.0, 0.0, 2.0 * PI], ..Centre::default() };
    Truth::of_centre("screw", &centre, [1.5, 0.0, 0.0], 1.0)
}

/// T3: a fixed axis, spinning up from 1 to 5 rad per unit of time.
pub fn spin_up() -> Truth {
    let (w, spin_up) = ([0.0, 0.0, 1.0], [0.0, 0.0, 4.0]);
    let centre = Centre { at: [0.5, 0.0, 0.0], w, spin_up, ..Centre::default() };
    Truth::of_centre("spin up", &centre, [1.5, 0.0, 0.0], 1.0)
}

/// The hub of [`wheel`].
pub fn hub() -> Centre {
    let (velocity, w) = ([0.5 * PI, 0.0, 0.0], [0.0, PI, 0.0]);
    Centre { at: [0.0, 0.0, 0.5], velocity, w, ..Centre::default() }
}

/// T4: half a turn of a rolling wheel of radius 0.5, from the top of the rim to the ground.
pub fn wheel() -> Truth {
    Truth::of_centre("wheel", &hub(), [0.0, 0.0, 1.0], 1.0)
}

/// T5: an axis that tips over while everything accelerates; the end by integration in high precision.
pub fn tumble() -> Truth {
    let twist = Twist { v: [0.3, -0.2, 0.5], w: [1.0, 2.0, -1.0] };
    let rate = Twist { v: [0.4, 0.1, -0.3], w: [-0.5, 1.5, 0.8] };
    Truth {
        name: "tumble",
        motion: Motion { twist, rate, jerk: Twist::default() },
        start: [0.6, -0.4, 0.9],
        span: 1.0,
        end: [-0.303_148_087_8, -0.936_944_334_3, -1.085_631_758_7],
        turn: [
            [-0.930_422_837, 0.339_594_034_4, 0.137_801_437_9],
            [0.209_197_139_5, 0.800_856_590_6, -0.561_128_575_4],
            [-0.300_915_106_5, -0.493_259_174_4, -0.816_177_361_6],
        ],
    }
}

/// T6: a throw without spin.
pub fn throw() -> Truth {
    let centre = Centre { velocity: [1.0, 0.2, 4.0], acceleration: [0.0, 0.0, -9.81], ..Centre::default() };
    Truth::of_centre("throw", &centre, [0.1, -0.3, 1.2], 0.8)
}

/// T7: the body of a throw with spin, and the particle followed. A constant rate is not exact here: `v̄` has the
/// quadratic part `−½ w×a_c τ²`.
pub fn throw_with_spin() -> (Centre, [f64; 3]) {
    let (velocity, acceleration) = ([1.0, 0.0, 0.5], [0.0, 0.3, -2.0]);
    (Centre { velocity, acceleration, w: [0.0, 0.0, 3.0], ..Centre::default() }, [0.2, 0.0, 0.1])
}

/// All whose ends a constant rate reaches exactly.
pub fn all() -> [Truth; 6] {
    [circle(), screw(), spin_up(), wheel(), tumble(), throw()]
}

/// Where a particle of any motion is at `tau`, to about 1e-13, by many steps of the fourth-order rule.
pub fn follow(motion: &Motion<f64>, tau: f64, x: [f64; 3]) -> ([f64; 3], [f64; 4]) {
    let n = 2048;
    let h = tau / f64::from(n);
    let go = |(x, q), k| step(Integrator::Se3Magnus4, motion, &Tick::new(f64::from(k) * h, h), x, q);
    (0..n).fold((x, [1.0, 0.0, 0.0, 0.0]), go)
}
