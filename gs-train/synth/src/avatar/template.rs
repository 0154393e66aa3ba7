//! Characters by name or file, with an atlas that covers the whole surface without overlap.

use std::path::PathBuf;

use gs_texel::texels::{TexelError, TexelOptions, TexelTable};
use gs_texel::{Character, ReadOptions, Template, load_character};
use serde::{Deserialize, Serialize};

use super::wrong;
use gs_data::DataError;
use gs_data::avatar::{BUILTIN, BUILTINS, builtin};

/// Share of the surface that an atlas must cover; otherwise it is replaced.
const MIN_COVERED: f64 = 0.5;
/// Side of the texel table in which overlap is searched.
const OVERLAP_SIDE: usize = 512;

/// Layout of the texture atlas of a template from a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Atlas {
    /// That of the file if it covers the surface without overlap, else [`Self::Repack`], else [`Self::Anew`].
    #[default]
    Auto,
    /// The texture coordinates of the file, as they are.
    Painted,
    /// The texture coordinates of the file, each material in a cell of its own.
    Repack,
    /// New texture coordinates for all faces.
    Anew,
}

impl Atlas {
    fn options(self) -> ReadOptions {
        let (repack, auto_uv) = (self == Self::Repack, self == Self::Anew);
        ReadOptions { repack, auto_uv, ..ReadOptions::default() }
    }
}

/// A template, the layout of its atlas and, if that is not the one of the file, the reason.
pub(super) struct Chosen {
    pub character: Character,
    pub atlas: Atlas,
    pub why: Option<String>,
}

/// Reads a template and chooses the layout of its atlas.
pub(super) fn choose(template: &str, asked: Atlas) -> Result<Chosen, DataError> {
    if let Some(name) = template.strip_prefix(BUILTIN) {
        let character =
            builtin(name).ok_or_else(|| wrong("template", template, format!("{BUILTINS}, or a glTF or GLB file")))?;
        return Ok(Chosen { character, atlas: Atlas::Painted, why: None });
    }
    let file = PathBuf::from(template);
    let load = |atlas: Atlas| {
        let failed = |source| DataError::Character { file: file.clone(), source: Box::new(source) };
        load_character(&file, &ReadOptions { need_uvs: asked != Atlas::Auto, ..atlas.options() }).map_err(failed)
    };
    if asked != Atlas::Auto {
        return Ok(Chosen { character: load(asked)?, atlas: asked, why: None });
    }
    let character = load(Atlas::Painted)?;
    let Some(fault) = fault(&character.template) else {
        return Ok(Chosen { character, atlas: Atlas::Painted, why: None });
    };
    if fault.shared {
        let repacked = load(Atlas::Repack)?;
        if self::fault(&repacked.template).is_none() {
            let why = format!("{}: every material gets a cell of its own", fault.what);
            return Ok(Chosen { character: repacked, atlas: Atlas::Repack, why: Some(why) });
        }
    }
    let why = format!("{}: it is laid out anew", fault.what);
    Ok(Chosen { character: load(Atlas::Anew)?, atlas: Atlas::Anew, why: Some(why) })
}

/// Why an atlas cannot be used.
struct Fault {
    what: String,
    /// Whether faces of several materials may overlap each other.
    shared: bool,
}

fn fault(template: &Template) -> Option<Fault> {
    let placed = placed(template);
    if placed < MIN_COVERED {
        let what = format!("{:.0} % of its surface has no place in its atlas", 100.0 * (1.0 - placed));
        return Some(Fault { what, shared: false });
    }
    let table =
        TexelTable::build(&template.faces, &template.uvs, &template.face_uvs, OVERLAP_SIDE, &TexelOptions::default());
    let first = template.face_materials.first();
    let shared = template.face_materials.iter().any(|m| Some(m) != first);
    match table {
        Ok(_) => None,
        Err(TexelError::Overlap { overlaps, valid, .. }) => {
            let share = 100.0 * overlaps as f64 / valid as f64;
            Some(Fault { what: format!("faces overlap in {share:.1} % of its atlas"), shared })
        }
        Err(e) => Some(Fault { what: e.to_string(), shared }),
    }
}

/// Share of the surface whose faces have an area inside the atlas.
fn placed(template: &Template) -> f64 {
    let (mut all, mut inside) = (0.0, 0.0);
    for (f, face) in template.faces.iter().enumerate() {
        let [a, b, c] = face.map(|v| template.vertices[v as usize].as_dvec3());
        let area = (b - a).cross(c - a).length();
        all += area;
        let Some(corners) = template.face_uvs.get(f).map(|f| f.map(|k| template.uvs[k as usize].as_dvec2())) else {
            continue;
        };
        let [a, b, c] = corners;
        let middle = (a + b + c) / 3.0;
        let has_area = (b - a).perp_dot(c - a).abs() > 1e-9;
        if has_area && middle.min_element() >= 0.0 && middle.max_element() <= 1.0 {
            inside += area;
        }
    }
    if all > 0.0 { inside / all } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::testkit::shared;

    #[test]
    fn palettes_are_laid_out_anew_and_atlases_stay() {
        let Some(folder) = shared("data/gltf_public") else { return };
        let chosen = |name: &str| choose(folder.join(name).to_str().unwrap(), Atlas::Auto).unwrap();
        for name in ["KayKit_Knight.glb", "kenney_character_rigid_parts/character.glb"] {
            let c = chosen(name);
            assert_eq!(c.atlas, Atlas::Anew, "{name}: {:?}", c.why);
            assert!(fault(&c.character.template).is_none());
            assert!(placed(&c.character.template) > 0.99, "{name}");
        }
        let man = chosen("CesiumMan.glb");
        assert_eq!((man.atlas, man.why), (Atlas::Painted, None));
    }

    #[test]
    fn built_in_characters_have_their_atlas() {
        for name in ["person", "body", "gown", "sphere", "cylinder", "plate"] {
            let c = choose(&format!("{BUILTIN}{name}"), Atlas::Auto).unwrap();
            assert!(fault(&c.character.template).is_none() && placed(&c.character.template) > 0.99, "{name}");
        }
    }
}
