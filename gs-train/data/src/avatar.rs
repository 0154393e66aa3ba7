//! A filmed person: the character, where its joints are in every frame, and what the conditioning cameras saw of it.
//!
//! A data set of the layout `avatar` (or made by gs-synth) carries one in
//! [`Dataset::avatar`](crate::Dataset::avatar). A method finds its frame by time: [`AvatarScene::frame_at`].

use crate::avatar::layout::points;
use crate::{DataError, ImageCache, ImageU8, View};
use glam::Vec3;
use gs_core::{Camera, Image, Time};
use gs_texel::figure::{self, Cylinder};
use gs_texel::{Character, Pose, Skinning};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

pub mod layout;
pub mod sample;

/// What images and poses make of morph targets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Morphs {
    /// Images show them, poses are at rest: their offsets are to be found.
    #[default]
    Gt,
    /// Images show them and poses state their weights.
    Apply,
    /// Neither images nor poses have them.
    Ignore,
}

/// What names of characters that need no file begin with.
pub const BUILTIN: &str = "builtin:";
/// Names of characters that need no file.
pub const BUILTINS: &str = "builtin:person, builtin:sphere, builtin:cylinder or builtin:plate";

/// The character that needs no file, by its name without [`BUILTIN`].
pub fn builtin(name: &str) -> Option<Character> {
    match name {
        "person" => Some(figure::person()),
        "sphere" => Some(figure::sphere(0.9, 24, 48)),
        "cylinder" => Some(figure::cylinder(&Cylinder::default())),
        "plate" => Some(figure::plate(1.0, 8)),
        _ => None,
    }
}

/// A filmed person.
#[derive(Clone, Debug, PartialEq)]
pub struct AvatarScene {
    /// Its template, skeleton and motions.
    pub character: Character,
    /// How joints are blended.
    pub skinning: Skinning,
    /// Frames per second.
    pub fps: f64,
    /// At least one, ascending in time.
    pub frames: Vec<AvatarFrame>,
}

/// A moment of a filmed person.
#[derive(Clone, Debug, PartialEq)]
pub struct AvatarFrame {
    /// Its number; it was filmed at `number / fps` seconds.
    pub number: u32,
    /// The moment, on the clock of the data set's views.
    pub time: Time,
    /// Whether training views show it: what is learnt of all frames at once leaves out the others.
    pub learnt: bool,
    /// Where the joints are, and the weights of the morphs as far as they are known: what a method may use.
    pub pose: Pose,
    /// What the conditioning cameras saw, in order of their ids: RGBA, alpha is coverage. At least one.
    pub inputs: Vec<View>,
    /// Points of the true surface, where the data bring them along.
    pub points: Option<SurfacePoints>,
    /// The weights of the morphs that the images show, where they are known: truth to compare with, not to learn from.
    pub true_morphs: Option<Vec<f32>>,
}

/// Points of a surface.
#[derive(Clone, Debug, PartialEq)]
pub enum SurfacePoints {
    /// A file of them.
    File(PathBuf),
    /// The points themselves.
    Memory(Arc<MeasuredPoints>),
}

/// Points of a surface, and what they look like.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeasuredPoints {
    /// World units.
    pub positions: Vec<Vec3>,
    /// Display-encoded RGB in 0..1, one per position, where they were measured.
    pub colors: Option<Vec<[f32; 3]>>,
}

impl MeasuredPoints {
    /// Points of unknown colour.
    pub fn uncoloured(positions: Vec<Vec3>) -> Self {
        Self { positions, colors: None }
    }
}

impl SurfacePoints {
    /// The points.
    ///
    /// # Errors
    /// As reading the file goes.
    pub fn read(&self) -> Result<Arc<MeasuredPoints>, DataError> {
        match self {
            Self::Memory(points) => Ok(points.clone()),
            Self::File(file) => Ok(Arc::new(points::read(file)?)),
        }
    }
}

impl AvatarScene {
    /// The frame nearest to a normalised time; of two equally near the earlier.
    ///
    /// # Panics
    /// Never for a scene with a frame, which every reader and generator gives.
    pub fn frame_at(&self, t: Time) -> &AvatarFrame {
        let after = self.frames.partition_point(|f| f.time.normalised < t.normalised);
        let next = after.min(self.frames.len() - 1);
        let before = next.saturating_sub(1);
        let away = |k: usize| (self.frames[k].time.normalised - t.normalised).abs();
        &self.frames[if away(before) <= away(next) { before } else { next }]
    }

    /// The template in the world at a frame's pose, `N` rows: what is known without looking at the images.
    pub fn posed(&self, frame: &AvatarFrame) -> Vec<Vec3> {
        self.character.posed(&frame.pose, self.skinning)
    }

    /// `D`: the offsets in the bind pose that the images show and the pose does not explain, `N` rows, where they are known.
    pub fn true_offsets(&self, frame: &AvatarFrame) -> Option<Vec<Vec3>> {
        let shown = self.character.template.morphed(frame.true_morphs.as_ref()?);
        let known = self.character.template.morphed(&frame.pose.morphs);
        Some(shown.iter().zip(known).map(|(&s, k)| s - k).collect())
    }

    /// The surface that the images show, in the world, `N` rows: [`Self::posed`] where no other truth is known.
    pub fn true_surface(&self, frame: &AvatarFrame) -> Vec<Vec3> {
        let morphs = frame.true_morphs.as_ref().unwrap_or(&frame.pose.morphs).clone();
        self.character.posed(&Pose { morphs, ..frame.pose.clone() }, self.skinning)
    }

    /// Colour and coverage of an input, of the size of its camera: the mask gives alpha where there is one, colour is zero
    /// where nothing is.
    ///
    /// # Errors
    /// As decoding goes.
    pub fn input_pixels(view: &View, cache: &ImageCache) -> Result<Arc<ImageU8>, DataError> {
        let image = cache.get(view)?;
        let Some(mask) = cache.mask(view)? else { return Ok(image) };
        let mut cut = Arc::unwrap_or_clone(image);
        for (pixel, m) in cut.data.chunks_exact_mut(4).zip(mask.data) {
            pixel[3] = (f32::from(pixel[3]) * m).round() as u8;
            if pixel[3] == 0 {
                pixel[..3].fill(0);
            }
        }
        Ok(Arc::new(cut))
    }

    /// Inputs decoded, with their cameras: straight colours in 0..1, the fourth channel is coverage.
    ///
    /// # Errors
    /// As decoding goes.
    pub fn photographs(inputs: &[View], cache: &ImageCache) -> Result<Vec<(Camera, Image)>, DataError> {
        let decoded = |view| {
            let ImageU8 { width, height, data } = &*Self::input_pixels(view, cache)?;
            let data = data.iter().map(|&v| f32::from(v) / 255.0).collect();
            Ok((cache.camera(view), Image { width: *width, height: *height, channels: 4, data }))
        };
        inputs.iter().map(decoded).collect()
    }

    /// Number of conditioning cameras of the first frame.
    pub fn input_count(&self) -> usize {
        self.frames.first().map_or(0, |f| f.inputs.len())
    }

    /// Every view of every frame's inputs, to be changed.
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
        AvatarScene { character: Character::default(), skinning: Skinning::Lbs, fps: 1.0, frames }
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
