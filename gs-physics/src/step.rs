//! One step of one particle, forward and backward.
//!
//! Positions are relative to the origin of the motion. With `a, m, b` the twist at the start, midpoint and end of a step:
//!
//! ```text
//! Euler       x + h a(x)                                            q(h w_a) ⊗ q
//! MidParams   x + h m(x)                                            q(h w_m) ⊗ q
//! Rk2         x + h m(x + ½h a(x))                                  q(h w_m) ⊗ q
//! Rk4         x + h/6 (k₁ + 2k₂ + 2k₃ + k₄), twists a, m, m, b      q(h w_m) ⊗ q
//! Se3Mid      exp(h m)
//! Se3Magnus4  exp(h ū − h³/12 [ū, u̇_m]),  ū the mean twist over the step
//! ```
//! Every rule is affine in `x` and depends on the particle only through its motion: see [`step_map`].

use crate::integrator::Integrator;
use crate::scalar::Scalar;
use crate::so3::{Rotation, product_backward};
use crate::twist::{Motion, Twist};
use crate::vec3::{V3, add, add_scaled, scale};
use gs_core::Real;
use gs_core::real::{cross3, dot3};
use gs_core::rot::Mat3;

/// The map `x -> a x + b` of positions about the origin of the twists.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine {
    /// Linear part, row by row, without unit.
    pub a: Mat3<f64>,
    /// Image of the origin, world units.
    pub b: [f64; 3],
}

impl Affine {
    /// The map `x -> x`.
    pub const IDENTITY: Self = Self { a: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], b: [0.0; 3] };

    /// `a x + b` of a position relative to the origin.
    pub fn apply(&self, x: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|r| dot3(self.a[r], x) + self.b[r])
    }

    /// The composition `x -> next(self(x))`.
    pub fn then(&self, next: &Self) -> Self {
        let column = |c: usize| [self.a[0][c], self.a[1][c], self.a[2][c]];
        let a = std::array::from_fn(|r| std::array::from_fn(|c| dot3(next.a[r], column(c))));
        Self { a, b: next.apply(self.b) }
    }
}

/// Time and length of a step: `h`, and the weights `(τ, ½τ²)` of rate and jerk at its start, midpoint and end and averaged
/// over it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Substep<T> {
    pub h: T,
    begin: [T; 2],
    middle: [T; 2],
    end: [T; 2],
    mean: [T; 2],
}

impl Substep<f64> {
    /// The step over `[tau, tau + h]`, `tau` counted from when the motion was read.
    pub(crate) fn new(tau: f64, h: f64) -> Self {
        let at = |t: f64| [t, 0.5 * t * t];
        let middle = at(tau + 0.5 * h);
        let mean = [middle[0], middle[1] + h * h * (1.0 / 24.0)];
        Self { h, begin: at(tau), middle, end: at(tau + h), mean }
    }

    /// One step over `[0, tau]` that uses the mean twist as a constant one: with [`Integrator::Se3Mid`] exact wherever the
    /// twists of the span commute.
    pub(crate) fn averaged(tau: f64) -> Self {
        let substep = Self::new(0.0, tau);
        Self { middle: substep.mean, ..substep }
    }

    /// The same step in the number kind of `like`.
    #[inline(always)]
    pub(crate) fn of<T: Real>(&self, like: T) -> Substep<T> {
        Substep {
            h: like.lit(self.h),
            begin: [like.lit(self.begin[0]), like.lit(self.begin[1])],
            middle: [like.lit(self.middle[0]), like.lit(self.middle[1])],
            end: [like.lit(self.end[0]), like.lit(self.end[1])],
            mean: [like.lit(self.mean[0]), like.lit(self.mean[1])],
        }
    }
}

