//! From outputs of the network to motions, and the way back.
//!
//! ```text
//! twist12    (v̄, w | ā, ε | j_v, j_w | w_b)            six numbers per order, three for a turn of the body's own
//! centre15   (P_c, v_c, w | a_c, ε)
//! gvfi13     (P_c, v_c, w | a_c, e)                     ε = e w / √(|w|² + κ²)
//! free       (v, w)                                     P_c = x, v_c = v
//!
//! v̄ = v_c − w × P_c     ā = a_c − ε × P_c − w × v_c     j_v = −2 ε × v_c − w × a_c  (third order)      (1)
//! ```
//! The own turn `w_b`, which passes `a |a| / 10` so that it stays small where nothing tells of it, is one about the middle `m` of what moves, a place of this moment:
//! ```text
//! w += w_b     v̄ −= w_b × m     ā −= w_b × u(m)         u(m) = v̄ + w × m without w_b                       (2)
//! ```
//! All are the network's outputs times a gain, about the origin of the law. Behind the bar stand derivatives, which pass the
//! map of accelerations. (1) is the
//! derivative of `v̄(t) = v_c(t) − w(t) × P_c(t)`; the paper's `ā` leaves out `−w × v_c`, as if the centre stood still.

use super::config::{AccelMap, LawConfig, LawForm};
use crate::twist::{Motion, Twist};
use crate::vec3::{V3, add, add_scaled, scale, sub};
use gs_core::Real;
use gs_core::real::{cross3, dot3};
use std::ops::Range;

/// Most outputs of any form.
pub(crate) const MAX_OUTPUTS: usize = 21;

/// `κ` of gvfi13, radians per unit of time: below it the axis fades away.
const AXIS_FLOOR: f64 = 1e-3;

/// How the outputs of a row are read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Form {
    kind: LawForm,
    order: u8,
    literal: bool,
    own_turn: bool,
    /// How each output is mapped.
    maps: [OutputMap; MAX_OUTPUTS],
}

/// How one output is read: times a gain, and perhaps `a |a| / 10` of that.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
struct OutputMap {
    gain: f64,
    squared: bool,
}

/// A body by its centre, as far as one particle sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Hub<T> {
    /// Relative to the origin of the law.
    pub position: V3<T>,
    pub velocity: V3<T>,
    pub acceleration: V3<T>,
    pub w: V3<T>,
    pub spin: V3<T>,
}

impl<T: Real> Hub<T> {
    fn zero(like: T) -> Self {
        let o = [like.lit(0.0); 3];
        Self { position: o, velocity: o, acceleration: o, w: o, spin: o }
    }

    /// Equation (1) up to an order.
    fn motion(&self, order: u8, literal: bool) -> Motion<T> {
        let Self { position, velocity, acceleration, w, spin } = *self;
        let o = [w[0].lit(0.0); 3];
        let printed = sub(acceleration, cross3(spin, position));
        let rate = if literal { printed } else { sub(printed, cross3(w, velocity)) };
        let third = scale(add_scaled(cross3(w, acceleration), w[0].lit(2.0), cross3(spin, velocity)), w[0].lit(-1.0));
        Motion {
            twist: Twist { v: sub(velocity, cross3(w, position)), w },
            rate: Twist { v: if order > 1 { rate } else { o }, w: if order > 1 { spin } else { o } },
            jerk: Twist { v: if order > 2 && !literal { third } else { o }, w: o },
        }
    }

    /// Cotangents of [`Hub::motion`]. For `y = a × b`: `g_a = b × g`, `g_b = g × a`.
    fn motion_back(&self, order: u8, literal: bool, d: &Motion<T>) -> Self {
        let (minus, minus_two) = (self.w[0].lit(-1.0), self.w[0].lit(-2.0));
        let mut out = Self::zero(minus);
        let g = d.twist.v;
        out.velocity = g;
        out.w = sub(d.twist.w, cross3(self.position, g));
        out.position = cross3(self.w, g);
        if order > 1 {
            let g = d.rate.v;
            out.acceleration = g;
            out.spin = sub(d.rate.w, cross3(self.position, g));
            out.position = add(out.position, cross3(self.spin, g));
            if !literal {
                out.w = sub(out.w, cross3(self.velocity, g));
                out.velocity = add(out.velocity, cross3(self.w, g));
            }
        }
        if order > 2 && !literal {
            let g = d.jerk.v;
            out.spin = add_scaled(out.spin, minus_two, cross3(self.velocity, g));
            out.velocity = add_scaled(out.velocity, minus_two, cross3(g, self.spin));
            out.w = add_scaled(out.w, minus, cross3(self.acceleration, g));
            out.acceleration = add_scaled(out.acceleration, minus, cross3(g, self.w));
        }
        out
    }
}

fn triple<T: Real>(y: &[T], at: usize) -> V3<T> {
    [y[at], y[at + 1], y[at + 2]]
}

