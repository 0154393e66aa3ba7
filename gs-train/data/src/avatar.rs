//! A filmed person: the rigged template, its pose in every frame, and the images of the conditioning cameras.
//!
//! A data set of the layout `avatar` (or made by gs-synth) has one in
//! [`Dataset::avatar`](crate::Dataset::avatar). [`AvatarScene::frame_at`] finds a frame by time. Template vertices are `N` rows,
//! lengths are metres.

use crate::avatar::layout::points;
use crate::cache::ImageCache;
use crate::error::DataError;
use crate::pixels::ImageU8;
use crate::view::View;
use glam::Vec3;
use gs_core::{Camera, Image, Time, cast};
use gs_texel::figure::{self, Cylinder};
use gs_texel::{Character, Pose, Skinning};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

pub mod layout;
pub mod rig;
pub mod sample;

/// How images and poses of a film treat morph targets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Morphs {
    /// Images show them, poses are at rest: a method has to estimate their offsets.
    #[default]
    Gt,
    /// Images show them and poses state their weights.
    Apply,
    /// Neither images nor poses have them.
    Ignore,
}

/// Prefix of the names of characters that need no file.
pub const BUILTIN: &str = "builtin:";
/// The names of characters that need no file, for error texts.
pub const BUILTINS: &str =
    "builtin:person, builtin:body, builtin:gown, builtin:sphere, builtin:cylinder or builtin:plate";

/// A character that needs no file, by its name without [`BUILTIN`]; none for an unknown name.
///
/// ```
/// use gs_data::avatar::builtin;
///
/// assert!(builtin("person").is_some_and(|c| c.skeleton.node("head").is_some()));
/// assert!(builtin("tail").is_none());
/// ```
pub fn builtin(name: &str) -> Option<Character> {
    match name {
        "person" => Some(figure::person()),
        "body" => Some(figure::body()),
        "gown" => Some(figure::gown()),
        "sphere" => Some(figure::sphere(0.9, 24, 48)),
        "cylinder" => Some(figure::cylinder(&Cylinder::default())),
        "plate" => Some(figure::plate(1.0, 8)),
        _ => None,
    }
}

/// A filmed person: rigged template, pose and inputs of every frame.
#[derive(Clone, Debug, PartialEq)]
pub struct AvatarScene {
    /// Template mesh, skeleton and motions of the person.
    pub character: Character,
    /// How joint transforms are blended: linearly or as dual quaternions.
    pub skinning: Skinning,
    /// Frames per second of film and motions.
    pub fps: f64,
    /// Frames that have inputs, ascending in time; at least one.
    pub frames: Vec<AvatarFrame>,
    /// Most memory for decoding one of its images, MiB ([`Dataset::max_image_mib`](crate::Dataset::max_image_mib)).
    pub max_image_mib: Option<u32>,
}

/// A frame of a filmed person.
#[derive(Clone, Debug, PartialEq)]
pub struct AvatarFrame {
    /// Number of the frame, at `number / fps` seconds.
    pub number: u32,
    /// Timestamp, on the clock of the data set's views.
    pub time: Time,
    /// Whether training views have this timestamp. Statistics over frames must leave out the others.
    pub learnt: bool,
    /// Joint transforms, and morph weights as far as they are known: what a method may use.
    pub pose: Pose,
    /// Views of the conditioning cameras, ascending in id: RGBA, alpha is coverage. At least one.
    pub inputs: Vec<View>,
    /// Points of the true surface, where the data have them.
    pub points: Option<SurfacePoints>,
    /// Morph weights that the images show, where they are known: ground truth for evaluation, not for training.
    pub true_morphs: Option<Vec<f32>>,
}

/// Points of a surface, in a file or in memory.
#[derive(Clone, Debug, PartialEq)]
pub enum SurfacePoints {
    /// Path of a `.ply`, `.obj` or `.bin` file.
    File(PathBuf),
    /// Points in memory, shared.
    Memory(Arc<MeasuredPoints>),
}

/// Points of a surface with optional colours.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeasuredPoints {
    /// Positions of the points, world units.
    pub positions: Vec<Vec3>,
    /// Display-encoded RGB in 0..1, one row per position, where they were measured.
    pub colors: Option<Vec<[f32; 3]>>,
}

impl MeasuredPoints {
    /// Points of unknown colour.
    pub(crate) fn uncoloured(positions: Vec<Vec3>) -> Self {
        Self { positions, colors: None }
    }
}

impl SurfacePoints {
    /// The points, read from the file if they are in one.
    ///
    /// # Errors
    /// `data.points`, `data.syntax` or `data.truncated` if the file is damaged, `io.read` if it cannot be read.
    pub fn read(&self) -> Result<Arc<MeasuredPoints>, DataError> {
        match self {
            Self::Memory(points) => Ok(points.clone()),
            Self::File(file) => Ok(Arc::new(points::read(file)?)),
        }
    }
}

impl AvatarScene {
    /// The frame nearest in normalised time; of two equally near ones the earlier.
    ///
    /// # Panics
    /// If [`Self::frames`] is empty; readers and generators give at least one frame.
    pub fn frame_at(&self, t: Time) -> &AvatarFrame {
        let after = self.frames.partition_point(|f| f.time.normalised < t.normalised);
        let next = after.min(self.frames.len() - 1);
        let before = next.saturating_sub(1);
        let away = |k: usize| (self.frames[k].time.normalised - t.normalised).abs();
        &self.frames[if away(before) <= away(next) { before } else { next }]
    }

