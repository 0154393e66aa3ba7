//! Eight particles at a time: [`Scalar`] for SIMD lanes.

use crate::scalar::{SERIES_F32, Scalar, TERMS_F32};
use fearless_simd::{Simd, SimdBase, SimdFloat, f32x8};
use gs_core::{Real, cast};
use std::ops::{Add, Div, Mul, Neg, Sub};

/// Particles per SIMD block.
pub(crate) const LANES: usize = 8;

/// Eight independent `f32` values, one per particle.
#[derive(Clone, Copy)]
pub(crate) struct Lanes<S: Simd>(pub f32x8<S>);

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
        Self(f32x8::splat(self.0.simd, cast::to_f32(c)))
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
        Self(self.0.simd.select_f32x8(self.0.simd_lt(other.0), then.0, otherwise.0))
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        Self(self.0.mul_add(a.0, b.0))
    }
}

impl<S: Simd> Scalar for Lanes<S> {
    const SERIES: f64 = SERIES_F32;
    const TERMS: usize = TERMS_F32;

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        let mut angles = [0.0; LANES];
        self.0.store_array(&mut angles);
        let mut cosines = [0.0; LANES];
        for (a, c) in angles.iter_mut().zip(&mut cosines) {
            (*a, *c) = a.sin_cos();
        }
        (Self(f32x8::load_array_ref(self.0.simd, &angles)), Self(f32x8::load_array_ref(self.0.simd, &cosines)))
    }

    #[inline(always)]
    fn any_above(self, limit: f64) -> bool {
        self.0.simd.any_true_mask32x8(self.0.simd_gt(f32x8::splat(self.0.simd, cast::to_f32(limit))))
    }
}
