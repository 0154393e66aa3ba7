//! Procedural characters: people, and simple bodies with closed forms.
//!
//! Metres, `y` up, facing `+z`. Every part is a closed surface, except those of the [`body`], which together are one; its chart
//! is a rectangle of the atlas with a gutter (caps of the cylinder: disks). Textures are band-limited: a few waves per chart,
//! different for each chart.
//!
//! ```
//! let sphere = gs_texel::figure::sphere(0.5, 8, 16);
//! assert_eq!((sphere.template.vertices.len(), sphere.template.faces.len()), (7 * 16 + 2, 14 * 16));
//! assert!(sphere.template.vertices.iter().all(|v| (v.length() - 0.5).abs() < 1e-6));
//! ```

mod body;
mod build;
mod gown;
mod motion;
mod person;
mod solids;

pub use body::body;
pub use gown::gown;
pub use person::person;
pub use solids::{Cylinder, cylinder, plate, sphere};