/// One step of `rule` as the affine map `x -> A x + b` about the origin of the motion, with its rotation as a unit
/// quaternion `(w, x, y, z)`. `tau` is the time since the motion was read, `h` the length of the step, negative to go back.
///
/// A particle that circles the z axis at distance 1 ends half a turn later on the other side, in one step:
/// ```
/// use gs_physics::{Integrator, Motion, Twist, step_map};
/// let twist = Twist { v: [0.0; 3], w: [0.0, 0.0, std::f64::consts::PI] };
/// let (map, q) = step_map(&Motion { twist, ..Motion::default() }, 0.0, 1.0, Integrator::Se3Mid);
/// let x = map.apply([1.0, 0.0, 5.0]);
/// assert!((x[0] + 1.0).abs() < 1e-15 && x[1].abs() < 1e-15 && x[2] == 5.0);
/// assert!((q[3] - 1.0).abs() < 1e-15);
/// ```
pub fn step_map(m: &Motion<f64>, tau: f64, h: f64, rule: Integrator) -> (Affine, [f64; 4]) {
    let unit = [1.0, 0.0, 0.0, 0.0];
    let substep = Substep::new(tau, h);
    let angular = |t: &Twist<f64>| Twist { v: [0.0; 3], w: t.w };
    let linear_part = Motion { twist: angular(&m.twist), rate: angular(&m.rate), jerk: angular(&m.jerk) };
    let columns = Affine::IDENTITY.a.map(|e| add(e, increment(rule, &linear_part, &substep, e, unit).0));
    let a = std::array::from_fn(|r| std::array::from_fn(|c| columns[c][r]));
    let (b, q) = increment(rule, m, &substep, [0.0; 3], unit);
    (Affine { a, b }, q)
}

/// Position and orientation after a step.
#[inline(always)]
pub(crate) fn step<T: Scalar>(
    rule: Integrator,
    m: &Motion<T>,
    substep: &Substep<T>,
    x: V3<T>,
    q: [T; 4],
) -> (V3<T>, [T; 4]) {
    let (moved, q) = increment(rule, m, substep, x, q);
    (add(x, moved), q)
}

/// What a step adds to the position, and the orientation after it.
#[inline(always)]
pub(crate) fn increment<T: Scalar>(
    rule: Integrator,
    m: &Motion<T>,
    substep: &Substep<T>,
    x: V3<T>,
    q: [T; 4],
) -> (V3<T>, [T; 4]) {
    let h = substep.h;
    match rule {
        Integrator::Euler => {
            let a = m.weighted(substep.begin);
            (scale(a.velocity(x), h), rotated(scale(a.w, h), q))
        }
        Integrator::MidParams => {
            let mid = m.weighted(substep.middle);
            (scale(mid.velocity(x), h), rotated(scale(mid.w, h), q))
        }
        Integrator::Rk2 => {
            let (a, mid) = (m.weighted(substep.begin), m.weighted(substep.middle));
            let x_m = add_scaled(x, h * h.lit(0.5), a.velocity(x));
            (scale(mid.velocity(x_m), h), rotated(scale(mid.w, h), q))
        }
        Integrator::Rk4 => {
            let mid = m.weighted(substep.middle);
            (Rk4Stages::new(m, substep, x).increment(h), rotated(scale(mid.w, h), q))
        }
        Integrator::Se3Mid | Integrator::Se3Magnus4 => {
            let omega = exponent(rule, m, substep);
            let rotation = Rotation::new(omega.w);
            (rotation.displacement(omega.v, x), rotation.rotate_quaternion(q))
        }
    }
}

#[inline(always)]
fn rotated<T: Scalar>(phi: V3<T>, q: [T; 4]) -> [T; 4] {
    Rotation::new(phi).rotate_quaternion(q)
}

/// The twist that the rules on SE(3) take the exponential of.
#[inline(always)]
fn exponent<T: Scalar>(rule: Integrator, m: &Motion<T>, substep: &Substep<T>) -> Twist<T> {
    let h = substep.h;
    if rule == Integrator::Se3Mid {
        return m.weighted(substep.middle).scaled(h);
    }
    let mean = m.weighted(substep.mean);
    let rate = m.rate.add_scaled(substep.middle[0], &m.jerk);
    mean.scaled(h).add_scaled(-h * h * h * h.lit(1.0 / 12.0), &mean.bracket(&rate))
}

