//! Training, method by method, on generated scenes of a few dozen pixels.

mod anchored;
mod dut;
mod frequency;
mod hashes;
mod journal;
mod learning;
mod methods;
mod physics;
mod resume;
mod scores;
mod support;
