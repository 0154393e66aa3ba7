//! Characters from files: glTF and GLB (rigged, animated), OBJ (a mesh that stands still).
//!
//! One invariant: **any bytes give a character or a typed error**. Files are parsed from memory; what they refer to is
//! read from their own folder only, links followed; every range is checked before it is read; memory is bounded by the
//! bytes present (48 MiB + 64 × size, images by [`Limits`]). What can be mended is mended and counted in
//! [`crate::character::Fallbacks`].
//!
//! | of glTF 2.0 | |
//! |---|---|
//! | read | triangles, strips, fans, indexed or not; sparse and normalised accessors; any number of meshes, primitives, materials, skins and influences; rigid parts (bound to their node); morph targets; STEP, LINEAR, CUBICSPLINE; base colour, colours of vertices where there is no texture, cut-out, wrap modes; `KHR_texture_transform`, `KHR_mesh_quantization` |
//! | passed over | normals and tangents, points and lines, cameras, lights, other parts of materials |
//! | refused by name | Draco, meshopt, KTX2 and every other required extension; matrices with shear |
#![cfg_attr(
    not(test),
    deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, clippy::unreachable)
)]

mod accessors;
mod atlas;
mod buffers;
mod clips;
mod container;
mod error;
mod gltf_in;
mod materials;
mod meshes;
mod nodes;
mod obj_in;
mod weld;

pub use error::CharacterError;

use crate::character::Character;
use buffers::Folder;
use gs_core::io::{Limits, read_file};
use std::path::Path;

/// What to read and how.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReadOptions {
    /// Whether texture coordinates must be there (a texel table needs them).
    pub need_uvs: bool,
    /// Lay the surface out anew, see [`crate::unwrap`]: for meshes without texture coordinates, or whose faces are points of a
    /// palette. Colours stay.
    pub auto_uv: bool,
    /// Give every material its own cell of a grid, where charts of several share `[0, 1]²`.
    pub repack: bool,
    /// Whether textures are read.
    pub textures: bool,
    /// The set of texture coordinates; none: the one the base colour's texture asks for.
    pub uv_set: Option<u32>,
    /// The node whose rotation is the character's heading; none: the lowest common ancestor of the joints.
    pub root_joint: Option<String>,
    /// How much is read.
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

/// Reads a character from a `.glb`, `.gltf` or `.obj` file; the content decides which.
///
/// # Errors
/// Whatever is wrong with the file or what it refers to, see [`CharacterError`].
pub fn load_character(path: &Path, options: &ReadOptions) -> Result<Character, CharacterError> {
    let bytes = read_file(path, &options.limits)?;
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    parse(&bytes, &path.display().to_string(), Some(folder), options)
}

/// Reads a character from memory; it can refer to nothing outside itself. `file` is the name used in errors.
///
/// # Errors
/// As [`load_character`].
pub fn parse_character(bytes: &[u8], file: &str, options: &ReadOptions) -> Result<Character, CharacterError> {
    parse(bytes, file, None, options)
}

fn parse(bytes: &[u8], file: &str, path: Option<&Path>, options: &ReadOptions) -> Result<Character, CharacterError> {
    let folder = Folder { file, path, limits: &options.limits };
    let text = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let is_gltf = bytes.starts_with(b"glTF") || text.trim_ascii_start().starts_with(b"{");
    let (soup, mut character) =
        if is_gltf { gltf_in::read(text, &folder, options)? } else { obj_in::read(text, &folder, options)? };
    weld::weld(soup, &mut character);
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
