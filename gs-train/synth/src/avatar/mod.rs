//! Generated films of a person: a built-in or a glTF character in motion, seen by rings of static cameras.
//!
//! The data set is that of the layout `avatar`, in memory or as a folder ([`write()`]): multi-view images with alpha,
//! poses, and points of the true surface. With [`Morphs::Gt`] the images show morph targets that the poses do not state:
//! offsets in the bind pose with exact ground truth. The result is a function of the options alone.
//!
//! ```
//! use gs_synth::avatar::{AvatarOptions, generate};
//!
//! let options = AvatarOptions { size: 8, per_ring: 4, rings: 1, frames: 2, points: 10, ..AvatarOptions::default() };
//! let film = generate(&options)?;
//! let scene = film.avatar.as_ref().unwrap();
//! assert_eq!((scene.frames.len(), scene.input_count(), film.train.len()), (2, 4, 8));
//! # Ok::<(), gs_data::DataError>(())
//! ```

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::Vec3;
use gs_texel::surface::Topology;
use gs_texel::{Character, Clip, Morph, Pose, Skinning};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use gs_core::{Camera, Time, cast};
use gs_data::avatar::layout::{Film, FilmFrame, FrameUse, Role, Shot, shot_name};
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

/// Options of [`generate`]: character, motion, cameras and images. Deserialising refuses unknown keys.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AvatarOptions {
    /// `builtin:` with `person`, `body`, `gown`, `sphere`, `cylinder` or `plate`, or a glTF or GLB file.
    pub template: String,
    /// Layout of the texture atlas of a template from a file.
    pub atlas: Atlas,
    /// Name of the motion; none: the first of the template.
    pub clip: Option<String>,
    /// Number of cameras in each ring, a multiple of 4, at most 64.
    pub per_ring: u32,
    /// Number of rings, 1 to 3.
    pub rings: u32,
    /// Number of timestamps that are filmed.
    pub frames: u32,
    /// Frames per second; none: such that the frames span the motion once.
    pub fps: Option<f64>,
    /// One frame of every `test_every`, the middle one, is held out (novel poses); 0: none.
    pub test_every: u32,
    /// Side of the square images, pixels.
    pub size: u32,
    /// Samples per pixel along each axis, 4 to 16.
    pub supersample: u32,
    /// How images and poses treat morph targets.
    pub morph: Morphs,
    /// Names of the morph targets that the motion moves, the others stay at rest; none: all.
    pub only_morphs: Vec<String>,
    /// How joint transforms are blended.
    pub skinning: Skinning,
    /// Directional light; none: unlit texture colours.
    pub light: Option<Light>,
    /// Number of points of the true surface at each frame, uniform by area; 0: none.
    pub points: u32,
    /// Seed of the surface points.
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

/// Frames per second for a motion without duration.
const FPS: f64 = 24.0;
/// Plausible lengths of a character in metres.
const METRES: std::ops::RangeInclusive<f32> = 0.1..=10.0;
/// Longest side of a picture before it is reduced to `size`, pixels: every thread draws one.
const MAX_SIDE: u32 = 8192;
/// Most memory for all images together.
const MAX_IMAGE_BYTES: u64 = 8 << 30;

/// Largest `scene.json`.
const MAX_SCENE_BYTES: u64 = 8 << 20;

/// Generates a film in memory.
///
/// # Errors
/// `data.option` if an option is out of its domain or names an unknown motion, `data.character` if the template
/// cannot be read.
pub fn generate(options: &AvatarOptions) -> Result<Dataset, DataError> {
    let scene = Scene::new(options)?;
    scene.film()?.into_dataset(&DataOptions::default())
}

/// The options with which the film in the folder `dir` was generated, with the path of the template in that folder; none if it
/// was not generated.
///
/// # Errors
/// `io.read`, `limits.file` or `data.syntax` of its `scene.json`.
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

/// A film without its images.
struct Scene<'a> {
    options: &'a AvatarOptions,
    character: Character,
    /// Layout of its atlas and, if not that of its file, the reason.
    atlas: Atlas,
    why: Option<String>,
    topology: Topology,
    clip: Option<Clip>,
    fps: f64,
    frames: Vec<PosedFrame>,
    cameras: Vec<rig::Rigged>,
    /// Longest side of the box around the surface at all frames, world units.
    length: f32,
}

