//! `gs4d pose`: the mesh of a rigged character at a time of one of its motions.

use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use gs_core::io::write_file;
use gs_texel::write_mesh::{write_obj, write_ply};
use gs_texel::{Character, CharacterError, ReadOptions, Skinning, load_character};
use serde_json::json;
use std::path::PathBuf;

/// Pose a rigged character (glTF, GLB, OBJ) and write its mesh in world space
#[derive(clap::Args)]
pub struct PoseVerb {
    /// The character: .glb, .gltf or .obj.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Name of the motion [default: the pose at rest].
    #[arg(long, value_name = "NAME")]
    clip: Option<String>,
    /// Seconds into the motion; before its first key and after its last it stands still.
    #[arg(long, value_name = "T", default_value_t = 0.0, requires = "clip", allow_hyphen_values = true)]
    time: f64,
    /// How joints are blended: matrices, or dual quaternions.
    #[arg(long, value_enum, default_value_t = Blend::Lbs)]
    skinning: Blend,
    /// The mesh to write, .obj or .ply.
    #[arg(short, long, value_name = "OUT")]
    out: PathBuf,
    /// Overwrite an existing file.
    #[arg(short, long)]
    force: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Blend {
    Lbs,
    Dqs,
}

impl From<CharacterError> for Failure {
    fn from(e: CharacterError) -> Self {
        let text = e.to_string();
        let (class, id) = match e {
            CharacterError::Io(e) => return e.into(),
            CharacterError::TooMuch { .. } => (Class::Resource, "limits.character"),
            CharacterError::Path { .. } => (Class::Data, "data.path"),
            CharacterError::Unsupported { .. } => (Class::Data, "data.unsupported"),
            _ => (Class::Data, "data.character"),
        };
        Self::new(class, id, text)
    }
}

impl PoseVerb {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let extension = self.out.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
        let write = match extension.as_deref() {
            Some("obj") => write_obj,
            Some("ply") => write_ply,
            _ => {
                let what = format!("{} is neither .obj nor .ply", self.out.display());
                return Err(Failure::usage(what).remedy("end the name after -o in .obj or .ply"));
            }
        };
        if !self.time.is_finite() {
            return Err(Failure::usage(format!("--time {} is no time", self.time)).remedy("give seconds"));
        }
        let character = load_character(&self.file, &ReadOptions { textures: false, ..ReadOptions::default() })?;
        for (what, count) in character.fallbacks.list() {
            global.say(format_args!("{}: {what}: {count}", self.file.display()));
        }
        let pose = match &self.clip {
            None => character.skeleton.rest_pose(),
            Some(name) => {
                let clip = character.clip(name).ok_or_else(|| no_clip(name, &character))?;
                clip.pose(&character.skeleton, self.time)
            }
        };
        let skinning = if self.skinning == Blend::Dqs { Skinning::Dqs } else { Skinning::Lbs };
        let posed = character.posed(&pose, skinning);
        if posed.iter().any(|p| !p.is_finite()) {
            return Err(Failure::new(Class::Numeric, "numeric", "the posed mesh is not finite")
                .place(self.file.display())
                .remedy("look for extreme scales and translations in its nodes and clips"));
        }
        write_file(&self.out, self.force, |out| write(&character, &posed, out))?;
        let (vertices, triangles) = (character.source_vertices.len(), character.template.faces.len());
        let text = format!("{vertices} vertices, {triangles} triangles -> {}\n", self.out.display());
        let json = json!({
            "file": self.out,
            "vertices": vertices,
            "welded": character.template.vertices.len(),
            "triangles": triangles,
            "joints": character.skeleton.joints.len(),
            "clips": character.clips.iter().map(|c| json!({"name": c.name, "seconds": c.duration()})).collect::<Vec<_>>(),
            "fallbacks": character.fallbacks,
        });
        Ok(Answer::new(text, json))
    }
}

fn no_clip(name: &str, character: &Character) -> Failure {
    let names: Vec<String> = character.clips.iter().map(|c| format!("`{}`", c.name)).collect();
    let there = if names.is_empty() { "it has none".to_owned() } else { format!("it has {}", names.join(", ")) };
    Failure::usage(format!("the character has no clip `{name}`"))
        .remedy(format!("{there}; leave --clip out for the pose at rest"))
}
