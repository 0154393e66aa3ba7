//! `scene.json`: frames, splits, template and motion of a film.
//!
//! ```text
//! version 1   units "m"   up "y"   fps   frames {start, count, step}   splits {train, test, ood}: frame numbers
//! template    a glTF, GLB or OBJ file of the folder, or builtin:NAME      uv_set, auto_uv, repack: layout of its texture
//! clip        a motion of the template, or null: at rest                 skinning "lbs" | "dqs"
//! motion      a BVH file of the folder in place of clip, brought to the template's skeleton; null: none
//! motion_names  {node of the template: joint of the motion}, where their names do not tell
//! morph       gt: images show the motion's morphs, poses do not state them; apply: both; ignore: neither
//! background  [0, 0, 0]: colours are black where alpha is 0              generated: options of the generator
//! ```
//! Frame `n` is at `n / fps` seconds of the film and of the motion. Without `splits` all frames train; frames in no
//! list are not read.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use gs_core::io::Limits;
use gs_texel::read::load_motion;
use gs_texel::retarget::retarget;
use gs_texel::{Character, Clip, Pose, ReadOptions, Skinning, load_character};
use serde_json::{Map, Value};

use super::FrameUse;
use crate::avatar::Morphs;
use crate::avatar::{BUILTIN, BUILTINS, builtin};
use crate::error::{DataError, Place};
use crate::files::Root;
use crate::json::{Fields, read_object, whole};

/// Largest file; the lists of a million frames have 7 MB.
const MAX_BYTES: u64 = 8 << 20;
/// Frames without a list of splits.
const MAX_FRAMES: u32 = 1_000_000;
const KEYS: [&str; 18] = [
    "version",
    "units",
    "up",
    "fps",
    "frames",
    "splits",
    "template",
    "uv_set",
    "auto_uv",
    "repack",
    "clip",
    "motion",
    "motion_names",
    "skinning",
    "morph",
    "background",
    "generated",
    "about",
];

/// JSON booleans, for [`choose`].
const WORDS: [(&str, bool); 2] = [("true", true), ("false", false)];

/// The parsed file.
pub(super) struct Manifest {
    pub(super) file: PathBuf,
    pub(super) fps: f64,
    pub(super) skinning: Skinning,
    /// List of each frame that is in one, by number.
    pub(super) lists: BTreeMap<u32, FrameUse>,
    template: String,
    uv_set: Option<u32>,
    auto_uv: bool,
    repack: bool,
    clip: Option<String>,
    motion: Option<String>,
    motion_names: BTreeMap<String, String>,
    morph: Morphs,
}

impl Manifest {
    /// Reads the file.
    ///
    /// # Errors
    /// `io.read`, `limits.file`, `data.syntax`, `data.field`.
    pub(super) fn read(file: &Path) -> Result<Self, DataError> {
        let map = read_object(file, MAX_BYTES)?;
        let f = Fields::new(file, "", &map);
        if let Some(key) = map.keys().find(|k| !KEYS.contains(&k.as_str())) {
            return Err(f.fault(key, "not known", "a misspelt field would be passed over", "correct or remove it"));
        }
        choose(&f, "version", &map, &[("1", ())])?;
        choose(&f, "units", &map, &[("\"m\"", ())])?;
        choose(&f, "up", &map, &[("\"y\"", ())])?;
        if let Some(color) = f.numbers::<3>("background")?.filter(|color| *color != [0.0; 3]) {
            let why = "images are cut out over black: where alpha is 0, so are colours";
            let fix = "give [0, 0, 0]; schedule.background is the colour that training puts behind images";
            return Err(f.fault("background", &format!("{color:?}"), why, fix));
        }
        let fps = f.required_number("fps")?;
        if !(fps > 0.0 && fps < 1e6) {
            return Err(f.fault("fps", &fps.to_string(), "frames per second are above 0", "correct the number"));
        }
        let skinning = [("\"lbs\"", Skinning::Lbs), ("\"dqs\"", Skinning::Dqs)];
        let morphs = [("\"gt\"", Morphs::Gt), ("\"apply\"", Morphs::Apply), ("\"ignore\"", Morphs::Ignore)];
        let no_set = |n: f64| f.fault("uv_set", &n.to_string(), "it is the number of a set", "give 0, 1, … or null");
        let uv_set = f.number("uv_set")?.map(|n| whole(n, 0..=255).ok_or_else(|| no_set(n))).transpose()?;
        Ok(Self {
            file: file.to_path_buf(),
            fps,
            skinning: choose(&f, "skinning", &map, &skinning)?.unwrap_or_default(),
            lists: lists(&f, file, &map)?,
            template: f.required_text("template")?.to_owned(),
            uv_set,
            auto_uv: choose(&f, "auto_uv", &map, &WORDS)?.unwrap_or(false),
            repack: choose(&f, "repack", &map, &WORDS)?.unwrap_or(false),
            clip: f.text("clip")?.map(str::to_owned),
            motion: f.text("motion")?.map(str::to_owned),
            motion_names: partners(&f, &map)?,
            morph: choose(&f, "morph", &map, &morphs)?.unwrap_or(Morphs::Apply),
        })
    }