/// A frame and its true surface.
struct PosedFrame {
    list: FrameUse,
    pose: Pose,
    true_morphs: Vec<f32>,
    surface: Vec<Vec3>,
    points: Option<Arc<MeasuredPoints>>,
}

fn wrong(name: &'static str, value: impl ToString, rule: impl Into<String>) -> DataError {
    DataError::Option { name, value: value.to_string(), rule: rule.into() }
}

impl<'a> Scene<'a> {
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
        let (frames, cameras, length) = Default::default();
        let mut scene = Self { options, character, atlas, why, topology, clip, fps, frames, cameras, length };
        scene.frames = (0..options.frames).into_par_iter().map(|n| scene.frame(n)).collect();
        let [low, high] = scene.bounds()?;
        scene.length = (high - low).max_element();
        scene.cameras = rig::rings(options.per_ring, options.rings, options.size, [low, high])?;
        Ok(scene)
    }

    fn frame(&self, number: u32) -> PosedFrame {
        let (options, skeleton) = (self.options, &self.character.skeleton);
        let seconds = f64::from(number) / self.fps;
        let rest = || skeleton.rest_pose();
        let mut shown = self.clip.as_ref().map_or_else(rest, |c| c.pose(skeleton, seconds));
        let acts = |m: &Morph| options.only_morphs.is_empty() || options.only_morphs.contains(&m.name);
        let weights = shown.morphs.iter_mut().zip(rest().morphs);
        let resting = weights.zip(&self.character.template.morphs).filter(|(_, m)| !acts(m));
        resting.for_each(|((weight, rest), _)| *weight = rest);
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
        PosedFrame { list, pose: Pose { locals: shown.locals, morphs: known }, true_morphs, surface, points }
    }

    /// The box around the surface at all frames.
    fn bounds(&self) -> Result<[Vec3; 2], DataError> {
        let mut all = self.frames.iter().flat_map(|s| &s.surface).copied();
        let first = all.next().ok_or_else(|| wrong("template", &self.options.template, "one with vertices"))?;
        let [low, high] = all.fold([first; 2], |[low, high], p| [low.min(p), high.max(p)]);
        if !(low.is_finite() && high.is_finite()) {
            return Err(wrong("template", &self.options.template, "one whose poses are finite"));
        }
        Ok([low, high])
    }

    /// The surface at a frame, prepared for rendering.
    fn stage(&self, frame: usize) -> Stage<'_> {
        let surface = self.frames[frame].surface.clone();
        Stage::new(&self.character.template, &self.topology, surface, self.options.light)
    }

    /// The film with its images in memory.
    fn film(&self) -> Result<Film, DataError> {
        let (cameras, frames) = (self.cameras.len(), self.frames.len());
        let stages: Vec<Stage> = (0..frames).into_par_iter().map(|k| self.stage(k)).collect();
        let shot = |i: usize| {
            let (id, frame) = (i / frames, i % frames);
            let rig::Rigged { camera, role } = &self.cameras[id];
            let image = Arc::new(stages[frame].picture(camera, self.options.supersample));
            self.shot(cast::to_u32(id), cast::to_u32(frame), *role, camera, ImageSource::Memory(image))
        };
        let shots = (0..cameras * frames).into_par_iter().map(shot).collect();
        let film_frame = |(number, s): (usize, &PosedFrame)| FilmFrame {
            number: cast::to_u32(number),
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
            frames: self.frames.iter().enumerate().map(film_frame).collect(),
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
                "template: it is {:.3} units long, but a unit is taken for a metre: the lengths among the \
                 settings of `dut`, such as unproject.near (0.05) and gaunet.offset_unit, do not fit it; scale the file",
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
    if o.size * o.supersample > MAX_SIDE {
        return Err(wrong("supersample", o.supersample, format!("size times supersample at most {MAX_SIDE}")));
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
    let images = u64::from(o.per_ring * o.rings) * u64::from(o.frames);
    if images * u64::from(o.size) * u64::from(o.size) * 4 > MAX_IMAGE_BYTES {
        return Err(wrong("frames", o.frames, "all images together below 8 GiB"));
    }
    Ok(())
}

/// The motion of that name, else the first of the template.
fn clip(character: &Character, name: Option<&str>) -> Result<Option<Clip>, DataError> {
    let Some(name) = name else { return Ok(character.clips.first().cloned()) };
    let known = || character.clips.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", ");
    let found = character.clip(name);
    found.cloned().map(Some).ok_or_else(|| wrong("clip", name, format!("one of the template's motions: {}", known())))
}
