//! From the network's outputs to motions, with backward.
//!
//! ```text
//! twist12    (v̄, w | ā, ε | j_v, j_w | w_b)            six numbers per order, three for the own turn w_b
//! centre15   (P_c, v_c, w | a_c, ε)                     twists by equation (1) of `centre`
//! gvfi13     (P_c, v_c, w | a_c, e)                     ε = e w / √(|w|² + κ²)
//! free       (v, w)                                     P_c = x, v_c = v
//! ```
//! All are the network's outputs times a gain, about the origin of the law. Those behind the first bar are derivatives and
//! pass the map of accelerations. The own turn `w_b` is a rotation about the centroid `m` of the moving particles at this
//! time; it passes `a |a| / 10`, which keeps it small where nothing supervises it:
//! ```text
//! w += w_b     v̄ −= w_b × m     ā −= w_b × u(m)         u(m) = v̄ + w × m without w_b                       (2)
//! ```

use super::config::{AccelMap, LawConfig, LawForm};
use crate::centre::{BodyState, Reduction};
use crate::twist::{Motion, Twist};
use crate::vec3::{V3, add, scale, sub};
use gs_core::Real;
use gs_core::real::{cross3, dot3};
use std::ops::Range;

/// Largest number of outputs of any form.
pub(crate) const MAX_OUTPUTS: usize = 21;

/// `κ` of gvfi13, radians per unit of time; below it the axis fades to zero.
const AXIS_FLOOR: f64 = 1e-3;

/// How the outputs of a row are interpreted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Form {
    kind: LawForm,
    order: u8,
    reduction: Reduction,
    own_turn: bool,
    /// One map per output.
    maps: [OutputMap; MAX_OUTPUTS],
}

/// An output times a gain, and where `squared` `a |a| / 10` of that.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
struct OutputMap {
    gain: f64,
    squared: bool,
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

/// Equation (2): `motion` with a rotation `own` about `centroid` added.
fn with_own_turn<T: Real>(motion: Motion<T>, own: V3<T>, centroid: V3<T>, order: u8) -> Motion<T> {
    let mut m = motion;
    let carried = m.twist.velocity(centroid);
    m.twist = Twist { v: sub(m.twist.v, cross3(own, centroid)), w: add(m.twist.w, own) };
    if order > 1 {
        m.rate.v = sub(m.rate.v, cross3(own, carried));
    }
    m
}

/// Cotangents of `motion` and `own` in [`with_own_turn`]. For `y = a × b`: `g_a = b × g`, `g_b = g × a`.
fn with_own_turn_backward<T: Real>(
    motion: &Motion<T>,
    own: V3<T>,
    centroid: V3<T>,
    order: u8,
    d: &Motion<T>,
) -> (Motion<T>, V3<T>) {
    let mut d_motion = *d;
    let mut d_own = sub(d.twist.w, cross3(centroid, d.twist.v));
    if order > 1 {
        let (g, carried) = (d.rate.v, motion.twist.velocity(centroid));
        d_own = sub(d_own, cross3(carried, g));
        let d_carried = cross3(own, g);
        d_motion.twist.v = add(d_motion.twist.v, d_carried);
        d_motion.twist.w = add(d_motion.twist.w, cross3(centroid, d_carried));
    }
    (d_motion, d_own)
}

impl Form {
    pub(crate) fn new(config: &LawConfig) -> Self {
        let order = if config.form == LawForm::Free { 1 } else { config.order };
        let own_turn = config.own_turn && config.form == LawForm::Twist12;
        let reduction = if config.literal { Reduction::Paper } else { Reduction::Exact };
        let maps = [OutputMap::default(); MAX_OUTPUTS];
        let mut form = Self { kind: config.form, order, reduction, own_turn, maps };
        let spin_order = if config.spin_order == 0 { order } else { config.spin_order };
        for i in 0..form.outputs().0 {
            let rate = form.rates().contains(&i);
            let factor = match form.is_angular(i) {
                true if rate && form.order_of(i) > usize::from(spin_order) => 0.0,
                true => f64::from(config.spin_gain),
                false => 1.0,
            };
            let squared = form.is_own_turn(i) || (config.accel == AccelMap::SignedSq10 && rate);
            form.maps[i] = OutputMap { gain: f64::from(config.gain) * factor, squared };
        }
        form
    }

    /// Whether formulas are those that the papers print.
    pub(crate) fn literal(&self) -> bool {
        self.reduction == Reduction::Paper
    }

    /// Outputs per row, and how many of them are of the first order.
    pub(crate) fn outputs(&self) -> (usize, usize) {
        let order = usize::from(self.order);
        match self.kind {
            LawForm::Twist12 => (6 * order + if self.own_turn { 3 } else { 0 }, 6),
            LawForm::Centre15 => (if order > 1 { 15 } else { 9 }, 9),
            LawForm::Gvfi13 => (if order > 1 { 13 } else { 9 }, 9),
            LawForm::Free => (6, 6),
        }
    }

    /// Whether particles follow a closed form ([`arc`](super::arc)) instead of an integrator.
    pub(crate) fn is_closed(&self) -> bool {
        matches!(self.kind, LawForm::Gvfi13 | LawForm::Free)
    }

    /// The first output of the own turn.
    fn own_at(&self) -> usize {
        6 * usize::from(self.order)
    }

