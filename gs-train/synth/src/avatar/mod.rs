//! Generated films of a person: a built-in or a glTF character, filmed by rings of cameras while it moves.
//!
//! The data set is that of the layout `avatar`, in memory or as a folder ([`write()`]): multi-view pictures with alpha,
//! poses, and points of the true surface. With [`Morphs::Gt`] the pictures show morph targets that the poses do not know of:
//! offsets in the bind pose whose truth is exact. Everything is a function of the options alone.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::Vec3;
use gs_texel::surface::Topology;
use gs_texel::{Character, Clip, Morph, Pose, Skinning};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use gs_core::{Camera, Time};
use gs_data::avatar::layout::{Film, FrameUse, Role, Shot, Still, shot_name};
use gs_data::avatar::{BUILTIN, MeasuredPoints, SurfacePoints, sample};
use gs_data::json::read_object;
use gs_data::{DataError, DataOptions, Dataset, ImageSource, Place, View};
use shade::Stage;
use template::Chosen;

mod rig;
mod shade;
mod template;
mod write;

pub use gs_data::avatar::Morphs;
pub use shade::Light;
pub use template::Atlas;
pub use write::write;

/// What to film.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AvatarOptions {
    /// `builtin:person`, `builtin:sphere`, `builtin:cylinder`, `builtin:plate`, or a glTF or GLB file.
    pub template: String,
    /// Where the faces of a file's template lie in its atlas.
    pub atlas: Atlas,
    /// Name of the motion; none: the first there is.
    pub clip: Option<String>,
    /// Cameras in each ring, a multiple of 4.
    pub per_ring: u32,
    /// Rings, 1 to 3.
    pub rings: u32,
    /// Frames.
    pub frames: u32,
    /// Frames per second; none: such that the frames span the motion once.
    pub fps: Option<f64>,
    /// Every so manyth frame, beginning in the middle of the first run, is for tests alone (novel poses); 0: none.
    pub test_every: u32,
    /// Side of the square pictures, pixels.
    pub size: u32,
    /// Samples per pixel along each axis, 4 to 16.
    pub supersample: u32,
    /// What becomes of morph targets.
    pub morph: Morphs,
    /// Names of the morph targets that the motion moves, the others stay at rest; none: all.
    pub only_morphs: Vec<String>,
    /// How joints are blended.
    pub skinning: Skinning,
    /// None: the texture's colour as it is.
    pub light: Option<Light>,
    /// Points of the true surface at each frame, uniform by area; 0: none.
    pub points: u32,
    /// Seed of the points.
    pub seed: u64,
}

impl Default for AvatarOptions {
    fn default() -> Self {
        Self {
            template: "builtin:person".into(),
            atlas: Atlas::Auto,
            clip: None,
            per_ring: 8,
            rings: 2,
            frames: 24,
            fps: None,
            test_every: 0,
            size: 256,
            supersample: 4,
            morph: Morphs::Gt,
            only_morphs: Vec::new(),
            skinning: Skinning::Lbs,
            light: None,
            points: 20_000,
            seed: 0,
        }
    }
}

/// Frames a second where a motion has no length.
const FPS: f64 = 24.0;
/// Lengths of characters that are presumably given in metres.
const METRES: std::ops::RangeInclusive<f32> = 0.1..=10.0;
/// Most memory that pictures may take.
const MAX_IMAGE_BYTES: u64 = 8 << 30;

/// Largest `scene.json`.
const MAX_SCENE_BYTES: u64 = 8 << 20;

/// Films a person in memory.
///
/// # Errors
/// `data.option` if an option is out of its domain or names a motion that is not there, `data.character` if the template
/// cannot be read.
pub fn generate(options: &AvatarOptions) -> Result<Dataset, DataError> {
    let set = Set::new(options)?;
    set.film()?.into_dataset(&DataOptions::default())
}

/// The options a film in the folder `dir` was generated with, its template named by where it lies now; none if it was not
/// generated.
///
/// # Errors
/// As reading its `scene.json` goes.
pub fn options_of(dir: &Path) -> Result<Option<AvatarOptions>, DataError> {
    let file = dir.join("scene.json");
    let map = read_object(&file, MAX_SCENE_BYTES)?;
    let Some(generated) = map.get("generated").filter(|v| !v.is_null()) else { return Ok(None) };
    let options: Result<AvatarOptions, _> = serde_json::from_value(generated.clone());
    let mut options = options.map_err(|e| DataError::syntax(&file, "generated", e.to_string()))?;
    if !options.template.starts_with(BUILTIN) {
        let name = map.get("template").and_then(Value::as_str).unwrap_or_default();
        options.template = dir.join(name).display().to_string();
    }
    Ok(Some(options))
}