/// The four stages of the classical rule: positions at which the velocity is evaluated, and its values there.
struct Rk4Stages<T> {
    twists: [Twist<T>; 4],
    at: [V3<T>; 4],
    k: [V3<T>; 4],
}

impl<T: Scalar> Rk4Stages<T> {
    #[inline(always)]
    fn new(m: &Motion<T>, substep: &Substep<T>, x: V3<T>) -> Self {
        let half = substep.h * substep.h.lit(0.5);
        let mid = m.weighted(substep.middle);
        let twists = [m.weighted(substep.begin), mid, mid, m.weighted(substep.end)];
        let k1 = twists[0].velocity(x);
        let x2 = add_scaled(x, half, k1);
        let k2 = mid.velocity(x2);
        let x3 = add_scaled(x, half, k2);
        let k3 = mid.velocity(x3);
        let x4 = add_scaled(x, substep.h, k3);
        Self { twists, at: [x, x2, x3, x4], k: [k1, k2, k3, twists[3].velocity(x4)] }
    }

    #[inline(always)]
    fn increment(&self, h: T) -> V3<T> {
        let inner = add(self.k[1], self.k[2]);
        let sum = add_scaled(add(self.k[0], self.k[3]), h.lit(2.0), inner);
        scale(sum, h * h.lit(1.0 / 6.0))
    }
}

/// Backward of [`step`]: from cotangents of the state after it to those of the state before; adds to the motion's.
#[inline(always)]
pub(crate) fn step_backward<T: Scalar>(
    rule: Integrator,
    m: &Motion<T>,
    substep: &Substep<T>,
    (x, q): (V3<T>, [T; 4]),
    (lambda, mu): (V3<T>, [T; 4]),
    grad: &mut Motion<T>,
) -> (V3<T>, [T; 4]) {
    let h = substep.h;
    let half = h * h.lit(0.5);
    match rule {
        Integrator::Euler | Integrator::MidParams => {
            let weights = if rule == Integrator::Euler { substep.begin } else { substep.middle };
            let u = m.weighted(weights);
            let (mu, d_phi) = rotated_backward(scale(u.w, h), q, mu);
            let (d_x, mut d) = velocity_backward(&u, x, scale(lambda, h));
            d.w = add_scaled(d.w, h, d_phi);
            add_weighted(grad, weights, &d);
            (add(lambda, d_x), mu)
        }
        Integrator::Rk2 => {
            let (a, mid) = (m.weighted(substep.begin), m.weighted(substep.middle));
            let x_m = add_scaled(x, half, a.velocity(x));
            let (mu, d_phi) = rotated_backward(scale(mid.w, h), q, mu);
            let (to_mid, mut d_mid) = velocity_backward(&mid, x_m, scale(lambda, h));
            d_mid.w = add_scaled(d_mid.w, h, d_phi);
            let (to_begin, d_a) = velocity_backward(&a, x, scale(to_mid, half));
            add_weighted(grad, substep.middle, &d_mid);
            add_weighted(grad, substep.begin, &d_a);
            (add(lambda, add(to_mid, to_begin)), mu)
        }
        Integrator::Rk4 => rk4_backward(m, substep, (x, q), (lambda, mu), grad),
        Integrator::Se3Mid | Integrator::Se3Magnus4 => {
            let omega = exponent(rule, m, substep);
            let rotation = Rotation::new(omega.w);
            let (mu, d_turn) = product_backward(rotation.quaternion(), q, mu);
            let (lambda, v, w) = rotation.transform_backward(omega.v, x, lambda, d_turn);
            exponent_backward(rule, m, substep, &Twist { v, w }, grad);
            (lambda, mu)
        }
    }
}

/// Cotangents of `q` and of the rotation vector in [`rotated`].
#[inline(always)]
fn rotated_backward<T: Scalar>(phi: V3<T>, q: [T; 4], mu: [T; 4]) -> ([T; 4], V3<T>) {
    let rotation = Rotation::new(phi);
    let (mu, d_turn) = product_backward(rotation.quaternion(), q, mu);
    (mu, rotation.quaternion_backward(d_turn))
}