    /// The outputs that are derivatives by time.
    pub(crate) fn rates(&self) -> Range<usize> {
        let (all, first) = self.outputs();
        first..if self.own_turn { self.own_at() } else { all }
    }

    /// Whether output `i` belongs to the own turn.
    fn is_own_turn(&self, i: usize) -> bool {
        self.own_turn && i >= self.own_at()
    }

    /// Whether output `i` is angular (a rotation vector or a derivative of one).
    fn is_angular(&self, i: usize) -> bool {
        match self.kind {
            LawForm::Twist12 | LawForm::Free => i % 6 >= 3 || i >= self.own_at(),
            LawForm::Centre15 | LawForm::Gvfi13 => (6..9).contains(&i) || i >= 12,
        }
    }

    /// The order of motion that output `i`, a derivative, belongs to.
    fn order_of(&self, i: usize) -> usize {
        if self.kind == LawForm::Twist12 { i / 6 + 1 } else { 2 }
    }

    /// Outputs times their gains, derivatives mapped; the rest of the array is 0.
    pub(crate) fn mapped<T: Real>(&self, y: &[T]) -> [T; MAX_OUTPUTS] {
        let mut out = [y[0].lit(0.0); MAX_OUTPUTS];
        for ((o, &v), map) in out.iter_mut().zip(y).zip(&self.maps) {
            let v = v * v.lit(map.gain);
            *o = if map.squared { v * v.max(-v) * v.lit(0.1) } else { v };
        }
        out
    }

    /// Backward of [`Form::mapped`], in place.
    pub(crate) fn mapped_backward<T: Real>(&self, y: &[T], d: &mut [T]) {
        for ((d, &v), map) in d.iter_mut().zip(y).zip(&self.maps) {
            *d = *d * v.lit(map.gain);
            if map.squared {
                *d = *d * v.max(-v) * v.lit(0.2 * map.gain);
            }
        }
    }

    /// The body that mapped outputs describe, for a particle at `x` about the origin.
    pub(crate) fn body<T: Real>(&self, m: &[T; MAX_OUTPUTS], x: V3<T>) -> BodyState<T> {
        let o = [x[0].lit(0.0); 3];
        if self.kind == LawForm::Free {
            let (velocity, w) = (triple(m, 0), triple(m, 3));
            return BodyState { position: x, velocity, acceleration: o, w, angular_acceleration: o };
        }
        let w = triple(m, 6);
        let angular_acceleration = if self.kind == LawForm::Gvfi13 { scale(axis(w).1, m[12]) } else { triple(m, 12) };
        let (position, velocity, acceleration) = (triple(m, 0), triple(m, 3), triple(m, 9));
        BodyState { position, velocity, acceleration, w, angular_acceleration }
    }

    /// The motion of mapped outputs of [`LawForm::Twist12`], without the own turn.
    fn twist<T: Real>(&self, m: &[T; MAX_OUTPUTS]) -> Motion<T> {
        let kept = if self.own_turn { self.own_at() } else { MAX_OUTPUTS };
        Motion::from_array(std::array::from_fn(|i| if i < kept { m[i] } else { m[i].lit(0.0) }))
    }

    /// The motion of a particle at `x` from the network's outputs `y`; `centroid` is that of the moving particles. Both
    /// positions are about the origin.
    pub(crate) fn motion<T: Real>(&self, y: &[T], x: V3<T>, centroid: V3<T>) -> Motion<T> {
        let m = self.mapped(y);
        match self.kind {
            LawForm::Twist12 if self.own_turn => {
                with_own_turn(self.twist(&m), triple(&m, self.own_at()), centroid, self.order)
            }
            LawForm::Twist12 => self.twist(&m),
            // A free particle is the centre of its own body: its path is a straight line to any order.
            LawForm::Free => self.body(&m, x).motion(2, Reduction::Exact),
            // The twist of an arc has a rate even at constant velocities, and ends with the jerk unless both are accelerated.
            LawForm::Gvfi13 => self.body(&m, x).motion(3, Reduction::Exact),
            LawForm::Centre15 => self.body(&m, x).motion(self.order, self.reduction),
        }
    }

    /// Cotangents of the outputs from those of [`Form::motion`], for the forms that an integrator advances.
    pub(crate) fn motion_backward<T: Real>(&self, y: &[T], centroid: V3<T>, d: &Motion<T>, d_y: &mut [T]) {
        if self.kind == LawForm::Twist12 && self.own_turn {
            let (m, at) = (self.mapped(y), self.own_at());
            let (twist, own) = with_own_turn_backward(&self.twist(&m), triple(&m, at), centroid, self.order, d);
            d_y[..at].iter_mut().zip(twist.to_array()).for_each(|(to, from)| *to = from);
            d_y[at..].copy_from_slice(&own);
        } else if self.kind == LawForm::Twist12 {
            d_y.iter_mut().zip(d.to_array()).for_each(|(to, from)| *to = from);
        } else {
            let body = self.body(&self.mapped(y), [y[0].lit(0.0); 3]);
            let d = body.motion_backward(self.order, self.reduction, d);
            let all = [d.position, d.velocity, d.w, d.acceleration, d.angular_acceleration];
            d_y.iter_mut().zip(all.into_iter().flatten()).for_each(|(to, from)| *to = from);
        }
        self.mapped_backward(y, d_y);
    }
}