    /// Template vertices at a frame's pose, world units, `N` rows: what is known without the images.
    pub fn posed(&self, frame: &AvatarFrame) -> Vec<Vec3> {
        self.character.posed(&frame.pose, self.skinning)
    }

    /// True offsets `D` of the template vertices in the bind pose, beyond those of the pose's morph weights, `N` rows; none where
    /// they are not known.
    pub fn true_offsets(&self, frame: &AvatarFrame) -> Option<Vec<Vec3>> {
        let shown = self.character.template.morphed(frame.true_morphs.as_ref()?);
        let known = self.character.template.morphed(&frame.pose.morphs);
        Some(shown.iter().zip(known).map(|(&s, k)| s - k).collect())
    }

    /// True vertices at a frame, world units, `N` rows: [`Self::posed`] with the true morph weights, where they are known.
    pub fn true_surface(&self, frame: &AvatarFrame) -> Vec<Vec3> {
        let morphs = frame.true_morphs.as_ref().unwrap_or(&frame.pose.morphs).clone();
        self.character.posed(&Pose { morphs, ..frame.pose.clone() }, self.skinning)
    }

    /// Colour and coverage of an input view, at the size of its camera: RGBA, straight alpha. A mask multiplies alpha; colour is 0
    /// where alpha is.
    ///
    /// # Errors
    /// Those of [`ImageCache::get`] and [`ImageCache::mask`].
    pub fn input_pixels(view: &View, cache: &ImageCache) -> Result<Arc<ImageU8>, DataError> {
        let image = cache.get(view)?;
        if view.mask.is_none() {
            return Ok(image);
        }
        // The alpha of a view that is cut out has its mask already.
        let mask = if view.cut_out { None } else { cache.mask(view)? };
        let mut cut = Arc::unwrap_or_clone(image);
        if let Some(mask) = mask {
            for (pixel, m) in cut.data.chunks_exact_mut(4).zip(&mask.data) {
                pixel[3] = cast::to_u8((f32::from(pixel[3]) * m).round());
            }
        }
        cut.data.chunks_exact_mut(4).filter(|pixel| pixel[3] == 0).for_each(|pixel| pixel[..3].fill(0));
        Ok(Arc::new(cut))
    }

    /// The images of input views with their cameras: `[H, W, 4]` in 0..1, straight colours and coverage.
    ///
    /// # Errors
    /// Those of [`Self::input_pixels`].
    pub fn input_images(inputs: &[View], cache: &ImageCache) -> Result<Vec<(Camera, Image)>, DataError> {
        let decoded = |view: &View| {
            let ImageU8 { width, height, data } = &*Self::input_pixels(view, cache)?;
            let data = data.iter().map(|&v| f32::from(v) / 255.0).collect();
            Ok((cache.camera(view), Image { width: *width, height: *height, channels: 4, data }))
        };
        let images: Vec<Result<_, DataError>> = inputs.par_iter().map(decoded).collect();
        images.into_iter().collect()
    }

    /// Number of conditioning cameras of the first frame.
    pub fn input_count(&self) -> usize {
        self.frames.first().map_or(0, |f| f.inputs.len())
    }

    /// The input views of all frames, mutable.
    pub(crate) fn inputs_mut(&mut self) -> impl Iterator<Item = &mut View> {
        self.frames.iter_mut().flat_map(|f| &mut f.inputs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(normalised: f32) -> Time {
        Time { normalised, seconds: f64::from(normalised) }
    }

    fn scene(times: &[f32]) -> AvatarScene {
        let frame = |(k, &t): (usize, &f32)| AvatarFrame {
            number: k as u32,
            time: at(t),
            learnt: true,
            pose: Pose::default(),
            inputs: Vec::new(),
            points: None,
            true_morphs: None,
        };
        let frames = times.iter().enumerate().map(frame).collect();
        let (character, skinning) = (Character::default(), Skinning::Lbs);
        AvatarScene { character, skinning, fps: 1.0, frames, max_image_mib: None }
    }

    #[test]
    fn the_nearest_frame_is_found_also_outside() {
        let s = scene(&[0.0, 0.5, 1.0, 3.0]);
        for (t, want) in [(-7.0, 0), (0.0, 0), (0.2, 0), (0.25, 0), (0.3, 1), (1.0, 2), (1.9, 2), (2.1, 3), (9.0, 3)] {
            assert_eq!(s.frame_at(at(t)).number, want, "{t}");
        }
        assert_eq!(scene(&[0.4]).frame_at(at(0.0)).number, 0);
    }

    #[test]
    fn offsets_are_what_the_pose_does_not_explain() {
        let mut s = scene(&[0.0]);
        let t = &mut s.character.template;
        t.vertices = vec![Vec3::ZERO; 2];
        t.morphs =
            [Vec3::X, Vec3::Y].map(|d| gs_texel::Morph { name: String::new(), offsets: vec![d, 2.0 * d] }).into();
        s.frames[0].pose.morphs = vec![0.0, 0.5];
        assert_eq!(s.true_offsets(&s.frames[0]), None);
        s.frames[0].true_morphs = Some(vec![0.25, 1.0]);
        let want = Vec3::new(0.25, 0.5, 0.0);
        assert_eq!(s.true_offsets(&s.frames[0]), Some(vec![want, 2.0 * want]));
    }
}
