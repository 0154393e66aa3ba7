//! One sub-step of one particle, and the way back.
//!
//! Positions are relative to the origin of the motion. With `a, m, b` the twist at the begin, middle and end of a step:
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
use crate::so3::{Rotation, product_back};
use crate::twist::{Motion, Twist};
use crate::vec3::{V3, add, add_scaled, scale};
use gs_core::Real;
use gs_core::real::cross3;
use gs_core::rot::Mat3;

/// `x -> a x + b`, about the origin of the twists.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine<T> {
    /// Rows.
    pub a: Mat3<T>,
    /// Shift, world units.
    pub b: [T; 3],
}

impl<T: Real> Affine<T> {
    /// The map that changes nothing; `like` gives the kind of number.
    pub fn identity(like: T) -> Self {
        let (o, i) = (like.lit(0.0), like.lit(1.0));
        Self { a: [[i, o, o], [o, i, o], [o, o, i]], b: [o; 3] }
    }

    /// `a x + b`.
    pub fn apply(&self, x: [T; 3]) -> [T; 3] {
        std::array::from_fn(|r| gs_core::real::dot3(self.a[r], x) + self.b[r])
    }

    /// This map, then `next`.
    pub fn then(&self, next: &Self) -> Self {
        let column = |c: usize| [self.a[0][c], self.a[1][c], self.a[2][c]];
        let a = std::array::from_fn(|r| std::array::from_fn(|c| gs_core::real::dot3(next.a[r], column(c))));
        Self { a, b: next.apply(self.b) }
    }
}

/// When a step happens: its length and the weights `(τ, ½τ²)` of rate and jerk at its begin, middle and end and averaged
/// over it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Tick<T> {
    pub h: T,
    begin: [T; 2],
    middle: [T; 2],
    end: [T; 2],
    mean: [T; 2],
}

impl<T: Real> Tick<T> {
    pub fn new(tau: T, h: T) -> Self {
        let half = tau.lit(0.5);
        let at = |t: T| [t, half * t * t];
        let middle = at(tau + half * h);
        let mean = [middle[0], middle[1] + h * h * tau.lit(1.0 / 24.0)];
        Self { h, begin: at(tau), middle, end: at(tau + h), mean }
    }
}

impl Tick<f64> {
    /// One step over `[0, tau]` that uses the mean twist as if it were constant: with [`Integrator::Se3Mid`] exact
    /// wherever the twists of the span commute.
    pub fn leap(tau: f64) -> Self {
        let tick = Self::new(0.0, tau);
        Self { middle: tick.mean, ..tick }
    }

    /// In the number kind of `like`.
    #[inline(always)]
    pub fn of<T: Real>(&self, like: T) -> Tick<T> {
        Tick {
            h: like.lit(self.h),
            begin: [like.lit(self.begin[0]), like.lit(self.begin[1])],
            middle: [like.lit(self.middle[0]), like.lit(self.middle[1])],
            end: [like.lit(self.end[0]), like.lit(self.end[1])],
            mean: [like.lit(self.mean[0]), like.lit(self.mean[1])],
        }
    }
}

/// One sub-step of one particle: the affine map `x → A x + b` about the origin of the motion, and its rotation as a unit
/// quaternion. `tau` is the time since the motion was read, `h` the length of the step, negative to go back.
pub fn step_map<T: Scalar>(m: &Motion<T>, tau: T, h: T, rule: Integrator) -> (Affine<T>, [T; 4]) {
    let (o, i) = (tau.lit(0.0), tau.lit(1.0));
    let tick = Tick::new(tau, h);
    let still = |t: &Twist<T>| Twist { v: [o; 3], w: t.w };
    let turning = Motion { twist: still(&m.twist), rate: still(&m.rate), jerk: still(&m.jerk) };
    let column = |e| add(e, change(rule, &turning, &tick, e, [i, o, o, o]).0);
    let columns = [[i, o, o], [o, i, o], [o, o, i]].map(column);
    let a = std::array::from_fn(|r| std::array::from_fn(|c| columns[c][r]));
    let (b, q) = change(rule, m, &tick, [o; 3], [i, o, o, o]);
    (Affine { a, b }, q)
}

/// Position and orientation after a step.
#[inline(always)]
pub(crate) fn step<T: Scalar>(rule: Integrator, m: &Motion<T>, tick: &Tick<T>, x: V3<T>, q: [T; 4]) -> (V3<T>, [T; 4]) {
    let (moved, q) = change(rule, m, tick, x, q);
    (add(x, moved), q)
}