    fn fault(&self, key: &str, value: &str, why: &'static str, fix: &'static str) -> DataError {
        DataError::Field { place: Place::new(&self.file, key), value: value.into(), why, fix }
    }

    /// The template.
    ///
    /// # Errors
    /// `data.escape` if it lies outside the folder, `data.character` if it cannot be read, `data.field` if it lacks the clip.
    pub(super) fn character(&self, root: &Root) -> Result<Character, DataError> {
        let character = if let Some(name) = self.template.strip_prefix(BUILTIN) {
            builtin(name)
                .ok_or_else(|| self.fault("template", &self.template, "no such character is built in", BUILTINS))?
        } else {
            let file = root.resolve(&self.template, &Place::new(&self.file, "template"))?;
            let Self { uv_set, auto_uv, repack, .. } = *self;
            let options = ReadOptions { need_uvs: true, auto_uv, repack, uv_set, ..ReadOptions::default() };
            load_character(&file, &options).map_err(|source| DataError::Character { file, source: Box::new(source) })?
        };
        if let Some(motion) = &self.motion {
            return self.moved(character, motion, root);
        }
        match &self.clip {
            Some(name) if character.clip(name).is_none() => {
                let known: Vec<&str> = character.clips.iter().map(|c| c.name.as_str()).collect();
                let value = format!("\"{name}\", the template has {known:?}");
                Err(self.fault("clip", &value, "frames are poses of this motion", "name one of its motions, or null"))
            }
            _ => Ok(character),
        }
    }

    /// The template with the motion of a BVH file as its last clip.
    fn moved(&self, mut character: Character, motion: &str, root: &Root) -> Result<Character, DataError> {
        if let Some(clip) = &self.clip {
            return Err(self.fault(
                "clip",
                clip,
                "frames are poses of one motion, and there is a motion, too",
                "give one of them",
            ));
        }
        let file = root.resolve(motion, &Place::new(&self.file, "motion"))?;
        let read = load_motion(&file, &Limits::default());
        let read = read.map_err(|source| DataError::Character { file, source: Box::new(source) })?;
        let moved = retarget(&read.skeleton, &read.clip, &character.skeleton, &self.motion_names);
        let moved = moved.map_err(|e| {
            let fix = "give partners in motion_names: {\"node of the template\": \"joint of the motion\"}";
            self.fault("motion", &format!("{motion}: {e}"), "its joints move those of the template", fix)
        })?;
        character.clips.push(moved.clip);
        Ok(character)
    }

    /// The motion; none: the template is at rest.
    pub(super) fn clip<'a>(&self, character: &'a Character) -> Option<&'a Clip> {
        match &self.motion {
            Some(_) => character.clips.last(),
            None => self.clip.as_ref().and_then(|name| character.clip(name)),
        }
    }

    /// The pose a method may use, of the pose `shown` in the images, and the true morph weights.
    pub(super) fn known(&self, character: &Character, shown: Pose) -> (Pose, Option<Vec<f32>>) {
        let rest = || character.skeleton.rest_morphs.clone();
        match self.morph {
            Morphs::Gt => (Pose { morphs: rest(), locals: shown.locals }, Some(shown.morphs)),
            Morphs::Apply => (shown.clone(), Some(shown.morphs)),
            Morphs::Ignore => (Pose { morphs: rest(), locals: shown.locals }, Some(rest())),
        }
    }
}

/// `motion_names`: nodes of the template with their partners.
fn partners(f: &Fields, map: &Map<String, Value>) -> Result<BTreeMap<String, String>, DataError> {
    let Some(value) = map.get("motion_names").filter(|v| !v.is_null()) else { return Ok(BTreeMap::new()) };
    let wrong = || f.fault("motion_names", &value.to_string(), "it is an object of names", "correct it");
    let names = value.as_object().ok_or_else(wrong)?;
    names.iter().map(|(n, m)| Some((n.clone(), m.as_str()?.to_owned()))).collect::<Option<_>>().ok_or_else(wrong)
}

