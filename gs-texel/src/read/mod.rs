//! Readers of characters: glTF and GLB (rigged, animated), OBJ (a static mesh on one joint); and of motions: BVH.
//!
//! One invariant: **any bytes give a character or a typed error**. Files are parsed from memory. Referenced files must lie in
//! the same folder, also after links are resolved. Every range is checked before it is read. Memory is bounded by the bytes
//! present (48 MiB + 64 × size; images by [`Limits`]). Repairs are counted in [`crate::character::Fallbacks`].
//!
//! | of glTF 2.0 | |
//! |---|---|
//! | read | triangles, strips, fans, indexed or not; sparse and normalised accessors; any number of meshes, primitives, materials, skins and influences; rigid parts (bound to their node); morph targets; STEP, LINEAR, CUBICSPLINE; base colour, colours of vertices where there is no texture, cut-out, wrap modes; `KHR_texture_transform`, `KHR_mesh_quantization` |
//! | ignored | normals and tangents, points and lines, cameras, lights, other parts of materials |
//! | refused by name | Draco, meshopt, KTX2 and every other required extension; matrices with shear |
//!
//! Vertices have the unit of the scene (glTF: metres). Where joints at rest scale them (centimetres under a node of scale 0.01), vertices and
//! morph offsets are multiplied by the median of these scales, and bind matrices divided by it. Triangles of mirrored rigid parts are turned over.
#![cfg_attr(
    not(test),
    deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, clippy::unreachable)
)]

mod accessors;
mod atlas;
mod buffers;
mod bvh_in;
mod clips;
mod container;
mod error;
mod gltf_in;
mod materials;
mod meshes;
mod nodes;
mod obj_in;
mod weld;

pub use buffers::percent_decoded;
pub use bvh_in::{Motion, load_motion, parse_motion};
pub use error::CharacterError;

use crate::character::Character;
use buffers::Folder;
use gs_core::io::{Limits, read_file};
use std::path::Path;

/// What [`load_character`] demands of a file, and how much memory it may use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReadOptions {
    /// Whether a mesh without texture coordinates is an error (a texel table needs them). Default: no.
    pub need_uvs: bool,
    /// Whether to make a new atlas ([`crate::unwrap`]): for meshes without texture coordinates, or whose faces are points of a
    /// palette. Colours are kept. Default: no.
    pub auto_uv: bool,
    /// Whether every material gets its own cell of a grid, where charts of several overlap in `[0, 1]²`. Default: no.
    pub repack: bool,
    /// Whether textures and OBJ material files are read. Default: yes.
    pub textures: bool,
    /// The set of texture coordinates to read. Default: that of the base colour texture.
    pub uv_set: Option<u32>,
    /// Name of the node whose rotation is the character's heading. Default: the lowest common ancestor of the joints.
    pub root_joint: Option<String>,
    /// Limits on bytes, expansion and image memory.
    pub limits: Limits,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self {
            need_uvs: false,
            auto_uv: false,
            repack: false,
            textures: true,
            uv_set: None,
            root_joint: None,
            limits: Limits::default(),
        }
    }
}

/// Reads a character from a `.glb`, `.gltf` or `.obj` file. The format is detected from the content.
///
/// # Errors
/// If the file or one it refers to is invalid, see [`CharacterError`].
pub fn load_character(path: &Path, options: &ReadOptions) -> Result<Character, CharacterError> {
    let bytes = read_file(path, &options.limits)?;
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    parse(&bytes, &path.display().to_string(), Some(folder), options)
}

/// Reads a character from memory; references to other files are errors. `file` is the name used in errors.
///
/// # Errors
/// As [`load_character`].
///
/// ```
/// use gs_texel::{ReadOptions, parse_character};
///
/// let obj = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n";
/// let t = parse_character(obj, "triangle.obj", &ReadOptions::default())?.template;
/// assert_eq!((t.vertices.len(), t.faces.as_slice()), (3, &[[0, 1, 2]][..]));
/// // `v` is flipped: OBJ counts it upwards.
/// assert_eq!(t.uvs[0].to_array(), [0.0, 1.0]);
/// # Ok::<(), gs_texel::CharacterError>(())
/// ```
pub fn parse_character(bytes: &[u8], file: &str, options: &ReadOptions) -> Result<Character, CharacterError> {
    parse(bytes, file, None, options)
}

fn parse(bytes: &[u8], file: &str, path: Option<&Path>, options: &ReadOptions) -> Result<Character, CharacterError> {
    let folder = Folder { file, path, limits: &options.limits };
    let text = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let is_gltf = bytes.starts_with(b"glTF") || text.trim_ascii_start().starts_with(b"{");
    let (mesh, mut character) =
        if is_gltf { gltf_in::read(text, &folder, options)? } else { obj_in::read(text, &folder, options)? };
    weld::weld(mesh, &mut character);
    let template = &mut character.template;
    if template.faces.is_empty() {
        return Err(CharacterError::Empty { file: file.into() });
    }
    atlas::lay_out(template, options);
    if options.need_uvs && template.face_uvs.is_empty() {
        return Err(CharacterError::NoUv { file: file.into(), what: "a mesh of the scene".into() });
    }
    atlas::count_flat(template, &mut character.fallbacks);
    Ok(character)
}
