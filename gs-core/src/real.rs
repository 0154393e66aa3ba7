//! The scalar trait: one formula, written once, serves `f64` references, `f32` code and SIMD lanes.
//!
//! Selection replaces branching, so the same source runs on sixteen lanes at a time. Constants come from [`Real::lit`],
//! which takes its type (and, for SIMD types, the level token) from an existing value.
//!
//! ```
//! use gs_core::real::{Real, cross3, dot3};
//!
//! fn area<T: Real>(a: [T; 3], b: [T; 3]) -> T {
//!     let n = cross3(a, b);
//!     dot3(n, n).sqrt() * a[0].lit(0.5)
//! }
//! assert_eq!(area([3.0f32, 0.0, 0.0], [0.0, 4.0, 0.0]), 6.0);
//! assert_eq!(area([3.0f64, 0.0, 0.0], [0.0, 4.0, 0.0]), 6.0);
//! ```

use std::ops::{Add, Div, Mul, Neg, Sub};

/// A real number, or a vector of independent real numbers (SIMD lanes).
pub trait Real:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// The constant `c` as a value of this type; `self` gives only the type.
    fn lit(self, c: f64) -> Self;
    /// Square root; NaN for negative input.
    fn sqrt(self) -> Self;
    /// The larger of two numbers. Unspecified which if either is NaN.
    fn max(self, other: Self) -> Self;
    /// The smaller of two numbers. Unspecified which if either is NaN.
    fn min(self, other: Self) -> Self;
    /// `self < other ? then : otherwise`, lane by lane.
    fn select_lt(self, other: Self, then: Self, otherwise: Self) -> Self;
    /// `self * a + b`; fused where the hardware does so without cost.
    fn mul_add(self, a: Self, b: Self) -> Self {
        self * a + b
    }
}

macro_rules! impl_real {
    ($t:ty) => {
        impl Real for $t {
            #[inline(always)]
            fn lit(self, c: f64) -> Self {
                c as $t
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                <$t>::sqrt(self)
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                <$t>::max(self, other)
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                <$t>::min(self, other)
            }
            #[inline(always)]
            fn select_lt(self, other: Self, then: Self, otherwise: Self) -> Self {
                if self < other { then } else { otherwise }
            }
        }
    };
}
impl_real!(f32);
impl_real!(f64);

/// Dot product `a · b`.
#[inline(always)]
pub fn dot3<T: Real>(a: [T; 3], b: [T; 3]) -> T {
    a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0]))
}

/// Cross product `a × b`, right-handed.
#[inline(always)]
pub fn cross3<T: Real>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
