//! One texel, forward and backward, in `f32` for production and in `f64` as its reference.

use super::affine;
use super::channels::{OFFSET, OPACITY, QUAT, SCALE};
use super::decode::Covariance;
use crate::skin::raw_quat;
use gs_core::Real;
use gs_core::rot::{self, Mat3};

/// A [`Real`] with an exponential: `f32` or `f64`.
pub trait Number: Real + PartialOrd {
    /// `e^self`.
    fn exp(self) -> Self;
    /// The value in `f64`.
    fn wide(self) -> f64;
}

impl Number for f32 {
    fn exp(self) -> Self {
        f32::exp(self)
    }
    fn wide(self) -> f64 {
        f64::from(self)
    }
}

impl Number for f64 {
    fn exp(self) -> Self {
        f64::exp(self)
    }
    fn wide(self) -> f64 {
        self
    }
}

/// One row of a [`super::TexelBase`].
#[derive(Clone, Copy, Debug)]
pub struct Base<T> {
    /// `c`: point of the deformed bind pose, metres.
    pub point: [T; 3],
    /// `R`: linear part of the skinning matrix, by rows.
    pub linear: Mat3<T>,
    /// `τ`: translation of the skinning matrix.
    pub translation: [T; 3],
    /// `q_R`: unit quaternion `(w, x, y, z)` of the rotation of `R`.
    pub rotation: [T; 4],
    /// `κ`: factor on all standard deviations.
    pub kappa: T,
}

/// One texel's Gaussian, or its cotangents.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gaussian<T> {
    /// Mean `μ` in the world, metres.
    pub mean: [T; 3],
    /// Quaternion `(w, x, y, z)`.
    pub quat: [T; 4],
    /// Standard deviations along the three axes, metres.
    pub scale: [T; 3],
    /// Opacity `α`, 0 to 1.
    pub opacity: T,
}

/// `1/(1 + e^−x)`, without overflow.
fn sigmoid<T: Number>(x: T) -> T {
    let one = x.lit(1.0);
    // e^−88 is the smallest that f32 can hold.
    one / (one + (-x).min(x.lit(88.0)).exp())
}

/// `ŝ` clamped to its range, and its derivative: 1 inside, 0 outside.
fn clamp<T: Number>(x: T, [low, high]: [f64; 2]) -> (T, T) {
    let (low, high) = (x.lit(low), x.lit(high));
    let inside = x >= low && x <= high;
    (x.max(low).min(high), x.lit(if inside { 1.0 } else { 0.0 }))
}

fn take<T: Copy, const N: usize>(row: &[T], from: usize) -> [T; N] {
    std::array::from_fn(|i| row[from + i])
}

fn apply<T: Number>(m: &Mat3<T>, v: [T; 3]) -> [T; 3] {
    m.map(|r| gs_core::real::dot3(r, v))
}

fn transposed<T: Copy>(m: &Mat3<T>) -> Mat3<T> {
    std::array::from_fn(|r| std::array::from_fn(|c| m[c][r]))
}

fn has_length<T: Number>(raw: &rot::UnitQuat<T>) -> bool {
    raw.free > raw.free.lit(0.5)
}

/// `r` normalised, and `r̂`: the identity, without a gradient, where `r` has length 0.
fn unit_quat<T: Number>(row: &[T]) -> (rot::UnitQuat<T>, [T; 4]) {
    let raw = rot::normalise(take::<T, 4>(row, QUAT.start));
    let identity = [1.0, 0.0, 0.0, 0.0].map(|v| raw.free.lit(v));
    (raw, if has_length(&raw) { raw.wxyz } else { identity })
}

/// The standard deviations before skinning, `exp(clamp ŝ) κ`, with the derivative by `ŝ` of each.
fn scales<T: Number>(row: &[T], base: &Base<T>, range: [f64; 2]) -> [[T; 3]; 2] {
    let clamped = take::<T, 3>(row, SCALE.start).map(|x| clamp(x, range));
    let scale = clamped.map(|(x, _)| x.exp() * base.kappa);
    [scale, std::array::from_fn(|i| scale[i] * clamped[i].1)]
}

