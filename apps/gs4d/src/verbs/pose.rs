//! `gs4d pose`: the mesh of a rigged character at a time of one of its motions.

use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use gs_core::io::{Limits, write_file};
use gs_texel::read::load_motion;
use gs_texel::retarget::retarget;
use gs_texel::write_mesh::{write_obj, write_ply};
use gs_texel::{Character, CharacterError, Clip, ReadOptions, Skeleton, Skinning, load_character};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Pose a rigged character (glTF, GLB, OBJ) and write its mesh in world space
#[derive(clap::Args)]
pub struct PoseVerb {
    /// The character: .glb, .gltf or .obj.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Name of the motion [default: the pose at rest].
    #[arg(long, value_name = "NAME")]
    clip: Option<String>,
    /// A motion in a BVH file, brought to the character's skeleton: joints correspond by their names or by the part of the body
    /// that these mean.
    #[arg(long, value_name = "BVH", conflicts_with = "clip")]
    motion: Option<PathBuf>,
    /// A joint of the character and its partner in the motion, where names do not tell (repeatable).
    #[arg(long, value_name = "JOINT=PARTNER", requires = "motion", value_parser = pair)]
    partner: Vec<(String, String)>,
    /// Seconds into the motion; before its first key and after its last it stands still.
    #[arg(long, value_name = "T", default_value_t = 0.0, allow_hyphen_values = true)]
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
        if self.time != 0.0 && self.clip.is_none() && self.motion.is_none() {
            return Err(Failure::usage("--time is of a motion, and none is given").remedy("give --clip or --motion"));
        }
        let mut character = load_character(&self.file, &ReadOptions { textures: false, ..ReadOptions::default() })?;
        for (what, count) in character.fallbacks.list() {
            global.say(format_args!("{}: {what}: {count}", self.file.display()));
        }
        if let Some(motion) = &self.motion {
            character.clips.insert(0, self.moved(motion, &character, global)?);
        }
        let pose = match &self.clip {
            None if self.motion.is_some() => character.clips[0].pose(&character.skeleton, self.time),
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

impl PoseVerb {
    /// The motion of a BVH file on the character's skeleton.
    fn moved(&self, file: &Path, character: &Character, global: &Global) -> Result<Clip, Failure> {
        let motion = load_motion(file, &Limits::default())?;
        let names = self.partner.iter().cloned().collect();
        let moved = retarget(&motion.skeleton, &motion.clip, &character.skeleton, &names).map_err(|e| {
            Failure::new(Class::Data, "data.motion", e.to_string())
                .place(file.display())
                .remedy("give partners: --partner JOINT=PARTNER, a joint of the character and one of the motion")
        })?;
        let name = |s: &Skeleton, n: u32| s.nodes[n as usize].name.clone();
        let pairs: Vec<String> = moved
            .partners
            .iter()
            .map(|&(n, m)| format!("{} = {}", name(&character.skeleton, n), name(&motion.skeleton, m)))
            .collect();
        let seconds = motion.clip.duration();
        global.say(format_args!("{}: {seconds:.2} s, {} joints: {}", file.display(), pairs.len(), pairs.join(", ")));
        Ok(Clip { name: file.display().to_string(), ..moved.clip })
    }
}

/// Two names with an equals sign between them.
fn pair(text: &str) -> Result<(String, String), String> {
    let (a, b) = text.split_once('=').ok_or("JOINT=PARTNER is needed")?;
    Ok((a.trim().into(), b.trim().into()))
}

fn no_clip(name: &str, character: &Character) -> Failure {
    let names: Vec<String> = character.clips.iter().map(|c| format!("`{}`", c.name)).collect();
    let there = if names.is_empty() { "it has none".to_owned() } else { format!("it has {}", names.join(", ")) };
    Failure::usage(format!("the character has no clip `{name}`"))
        .remedy(format!("{there}; leave --clip out for the pose at rest"))
}
