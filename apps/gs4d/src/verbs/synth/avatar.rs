//! `gs4d synth avatar`: films a rigged character.

use crate::answer::Answer;
use crate::failure::Failure;
use crate::global::Global;
use gs_data::avatar::BUILTIN;
use gs_synth::avatar::{Atlas, AvatarOptions, Light, Morphs, write};
use serde_json::json;
use std::path::Path;

/// Name of the scene.
pub const NAME: &str = "avatar";
/// One line for the list of scenes.
pub const ABOUT: &str = "a rigged character, built in or from a glTF file, filmed by rings of cameras while it moves";
/// Default ambient share of a light.
const AMBIENT: f64 = 0.3;

/// Whether images and poses include morph targets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum MorphFlag {
    /// Images show them, poses do not know them: offsets to be found.
    Gt,
    /// Images show them and poses know them.
    Apply,
    /// Neither.
    Ignore,
}

/// Flags of the scene "avatar".
#[derive(clap::Args)]
#[command(next_help_heading = "Scene \"avatar\"")]
pub struct AvatarFlags {
    /// The character: builtin, builtin:NAME (person, body, gown, sphere, cylinder, plate), or a glTF or GLB file [default: builtin].
    #[arg(long, value_name = "builtin|FILE")]
    template: Option<String>,
    /// Lay the character's surface out anew, colours kept [default: where its file's atlas will not do].
    #[arg(long, conflicts_with = "repack")]
    auto_uv: bool,
    /// Give every material a cell of its own in the atlas [default: where they share places].
    #[arg(long)]
    repack: bool,
    /// The motion [default: the character's first].
    #[arg(long, value_name = "NAME")]
    clip: Option<String>,
    /// Cameras in each ring (a multiple of 4) and rings (1 to 3) [default: 8x2].
    #[arg(long, value_name = "NxRINGS", value_parser = rings)]
    cams: Option<[u32; 2]>,
    /// Frames [default: 24].
    #[arg(long, value_name = "N")]
    frames: Option<u32>,
    /// Frames per second [default: such that the frames span the motion].
    #[arg(long, value_name = "RATE")]
    fps: Option<f64>,
    /// Every N-th frame is for tests alone [default: none].
    #[arg(long, value_name = "N")]
    test_every: Option<u32>,
    /// What becomes of morph targets [default: gt].
    #[arg(long, value_enum)]
    morph: Option<MorphFlag>,
    /// The morph targets that the motion moves, the others stay at rest [default: all].
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    only_morphs: Vec<String>,
    /// A light from direction X,Y,Z; AMBIENT is what a point that faces away gets [default: no light, ambient 0.3].
    #[arg(long, value_name = "X,Y,Z[,AMBIENT]", value_parser = light, allow_hyphen_values = true)]
    light: Option<Light>,
    /// The character casts shadows on itself.
    #[arg(long, requires = "light")]
    shadows: bool,
    /// Points of the true surface at each frame [default: 20000].
    #[arg(long, value_name = "N")]
    points: Option<u32>,
    /// Samples per pixel along each axis, 4 to 16 [default: 4].
    #[arg(long, value_name = "K")]
    supersample: Option<u32>,
}

/// Flags of all scenes that this one has, too.
pub struct Shared {
    pub size: Option<u32>,
    pub seed: u64,
    pub truth: bool,
    pub force: bool,
}

/// `8x2`.
fn rings(text: &str) -> Result<[u32; 2], String> {
    let wrong = || "give cameras in each ring and rings, for example 8x2".to_owned();
    let (n, rings) = text.split_once('x').ok_or_else(wrong)?;
    Ok([n.trim().parse().map_err(|_| wrong())?, rings.trim().parse().map_err(|_| wrong())?])
}

/// `x,y,z` or `x,y,z,ambient`.
pub fn light(text: &str) -> Result<Light, String> {
    let number = |part: &str| part.trim().parse::<f64>().ok().filter(|v| v.is_finite());
    let numbers: Option<Vec<f64>> = text.split(',').map(number).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) => Ok(Light { direction: [x, y, z], ambient: AMBIENT, shadows: false }),
        Some(&[x, y, z, ambient]) => Ok(Light { direction: [x, y, z], ambient, shadows: false }),
        _ => Err("give a direction and perhaps a share, for example 1,2,1 or 1,2,1,0.3".to_owned()),
    }
}

