//! Eight splats at a time: [`Real`] for SIMD lanes of `f64`.
//!
//! No operation is fused, so that a lane has the bits of the same formula in scalars, on every instruction set. Functions
//! of lanes are marked `inline(always)` and call neither closures nor `array::map`, into which the instruction set chosen
//! at run time does not reach.

use fearless_simd::{Simd, SimdBase, SimdFloat, f64x8};
use gs_core::Real;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// Splats per vector.
pub(crate) const LANES: usize = 8;

/// Eight independent numbers, one per splat.
#[derive(Clone, Copy)]
pub(crate) struct Lanes<S: Simd>(f64x8<S>);

impl<S: Simd> Lanes<S> {
    #[inline(always)]
    pub(crate) fn load(simd: S, values: [f64; LANES]) -> Self {
        Self(f64x8::load_array(simd, values))
    }

    #[inline(always)]
    pub(crate) fn all<const N: usize>(simd: S, values: [[f64; LANES]; N]) -> [Self; N] {
        let mut all = [Self::load(simd, [0.0; LANES]); N];
        for (to, from) in all.iter_mut().zip(values) {
            *to = Self::load(simd, from);
        }
        all
    }

    #[inline(always)]
    pub(crate) fn to_array(self) -> [f64; LANES] {
        self.0.to_array()
    }

    #[inline(always)]
    pub(crate) fn arrays<const N: usize>(values: [Self; N]) -> [[f64; LANES]; N] {
        let mut arrays = [[0.0; LANES]; N];
        for (to, from) in arrays.iter_mut().zip(values) {
            *to = from.to_array();
        }
        arrays
    }
}

macro_rules! forward {
    ($($trait:ident $name:ident),*) => {$(
        impl<S: Simd> $trait for Lanes<S> {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self($trait::$name(self.0, other.0))
            }
        }
    )*};
}
forward!(Add add, Sub sub, Mul mul, Div div);

impl<S: Simd> Neg for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(-self.0)
    }
}

impl<S: Simd> Real for Lanes<S> {
    #[inline(always)]
    fn lit(self, c: f64) -> Self {
        Self(f64x8::splat(self.0.simd, c))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.sqrt())
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self(self.0.max(other.0))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(self.0.min(other.0))
    }
    #[inline(always)]
    fn select_lt(self, other: Self, then: Self, otherwise: Self) -> Self {
        Self(self.0.simd.select_f64x8(self.0.simd_lt(other.0), then.0, otherwise.0))
    }
}