/// Everything but the pictures.
struct Set<'a> {
    options: &'a AvatarOptions,
    character: Character,
    /// How its atlas was chosen and, if not as its file says, why.
    atlas: Atlas,
    why: Option<String>,
    topology: Topology,
    clip: Option<Clip>,
    fps: f64,
    stills: Vec<StillLife>,
    cameras: Vec<rig::Rigged>,
    /// Longest side of the box around all frames, world units.
    length: f32,
}

/// A frame and its true surface.
struct StillLife {
    list: FrameUse,
    pose: Pose,
    true_morphs: Vec<f32>,
    surface: Vec<Vec3>,
    points: Option<Arc<MeasuredPoints>>,
}

fn wrong(name: &'static str, value: impl ToString, rule: impl Into<String>) -> DataError {
    DataError::Option { name, value: value.to_string(), rule: rule.into() }
}

impl<'a> Set<'a> {
    fn new(options: &'a AvatarOptions) -> Result<Self, DataError> {
        check(options)?;
        let Chosen { character, atlas, why } = template::choose(&options.template, options.atlas)?;
        let template = &character.template;
        let topology = Topology::new(&template.faces, template.vertices.len());
        let topology = topology.map_err(|e| wrong("template", &options.template, e.to_string()))?;
        let clip = clip(&character, options.clip.as_deref())?;
        let names: Vec<&str> = template.morphs.iter().map(|m| m.name.as_str()).collect();
        if let Some(unknown) = options.only_morphs.iter().find(|n| !names.contains(&n.as_str())) {
            return Err(wrong("only_morphs", unknown, format!("of the template's morphs: {}", names.join(", "))));
        }
        let length = clip.as_ref().map_or(0.0, Clip::duration);
        let usual = if length > 0.0 { f64::from(options.frames) / length } else { FPS };
        let fps = options.fps.unwrap_or(usual);
        let (stills, cameras, length) = Default::default();
        let mut set = Self { options, character, atlas, why, topology, clip, fps, stills, cameras, length };
        set.stills = (0..options.frames).into_par_iter().map(|n| set.still(n)).collect();
        let [low, high] = set.bounds()?;
        set.length = (high - low).max_element();
        set.cameras = rig::rings(options.per_ring, options.rings, options.size, [low, high])?;
        Ok(set)
    }

    fn still(&self, number: u32) -> StillLife {
        let (options, skeleton) = (self.options, &self.character.skeleton);
        let seconds = f64::from(number) / self.fps;
        let rest = || skeleton.rest_pose();
        let mut shown = self.clip.as_ref().map_or_else(rest, |c| c.pose(skeleton, seconds));
        let acts = |m: &Morph| options.only_morphs.is_empty() || options.only_morphs.contains(&m.name);
        let weights = shown.morphs.iter_mut().zip(rest().morphs);
        let still = weights.zip(&self.character.template.morphs).filter(|(_, m)| !acts(m));
        still.for_each(|((weight, rest), _)| *weight = rest);
        let (known, true_morphs) = match options.morph {
            Morphs::Gt => (rest().morphs, shown.morphs),
            Morphs::Apply => (shown.morphs.clone(), shown.morphs),
            Morphs::Ignore => (rest().morphs, rest().morphs),
        };
        let truth = Pose { locals: shown.locals.clone(), morphs: true_morphs.clone() };
        let surface = self.character.posed(&truth, options.skinning);
        let faces = &self.character.template.faces;
        let points = (options.points > 0).then(|| {
            let on = sample::on_faces(&surface, faces, options.points as usize, options.seed, number);
            let stage = Stage::new(&self.character.template, &self.topology, surface.clone(), options.light);
            let colors = on.iter().map(|(face, bary)| stage.color(*face, *bary)).collect();
            Arc::new(MeasuredPoints { positions: sample::places(&on, &surface, faces), colors: Some(colors) })
        });
        let every = options.test_every;
        let list = if every > 0 && number % every == every / 2 { FrameUse::Test } else { FrameUse::Train };
        StillLife { list, pose: Pose { locals: shown.locals, morphs: known }, true_morphs, surface, points }
    }

    /// The box around the surface at every frame.
    fn bounds(&self) -> Result<[Vec3; 2], DataError> {
        let mut all = self.stills.iter().flat_map(|s| &s.surface).copied();
        let first = all.next().ok_or_else(|| wrong("template", &self.options.template, "one with vertices"))?;
        let [low, high] = all.fold([first; 2], |[low, high], p| [low.min(p), high.max(p)]);
        if !(low.is_finite() && high.is_finite()) {
            return Err(wrong("template", &self.options.template, "one whose poses are finite"));
        }
        Ok([low, high])
    }