/// One of several values, if the field is there.
fn choose<T: Copy>(
    f: &Fields,
    key: &str,
    map: &Map<String, Value>,
    known: &[(&str, T)],
) -> Result<Option<T>, DataError> {
    let Some(value) = map.get(key).filter(|v| !v.is_null()) else { return Ok(None) };
    let text = value.to_string();
    let found = known.iter().find(|(name, _)| *name == text).map(|(_, v)| *v);
    found.map(Some).ok_or_else(|| {
        f.fault(
            key,
            &text,
            "only 1 for version, \"m\" for units, \"y\" for up and the values of the layout's page are known",
            "correct it",
        )
    })
}

/// The list of every frame that is in one.
fn lists(f: &Fields, file: &Path, map: &Map<String, Value>) -> Result<BTreeMap<u32, FrameUse>, DataError> {
    let range = Range::read(f, file, map)?;
    let Some(splits) = map.get("splits").filter(|v| !v.is_null()) else {
        return Ok(range.numbers().map(|n| (n, FrameUse::Train)).collect());
    };
    let fault = |at: &str, value: String, why| f.fault(at, &value, why, "correct the list");
    let splits = splits.as_object().ok_or_else(|| fault("splits", splits.to_string(), "it is an object of lists"))?;
    let mut lists = BTreeMap::new();
    let names = [("train", FrameUse::Train), ("test", FrameUse::Test), ("ood", FrameUse::Ood)];
    if let Some(key) = splits.keys().find(|k| names.iter().all(|(n, _)| n != k)) {
        return Err(fault(&format!("splits.{key}"), "not known".into(), "the lists are train, test and ood"));
    }
    for (name, list) in names {
        let Some(numbers) = splits.get(name).filter(|v| !v.is_null()) else { continue };
        let at = format!("splits.{name}");
        let numbers = numbers.as_array();
        let numbers = numbers.ok_or_else(|| fault(&at, splits[name].to_string(), "it is a list of frame numbers"))?;
        for (i, value) in numbers.iter().enumerate() {
            let at = format!("{at}[{i}]");
            let number = value.as_u64().and_then(|n| u32::try_from(n).ok()).filter(|n| range.holds(*n));
            let number = number.ok_or_else(|| fault(&at, value.to_string(), "it is no frame of \"frames\""))?;
            if lists.insert(number, list).is_some() {
                return Err(fault(&at, value.to_string(), "a frame is in one list, once"));
            }
        }
    }
    let count = |list| lists.values().filter(|l| **l == list).count();
    if count(FrameUse::Train) == 1 && lists.len() > 1 {
        let why = "the first and last training frame are times 0 and 1, so there is one or more than two frames in all";
        return Err(fault("splits.train", "one frame".into(), why));
    }
    Ok(lists)
}

/// `start`, `start + step`, …
struct Range {
    start: u32,
    count: u32,
    step: u32,
}

impl Range {
    fn read(f: &Fields, file: &Path, map: &Map<String, Value>) -> Result<Self, DataError> {
        let why = "frames are {start, count, step}";
        let frames = map.get("frames").and_then(Value::as_object);
        let frames = frames.ok_or_else(|| f.fault("frames", "no object", why, "add the field"))?;
        let fields = Fields::new(file, "frames", frames);
        let number = |key: &str, least: u32, usual: f64| {
            let value = fields.number(key)?.unwrap_or(usual);
            let why = "start is a whole number from 0, count and step are from 1, none above a million";
            whole(value, least..=MAX_FRAMES)
                .ok_or_else(|| fields.fault(key, &value.to_string(), why, "correct the number"))
        };
        Ok(Self { start: number("start", 0, 0.0)?, count: number("count", 1, 0.0)?, step: number("step", 1, 1.0)? })
    }

    fn numbers(&self) -> impl Iterator<Item = u32> {
        let (start, step) = (self.start, self.step);
        (0..self.count).map_while(move |k| start.checked_add(k.checked_mul(step)?))
    }

    fn holds(&self, number: u32) -> bool {
        let Some(offset) = number.checked_sub(self.start) else { return false };
        offset.is_multiple_of(self.step) && offset / self.step < self.count
    }
}
