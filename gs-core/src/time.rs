//! Time, normalised for the fields and in seconds for the physics.

/// A moment of a scene. `normalised` is what fields see: 0 at the first training frame, 1 at the last, or at the end of the whole
/// sequence where a boundary keeps its later part out of training; values outside `[0, 1]` extrapolate. `seconds` is the same moment on the data set's clock.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Default)]
pub struct Time {
    /// 0 … 1 over the training span; may lie outside to extrapolate.
    pub normalised: f32,
    /// Seconds on the data set's clock; equals `normalised` where the data give no rate.
    pub seconds: f64,
}

/// A time that is not a number.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("time {value} is not finite; give a number such as 0.25 (0 = first training frame, 1 = last)")]
pub struct TimeError {
    /// The value met.
    pub value: f64,
}

impl Time {
    /// A normalised time whose clock runs 1 second over the training span.
    ///
    /// # Errors
    /// If the value is not finite.
    pub fn new(normalised: f32) -> Result<Self, TimeError> {
        Self::with_seconds(normalised, f64::from(normalised))
    }

    /// A normalised time with its clock reading.
    ///
    /// # Errors
    /// If either value is not finite.
    pub fn with_seconds(normalised: f32, seconds: f64) -> Result<Self, TimeError> {
        for value in [f64::from(normalised), seconds] {
            if !value.is_finite() {
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
        assert!(Time::new(f32::NAN).is_err() && Time::with_seconds(0.0, f64::INFINITY).is_err());
    }
}