    /// A person at a frame, ready to be seen.
    fn stage(&self, frame: usize) -> Stage<'_> {
        let surface = self.stills[frame].surface.clone();
        Stage::new(&self.character.template, &self.topology, surface, self.options.light)
    }

    /// With pictures in memory.
    fn film(&self) -> Result<Film, DataError> {
        let (cameras, frames) = (self.cameras.len(), self.stills.len());
        let stages: Vec<Stage> = (0..frames).into_par_iter().map(|k| self.stage(k)).collect();
        let shot = |i: usize| {
            let (id, frame) = (i / frames, i % frames);
            let rig::Rigged { camera, role } = &self.cameras[id];
            let image = Arc::new(stages[frame].picture(camera, self.options.supersample));
            self.shot(id as u32, frame as u32, *role, camera, ImageSource::Memory(image))
        };
        let shots = (0..cameras * frames).into_par_iter().map(shot).collect();
        let still = |(number, s): (usize, &StillLife)| Still {
            number: number as u32,
            list: s.list,
            pose: s.pose.clone(),
            true_morphs: Some(s.true_morphs.clone()),
            points: s.points.clone().map(SurfacePoints::Memory),
        };
        Ok(Film {
            root: PathBuf::new(),
            layout: "synth",
            place: Place { file: "generated".into(), at: String::new() },
            character: self.character.clone(),
            skinning: self.options.skinning,
            fps: self.fps,
            stills: self.stills.iter().enumerate().map(still).collect(),
            shots,
            has_alpha: true,
            notes: self.notes(),
        })
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = vec![format!("generated film of {}", self.options.template)];
        notes.extend(self.why.iter().map(|why| format!("template: {why}")));
        if !METRES.contains(&self.length) {
            notes.push(format!(
                "template: it is {:.3} units long, but a unit is taken for a metre: `dut` holds depths apart by \
                 unproject.depth_tolerance (0.02) and may see nothing of it; scale the file",
                self.length
            ));
        }
        notes
    }

    fn shot(&self, id: u32, frame: u32, role: Role, camera: &Camera, image: ImageSource) -> Shot {
        let view = View::new(shot_name(id, frame), camera.clone(), Time::default(), image, id);
        Shot { number: frame, role, view }
    }
}

fn check(o: &AvatarOptions) -> Result<(), DataError> {
    let ranges = [
        ("rings", o.rings, 1..=3),
        ("per_ring", o.per_ring, 4..=64),
        ("frames", o.frames, 1..=100_000),
        ("size", o.size, 1..=2048),
        ("supersample", o.supersample, 4..=16),
        ("points", o.points, 0..=10_000_000),
    ];
    for (name, value, range) in ranges {
        if !range.contains(&value) {
            return Err(wrong(name, value, format!("{} to {}", range.start(), range.end())));
        }
    }
    if !o.per_ring.is_multiple_of(4) {
        return Err(wrong("per_ring", o.per_ring, "a multiple of 4: there is a conditioning camera every 90 degrees"));
    }
    if o.test_every == 1 {
        return Err(wrong("test_every", 1, "0, or at least 2: some frames must train"));
    }
    if let Some(fps) = o.fps.filter(|f| !(*f > 0.0 && f.is_finite())) {
        return Err(wrong("fps", fps, "above 0: frames per second"));
    }
    if let Some(light) = &o.light {
        let length = light.direction.iter().map(|v| v * v).sum::<f64>();
        if !(length > 0.0 && length.is_finite() && (0.0..=1.0).contains(&light.ambient)) {
            return Err(wrong("light", format!("{light:?}"), "a finite direction that is not zero, ambient 0 to 1"));
        }
    }
    let pictures = u64::from(o.per_ring * o.rings) * u64::from(o.frames);
    if pictures * u64::from(o.size) * u64::from(o.size) * 4 > MAX_IMAGE_BYTES {
        return Err(wrong("frames", o.frames, "all pictures together below 8 GiB"));
    }
    Ok(())
}

/// The motion of that name, or the first there is.
fn clip(character: &Character, name: Option<&str>) -> Result<Option<Clip>, DataError> {
    let Some(name) = name else { return Ok(character.clips.first().cloned()) };
    let known = || character.clips.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", ");
    let found = character.clip(name);
    found.cloned().map(Some).ok_or_else(|| wrong("clip", name, format!("one of the template's motions: {}", known())))
}
