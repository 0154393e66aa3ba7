//! Twists, laws of motion, integration, velocity fields and refitted paths.

mod adjoint;
mod hard;
mod law;
mod refit;
mod support;
mod truths;
mod velocity;