impl AvatarFlags {
    /// The first flag that was given.
    pub fn given(&self) -> Option<&'static str> {
        let flags = [
            ("--template", self.template.is_some()),
            ("--auto-uv", self.auto_uv),
            ("--repack", self.repack),
            ("--clip", self.clip.is_some()),
            ("--cams", self.cams.is_some()),
            ("--frames", self.frames.is_some()),
            ("--fps", self.fps.is_some()),
            ("--test-every", self.test_every.is_some()),
            ("--morph", self.morph.is_some()),
            ("--only-morphs", !self.only_morphs.is_empty()),
            ("--light", self.light.is_some()),
            ("--shadows", self.shadows),
            ("--points", self.points.is_some()),
            ("--supersample", self.supersample.is_some()),
        ];
        flags.into_iter().find(|(_, given)| *given).map(|(flag, _)| flag)
    }

    fn options(&self, size: Option<u32>, seed: u64) -> AvatarOptions {
        let default = AvatarOptions::default();
        let template = match self.template.as_deref() {
            None | Some("builtin") => default.template.clone(),
            Some(name) => name.to_owned(),
        };
        let [per_ring, rings] = self.cams.unwrap_or([default.per_ring, default.rings]);
        let morph = self.morph.map_or(default.morph, |m| match m {
            MorphFlag::Gt => Morphs::Gt,
            MorphFlag::Apply => Morphs::Apply,
            MorphFlag::Ignore => Morphs::Ignore,
        });
        let atlas = match (self.auto_uv, self.repack) {
            (true, _) => Atlas::Anew,
            (_, true) => Atlas::Repack,
            _ => default.atlas,
        };
        AvatarOptions {
            template,
            atlas,
            clip: self.clip.clone(),
            per_ring,
            rings,
            frames: self.frames.unwrap_or(default.frames),
            fps: self.fps,
            test_every: self.test_every.unwrap_or(default.test_every),
            size: size.unwrap_or(default.size),
            supersample: self.supersample.unwrap_or(default.supersample),
            morph,
            only_morphs: self.only_morphs.clone(),
            light: self.light.map(|light| Light { shadows: self.shadows, ..light }),
            points: self.points.unwrap_or(default.points),
            seed,
            ..default
        }
    }

    /// Films the character.
    pub fn run(&self, out: &Path, shared: Shared, global: &Global) -> Result<Answer, Failure> {
        let Shared { size, seed, truth, force } = shared;
        let options = self.options(size, seed);
        let data = write(out, &options, truth, force)?;
        data.notes.iter().filter(|n| n.starts_with("template:")).for_each(|note| global.say(note));
        let cond = data.avatar.as_ref().map_or(0, |a| a.input_count());
        let (train, test) = (data.train.len(), data.test.len());
        let who = options.template.strip_prefix(BUILTIN).unwrap_or(&options.template);
        let text = format!(
            "{}  {who}: {} frames, {} cameras ({cond} conditioning), {train} training, {test} test views of {size}x{size}{}\n",
            out.display(),
            options.frames,
            options.per_ring * options.rings,
            if truth { "; depth, normals and positions in gt/" } else { "" },
            size = options.size,
        );
        let json = json!({
            "path": out.display().to_string(), "scene": NAME, "layout": "avatar", "options": options,
            "views": [train, 0, test], "conditioning_cameras": cond,
        });
        Ok(Answer::new(text, json))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values() {
        assert_eq!(rings("8x2"), Ok([8, 2]));
        assert!(["8", "x2", "8x", "8x-1", "8x2x3"].iter().all(|t| rings(t).is_err()));
        assert_eq!(light("1,-2,0.5"), Ok(Light { direction: [1.0, -2.0, 0.5], ambient: AMBIENT, shadows: false }));
        assert_eq!(light("0,1,0,0.1").map(|l| l.ambient), Ok(0.1));
        assert!(["", "1,2", "1,2,nan", "1,2,3,4,5"].iter().all(|t| light(t).is_err()));
    }
}