/// What a step adds to the position, and the orientation after it.
#[inline(always)]
pub(crate) fn change<T: Scalar>(
    rule: Integrator,
    m: &Motion<T>,
    tick: &Tick<T>,
    x: V3<T>,
    q: [T; 4],
) -> (V3<T>, [T; 4]) {
    let h = tick.h;
    match rule {
        Integrator::Euler => {
            let a = m.weighed(tick.begin);
            (scale(a.velocity(x), h), turned(scale(a.w, h), q))
        }
        Integrator::MidParams => {
            let mid = m.weighed(tick.middle);
            (scale(mid.velocity(x), h), turned(scale(mid.w, h), q))
        }
        Integrator::Rk2 => {
            let (a, mid) = (m.weighed(tick.begin), m.weighed(tick.middle));
            let x_m = add_scaled(x, h * h.lit(0.5), a.velocity(x));
            (scale(mid.velocity(x_m), h), turned(scale(mid.w, h), q))
        }
        Integrator::Rk4 => {
            let mid = m.weighed(tick.middle);
            (Classical::new(m, tick, x).change(h), turned(scale(mid.w, h), q))
        }
        Integrator::Se3Mid | Integrator::Se3Magnus4 => {
            let omega = exponent(rule, m, tick);
            let rotation = Rotation::new(omega.w);
            (rotation.change(omega.v, x), rotation.turn(q))
        }
    }
}

#[inline(always)]
fn turned<T: Scalar>(phi: V3<T>, q: [T; 4]) -> [T; 4] {
    Rotation::new(phi).turn(q)
}

/// What the rules on SE(3) take the exponential of.
#[inline(always)]
fn exponent<T: Scalar>(rule: Integrator, m: &Motion<T>, tick: &Tick<T>) -> Twist<T> {
    let h = tick.h;
    if rule == Integrator::Se3Mid {
        return m.weighed(tick.middle).scaled(h);
    }
    let mean = m.weighed(tick.mean);
    let rate = m.rate.add_scaled(tick.middle[0], &m.jerk);
    mean.scaled(h).add_scaled(-h * h * h * h.lit(1.0 / 12.0), &mean.bracket(&rate))
}

/// The four stages of the classical rule: where the field is read, and what it says there.
struct Classical<T> {
    twists: [Twist<T>; 4],
    at: [V3<T>; 4],
    k: [V3<T>; 4],
}

impl<T: Scalar> Classical<T> {
    #[inline(always)]
    fn new(m: &Motion<T>, tick: &Tick<T>, x: V3<T>) -> Self {
        let half = tick.h * tick.h.lit(0.5);
        let mid = m.weighed(tick.middle);
        let twists = [m.weighed(tick.begin), mid, mid, m.weighed(tick.end)];
        let k1 = twists[0].velocity(x);
        let x2 = add_scaled(x, half, k1);
        let k2 = mid.velocity(x2);
        let x3 = add_scaled(x, half, k2);
        let k3 = mid.velocity(x3);
        let x4 = add_scaled(x, tick.h, k3);
        Self { twists, at: [x, x2, x3, x4], k: [k1, k2, k3, twists[3].velocity(x4)] }
    }

    #[inline(always)]
    fn change(&self, h: T) -> V3<T> {
        let inner = add(self.k[1], self.k[2]);
        let sum = add_scaled(add(self.k[0], self.k[3]), h.lit(2.0), inner);
        scale(sum, h * h.lit(1.0 / 6.0))
    }
}

/// Cotangents of a step: of the state before it, given those of the state after; adds to the motion's.
#[inline(always)]
pub(crate) fn step_back<T: Scalar>(
    rule: Integrator,
    m: &Motion<T>,
    tick: &Tick<T>,
    (x, q): (V3<T>, [T; 4]),
    (lambda, mu): (V3<T>, [T; 4]),
    grad: &mut Motion<T>,
) -> (V3<T>, [T; 4]) {
    let h = tick.h;
    let half = h * h.lit(0.5);
    match rule {
        Integrator::Euler | Integrator::MidParams => {
            let weights = if rule == Integrator::Euler { tick.begin } else { tick.middle };
            let u = m.weighed(weights);
            let (mu, d_phi) = turned_back(scale(u.w, h), q, mu);
            let (pulled, mut d) = field_back(&u, x, scale(lambda, h));
            d.w = add_scaled(d.w, h, d_phi);
            add_weighed(grad, weights, &d);
            (add(lambda, pulled), mu)
        }
        Integrator::Rk2 => {
            let (a, mid) = (m.weighed(tick.begin), m.weighed(tick.middle));
            let x_m = add_scaled(x, half, a.velocity(x));
            let (mu, d_phi) = turned_back(scale(mid.w, h), q, mu);
            let (to_mid, mut d_mid) = field_back(&mid, x_m, scale(lambda, h));
            d_mid.w = add_scaled(d_mid.w, h, d_phi);
            let (to_begin, d_a) = field_back(&a, x, scale(to_mid, half));
            add_weighed(grad, tick.middle, &d_mid);
            add_weighed(grad, tick.begin, &d_a);
            (add(lambda, add(to_mid, to_begin)), mu)
        }
        Integrator::Rk4 => classical_back(m, tick, (x, q), (lambda, mu), grad),
        Integrator::Se3Mid | Integrator::Se3Magnus4 => {
            let omega = exponent(rule, m, tick);
            let rotation = Rotation::new(omega.w);
            let (mu, d_turn) = product_back(rotation.quaternion(), q, mu);
            let (lambda, v, w) = rotation.carry_back(omega.v, x, lambda, d_turn);
            exponent_back(rule, m, tick, &Twist { v, w }, grad);
            (lambda, mu)
        }
    }
}

