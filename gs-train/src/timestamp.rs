//! The time a scene is asked for.

use gs_core::Time;

/// A timestamp of a scene: the time, normalised and in seconds.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Timestamp {
    /// Time asked for, normalised and in seconds.
    pub t: Time,
}

impl Timestamp {
    /// The timestamp of a time.
    pub fn new(t: Time) -> Self {
        Self { t }
    }

    /// The timestamp of a normalised time (0: first training image, 1: last).
    pub fn normalised(t: f32) -> Self {
        Self::new(Time { normalised: t, seconds: f64::from(t) })
    }
}
