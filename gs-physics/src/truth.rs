//! Motions with exact ends: circles, screws, wheels and throws, with their twists by [`crate::centre`].
//!
//! Shared by tests, benches and examples. All start at `τ = 0` with an identity orientation; positions and twists refer to
//! the world's origin.

use crate::centre::{BodyState, Reduction};
use crate::step::Substep;
use crate::twist::{Motion, Twist};
use crate::{Integrator, step::step};
use gs_core::rot::{Mat3, matrix};
use std::f64::consts::PI;

/// A motion, one particle of it, and the exact end of that particle.
///
/// ```
/// use gs_physics::{Integrator, reference::advance, Rollout, truth};
/// let wheel = truth::wheel();
/// let rollout = Rollout { rule: Integrator::Se3Magnus4, dt: wheel.span / 30.0, origin: glam::Vec3::ZERO };
/// let (x, q) = advance(&rollout, &wheel.motion, [0.0, wheel.span], (wheel.start, [1.0, 0.0, 0.0, 0.0]));
/// assert!(wheel.position_error(x) < 2e-7 && wheel.rotation_error(q) < 1e-14);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Name of the case, in lower case.
    pub name: &'static str,
    /// The motion about the world's origin, with a constant rate; see [`throw_with_spin`] for where that is not exact.
    pub motion: Motion<f64>,
    /// Position of the particle at `τ = 0`, world units.
    pub start: [f64; 3],
    /// Duration, in units of time.
    pub span: f64,
    /// Position of the particle at `τ = span`, world units.
    pub end: [f64; 3],
    /// Its rotation over the span, as rows of a matrix.
    pub rotation: Mat3<f64>,
}

impl Truth {
    fn of_body(name: &'static str, body: &BodyState<f64>, start: [f64; 3], span: f64) -> Self {
        let (end, q) = body.exact_arc(span, start);
        Self { name, motion: body.motion(2, Reduction::Exact), start, span, end, rotation: matrix(q) }
    }

    /// Distance of a position from the exact end, world units.
    pub fn position_error(&self, x: [f64; 3]) -> f64 {
        crate::vec3::norm(crate::vec3::sub(x, self.end))
    }

    /// Distance of an orientation `(w, x, y, z)` from the exact one, `‖R − R'‖_F / √2`: the angle, to first order.
    pub fn rotation_error(&self, q: [f64; 4]) -> f64 {
        let got = matrix(q);
        let square: f64 = (0..9).map(|i| (got[i / 3][i % 3] - self.rotation[i / 3][i % 3]).powi(2)).sum();
        (0.5 * square).sqrt()
    }
}

/// T1: one uniform turn about a fixed axis.
pub fn circle() -> Truth {
    let body = BodyState { position: [0.5, 0.0, 0.0], w: [0.0, 0.0, 2.0 * PI], ..BodyState::default() };
    Truth::of_body("circle", &body, [1.5, 0.0, 0.0], 1.0)
}

/// T2: as [`circle`], with a constant velocity along the axis.
pub fn screw() -> Truth {
    let (position, velocity, w) = ([0.5, 0.0, 0.0], [0.0, 0.0, 0.3], [0.0, 0.0, 2.0 * PI]);
    let body = BodyState { position, velocity, w, ..BodyState::default() };
    Truth::of_body("screw", &body, [1.5, 0.0, 0.0], 1.0)
}

/// T3: a fixed axis, spinning up from 1 to 5 rad per unit of time.
pub fn spin_up() -> Truth {
    let (position, w, angular_acceleration) = ([0.5, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 4.0]);
    let body = BodyState { position, w, angular_acceleration, ..BodyState::default() };
    Truth::of_body("spin up", &body, [1.5, 0.0, 0.0], 1.0)
}

/// The body of [`wheel`], described by its hub.
pub fn wheel_body() -> BodyState<f64> {
    let (position, velocity, w) = ([0.0, 0.0, 0.5], [0.5 * PI, 0.0, 0.0], [0.0, PI, 0.0]);
    BodyState { position, velocity, w, ..BodyState::default() }
}

/// T4: half a turn of a rolling wheel of radius 0.5, from the top of the rim to the ground.
pub fn wheel() -> Truth {
    Truth::of_body("wheel", &wheel_body(), [0.0, 0.0, 1.0], 1.0)
}

/// T5: a tumbling body with all twist and rate coefficients non-zero; the end by integration in high precision.
pub fn tumble() -> Truth {
    let twist = Twist { v: [0.3, -0.2, 0.5], w: [1.0, 2.0, -1.0] };
    let rate = Twist { v: [0.4, 0.1, -0.3], w: [-0.5, 1.5, 0.8] };
    Truth {
        name: "tumble",
        motion: Motion { twist, rate, jerk: Twist::default() },
        start: [0.6, -0.4, 0.9],
        span: 1.0,
        end: [-0.303_148_087_8, -0.936_944_334_3, -1.085_631_758_7],
        rotation: [
            [-0.930_422_837, 0.339_594_034_4, 0.137_801_437_9],
            [0.209_197_139_5, 0.800_856_590_6, -0.561_128_575_4],
            [-0.300_915_106_5, -0.493_259_174_4, -0.816_177_361_6],
        ],
    }
}

/// T6: a throw without spin.
pub fn throw() -> Truth {
    let (velocity, acceleration) = ([1.0, 0.2, 4.0], [0.0, 0.0, -9.81]);
    let body = BodyState { velocity, acceleration, ..BodyState::default() };
    Truth::of_body("throw", &body, [0.1, -0.3, 1.2], 0.8)
}

/// T7: the body of a throw with spin, and the start of a particle. A constant rate is not exact here: `v̄` has the
/// quadratic part `−½ w×a_c τ²`.
pub fn throw_with_spin() -> (BodyState<f64>, [f64; 3]) {
    let (velocity, acceleration) = ([1.0, 0.0, 0.5], [0.0, 0.3, -2.0]);
    (BodyState { velocity, acceleration, w: [0.0, 0.0, 3.0], ..BodyState::default() }, [0.2, 0.0, 0.1])
}

/// All motions that a constant rate describes exactly.
pub fn all() -> [Truth; 6] {
    [circle(), screw(), spin_up(), wheel(), tumble(), throw()]
}

/// Position and rotation `(w, x, y, z)` at `tau` of the particle at `x`, to about 1e-13, by 2048 steps of the fourth-order
/// rule.
pub fn follow(motion: &Motion<f64>, tau: f64, x: [f64; 3]) -> ([f64; 3], [f64; 4]) {
    let n = 2048;
    let h = tau / f64::from(n);
    let advance = |(x, q), k| step(Integrator::Se3Magnus4, motion, &Substep::new(f64::from(k) * h, h), x, q);
    (0..n).fold((x, [1.0, 0.0, 0.0, 0.0]), advance)
}
