//! Generated scenes and their mechanics.

mod mechanics;
mod scenes;
