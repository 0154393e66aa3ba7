//! Timestamps: normalised for deformation fields, in seconds for the physics.
//!
//! ```
//! use gs_core::Time;
//!
//! let t = Time::with_seconds(1.5, 12.0)?; // half a training span after its end: extrapolation
//! assert_eq!((t.normalised, t.seconds), (1.5, 12.0));
//! assert!(Time::new(f32::NAN).is_err());
//! # Ok::<(), gs_core::time::TimeError>(())
//! ```

/// A timestamp of a scene. Fields take `normalised`: 0 at the first training frame, 1 at the last one, or at the end of
/// the whole sequence where its later part is held out. `seconds` is the same timestamp on the data set's clock.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Default)]
pub struct Time {
    /// 0 to 1 over the training span; values outside extrapolate.
    pub normalised: f32,
    /// Seconds on the data set's clock; equals `normalised` where the data give no rate.
    pub seconds: f64,
}

/// Largest magnitude of a normalised time: beyond it an `f32` cannot tell one frame of a second from the next.
const MAX_NORMALISED: f64 = 1e6;

/// A time that is not a number, or a normalised one far beyond the training span.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "time {value} is not finite, or beyond a million training spans; give a number such as 0.25 (0 = first training frame, \
     1 = last)"
)]
pub struct TimeError {
    /// The value that was given.
    pub value: f64,
}

impl Time {
    /// A timestamp whose clock runs 1 second over the training span: `seconds = normalised`.
    ///
    /// # Errors
    /// If the value is not finite or beyond 10⁶.
    pub fn new(normalised: f32) -> Result<Self, TimeError> {
        Self::with_seconds(normalised, f64::from(normalised))
    }

    /// A timestamp from its normalised time and its clock reading in seconds.
    ///
    /// # Errors
    /// If either value is not finite, or the normalised one beyond 10⁶.
    pub fn with_seconds(normalised: f32, seconds: f64) -> Result<Self, TimeError> {
        for (value, most) in [(f64::from(normalised), MAX_NORMALISED), (seconds, f64::MAX)] {
            if value.is_nan() || value.abs() > most {
                return Err(TimeError { value });
            }
        }
        Ok(Self { normalised, seconds })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_finite_times_exist() {
        assert_eq!(Time::new(0.25).unwrap().seconds, 0.25);
        assert!(Time::new(1.5).is_ok(), "extrapolation is legal");
        assert!(Time::new(1e6).is_ok() && Time::new(1.1e6).is_err() && Time::with_seconds(0.0, 1e12).is_ok());
        assert!(Time::new(f32::NAN).is_err() && Time::with_seconds(0.0, f64::INFINITY).is_err());
    }
}
