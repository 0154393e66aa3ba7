//! Training, method by method, on generated scenes of a few dozen pixels.

mod ground_truth;
mod hashes;
mod journal;
mod learning;
mod methods;
mod ranks;
mod resume;
mod road;
mod scores;
mod settings;
mod support;
