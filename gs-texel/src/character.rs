//! A character: a template, the skeleton that moves it, and the motions it came with.

use crate::clip::Clip;
use crate::skeleton::{Pose, Skeleton};
use crate::skin::{Skinning, skin};
use crate::template::Template;
use glam::Vec3;

/// What a file of a rigged character, or a procedure, gives.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Character {
    /// The mesh in its bind pose.
    pub template: Template,
    /// What moves it.
    pub skeleton: Skeleton,
    /// Its motions.
    pub clips: Vec<Clip>,
    /// The vertices as the file lists them (meshes of the scene, their primitives, their rows), as numbers of the
    /// template's welded vertices.
    pub file_vertices: Vec<u32>,
    /// What was repaired or left out.
    pub fallbacks: Fallbacks,
}

/// What a reader repaired or left out, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Fallbacks {
    /// Vertices without a positive weight: bound to the nearest joint of their skin.
    pub unbound_vertices: usize,
    /// Vertices whose weights were negative or did not sum to 1 within 1e-2: left out, made to sum to 1.
    pub mended_weights: usize,
    /// Triangles dropped because two of their corners are one vertex.
    pub collapsed_faces: usize,
    /// Triangles of no area in space, kept.
    pub flat_faces: usize,
    /// Triangles of no area in the texture, kept; they own no texel.
    pub flat_face_uvs: usize,
    /// Primitives of points or lines, or without positions: left out.
    pub ignored_primitives: usize,
    /// Animation channels of things that are not read (or of nothing): left out.
    pub ignored_channels: usize,
}

impl Fallbacks {
    /// The counters that are not 0, by name.
    pub fn list(&self) -> Vec<(&'static str, usize)> {
        let all = [
            ("vertices without weights, bound to the nearest joint", self.unbound_vertices),
            ("vertices with mended weights", self.mended_weights),
            ("collapsed triangles dropped", self.collapsed_faces),
            ("triangles of no area", self.flat_faces),
            ("triangles of no area in the texture", self.flat_face_uvs),
            ("primitives ignored", self.ignored_primitives),
            ("animation channels ignored", self.ignored_channels),
        ];
        all.into_iter().filter(|(_, n)| *n > 0).collect()
    }
}

impl Character {
    /// The first clip of that name.
    pub fn clip(&self, name: &str) -> Option<&Clip> {
        self.clips.iter().find(|c| c.name == name)
    }

    /// The template's vertices in the world at a pose, with its morphs.
    pub fn posed(&self, pose: &Pose, skinning: Skinning) -> Vec<Vec3> {
        let transforms = skinning.blend(&self.template.weights, &self.skeleton.skinning(pose));
        skin(&self.template.morphed(&pose.morphs), &transforms)
    }
}