/// `(1 / n, ŵ)` with `n = √(|w|² + κ²)`, `ŵ = w / n`.
pub(super) fn axis<T: Real>(w: V3<T>) -> (T, V3<T>) {
    let floor = w[0].lit(AXIS_FLOOR * AXIS_FLOOR);
    let inverse = w[0].lit(1.0) / (dot3(w, w) + floor).sqrt();
    (inverse, scale(w, inverse))
}

/// Equation (2): `motion` with a turn `own` about `middle` added.
fn turned<T: Real>(motion: Motion<T>, own: V3<T>, middle: V3<T>, order: u8) -> Motion<T> {
    let mut m = motion;
    let carried = m.twist.velocity(middle);
    m.twist = Twist { v: sub(m.twist.v, cross3(own, middle)), w: add(m.twist.w, own) };
    if order > 1 {
        m.rate.v = sub(m.rate.v, cross3(own, carried));
    }
    m
}

/// Cotangents of the motion and of the turn in [`turned`]. For `y = a × b`: `g_a = b × g`, `g_b = g × a`.
fn turned_back<T: Real>(motion: &Motion<T>, own: V3<T>, middle: V3<T>, order: u8, d: &Motion<T>) -> (Motion<T>, V3<T>) {
    let mut d_motion = *d;
    let mut d_own = sub(d.twist.w, cross3(middle, d.twist.v));
    if order > 1 {
        let (g, carried) = (d.rate.v, motion.twist.velocity(middle));
        d_own = sub(d_own, cross3(carried, g));
        let d_carried = cross3(own, g);
        d_motion.twist.v = add(d_motion.twist.v, d_carried);
        d_motion.twist.w = add(d_motion.twist.w, cross3(middle, d_carried));
    }
    (d_motion, d_own)
}

impl Form {
    pub fn new(config: &LawConfig) -> Self {
        let order = if config.form == LawForm::Free { 1 } else { config.order };
        let own_turn = config.own_turn && config.form == LawForm::Twist12;
        let (kind, literal, maps) = (config.form, config.literal, [OutputMap::default(); MAX_OUTPUTS]);
        let mut form = Self { kind, order, literal, own_turn, maps };
        let spin_order = if config.spin_order == 0 { order } else { config.spin_order };
        for i in 0..form.outputs().0 {
            let rate = form.rates().contains(&i);
            let factor = match form.turns(i) {
                true if rate && form.order_of(i) > spin_order => 0.0,
                true => f64::from(config.spin_gain),
                false => 1.0,
            };
            let squared = form.own(i) || (config.accel == AccelMap::SignedSq10 && rate);
            form.maps[i] = OutputMap { gain: f64::from(config.gain) * factor, squared };
        }
        form
    }

    pub fn literal(&self) -> bool {
        self.literal
    }

    /// Values per row, and how many of them are of the first order.
    pub fn outputs(&self) -> (usize, usize) {
        let order = usize::from(self.order);
        match self.kind {
            LawForm::Twist12 => (6 * order + if self.own_turn { 3 } else { 0 }, 6),
            LawForm::Centre15 => (if order > 1 { 15 } else { 9 }, 9),
            LawForm::Gvfi13 => (if order > 1 { 13 } else { 9 }, 9),
            LawForm::Free => (6, 6),
        }
    }

    /// Whether a closed form carries particles ([`arc`](super::arc)) instead of an integrator.
    pub fn is_closed(&self) -> bool {
        matches!(self.kind, LawForm::Gvfi13 | LawForm::Free)
    }

    /// The first output of the own turn.
    fn own_at(&self) -> usize {
        6 * usize::from(self.order)
    }

    /// The outputs that are derivatives.
    pub fn rates(&self) -> Range<usize> {
        let (all, first) = self.outputs();
        first..if self.own_turn { self.own_at() } else { all }
    }

    /// Whether output `i` is of the own turn.
    fn own(&self, i: usize) -> bool {
        self.own_turn && i >= self.own_at()
    }

    /// Whether output `i` says how particles turn.
    fn turns(&self, i: usize) -> bool {
        match self.kind {
            LawForm::Twist12 | LawForm::Free => i % 6 >= 3 || i >= self.own_at(),
            LawForm::Centre15 | LawForm::Gvfi13 => (6..9).contains(&i) || i >= 12,
        }
    }

    /// The order of motion that output `i`, a derivative, belongs to.
    fn order_of(&self, i: usize) -> u8 {
        if self.kind == LawForm::Twist12 { i as u8 / 6 + 1 } else { 2 }
    }

    /// Outputs times their gains, derivatives mapped; the rest of the array is 0.
    pub fn mapped<T: Real>(&self, y: &[T]) -> [T; MAX_OUTPUTS] {
        let mut out = [y[0].lit(0.0); MAX_OUTPUTS];
        for ((o, &v), map) in out.iter_mut().zip(y).zip(&self.maps) {
            let v = v * v.lit(map.gain);
            *o = if map.squared { v * v.max(-v) * v.lit(0.1) } else { v };
        }
        out
    }

