//! What a moment of a scene offers to a method.

use gs_core::Time;

/// A moment: the time, always. Body poses and input views join it where the data have them.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Moment {
    /// When.
    pub t: Time,
}

impl Moment {
    /// The moment at time `t`.
    pub fn new(t: Time) -> Self {
        Self { t }
    }
}
