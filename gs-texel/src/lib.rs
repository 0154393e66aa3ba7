//! Human avatars from few cameras: a skinned template and its poses, the texels of its surface, which view sees which texel,
//! unprojected textures, texel Gaussians, and the two networks of DUT.
//!
//! ```text
//! template ──pose──▶ posed mesh ──unproject──▶ texture ──GeoNet──▶ offsets ──pose──▶ deformed mesh ──unproject──▶ texture
//!                                                                                            ──GauNet──▶ texel Gaussians
//! ```
//! (DUT: "Real-time Free-view Human Rendering from Sparse-view RGB Videos using Double Unprojected Textures".)
//!
//! ```
//! use gs_texel::texels::{TexelOptions, TexelTable};
//! use gs_texel::{Skinning, figure};
//!
//! let person = figure::person();
//! let pose = person.clip("walk").unwrap().pose(&person.skeleton, 0.25);
//! let vertices = person.posed(&pose, Skinning::Lbs);
//! let t = &person.template;
//! let table = TexelTable::build(&t.faces, &t.uvs, &t.face_uvs, 128, &TexelOptions::default())?;
//! // The world position of every valid texel.
//! let points = table.interp_vec3(&t.faces, &vertices);
//! assert_eq!(points.len(), table.len());
//! assert_eq!((table.report.charts, table.report.overlaps), (8, 0));
//! # Ok::<(), gs_texel::texels::TexelError>(())
//! ```
//!
//! # Conventions
//! Cameras, quaternions, pixels and images are those of [`gs_core`]. Lengths are metres where the asset's are. A texture
//! coordinate is `(u, v)` in `[0, 1]²` with row 0 of the texture at `v = 0`, `v` downwards (glTF's; OBJ's is flipped by the
//! reader); texel `(x, y)` of an `S × S` map has its centre at `((x + ½)/S, (y + ½)/S)`.
//!
//! # Features
//! | feature | default | adds |
//! |---|---|---|
//! | `read` | on | [`mod@read`]: characters from glTF, GLB and OBJ, with PNG and JPEG textures |
//! | `exr` | on | [`maps_exr`]: texel maps as layers of an EXR file |
//!
//! # What it leaves out
//! Training of the networks, template fitting, cloth and hair simulation, tangent-space normal maps.
#![warn(unreachable_pub)]

pub mod bvh;
pub mod character;
pub mod clip;
mod coverage;
pub mod figure;
pub mod gaunet;
pub mod gaussians;
pub mod geonet;
pub mod inpaint;
#[cfg(feature = "exr")]
pub mod maps_exr;
mod neighbours;
pub mod net;
#[cfg(feature = "read")]
pub mod read;
pub mod retarget;
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
#[cfg(feature = "read")]
pub use read::{CharacterError, ReadOptions, load_character, parse_character};
pub use skeleton::{Joint, Node, Pose, Skeleton, Trs};
pub use skin::Skinning;
pub use template::{Material, Morph, SkinWeights, Template, Wrap};