    /// The way back of [`Form::mapped`], in place.
    pub fn mapped_back<T: Real>(&self, y: &[T], d: &mut [T]) {
        for ((d, &v), map) in d.iter_mut().zip(y).zip(&self.maps) {
            *d = *d * v.lit(map.gain);
            if map.squared {
                *d = *d * v.max(-v) * v.lit(0.2 * map.gain);
            }
        }
    }

    /// The centre that mapped outputs speak of, for a particle at `x` about the origin.
    pub fn centre<T: Real>(&self, m: &[T; MAX_OUTPUTS], x: V3<T>) -> Hub<T> {
        let o = [x[0].lit(0.0); 3];
        if self.kind == LawForm::Free {
            return Hub { position: x, velocity: triple(m, 0), acceleration: o, w: triple(m, 3), spin: o };
        }
        let w = triple(m, 6);
        let spin = if self.kind == LawForm::Gvfi13 { scale(axis(w).1, m[12]) } else { triple(m, 12) };
        Hub { position: triple(m, 0), velocity: triple(m, 3), acceleration: triple(m, 9), w, spin }
    }

    /// The twist that mapped outputs speak of, without the own turn.
    fn twist<T: Real>(&self, m: &[T; MAX_OUTPUTS]) -> Motion<T> {
        let kept = if self.own_turn { self.own_at() } else { MAX_OUTPUTS };
        Motion::from_array(std::array::from_fn(|i| if i < kept { m[i] } else { m[i].lit(0.0) }))
    }

    /// The motion of a particle at `x`, from the network's outputs `y`; `middle` is that of what moves. Both about the origin.
    pub fn motion<T: Real>(&self, y: &[T], x: V3<T>, middle: V3<T>) -> Motion<T> {
        let m = self.mapped(y);
        match self.kind {
            LawForm::Twist12 if self.own_turn => turned(self.twist(&m), triple(&m, self.own_at()), middle, self.order),
            LawForm::Twist12 => self.twist(&m),
            // A free particle is a body with its centre in the particle: its path is the straight line to any order.
            LawForm::Free => self.centre(&m, x).motion(2, false),
            _ => self.centre(&m, x).motion(self.order, self.literal),
        }
    }

    /// Cotangents of the outputs from those of [`Form::motion`], for the forms that an integrator carries.
    pub fn motion_back<T: Real>(&self, y: &[T], middle: V3<T>, d: &Motion<T>, d_y: &mut [T]) {
        if self.kind == LawForm::Twist12 && self.own_turn {
            let (m, at) = (self.mapped(y), self.own_at());
            let (twist, own) = turned_back(&self.twist(&m), triple(&m, at), middle, self.order, d);
            d_y[..at].iter_mut().zip(twist.to_array()).for_each(|(to, from)| *to = from);
            d_y[at..].copy_from_slice(&own);
        } else if self.kind == LawForm::Twist12 {
            d_y.iter_mut().zip(d.to_array()).for_each(|(to, from)| *to = from);
        } else {
            let centre = self.centre(&self.mapped(y), [y[0].lit(0.0); 3]);
            let d = centre.motion_back(self.order, self.literal, d);
            let all = [d.position, d.velocity, d.w, d.acceleration, d.spin];
            d_y.iter_mut().zip(all.into_iter().flatten()).for_each(|(to, from)| *to = from);
        }
        self.mapped_back(y, d_y);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::centre::{Centre, Reduction};
    use gs_core::Rng;

    /// Up to the rate it is [`Centre`]; the third order is the second derivative of `v_c(t) − w(t) × P_c(t)`.
    #[test]
    fn motions_of_hubs_are_those_of_centres() {
        let mut rng = Rng::new(1, "hubs", 0, 0);
        let mut random = || -> V3<f64> { std::array::from_fn(|_| f64::from(rng.normal())) };
        for _ in 0..50 {
            let [position, velocity, acceleration] = [random(), random(), random()];
            let hub = Hub { position, velocity, acceleration, w: random(), spin: random() };
            let centre = Centre { at: position, velocity, acceleration, w: hub.w, spin_up: hub.spin };
            for (literal, reduction) in [(false, Reduction::Exact), (true, Reduction::Paper)] {
                let (got, want) = (hub.motion(2, literal), centre.motion(reduction));
                for (got, want) in got.to_array().iter().zip(want.to_array()) {
                    assert!((got - want).abs() < 1e-13, "{got} {want}");
                }
            }
            let v = |t: f64| {
                let at = add_scaled(add_scaled(position, t, velocity), 0.5 * t * t, acceleration);
                sub(add_scaled(velocity, t, acceleration), cross3(add_scaled(hub.w, t, hub.spin), at))
            };
            let h = 1e-3;
            let bent = scale(sub(add(v(h), v(-h)), scale(v(0.0), 2.0)), 1.0 / (h * h));
            for (got, want) in hub.motion(3, false).jerk.v.iter().zip(bent) {
                assert!((got - want).abs() < 1e-7, "{got} {want}");
            }
        }
    }
}
