//! People from few cameras: a skinned template, its pose, the texels of its surface, which camera sees which texel, and
//! what the cameras say about it.
//!
//! ```text
//! template ──pose──▶ posed mesh ──unproject──▶ texture ──GeoNet──▶ offsets ──pose──▶ deformed mesh ──unproject──▶ texture
//!                                                                                            ──GauNet──▶ texel Gaussians
//! ```
//! (DUT: "Real-time Free-view Human Rendering from Sparse-view RGB Videos using Double Unprojected Textures".)
//!
//! # Conventions
//! Cameras, quaternions, pixels and images are those of [`gs_core`]. Lengths are metres where the asset's are. A texture
//! coordinate is `(u, v)` in `[0, 1]²` with row 0 of the texture at `v = 0`, `v` downwards (glTF's; OBJ's is turned when
//! read); texel `(x, y)` of an `S × S` map has its centre at `((x + ½)/S, (y + ½)/S)`.

pub mod bvh;
pub mod character;
pub mod clip;
mod coverage;
pub mod figure;
pub mod gaunet;
pub mod gaussians;
pub mod geonet;
pub mod inpaint;
pub mod maps_exr;
pub mod net;
pub mod read;
pub mod scale_refine;
pub mod skeleton;
pub mod skin;
pub mod surface;
pub mod surface_loss;
pub mod template;
pub mod texels;
pub mod unproject;
pub mod unwrap;
pub mod visibility;
pub mod write_mesh;
pub mod zbuffer;

pub use character::{Character, Fallbacks};
pub use clip::Clip;
pub use gaunet::{GauNet, GauNetConfig, GauNetTape};
pub use geonet::{GeoNet, GeoNetConfig, GeoNetTape};
pub use read::{CharacterError, ReadOptions, load_character, parse_character};
pub use skeleton::{Joint, Node, Pose, Skeleton, Trs};
pub use skin::Skinning;
pub use template::{Material, Morph, SkinWeights, Template, Wrap};
