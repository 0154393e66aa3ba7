//! Conversions to a smaller type, one for each meaning. Where `clippy::cast_possible_truncation` is on, these stand for `as`.
//!
//! ```
//! use gs_core::cast;
//!
//! assert_eq!((cast::to_f32(0.1), cast::to_f32(1e300)), (0.1f32, f32::INFINITY));
//! assert_eq!([-3.0, 254.9, 300.0, f64::NAN].map(cast::to_u8), [0, 254, 255, 0]);
//! assert_eq!([-3.0f32, 7.9].map(cast::to_usize), [0, 7]);
//! assert_eq!(cast::to_u32(7), 7u32);
//! ```
#![expect(clippy::cast_possible_truncation, reason = "this is the place where it happens")]

/// The nearest `f32`, infinite beyond its range. What is computed in `f64` is stored by it.
#[inline(always)]
pub const fn to_f32(x: f64) -> f32 {
    x as f32
}

/// The integer part as an 8-bit value, clamped to 0 … 255; NaN gives 0. Callers add ½ where they round.
#[inline(always)]
pub fn to_u8(x: impl Into<f64>) -> u8 {
    x.into() as u8
}

/// The integer part as an index or a count; 0 for negative numbers and NaN.
#[inline(always)]
pub fn to_usize(x: impl Into<f64>) -> usize {
    x.into() as usize
}

/// A row number, a side or a count as tables and files hold it: nothing here has 2³² of anything.
#[inline(always)]
pub const fn to_u32(i: usize) -> u32 {
    debug_assert!(i <= u32::MAX as usize);
    i as u32
}
