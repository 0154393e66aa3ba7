//! Sums and products of 3-vectors and quaternions kept as arrays, for any [`Real`]. No closures: inside SIMD code they
//! would lose the instruction set.

use gs_core::Real;

pub(crate) type V3<T> = [T; 3];

#[inline(always)]
pub(crate) fn add<T: Real>(a: V3<T>, b: V3<T>) -> V3<T> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
pub(crate) fn sub<T: Real>(a: V3<T>, b: V3<T>) -> V3<T> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(crate) fn scale<T: Real>(a: V3<T>, s: T) -> V3<T> {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// `a + s b` by fused multiply-adds.
#[inline(always)]
pub(crate) fn add_scaled<T: Real>(a: V3<T>, s: T, b: V3<T>) -> V3<T> {
    [s.mul_add(b[0], a[0]), s.mul_add(b[1], a[1]), s.mul_add(b[2], a[2])]
}

/// `√(a · a)`, the Euclidean length.
#[inline(always)]
pub(crate) fn norm<T: Real>(a: V3<T>) -> T {
    gs_core::real::dot3(a, a).sqrt()
}

#[inline(always)]
pub(crate) fn dot4<T: Real>(a: [T; 4], b: [T; 4]) -> T {
    a[3].mul_add(b[3], a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0])))
}

#[inline(always)]
pub(crate) fn scale4<T: Real>(a: [T; 4], s: T) -> [T; 4] {
    [a[0] * s, a[1] * s, a[2] * s, a[3] * s]
}
