//! The parts of FAGS, and splats left at rest.

mod frequency;
mod still;
mod still_training;
