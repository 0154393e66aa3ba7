//! Generated scenes and their mechanics.

mod covisible;
mod mechanics;
mod scenes;
