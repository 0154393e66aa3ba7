//! Number kinds that rotations are computed in.

use gs_core::{Real, cast};

/// A [`Real`] with sine and cosine: `f64` for references, `f32`, or lanes of `f32` in the roll-out.
pub(crate) trait Scalar: Real {
    /// Squared angle up to which rotations use series in `θ²` instead of sine and cosine, so that nothing cancels.
    const SERIES: f64;
    /// Number of terms of those series.
    const TERMS: usize;
    /// `(sin, cos)` of an angle in radians.
    fn sin_cos(self) -> (Self, Self);
    /// Whether the value, or any lane of it, lies above `limit`.
    fn any_above(self, limit: f64) -> bool;
}

impl Scalar for f64 {
    // Ten terms leave 1/23! of the last series; closed forms lose three bits just above.
    const SERIES: f64 = 1.0;
    const TERMS: usize = 10;

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        f64::sin_cos(self)
    }

    #[inline(always)]
    fn any_above(self, limit: f64) -> bool {
        self > limit
    }
}

/// `θ²` of half a turn per step: hardly any step exceeds it, so eight lanes rarely call library sines.
pub(crate) const SERIES_F32: f64 = 9.8;
/// Eight terms leave an error of 7e-10 at that angle.
pub(crate) const TERMS_F32: usize = 8;

impl Scalar for f32 {
    const SERIES: f64 = SERIES_F32;
    const TERMS: usize = TERMS_F32;

    #[inline(always)]
    fn sin_cos(self) -> (Self, Self) {
        f32::sin_cos(self)
    }

    #[inline(always)]
    fn any_above(self, limit: f64) -> bool {
        self > cast::to_f32(limit)
    }
}