/// Cotangents of `turned`: of `q`, and of the rotation vector.
#[inline(always)]
fn turned_back<T: Scalar>(phi: V3<T>, q: [T; 4], mu: [T; 4]) -> ([T; 4], V3<T>) {
    let rotation = Rotation::new(phi);
    let (mu, d_turn) = product_back(rotation.quaternion(), q, mu);
    (mu, rotation.quaternion_back(d_turn))
}

/// Cotangents of `u(x)` from `g`: of `x`, and of the twist.
#[inline(always)]
fn field_back<T: Real>(u: &Twist<T>, x: V3<T>, g: V3<T>) -> (V3<T>, Twist<T>) {
    (cross3(g, u.w), Twist { v: g, w: cross3(x, g) })
}

/// The transpose of [`Motion::weighed`].
#[inline(always)]
fn add_weighed<T: Real>(grad: &mut Motion<T>, weights: [T; 2], d: &Twist<T>) {
    let one = weights[0].lit(1.0);
    grad.twist = grad.twist.add_scaled(one, d);
    grad.rate = grad.rate.add_scaled(weights[0], d);
    grad.jerk = grad.jerk.add_scaled(weights[1], d);
}

#[inline(always)]
fn classical_back<T: Scalar>(
    m: &Motion<T>,
    tick: &Tick<T>,
    (x, q): (V3<T>, [T; 4]),
    (lambda, mu): (V3<T>, [T; 4]),
    grad: &mut Motion<T>,
) -> (V3<T>, [T; 4]) {
    let h = tick.h;
    let (half, sixth, third) = (h * h.lit(0.5), h * h.lit(1.0 / 6.0), h * h.lit(1.0 / 3.0));
    let stages = Classical::new(m, tick, x);
    let (mu, d_phi) = turned_back(scale(stages.twists[1].w, h), q, mu);
    let (to_4, d_4) = field_back(&stages.twists[3], stages.at[3], scale(lambda, sixth));
    let (to_3, d_3) = field_back(&stages.twists[2], stages.at[2], add_scaled(scale(lambda, third), h, to_4));
    let (to_2, mut d_2) = field_back(&stages.twists[1], stages.at[1], add_scaled(scale(lambda, third), half, to_3));
    let (to_1, d_1) = field_back(&stages.twists[0], x, add_scaled(scale(lambda, sixth), half, to_2));
    d_2.w = add_scaled(d_2.w, h, d_phi);
    add_weighed(grad, tick.begin, &d_1);
    add_weighed(grad, tick.middle, &d_2);
    add_weighed(grad, tick.middle, &d_3);
    add_weighed(grad, tick.end, &d_4);
    (add(lambda, add(add(to_1, to_2), add(to_3, to_4))), mu)
}

/// The transpose of [`exponent`].
#[inline(always)]
fn exponent_back<T: Scalar>(rule: Integrator, m: &Motion<T>, tick: &Tick<T>, g: &Twist<T>, grad: &mut Motion<T>) {
    let h = tick.h;
    if rule == Integrator::Se3Mid {
        return add_weighed(grad, tick.middle, &g.scaled(h));
    }
    let mean = m.weighed(tick.mean);
    let rate = m.rate.add_scaled(tick.middle[0], &m.jerk);
    let k = -h * h * h * h.lit(1.0 / 12.0);
    let (d_mean, d_rate) = bracket_back(&mean, &rate, &g.scaled(k));
    add_weighed(grad, tick.mean, &d_mean.add_scaled(h, g));
    grad.rate = grad.rate.add_scaled(h.lit(1.0), &d_rate);
    grad.jerk = grad.jerk.add_scaled(tick.middle[0], &d_rate);
}

/// Cotangents of `[a, b]` from `g`. For `y = p × q`: `g_p = q × g`, `g_q = g × p`.
#[inline(always)]
fn bracket_back<T: Real>(a: &Twist<T>, b: &Twist<T>, g: &Twist<T>) -> (Twist<T>, Twist<T>) {
    let d_a = Twist { v: cross3(b.w, g.v), w: add(cross3(b.v, g.v), cross3(b.w, g.w)) };
    let d_b = Twist { v: cross3(g.v, a.w), w: add(cross3(g.v, a.v), cross3(g.w, a.w)) };
    (d_a, d_b)
}
