//! Characters made here, no file needed: a person, and the simple bodies that closed forms are known for.
//!
//! Metres, `y` up, facing `+z`. Every part is a closed surface; its chart is a rectangle of the atlas, a gutter away from
//! its neighbours (caps of the cylinder: disks). Textures are band-limited: a few waves per chart, each chart its own.

mod build;
mod person;
mod solids;

pub use person::person;
pub use solids::{Cylinder, cylinder, plate, sphere};