/// The axes under `q = q_R ⊗ r̂` of any length, whose matrix is `(1 − |q|²) I + |q|² Rot(q/|q|)` (3DGS's rasteriser).
fn raw_axes<T: Number>(base: &Base<T>, unit: [T; 4], scale: [T; 3]) -> affine::Axes {
    const IDENTITY: Mat3<f64> = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let turn = raw_quat(&base.linear.map(|r| r.map(T::wide)));
    affine::Axes::of(&IDENTITY, rot::hamilton(turn, unit.map(T::wide)), scale.map(T::wide))
}

/// The Gaussian of a row of channels. `range` bounds the log-scales before κ.
pub fn decode<T: Number>(row: &[T], base: &Base<T>, covariance: Covariance, range: [f64; 2]) -> Gaussian<T> {
    let offset: [T; 3] = take(row, OFFSET.start);
    let moved = apply(&base.linear, std::array::from_fn(|i| base.point[i] + offset[i]));
    let mean = std::array::from_fn(|i| moved[i] + base.translation[i]);
    let (_, unit) = unit_quat(row);
    let [scale, _] = scales(row, base, range);
    let opacity = sigmoid(row[OPACITY]);
    let (quat, scale) = match covariance {
        Covariance::Polar => (rot::hamilton(base.rotation, unit), scale),
        Covariance::Affine => {
            let axes = affine::Axes::of(&base.linear, unit, scale);
            let (quat, scale) = axes.gaussian();
            let lit = |v: f64| base.kappa.lit(v);
            (quat.map(lit), scale.map(lit))
        }
        Covariance::Raw => {
            let (quat, scale) = raw_axes(base, unit, scale).gaussian();
            let lit = |v: f64| base.kappa.lit(v);
            (quat.map(lit), scale.map(lit))
        }
    };
    Gaussian { mean, quat, scale, opacity }
}

/// Backward of [`decode`]: adds the gradient of the row to `grad` and returns `dL/dc`, which equals `dL/dd`.
pub fn backward<T: Number>(
    row: &[T],
    base: &Base<T>,
    covariance: Covariance,
    range: [f64; 2],
    d: &Gaussian<T>,
    grad: &mut [T],
) -> [T; 3] {
    let d_point = apply(&transposed(&base.linear), d.mean);
    let (raw, unit) = unit_quat(row);
    let [scale, slope] = scales(row, base, range);
    let (d_unit, d_scale) = match covariance {
        Covariance::Polar => {
            let [w, x, y, z] = base.rotation;
            (rot::hamilton([w, -x, -y, -z], d.quat), d.scale)
        }
        Covariance::Affine => {
            let axes = affine::Axes::of(&base.linear, unit, scale);
            let (d_unit, d_scale) = axes.backward(d.quat.map(T::wide), d.scale.map(T::wide));
            let lit = |v: f64| base.kappa.lit(v);
            (d_unit.map(lit), d_scale.map(lit))
        }
        Covariance::Raw => {
            let (d_quat, d_scale) = raw_axes(base, unit, scale).backward(d.quat.map(T::wide), d.scale.map(T::wide));
            let [w, x, y, z] = raw_quat(&base.linear.map(|r| r.map(T::wide)));
            let lit = |v: f64| base.kappa.lit(v);
            (rot::hamilton([w, -x, -y, -z], d_quat).map(lit), d_scale.map(lit))
        }
    };
    let opacity = sigmoid(row[OPACITY]);
    let mut add = |at: usize, v: T| grad[at] = grad[at] + v;
    (0..3).for_each(|i| add(SCALE.start + i, d_scale[i] * slope[i]));
    let d_raw = rot::normalise_backward(&raw, d_unit);
    (0..4).filter(|_| has_length(&raw)).for_each(|i| add(QUAT.start + i, d_raw[i]));
    add(OPACITY, d.opacity * opacity * (opacity.lit(1.0) - opacity));
    (0..3).for_each(|i| add(OFFSET.start + i, d_point[i]));
    d_point
}