/// Cotangents of `x` and of the twist from the cotangent `g` of `u(x)`.
#[inline(always)]
fn velocity_backward<T: Real>(u: &Twist<T>, x: V3<T>, g: V3<T>) -> (V3<T>, Twist<T>) {
    (cross3(g, u.w), Twist { v: g, w: cross3(x, g) })
}

/// The transpose of [`Motion::weighted`].
#[inline(always)]
fn add_weighted<T: Real>(grad: &mut Motion<T>, weights: [T; 2], d: &Twist<T>) {
    let one = weights[0].lit(1.0);
    grad.twist = grad.twist.add_scaled(one, d);
    grad.rate = grad.rate.add_scaled(weights[0], d);
    grad.jerk = grad.jerk.add_scaled(weights[1], d);
}

#[inline(always)]
fn rk4_backward<T: Scalar>(
    m: &Motion<T>,
    substep: &Substep<T>,
    (x, q): (V3<T>, [T; 4]),
    (lambda, mu): (V3<T>, [T; 4]),
    grad: &mut Motion<T>,
) -> (V3<T>, [T; 4]) {
    let h = substep.h;
    let (half, sixth, third) = (h * h.lit(0.5), h * h.lit(1.0 / 6.0), h * h.lit(1.0 / 3.0));
    let stages = Rk4Stages::new(m, substep, x);
    let (mu, d_phi) = rotated_backward(scale(stages.twists[1].w, h), q, mu);
    let (to_4, d_4) = velocity_backward(&stages.twists[3], stages.at[3], scale(lambda, sixth));
    let (to_3, d_3) = velocity_backward(&stages.twists[2], stages.at[2], add_scaled(scale(lambda, third), h, to_4));
    let (to_2, mut d_2) =
        velocity_backward(&stages.twists[1], stages.at[1], add_scaled(scale(lambda, third), half, to_3));
    let (to_1, d_1) = velocity_backward(&stages.twists[0], x, add_scaled(scale(lambda, sixth), half, to_2));
    d_2.w = add_scaled(d_2.w, h, d_phi);
    add_weighted(grad, substep.begin, &d_1);
    add_weighted(grad, substep.middle, &d_2);
    add_weighted(grad, substep.middle, &d_3);
    add_weighted(grad, substep.end, &d_4);
    (add(lambda, add(add(to_1, to_2), add(to_3, to_4))), mu)
}

/// The transpose of [`exponent`].
#[inline(always)]
fn exponent_backward<T: Scalar>(
    rule: Integrator,
    m: &Motion<T>,
    substep: &Substep<T>,
    g: &Twist<T>,
    grad: &mut Motion<T>,
) {
    let h = substep.h;
    if rule == Integrator::Se3Mid {
        return add_weighted(grad, substep.middle, &g.scaled(h));
    }
    let mean = m.weighted(substep.mean);
    let rate = m.rate.add_scaled(substep.middle[0], &m.jerk);
    let k = -h * h * h * h.lit(1.0 / 12.0);
    let (d_mean, d_rate) = bracket_backward(&mean, &rate, &g.scaled(k));
    add_weighted(grad, substep.mean, &d_mean.add_scaled(h, g));
    grad.rate = grad.rate.add_scaled(h.lit(1.0), &d_rate);
    grad.jerk = grad.jerk.add_scaled(substep.middle[0], &d_rate);
}

/// Cotangents of `[a, b]` from `g`. For `y = p × q`: `g_p = q × g`, `g_q = g × p`.
#[inline(always)]
fn bracket_backward<T: Real>(a: &Twist<T>, b: &Twist<T>, g: &Twist<T>) -> (Twist<T>, Twist<T>) {
    let d_a = Twist { v: cross3(b.w, g.v), w: add(cross3(b.v, g.v), cross3(b.w, g.w)) };
    let d_b = Twist { v: cross3(g.v, a.w), w: add(cross3(g.v, a.v), cross3(g.w, a.w)) };
    (d_a, d_b)
}
